"""Watch navigation for what is plausible sample by sample and cannot go on so: a person is asked to look.

It changes no pose and rejects nothing; it sees every sample as it comes, live and in a replay.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from auv_mcm.geometry.fix import Fix, chord_m, course_rad, fix_at
from auv_mcm.geometry.pitch_watch import PitchWatch
from auv_mcm.records import NavSample, Notice

_CHORD_M: Final = 2.0  # as of course made good: well above the rounding of fixes
_MAX_CHORD_S: Final = 10.0  # a vehicle slower than this, or fixes farther apart, give no course
_N_CHORDS: Final = 20  # 40 m of track
_TURNED_RAD: Final = math.radians(40.0)
"""Change of heading against the course over `_N_CHORDS` that is reported. Fixes that scatter by 0.2 m turn chords by
8 degrees, and a line through 20 of them by 6 from end to end: one in 10^10 by chance. A current that turned a vehicle
so far on a straight line within 40 m would have to change by two thirds of its speed."""
_STRAIGHT_RAD: Final = math.radians(15.0)  # of the course over as many chords: in a turn the current's side changes
_SCATTER_RAD: Final = math.radians(12.0)  # RMS about the line: more is no drift
_COURSE_SCATTER_RAD: Final = math.radians(8.0)
"""RMS of `_N_COURSES` courses over `_CHORD_M` about a straight line that is reported where no heading is known: a
contact at a range of 10 m may lie 1 m off. Fixes that scatter by 0.2 m give as much, by 0.1 m once in 10^4."""
_N_COURSES: Final = 10  # 20 m of track
_STILL_M: Final = 0.05  # fixes this near are one; receivers give 0.01 to 0.1 m, and drift more
_STILL_S: Final = 12.0  # a unit that gives a fix every 10 s repeats it no longer
_STILL_WAY_M: Final = 25.0  # reported way meanwhile: five times the error of a usual acoustic fix
_IN_A_ROW: Final = 20  # samples, as for altitudes of 0
_ABOVE_SURFACE_M: Final = 5.0  # depth of less than minus this: tide and a cell's offset are smaller
_TURN_RAD: Final = math.radians(361.0)  # as of the buffer, which refuses more
_LEAP_S: Final = 60.0  # as of the buffer: less is a pause
_MOVING_MPS: Final = 0.5  # reported speed; slower, a vehicle may have waited where it is
_STEP_S: Final = 10.0  # s: of the way made while time leapt, as between two fixes; who paused goes on elsewhere


class _Moment(NamedTuple):
    fix: Fix
    speed_mps: float
    heading_rad: float


def _scattered_course(courses_rad: Sequence[float]) -> list[Notice]:
    """Raise a notice where courses scatter about a nearly straight line too far to stand for a heading."""
    change_rad, scatter_rad = _line(tuple(courses_rad))
    if scatter_rad <= _COURSE_SCATTER_RAD or abs(change_rad) > _STRAIGHT_RAD + 2.0 * scatter_rad:
        return []
    text = (
        "no heading is known, and positions scatter so that the course, which stands for it, is off by "
        f"{math.degrees(scatter_rad):.0f} degrees: contacts lie off along the track by that share of their range. "
        "Connect a compass or gyro, or give smoother positions."
    )
    return [Notice(code="navigation.course_scattered", text=text)]


class NavigationWatch:
    """Raise notices about navigation that cannot go on so, each once in a mission.

    A heading that drifts away from the course, no heading with fixes that scatter, a position that stands still at a
    reported speed, a time that leaps ahead while the vehicle went on, altitudes below 0, depths above the surface,
    headings of more than a turn, and a pitch of the wrong sign.
    """

    def __init__(self) -> None:
        self._raised: set[str] = set()
        self._heading_rad = math.nan
        self._heading_s = -math.inf
        self._speed_mps = math.nan
        self._chord_start: tuple[Fix, complex] | None = None  # and the sum of headings since then, as unit vectors
        # course, heading less course (NaN where there is none); unwrapped
        self._chords: deque[tuple[float, float]] = deque(maxlen=_N_CHORDS)
        self._still_since: Fix | None = None
        self._still_way_m = 0.0
        self._last_s = math.nan
        self._last: _Moment | None = None
        self._before_leap: _Moment | None = None
        self._n_below = {"altitude": 0, "depth": 0, "heading": 0}
        self._pitch = PitchWatch()

    def add(self, sample: NavSample) -> list[Notice]:
        """Take a sample; return the notices that it raises."""
        if not math.isfinite(sample.time_s):
            return []
        found = self._check_vertical(sample) + self._pitch.add(sample)
        if math.isfinite(sample.speed_mps):
            self._speed_mps = abs(sample.speed_mps)
        # Between samples of any kind: positions come more seldom than what a merge gives beside them.
        step_s = min(max(sample.time_s - self._last_s, 0.0), 1.0)
        self._still_way_m += step_s * self._speed_mps if math.isfinite(step_s * self._speed_mps) else 0.0
        self._last_s = sample.time_s
        if math.isfinite(sample.heading_rad):
            self._heading_rad, self._heading_s = sample.heading_rad, sample.time_s
            if self._chord_start is not None:
                fix, headings = self._chord_start
                self._chord_start = fix, headings + cmath.rect(1.0, sample.heading_rad)
        has_position = (
            abs(sample.latitude_deg) <= 90.0
            and abs(sample.longitude_deg) <= 360.0
            and (sample.latitude_deg, sample.longitude_deg) != (0.0, 0.0)
            and not sample.position_leaps
        )
        if has_position:
            fix = fix_at(sample.time_s, sample.latitude_deg, sample.longitude_deg)
            found += self._check_leap(fix) + self._check_heading(fix) + self._check_still(fix)
        return [notice for notice in found if not self._was_raised(notice.code)]

    def _was_raised(self, code: str) -> bool:
        was_raised = code in self._raised
        self._raised.add(code)
        return was_raised

    def _check_vertical(self, sample: NavSample) -> list[Notice]:
        found = []
        if self._is_below("altitude", sample.altitude_m, 0.0):
            text = (
                f"altitude was below 0 in {_IN_A_ROW} samples in a row, the last {sample.altitude_m:.1f} m, and counts "
                "as unknown: the sea floor is found from the echoes alone. Check the altimeter's sign, unit and offset."
            )
            found.append(Notice(code="navigation.altitude_negative", text=text))
        if self._is_below("depth", sample.depth_m, -_ABOVE_SURFACE_M):
            text = (
                f"depth was above the surface in {_IN_A_ROW} samples in a row, the last {sample.depth_m:.1f} m: depths "
                "of contacts are wrong by as much. Check the depth cell's sign, unit and offset."
            )
            found.append(Notice(code="navigation.depth_negative", text=text))
        if self._is_below("heading", -abs(sample.heading_rad), -_TURN_RAD):
            text = (
                f"heading was more than a turn in {_IN_A_ROW} samples in a row, the last "
                f"{math.degrees(sample.heading_rad):.0f} degrees, and counts as unknown: the course stands for it. "
                "Check its unit and offset."
            )
            found.append(Notice(code="navigation.heading_impossible", text=text))
        return found

    def _is_below(self, name: str, value: float, low: float) -> bool:
        """Check whether this is the last of so many values in a row below a limit; NaN is none."""
        if math.isfinite(value):
            self._n_below[name] = self._n_below[name] + 1 if value < low else 0
        return math.isfinite(value) and self._n_below[name] == _IN_A_ROW

    def _check_heading(self, fix: Fix) -> list[Notice]:
        start = self._chord_start
        headings = cmath.rect(1.0, self._heading_rad) if fix.time_s - self._heading_s <= _MAX_CHORD_S else 0j
        if start is None or not 0.0 <= fix.time_s - start[0].time_s <= _MAX_CHORD_S:
            self._chords.clear()
            self._chord_start = (fix, headings)
            return []
        if chord_m(start[0], fix) < _CHORD_M:
            return []
        self._chord_start = (fix, headings)
        course = course_rad(start[0], fix)
        off = cmath.phase(start[1]) - course if start[1] else math.nan
        if self._chords and math.isnan(off) != math.isnan(self._chords[-1][1]):
            self._chords.clear()  # a compass that comes or goes has not turned
        if self._chords:
            course, off = _unwrapped(course, self._chords[-1][0]), _unwrapped(off, self._chords[-1][1])
        self._chords.append((course, off))
        if math.isnan(off):
            courses = [course for course, _ in self._chords]
            return _scattered_course(courses[-_N_COURSES:]) if len(courses) >= _N_COURSES else []
        if len(self._chords) < _N_CHORDS:
            return []
        courses_rad, offs_rad = zip(*self._chords, strict=True)
        change, scatter = _line(offs_rad)
        if abs(change) < _TURNED_RAD or scatter > _SCATTER_RAD or abs(_line(courses_rad)[0]) > _STRAIGHT_RAD:
            return []
        text = (
            f"heading turned by {math.degrees(abs(change)):.0f} degrees against the course while the track went "
            f"straight on for {_N_CHORDS * _CHORD_M:.0f} m: contacts are placed across a wrong heading from here on. "
            "Check the compass or gyro; heading may be left to the course by not configuring it."
        )
        return [Notice(code="navigation.heading_drifts", text=text)]

    def _check_still(self, fix: Fix) -> list[Notice]:
        since = self._still_since
        if since is None or chord_m(since, fix) > _STILL_M or fix.time_s < since.time_s:
            self._still_since, self._still_way_m = fix, 0.0
            return []
        still_s = fix.time_s - since.time_s
        if still_s < _STILL_S or self._still_way_m < _STILL_WAY_M:
            return []
        text = (
            f"position stands still for {still_s:.0f} s while {self._speed_mps:.1f} m/s are reported, over "
            f"{self._still_way_m:.0f} m: contacts there are placed wrong by as much. Check the positioning unit."
        )
        return [Notice(code="navigation.position_frozen", text=text)]

    def _check_leap(self, fix: Fix) -> list[Notice]:
        last, self._last = self._last, _Moment(fix, self._speed_mps, self._heading_rad)
        before, self._before_leap = self._before_leap, None
        if last is None:
            return []
        if before is None:
            if fix.time_s - last.fix.time_s > _LEAP_S:
                self._before_leap = last  # or one bad stamp: the next fix decides
            return []
        leap_s = last.fix.time_s - before.fix.time_s
        slowest_mps = min(before.speed_mps, self._speed_mps)
        goes_on = 0.0 <= fix.time_s - last.fix.time_s <= _LEAP_S
        if not goes_on or not slowest_mps >= _MOVING_MPS:
            return []
        if chord_m(before.fix, last.fix) > _STEP_S * slowest_mps:
            return []
        if abs(math.remainder(self._heading_rad - before.heading_rad, 2.0 * math.pi)) > _TURNED_RAD:
            return []  # the time went by: it turned, as before the same line back
        text = (
            f"time leapt {leap_s:.0f} s ahead while the vehicle went on by {chord_m(before.fix, last.fix):.0f} m at "
            f"{slowest_mps:.1f} m/s: a clock was set, a time zone changed, or leap seconds were taken for something "
            "else. Contacts carry the times that were logged. Check the recorder's clock."
        )
        return [Notice(code="navigation.time_leapt", text=text)]


def _unwrapped(angle_rad: float, near_rad: float) -> float:
    if math.isnan(angle_rad):
        return angle_rad
    return angle_rad + 2.0 * math.pi * round((near_rad - angle_rad) / (2.0 * math.pi))


def _line(values: tuple[float, ...]) -> tuple[float, float]:
    """Fit a straight line; return its change from end to end and the RMS about it."""
    numbers = np.arange(len(values)) - 0.5 * (len(values) - 1)
    centred = np.array(values) - math.fsum(values) / len(values)
    slope = float(numbers @ centred) / float(numbers @ numbers)
    return slope * (len(values) - 1), float(np.sqrt(np.mean((centred - slope * numbers) ** 2)))
