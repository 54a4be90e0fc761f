"""Hold and compare positions one at a time, in plain floats: array arithmetic would cost ten times as much."""

from __future__ import annotations

import math
from typing import Final

import msgspec

from auv_mcm.geometry.geodesy import ECCENTRICITY_SQUARED, SEMI_MAJOR_M
from auv_mcm.geometry.sample_values import MAX_SPEED_MPS

JUMP_SLACK_M: Final = 3.0  # fixes scatter and are rounded, which over a few milliseconds looks like any speed
_N_SIGMA: Final = 3.0  # standard deviations: of sound fixes one in 370 is further off


class Fix(msgspec.Struct, frozen=True, gc=False):
    """Hold one position on the ellipsoid at one time. x, y, z: Earth-centred metres. sigma_m: beyond any fix's own."""

    time_s: float
    x: float
    y: float
    z: float
    latitude_rad: float
    longitude_rad: float
    sigma_m: float = 0.0


def fix_at(time_s: float, latitude_deg: float, longitude_deg: float, sigma_m: float = 0.0) -> Fix:
    """Place a position on the ellipsoid, as geodesy.geodetic_to_ecef at height 0."""
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    sine, cosine = math.sin(latitude), math.cos(latitude)
    prime_vertical = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY_SQUARED * sine * sine)
    x = prime_vertical * cosine * math.cos(longitude)
    y = prime_vertical * cosine * math.sin(longitude)
    return Fix(time_s, x, y, prime_vertical * (1.0 - ECCENTRICITY_SQUARED) * sine, latitude, longitude, sigma_m)


def chord_m(a: Fix, b: Fix) -> float:
    """Measure the chord between two fixes."""
    return math.hypot(b.x - a.x, b.y - a.y, b.z - a.z)


def is_corrected(a: Fix, b: Fix) -> bool:
    """Check whether b, known twice as well or better, corrects a: what lies between them is not motion."""
    return 2.0 * b.sigma_m < a.sigma_m


def way_m(a: Fix, b: Fix) -> float:
    """Give the longest way between two fixes that may be motion."""
    return JUMP_SLACK_M + MAX_SPEED_MPS * (b.time_s - a.time_s)


def reach_m(a: Fix, b: Fix) -> float:
    """Give how far apart two fixes of one source may be, by motion and by what the second corrects."""
    return way_m(a, b) + (_N_SIGMA * a.sigma_m if is_corrected(a, b) else 0.0)


def course_rad(a: Fix, b: Fix) -> float:
    """Give the compass direction from a to b, at a, within (-pi, pi]."""
    x, y, z = b.x - a.x, b.y - a.y, b.z - a.z
    sin_lon, cos_lon = math.sin(a.longitude_rad), math.cos(a.longitude_rad)
    outward = cos_lon * x + sin_lon * y
    east = cos_lon * y - sin_lon * x
    north = math.cos(a.latitude_rad) * z - math.sin(a.latitude_rad) * outward
    return math.atan2(east, north)
