"""Hold time-ordered values of one quantity, and read them between and beyond their samples."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import NAN

CLOCK_S: Final = 1e-6  # s: float64 UTC seconds resolve 0.24 microseconds; limits hold to this
_ROOM: Final = 128  # values there is room for at first, and that are gathered at once


class Limits(NamedTuple):
    """Set how values are read between and beyond its samples; seconds."""

    bridge_s: float  # interpolate between neighbours at most this far apart
    fresh_s: float  # elsewhere the nearest sample's value counts as fresh this long
    look_ahead_s: float  # a later sample may lend its value this far back, no farther, so that waiting for it ends


class Values(NamedTuple):
    """Hold values of instants.

    values: (n, width), NaN where not known; fresh: (n,); age_s: (n,) to the nearest value, inf without one.
    """

    values: NDArray[np.float64]
    fresh: NDArray[np.bool_]
    age_s: NDArray[np.float64]


class Holes(NamedTuple):
    """Hold instants between values too far apart to interpolate: their rows, and the times and values of both.

    joined: may a line lead from one to the other?
    """

    rows: NDArray[np.intp]
    left_s: NDArray[np.float64]
    right_s: NDArray[np.float64]
    left: NDArray[np.float64]
    right: NDArray[np.float64]
    joined: NDArray[np.bool_]


class TimedValues:
    """Hold time-ordered values of one quantity; grow at the end, drop at the start.

    last_s: time of the newest value, -inf without one.
    """

    def __init__(self, limits: Limits, width: int = 1) -> None:
        """Start without a value; width: numbers of each."""
        self.limits = limits
        self._times = np.empty(_ROOM)
        self._values = np.empty((_ROOM, width))
        self._joined = np.empty(_ROOM, dtype=np.bool_)
        # values not in the arrays yet: adding them one by one costs more
        self._new: list[tuple[float, float | tuple[float, ...], bool]] = []
        self.clear()

    def clear(self) -> None:
        """Forget all values."""
        self._start = self._stop = 0
        self._new.clear()
        self.last_s = -math.inf
        self._hole_end_s = math.inf  # of the newest hole too long to bridge; the time before the first sample is one

    def append(self, time_s: float, value: float | tuple[float, ...], joined: bool = True) -> None:
        """Add a value later than all others; `joined` is False if no line may lead to it from its predecessor."""
        self._new.append((time_s, value, joined))
        if len(self._new) == _ROOM:
            self._gather()
        if time_s - self.last_s > self.limits.bridge_s:
            self._hole_end_s = time_s
        self.last_s = time_s

    def final_until(self, next_s: float) -> float:
        """Give the time up to which no value at `next_s` or later can change the result of `at`."""
        return max(self.last_s, next_s - self.limits.look_ahead_s - 2 * CLOCK_S)

    def has_hole(self, from_s: float, newest_s: float) -> bool:
        """Check whether any instant from `from_s` to `newest_s` is not between values close enough to interpolate."""
        return newest_s - self.last_s > self.limits.bridge_s or from_s < self._hole_end_s

    def before_hole(self, time_s: float) -> float:
        """Give the time of the value before the hole that an instant is in, or the instant where it is in none."""
        if time_s >= self._hole_end_s or math.isinf(self._hole_end_s):
            return time_s
        self._gather()
        right = self._start + int(np.searchsorted(self._times[self._start : self._stop], time_s, side="right"))
        if right == self._start or right == self._stop:
            return time_s
        left_s, right_s = self._times[right - 1 : right + 1].tolist()
        return float(left_s) if right_s - left_s > self.limits.bridge_s + CLOCK_S and self._joined[right] else time_s

    def at(self, times: NDArray[np.float64]) -> Values:
        """Give the values at instants, (n,): interpolated, else of the nearest sample."""
        self._gather()
        limits = self.limits
        known_s = self._times[self._start : self._stop]
        known = self._values[self._start : self._stop]
        if known_s.size == 0:
            return Values(
                np.full((times.size, known.shape[1]), NAN),
                np.zeros(times.size, dtype=np.bool_),
                np.full(times.size, np.inf),
            )
        last = known_s.size - 1
        right = known_s.searchsorted(times, side="right")
        if times.size and right.max() <= last and right.min() > 0:
            # Between two values everywhere, as a rule close enough to each other.
            left = right - 1
            left_s, right_s = known_s[left], known_s[right]
            span = right_s - left_s
            if span.max() <= limits.bridge_s + CLOCK_S and self._joined[self._start + right].all():
                since, low = times - left_s, known.take(left, axis=0)
                values = low + (since / span)[:, np.newaxis] * (known.take(right, axis=0) - low)
                return Values(values, np.ones(times.size, dtype=np.bool_), np.minimum(since, right_s - times))
        has_left, has_right = right > 0, right <= last
        left, right = np.maximum(right - 1, 0), np.minimum(right, last)
        left_s, right_s = known_s[left], known_s[right]
        since, until, span = np.where(has_left, times - left_s, np.inf), right_s - times, right_s - left_s
        until = np.where(has_right & (until <= limits.look_ahead_s + CLOCK_S), until, np.inf)
        bridged = (
            np.isfinite(since)
            & np.isfinite(until)
            & (span <= limits.bridge_s + CLOCK_S)
            & self._joined[self._start + right]
        )
        distance = np.minimum(since, until)
        values = known.take(np.where(until < since, right, left), axis=0)
        values[~np.isfinite(distance)] = NAN
        low = known.take(left[bridged], axis=0)
        share = since[bridged] / span[bridged]
        values[bridged] = low + share[:, np.newaxis] * (known.take(right[bridged], axis=0) - low)
        return Values(values, bridged | (distance <= limits.fresh_s + CLOCK_S), distance)

    def at_one(self, time_s: float) -> tuple[float, ...]:
        """Give the values at one instant, NaN where none is fresh.

        They are those of `at`, in a tenth of its time between two values or at the newest.
        """
        if self._new and time_s == self.last_s and isinstance(newest := self._new[-1][1], tuple):
            return newest
        self._gather()
        start, stop = self._start, self._stop
        right = start + int(np.searchsorted(self._times[start:stop], time_s, side="right"))
        if right == stop > start and time_s == self.last_s:
            return tuple(self._values[stop - 1].tolist())
        if start < right < stop and self._joined[right]:
            left_s, right_s = self._times[right - 1 : right + 1].tolist()
            if right_s - left_s <= self.limits.bridge_s + CLOCK_S:
                share = (time_s - left_s) / (right_s - left_s)
                left, after = self._values[right - 1 : right + 1].tolist()
                return tuple(one + share * (other - one) for one, other in zip(left, after, strict=True))
        found = self.at(np.array([time_s]))
        return tuple(np.where(found.fresh[0], found.values[0], NAN).tolist())

    @property
    def first_s(self) -> float:
        """Give the time of the oldest value that is kept; inf without one."""
        self._gather()
        return float(self._times[self._start]) if self._stop > self._start else math.inf

    def holes(self, times: NDArray[np.float64]) -> Holes | None:
        """Find the instants in holes too long to interpolate whose value is not the later one; None without any."""
        self._gather()
        known_s = self._times[self._start : self._stop]
        right = np.searchsorted(known_s, times, side="right")
        rows = np.flatnonzero((right > 0) & (right < known_s.size))
        right = right[rows]
        left_s, right_s, joined = known_s[right - 1], known_s[right], self._joined[self._start + right]
        until_s = right_s - times[rows]
        at_later = (until_s < times[rows] - left_s) & (until_s <= self.limits.look_ahead_s + CLOCK_S)
        is_hole = (right_s - left_s > self.limits.bridge_s + CLOCK_S) & (joined | ~at_later)
        if not is_hole.any():
            return None
        known = self._values[self._start : self._stop]
        left, later = known[right[is_hole] - 1], known[right[is_hole]]
        return Holes(rows[is_hole], left_s[is_hole], right_s[is_hole], left, later, joined[is_hole])

    def forget_before(self, time_s: float) -> None:
        """Keep the last sample at or before `time_s`, as left neighbour, and all later ones."""
        self._gather()
        known_s = self._times[self._start : self._stop]
        self._start += max(0, int(np.searchsorted(known_s, time_s, side="right")) - 1)

    def _gather(self) -> None:
        """Put new values into the arrays."""
        if not self._new:
            return
        times, values, joined = zip(*self._new, strict=True)
        n_new = len(times)
        if self._stop + n_new > self._times.shape[0]:
            self._make_room(n_new)
        rows = slice(self._stop, self._stop + n_new)
        self._times[rows], self._joined[rows] = times, joined
        self._values[rows] = np.array(values).reshape(n_new, -1)
        self._stop += n_new
        self._new.clear()

    def _make_room(self, n_new: int) -> None:
        """Drop the forgotten; double the room if the rest needs it."""
        kept = slice(self._start, self._stop)
        count = self._stop - self._start
        room = max(_ROOM, 2 * (count + n_new))
        times, values, joined = np.empty(room), np.empty((room, self._values.shape[1])), np.empty(room, dtype=np.bool_)
        times[:count], values[:count], joined[:count] = self._times[kept], self._values[kept], self._joined[kept]
        self._times, self._values, self._joined = times, values, joined
        self._start, self._stop = 0, count


def measured_or_derived(
    measured: TimedValues, derived: TimedValues, is_off: NDArray[np.bool_], times: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Give fresh measured values, else fresh derived ones, else the nearest known; which are fresh; which derived.

    Parameters
    ----------
    measured, derived
        Of one quantity.
    is_off
        Where measured values do not count if there are derived ones, (n,).
    times
        Of the instants, (n,).
    """
    first = measured.at(times)
    if first.fresh.all() and not is_off.any():
        return first.values[:, 0], first.fresh, np.zeros(times.shape, dtype=np.bool_)
    second = derived.at(times)
    use_derived = ~first.fresh & (second.fresh | np.isnan(first.values[:, 0]))
    use_derived |= is_off & ~np.isnan(second.values[:, 0])
    values = np.where(use_derived, second.values[:, 0], first.values[:, 0])
    return values, (first.fresh & ~is_off) | second.fresh, use_derived & ~np.isnan(values)
