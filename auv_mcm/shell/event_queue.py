"""Hold events between the source and perception: the one queue, and the one policy of what is dropped."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Callable
from typing import Final

from auv_mcm.records import Ping, SourceEvent

_OTHERS_PER_PING: Final = 16  # room in the queue for navigation samples and notices, per ping


class EventQueue:
    """Hold events between source and perception: at most `max_pings` pings and a proportionate number of others.

    A source that can wait puts its events in and is held back while there is no room. A live source cannot wait and
    pushes them: the oldest event of the same kind is dropped, counted as `service.ping_dropped` or
    `service.event_dropped`, because the newest gives the vehicle's present position. One task takes events out.
    """

    def __init__(
        self, max_pings: int, counters: Counter[str], see: Callable[[SourceEvent], None] = lambda event: None
    ) -> None:
        """see: is given every event as it comes, before it waits or is dropped."""
        self._max_pings = max_pings
        self._max_events = max_pings * (1 + _OTHERS_PER_PING)
        self._counters = counters
        self._see = see
        self._events: deque[SourceEvent] = deque()
        self._pings = 0
        self._closed = False
        self._filled = asyncio.Event()
        self._emptied = asyncio.Event()

    @property
    def pings(self) -> int:
        """Count the pings that wait."""
        return self._pings

    async def put(self, event: SourceEvent) -> None:
        """Append an event once there is room."""
        self._see(event)
        while self._is_full(isinstance(event, Ping)):
            self._emptied.clear()
            await self._emptied.wait()
        self._append(event)

    def push(self, event: SourceEvent) -> None:
        """Append an event at once; drop the oldest of its kind if there is no room."""
        self._see(event)
        if self._is_full(isinstance(event, Ping)):
            self._drop(isinstance(event, Ping))
        self._append(event)

    async def get(self) -> SourceEvent | None:
        """Take the next event; None once the queue is closed and empty."""
        while not self._events:
            if self._closed:
                return None
            self._filled.clear()
            await self._filled.wait()
        event = self._events.popleft()
        self._pings -= isinstance(event, Ping)
        self._emptied.set()
        return event

    def close(self) -> None:
        """Declare that no event follows."""
        self._closed = True
        self._filled.set()

    def _append(self, event: SourceEvent) -> None:
        self._events.append(event)
        self._pings += isinstance(event, Ping)
        self._filled.set()

    def _is_full(self, is_ping: bool) -> bool:
        return len(self._events) >= self._max_events or (is_ping and self._pings >= self._max_pings)

    def _drop(self, is_ping: bool) -> None:
        oldest = next((i for i, event in enumerate(self._events) if isinstance(event, Ping) == is_ping), 0)
        dropped_ping = isinstance(self._events[oldest], Ping)
        self._counters["service.ping_dropped" if dropped_ping else "service.event_dropped"] += 1
        self._pings -= dropped_ping
        del self._events[oldest]
