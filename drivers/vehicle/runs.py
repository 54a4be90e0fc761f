"""Put points along the straight runs of a plan.

For vehicles that go to places by themselves: they steer for a place, not along a line.
"""

from __future__ import annotations

import math
from itertools import pairwise

from msgspec import structs

from auv_mcm.records import Waypoint
from drivers.navigation.corrections import moved, offset_m

ON_LEG = "on_leg"
"""Kind of the way-points that are put in."""


def with_points_on_legs(plan: tuple[Waypoint, ...], spacing_m: float) -> tuple[Waypoint, ...]:
    """Return the plan with points at most spacing_m apart between each leg's entry and exit, evenly spaced."""
    points = list(plan[:1])
    for before, point in pairwise(plan):
        if point.kind == "leg_exit" and before.kind == "leg_entry":
            start = before.latitude_deg, before.longitude_deg
            east_m, north_m = offset_m(start, (point.latitude_deg, point.longitude_deg))
            n_parts = max(1, math.ceil(math.hypot(east_m, north_m) / spacing_m))
            for part in range(1, n_parts):
                latitude_deg, longitude_deg = moved(*start, east_m * part / n_parts, north_m * part / n_parts)
                points.append(
                    structs.replace(point, kind=ON_LEG, latitude_deg=latitude_deg, longitude_deg=longitude_deg)
                )
        points.append(point)
    return tuple(points)
