"""C and numpy render the same bytes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.simulator import backend
from sim_replay.simulator.backscatter import TABLE_SIZE
from sim_replay.simulator.bodies import CONE, CYLINDER, ELLIPSOID, MOAT, POLYHEDRON, SCAR, TORUS, Bodies, Body, pack
from sim_replay.simulator.render import Rendered, render_numpy, render_pings
from sim_replay.simulator.world import Patches
from tests.sim_replay.simulator.rendered_lines import EVEN, EVEN_BEAM, POOL, SEABED, TURN, rays

needs_c = pytest.mark.skipif(backend.library() is None, reason=f"no C library: {backend.simulator_library().reason}")
TEXTURE = np.random.Generator(np.random.PCG64(4)).gamma(4.0, 0.25, POOL.shape).astype(np.float32)
PLACE, PART = st.floats(-12.0, 12.0), st.floats(0.1, 1.0)


def any_body(kind: int) -> st.SearchStrategy[Body]:
    def built(
        east: float, north: float, azimuth: float, base: float, a: float, b: float, c: float, tilt: float
    ) -> Body:
        sizes = {
            ELLIPSOID: (a, b, c, 0.5 * c),
            CYLINDER: (0.5 * a, b, 0.4 * c, math.sin(tilt), math.cos(tilt)),
            CONE: (a, b * a, c, 0.2 * c),
            TORUS: (a, 0.3 * b, 0.2 * c, 0.1),
            SCAR: (4.0 * a, b, 0.3 * c),
            MOAT: (a, b, 0.2 * c, 0.6),
        }
        place = (kind, east, north, base, azimuth, 5.0)
        if kind != POLYHEDRON:
            return Body(*place, sizes[kind], 2)
        planes = (
            (1.0, 0.0, a),
            (-1.0, 0.0, a),
            (0.0, 1.0, b),
            (0.0, -1.0, b),
            (0.6, 0.8, 0.9 * a),
            (tilt, 0.0, c),
            (-0.5, 0.2, c),
        )
        return Body(*place, (), 2, planes, 5)

    return st.builds(
        built, PLACE, PLACE, TURN, st.floats(-0.3, 0.3), PART, PART, PART, st.sampled_from([0.0, 0.1, 0.4])
    )


BODIES = st.lists(st.one_of(*(any_body(kind) for kind in range(7))), max_size=12).map(pack)


@needs_c
@given(
    seed=st.integers(0, 2**32),
    bodies=BODIES,
    elevation_m=st.floats(0.2, 9.0),
    pitch_rad=st.floats(-0.5, 0.5),
    roll_rad=st.floats(-0.5, 0.5),
    bin_m=st.sampled_from([0.007, 0.02, 0.05, 0.4]),
    n_bins=st.integers(1, 400),
)
@settings(max_examples=150)
def test_c_and_numpy_give_the_same_bytes(
    seed: int, bodies: Bodies, elevation_m: float, pitch_rad: float, roll_rad: float, bin_m: float, n_bins: int
) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    size, n_lines, n_nodes = 4, 35, 210
    patches = Patches(POOL, TEXTURE, SEABED, random.integers(0, 3, (size, size)).astype(np.int32), -2, -2)
    place = random.uniform(-280.0, 280.0, (2, n_lines))
    lines = rays(
        place[0],
        place[1],
        random.uniform(-math.pi, math.pi, n_lines),
        elevation_m,
        pitch_rad=pitch_rad,
        roll_rad=roll_rad,
        ping=random.integers(0, 4, n_lines),
    )
    tables = random.uniform(0.0, 1.0, (3, TABLE_SIZE)).astype(np.float32)
    beam = random.uniform(0.0, 1.0, TABLE_SIZE).astype(np.float32)

    compiled, plain = (
        work(
            lines,
            patches,
            bodies,
            tables,
            beam,
            cell_m=0.05,
            n_nodes=n_nodes,
            n_pings=4,
            n_bins=n_bins,
            bin_m=bin_m,
            keep_nodes=True,
        )
        for work in (render_pings, render_numpy)
    )
    for name, one, other in zip(Rendered._fields, compiled, plain, strict=True):
        assert one is not None
        assert other is not None
        assert one.tobytes() == other.tobytes(), name
    assert np.isfinite(compiled.energy).all()


def test_patches_may_lie_anywhere_without_a_bit_of_difference() -> None:
    """The same rays over the same floor, the request of which began elsewhere."""
    lines = rays(np.linspace(-200.0, 200.0, 9), -37.3, np.linspace(0.0, 6.0, 9), 5.0)
    small = np.arange(16, dtype=np.int32).reshape(4, 4) % 3
    large = np.zeros((9, 8), dtype=np.int32)
    large[3:7, 2:6] = small

    def energy(slots: NDArray[np.int32], first_row: int, first_column: int) -> bytes:
        patches = Patches(POOL, TEXTURE, SEABED, slots, first_row, first_column)
        body = Body(ELLIPSOID, -1.0, -3.0, 0.0, 0.3, 0.6, (0.5, 0.4, 0.4, 0.3), 1)
        return render_pings(
            lines, patches, pack([body]), EVEN, EVEN_BEAM, cell_m=0.05, n_nodes=210, n_pings=9, n_bins=200, bin_m=0.05
        ).energy.tobytes()

    assert energy(small, -2, -2) == energy(large, -5, -4)
