"""Convert a unit's fixes, with its signs and mounting, to values at the vehicle's navigation reference."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from auv_mcm.geometry.geodesy import ECCENTRICITY_SQUARED, SEMI_MAJOR_M
from auv_mcm.geometry.navigation_checks import CROSS_CURRENT_MPS
from auv_mcm.records import NAN
from auv_mcm.settings.port_settings import NavUnitSettings, Quantity
from drivers.navigation.nav_decoder import NavFix

_TURN: Final = 2.0 * math.pi
_MAX_DEPTH_M: Final = 12_000.0  # m: deeper than any sea
_MIN_DEPTH_M: Final = -100.0  # m: above the surface by as much as a pressure sensor without its offset may read
_MAX_SPEED_MPS: Final = 30.0  # m/s: faster than any vehicle that this runs on
_MAX_SIGMA: Final = 1e6  # metres or radians: receivers mark the unknown by such
_SHARPEST_COSINE: Final = 1e-9  # keeps steps finite at a pole


class Position(NamedTuple):
    """Hold a position with its 1-sigma. is_stated: not by the unit's settings alone."""

    latitude_deg: float
    longitude_deg: float
    sigma_m: float
    is_stated: bool = False


class HeadingReading(NamedTuple):
    """Hold a heading with its 1-sigma."""

    heading_rad: float
    sigma_rad: float


class AttitudeReading(NamedTuple):
    """Hold pitch and roll."""

    pitch_rad: float
    roll_rad: float


class SpeedReading(NamedTuple):
    """Hold a velocity.

    course_rad: over ground, NaN if not reported; drift_rad: against the bow, NaN if not reported.
    """

    speed_mps: float
    course_rad: float
    drift_rad: float
    sigma_mps: float


class Readings(NamedTuple):
    """Hold a fix's readings of the vehicle; None where it reports nothing, or nothing that is possible."""

    position: Position | None
    heading: HeadingReading | None
    attitude: AttitudeReading | None
    depth: float | None
    altitude: float | None
    speed: SpeedReading | None


def readings_of(fix: NavFix, unit: NavUnitSettings) -> tuple[Readings, list[Quantity]]:
    """Correct signs and mounting angles, not lever arms; return also the quantities with impossible values."""
    impossible: list[Quantity] = []

    def plausible(quantity: Quantity, known: bool, possible: bool) -> bool:
        if known and not possible:
            impossible.append(quantity)
        return known and possible

    position = heading = attitude = depth = altitude = speed = None
    latitude_deg, longitude_deg = fix.latitude_deg, fix.longitude_deg
    known = not (math.isnan(latitude_deg) or math.isnan(longitude_deg))
    # Nobody dives at 0, 0: unfilled records hold it.
    if plausible(
        "position",
        known,
        abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0 and (latitude_deg, longitude_deg) != (0, 0),
    ):
        sigma_m = _sigma(fix.position_sigma_m, unit.position_sigma_m)
        position = Position(latitude_deg, longitude_deg, sigma_m, sigma_m == fix.position_sigma_m)
    if plausible("heading", fix.heading_rad == fix.heading_rad, abs(fix.heading_rad) <= _TURN + 0.02):
        turned = unit.heading_sign * fix.heading_rad + math.radians(unit.heading_offset_deg)
        heading = HeadingReading(turned % _TURN, _sigma(fix.heading_sigma_rad, math.radians(unit.heading_sigma_deg)))
    known = not (math.isnan(fix.pitch_rad) or math.isnan(fix.roll_rad))
    if plausible("attitude", known, abs(fix.pitch_rad) <= math.pi / 2 and abs(fix.roll_rad) <= math.pi + 0.02):
        attitude = AttitudeReading(
            unit.pitch_sign * fix.pitch_rad + math.radians(unit.pitch_offset_deg),
            unit.roll_sign * fix.roll_rad + math.radians(unit.roll_offset_deg),
        )
    if plausible("depth", fix.depth_m == fix.depth_m, _MIN_DEPTH_M <= fix.depth_m <= _MAX_DEPTH_M):
        depth = fix.depth_m
    if plausible("altitude", fix.altitude_m == fix.altitude_m, 0.0 < fix.altitude_m <= _MAX_DEPTH_M):
        altitude = fix.altitude_m
    speed_mps = fix.water_speed_mps if math.isnan(fix.speed_mps) else fix.speed_mps
    if plausible("speed", speed_mps == speed_mps, abs(speed_mps) <= _MAX_SPEED_MPS):
        course_rad = fix.course_rad if abs(fix.course_rad) <= _TURN + 0.02 else NAN
        drift_rad = fix.drift_rad + math.radians(unit.heading_offset_deg) if abs(fix.drift_rad) <= _TURN else NAN
        sigma_mps = _sigma(fix.speed_sigma_mps, unit.speed_sigma_mps)
        if math.isnan(fix.speed_mps):
            sigma_mps = math.hypot(sigma_mps, CROSS_CURRENT_MPS)  # through the water, which moves any way
        speed = SpeedReading(speed_mps, course_rad, drift_rad, sigma_mps)
    return Readings(position, heading, attitude, depth, altitude, speed), impossible


