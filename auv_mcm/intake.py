"""Turn a stream of pings and navigation into blocks of pings with poses.

By ordering, cutting segments, and waiting for navigation.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.geometry.navigation import NavBuffer
from auv_mcm.geometry.navigation_checks import AltitudeCheck
from auv_mcm.geometry.pose_track import slice_pose
from auv_mcm.records import EchoTrace, NavSample, Notice, Ping, PoseTrack, Transfer
from auv_mcm.settings.config import Config

BLOCK_PINGS: Final = 32  # pings processed at once: more delays tiles, fewer cost time per ping
_RATE_HALF_SPAN_S: Final = 1.0  # rotation rates are taken over two seconds: fixes and compasses are coarser than that
_CLOCK_STEP_S: Final = 1.0  # s: a step back of less is a late ping, of more a clock that was set
_MAX_HELD: Final = 1024  # navigation samples kept until pings step back too, or do not: 20 s of 50 Hz
# navigation samples without a ping: 20 MB, ten minutes of 100 Hz. A sonar that is off must not let memory grow.
_MAX_WITHOUT_PING: Final = 1 << 16
# s of navigation without a ping, after which the segment ends: pings that a link holds up come sooner; chosen
_QUIET_S: Final = 30.0
_MAX_QUIET_STEP_S: Final = 1.0  # that a sample adds to it: its clock may leap
_MIN_HELD: Final = 3  # in a row, by which navigation has stepped back: one or two are late, or a glitch
_MIN_SEGMENT_GAP_S: Final = 2.0  # s without a ping that end a segment, whatever navigation may bridge
_MIN_STEP_M: Final = 1e-3  # m between pings: keeps distances along the track increasing when the vehicle stands
_WAVERS: Final = 0.01  # of a ping's samples: a change of range changes more. Chosen
_MIN_LOST: Final = 64  # pings that have the time of another, as a third of all: from there a person is asked. Chosen
_UNKNOWN_SPEED_MPS: Final = 1.5  # m/s, a usual survey speed; spaces pings whose speed is not known


class PingBlock(NamedTuple):
    """Hold pings of the first one's sample layout with their poses at transmit; speeds are known and not negative.

    along_m: (n,) float64 distance from mission start, strictly increasing once placed along the track, zero before.
    yaw_rate_rad_s, pitch_rate_rad_s: (n,) float64.
    """

    pings: list[Ping]
    poses: PoseTrack
    along_m: NDArray[np.float64]
    yaw_rate_rad_s: NDArray[np.float64]
    pitch_rate_rad_s: NDArray[np.float64]

    def piece(self, first: int, stop: int) -> PingBlock:
        """Cut out pings [first, stop)."""
        if (first, stop) == (0, len(self.pings)):
            return self
        rows = slice(first, stop)
        poses = slice_pose(self.poses, rows)
        return PingBlock(
            self.pings[rows], poses, self.along_m[rows], self.yaw_rate_rad_s[rows], self.pitch_rate_rad_s[rows]
        )


class SegmentEnd(NamedTuple):
    """Mark the end of a segment: the next block does not continue the one before.

    transfer: what its samples are from there on, None for no change.
    """

    transfer: Transfer | None = None


class Intake:
    """Release blocks of equally laid-out pings once navigation around them is final.

    Depends on the events and their times alone, so the same stream gives the same blocks however it was cut up.
    """

    def __init__(self, config: Config, counters: Counter[str]) -> None:
        self._config = config
        self._counters = counters
        self._raised: set[str] = set()  # codes of notices about navigation
        self._navigation = NavBuffer(config.navigation, self._raised)
        self._held: deque[NavSample] = deque(maxlen=_MAX_HELD)  # that stepped back, in a row, until pings do too
        self._altitude_check = AltitudeCheck()
        self._beyond_range: Notice | None = None
        self._last_beyond = (math.nan, math.nan, "")  # altitude and range in metres, place
        self._notices: list[Notice] = []
        self._n_steps = 0  # of the position, before the newest block
        self._refused: Counter[str] = Counter()  # by navigation buffers already put away
        self._pending: deque[Ping | SegmentEnd] = deque()
        self._run: list[Ping] = []  # of the pending pings, those that make the next block, once that is known
        self._squint_rad: float | None = None  # of the newest ping
        self._newest_s = math.nan  # of the pings: one wrong stamp of navigation must not end all waiting for it
        self._newest_name: tuple[object, ...] = ()  # number and sides of the newest ping
        self._n_given = self._n_lost = 0  # pings, and those of them that have the time of another
        self._n_without_ping = 0  # navigation samples since the newest ping
        self._quiet_s = 0.0  # that they lasted
        self._navigated_s = math.nan  # of the newest sample
        self._is_open = False  # the segment has pings
        self._leap: Ping | None = None  # after a hole or a step back, until another ping confirms its stamp
        self._longest_hole_s = max(_MIN_SEGMENT_GAP_S, config.navigation.max_gap_s)
        self._previous_speed_mps = math.nan
        self._along_m = config.waterfall.max_ping_gap_m  # the first ping stands for half a gap of track before it
        self._last_time_s = math.nan
        self._max_wait_s = _RATE_HALF_SPAN_S + 2.0 * max(
            config.navigation.max_gap_s, config.navigation.max_extrapolation_s
        )

    @property
    def navigation_counters(self) -> Counter[str]:
        """Count the navigation samples that were refused, and what the buffer counts."""
        return self._refused + self._navigation.counters

    def add_navigation(self, sample: NavSample) -> list[Notice]:
        """Take a sample; return the notices about navigation that it raises.

        Samples that step back wait until pings do: where a clock is set back, both go on in its new time, and what
        still comes in the old one is refused.
        """
        self._n_without_ping += 1
        step_s, self._navigated_s = sample.time_s - self._navigated_s, sample.time_s
        self._quiet_s += min(step_s, _MAX_QUIET_STEP_S) if step_s > 0.0 else 0.0
        newest_s = self._navigation.span_s[1]
        if not newest_s - sample.time_s > _CLOCK_STEP_S:
            self._refuse_held()
            self._navigation.add(sample)
            return self.take_notices()
        if self._held and sample.time_s < self._held[-1].time_s:
            self._refuse_held()
        if len(self._held) == _MAX_HELD:
            self._refused["navigation.time_backwards"] += 1
        self._held.append(sample)
        if len(self._held) >= _MIN_HELD and abs(self._newest_s - sample.time_s) < abs(self._newest_s - newest_s):
            self._renew_navigation()  # the pings stepped back before: what came since then was late
        return self.take_notices()

    def let_go(self) -> list[PingBlock | SegmentEnd]:
        """Release the pings that wait, and forget navigation that later ones do not need, where none come any more.

        The segment ends there once no later sample changes where the pings are: as it does where they go on later.
        """
        if self._is_open and self._quiet_s >= _QUIET_S and self._is_ready(self._newest_s):
            self._is_open = False
            return [*self._release(everything=True), SegmentEnd()]
        if self._n_without_ping < _MAX_WITHOUT_PING:
            return []
        self._n_without_ping = 0
        released = self._release(everything=True)
        self._navigation.forget_before(self._navigation.span_s[1] - self._max_wait_s)
        return released

    def _refuse_held(self) -> None:
        if self._held:
            self._refused["navigation.time_backwards"] += len(self._held)
            self._held.clear()

    def _renew_navigation(self) -> None:
        """Begin navigation anew, with the samples that stepped back."""
        self._refused += self._navigation.counters
        self._notices += self._navigation.take_notices()
        self._navigation, self._n_steps = NavBuffer(self._config.navigation, self._raised), 0
        for sample in self._held:
            self._navigation.add(sample)
        self._held.clear()

    def take_notices(self) -> list[Notice]:
        """Return the notices about pings and navigation raised since the last call."""
        notices, self._notices = self._notices + self._navigation.take_notices(), []
        return notices

    def add_ping(self, ping: Ping) -> list[PingBlock | SegmentEnd]:
        """Queue a ping; return what became ready."""
        if ping.port is None and ping.starboard is None:
            self._counters["ping.no_side_scan_channel"] += 1
            return []
        if not math.isfinite(ping.time_s):
            self._counters["ping.time_not_finite"] += 1
            return []
        leap, self._leap = self._leap, None
        step_s = ping.time_s - self._newest_s
        if leap is None:
            if step_s > self._longest_hole_s or step_s <= -_CLOCK_STEP_S:
                self._leap = ping  # a hole in time, a clock that was set, or one bad stamp: the next ping decides
                return []
            return self._accept(ping)
        if (whole := _joined(leap, ping)) is not None:
            self._leap = whole  # its other side has the same stamp, and confirms nothing
            return []
        if ping.time_s < leap.time_s or leap.time_s < self._newest_s < ping.time_s + _CLOCK_STEP_S:
            self._counters["ping.time_leap"] += 1
            return self.add_ping(ping)
        return self._accept(leap) + self._accept(ping)

    def _accept(self, ping: Ping) -> list[PingBlock | SegmentEnd]:
        step_s = ping.time_s - self._newest_s
        looks_elsewhere = self._squint_rad not in (None, ping.squint_rad)
        self._squint_rad = ping.squint_rad
        if step_s == 0.0 and self._joins(ping):
            return []
        name = ping.number, ping.port is None, ping.starboard is None
        self._n_given += 1
        if not looks_elsewhere and -_CLOCK_STEP_S < step_s <= 0.0:
            self._counters["ping.time_repeated" if step_s == 0.0 else "ping.time_backwards"] += 1
            if step_s == 0.0 and name != self._newest_name:
                self._lose(ping)
            return []
        self._newest_name = name
        done: list[PingBlock | SegmentEnd] = []
        if looks_elsewhere or step_s <= -_CLOCK_STEP_S:
            self._counters["ping.sub_aperture" if looks_elsewhere else "ping.clock_stepped_back"] += 1
            done = [*self._release(everything=True), SegmentEnd()]
            self._renew_navigation()
        elif step_s > self._longest_hole_s:
            self._counters["ping.gap"] += 1
            if self._is_open:
                self._pending.append(SegmentEnd())
        self._newest_s = ping.time_s
        self._n_without_ping, self._quiet_s, self._is_open = 0, 0.0, True
        self._pending.append(ping)
        return done + self._release(everything=False)

    def _joins(self, ping: Ping) -> bool:
        """Join a ping to the newest one where that has its time and only the other side; check whether it did."""
        newest = self._pending[-1] if self._pending else None
        whole = _joined(newest, ping) if isinstance(newest, Ping) else None
        if whole is None:
            return False
        self._pending[-1], self._run = whole, []
        return True

    def _lose(self, ping: Ping) -> None:
        """Count a ping that has the time of another one, and ask a person to look where that takes many."""
        self._n_lost += 1
        if self._n_lost < _MIN_LOST or 3 * self._n_lost < self._n_given or "ping.times_repeat" in self._raised:
            return
        self._raised.add("ping.times_repeat")
        text = (
            f"{self._n_lost} of {self._n_given} pings have the time of the one before, and are left out: a clock that "
            "is too coarse. Give each ping the time at which it was sent."
        )
        self._notices.append(Notice(code="ping.times_repeat", text=text, place=ping.place))

    def flush(self) -> list[PingBlock | SegmentEnd]:
        """Release everything still waiting, and the end of the segment."""
        leap, self._leap = self._leap, None
        late = [] if leap is None else self._accept(leap)
        released = [*late, *self._release(everything=True), SegmentEnd()]
        self._check_altitude(at_end=True)
        return released

    def end_segment(self, transfer: Transfer) -> None:
        """End the segment with the pings so far; the samples of those that follow are what `transfer` says."""
        self._pending.append(SegmentEnd(transfer))

    def start_segment(self, along_m: float) -> None:
        """Start a segment: the next block's first ping lies just after this along-track distance."""
        self._along_m = along_m + self._config.waterfall.max_ping_gap_m
        self._previous_speed_mps = math.nan

    def _release(self, *, everything: bool) -> list[PingBlock | SegmentEnd]:
        released: list[PingBlock | SegmentEnd] = []
        while self._pending:
            first = self._pending[0]
            if isinstance(first, SegmentEnd):
                self._pending.popleft()
                released.append(first)
                continue
            run = self._next_run(everything=everything)
            if not run:
                break
            if not (everything or self._is_ready(run[-1].time_s)):
                break
            for _ in run:
                self._pending.popleft()
            self._run = []
            released += self._blocks(run)
        return released

    def _is_ready(self, last_s: float) -> bool:
        """Check whether navigation around a ping is final, or has been waited for long enough."""
        if self._newest_s >= last_s + max(self._max_wait_s, self._navigation.wait_s + _RATE_HALF_SPAN_S):
            return True
        final_s = last_s + _RATE_HALF_SPAN_S
        # Nothing is final beyond the newest sample, which takes less to find out.
        return self._navigation.span_s[1] >= final_s and self._navigation.ready_until_s >= final_s

    def _next_run(self, *, everything: bool) -> list[Ping]:
        """Take the next block's pings.

        Returns none of them while later pings may still join, unless `everything` has to go.
        """
        if self._run or (len(self._pending) < BLOCK_PINGS and not everything):
            return self._run
        run: list[Ping] = []
        for item in self._pending:
            if isinstance(item, SegmentEnd) or len(run) == BLOCK_PINGS or (run and not _is_alike(item, run[0])):
                break
            run.append(item)
        self._run = run
        return run

    def _blocks(self, pings: list[Ping]) -> list[PingBlock | SegmentEnd]:
        """Give pings their poses, in pieces with a segment's end between where the position steps to another place."""
        block = self._block(pings)
        n_steps = self._navigation.n_steps_before(block.poses.time_s)
        pieces: list[PingBlock | SegmentEnd] = []
        for first, stop in pairwise([0, *(np.flatnonzero(np.diff(n_steps)) + 1).tolist(), len(pings)]):
            if n_steps[first] != self._n_steps:
                self._n_steps = int(n_steps[first])
                pieces.append(SegmentEnd())
            pieces.append(block.piece(first, stop))
        return pieces

    def _block(self, pings: list[Ping]) -> PingBlock:
        times = np.array([ping.time_s for ping in pings])
        # Beyond its ends navigation has a heading, but no turning.
        oldest_s, newest_s = self._navigation.span_s
        before_s = np.maximum(times - _RATE_HALF_SPAN_S, oldest_s)
        after_s = np.minimum(times + _RATE_HALF_SPAN_S, newest_s)
        span_s = after_s - before_s
        n_pings = len(pings)
        poses = self._navigation.interpolate(np.concatenate([times, before_s, after_s]))
        heading_rad, pitch_rad = (angle.reshape(3, n_pings) for angle in (poses.heading_rad, poses.pitch_rad))
        poses = slice_pose(poses, slice(n_pings))
        speed_mps = np.abs(poses.speed_mps)  # astern, or by a sensor mounted so, pings lie as far apart
        unknown = ~np.isfinite(speed_mps)
        self._counters["navigation.speed_unknown"] += int(np.count_nonzero(unknown))
        stated_m = np.array([ping.altitude_m for ping in pings])  # by a sonar that has an altimeter of its own
        poses = structs.replace(
            poses,
            speed_mps=np.where(unknown, _UNKNOWN_SPEED_MPS, speed_mps),
            altitude_m=np.where(np.isfinite(poses.altitude_m), poses.altitude_m, stated_m),
        )
        self._navigation.forget_before(float(times[-1]) - 2.0 * _RATE_HALF_SPAN_S)
        self._compare_altitude(pings, poses)
        self._counters["navigation.ping_stale"] += int(np.count_nonzero(poses.stale))
        return PingBlock(
            pings,
            poses,
            np.zeros(n_pings),
            _rate(heading_rad[2] - heading_rad[1], span_s),
            _rate(pitch_rad[2] - pitch_rad[1], span_s),
        )

    def _compare_altitude(self, pings: list[Ping], poses: PoseTrack) -> None:
        """Compare altitudes of a block with the range of its pings, which have one layout."""
        if self._beyond_range is not None:
            return
        altitude_m = poses.altitude_m
        range_m = max(
            trace.first_range_m + trace.spacing_m * trace.samples.shape[0]
            for trace in (pings[0].port, pings[0].starboard)
            if trace
        )
        beyond = altitude_m > range_m
        self._altitude_check.add(int(np.count_nonzero(np.isfinite(altitude_m))), int(np.count_nonzero(beyond)))
        if beyond.any():
            self._last_beyond = (float(np.max(altitude_m[beyond])), range_m, pings[0].place)
        self._check_altitude(at_end=False)

    def _check_altitude(self, *, at_end: bool) -> None:
        if self._beyond_range is not None or not self._altitude_check.is_beyond_range(at_end=at_end):
            return
        altitude_m, range_m, place = self._last_beyond
        text = (
            f"altitude ({altitude_m:.1f} m) is greater than the sonar's range ({range_m:.1f} m) in most pings: no echo "
            "can come from the sea floor. Check the altimeter and its unit, and the range setting of the sonar."
        )
        self._beyond_range = Notice(code="navigation.altitude_beyond_range", text=text, place=place)
        self._notices.append(self._beyond_range)

    def place_along_track(self, block: PingBlock) -> PingBlock:
        """Give the block its along-track distances: speed over ground integrated over time, strictly increasing."""
        times, speed = block.poses.time_s, block.poses.speed_mps
        along: NDArray[np.float64] = np.empty(len(times))
        if math.isnan(self._previous_speed_mps):
            along[0] = self._along_m
        else:
            mean = 0.5 * (self._previous_speed_mps + speed[0])
            along[0] = self._along_m + max(mean * (times[0] - self._last_time_s), _MIN_STEP_M)
        steps = np.maximum(0.5 * (speed[:-1] + speed[1:]) * np.diff(times), _MIN_STEP_M)
        along[1:] = along[0] + np.cumsum(steps)
        self._along_m, self._previous_speed_mps, self._last_time_s = (
            float(along[-1]),
            float(speed[-1]),
            float(times[-1]),
        )
        return block._replace(along_m=along)


