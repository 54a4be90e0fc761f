"""Model the vehicle's true motion.

Its path over ground is the planned legs, straight from start to end, joined by shortest paths of limited curvature. On
it the vehicle travels at its speed through water, set off sideways by sway; it heads into the current just enough to
stay on the path, so it crabs. Attitude, sway, speed and altitude wander as Gauss-Markov processes.

Not modelled: rolling into turns, pitching to climb, heading that follows sway.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from auv_mcm.errors import UsageError
from auv_mcm.plan import dubins
from sim_replay.simulator.gauss_markov import GaussMarkov
from sim_replay.simulator.plan import Leg
from sim_replay.simulator.scene import Track

STRONGEST_CURRENT: Final = 0.8  # of the planned speed
SLOWEST: Final = (
    0.1  # of the planned speed is what the vehicle always makes through water on top of the current's speed
)
MIN_ALTITUDE_M: Final = 0.5  # m above the sea floor, whatever the plan
MIN_DEPTH_M: Final = 0.2  # m below the surface, whatever the plan
RUN_IN_S: Final = 3.0  # straight before a leg starts
WANDER_PERIOD_S: Final = 20.0  # of sway, speed and altitude

_SWAY_SPEED: Final = 0.05  # of the planned speed is what sway's rate has as standard deviation at most
_SIGMAS_IN_TURN: Final = 4.0  # a turn is at least so many standard deviations of sway wide
_TICK_S: Final = 0.05  # s: step of the depth's lag
_ROUNDING_M: Final = 1e-9  # m of way that is none
_SAME_PLACE_M: Final = 1e-3  # m between the end of a leg and the start of the next, so that no turn is flown
_SAME_DIRECTION_RAD: Final = 1e-6  # rad between them
_STREAM: Final = 0x56454849  # keeps these random numbers apart from others of the same seed
_SENSE: Final[dict[dubins.Turn, float]] = {"left": -1.0, "straight": 0.0, "right": 1.0}


class SonarPose(NamedTuple):
    """Hold the sonar's true position and motion.

    time_s: UTC seconds since 1970. east_m, north_m: in the scene's plane. depth_m: below the surface, positive down.
    Directions are clockwise from the plane's north and not wrapped; pitch is bow up, roll starboard down. course_rad,
    speed_mps: over ground. on_leg: index into Vehicle.legs, or -1 between legs.
    """

    time_s: float
    east_m: float
    north_m: float
    depth_m: float
    heading_rad: float
    pitch_rad: float
    roll_rad: float
    course_rad: float
    speed_mps: float
    on_leg: int


class _Piece(NamedTuple):
    """Describe a part of the path over ground. Curvature is positive to starboard; the last piece has no end."""

    leg: int
    length_m: float
    east_m: float
    north_m: float
    direction_rad: float
    curvature: float

    def at(self, way_m: float) -> tuple[float, float, float]:
        """Return east, north and direction after `way_m`."""
        if self.curvature == 0.0:
            chord, mean, direction = way_m, self.direction_rad, self.direction_rad
        else:
            turned = self.curvature * way_m
            chord = 2.0 / self.curvature * math.sin(0.5 * turned)
            mean, direction = self.direction_rad + 0.5 * turned, self.direction_rad + turned
        return self.east_m + chord * math.sin(mean), self.north_m + chord * math.cos(mean), direction


class Vehicle:
    """Fly legs, and take a new plan at any time.

    It starts at the start of the first leg at `track.start_time_s`. Every leg is flown straight in full: turns end
    RUN_IN_S ahead of it on its line, or at its start if that lies straight ahead. Turns are no tighter than
    `turn_rate_deg_s` allows at the highest ground speed of the track without its wander. After the last leg the vehicle
    flies straight on, ready for another plan.

    depth_of_floor: water depth in metres at east and north in the scene's plane; it decides the depth the vehicle flies
    at. With an altitude lag the depth sought is taken every 0.05 s. The vehicle stays MIN_DEPTH_M below the surface,
    but always MIN_ALTITUDE_M above the floor.

    Where the vehicle is at a time depends on track, legs, seed and floor and on when which plans were given, not on the
    times it was asked for. Standard deviations scale the same random course, so that scenes that differ in
    them compare.

    legs: all legs ever given, in order; those that a new plan took away keep their numbers.

    Raises UsageError if there is no leg, or the current is too strong to fly in.
    """

    def __init__(
        self, track: Track, legs: Sequence[Leg], seed: int, depth_of_floor: Callable[[float, float], float]
    ) -> None:
        motion, speed = track.motion, track.speed_mps
        if not legs:
            raise UsageError("the plan has no leg to start on: give it one at least")
        if motion.current_mps > STRONGEST_CURRENT * speed:
            raise UsageError(
                f"`track.motion.current_mps` is {motion.current_mps:g}: with a `track.speed_mps` of {speed:g} the "
                f"vehicle stays on its track in at most {STRONGEST_CURRENT * speed:g}"
            )
        self._track = track
        self._floor = depth_of_floor
        self._current_mps = motion.current_mps
        self._current_rad = math.radians(motion.current_towards_deg)
        self._slowest_mps = motion.current_mps + SLOWEST * speed
        # In a turn, ground speed over radius is the course's rate. The heading's is that times ground speed over speed
        # through water along the path, (v + c)^2 / (R v) at most, with the current from astern.
        tightest = (speed + motion.current_mps) ** 2 / (speed * math.radians(track.turn_rate_deg_s))
        self._radius_m = max(tightest, _SIGMAS_IN_TURN * motion.sway_sigma_m)
        streams = [np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence([seed, _STREAM]).spawn(6)]
        sway_period = max(WANDER_PERIOD_S, 2.0 * math.pi * motion.sway_sigma_m / (_SWAY_SPEED * speed))
        self._roll = GaussMarkov(math.radians(motion.roll_sigma_deg), motion.attitude_period_s, streams[0])
        self._pitch = GaussMarkov(math.radians(motion.pitch_sigma_deg), motion.attitude_period_s, streams[1])
        self._heading = GaussMarkov(math.radians(motion.heading_sigma_deg), motion.attitude_period_s, streams[2])
        self._sway = GaussMarkov(motion.sway_sigma_m, sway_period, streams[3])
        self._speed_error = GaussMarkov(motion.speed_sigma_percent / 100.0, WANDER_PERIOD_S, streams[4])
        self._altitude_error = GaussMarkov(motion.altitude_sigma_m, WANDER_PERIOD_S, streams[5])

        self.legs: tuple[Leg, ...] = ()
        self._pieces: list[_Piece] = []
        self._append(legs, legs[0].east_m, legs[0].north_m, legs[0].direction_rad)
        # State at the last tick, from which any time up to the next one is reached.
        self._tick = 0
        self._piece = 0
        self._way_m = 0.0
        self._ground_mps = self._ground_speed(self._pieces[0].direction_rad, self._water_speed(0.0))
        east, north, _ = self._place(0, 0.0, 0.0)
        self._sought_m = self._floor(east, north) - track.altitude_m
        self._held_m = self._sought_m
        # Where the caller has come to.
        self._now_s = 0.0
        self._piece_now = 0
        self._way_now_m = 0.0

    @property
    def done(self) -> bool:
        """Report whether the last leg lies behind."""
        return self._piece_now == len(self._pieces) - 1

    def poses(self, rate_hz: float) -> Iterator[SonarPose]:
        """Yield the poses from now until the plan is done, `rate_hz` per second.

        If the track has no pings in turns, only those on legs, each leg after a turn beginning with a pose at its very
        start.
        """
        silent = not self._track.pings_in_turns
        start_s, beat = self._now_s, 0
        while True:
            if self._fly_to(start_s + beat / rate_hz, stop_at_leg=silent):
                start_s, beat = self._now_s, 0
            if self.done:
                return
            if not silent or self._pieces[self._piece_now].leg >= 0:
                yield self._pose()
            beat += 1

    def follow(self, legs: Sequence[Leg]) -> None:
        """Replace the plan from now on; without legs the vehicle is done and flies straight on."""
        cut = self._pieces[self._piece_now]._replace(length_m=self._way_now_m)
        self._pieces[self._piece_now :] = [cut]
        self._append(legs, *cut.at(cut.length_m))
        self._piece_now, self._way_now_m = self._piece_now + 1, 0.0

    def _append(self, legs: Iterable[Leg], east_m: float, north_m: float, direction_rad: float) -> None:
        """Append a path through legs from a place and direction, and on without end."""
        for leg in legs:
            self._pieces += self._transit(leg, east_m, north_m, direction_rad)
            self._pieces.append(_Piece(len(self.legs), leg.length_m, leg.east_m, leg.north_m, leg.direction_rad, 0.0))
            self.legs += (leg,)
            (east_m, north_m), direction_rad = leg.end, leg.direction_rad
        self._pieces.append(_Piece(-1, math.inf, east_m, north_m, direction_rad, 0.0))

    def _transit(self, leg: Leg, east_m: float, north_m: float, direction_rad: float) -> list[_Piece]:
        along, across = leg.along_across(east_m, north_m)
        off = leg.direction_rad - direction_rad
        if (
            abs(math.sin(off)) < _SAME_DIRECTION_RAD
            and math.cos(off) > 0.0
            and abs(across) < _SAME_PLACE_M
            and along < _SAME_PLACE_M
        ):
            return [_Piece(-1, -along, east_m, north_m, direction_rad, 0.0)] if along < -_SAME_PLACE_M else []
        run_in = RUN_IN_S * self._track.speed_mps
        entry = dubins.PlanePose(*leg.at(-run_in, 0.0), leg.direction_rad)
        pieces = []
        for turn, length in dubins.dubins_path(
            dubins.PlanePose(east_m, north_m, direction_rad), entry, self._radius_m
        ).segments:
            pieces.append(_Piece(-1, length, east_m, north_m, direction_rad, _SENSE[turn] / self._radius_m))
            east_m, north_m, direction_rad = pieces[-1].at(length)
        return [*pieces, _Piece(-1, run_in, *entry, 0.0)]

    def _fly_to(self, time_s: float, *, stop_at_leg: bool) -> bool:
        """Fly until `time_s`, or to the start of a leg after a turn if that comes first and is wanted; True then."""
        while True:
            tick_end_s = (self._tick + 1) * _TICK_S
            end_s = min(time_s, tick_end_s)
            piece, way = self._on_path(end_s)
            if stop_at_leg and piece > self._piece_now and self._pieces[piece].leg >= 0 > self._pieces[piece - 1].leg:
                while abs(way) > _ROUNDING_M:
                    end_s -= way / self._ground_mps
                    reached, way = self._on_path(end_s)
                    way -= sum(before.length_m for before in self._pieces[reached:piece])
                self._now_s, self._piece_now, self._way_now_m = end_s, piece, 0.0
                return True
            self._now_s, self._piece_now, self._way_now_m = end_s, piece, way
            if end_s == tick_end_s:
                self._complete_tick(end_s, piece, way)
            if end_s >= time_s:
                return False

    def _complete_tick(self, time_s: float, piece: int, way_m: float) -> None:
        self._tick, self._piece, self._way_m = self._tick + 1, piece, way_m
        self._ground_mps = self._ground_speed(self._pieces[piece].at(way_m)[2], self._water_speed(time_s))
        lag = self._track.motion.altitude_lag_s
        if lag > 0.0:
            self._held_m = self._sought_m + (self._held_m - self._sought_m) * math.exp(-_TICK_S / lag)
            east, north, _ = self._place(piece, way_m, self._sway.at(time_s)[0])
            self._sought_m = self._floor(east, north) - self._track.altitude_m

    def _on_path(self, time_s: float) -> tuple[int, float]:
        """Return the piece and the way on it at a time from the last tick up to the next, by the trapezoidal rule."""
        since = time_s - self._tick * _TICK_S
        ground = self._ground_mps
        if self._current_mps == 0.0:
            ground_then = self._water_speed(time_s)
        else:
            piece, way = self._further(since * ground)
            ground_then = self._ground_speed(self._pieces[piece].at(way)[2], self._water_speed(time_s))
        return self._further(0.5 * since * (ground + ground_then))

    def _further(self, distance_m: float) -> tuple[int, float]:
        piece, way = self._piece, self._way_m + distance_m
        while way > self._pieces[piece].length_m - _ROUNDING_M:
            way -= self._pieces[piece].length_m
            piece += 1
        return piece, way

    def _water_speed(self, time_s: float) -> float:
        return max(self._track.speed_mps * (1.0 + self._speed_error.at(time_s)[0]), self._slowest_mps)

    def _ground_speed(self, direction_rad: float, water_mps: float) -> float:
        if self._current_mps == 0.0:
            return water_mps
        off = self._current_rad - direction_rad
        across = self._current_mps * math.sin(off)
        return self._current_mps * math.cos(off) + math.sqrt(water_mps * water_mps - across * across)

    def _place(self, piece: int, way_m: float, sway_m: float) -> tuple[float, float, float]:
        """Return east and north, and the path's direction there."""
        east, north, direction = self._pieces[piece].at(way_m)
        return east + sway_m * math.cos(direction), north - sway_m * math.sin(direction), direction

    def _pose(self) -> SonarPose:
        time_s, motion = self._now_s, self._track.motion
        piece = self._pieces[self._piece_now]
        sway, sway_mps = self._sway.at(time_s)
        east, north, direction = self._place(self._piece_now, self._way_now_m, sway)
        water_mps = self._water_speed(time_s)
        ahead_mps = self._ground_speed(direction, water_mps) * (1.0 - piece.curvature * sway)
        crab = math.asin(self._current_mps * math.sin(self._current_rad - direction) / water_mps)

        floor = self._floor(east, north)
        if motion.altitude_lag_s > 0.0:
            since = time_s - self._tick * _TICK_S
            depth = self._sought_m + (self._held_m - self._sought_m) * math.exp(-since / motion.altitude_lag_s)
        else:
            depth = floor - self._track.altitude_m
        depth -= self._altitude_error.at(time_s)[0]
        return SonarPose(
            time_s=self._track.start_time_s + time_s,
            east_m=east,
            north_m=north,
            depth_m=min(max(depth, MIN_DEPTH_M), floor - MIN_ALTITUDE_M),
            heading_rad=direction - crab + self._heading.at(time_s)[0],
            pitch_rad=math.radians(motion.pitch_offset_deg) + self._pitch.at(time_s)[0],
            roll_rad=self._roll.at(time_s)[0],
            course_rad=direction + math.atan2(sway_mps, ahead_mps),
            speed_mps=math.hypot(ahead_mps, sway_mps),
            on_leg=piece.leg,
        )
