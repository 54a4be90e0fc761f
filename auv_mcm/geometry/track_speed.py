"""Find the speed over ground from positions, and compare the measured speed with it.

Speeds come in wrong units, as zeros that were never filled, or through the water. Positions say how fast a vehicle
moves; over a few seconds a straight line through many of them is little disturbed by their scatter.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

import numpy as np

from auv_mcm.geometry.fix import Fix

WINDOW_S: Final = 6.0
"""s of fixes through which a line is laid: 25 fixes that scatter by 1 m give 0.1 m/s; pings wait half of it."""
_MIN_SPAN_S: Final = 4.0  # s of fixes before the first line: 17 fixes that scatter by 0.3 m give 0.06 m/s
_MIN_FORCED_SPAN_S: Final = 0.5  # s, at the end of a log: below it, rounded fixes make any speed
_MIN_FIXES: Final = 3  # a line through two has no scatter that could be judged
_SPACING_S: Final = 0.25  # s between fixes that are kept: bounds the work at high rates
_PERIOD_S: Final = 0.5  # s between lines
_MAX_HOLE_S: Final = 16.0  # s between fixes, beyond which a line says little about the speed between them
MIN_SPEED_MPS: Final = 0.3  # m/s: slower, a vehicle stands, or its position stands still; neither judges a speed
_MAX_SIGMA: Final = 0.1  # of the speed: lines with a larger 1-sigma judge no measured speed
_MIN_STRAIGHTNESS: Final = 0.97  # of the way made, against its chord: an arc of 50 degrees; turns judge no speed
_OFF: Final = math.log(1.2)  # a measured speed further off is not used
_N_SIGMA: Final = 2.0  # of the line's own error, beyond which a difference is not the fixes' scatter
_BACK: Final = math.log(1.1)  # one that comes as near as that is used again
_COMPARED_M: Final = 50.0  # m of way, by the longer of both, over which a difference is reported


class TrackPoint(NamedTuple):
    """Hold a fix, Earth-centred, with the way by heading and measured speed until then, m.

    leg: counts where heading or speed were missing; NaN for what was never measured.
    """

    time_s: float
    x: float
    y: float
    z: float
    east_m: float
    north_m: float
    way_m: float
    leg: float


class SpeedEstimate(NamedTuple):
    """Hold the speed over ground of a line through fixes, and the measured one over the same time; m/s.

    measured_mps: NaN where none was measured. elapsed_s: since the estimate before. is_straight: by the
    heading, if it is known. scatter_m: of the fixes about the line, per axis; NaN of two fixes.
    """

    middle_s: float
    speed_mps: float
    sigma_mps: float
    measured_mps: float
    elapsed_s: float
    is_straight: bool
    scatter_m: float

    @property
    def is_good(self) -> bool:
        """Check whether it may judge a measured speed."""
        return self.is_straight and self.speed_mps >= MIN_SPEED_MPS and self.sigma_mps <= _MAX_SIGMA * self.speed_mps


class TrackSpeed:
    """Lay lines through the newest fixes."""

    def __init__(self) -> None:
        self._points: deque[TrackPoint] = deque()
        self._last_estimate_s = -math.inf

    def earliest_middle_s(self, next_s: float) -> float:
        """Give the earliest middle that a line may have, of which the next fix comes at `next_s` or later."""
        points = self._points
        if not points or next_s - points[-1].time_s > _MAX_HOLE_S:
            return next_s
        return 0.5 * (points[0].time_s + next_s)

    def clear(self) -> None:
        """Forget all fixes."""
        self._points.clear()

    def takes(self, fix: Fix, *, joined: bool) -> bool:
        """Check whether the next fix is to be added, before its way is known."""
        points = self._points
        return not points or not joined or not fix.time_s - points[-1].time_s < _SPACING_S

    def add(self, point: TrackPoint, *, joined: bool) -> SpeedEstimate | None:
        """Take a fix it `takes`; `joined` is False if the vehicle cannot have travelled there from the last one."""
        points, time_s = self._points, point.time_s
        if points and (not joined or time_s - points[-1].time_s > _MAX_HOLE_S):
            points.clear()
        points.append(point)
        while len(points) > _MIN_FIXES and time_s - points[0].time_s > WINDOW_S:
            points.popleft()
        if time_s - points[0].time_s < _MIN_SPAN_S or time_s - self._last_estimate_s < _PERIOD_S:
            return None
        return self._estimate(_MIN_FIXES)

    def at_end(self) -> SpeedEstimate | None:
        """Lay a line through what there is, because a caller cannot wait for more."""
        points = self._points
        if len(points) < 2 or points[-1].time_s - points[0].time_s < _MIN_FORCED_SPAN_S:
            return None
        return self._estimate(2)

    def _estimate(self, min_fixes: int) -> SpeedEstimate | None:
        points = self._points
        if len(points) < min_fixes:
            return None
        start_s, end_s = points[0].time_s, points[-1].time_s
        values = np.array([point[:-1] for point in points])  # all but the leg
        values[:, 0] -= start_s
        values -= values.sum(axis=0) / len(points)
        times = values[:, 0]
        spread = float(times @ times)
        slopes = times @ values[:, 1:] / spread
        residuals = values[:, 1:4] - times[:, np.newaxis] * slopes[:3]
        n_free = len(points) - 2
        sigma_mps = math.sqrt(float((residuals * residuals).sum()) / n_free / spread) if n_free else math.inf
        is_whole = points[0].leg == points[-1].leg
        measured_mps = math.hypot(slopes[3], slopes[4]) if is_whole else float(slopes[5])
        is_straight = not is_whole or measured_mps >= _MIN_STRAIGHTNESS * slopes[5]
        since_s = max(self._last_estimate_s, start_s)
        self._last_estimate_s = end_s
        return SpeedEstimate(
            middle_s=0.5 * (start_s + end_s),
            speed_mps=math.sqrt(slopes[:3] @ slopes[:3]),
            sigma_mps=sigma_mps,
            measured_mps=measured_mps,
            elapsed_s=end_s - since_s,
            is_straight=bool(is_straight),
            scatter_m=sigma_mps * math.sqrt(0.5 * spread) if n_free else math.nan,
        )


class SpeedCheck:
    """Decide whether the measured speed is used, and whether a person should know how far it is off."""

    def __init__(self) -> None:
        self._ways_m: deque[tuple[float, float]] = deque()  # by positions, by the measured speed

    def is_off(self, estimate: SpeedEstimate, was_off: bool) -> bool | None:
        """Judge the measured speed by one estimate; None where it cannot be judged."""
        if not estimate.is_good or math.isnan(estimate.measured_mps):
            return None
        limit = _BACK if was_off else _OFF + _N_SIGMA * estimate.sigma_mps / estimate.speed_mps
        return abs(_log_ratio(estimate.speed_mps, estimate.measured_mps)) > limit

    def reported(self, estimate: SpeedEstimate) -> tuple[float, float] | None:
        """Return both ways, m, by positions and by the measured speed, where they differ by a fifth over 50 m."""
        if not estimate.is_good or math.isnan(estimate.measured_mps):
            return None
        self._ways_m.append((estimate.speed_mps * estimate.elapsed_s, estimate.measured_mps * estimate.elapsed_s))
        by_track_m, measured_m = (sum(ways) for ways in zip(*self._ways_m, strict=True))
        if max(by_track_m, measured_m) < _COMPARED_M:
            return None
        self._ways_m.popleft()
        return (by_track_m, measured_m) if abs(_log_ratio(by_track_m, measured_m)) > _OFF else None


class Verdicts:
    """Hold since when something is so. The first verdict holds for all time before it, too."""

    def __init__(self) -> None:
        self._changes_s: list[float] = []
        self._values: list[bool] = []

    @property
    def is_decided(self) -> bool:
        """Check whether there is a verdict."""
        return bool(self._values)

    @property
    def newest(self) -> bool:
        """Give the newest verdict; False without one."""
        return bool(self._values) and self._values[-1]

    def decide(self, time_s: float, value: bool) -> None:
        """Take a verdict that holds after `time_s`."""
        if self._values and self._values[-1] == value:
            return
        self._changes_s.append(time_s if self._values else -math.inf)
        self._values.append(value)

    def at(self, times: np.ndarray[tuple[int], np.dtype[np.float64]]) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Give the verdict at each instant, (n,)."""
        if not any(self._values):
            return np.zeros(times.shape, dtype=np.bool_)
        held = np.maximum(np.searchsorted(self._changes_s, times, side="left") - 1, 0)
        return np.array(self._values)[held]

    def holds_after(self, time_s: float) -> bool:
        """Check whether it is so at any instant after `time_s`, as far as is decided."""
        if self.newest:
            return True
        return any(
            value and until_s > time_s for value, until_s in zip(self._values, self._changes_s[1:], strict=False)
        )


def _log_ratio(by_track: float, measured: float) -> float:
    """Compare two ways or speeds; of the measured one, less than a hundredth of the other counts as that."""
    return math.log(by_track / max(measured, 0.01 * by_track))
