"""Reckon the vehicle's position, and its error, from heading and speed since the last position."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from auv_mcm.records import NAN
from drivers.navigation.corrections import HeadingReading, Position, SpeedReading, moved, offset_m

MAX_HOLD_S: Final = 1.5  # a velocity is taken to go on for this long, no longer
_CONTRADICTED_S: Final = 20.0  # s for which a contradiction counts: as long as fixes are compared with the way made


class Travelled(NamedTuple):
    """Hold the distance run since the start.

    leg: the distance between two instants is known only within one leg; NaN: on none.
    """

    leg: float
    east_m: float
    north_m: float


class _Anchor(NamedTuple):
    time_s: float
    position: Position
    travelled: Travelled
    distance_m: float


class Reckoner:
    """Integrate velocities, with the direction from a course over ground, else from heading and drift.

    Times are seconds on any clock.

    Errors of heading and speed are taken to be constant, so that they add up with the way and with the time: the
    1-sigma is sqrt(sigma0^2 + (sigma_heading * distance)^2 + (sigma_speed * time)^2).
    """

    def __init__(self) -> None:
        self._time_s = -math.inf
        self._velocity: tuple[float, float] | None = None  # east, north
        self._heading: tuple[float, HeadingReading] | None = None
        self._speed: tuple[float, SpeedReading] | None = None
        self._has_run = False  # a speed of 0 in every message is a field that was never filled
        self._leg = 0
        self._east_m = self._north_m = self._distance_m = 0.0
        self._anchor: _Anchor | None = None
        self._contradiction: tuple[float, float] = (-math.inf, 0.0)  # when, and by how many metres

    def travelled(self, time_s: float) -> Travelled:
        """Return how far the vehicle went until a time near the newest; on no leg where nothing says how fast it is."""
        ahead_s = time_s - self._time_s
        if self._velocity is None or ahead_s > MAX_HOLD_S:
            return Travelled(NAN, self._east_m, self._north_m)
        east_mps, north_mps = self._velocity
        return Travelled(self._leg, self._east_m + east_mps * ahead_s, self._north_m + north_mps * ahead_s)

    def turn(self, time_s: float, heading: HeadingReading) -> None:
        """Turn to a heading at its time."""
        self._heading = time_s, heading
        self._go_to(time_s)

    def run(self, time_s: float, speed: SpeedReading) -> None:
        self._speed = time_s, speed
        self._has_run = self._has_run or speed.speed_mps != 0.0
        self._go_to(time_s)

    def fix(self, time_s: float, position: Position) -> None:
        """Start from a measured position."""
        self._anchor = _Anchor(time_s, position, self.travelled(time_s), self._distance_m)

    def contradict(self, time_s: float, position: Position) -> None:
        """Note a position that is not believed, but may be right: the error of reckoning is that large, perhaps."""
        reckoned = self.position()
        if reckoned is not None:
            self._contradiction = time_s, math.hypot(*offset_m(reckoned[1][:2], position[:2]))

    def way_m(self) -> float:
        """Return the way made since the last measured position."""
        return 0.0 if self._anchor is None else self._distance_m - self._anchor.distance_m

    def position(self) -> tuple[float, Position] | None:
        """Return time and place by reckoning.

        None if the distance run since the last measured position is not known.
        """
        anchor = self._anchor
        if (
            anchor is None
            or self._velocity is None
            or anchor.travelled.leg != self._leg
            or self._heading is None
            or self._speed is None
        ):
            return None
        place = anchor.position
        latitude_deg, longitude_deg = moved(
            place.latitude_deg,
            place.longitude_deg,
            self._east_m - anchor.travelled.east_m,
            self._north_m - anchor.travelled.north_m,
        )
        across_m = self._heading[1].sigma_rad * (self._distance_m - anchor.distance_m)
        along_m = self._speed[1].sigma_mps * max(self._time_s - anchor.time_s, 0.0)
        sigma_m = math.sqrt(place.sigma_m**2 + across_m**2 + along_m**2)
        if self._time_s - self._contradiction[0] <= _CONTRADICTED_S:
            sigma_m = max(sigma_m, self._contradiction[1])
        return self._time_s, Position(latitude_deg, longitude_deg, sigma_m, is_stated=True)

    def _go_to(self, time_s: float) -> None:
        """Advance by the mean of the last two velocities. Late messages change the velocity, not the distance run."""
        elapsed_s = time_s - self._time_s
        velocity = self._velocity_at(time_s)
        if elapsed_s > MAX_HOLD_S or velocity is None or self._velocity is None:
            self._leg += 1
            self._velocity = velocity
            self._time_s = max(self._time_s, time_s)
            if self._anchor is not None and time_s - self._anchor.time_s <= MAX_HOLD_S:
                self.fix(*self._anchor[:2])
            return
        if elapsed_s > 0.0:
            east_m = 0.5 * (self._velocity[0] + velocity[0]) * elapsed_s
            north_m = 0.5 * (self._velocity[1] + velocity[1]) * elapsed_s
            self._east_m += east_m
            self._north_m += north_m
            self._distance_m += math.hypot(east_m, north_m)
        self._velocity = velocity
        self._time_s = max(self._time_s, time_s)

    def _velocity_at(self, time_s: float) -> tuple[float, float] | None:
        """Return the velocity east and north, in m/s, if heading and speed are recent; else None."""
        if not self._has_run or self._speed is None or abs(time_s - self._speed[0]) > MAX_HOLD_S:
            return None
        speed = self._speed[1]
        direction_rad = speed.course_rad
        if math.isnan(direction_rad):
            heading_rad = NAN
            if self._heading is not None and abs(time_s - self._heading[0]) <= MAX_HOLD_S:
                heading_rad = self._heading[1].heading_rad
            direction_rad = heading_rad + (0.0 if math.isnan(speed.drift_rad) else speed.drift_rad)
        if math.isnan(direction_rad):
            return None
        return speed.speed_mps * math.sin(direction_rad), speed.speed_mps * math.cos(direction_rad)
