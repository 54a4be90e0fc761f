"""Put the records of a log in order of time, which recorders keep only roughly."""

from __future__ import annotations

import heapq
from collections import Counter
from typing import Any, Final, Generic, Protocol, Self, TypeVar

from auv_mcm.clock import Stamp

PAUSE_S: Final = 10.0  # a longer one is a break: what was known of clocks and navigation no longer holds
_SLACK_NS: Final = 1_000_000_000  # recorders write what came within a second in any order
_PAUSE_NS: Final = round(PAUSE_S * 1e9)
_MAX_HELD: Final = 256  # messages; several seconds of a side-scan's, and the bound where a clock stands still


class Stamped(Protocol):
    """Have a stamp that can be replaced, as named tuples do."""

    @property
    def stamp(self) -> Stamp:
        """Return the time of it."""

    def _replace(self, *args: Any, **kwargs: Any) -> Self: ...


M = TypeVar("M", bound=Stamped)


class TimeOrder(Generic[M]):
    """Sort messages by their stamps within a second.

    One whose time is far from those before it is believed only if the next one agrees: formats without a checksum hold
    damaged times. Counts reader.time_outlier (left out), reader.time_backwards and reader.pause (where two agreed on
    another time).
    """

    def __init__(self, counters: Counter[str]) -> None:
        self._counters = counters
        self._held: list[tuple[int, int, M]] = []
        self._n_held = 0
        self._newest_ns: int | None = None
        self._released_ns = 0
        self._suspect: M | None = None

    def add(self, recorded: M) -> list[M]:
        """Take a message in the order of the log; return those that none can precede any more."""
        time_ns = recorded.stamp.mono_ns
        suspect = self._suspect
        if self._newest_ns is not None and _is_near(time_ns, self._newest_ns):
            self._drop_suspect()
            return self._put(recorded)
        if suspect is None or not _is_near(time_ns, suspect.stamp.mono_ns):
            self._drop_suspect()
            self._suspect = recorded
            return []
        self._suspect = None
        released = self._release_all()
        if self._newest_ns is not None:
            self._counters["reader.time_backwards" if time_ns < self._newest_ns else "reader.pause"] += 1
        self._newest_ns, self._released_ns = None, 0
        return released + self._put(suspect) + self._put(recorded)

    def finish(self) -> list[M]:
        """Release what is held: the log is at its end."""
        released = self._release_all()
        if self._newest_ns is None and self._suspect is not None:
            return [*released, self._suspect]
        self._drop_suspect()
        return released

    def _drop_suspect(self) -> None:
        if self._suspect is not None:
            self._counters["reader.time_outlier"] += 1
            self._suspect = None

    def _put(self, recorded: M) -> list[M]:
        time_ns = recorded.stamp.mono_ns
        self._newest_ns = time_ns if self._newest_ns is None else max(self._newest_ns, time_ns)
        heapq.heappush(self._held, (time_ns, self._n_held, recorded))
        self._n_held += 1
        released = []
        while self._held[0][0] < self._newest_ns - _SLACK_NS or len(self._held) > _MAX_HELD:
            released.append(self._pop())
        return released

    def _release_all(self) -> list[M]:
        return [self._pop() for _ in range(len(self._held))]

    def _pop(self) -> M:
        time_ns, _, recorded = heapq.heappop(self._held)
        self._released_ns = max(time_ns, self._released_ns)
        return recorded._replace(stamp=Stamp(self._released_ns, self._released_ns))


def _is_near(time_ns: int, other_ns: int) -> bool:
    return -_SLACK_NS <= time_ns - other_ns <= _PAUSE_NS
