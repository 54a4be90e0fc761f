"""Find out that pitch has the wrong sign: a vehicle under way rises with its bow up, and sinks with it down."""

from __future__ import annotations

import math
from typing import Final

from auv_mcm.records import NavSample, Notice

_CLIMB_M: Final = 2.0  # between two looks: waves from astern, which lift less, press the bow down meanwhile
_LONGEST_S: Final = 60.0  # that such a climb may take: of one that takes longer the path is as good as level
_MAX_STEP_S: Final = 1.5  # between samples; the way across a longer gap is not known
_LOWEST_RAD: Final = math.radians(3.0)  # of the path: trim and waves give pitch on a level one
_STEEPEST_RAD: Final = math.radians(45.0)  # steeper is lifted or sinks, without way ahead
_MIN_CLIMBS: Final = 4  # each way
_TURNED: Final = -0.5  # pitch by angle of the path: 1 where the sign is right, -1 where it is turned, 0 who hovers


class PitchWatch:
    """Compare the pitch with the path, climb by climb."""

    def __init__(self) -> None:
        self._last_s = math.nan
        self._pitch_rad = self._speed_mps = math.nan
        self._depth_m = math.nan  # where the climb began
        self._lasted_s = self._way_m = self._pitch_rad_s = 0.0  # since then
        self._sums = {True: [0, 0.0, 0.0], False: [0, 0.0, 0.0]}  # up and down: climbs, pitch and path, rad

    def add(self, sample: NavSample) -> list[Notice]:
        """Take a sample; return the notice that it raises, again with each climb."""
        step_s, self._last_s = sample.time_s - self._last_s, sample.time_s
        if 0.0 <= step_s <= _MAX_STEP_S:
            self._lasted_s += step_s
            self._way_m += step_s * self._speed_mps
            self._pitch_rad_s += step_s * self._pitch_rad
        else:
            self._depth_m = math.nan
        if math.isfinite(sample.speed_mps):
            self._speed_mps = sample.speed_mps
        if math.isfinite(sample.pitch_rad):
            self._pitch_rad = sample.pitch_rad
        return self._look(sample.depth_m) if math.isfinite(sample.depth_m) else []

    def _look(self, depth_m: float) -> list[Notice]:
        climb_m = self._depth_m - depth_m
        if abs(climb_m) < _CLIMB_M and self._lasted_s <= _LONGEST_S:
            return []
        path_rad = math.atan2(climb_m, self._way_m)
        pitch_rad = self._pitch_rad_s / self._lasted_s if self._lasted_s else math.nan
        self._depth_m, self._lasted_s, self._way_m, self._pitch_rad_s = depth_m, 0.0, 0.0, 0.0
        if not (_LOWEST_RAD <= abs(path_rad) <= _STEEPEST_RAD and math.isfinite(pitch_rad)):
            return []
        sums = self._sums[path_rad > 0.0]
        sums[0], sums[1], sums[2] = sums[0] + 1, sums[1] + pitch_rad, sums[2] + path_rad
        return self._judge()

    def _judge(self) -> list[Notice]:
        (n_up, up_rad, rise_rad), (n_down, down_rad, fall_rad) = self._sums[True], self._sums[False]
        if min(n_up, n_down) < _MIN_CLIMBS:
            return []
        change_rad = up_rad / n_up - down_rad / n_down
        if change_rad > _TURNED * (rise_rad / n_up - fall_rad / n_down):
            return []
        text = (
            f"pitch is {math.degrees(-change_rad):.0f} degrees lower where the vehicle rises than where it sinks: its "
            "sign is turned, and contacts lie off along the track by twice the altitude times the pitch. Set "
            "pitch_sign of the unit to the other sign."
        )
        return [Notice(code="navigation.pitch_turned", text=text)]
