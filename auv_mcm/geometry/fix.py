"""Hold and compare positions one at a time, in plain floats: array arithmetic would cost ten times as much."""

from __future__ import annotations

import math
from typing import NamedTuple

from auv_mcm.geometry.geodesy import ECCENTRICITY_SQUARED, SEMI_MAJOR_M


class Fix(NamedTuple):
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


def course_rad(a: Fix, b: Fix) -> float:
    """Give the compass direction from a to b, at a, within (-pi, pi]."""
    x, y, z = b.x - a.x, b.y - a.y, b.z - a.z
    sin_lon, cos_lon = math.sin(a.longitude_rad), math.cos(a.longitude_rad)
    outward = cos_lon * x + sin_lon * y
    east = cos_lon * y - sin_lon * x
    north = math.cos(a.latitude_rad) * z - math.sin(a.latitude_rad) * outward
    return math.atan2(east, north)