def arm_north_east_down(
    arm_m: tuple[float, float, float], heading_rad: float, pitch_rad: float, roll_rad: float
) -> tuple[float, float, float]:
    """Rotate a lever arm (forward, starboard, down) to north, east, down.

    Yaw, pitch, roll in this order (Fossen 2011, eq. 2.18).
    """
    forward, starboard, down = arm_m
    sin_h, cos_h = math.sin(heading_rad), math.cos(heading_rad)
    sin_p, cos_p = math.sin(pitch_rad), math.cos(pitch_rad)
    sin_r, cos_r = math.sin(roll_rad), math.cos(roll_rad)
    sideways = cos_r * starboard - sin_r * down
    below = sin_r * starboard + cos_r * down
    ahead = cos_p * forward + sin_p * below
    return cos_h * ahead - sin_h * sideways, sin_h * ahead + cos_h * sideways, cos_p * below - sin_p * forward


def moved(latitude_deg: float, longitude_deg: float, east_m: float, north_m: float) -> tuple[float, float]:
    """Move a position by some metres, by the ellipsoid's radii of curvature there.

    Good to a millimetre over a kilometre away from the poles.
    """
    meridian_m, parallel_m = _radii_m(latitude_deg)
    latitude = min(max(latitude_deg + math.degrees(north_m / meridian_m), -90.0), 90.0)
    longitude = longitude_deg + math.degrees(east_m / parallel_m)
    return latitude, longitude if -180.0 <= longitude <= 180.0 else (longitude + 180.0) % 360.0 - 180.0


def offset_m(from_deg: tuple[float, float], to_deg: tuple[float, float]) -> tuple[float, float]:
    """Return east and north, in metres, from one latitude, longitude to another nearby; the reverse of `moved`."""
    meridian_m, parallel_m = _radii_m(from_deg[0])
    across_deg = (to_deg[1] - from_deg[1] + 180.0) % 360.0 - 180.0
    return math.radians(across_deg) * parallel_m, math.radians(to_deg[0] - from_deg[0]) * meridian_m


def _radii_m(latitude_deg: float) -> tuple[float, float]:
    """Return the radii of curvature along the meridian and of the parallel, in metres."""
    latitude = math.radians(latitude_deg)
    sine = math.sin(latitude)
    squeezed = 1.0 - ECCENTRICITY_SQUARED * sine * sine
    prime_vertical_m = SEMI_MAJOR_M / math.sqrt(squeezed)
    return prime_vertical_m * (1.0 - ECCENTRICITY_SQUARED) / squeezed, prime_vertical_m * max(
        math.cos(latitude), _SHARPEST_COSINE
    )


def _sigma(reported: float, otherwise: float) -> float:
    return reported if 0.0 <= reported < _MAX_SIGMA else otherwise
