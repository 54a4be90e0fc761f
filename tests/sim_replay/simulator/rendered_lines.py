"""Lines of rays over small patches of a height field."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.simulator.backscatter import TABLE_SIZE
from sim_replay.simulator.bodies import POLYHEDRON, Bodies, Body, pack
from sim_replay.simulator.render import Lines, Rendered, render_pings
from sim_replay.simulator.world import NODES, Patches

Floats: TypeAlias = NDArray[np.float64]
NO_BODIES = pack([])
EVEN = np.ones((2, TABLE_SIZE), dtype=np.float32)
EVEN_BEAM = np.ones(TABLE_SIZE, dtype=np.float32)


def flat_patches(size: int = 10) -> Patches:
    """A level floor at height 0 about the origin; all its patches are one."""
    shape = (1, NODES, NODES)
    slots = np.zeros((size, size), dtype=np.int32)
    return Patches(
        np.zeros(shape, np.float32),
        np.ones(shape, np.float32),
        np.zeros(shape, np.uint8),
        slots,
        -(size // 2),
        -(size // 2),
    )


def rays(
    north_cells: Floats | float,
    east_cells: Floats | float,
    direction_rad: Floats | float,
    elevation_m: Floats | float,
    *,
    roll_rad: float = 0.0,
    pitch_rad: float = 0.0,
    ping: NDArray[np.int64] | None = None,
) -> Lines:
    """Rays of steps of one cell, each a ping of its own by default."""
    north, east, direction, elevation = np.broadcast_arrays(
        *np.atleast_1d(north_cells, east_cells, direction_rad, elevation_m)
    )
    one = np.ones(north.shape)
    return Lines(
        north_cells=north * one,
        east_cells=east * one,
        step_north=np.cos(direction),
        step_east=np.sin(direction),
        elevation_m=elevation * one,
        slant_factor=one / math.cos(pitch_rad),
        axis_cos=one * math.cos(0.4 + roll_rad),
        axis_sin=one * math.sin(0.4 + roll_rad),
        weight=one,
        ping=np.arange(len(one)) if ping is None else ping,
    )


def rendered(
    lines: Lines,
    patches: Patches,
    bodies: Bodies = NO_BODIES,
    tables: NDArray[np.float32] = EVEN,
    beam: NDArray[np.float32] = EVEN_BEAM,
    **grid: Any,
) -> Rendered:
    """Render one ping over a floor and under a beam that are even, with no body on it, unless others are given."""
    return render_pings(lines, patches, bodies, tables, beam, n_pings=1, **grid)


def block(length_m: float, width_m: float, planes: tuple[tuple[float, float, float], ...]) -> Body:
    sides = (
        (1.0, 0.0, 0.5 * length_m),
        (-1.0, 0.0, 0.5 * length_m),
        (0.0, 1.0, 0.5 * width_m),
        (0.0, -1.0, 0.5 * width_m),
    )
    return Body(POLYHEDRON, 0.0, 0.0, 0.0, 0.0, math.hypot(length_m, width_m), (), 1, sides + planes, 4)


TURN, BURIED = st.floats(-math.pi, math.pi), st.floats(0.0, 0.6)
