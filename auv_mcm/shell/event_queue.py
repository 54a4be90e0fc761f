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
    """Hold events between source and perception, pings and others in rooms of their own.

    There is room for `max_pings` pings and sixteen times as many others: however much comes of one kind, the other
    keeps its room.

    A source that can wait puts its events in and is held back while there is no room. A live source cannot wait and
    pushes them: the oldest event of the same kind is dropped, counted as `service.ping_dropped` or
    `service.event_dropped`, because the newest gives the vehicle's present position. One task takes events out, in the
    order in which they came.
    """

    def __init__(
        self, max_pings: int, counters: Counter[str], see: Callable[[SourceEvent], int] = lambda event: 0
    ) -> None:
        """see: is given every event as it comes, before it waits or is dropped, and returns its number."""
        self._counters = counters
        self._see = see
        self._pings = _Room("service.ping_dropped", max_pings)
        self._others = _Room("service.event_dropped", max_pings * _OTHERS_PER_PING)
        self._n_taken_in = 0
        self._closed = False
        self._filled = asyncio.Event()
        self._emptied = asyncio.Event()

    @property
    def pings(self) -> int:
        """Count the pings that wait."""
        return len(self._pings.waiting)

    async def put(self, event: SourceEvent) -> None:
        """Append an event once there is room."""
        queued = Queued(self._see(event), event)
        room = self._room(event)
        while room.is_full:
            self._emptied.clear()
            await self._emptied.wait()
        self._append(room, queued)

    def push(self, event: SourceEvent) -> None:
        """Append an event at once; drop the oldest of its kind if there is no room."""
        queued = Queued(self._see(event), event)
        room = self._room(event)
        if room.is_full:
            room.waiting.popleft()
            self._counters[room.dropped] += 1
        self._append(room, queued)

    async def get(self) -> Queued | None:
        """Take the next event; None once the queue is closed and empty."""
        while not (rooms := [room for room in (self._pings, self._others) if room.waiting]):
            if self._closed:
                return None
            self._filled.clear()
            await self._filled.wait()
        _, queued = min(rooms, key=lambda room: room.waiting[0][0]).waiting.popleft()
        self._emptied.set()
        return queued

    def close(self) -> None:
        """Declare that no event follows."""
        self._closed = True
        self._filled.set()

    def _room(self, event: SourceEvent) -> _Room:
        return self._pings if isinstance(event, Ping) else self._others

    def _append(self, room: _Room, queued: Queued) -> None:
        room.waiting.append((self._n_taken_in, queued))
        self._n_taken_in += 1
        self._filled.set()


class _Room:
    """Hold the events of one kind, each with its place in the order in which all came.

    dropped: name of the counter of those that found no room.
    """

    def __init__(self, dropped: str, max_events: int) -> None:
        self.dropped = dropped
        self.waiting: deque[tuple[int, Queued]] = deque()
        self._max_events = max_events

    @property
    def is_full(self) -> bool:
        return len(self.waiting) >= self._max_events