def _rate(change: NDArray[np.float64], span_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the change per second.

    Zero where there is hardly any time to see one, as with navigation that came and went.
    """
    return np.divide(change, span_s, out=np.zeros(change.shape), where=span_s > 0.5 * _RATE_HALF_SPAN_S)


def _joined(one: Ping, other: Ping) -> Ping | None:
    """Join two pings of one time that have a side each; None for others."""
    if one.time_s == other.time_s and other.starboard is None and one.port is None:
        return structs.replace(one, port=other.port)
    if one.time_s == other.time_s and other.port is None and one.starboard is None:
        return structs.replace(one, starboard=other.starboard)
    return None


def _is_alike(ping: Ping, first: Ping) -> bool:
    """Check whether a ping has the sides and the sample layout of the first one of its block."""
    return same_ranges(ping.port, first.port) and same_ranges(ping.starboard, first.starboard)


def same_ranges(trace: EchoTrace | None, first: EchoTrace | None) -> bool:
    """Check whether samples lie at the same ranges, but for less than half a sample at either end, nearly as many.

    Where the sound speed is measured with each ping, no two spacings are equal.
    """
    if trace is None or first is None:
        return trace is first
    near_m = trace.first_range_m - first.first_range_m
    far_m = near_m + len(first.samples) * (trace.spacing_m - first.spacing_m)
    return nearly_as_many(trace, first) and max(abs(near_m), abs(far_m)) < 0.5 * first.spacing_m


def nearly_as_many(trace: EchoTrace, first: EchoTrace) -> bool:
    """Check whether sample counts differ by a hundredth at most: some recorders' waver by one or two."""
    return abs(len(trace.samples) - len(first.samples)) <= _WAVERS * len(first.samples)


def equal_counts(traces: Sequence[EchoTrace]) -> list[EchoTrace]:
    """Cut traces to the samples of the shortest."""
    n_samples = min(len(trace.samples) for trace in traces)
    return [
        trace if len(trace.samples) == n_samples else structs.replace(trace, samples=trace.samples[:n_samples])
        for trace in traces
    ]
