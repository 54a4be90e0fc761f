"""Project places on a flat chart around an origin, in plain floats: a hundred times faster than arrays of one.

The same projection as `auv_mcm.geometry.geodesy.LocalFrame` without heights: Earth-centred coordinates seen along the
vertical of the origin, so that poles and the antimeridian need no branch.
Straight lines on the chart are great circles within 0.5 m up to 50 km from the origin.
What lies on the far side of the Earth would fold onto the chart; so what is too far away has no place there.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, TypeAlias

from auv_mcm.geometry.geodesy import ECCENTRICITY_SQUARED, SEMI_MAJOR_M
from auv_mcm.records import NAN

Vector: TypeAlias = tuple[float, float, float]

_REACH_M: Final = 500_000.0  # m from the chart's origin: farther, the plane is too poor a picture of the Earth
_TURN: Final = 2.0 * math.pi


class Point(NamedTuple):
    """Hold a point on the chart; NaN where it does not reach."""

    east_m: float
    north_m: float


class LocalPlane:
    """Project to east and north in metres from an origin, at sea level."""

    def __init__(self, latitude_deg: float, longitude_deg: float) -> None:
        self._origin_m = _ecef_m(latitude_deg, longitude_deg)
        self._east, self._north = _east_north(latitude_deg, longitude_deg)

    def point(self, latitude_deg: float, longitude_deg: float) -> Point:
        """Return a place on the chart; NaN for NaN, and farther than 500 km away."""
        if not math.isfinite(latitude_deg + longitude_deg):
            return Point(NAN, NAN)
        x, y, z = _ecef_m(latitude_deg, longitude_deg)
        x0, y0, z0 = self._origin_m
        offset = x - x0, y - y0, z - z0
        if not _dot(offset, offset) <= _REACH_M * _REACH_M:
            return Point(NAN, NAN)
        return Point(_dot(offset, self._east), _dot(offset, self._north))

    def direction(self, latitude_deg: float, longitude_deg: float, heading_rad: float) -> Point:
        """Return one metre on the chart along a true heading at a place.

        Near a pole true north turns against the chart's.
        """
        east, north = _east_north(latitude_deg, longitude_deg)
        sine, cosine = math.sin(heading_rad), math.cos(heading_rad)
        ahead = sine * east[0] + cosine * north[0], sine * east[1] + cosine * north[1], cosine * north[2]
        return Point(_dot(ahead, self._east), _dot(ahead, self._north))

    def true_heading_rad(self, latitude_deg: float, longitude_deg: float, course_rad: float) -> float:
        """Return the true heading, [0, 2 pi), at a place of a direction on the chart; the reverse of `direction`."""
        east, north = _east_north(latitude_deg, longitude_deg)
        sine, cosine = math.sin(course_rad), math.cos(course_rad)
        ahead = (
            sine * self._east[0] + cosine * self._north[0],
            sine * self._east[1] + cosine * self._north[1],
            sine * self._east[2] + cosine * self._north[2],
        )
        return (
            math.atan2(_dot(ahead, east), _dot(ahead, north)) % _TURN % _TURN
        )  # once more: just below zero rounds up to a turn


def distance_m(a: Point, b: Point) -> float:
    """Compute the distance between two points, m."""
    return math.hypot(b.east_m - a.east_m, b.north_m - a.north_m)


def distance_to_line_m(point: Point, start: Point, end: Point) -> float:
    """Return the distance of a point to the straight line between two others, which may coincide."""
    east_m, north_m = end.east_m - start.east_m, end.north_m - start.north_m
    length2 = east_m * east_m + north_m * north_m
    from_east_m, from_north_m = point.east_m - start.east_m, point.north_m - start.north_m
    share = (from_east_m * east_m + from_north_m * north_m) / length2 if length2 > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return math.hypot(from_east_m - share * east_m, from_north_m - share * north_m)


def _ecef_m(latitude_deg: float, longitude_deg: float) -> Vector:
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    sine = math.sin(latitude)
    prime_vertical_m = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY_SQUARED * sine * sine)
    from_axis_m = prime_vertical_m * math.cos(latitude)
    return (
        from_axis_m * math.cos(longitude),
        from_axis_m * math.sin(longitude),
        prime_vertical_m * (1.0 - ECCENTRICITY_SQUARED) * sine,
    )


def _east_north(latitude_deg: float, longitude_deg: float) -> tuple[Vector, Vector]:
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
    sin_lon, cos_lon = math.sin(longitude), math.cos(longitude)
    return (-sin_lon, cos_lon, 0.0), (-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat)


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
