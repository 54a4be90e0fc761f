"""Hold events between the source and perception: the one queue, and the one policy of what is dropped."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Callable
from typing import Final, NamedTuple

from auv_mcm.records import Ping, SourceEvent

_OTHERS_PER_PING: Final = 16  # room in the queue for navigation samples and notices, per ping


class Queued(NamedTuple):
    """Hold an event that waits, and its number."""

    number: int
    event: SourceEvent


class EventQueue:
    """Hold events between source and perception: at most `max_pings` pings and a proportionate number of others.

    A source that can wait puts its events in and is held back while there is no room. A live source cannot wait and
    pushes them: the oldest event of the same kind is dropped, counted as `service.ping_dropped` or
    `service.event_dropped`, because the newest gives the vehicle's present position. One task takes events out.
    """

    def __init__(
        self, max_pings: int, counters: Counter[str], see: Callable[[SourceEvent], int] = lambda event: 0
    ) -> None:
        """see: is given every event as it comes, before it waits or is dropped, and returns its number."""
        self._max_pings = max_pings
        self._max_events = max_pings * (1 + _OTHERS_PER_PING)
        self._counters = counters
        self._see = see
        self._events: deque[Queued] = deque()
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
        queued = Queued(self._see(event), event)
        while self._is_full(isinstance(event, Ping)):
            self._emptied.clear()
            await self._emptied.wait()
        self._append(queued)

    def push(self, event: SourceEvent) -> None:
        """Append an event at once; drop the oldest of its kind if there is no room."""
        queued = Queued(self._see(event), event)
        if self._is_full(isinstance(event, Ping)):
            self._drop(isinstance(event, Ping))
        self._append(queued)

    async def get(self) -> Queued | None:
        """Take the next event; None once the queue is closed and empty."""
        while not self._events:
            if self._closed:
                return None
            self._filled.clear()
            await self._filled.wait()
        queued = self._events.popleft()
        self._pings -= isinstance(queued.event, Ping)
        self._emptied.set()
        return queued

    def close(self) -> None:
        """Declare that no event follows."""
        self._closed = True
        self._filled.set()

    def _append(self, queued: Queued) -> None:
        self._events.append(queued)
        self._pings += isinstance(queued.event, Ping)
        self._filled.set()

    def _is_full(self, is_ping: bool) -> bool:
        return len(self._events) >= self._max_events or (is_ping and self._pings >= self._max_pings)

    def _drop(self, is_ping: bool) -> None:
        oldest = next((i for i, queued in enumerate(self._events) if isinstance(queued.event, Ping) == is_ping), 0)
        dropped_ping = isinstance(self._events[oldest].event, Ping)
        self._counters["service.ping_dropped" if dropped_ping else "service.event_dropped"] += 1
        self._pings -= dropped_ping
        del self._events[oldest]
