"""Compute the planned legs of a scene's track, and places relative to them."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

from auv_mcm.geometry.geodesy import LocalFrame
from sim_replay.simulator.scene import Lawnmower, Origin, Scene, SceneObject, Spiral, Waypoints


class Leg(NamedTuple):
    """Describe a straight run in the local plane; direction clockwise from north."""

    east_m: float
    north_m: float
    direction_rad: float
    length_m: float

    @property
    def end(self) -> tuple[float, float]:
        """Return east and north of the far end, m."""
        return self.at(self.length_m, 0.0)

    def at(self, along_m: float, across_m: float) -> tuple[float, float]:
        """Return east and north of a place `along_m` from the start and `across_m` to starboard."""
        sine, cosine = math.sin(self.direction_rad), math.cos(self.direction_rad)
        return self.east_m + along_m * sine + across_m * cosine, self.north_m + along_m * cosine - across_m * sine

    def along_across(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Invert `at`."""
        sine, cosine = math.sin(self.direction_rad), math.cos(self.direction_rad)
        east, north = east_m - self.east_m, north_m - self.north_m
        return east * sine + north * cosine, east * cosine - north * sine

    def distance_m(self, east_m: float, north_m: float) -> float:
        """Return the shortest distance from the leg."""
        along, across = self.along_across(east_m, north_m)
        return math.hypot(along - min(max(along, 0.0), self.length_m), across)


def planned_legs(plan: Lawnmower | Spiral | Waypoints) -> tuple[Leg, ...]:
    """Return the plan's legs, in order."""
    if isinstance(plan, Waypoints):
        return tuple(
            Leg(start[0], start[1], math.atan2(end[0] - start[0], end[1] - start[1]), math.dist(start, end))
            for start, end in pairwise(plan.points_m)
        )
    direction = math.radians(plan.heading_deg)
    first = Leg(
        plan.start_east_m,
        plan.start_north_m,
        direction,
        plan.leg_m if isinstance(plan, Lawnmower) else plan.first_leg_m,
    )
    if isinstance(plan, Lawnmower):
        return tuple(
            Leg(
                *first.at(plan.leg_m * (index % 2), index * plan.spacing_m),
                direction + math.pi * (index % 2),
                plan.leg_m,
            )
            for index in range(plan.n_legs)
        )
    legs = [first]
    for index in range(1, plan.n_legs):
        length = plan.first_leg_m + plan.spacing_m * (index // 2)
        legs.append(Leg(*legs[-1].end, direction + 0.5 * math.pi * index, length))
    return tuple(legs)


def local_frame(origin: Origin) -> LocalFrame:
    """Return the plane of a scene's east and north."""
    return LocalFrame(latitude_deg=origin.latitude_deg, longitude_deg=origin.longitude_deg)


def swath_m(scene: Scene) -> float:
    """Return the ground range that the sonar reaches over a flat floor at the planned altitude."""
    sonar, altitude = scene.sonar, scene.track.altitude_m
    return math.sqrt(max(0.0, (sonar.range_m - altitude) * (sonar.range_m + altitude)))


def place_in_plane(scene: Scene, scene_object: SceneObject) -> tuple[float, float]:
    """Return east and north of an object, in whatever form its place was given."""
    if scene_object.east_m is not None and scene_object.north_m is not None:
        return scene_object.east_m, scene_object.north_m
    if scene_object.leg is not None and scene_object.along_m is not None and scene_object.across_m is not None:
        return planned_legs(scene.track.plan)[scene_object.leg].at(scene_object.along_m, scene_object.across_m)
    east, north, _ = local_frame(scene.origin).to_enu(
        scene_object.latitude_deg or 0.0, scene_object.longitude_deg or 0.0, 0.0
    )
    return float(east), float(north)
