"""Hold a plan as it is flown, and put points along its straight runs.

The points are for vehicles that go to places by themselves: they steer for a place, not along a line.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

from msgspec import structs

from auv_mcm.records import Waypoint
from drivers.navigation.corrections import moved, offset_m
from drivers.vehicle.guidance import WaypointTrack

ON_LEG = "on_leg"
"""Kind of the way-points that are put in."""


class FlownPlan(NamedTuple):
    """Hold a plan. proposed: as it was given; waypoints: as it is flown; track: its index counts in these.

    approved_s: when it was proposed last.
    """

    proposed: tuple[Waypoint, ...]
    waypoints: tuple[Waypoint, ...]
    track: WaypointTrack
    approved_s: float

    @property
    def leg(self) -> int:
        """Return the number of the leg of the next way-point."""
        return self.waypoints[min(self.track.index, len(self.waypoints) - 1)].leg

    def entry(self, position_deg: tuple[float, float]) -> int:
        """Return the way-point to go to first, from a position off the track.

        A leg that was broken off is flown again from its beginning.
        """
        first = self.track.index
        while self.waypoints[first].kind in (ON_LEG, "leg_exit") and first > 1:
            first -= 1
        last = next(
            (index for index in range(first, len(self.waypoints)) if self.waypoints[index].kind == "leg_entry"), first
        )
        return self.track.nearest(position_deg, first, last)


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
