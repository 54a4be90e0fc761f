"""Sum up what is fed to a pipeline: pings, navigation, time and distance, and the last known pose."""

from __future__ import annotations

import math
from typing import Any, Final

from auv_mcm.geometry.fix import Fix, chord_m, course_rad, fix_at
from auv_mcm.records import NAN, NavSample, Notice, Ping, SourceEvent

# A longer step between two fixes or two pings is a jump, or a hole between logs: neither distance sailed nor time
# surveyed.
MAX_STEP_M: Final = 100.0
MAX_STEP_S: Final = 60.0
_STRIDE_M: Final = 2.0
"""Distance and course are taken over as much, as by `auv-mcm info`: scatter and steps of fixes are no way sailed."""


class Tally:
    """Sum up everything fed to a pipeline, and keep the last pose known, from which a plan of further legs starts."""

    def __init__(self) -> None:
        self.pings = 0
        self.navigation_samples = 0
        self.notices = 0
        self.first_s = NAN
        self.last_s = NAN
        self.duration_s = 0.0
        self._strides_m = 0.0
        self.latitude_deg = NAN
        self.longitude_deg = NAN
        self.heading_rad = NAN
        self._course_rad = NAN
        self._fix: Fix | None = None
        self._stride_from: Fix | None = None
        self._look: tuple[float, ...] = ()  # squint and sides of the ping before
        self._far_s = NAN  # a time beyond a hole, until the next one shows that it is none of a wrong clock
        self._is_seen_again = False  # by a further sub-aperture, or the other side's log, of the same pass

    @property
    def direction_rad(self) -> float:
        """Give the heading, or the course over ground where no heading was ever measured; NaN if neither is known."""
        return self.heading_rad if math.isfinite(self.heading_rad) else self._course_rad

    @property
    def distance_m(self) -> float:
        """Return the distance sailed, m: over whole strides, and to the last fix."""
        if self._fix is None or self._stride_from is None:
            return 0.0
        return self._strides_m + chord_m(self._stride_from, self._fix)

    def add(self, event: SourceEvent) -> None:
        match event:
            case Ping():
                self.pings += 1
                self._add_time(event.time_s, (event.squint_rad, event.port is None, event.starboard is None))
            case NavSample():
                self.navigation_samples += 1
                self._add_position(event)
            case Notice():
                self.notices += 1

    def _add_time(self, time_s: float, look: tuple[float, ...]) -> None:
        if not math.isfinite(time_s):
            return
        if time_s - self.last_s > MAX_STEP_S:
            before_s, self._far_s = self._far_s, time_s
            if not 0.0 < abs(time_s - before_s) <= MAX_STEP_S:
                return
            self.last_s = before_s
        if look != self._look:
            self._is_seen_again = time_s < self.last_s  # NaN at first; of one time, sides come in messages of their own
            self._look = look
        if self._is_seen_again:
            self._is_seen_again = time_s < self.last_s
            return
        if math.isnan(self.first_s):
            self.first_s = time_s
        elif 0.0 < (step_s := time_s - self.last_s) <= MAX_STEP_S:
            self.duration_s += step_s
        self.last_s = time_s

    def _add_position(self, sample: NavSample) -> None:
        if math.isfinite(sample.heading_rad):
            self.heading_rad = sample.heading_rad
        if (
            sample.position_leaps
            or not (math.isfinite(sample.latitude_deg) and math.isfinite(sample.longitude_deg))
            or sample.latitude_deg == sample.longitude_deg == 0
            or abs(sample.latitude_deg) > 90.0
            or not -180.0 <= sample.longitude_deg <= 360.0
        ):
            return
        last, fix = self._fix, fix_at(sample.time_s, sample.latitude_deg, sample.longitude_deg)
        if last is None or self._stride_from is None:
            self._stride_from = fix
        elif chord_m(last, fix) > MAX_STEP_M or not self._is_onward(last, fix):
            self._strides_m, self._stride_from = self.distance_m, fix
        elif stride_m := chord_m(self._stride_from, fix):
            if stride_m >= _STRIDE_M or math.isnan(self._course_rad):
                self._course_rad = course_rad(self._stride_from, fix)
            if stride_m >= _STRIDE_M:
                self._strides_m, self._stride_from = self._strides_m + stride_m, fix
        self._fix = fix
        self.latitude_deg, self.longitude_deg = sample.latitude_deg, sample.longitude_deg

    def _is_onward(self, last: Fix, fix: Fix) -> bool:
        return 0.0 <= fix.time_s - last.time_s <= MAX_STEP_S and not self._is_seen_again

    def state(self) -> dict[str, Any]:
        """Return what `restore` goes on from."""
        return dict(vars(self))

    def restore(self, state: dict[str, Any]) -> None:
        """Go on where another tally was."""
        vars(self).update(state)

    def totals(self) -> dict[str, Any]:
        """Return what was counted, by name."""
        return {
            "pings": self.pings,
            "navigation_samples": self.navigation_samples,
            "duration_s": round(self.duration_s, 3),
            "distance_m": round(self.distance_m, 1),
        }
