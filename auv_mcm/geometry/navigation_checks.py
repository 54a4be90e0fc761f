"""Find navigation that is plausible sample by sample and wrong as a whole.

Examples are a compass mounted askew and an altitude without a sea floor.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.bridging import MAX_HOLE_S
from auv_mcm.geometry.track_speed import MIN_SPEED_MPS

# Courses come from chords of 2 m or more, so that 25 of them are at least 50 m of track.
_N_CHORDS: Final = 25
# A vehicle crabs by asin(cross current / speed): 60 degrees needs a current of 0.87 of its speed, in which no survey
# line is held.
_MAX_OFFSET_RAD: Final = math.radians(60.0)
# One number in every sample is no compass's: off a course by more than a current makes it, it is worth a look.
_MAX_STILL_OFFSET_RAD: Final = math.radians(15.0)
# of the unit vectors of the differences: a circular standard deviation of 26 degrees; turns scatter more
_MIN_RESULTANT: Final = 0.9

_MIN_PINGS: Final = 100  # pings before a verdict
_MIN_PINGS_AT_END: Final = 20  # of a short mission
_MIN_SHARE_BEYOND: Final = 0.5  # of the pings: more than half

ZERO_ALTITUDES: Final = 20
"""Altitudes of exactly 0 in a row that are reported: a bottom lock that is lost for a ping or two is not."""


CROSS_CURRENT_MPS: Final = 0.25
"""1-sigma of the current across the track: 0.14, 0.23 and 0.35 by compass and course of three recorded lines."""


def crab_sigma_rad(speed_mps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the 1-sigma between heading and course, rad (n,), at speeds over ground, m/s (n,); NaN counts as 0."""
    return np.asarray(np.arctan2(CROSS_CURRENT_MPS, np.nan_to_num(np.abs(speed_mps))))


class HeadingCheck:
    """Compare the measured heading with the course over ground, chord by chord."""

    def __init__(self) -> None:
        self._differences: deque[complex] = deque(maxlen=_N_CHORDS)
        self._headings: deque[float] = deque(maxlen=_N_CHORDS)

    def add(self, heading_rad: float, course_rad: float) -> float | None:
        """Take one chord, and find how far heading is steadily off the course.

        Returns radians in (-pi, pi], None unless the angle is steady and large; one that is not so large counts where
        the heading is the same number all the time.
        """
        self._headings.append(heading_rad)
        self._differences.append(cmath.rect(1.0, heading_rad - course_rad))
        if len(self._differences) < _N_CHORDS:
            return None
        mean = sum(self._differences) / _N_CHORDS
        offset_rad = cmath.phase(mean)
        stands_still = min(self._headings) == max(self._headings)
        limit_rad = _MAX_STILL_OFFSET_RAD if stands_still else _MAX_OFFSET_RAD
        return offset_rad if abs(mean) >= _MIN_RESULTANT and abs(offset_rad) > limit_rad else None


MAX_ZERO_OFFSET_DEG: Final = 5.0
"""Between a heading of 0 in every sample and the course, degrees: a compass never reads exactly 0 for long."""
_MIN_ZERO_HEADINGS: Final = 20  # before a verdict: a compass in steps of a degree may read 0 for a second
_ZERO_CHORDS: Final = 3  # newest chords, 6 m or more, whose mean course is compared
_ZERO_WAY_M: Final = 6.0  # m: one chord as long, between fixes that come seldom, serves as well


class ZeroHeadingCheck:
    """Find a heading that is 0 in every sample although the vehicle goes elsewhere: a field that was never filled."""

    def __init__(self) -> None:
        self._n_zeros = 0
        self._is_filled = False
        self._courses: deque[complex] = deque(maxlen=_ZERO_CHORDS)

    @property
    def is_all_zero(self) -> bool:
        """Check whether there were headings, all of them 0."""
        return self._n_zeros > 0 and not self._is_filled

    def add(self, heading_rad: float) -> bool:
        """Take a heading; return whether all were 0 until now."""
        self._is_filled = self._is_filled or math.remainder(heading_rad, math.tau) != 0.0
        self._n_zeros += not self._is_filled
        return not self._is_filled

    def off_course_deg(self, course_rad: float, way_m: float) -> float | None:
        """Take a chord's course and length; return the mean course where it can be compared with a heading of 0."""
        self._courses.append(cmath.rect(1.0, course_rad))
        if self._is_filled or self._n_zeros < _MIN_ZERO_HEADINGS:
            return None
        if len(self._courses) < _ZERO_CHORDS and way_m < _ZERO_WAY_M:
            return None
        return math.degrees(cmath.phase(sum(self._courses)))


_MIN_ROUNDED: Final = 4  # more changes of latitude or longitude alone than of both: a recorder's steps are that coarse


class HeldPositionCheck:
    """Find positions that a recorder repeats until the next fix, while the vehicle goes on.

    Coarse steps of latitude and longitude repeat as well, but one changes without the other: those are kept, since the
    first of equal positions is as rough as the others.
    """

    def __init__(self) -> None:
        self._last = (math.nan, math.nan)
        self._last_s = -math.inf
        self._n_rounded = 0

    def add(self, time_s: float, latitude_deg: float, longitude_deg: float, speed_mps: float) -> bool:
        """Take a position with the measured speed; return whether it repeats the one before."""
        n_same = (latitude_deg == self._last[0]) + (longitude_deg == self._last[1])
        is_moving = abs(speed_mps) >= MIN_SPEED_MPS and time_s - self._last_s <= MAX_HOLE_S
        if n_same == 2 and is_moving and self._n_rounded < _MIN_ROUNDED:
            return True
        if n_same < 2:
            self._n_rounded = min(max(self._n_rounded + (1 if n_same else -1), 0), 2 * _MIN_ROUNDED)
        self._last, self._last_s = (latitude_deg, longitude_deg), time_s
        return False


class AltitudeCheck:
    """Compare the measured altitude with the range of the sonar, ping by ping."""

    def __init__(self) -> None:
        self._n_pings = 0
        self._n_beyond = 0

    def add(self, n_pings: int, n_beyond: int) -> None:
        """Take so many pings with a measured altitude, of which n_beyond are higher than the sonar ranges."""
        self._n_pings += n_pings
        self._n_beyond += n_beyond

    def is_beyond_range(self, *, at_end: bool) -> bool:
        """Check whether most pings so far have an altitude beyond the range.

        Not from few pings, unless no more will come.
        """
        return (
            self._n_pings >= (_MIN_PINGS_AT_END if at_end else _MIN_PINGS)
            and self._n_beyond > _MIN_SHARE_BEYOND * self._n_pings
        )
