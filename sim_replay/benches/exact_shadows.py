"""Measure heights by shadows whose edges are known exactly: what the floor under a shadow costs, and clicks do not."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.shadow import shadow_height_m
from sim_replay.simulator.bodies import MOVES_FLOOR, Bodies, body_tops, pack
from sim_replay.simulator.objects import PlacedObject, bodies_of
from sim_replay.simulator.plan import planned_legs
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.sea import Sea

GROUND_RANGES_M: Final = (10.0, 20.0, 30.0, 40.0)
"""At which each target is looked at, from both sides of the scene's first leg, m."""
_STEP_M: Final = 0.02  # of the profile: a third of a pixel of the waterfall
_BESIDE_M: Final = np.arange(-1.2, 1.21, 0.12)  # profiles along the track: the longest targets, at the waterfall's rows
_BEHIND_M: Final = 14.0  # shadow of 1.3 m at 40 m, 5 m over the floor


def exact_heights(scene: Scene) -> NDArray[np.float64]:
    """Measure every target by the longest of its shadows; returns measured and true heights, m, (n, 2).

    The edges come from the floor and the bodies themselves: along profiles away from the sonar, the last lit point of
    the object and the first lit point behind it. They go through the measure of the page. No sonar, speckle or beam
    takes part, so that what is wrong comes from the floor's own heights.
    """
    sea = Sea(scene)
    heading_rad = planned_legs(scene.track.plan)[0].direction_rad
    heights: list[tuple[float, float]] = []
    for target in sea.objects:
        if not target.is_target or target.kind == "point":
            continue
        bodies = pack(bodies_of(target, sea.world.floor_m, 0))
        for side in (1.0, -1.0):
            abeam = side * math.cos(heading_rad), -side * math.sin(heading_rad)
            for ground_range_m in GROUND_RANGES_M:
                measured_m = _longest(sea, target, bodies, abeam, ground_range_m, scene.track.altitude_m)
                if measured_m is not None:
                    heights.append((measured_m, target.height_m - target.burial_m))
    return np.array(heights, dtype=np.float64).reshape(-1, 2)


def _longest(
    sea: Sea,
    target: PlacedObject,
    bodies: Bodies,
    abeam: tuple[float, float],
    ground_range_m: float,
    altitude_m: float,
) -> float | None:
    """Return the greatest height that the profiles over a target give, m; None where it throws no shadow."""
    east, north = abeam
    behind_m = np.arange(1.0, ground_range_m + _BEHIND_M, _STEP_M)
    sonar_m = altitude_m + float(
        sea.world.floor_m(target.east_m - ground_range_m * east, target.north_m - ground_range_m * north)
    )
    best_m: float | None = None
    for beside_m in _BESIDE_M:
        # along the track is abeam turned by a right angle
        east_m = target.east_m - beside_m * north + (behind_m - ground_range_m) * east
        north_m = target.north_m + beside_m * east + (behind_m - ground_range_m) * north
        top_m, is_object = _profile(bodies, np.asarray(sea.world.elevation_m(east_m, north_m)), east_m, north_m)
        slope = (top_m - sonar_m) / behind_m
        is_lit = slope >= np.maximum.accumulate(slope) - 1e-9  # of rounding
        shown = np.flatnonzero(is_object & is_lit)
        if not len(shown):
            continue
        after = np.flatnonzero(is_lit[shown[-1] + 1 :])
        if not len(after):
            continue
        ends = np.array([shown[-1], shown[-1] + 1 + after[0]])
        # The page takes ground ranges from slant ranges over a level floor.
        slant_m = np.hypot(behind_m[ends], sonar_m - top_m[ends])
        lit_m, end_m = np.sqrt(np.maximum(slant_m**2 - altitude_m**2, 0.0))
        height_m = shadow_height_m(altitude_m, float(lit_m), float(end_m))
        best_m = height_m if best_m is None else max(best_m, height_m)
    return best_m


def _profile(
    bodies: Bodies, floor_m: NDArray[np.float64], east_m: NDArray[np.float64], north_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Put bodies on a profile of the floor; returns its heights, m, and where a body is the top, both (n,)."""
    top_m, is_object = floor_m, np.zeros(len(floor_m), dtype=np.bool_)
    for body in bodies.table:
        kind, body_east_m, body_north_m, _, sine, cosine, base_m = body[:7]
        over_east_m, over_north_m = east_m - body_east_m, north_m - body_north_m
        along_m = over_east_m * sine + over_north_m * cosine
        across_m = over_east_m * cosine - over_north_m * sine
        rise_m, _, _, is_covered = body_tops(body, bodies.planes, along_m, across_m)
        if kind >= MOVES_FLOOR:
            top_m = np.where(is_covered, top_m + rise_m, top_m)
            continue
        rules = is_covered & (base_m + rise_m > top_m)
        top_m = np.where(rules, base_m + rise_m, top_m)
        is_object |= rules
    return top_m, is_object
