"""Measure where the simulator's shadows end, against the closed forms of the shapes that cast them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.solids.shapes import Box, Cylinder, Shape, Sphere, TruncatedCone, Wedge, view_shape
from sim_replay.simulator.backscatter import TABLE_SIZE
from sim_replay.simulator.bodies import pack
from sim_replay.simulator.objects import PlacedObject, bodies_of, place_objects
from sim_replay.simulator.render import Lines, render_pings
from sim_replay.simulator.scene import Lawnmower, ObjectKind, Scene, SceneObject, Track
from sim_replay.simulator.world import NODES, Patches

_ALTITUDE_M: Final = 6.0  # m above the sea floor
_SOLIDS: Final[dict[ObjectKind, Callable[[PlacedObject], Shape]]] = {
    "sphere": lambda p: Sphere(radius_m=0.5 * p.width_m),
    "cylinder": lambda p: Cylinder(radius_m=0.5 * p.width_m, length_m=p.length_m, azimuth_rad=p.azimuth_rad),
    "truncated_cone": lambda p: TruncatedCone(
        base_radius_m=0.5 * p.width_m, top_radius_m=0.5 * p.top_m, height_m=p.height_m
    ),
    "wedge": lambda p: Wedge(length_m=p.length_m, width_m=p.width_m, height_m=p.height_m, azimuth_rad=p.azimuth_rad),
    "box": lambda p: Box(length_m=p.length_m, width_m=p.width_m, height_m=p.height_m, azimuth_rad=p.azimuth_rad),
}


def shadow_errors_m(cell_m: float) -> NDArray[np.float64]:
    """Measure how far beyond the closed form shadows of usual mine shapes end, m.

    At 10 to 30 m on a level floor, by rays through their middles.
    """
    shape = (1, NODES, NODES)
    size = 2 * math.ceil(45.0 / cell_m / (NODES - 1) + 1)
    level = Patches(
        np.zeros(shape, np.float32),
        np.ones(shape, np.float32),
        np.zeros(shape, np.uint8),
        np.zeros((size, size), np.int32),
        -(size // 2),
        -(size // 2),
    )
    one, n_nodes = np.ones(1), math.ceil(45.0 / cell_m)
    ray = Lines(0 * one, 0 * one, 0 * one, one, _ALTITUDE_M * one, one, one, 0 * one, one, np.zeros(1, np.int64))
    even = np.ones((2, TABLE_SIZE), dtype=np.float32)
    errors = []
    for kind, solid in _SOLIDS.items():
        for turn, ground_range_m in enumerate(np.linspace(10.0, 30.0, 41).tolist()):
            scene_object = SceneObject(kind=kind, east_m=ground_range_m, north_m=0.0, azimuth_deg=37.0 * turn % 360.0)
            (placed,) = place_objects(Scene(objects=(scene_object,), track=Track(plan=Lawnmower())))
            lit = render_pings(
                ray,
                level,
                pack(bodies_of(placed, lambda east_m, north_m: 0.0, 1)),
                even,
                even[0],
                cell_m=cell_m,
                n_nodes=n_nodes,
                n_pings=1,
                n_bins=1,
                bin_m=1e3,
                keep_nodes=True,
            ).lit
            assert lit is not None
            last = int(np.flatnonzero(lit[0] < 1.0)[-1])
            if last > 0:  # node 0 ends no facet; ramps may be lit down to the floor
                expected = view_shape(solid(placed), 0.0, ground_range_m, _ALTITUDE_M).shadow_end_m
                errors.append((last - float(lit[0, last])) * cell_m - float(expected))
    return np.array(errors)
