"""Steer a vehicle: it obeys commands while they come and flies its own plan otherwise.

It turns, climbs and speeds up no faster than such a vehicle can, and the current carries it along: where it goes by
itself, on its legs or to a place, it heads into the current; a commanded heading it holds, and drifts.

Heading, speed and depth follow what is wanted by first-order laws with bounded rates. Not modelled: sway, rolling into
turns, pitching to climb, and that the plane's north differs from true north away from its origin.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan import dubins
from drivers.vehicle.dialect import Command, GoTo, Steer, Vertical
from sim_replay.simulator.gauss_markov import GaussMarkov
from sim_replay.simulator.plan import Leg
from sim_replay.simulator.scene import Track
from sim_replay.simulator.vehicle import (
    MIN_ALTITUDE_M,
    MIN_DEPTH_M,
    SLOWEST,
    STRONGEST_CURRENT,
    WANDER_PERIOD_S,
    SonarPose,
)

SAFE_ALTITUDE_M: Final = 1.5  # lower it goes for nobody
FASTEST: Final = 1.5  # of the planned speed
STEEPEST_RAD: Final = math.radians(20.0)

_TICK_S: Final = 0.05  # s: step of the vehicle's motion
_TURN_LAG_S: Final = 0.3  # s: lag of the heading
_SPEED_LAG_S: Final = 1.5  # s: lag of the speed
_DEPTH_LAG_S: Final = 1.0  # s: lag of the depth
_LOOK_AHEAD_RADII: Final = 0.5  # of the line of sight along a leg
_WIDE: Final = 1.2  # of the narrowest turn are those on the way back to a leg
_RUN_IN_RADII: Final = 2.0  # straight before a leg is taken up
_STEP_M: Final = 0.2  # m: step along the line that is steered to
_ARC_STEP_RAD: Final = math.radians(10.0)
_ON_LINE_M: Final = 0.5  # m across the track, within which the vehicle is on its line
_STREAM: Final = 0x53544545  # keeps these random numbers apart from others of the same seed

_Plane: TypeAlias = tuple[float, float]
Floats: TypeAlias = NDArray[np.float64]


class _Wanted(NamedTuple):
    """Hold the wanted course. heading_rad: through the water."""

    heading_rad: float
    speed_mps: float
    vertical: Vertical


class _Way(NamedTuple):
    """Hold a way through places, joined by straight lines; all (n,), from its start."""

    gone_m: Floats
    east_m: Floats
    north_m: Floats

    def at(self, gone_m: float) -> _Plane:
        return float(np.interp(gone_m, self.gone_m, self.east_m)), float(np.interp(gone_m, self.gone_m, self.north_m))


class SteeredVehicle:
    """Steer a vehicle of a track, at the start of its first leg at `track.start_time_s`.

    Its own plan: every leg in order, at the track's speed and altitude. After a command it goes on with the leg, or the
    rest of it, that it had left; after the last leg it circles, and `done` is set. Commands are kept within what it can
    do: SLOWEST and FASTEST of the planned speed, STEEPEST_RAD, `turn_rate_deg_s`, MIN_DEPTH_M below the surface, and
    SAFE_ALTITUDE_M above the floor, which goes before everything else. At the place of a GoTo, or as near as its
    radius, it holds its course until the next command.

    frame: the plane of the legs. depth_of_floor: water depth in metres at east and north. Where it is depends on track,
    legs, seed and floor, on the ping rate and on between which poses which commands were given, not on how many poses
    are asked for at once.

    Raises UsageError if there is no leg, or the current is too strong to fly in.
    """

    def __init__(
        self,
        track: Track,
        legs: Sequence[Leg],
        seed: int,
        frame: LocalFrame,
        depth_of_floor: Callable[[float, float], float],
    ) -> None:
        motion, speed_mps = track.motion, track.speed_mps
        if not legs:
            raise UsageError("the plan has no leg to start on: give it one at least")
        if motion.current_mps > STRONGEST_CURRENT * speed_mps:
            raise UsageError(
                f"`track.motion.current_mps` is {motion.current_mps:g}: with a `track.speed_mps` of {speed_mps:g} the "
                f"vehicle goes where it wants in at most {STRONGEST_CURRENT * speed_mps:g}"
            )
        self._track = track
        self._frame = frame
        self._floor = depth_of_floor
        self._own_altitude = Vertical("altitude", track.altitude_m)
        self._turn_rate = math.radians(track.turn_rate_deg_s)
        self._current_mps = motion.current_mps
        self._current_rad = math.radians(motion.current_towards_deg)
        streams = [np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence([seed, _STREAM]).spawn(5)]
        self._roll = GaussMarkov(math.radians(motion.roll_sigma_deg), motion.attitude_period_s, streams[0])
        self._pitch = GaussMarkov(math.radians(motion.pitch_sigma_deg), motion.attitude_period_s, streams[1])
        self._heading_error = GaussMarkov(math.radians(motion.heading_sigma_deg), motion.attitude_period_s, streams[2])
        self._speed_error = GaussMarkov(motion.speed_sigma_percent / 100.0, WANDER_PERIOD_S, streams[3])
        self._altitude_error = GaussMarkov(motion.altitude_sigma_m, WANDER_PERIOD_S, streams[4])

        self.legs: Final = tuple(legs)
        self._leg = 0
        self._way_m = 0.0  # of the leg, done
        self._on_leg = True
        self._back: _Way | None = None  # to the leg
        self._gone_m = 0.0  # on it
        self._command: Command | None = None
        self._place: _Plane = (0.0, 0.0)  # of a GoTo
        self._held_rad: float | None = None  # the course kept at the place of a GoTo

        self._time_s = 0.0
        self._east_m, self._north_m = legs[0].east_m, legs[0].north_m
        self._speed_mps = speed_mps
        self._heading_rad = self._against_current(legs[0].direction_rad)
        self._depth_m = self._floor(self._east_m, self._north_m) - track.altitude_m

    @property
    def done(self) -> bool:
        """Report whether the last leg of its own plan lies behind."""
        return self._leg == len(self.legs)

    @property
    def legs_flown(self) -> int:
        """Return the number of legs of its own plan that lie behind."""
        return self._leg

    @property
    def turn_radius_m(self) -> float:
        """Return the maximum turn radius over ground at the planned speed, or at the present one if higher.

        The maximum is with the current from astern.
        """
        speed_mps = max(self._speed_mps, self._track.speed_mps)
        return (speed_mps + self._current_mps) ** 2 / (speed_mps * self._turn_rate)

    def steer(self, command: Command | None) -> None:
        """Set the command to fly from the next pose on; None: its own plan. Repeating a command changes nothing."""
        if command == self._command:
            return
        if command is not None:
            self._on_leg, self._back = False, None
        self._command = command
        self._held_rad = None
        if isinstance(command, GoTo):
            east_m, north_m, _ = self._frame.to_enu(command.latitude_deg, command.longitude_deg, 0.0)
            self._place = float(east_m), float(north_m)

    def fly(self, n_poses: int, rate_hz: float) -> list[SonarPose]:
        """Return the next poses, `rate_hz` per second; the first of all is the start."""
        poses = []
        n_ticks = math.ceil(1.0 / rate_hz / _TICK_S)
        for _ in range(n_poses):
            poses.append(self._pose())
            for _ in range(n_ticks):
                self._tick(1.0 / rate_hz / n_ticks)
        return poses

    def _tick(self, dt_s: float) -> None:
        wanted = self._wanted()
        speed_mps = min(
            max(wanted.speed_mps, self._current_mps + SLOWEST * self._track.speed_mps), FASTEST * self._track.speed_mps
        )
        speed_mps *= 1.0 + self._speed_error.at(self._time_s)[0]
        off_rad = math.remainder(wanted.heading_rad - self._heading_rad, 2.0 * math.pi)
        turn_rad = min(max(off_rad * -math.expm1(-dt_s / _TURN_LAG_S), -self._turn_rate * dt_s), self._turn_rate * dt_s)
        middle_rad = self._heading_rad + 0.5 * turn_rad
        east_mps, north_mps = self._velocity(middle_rad)
        self._east_m += east_mps * dt_s
        self._north_m += north_mps * dt_s
        self._heading_rad += turn_rad
        self._speed_mps += (speed_mps - self._speed_mps) * -math.expm1(-dt_s / _SPEED_LAG_S)
        floor_m = self._floor(self._east_m, self._north_m)
        reference, value_m = wanted.vertical
        sought_m = min(value_m if reference == "depth" else floor_m - value_m, floor_m - SAFE_ALTITUDE_M)
        max_m = self._speed_mps * math.sin(STEEPEST_RAD) * dt_s
        sink_m = (max(sought_m, MIN_DEPTH_M) - self._depth_m) * -math.expm1(-dt_s / _DEPTH_LAG_S)
        self._depth_m += min(max(sink_m, -max_m), max_m)
        self._time_s += dt_s

    def _wanted(self) -> _Wanted:
        command = self._command
        match command:
            case Steer():
                return _Wanted(command.heading_rad, command.speed_mps, command.vertical)
            case GoTo():
                east_m, north_m = self._place[0] - self._east_m, self._place[1] - self._north_m
                if self._held_rad is None and math.hypot(east_m, north_m) <= command.radius_m:
                    east_mps, north_mps = self._velocity(self._heading_rad)
                    self._held_rad = math.atan2(east_mps, north_mps)
                if self._held_rad is not None:
                    return _Wanted(self._against_current(self._held_rad), command.speed_mps, command.vertical)
                return _Wanted(self._heading_to(self._place, command.radius_m), command.speed_mps, command.vertical)
        return _Wanted(self._own_heading(), self._track.speed_mps, self._own_altitude)

    @property
    def _look_ahead_m(self) -> float:
        return _LOOK_AHEAD_RADII * self.turn_radius_m

    def _own_heading(self) -> float:
        if not self.done and self._on_leg:
            along_m, across_m = self.legs[self._leg].along_across(self._east_m, self._north_m)
            if abs(across_m) < _ON_LINE_M:
                self._way_m = max(self._way_m, along_m)
            elif along_m > self._way_m:
                self._on_leg = False  # it came too far off the line, and takes the leg up again
            if self._way_m >= self.legs[self._leg].length_m:
                self._leg, self._way_m, self._on_leg = self._leg + 1, 0.0, False
        if self.done:
            return self._heading_rad + 0.5 * self._turn_rate * _TURN_LAG_S
        leg = self.legs[self._leg]
        if not self._on_leg:
            self._back = self._back or self._way_to(leg)
            here = self._east_m, self._north_m
            while (
                self._gone_m < self._back.gone_m[-1]
                and math.dist(here, self._back.at(self._gone_m)) < self._look_ahead_m
            ):
                self._gone_m += _STEP_M
            self._on_leg = self._gone_m >= self._back.gone_m[-1]
        if not self._on_leg and self._back is not None:
            east_m, north_m = self._back.at(self._gone_m)
            bearing_rad = math.atan2(east_m - self._east_m, north_m - self._north_m)
            if math.cos(bearing_rad - math.atan2(*self._velocity(self._heading_rad))) < 0.0:
                self._back = None  # it came off the way, which begins anew from here
            return self._against_current(bearing_rad)
        self._back = None
        _, across_m = leg.along_across(self._east_m, self._north_m)
        return self._against_current(leg.direction_rad + math.atan2(-across_m, self._look_ahead_m))

    def _way_to(self, leg: Leg) -> _Way:
        """Return the shortest way back to the leg's last place that ends along the leg (L. E. Dubins, 1957)."""
        self._gone_m = 0.0
        course_rad = math.atan2(*self._velocity(self._heading_rad))
        entry = dubins.PlanePose(*leg.at(self._way_m - _RUN_IN_RADII * self.turn_radius_m, 0.0), leg.direction_rad)
        path = dubins.dubins_path(
            dubins.PlanePose(self._east_m, self._north_m, course_rad), entry, _WIDE * self.turn_radius_m
        )
        east, north = np.vstack([dubins.sample_path(path, _ARC_STEP_RAD)[:, :2], leg.at(self._way_m, 0.0)]).T
        return _Way(np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(east), np.diff(north)))]), east, north)

    def _heading_to(self, place: _Plane, radius_m: float) -> float:
        """Head for a place; go straight on while no turn would come as near as radius_m."""
        east_m, north_m = place[0] - self._east_m, place[1] - self._north_m
        sine, cosine = math.sin(self._heading_rad), math.cos(self._heading_rad)
        ahead_m, across_m = east_m * sine + north_m * cosine, east_m * cosine - north_m * sine
        off_centre_m = math.hypot(ahead_m, abs(across_m) - self.turn_radius_m)
        if off_centre_m < self.turn_radius_m - radius_m and abs(across_m) > 0.1 * abs(ahead_m):
            return self._heading_rad
        return self._against_current(math.atan2(east_m, north_m))

    def _against_current(self, course_rad: float) -> float:
        """Return the heading that gives a course over ground."""
        across_mps = self._current_mps * math.sin(self._current_rad - course_rad)
        return course_rad - math.asin(min(max(across_mps / self._speed_mps, -1.0), 1.0))

    def _velocity(self, heading_rad: float) -> tuple[float, float]:
        """Return the velocity east and north over ground, m/s."""
        return (
            self._speed_mps * math.sin(heading_rad) + self._current_mps * math.sin(self._current_rad),
            self._speed_mps * math.cos(heading_rad) + self._current_mps * math.cos(self._current_rad),
        )

    def _pose(self) -> SonarPose:
        floor_m = self._floor(self._east_m, self._north_m)
        east_mps, north_mps = self._velocity(self._heading_rad)
        depth_m = self._depth_m - self._altitude_error.at(self._time_s)[0]
        own = self._command is None and self._on_leg and not self.done
        return SonarPose(
            time_s=self._track.start_time_s + self._time_s,
            east_m=self._east_m,
            north_m=self._north_m,
            depth_m=min(max(depth_m, MIN_DEPTH_M), floor_m - MIN_ALTITUDE_M),
            heading_rad=self._heading_rad + self._heading_error.at(self._time_s)[0],
            pitch_rad=math.radians(self._track.motion.pitch_offset_deg) + self._pitch.at(self._time_s)[0],
            roll_rad=self._roll.at(self._time_s)[0],
            course_rad=math.atan2(east_mps, north_mps),
            speed_mps=math.hypot(east_mps, north_mps),
            on_leg=self._leg
            if own and self.legs[self._leg].along_across(self._east_m, self._north_m)[0] >= 0.0
            else -1,
        )
