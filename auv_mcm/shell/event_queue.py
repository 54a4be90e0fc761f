"""The queue of events between the source and perception."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from typing import Final

from auv_mcm.records import Ping, SourceEvent

_OTHERS_PER_PING: Final = 16  # room in the queue for navigation samples and notices, per ping


class EventQueue:
    """Events on their way from the source to perception: at most `max_pings` pings and a proportionate number of others.

    A lossless source waits for room. Otherwise the oldest ping goes, counted as `service.ping_dropped`: what comes in now says
    where the vehicle is now.
    """

    def __init__(self, max_pings: int, lossless: bool, counters: Counter[str]) -> None:
        self._max_pings = max_pings
        self._max_events = max_pings * (1 + _OTHERS_PER_PING)
        self._lossless = lossless
        self._counters = counters
        self._events: deque[SourceEvent] = deque()
        self._pings = 0
        self._closed = False
        self._changed = asyncio.Condition()

    @property
    def pings(self) -> int:
        return self._pings

    async def put(self, event: SourceEvent) -> None:
        async with self._changed:
            is_ping = isinstance(event, Ping)
            if self._lossless:
                await self._changed.wait_for(lambda: not self._is_full(is_ping))
            elif self._is_full(is_ping):
                self._drop(is_ping)
            self._events.append(event)
            self._pings += is_ping
            self._changed.notify_all()

    async def get(self) -> SourceEvent | None:
        """The next event; None once the queue is closed and empty."""
        async with self._changed:
            await self._changed.wait_for(lambda: bool(self._events) or self._closed)
            if not self._events:
                return None
            event = self._events.popleft()
            self._pings -= isinstance(event, Ping)
            self._changed.notify_all()
            return event

    async def close(self) -> None:
        """No event follows."""
        async with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _is_full(self, is_ping: bool) -> bool:
        return len(self._events) >= self._max_events or (is_ping and self._pings >= self._max_pings)

    def _drop(self, is_ping: bool) -> None:
        oldest = next((i for i, event in enumerate(self._events) if isinstance(event, Ping) == is_ping), 0)
        dropped_ping = isinstance(self._events[oldest], Ping)
        self._counters["service.ping_dropped" if dropped_ping else "service.event_dropped"] += 1
        self._pings -= dropped_ping
        del self._events[oldest]
