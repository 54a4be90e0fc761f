"""Separate time stamps that tie.

Loggers stamp pings with a clock of 10 ms or even 1 s, so that several pings may carry one time. Recorded times are kept
as they are (their jitter of a tick is centimetres of vehicle motion); only pings that tie are spread evenly up to the
next time stamp.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Final, Protocol, TypeVar

MAX_TIED: Final = 64  # more than this at one time: the clock stands still, pings are timed by their interval
_MAX_STEP_S: Final = 2.0  # s between pings: a longer one is a hole, over which times are not spread
_FALLBACK_INTERVAL_S: Final = 0.1  # s between pings of equal time, where nothing shows the rate


class TimedPing(Protocol):
    """Have a time and an interval to the ping before."""

    @property
    def time_s(self) -> float:
        """Return UTC seconds since 1970."""

    @property
    def interval_s(self) -> float:
        """Return the seconds since the ping before."""


T = TypeVar("T", bound=TimedPing)


def spread_ties(items: Iterable[T], counters: Counter[str]) -> Iterator[tuple[float, T]]:
    """Pair each item with its transmit time; ties become strictly increasing. Time going backwards is left as it is.

    An item's `interval_s` is the recorder's own time between pings, used where no later time stamp follows; NaN or 0 if
    unknown. Counts reader.time_tied, reader.clock_stuck and reader.time_backwards. Holds at most MAX_TIED items.
    """
    group: list[T] = []
    stuck_at: float | None = None
    running = 0.0
    last_step = math.nan
    previous = -math.inf
    for item in items:
        if stuck_at is not None:
            if item.time_s == stuck_at:
                counters["reader.clock_stuck"] += 1
                running += _step(item, last_step)
                previous = running
                yield running, item
                continue
            stuck_at = None
        if group and item.time_s != group[0].time_s:
            gap = item.time_s - group[0].time_s
            step = gap / len(group) if 0.0 < gap <= _MAX_STEP_S else _step(group[0], last_step)
            if 0.0 < gap <= _MAX_STEP_S:
                last_step = step
            previous = group[0].time_s + step * (len(group) - 1)
            yield from _spread(group, step, counters)
            group = []
        if not group and item.time_s < previous:
            counters["reader.time_backwards"] += 1
        group.append(item)
        if len(group) == MAX_TIED:
            step = _step(item, last_step)
            stuck_at = item.time_s
            running = previous = stuck_at + step * (MAX_TIED - 1)
            yield from _spread(group, step, counters)
            group = []
    if group:
        yield from _spread(group, _step(group[0], last_step), counters)


def _spread(group: list[T], step: float, counters: Counter[str]) -> Iterator[tuple[float, T]]:
    if len(group) > 1:
        counters["reader.time_tied"] += len(group) - 1
    for index, item in enumerate(group):
        yield item.time_s + index * step, item


def _step(item: TimedPing, last_step: float) -> float:
    for candidate in (last_step, item.interval_s):
        if 0.0 < candidate <= _MAX_STEP_S:
            return candidate
    return _FALLBACK_INTERVAL_S
