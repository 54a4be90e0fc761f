"""Turn navigation samples into vehicle poses at ping times.

Each quantity lives in time-ordered values of its own, because sources measure them at different rates. Positions that
contradict each other are settled by `auv_mcm.geometry.fix_agreement`. A pose at a given instant becomes final, that is,
no later sample can change it, up to `NavBuffer.ready_until_s`; a caller that waits for it gets the same poses however
the stream was cut into pieces.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry import navigation_checks as checks
from auv_mcm.geometry.bridging import MAX_HOLE_S, Bridged, Dated, Odometer
from auv_mcm.geometry.fix import Fix, chord_m, course_rad, fix_at, is_corrected, reach_m, way_m
from auv_mcm.geometry.fix_agreement import FixAgreement, FixDecision
from auv_mcm.geometry.geodesy import ecef_to_geodetic
from auv_mcm.geometry.navigation_notices import NavNotices
from auv_mcm.geometry.sample_values import RANGES, values_of
from auv_mcm.geometry.timed_values import CLOCK_S, Limits, TimedValues, measured_or_derived
from auv_mcm.geometry.track_speed import SpeedCheck, SpeedEstimate, TrackPoint, TrackSpeed, Verdicts
from auv_mcm.records import NAN, NavSample, Notice, PoseTrack
from auv_mcm.settings.config import NavigationConfig

# Fixes that contradict the ones before must agree this long until they are accepted: a receiver that was 1 degree off
# for 4 s came back.
# Pings wait 5 s for navigation by default, so the decision comes before they are placed.
AGREE_S: Final = 4.5
DRIFT_MPS: Final = 1.5  # error of a position per second of its age where no speed is known: a survey speed
_REJECTED_WINDOW: Final = 40  # newest decided fixes, of which so many rejected ones raise a notice
_REJECTED_SHARE: Final = 0.2
_MIN_REJECTED: Final = 5
# a time stamp farther ahead waits for a second one, else one bad stamp would silence the source
MAX_TIME_LEAP_S: Final = 60.0
CHORD_M: Final = 2.0  # course and speed come from fixes this far apart, well above the rounding of coarse logs (0.1 m)
_CHORD_PER_SCATTER: Final = 15.0  # chords are so many times the scatter of fixes, which turns a course by 5 degrees
_CHORD_MAX_M: Final = 5.0  # but no longer: over it a vehicle turns
CHORD_MIN_S: Final = 0.5  # and this long apart, so that JUMP_SLACK_M is no great speed
CHORD_MAX_S: Final = 4.0  # a vehicle that covers less than CHORD_M in this time has a speed but no course
# s that pings wait for the next fix where heading and speed go on; more where fixes were seen to be farther apart.
_LEND_S: Final = 4.0
_LEND_FACTOR: Final = 1.25  # of the longest time between fixes seen: it varies
_GIVE_UP_S: Final = 8.0  # s of navigation after which a speed or heading that nothing was compared with is believed
_SPARSE_INSTANTS: Final = 64  # in holes that nothing bridges, before a notice: a fix that is lost once is no habit


class NavBuffer:
    """Hold the vehicle's recent navigation.

    `counters` holds what was rejected or derived: `navigation.time_not_finite`, `.time_backwards`, `.time_repeated`,
    `.time_leap`, `.not_finite`, `.position_zero`, `.zero_with_position`, `.position_repeated`, `.position_jump`,
    `.position_refix`, `.<quantity>_out_of_range`; in instants: `.heading_from_course`, `.speed_from_fixes`; at most
    one: `.pitch_absent`, `.roll_absent`.
    """

    def __init__(self, config: NavigationConfig, raised: set[str] | None = None) -> None:
        """raised: codes of notices that are not raised again, as of the buffer before a clock step; grows."""
        self.counters: Counter[str] = Counter()
        limits = Limits(config.max_gap_s, config.max_extrapolation_s, max(config.max_gap_s, config.max_extrapolation_s))
        # Derived values stand at the middle of a chord, so they are as far apart as chords are long.
        chord_s = CHORD_MAX_S + config.max_gap_s
        chord_limits = Limits(chord_s, chord_s, chord_s)
        # Earth-centred metres, doubt in metres, 1 where the position is disputed, how far back it lends, s
        self._position = TimedValues(limits, width=6)
        self._heading = TimedValues(limits)
        self._pitch, self._roll, self._depth, self._altitude, self._speed = (TimedValues(limits) for _ in range(5))
        self._plain = (self._pitch, self._roll, self._depth, self._altitude, self._speed)
        self._measured = (self._heading, *self._plain)  # in the order of RANGES
        self._course = TimedValues(chord_limits)
        self._track_speed = TimedValues(chord_limits)
        self._way = TimedValues(limits, width=4)  # as WayMade
        self._all = (self._position, *self._measured, self._course, self._track_speed, self._way)
        self._odometer = Odometer(config.max_gap_s)
        self._line = TrackSpeed()
        self._speed_check = SpeedCheck()
        self._speed_is_off = Verdicts()
        self._zero_heading = checks.ZeroHeadingCheck()
        self._heading_is_empty = Verdicts()
        verdicts = self._heading_is_empty, self._speed_is_off
        self._dated = Dated(self._position, self._heading, self._course, *verdicts, self._way)
        self._last_speed_mps = NAN
        self._has_speed = False  # other than zero
        self._new_fixes: list[tuple[Fix, bool]] = []  # accepted, not used for the speed yet; joined to the one before?
        self._chord_m = CHORD_M
        self._shortest_lend_s = max(_LEND_S, limits.look_ahead_s)  # as long as the position waits for a later fix
        self._lend_s = self._shortest_lend_s
        self._n_unbridged = self._n_zero_altitudes = 0  # instants; altitudes in a row
        self._newest_s = self._oldest_s = -math.inf
        self._fix_sigma_m = config.position_sigma_m
        self._last_heading: float | None = None
        self._last_course: float | None = None
        self._leap: NavSample | None = None
        self._agreement = FixAgreement(chord_m, reach_m, AGREE_S)
        self._last_offered_s = -math.inf  # time of the newest position offered, accepted or not
        self._held_position = checks.HeldPositionCheck()
        self._decided: deque[bool] = deque(maxlen=_REJECTED_WINDOW)  # per fix: was it rejected?
        self._steps_s: list[tuple[float, float]] = []  # fixes between which the track steps to another place
        self._heading_check = checks.HeadingCheck()
        self._notices = NavNotices(set() if raised is None else raised)
        self._last_fix: Fix | None = None
        self._chord_start: Fix | None = None

    def add(self, sample: NavSample) -> None:
        """Take one sample. Impossible values are rejected and counted; samples older than the newest one too.

        At equal times quantities that the earlier sample lacked are added; its own stay.
        """
        time_s = sample.time_s
        if not math.isfinite(time_s):
            self.counters["navigation.time_not_finite"] += 1
            return
        if time_s < self._newest_s:
            if self._newest_s - time_s <= MAX_TIME_LEAP_S or self._newest_s > self._oldest_s:
                self.counters["navigation.time_backwards"] += 1
                return
            # The very first stamp was the bad one: no other supports it.
            self.counters["navigation.time_leap"] += 1
            self._restart()
        leap = self._leap
        self._leap = None
        leaps = time_s - self._newest_s > MAX_TIME_LEAP_S and self._oldest_s > -math.inf
        if leap is not None and not (leaps and leap.time_s <= time_s):
            self.counters["navigation.time_leap"] += 1
            leap = None
        if leaps and leap is None:
            self._leap = sample
            return
        if leap is not None:
            self._store(leap)
        self._store(sample)

    def take_notices(self) -> list[Notice]:
        """Take the notices raised since the last call."""
        return self._notices.take()

    def n_steps_before(self, times_s: NDArray[np.float64]) -> NDArray[np.intp]:
        """Count how often the track has stepped to another place before each instant, (n,)."""
        if not self._steps_s:
            return np.zeros(len(times_s), dtype=np.intp)
        before_s, after_s = np.array([*self._steps_s, (np.inf, np.inf)]).T
        n_steps = np.searchsorted(after_s, times_s, side="right")
        # As TimedValues.at has it: between two fixes that are not joined an instant is at the nearer one.
        until_s = after_s[n_steps] - times_s
        at_next = (until_s < times_s - before_s[n_steps]) & (until_s <= self._position.limits.look_ahead_s + CLOCK_S)
        return np.asarray(n_steps + at_next)

    @property
    def span_s(self) -> tuple[float, float]:
        """Give the times of the oldest and the newest sample accepted; both -inf before the first one."""
        return self._oldest_s, self._newest_s

    @property
    def ready_until_s(self) -> float:
        """Give the time up to which poses are final; -inf before the first sample.

        Depends on the samples alone. It may step back when a hole shows up in heading or speed; what was final stays
        so.
        """
        newest_s = self._newest_s
        next_fix_s = min(newest_s, self._agreement.waiting_since_s)  # fixes not decided yet may still be accepted
        # Later chords and lines have their middle at or after this instant; the next fix after a hole starts anew.
        next_chord_s = next_fix_s
        start, last = self._chord_start, self._last_fix
        if start is not None and last is not None and next_fix_s - last.time_s <= self._chord_hole_s:
            next_chord_s = 0.5 * (start.time_s + next_fix_s)
        next_line_s = self._line.earliest_middle_s(next_fix_s)
        course_s = self._course.final_until(next_chord_s)
        track_speed_s = self._track_speed.final_until(next_line_s)
        if self._is_undecided():
            return -math.inf
        ready_s = min(channel.final_until(newest_s) for channel in self._measured)
        ready_s = min(ready_s, max(self._position.last_s, next_fix_s - self._lend_s - 2 * CLOCK_S))
        for channel, derived_s, verdicts in (
            (self._heading, course_s, self._heading_is_empty),
            (self._speed, track_speed_s, self._speed_is_off),
        ):
            if channel.has_hole(derived_s, newest_s) or verdicts.holds_after(derived_s):
                ready_s = min(ready_s, derived_s)
        return self._position.before_hole(ready_s)  # how it is bridged depends on heading and way up to its end

    def interpolate(self, times_s: NDArray[np.float64]) -> PoseTrack:
        """Compute poses at `times_s` (n,), linear between samples.

        Positions lie along the chord through the Earth, so any place will do.

        Only positions are extrapolated, by the way made since a fix, for MAX_HOLE_S. Beyond the ends, and in holes
        longer than `max_gap_s`, a quantity keeps its nearest value, taken from a later sample only up to
        max(max_gap_s, max_extrapolation_s) away; with none it is NaN (pitch, roll: 0). Heading and speed fall back on
        those over the fixes. `stale` marks instants more than `max_extrapolation_s` from the nearest fix or heading and
        neither placed by the way made nor between two that are at most `max_gap_s` apart, and those whose position is
        disputed. For instants later than `ready_until_s` before any track of fixes is accepted, the best track is.
        """
        times = np.array(times_s, dtype=np.float64)
        if times.size and float(times.max()) > self.ready_until_s:
            self._decide_now()
        position = self._position.at(times)
        heading, heading_fresh, is_course = self._measured_or_derived(
            (self._heading, self._course), self._heading_is_empty, "navigation.heading_from_course", times
        )
        speed, _, _ = self._measured_or_derived(
            (self._speed, self._track_speed), self._speed_is_off, "navigation.speed_from_fixes", times
        )
        if not self._has_speed and not math.isnan(self._last_speed_mps):
            speed = np.where(np.isnan(speed), 0.0, speed)
        placed = self._dated.bridged(times, position.values[:, :3])
        self._count_unbridged(placed, float(times[0]) if times.size else math.nan)
        latitude, longitude, _ = ecef_to_geodetic(placed.place)
        doubt_m, disputed = np.nan_to_num(position.values[:, 3]), position.values[:, 4] > 0.0
        doubt_m = np.where(
            times >= self._agreement.waiting_since_s, np.maximum(doubt_m, self._agreement.waiting_apart_m), doubt_m
        )
        drift_m = np.where(placed.bridged, placed.sigma_m, 0.0)
        drift_m = np.where(position.fresh | placed.bridged, drift_m, position.age_s * np.fmax(np.abs(speed), DRIFT_MPS))
        return PoseTrack(
            time_s=times,
            latitude_deg=latitude,
            longitude_deg=longitude,
            depth_m=self._depth.at(times).values[:, 0],
            heading_rad=heading,
            pitch_rad=self._or_level(self._pitch, "navigation.pitch_absent", times),
            roll_rad=self._or_level(self._roll, "navigation.roll_absent", times),
            speed_mps=speed,
            altitude_m=self._altitude.at(times).values[:, 0],
            stale=~((position.fresh | placed.bridged) & heading_fresh) | disputed,
            position_sigma_m=np.hypot(doubt_m, np.where(np.isfinite(drift_m), drift_m, 0.0)),
            heading_sigma_rad=np.where(is_course, checks.crab_sigma_rad(speed), 0.0),
        )

    def forget_before(self, time_s: float) -> None:
        """Drop what no pose at `time_s` or later needs, so that memory does not grow with the mission."""
        for channel in self._all:
            if channel is not self._way:
                channel.forget_before(time_s)
        self._way.forget_before(min(time_s, max(self._position.first_s, time_s - MAX_HOLE_S)))

    @property
    def wait_s(self) -> float:
        """Give how long a later fix may be worth waiting for, s: two of them, until speed and heading are judged."""
        return self._judge_s if self._is_undecided() else self._lend_s

    @property
    def _judge_s(self) -> float:
        """Give how long two holes between fixes may be, as far as is known, s."""
        open_s = 0.0 if self._last_fix is None else min(self._newest_s - self._last_fix.time_s, MAX_HOLE_S)
        longest_s = max(self._lend_s, _LEND_FACTOR * open_s)
        return 2.0 * longest_s if longest_s > self._shortest_lend_s else self._lend_s

    def _restart(self) -> None:
        self._newest_s = self._oldest_s = -math.inf
        for channel in self._all:
            channel.clear()
        self._agreement = FixAgreement(chord_m, reach_m, AGREE_S)
        self._last_offered_s, self._held_position = -math.inf, checks.HeldPositionCheck()
        self._last_fix = self._chord_start = None
        self._last_heading = self._last_course = None
        self._line.clear()
        self._new_fixes.clear()
        self._odometer = Odometer(self._heading.limits.bridge_s)

    def _store(self, sample: NavSample) -> None:
        time_s = sample.time_s
        if self._oldest_s == -math.inf:
            self._oldest_s = time_s
        self._newest_s = time_s
        latitude, longitude, *measured = values_of(sample, self.counters)
        if latitude == latitude or longitude == longitude:
            self._store_position(time_s, latitude, longitude, sample.position_sigma_m)
        if math.isfinite(self._agreement.waiting_since_s):
            self._decide(self._agreement.advance(time_s))
        for channel, value, (name, low, high) in zip(self._measured, measured, RANGES, strict=True):
            if not low <= value <= high:
                self._count_impossible(name, value, time_s)
            elif channel is self._speed and value == 0.0 and not self._has_speed:
                self._last_speed_mps = 0.0  # never filled, or the vehicle stands: positions say which
            elif channel.last_s == time_s:
                self.counters["navigation.time_repeated"] += 1
            elif channel is self._heading:
                self._last_heading = self._unwrap(value, time_s)
                channel.append(time_s, self._last_heading)
                if not self._zero_heading.add(value):
                    self._heading_is_empty.decide(time_s, False)
            else:
                channel.append(time_s, value)
                if channel is self._altitude:
                    self._n_zero_altitudes = 0
                elif channel is self._speed:
                    self._last_speed_mps, self._has_speed = value, True
        self._run(time_s)

    def _run(self, time_s: float) -> None:
        """Add the way made until now; judge speed and heading by new fixes."""
        heading_rad = NAN
        if self._last_heading is not None and time_s - self._heading.last_s <= self._heading.limits.bridge_s:
            heading_rad = self._last_heading
        is_old = self._has_speed and time_s - self._speed.last_s > self._speed.limits.bridge_s
        if not (is_old or math.isnan(self._last_speed_mps)):
            self._way.append(time_s, self._odometer.go_to(time_s, heading_rad, self._last_speed_mps))
        self._judge_speed()
        if self._is_undecided() and time_s - self._oldest_s > max(_GIVE_UP_S, self._judge_s):
            self._believe()

    def _judge_speed(self) -> None:
        """Lay lines through new fixes; compare the measured speed with them."""
        new, self._new_fixes = self._new_fixes, []
        for fix, joined in new:
            if not self._line.takes(fix, joined=joined):
                continue
            way = self._way.at_one(fix.time_s)
            estimate = self._line.add(TrackPoint(fix.time_s, fix.x, fix.y, fix.z, *way), joined=joined)
            if estimate is not None:
                self._use_estimate(estimate)

    def _use_estimate(self, estimate: SpeedEstimate) -> None:
        if estimate.scatter_m == estimate.scatter_m:
            self._chord_m = min(max(CHORD_M, _CHORD_PER_SCATTER * estimate.scatter_m), _CHORD_MAX_M)
        if estimate.middle_s > self._track_speed.last_s:
            self._track_speed.append(estimate.middle_s, estimate.speed_mps)
        is_off = self._speed_check.is_off(estimate, self._speed_is_off.newest)
        if is_off is not None:
            self._speed_is_off.decide(self._newest_s, is_off)
        ways_m = self._speed_check.reported(estimate)
        if ways_m is not None:
            self._notices.speed_off_track(*ways_m, estimate.middle_s)

    def _is_undecided(self) -> bool:
        """Check whether it has to be found out yet if measured speed and heading can be used."""
        has_speed = not math.isnan(self._last_speed_mps)
        return (has_speed and not self._speed_is_off.is_decided) or (
            self._zero_heading.is_all_zero and not self._heading_is_empty.is_decided
        )

    def _believe(self) -> None:
        """Use measured speed and heading until something speaks against them."""
        for verdicts in (self._speed_is_off, self._heading_is_empty):
            if not verdicts.is_decided:
                verdicts.decide(self._newest_s, False)

    def _decide_now(self) -> None:
        """Decide what is open, because a caller cannot wait."""
        if not self._agreement.is_decided:
            self._decide(self._agreement.decide())
            self._judge_speed()
        if not self._speed_is_off.is_decided or not math.isfinite(self._track_speed.last_s):
            estimate = self._line.at_end()
            if estimate is not None:
                self._use_estimate(estimate)
        if self._is_undecided():
            self._believe()

    def _count_unbridged(self, placed: Bridged, time_s: float) -> None:
        self._n_unbridged += placed.n_left
        if placed.hole_s and self._n_unbridged >= _SPARSE_INSTANTS:
            self._notices.fixes_sparse(placed.hole_s, self._position.limits.bridge_s, time_s)

    def _count_impossible(self, name: str, value: float, time_s: float) -> None:
        if math.isfinite(value):
            self.counters[f"navigation.{name}_out_of_range"] += 1
            if name == "altitude" and value == 0.0:
                self._n_zero_altitudes += 1
                if self._n_zero_altitudes >= checks.ZERO_ALTITUDES:
                    self._notices.altitude_zero(time_s)
        elif not math.isnan(value):  # which is not measured
            self.counters["navigation.not_finite"] += 1

    def _store_position(self, time_s: float, latitude: float, longitude: float, sigma_m: float) -> None:
        if not (math.isfinite(latitude) and math.isfinite(longitude)):
            self.counters["navigation.not_finite"] += 1
            return
        if not (-90.0 <= latitude <= 90.0 and -180.0 <= longitude <= 360.0):
            self._last_offered_s = time_s
            self._reject(1, "navigation.position_out_of_range")
            return
        if time_s == self._last_offered_s:
            self.counters["navigation.time_repeated"] += 1
            return
        self._last_offered_s = time_s
        speed_mps = self._last_speed_mps if time_s - self._speed.last_s <= MAX_HOLE_S else NAN
        if self._held_position.add(time_s, latitude, longitude, speed_mps):
            self.counters["navigation.position_repeated"] += 1
            return
        added_m = math.sqrt(max(0.0, sigma_m * sigma_m - self._fix_sigma_m**2))  # 0 where none is stated
        self._decide(self._agreement.add(fix_at(time_s, latitude, longitude, added_m)))

    def _decide(self, decision: FixDecision[Fix]) -> None:
        if not decision.accepted and not decision.n_rejected:
            return
        accepted = [fix for fix in decision.accepted if fix.time_s > self._position.last_s]
        for number, fix in enumerate(accepted):
            if number == 0 and decision.step_m > 0.0:
                self._step(fix, decision.step_m)
            doubt = (math.hypot(decision.doubt_m, fix.sigma_m), float(decision.disputed))
            self._accept(fix, number > 0 or decision.step_m == 0.0, doubt)
        if decision.disputed and accepted:
            self._notices.position_disputed(decision.doubt_m, accepted[-1].time_s)
        self._decided.extend([False] * len(accepted))
        if decision.n_rejected:
            self._reject(decision.n_rejected, "navigation.position_jump")

    def _reject(self, n_fixes: int, counter: str) -> None:
        """Count rejected fixes; raise the notice where they are many of the newest ones."""
        self.counters[counter] += n_fixes
        self._decided.extend([True] * n_fixes)
        n_rejected = self._decided.count(True)
        if n_rejected >= max(_MIN_REJECTED, _REJECTED_SHARE * len(self._decided)):
            self._notices.positions_rejected(n_rejected, len(self._decided), self._last_offered_s)

    def _step(self, fix: Fix, step_m: float) -> None:
        """Record that the track goes on at another place from this fix on."""
        self.counters["navigation.position_refix"] += 1
        self._steps_s.append((self._position.last_s, fix.time_s))
        self._notices.position_jump(step_m, len(self._steps_s), fix.time_s)

    def _accept(self, fix: Fix, joined: bool, doubt: tuple[float, float]) -> None:
        """Take a fix; `joined` is False if the vehicle cannot have travelled there from the last one."""
        start, last = self._chord_start, self._last_fix
        if joined and last is not None and is_corrected(last, fix):
            joined = False
            if chord_m(last, fix) > way_m(last, fix):
                self._steps_s.append((last.time_s, fix.time_s))
        self._position.append(fix.time_s, (fix.x, fix.y, fix.z, *doubt, self._lend_s), joined)
        self._new_fixes.append((fix, joined))
        chord_hole_s, hole_s = self._chord_hole_s, math.inf if last is None else fix.time_s - last.time_s
        if joined and self._position.limits.bridge_s < hole_s <= MAX_HOLE_S:
            self._lend_s = min(max(self._lend_s, _LEND_FACTOR * hole_s), MAX_HOLE_S)
        self._last_fix = fix
        if start is None or last is None or not joined or hole_s > chord_hole_s:
            self._chord_start = fix
            if last is not None and joined and hole_s <= MAX_HOLE_S and chord_m(last, fix) >= CHORD_M:
                self._check_zero_heading(fix.time_s, course_rad(last, fix), chord_m(last, fix))
            return
        distance, duration = chord_m(start, fix), fix.time_s - start.time_s
        if duration < CHORD_MIN_S or (distance < self._chord_m and duration < CHORD_MAX_S):
            return
        self._chord_start = fix
        middle_s = 0.5 * (start.time_s + fix.time_s)
        if distance >= CHORD_M:
            self._last_course = self._unwrap(course_rad(start, fix), fix.time_s)
            self._course.append(middle_s, self._last_course)
            self._check_zero_heading(middle_s, self._last_course, distance)
            self._check_heading(middle_s, self._last_course)

    @property
    def _chord_hole_s(self) -> float:
        """Give how far apart two fixes of a chord may be, s: farther where they are known to come seldom."""
        return self._lend_s if self._lend_s > self._shortest_lend_s else self._position.limits.bridge_s

    def _check_zero_heading(self, time_s: float, course_rad: float, way_m: float) -> None:
        course_deg = self._zero_heading.off_course_deg(course_rad, way_m)
        if course_deg is not None:
            is_empty = abs(course_deg) > checks.MAX_ZERO_OFFSET_DEG
            self._heading_is_empty.decide(self._newest_s, is_empty)
            if is_empty:
                self._notices.heading_zero(course_deg, time_s)

    def _check_heading(self, time_s: float, course_rad: float) -> None:
        if self._heading_is_empty.newest:
            return
        (heading_rad,) = self._heading.at_one(time_s)
        if math.isnan(heading_rad):
            return
        offset_rad = self._heading_check.add(heading_rad, course_rad)
        if offset_rad is not None:
            self._notices.heading_off_course(offset_rad, time_s)

    def _unwrap(self, angle_rad: float, time_s: float) -> float:
        """Choose the turn count nearest to the heading, or to the course while the compass is silent.

        A track may change between them.
        """
        compass_speaks = (
            time_s - self._heading.last_s <= self._heading.limits.bridge_s and not self._heading_is_empty.newest
        )
        last = self._last_heading if compass_speaks or self._last_course is None else self._last_course
        return angle_rad if last is None else angle_rad + 2 * math.pi * round((last - angle_rad) / (2 * math.pi))

    def _measured_or_derived(
        self, channels: tuple[TimedValues, TimedValues], is_off: Verdicts, counter: str, times: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
        values, fresh, is_derived = measured_or_derived(*channels, is_off.at(times), times)
        if is_derived.any():
            self.counters[counter] += int(np.count_nonzero(is_derived))
        return values, fresh, is_derived

    def _or_level(self, channel: TimedValues, counter: str, times: NDArray[np.float64]) -> NDArray[np.float64]:
        values = channel.at(times).values[:, 0]
        absent = np.isnan(values)
        if absent.any():
            self.counters[counter] = 1
            values = np.where(absent, 0.0, values)
        return values
