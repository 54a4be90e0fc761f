"""Bodies against what lies inside of them, point by point, and slopes against differences of heights."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.simulator.bodies import (
    CONE,
    CYLINDER,
    ELLIPSOID,
    MOAT,
    POLYHEDRON,
    SCAR,
    TORUS,
    Bodies,
    Body,
    Planes,
    body_tops,
    body_wall,
    near,
    pack,
)

Floats: TypeAlias = NDArray[np.float64]
Inside: TypeAlias = Callable[[Floats, Floats, Floats], NDArray[np.bool_]]


class Solid(NamedTuple):
    """A body, packed, and which points (u, v, height over its base) lie in it."""

    bodies: Bodies
    inside: Inside


def packed(kind: int, sizes: tuple[float, ...] = (), planes: Planes = (), n_sides: int = 0) -> Bodies:
    return pack([Body(kind, 0.0, 0.0, 0.0, 0.0, 3.0, sizes, 0, planes, n_sides)])


def ellipsoid(a: float, b: float, c: float, centre: float) -> Solid:
    return Solid(
        packed(ELLIPSOID, (a, b, c, centre)),
        lambda u, v, z: (u / a) ** 2 + (v / b) ** 2 + ((z - centre) / c) ** 2 <= 1.0,
    )


def cylinder(radius: float, half_length: float, centre: float, tilt: float) -> Solid:
    sine, cosine = math.sin(tilt), math.cos(tilt)

    def inside(u: Floats, v: Floats, z: Floats) -> NDArray[np.bool_]:
        along, up = u * cosine + (z - centre) * sine, (z - centre) * cosine - u * sine
        return np.asarray((np.abs(along) <= half_length) & (up**2 + v**2 <= radius**2))

    return Solid(packed(CYLINDER, (radius, half_length, centre, sine, cosine)), inside)


def cone(base: float, top: float, height: float, burial: float) -> Solid:
    def inside(u: Floats, v: Floats, z: Floats) -> NDArray[np.bool_]:
        up = z + burial
        return np.asarray((up >= 0.0) & (up <= height) & (np.hypot(u, v) <= base - (base - top) * up / height))

    return Solid(packed(CONE, (base, top, height, burial)), inside)


def polyhedron(length: float, width: float, height: float, ramp: float, hip: float) -> Solid:
    sides = (
        (1.0, 0.0, length),
        (-1.0, 0.0, length),
        (0.0, 1.0, width),
        (0.0, -1.0, width),
        (0.6, 0.8, 0.8 * (length + width) / 1.4),
    )
    tops = ((ramp, 0.0, height), (-0.2, hip, height), (0.0, -hip, 0.9 * height))

    def inside(u: Floats, v: Floats, z: Floats) -> NDArray[np.bool_]:
        within = np.ones(np.broadcast_shapes(u.shape, z.shape), dtype=np.bool_)
        for a, b, d in sides:
            within &= a * u + b * v <= d
        for a, b, c in tops:
            within &= z <= a * u + b * v + c
        return within

    return Solid(packed(POLYHEDRON, (), sides + tops, len(sides)), inside)


def torus(ring: float, half_width: float, half_height: float, centre: float) -> Solid:
    def inside(u: Floats, v: Floats, z: Floats) -> NDArray[np.bool_]:
        return np.asarray(((np.hypot(u, v) - ring) / half_width) ** 2 + ((z - centre) / half_height) ** 2 <= 1.0)

    return Solid(packed(TORUS, (ring, half_width, half_height, centre)), inside)


SIZE = st.floats(0.2, 1.2)
SOLIDS = st.one_of(
    st.builds(ellipsoid, SIZE, SIZE, SIZE, st.floats(-0.3, 1.0)),
    st.builds(cylinder, SIZE, SIZE, st.floats(-0.2, 1.0), st.sampled_from([0.0, 0.05, 0.3, 0.7])),
    st.builds(cone, st.floats(0.6, 1.2), st.floats(0.1, 0.6), SIZE, st.floats(0.0, 0.2)),
    st.builds(polyhedron, SIZE, SIZE, SIZE, st.floats(-0.5, 0.5), st.floats(-0.4, 0.4)),
    st.builds(torus, st.floats(0.4, 0.9), st.floats(0.1, 0.3), st.floats(0.1, 0.3), st.floats(0.0, 0.4)),
)
FLOOR_FORMS = st.one_of(
    st.builds(lambda a, b, c: packed(SCAR, (3.0 * a, b, c)), SIZE, SIZE, SIZE),
    st.builds(lambda a, b, c, d: packed(MOAT, (a, b, c, d)), SIZE, SIZE, SIZE, st.floats(0.2, 0.8)),
)
PLACES = st.lists(st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)), min_size=1, max_size=20)


def tops(bodies: Bodies, u: Floats, v: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    return body_tops(bodies.table[0], bodies.planes, u, v)


@given(solid=SOLIDS, places=PLACES)
@settings(max_examples=100)
def test_tops_are_the_highest_points_inside(solid: Solid, places: list[tuple[float, float]]) -> None:
    u, v = np.array(places).T
    top, _, _, covered = tops(solid.bodies, u, v)
    heights = np.linspace(-3.0, 3.0, 1501)
    within = solid.inside(u[:, None], v[:, None], heights[None, :])
    assert covered[within.sum(axis=1) > 1].all()
    assert solid.inside(u, v, top - 1e-7)[covered & (within.sum(axis=1) > 0)].all()
    assert not (solid.inside(u, v, top + 1e-7)[covered]).any()
    above = within & (heights[None, :] > top[:, None] + 1e-7)
    assert not above[covered].any()


@given(bodies=st.one_of(SOLIDS.map(lambda solid: solid.bodies), FLOOR_FORMS), places=PLACES)
@settings(max_examples=100)
def test_slopes_are_differences_of_heights(bodies: Bodies, places: list[tuple[float, float]]) -> None:
    u, v = np.array(places).T
    step = 1e-6
    _, slope_u, slope_v, covered = tops(bodies, u, v)
    for axis, slope in ((0, slope_u), (1, slope_v)):
        du, dv = (step, 0.0) if axis == 0 else (0.0, step)
        ahead, *_, ahead_covered = tops(bodies, u + du, v + dv)
        behind, *_, behind_covered = tops(bodies, u - du, v - dv)
        here, *_ = tops(bodies, u, v)
        right, left = (ahead - here) / step, (here - behind) / step
        smooth = covered & ahead_covered & behind_covered & (np.abs(right - left) < 1e-2)
        np.testing.assert_allclose(slope[smooth], 0.5 * (right + left)[smooth], atol=2e-2)


@given(solid=SOLIDS, turn=st.floats(-math.pi, math.pi), aside=st.floats(-0.5, 0.5))
@settings(max_examples=100)
def test_walls_face_away_from_the_body(solid: Solid, turn: float, aside: float) -> None:
    """From just outside, against the normal of the wall comes the body, and along it nothing."""
    away = np.linspace(0.0, 3.0, 6001)
    start = np.array([-aside * math.sin(turn), aside * math.cos(turn)])
    *_, covered = tops(solid.bodies, start[0] + away * math.cos(turn), start[1] + away * math.sin(turn))
    if not covered.any():
        return
    outside = start + away[np.flatnonzero(covered)[-1] + 1] * np.array([math.cos(turn), math.sin(turn)])
    normal = np.array(body_wall(solid.bodies.table[0], solid.bodies.planes, *outside.tolist()))
    normal /= np.linalg.norm(normal)
    depths = np.linspace(0.0, 0.05, 200)
    *_, behind = tops(solid.bodies, outside[0] - depths * normal[0], outside[1] - depths * normal[1])
    *_, before = tops(solid.bodies, outside[0] + depths * normal[0], outside[1] + depths * normal[1])
    assert not before.any()
    assert behind.any() or float(np.cos(turn) * normal[0] + np.sin(turn) * normal[1]) < 0.2


def test_a_scar_is_a_trench_between_banks_that_fade_at_its_ends() -> None:
    scar = packed(SCAR, (10.0, 1.2, 0.25))
    across = np.linspace(-1.3, 1.3, 261)
    top, *_, covered = tops(scar, np.zeros_like(across), across)
    assert top.min() == pytest.approx(-0.25)
    assert across[np.argmin(top)] == pytest.approx(0.0, abs=1e-9)
    assert top[covered].max() == pytest.approx(0.514 * 0.25, rel=1e-2)
    np.testing.assert_array_equal(covered, np.abs(across) < 1.2)
    along, *_ = tops(scar, np.array([0.0, 9.0, 9.7, 9.99]), np.zeros(4))
    assert np.all(np.diff(along) >= 0.0)
    assert along[-1] > -0.01


def test_a_moat_is_deepest_along_the_outline() -> None:
    moat = packed(MOAT, (1.0, 0.5, 0.2, 0.6))
    turn = np.linspace(0.0, 2.0 * math.pi, 50)
    top, *_ = tops(moat, np.cos(turn), 0.5 * np.sin(turn))
    np.testing.assert_allclose(top, -0.2)
    *_, covered = tops(moat, np.array([0.0, 1.61]), np.zeros(2))
    assert not covered.any()


def test_bodies_that_move_the_floor_come_first() -> None:
    plain = Body(ELLIPSOID, 1.0, 2.0, 0.0, 0.0, 1.0, (1.0, 1.0, 1.0, 0.0))
    bodies = pack([plain, plain._replace(kind=MOAT), plain._replace(kind=CONE), plain._replace(kind=SCAR)])
    np.testing.assert_array_equal(bodies.table[:, 0], [MOAT, SCAR, ELLIPSOID, CONE])


def test_near_are_those_that_reach_into_the_rectangle() -> None:
    bodies = pack(
        [Body(ELLIPSOID, east, 0.0, 0.0, 0.0, 1.0, (1.0, 1.0, 1.0, 0.0)) for east in (-3.0, -1.5, 0.0, 4.5, 6.5)]
    )
    found = near(bodies, -0.6, 5.0, -0.5, 0.5)
    np.testing.assert_array_equal(found.table[:, 1], [-1.5, 0.0, 4.5])
    assert len(near(bodies, -0.6, 5.0, 1.5, 3.0).table) == 0
