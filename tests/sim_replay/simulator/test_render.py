"""Rays over a height field against closed-form shadows, a slow ray caster and sums of areas, and C against numpy."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.simulator import backend
from sim_replay.simulator.backscatter import TABLE_SIZE
from sim_replay.simulator.bodies import CONE, CYLINDER, ELLIPSOID, MOAT, POLYHEDRON, SCAR, TORUS, Bodies, Body, pack
from sim_replay.simulator.render import Rendered, render_numpy, render_pings
from sim_replay.simulator.world import NODES, Patches
from tests.sim_replay.simulator.rendered_lines import (
    EVEN,
    EVEN_BEAM,
    NO_BODIES,
    TURN,
    Floats,
    block,
    flat_patches,
    rays,
    rendered,
)

Height: TypeAlias = Callable[[Floats, Floats], Floats]
needs_c = pytest.mark.skipif(backend.library() is None, reason=f"no C library: {backend.simulator_library().reason}")


def one_patch(elevation_m: NDArray[np.float32]) -> Patches:
    """A patch that is `elevation_m` in its south-western corner and level elsewhere."""
    pool = np.zeros((1, NODES, NODES), dtype=np.float32)
    pool[0, : elevation_m.shape[0], : elevation_m.shape[1]] = elevation_m
    return Patches(pool, np.ones_like(pool), np.zeros(pool.shape, np.uint8), np.zeros((1, 1), np.int32), 0, 0)


def bilinear(elevation_m: NDArray[np.float32], north_cells: Floats, east_cells: Floats) -> Floats:
    heights = elevation_m.astype(np.float64)
    row, column = (np.minimum(places.astype(int), heights.shape[0] - 2) for places in (north_cells, east_cells))
    down, right = north_cells - row, east_cells - column
    south = heights[row, column] * (1.0 - right) + heights[row, column + 1] * right
    north = heights[row + 1, column] * (1.0 - right) + heights[row + 1, column + 1] * right
    return np.asarray(south * (1.0 - down) + north * down)


def clearance(profile: Callable[[Floats], Floats], node: int, elevation_m: float, cell_m: float) -> float:
    """Least height of the line from the sonar to a node over the profile before it, over ground range; in tenths of a
    cell.
    """
    at = np.arange(1, 10 * node) / 10.0
    line_m = elevation_m + at / node * (profile(np.array([float(node)]))[0] - elevation_m)
    return float(np.min((line_m - profile(at)) / (at * cell_m), initial=np.inf))


@given(
    seed=st.integers(0, 2**32),
    rough_m=st.sampled_from([0.02, 0.1, 0.5]),
    elevation_m=st.floats(0.3, 4.0),
    quarter=st.integers(0, 3),
    aside=st.floats(1.0, 60.0),
    turn_rad=st.sampled_from([0.0, 0.0, 0.3, -0.7]),
)
@settings(max_examples=40)
def test_nodes_are_lit_where_a_slow_ray_caster_sees_them(
    seed: int, rough_m: float, elevation_m: float, quarter: int, aside: float, turn_rad: float
) -> None:
    """Along the grid the profile is the bilinear floor itself, across it that floor taken at the nodes."""
    cell_m, n = 0.05, 64
    random = np.random.Generator(np.random.PCG64(seed))
    floor = np.cumsum(random.normal(0.0, rough_m, (n, n)), axis=int(random.integers(2))).astype(np.float32)
    floor -= floor.mean()
    north, east = ((0.0, aside), (aside, 0.0), (62.0, aside), (aside, 62.0))[quarter]
    direction = 0.5 * math.pi * quarter + turn_rad
    n_nodes = 62
    if turn_rad != 0.0:
        (north, east), n_nodes = ((20.0, 31.0), (31.0, 20.0), (42.0, 31.0), (31.0, 42.0))[quarter], 24
    elevation_m += float(bilinear(floor, np.array([north]), np.array([east]))[0])
    lines = rays(north, east, direction, elevation_m)
    out = rendered(lines, one_patch(floor), cell_m=cell_m, n_nodes=n_nodes, n_bins=50, bin_m=0.1, keep_nodes=True)
    nodes = np.arange(n_nodes, dtype=np.float64)

    def along(at: Floats) -> Floats:
        return bilinear(
            floor, np.maximum(north + at * math.cos(direction), 0.0), np.maximum(east + at * math.sin(direction), 0.0)
        )

    def profile(at: Floats) -> Floats:
        return along(at) if turn_rad == 0.0 else np.interp(at, nodes, along(nodes))

    assert out.lit is not None
    for node in range(1, n_nodes):
        free = clearance(profile, node, elevation_m, cell_m)
        if abs(free) > 1e-4:  # positions are rounded to float32
            assert (out.lit[0, node] > 0.0) == (free > 0.0), node


def test_a_facet_is_lit_as_far_as_the_shadow_before_it_leaves_it() -> None:
    cell_m, altitude_m = 0.1, 5.0
    heights = np.zeros((64, 64), dtype=np.float32)
    heights[:, 20] = 0.5
    out = rendered(
        rays(30.0, 0.0, 0.5 * math.pi, altitude_m),
        one_patch(heights),
        cell_m=cell_m,
        n_nodes=40,
        n_bins=80,
        bin_m=0.1,
        keep_nodes=True,
    )
    assert out.lit is not None
    end_cells = 20.0 * altitude_m / (altitude_m - 0.5)
    expected = np.ones(40)
    expected[0] = 0.0
    expected[21:23] = 0.0
    expected[math.ceil(end_cells)] = math.ceil(end_cells) - end_cells
    np.testing.assert_allclose(out.lit[0], expected, atol=1e-5)


def rough_pool(seed: int) -> NDArray[np.float32]:
    """Patches of three roughnesses: level, rough, and steep."""
    random = np.random.Generator(np.random.PCG64(seed))
    rough = random.normal(0.0, 0.02, (NODES, NODES))
    steep = np.cumsum(random.normal(0.0, 0.03, (NODES, NODES)), axis=1)
    return np.stack([np.zeros((NODES, NODES)), rough, steep - steep.mean()]).astype(np.float32)


POOL = rough_pool(3)
TEXTURE = np.random.Generator(np.random.PCG64(4)).gamma(4.0, 0.25, POOL.shape).astype(np.float32)
SEABED = np.random.Generator(np.random.PCG64(5)).integers(0, 2, POOL.shape).astype(np.uint8)


@given(
    seed=st.integers(0, 2**32),
    direction_rad=st.floats(-math.pi, math.pi),
    bin_m=st.sampled_from([0.004, 0.02, 0.05, 0.3, 100.0]),
    pitch_rad=st.floats(-0.3, 0.3),
    n_bins=st.integers(1, 300),
)
@settings(max_examples=40)
def test_no_energy_is_lost_or_made_on_the_way_into_bins(
    seed: int, direction_rad: float, bin_m: float, pitch_rad: float, n_bins: int
) -> None:
    """Against the areas of the facets in double precision, from heights and slopes of the bilinear floor."""
    cell_m, n_nodes, slot = 0.05, 100, seed % 3
    patches = Patches(
        POOL[slot : slot + 1], np.ones_like(POOL[:1]), np.zeros_like(SEABED[:1]), np.zeros((1, 1), np.int32), 0, 0
    )
    lines = rays(128.0 + seed % 7 / 7.0, 128.4, direction_rad, 6.0, pitch_rad=pitch_rad)
    out = rendered(lines, patches, cell_m=cell_m, n_nodes=n_nodes, n_bins=n_bins, bin_m=bin_m, keep_nodes=True)
    assert out.lit is not None
    nodes = np.arange(n_nodes, dtype=np.float64)
    north = lines.north_cells[0] + nodes * lines.step_north[0]
    east = lines.east_cells[0] + nodes * lines.step_east[0]
    z = bilinear(POOL[slot], north, east)
    row, column = north.astype(int), east.astype(int)
    heights = POOL[slot].astype(np.float64)
    corners = [heights[row + i, column + k] for i in (0, 1) for k in (0, 1)]
    down, right = north - row, east - column
    to_north = (corners[2] - corners[0]) * (1.0 - right) + (corners[3] - corners[1]) * right
    to_east = (corners[1] - corners[0]) * (1.0 - down) + (corners[3] - corners[2]) * down
    q = (-to_north * math.sin(direction_rad) + to_east * math.cos(direction_rad))[1:] / cell_m
    s = np.diff(z) / cell_m
    area = cell_m * np.sqrt(1.0 + s**2 + q**2) * out.lit[0, 1:]
    assert float(out.energy.sum() + out.beyond.sum()) == pytest.approx(float(area.sum()), rel=2e-5)
    whole = render_pings(
        lines, patches, NO_BODIES, EVEN, EVEN_BEAM, cell_m=cell_m, n_nodes=n_nodes, n_pings=1, n_bins=1, bin_m=1e3
    )
    assert float(out.energy.sum() + out.beyond.sum()) == pytest.approx(float(whole.energy[0, 0]), rel=1e-6)


@given(bin_m=st.floats(0.003, 0.5), altitude_m=st.floats(1.0, 20.0), weight=st.floats(0.1, 1.0))
@settings(max_examples=40)
def test_a_level_floor_fills_every_bin_by_its_ground(bin_m: float, altitude_m: float, weight: float) -> None:
    """Bins that begin beyond the first node hold sqrt((r + dr)^2 - H^2) - sqrt(r^2 - H^2) metres of floor, up to what
    takes a facet's energy as even over its slant ranges.
    """
    cell_m, n_nodes = 0.05, 800
    lines = rays(0.3, 0.2, 1.0, altitude_m)._replace(weight=np.array([weight]))
    n_bins = int((math.hypot((n_nodes - 2) * cell_m, altitude_m)) / bin_m)
    out = rendered(lines, flat_patches(), cell_m=cell_m, n_nodes=n_nodes, n_bins=n_bins, bin_m=bin_m)
    edges = np.sqrt(np.maximum((np.arange(n_bins + 1) * bin_m) ** 2 - altitude_m**2, 0.0))
    cumulative = np.concatenate([[0.0], np.cumsum(out.energy[0])]) / weight
    np.testing.assert_allclose(cumulative, edges, atol=0.25 * cell_m)
    far = edges[:-1] > 40.0 * cell_m
    np.testing.assert_allclose(out.energy[0, far] / weight, np.diff(edges)[far], rtol=2e-2)


def material(profile: Callable[[Floats], Floats]) -> NDArray[np.float32]:
    """Tables: nothing from the floor, and for bodies a function of the sine of grazing."""
    sine = (np.arange(TABLE_SIZE) + 0.5) / TABLE_SIZE
    return np.stack([np.zeros(TABLE_SIZE), profile(sine)]).astype(np.float32)


def box_echo(tables: NDArray[np.float32], turned_rad: float, cell_m: float = 0.005) -> tuple[float, float]:
    """Energy of a box of 1 m by 1 m by 0.5 m turned by an angle, 10 m away and 4 m below, by a ray through its middle,
    and what Lambert's law gives: the wall's height and the top's length across the slice, each by its squared cosine of
    incidence.
    """
    body = block(1.0, 1.0, ((0.0, 0.0, 0.5),))._replace(north_m=0.0, east_m=10.0, azimuth_rad=turned_rad)
    out = rendered(
        rays(0.0, 0.0, 0.5 * math.pi, 4.0),
        flat_patches(24),
        tables=tables,
        bodies=pack([body]),
        cell_m=cell_m,
        n_nodes=int(12.0 / cell_m),
        n_bins=1,
        bin_m=100.0,
    )
    front_m = 10.0 - 0.5 / math.cos(turned_rad)
    on_wall = (front_m / math.hypot(front_m, 3.75) * math.cos(turned_rad)) ** 2
    on_top = (3.5 / math.hypot(10.0, 3.5)) ** 2
    return float(out.energy[0, 0]), (0.5 * on_wall + on_top) / math.cos(turned_rad)


@pytest.mark.parametrize("turned_deg", [-40.0, -20.0, 0.0, 10.0, 30.0])
def test_walls_are_as_bright_as_they_are_turned(turned_deg: float) -> None:
    energy, expected = box_echo(material(np.square), math.radians(turned_deg))
    assert energy == pytest.approx(expected, rel=0.02)


def test_a_wall_flashes_broadside() -> None:
    tables = material(lambda sine: np.asarray(sine**40))
    broadside, turned, edge_on = (box_echo(tables, math.radians(angle))[0] for angle in (0.0, 15.0, 40.0))
    assert broadside > 3.0 * turned > 100.0 * edge_on


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_beam_is_looked_up_by_the_angle_off_its_axis(side: float) -> None:
    """Pitch and roll included: a beam table that is 1 within a band lights just the slant ranges that lie in it."""
    altitude_m, axis_rad, pitch_rad = 6.0, 0.4, 0.2
    beam = np.zeros(TABLE_SIZE, dtype=np.float32)
    low, high = sorted((side * 0.1, side * 0.3))
    beam[int((1.0 + low) * 0.5 * TABLE_SIZE) : int((1.0 + high) * 0.5 * TABLE_SIZE)] = 1.0
    out = rendered(
        rays(0.0, 0.0, 2.0, altitude_m, pitch_rad=pitch_rad),
        flat_patches(),
        beam=beam,
        cell_m=0.05,
        n_nodes=900,
        n_bins=900,
        bin_m=0.05,
    )
    r = (np.flatnonzero(out.energy[0]) + 0.5) * 0.05
    down = np.arcsin(altitude_m / math.cos(pitch_rad) / r)
    off = np.sin(down - axis_rad)
    tolerance = 0.06 * np.abs(np.gradient(off, r))
    assert np.all((off > low - tolerance) & (off < high + tolerance))
    assert len(r) > 5


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
