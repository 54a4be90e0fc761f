"""Closed forms against each other and at their limits: larger, mirrored, far away, buried, without length."""

from __future__ import annotations

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from auv_mcm.solids.shapes import (
    Box,
    ConvexPolyhedron,
    Cylinder,
    Shape,
    Sphere,
    TruncatedCone,
    Wedge,
    flat_ground_range_m,
    view_shape,
)
from tests.auv_mcm.classify.sampled_views import Array, height_m, reach_m, sampled_parallel_end_m
from tests.auv_mcm.solids.solid_samples import (
    AZIMUTH,
    EVERY_SOLID,
    PINGS,
    POSE,
    RADIUS,
    RIGHT,
    SHARE,
    SIZE,
    SOLIDS,
    clear_of_edges,
)

ANY_SOLID = st.one_of(*SOLIDS.values())
GROWTH = st.floats(1.0, 1.5)


@settings(max_examples=200)
@given(
    ANY_SOLID,
    PINGS,
    POSE,
    GROWTH,
    st.sampled_from(["radius", "height", "length", "width", "burial", "range", "altitude"]),
)
def test_shadow_ends_no_nearer_for_larger_and_farther_and_less_buried_objects_and_lower_sonars(
    shape: Shape, pings: Array, pose: tuple[float, float], growth: float, what: str
) -> None:
    altitude = 1.6 * pose[0] * height_m(shape)
    ground_range, offset = 3.0 * reach_m(shape) + pose[1] * altitude, pings * reach_m(shape)
    before = view_shape(shape, offset, ground_range, altitude).shadow_end_m
    if what == "range":
        after = view_shape(shape, offset, ground_range * growth, altitude).shadow_end_m
    elif what == "altitude":
        before, after = view_shape(shape, offset, ground_range, altitude * growth).shadow_end_m, before
    else:
        after = view_shape(grown(shape, what, growth), offset, ground_range, altitude).shadow_end_m
    seen = ~np.isnan(before)
    assert np.all(after[seen] >= before[seen] - 1e-9)


def grown(shape: Shape, what: str, growth: float) -> Shape:
    """The solid with one size greater, or itself if it has no such size, as deep in the floor as before; or less
    deep."""
    b = shape.burial_m
    match shape, what:
        case _, "burial":
            return remade(shape, burial_m=b / growth)
        case Box() | Wedge(), "width":
            return remade(shape, width_m=shape.width_m * growth)
        case Sphere(), "radius":
            return Sphere(radius_m=shape.radius_m * growth, burial_m=b)
        case Cylinder(), "radius":
            return Cylinder(
                radius_m=shape.radius_m * growth, length_m=shape.length_m, azimuth_rad=shape.azimuth_rad, burial_m=b
            )
        case Cylinder(), "length":
            return Cylinder(
                radius_m=shape.radius_m, length_m=shape.length_m * growth, azimuth_rad=shape.azimuth_rad, burial_m=b
            )
        case TruncatedCone(), "radius":
            base, top = shape.base_radius_m * growth, shape.top_radius_m * growth
            return TruncatedCone(base_radius_m=base, top_radius_m=top, height_m=shape.height_m, burial_m=b)
        case TruncatedCone(), "height":
            base, top = shape.base_radius_m, shape.top_radius_m
            return TruncatedCone(base_radius_m=base, top_radius_m=top, height_m=shape.height_m * growth, burial_m=b)
        case Box(), "length":
            return Box(
                length_m=shape.length_m * growth,
                width_m=shape.width_m,
                height_m=shape.height_m,
                azimuth_rad=shape.azimuth_rad,
                burial_m=b,
            )
        case Box() | Wedge(), "height":
            return type(shape)(
                length_m=shape.length_m,
                width_m=shape.width_m,
                height_m=shape.height_m * growth,
                azimuth_rad=shape.azimuth_rad,
                burial_m=b,
            )
        case _:
            return shape


def remade(shape: Shape, **changes: object) -> Shape:
    """The solid with some fields changed, checked like any other."""
    return type(shape)(**{**{name: getattr(shape, name) for name in shape.__struct_fields__}, **changes})


@settings(max_examples=150)
@given(ANY_SOLID, PINGS, POSE)
def test_mirroring_along_the_track_mirrors_the_view(shape: Shape, pings: Array, pose: tuple[float, float]) -> None:
    offset, altitude = pings * reach_m(shape), pose[0] * height_m(shape)
    ground_range = reach_m(shape) + pose[1] * altitude
    match shape:
        case Sphere() | TruncatedCone():
            mirrored: Shape = shape
        case Cylinder() | Box():
            mirrored = remade(shape, azimuth_rad=-shape.azimuth_rad)
        case Wedge():  # no plane of symmetry across its axis: the reversed track sees it from the other end
            mirrored = remade(shape, azimuth_rad=math.pi - shape.azimuth_rad)
        case ConvexPolyhedron():
            mirrored = remade(shape, vertices_m=shape.vertices_m * [-1.0, 1.0, 1.0], azimuth_rad=-shape.azimuth_rad)
    offset = clear_of_edges(lambda offset: view_shape(shape, offset, ground_range, altitude), offset, 1e-6)
    for one, other in zip(
        view_shape(shape, offset, ground_range, altitude),
        view_shape(mirrored, -offset, ground_range, altitude),
        strict=True,
    ):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-6)


@EVERY_SOLID
def test_far_away_the_shadow_is_the_parallel_projection(kind: str) -> None:
    """Error of order one over altitude at constant ratio of ground range to altitude."""

    @settings(max_examples=10)
    @given(SOLIDS[kind], st.floats(0.5, 8.0))
    def check(shape: Shape, cotangent: float) -> None:
        reach = reach_m(shape)
        offset = np.linspace(-0.8, 0.8, 5) * reach
        offset = clear_of_edges(
            lambda offset: view_shape(shape, offset, 1000.0 * cotangent, 1000.0), offset, 10.0 * reach
        )
        parallel = sampled_parallel_end_m(shape, offset, cotangent)
        # H y / (H - z) - (y' + z cot) = z (y' + z cot) / (H - z)
        bound = height_m(shape) * (reach + height_m(shape) * cotangent)
        for altitude in (1e2, 1e3, 1e4):
            end = view_shape(shape, offset, altitude * cotangent, altitude).shadow_end_m - altitude * cotangent
            np.testing.assert_allclose(end, parallel, rtol=0.0, atol=1.01 * bound / (altitude - height_m(shape)) + 1e-9)

    check()


@given(RADIUS, st.floats(0.05, math.pi - 0.05), st.floats(-0.95, 0.95), POSE)
def test_a_cylinder_without_length_is_a_disc(
    radius: float, azimuth: float, share: float, pose: tuple[float, float]
) -> None:
    altitude = 2.0 * radius * pose[0]
    ground_range = 1.1 * radius + altitude * pose[1]
    offset = share * radius * math.sin(azimuth)
    across, top = -offset / math.tan(azimuth), radius + radius * math.sqrt(1.0 - share**2)
    for length in (0.0, 1e-12):
        view = view_shape(
            Cylinder(radius_m=radius, length_m=length, azimuth_rad=azimuth), offset, ground_range, altitude
        )
        assert view.shadow_end_m == pytest.approx(altitude * (ground_range + across) / (altitude - top), abs=1e-6)
        assert view.tangent_slant_range_m == pytest.approx(math.hypot(ground_range + across, altitude - top), abs=1e-6)
        assert view.front_slant_range_m == pytest.approx(math.hypot(ground_range + across, altitude - top), abs=1e-6)


@given(RADIUS, SIZE, SHARE, st.floats(-0.99, 0.99), POSE)
def test_a_cone_with_equal_radii_is_an_upright_cylinder(
    radius: float, height: float, buried: float, share: float, pose: tuple[float, float]
) -> None:
    top = height * (1.0 - buried)
    altitude = top * pose[0]
    ground_range = 1.1 * radius + altitude * pose[1]
    half = radius * math.sqrt(1.0 - share**2)
    for taper in (0.0, 1e-12, 1e-10):
        cone = TruncatedCone(
            base_radius_m=radius, top_radius_m=radius * (1.0 - taper), height_m=height, burial_m=buried * height
        )
        view = view_shape(cone, share * radius, ground_range, altitude)
        assert view.shadow_end_m == pytest.approx(altitude * (ground_range + half) / (altitude - top), abs=1e-6)
        assert view.tangent_slant_range_m == pytest.approx(math.hypot(ground_range + half, altitude - top), abs=1e-6)
        assert view.front_slant_range_m == pytest.approx(math.hypot(ground_range - half, altitude - top), abs=1e-6)
        beside = view_shape(cone, share * radius, ground_range, 0.5 * top)
        assert beside.front_slant_range_m == pytest.approx(ground_range - half, abs=1e-6)
        assert beside.tangent_slant_range_m == pytest.approx(math.hypot(ground_range - half, 0.5 * top), abs=1e-6)


def test_a_broadside_cylinder_is_a_sphere_in_its_middle() -> None:
    sphere, cylinder = (
        view_shape(shape, 0.0, 20.0, 5.0)
        for shape in (Sphere(radius_m=0.3, burial_m=0.1), Cylinder(radius_m=0.3, length_m=2.0, burial_m=0.1))
    )
    np.testing.assert_allclose(sphere, cylinder, rtol=0.0, atol=1e-12)
    # d, asin(radius / d) and the tangent of the difference, by hand
    distance, down = math.hypot(20.0, 4.8), math.atan2(4.8, 20.0)
    assert sphere.front_slant_range_m == pytest.approx(distance - 0.3, abs=1e-12)
    assert sphere.tangent_slant_range_m == pytest.approx(math.sqrt(distance**2 - 0.09), abs=1e-12)
    assert sphere.shadow_end_m == pytest.approx(5.0 / math.tan(down - math.asin(0.3 / distance)), abs=1e-12)


@given(SIZE, SIZE, SIZE, AZIMUTH, st.floats(0.0, 0.9), PINGS, POSE)
def test_burial_cuts_what_is_below_the_floor(
    length: float, width: float, height: float, azimuth: float, buried: float, pings: Array, pose: tuple[float, float]
) -> None:
    """A buried box is a lower box; a buried wedge is a smaller wedge with the same vertical face."""
    left = 1.0 - buried
    reach = np.hypot(length, width)
    altitude = height * left * pose[0]
    ground_range, offset = reach + altitude * pose[1], pings * 0.5 * reach
    deep = Box(length_m=length, width_m=width, height_m=height, azimuth_rad=azimuth, burial_m=height * buried)
    low = Box(length_m=length, width_m=width, height_m=height * left, azimuth_rad=azimuth)
    for one, other in zip(
        view_shape(deep, offset, ground_range, altitude), view_shape(low, offset, ground_range, altitude), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-6)
    deep_wedge = Wedge(length_m=length, width_m=width, height_m=height, azimuth_rad=azimuth, burial_m=height * buried)
    small = Wedge(length_m=length * left, width_m=width, height_m=height * left, azimuth_rad=azimuth)
    shift = 0.5 * length * buried
    offset = clear_of_edges(lambda offset: view_shape(deep_wedge, offset, ground_range, altitude), offset, 1e-6)
    seen = view_shape(small, offset - shift * math.cos(azimuth), ground_range + shift * math.sin(azimuth), altitude)
    np.testing.assert_allclose(
        view_shape(deep_wedge, offset, ground_range, altitude).shadow_end_m, seen.shadow_end_m, rtol=0.0, atol=1e-6
    )


@EVERY_SOLID
def test_hypotheses_broadcast_against_pings(kind: str) -> None:
    altitude, offset = np.array([5.0, 6.0, 7.0, 8.0]), np.array([-0.1, 0.0, 0.05, 40.0])

    def solid(size: float | Array) -> Shape:
        match kind:
            case "sphere":
                return Sphere(radius_m=size, burial_m=0.1)
            case "cylinder":
                return Cylinder(radius_m=0.3, length_m=size, azimuth_rad=size, burial_m=0.1)
            case "truncated_cone":
                return TruncatedCone(base_radius_m=0.5, top_radius_m=0.2, height_m=size, burial_m=0.1)
            case "box":
                return Box(length_m=1.0, width_m=0.8, height_m=size, azimuth_rad=size, burial_m=0.1)
            case "wedge":
                return Wedge(length_m=size, width_m=0.8, height_m=0.4, azimuth_rad=0.4, burial_m=0.1)
            case _:
                corners = np.array([[0.5, 0.0, 0.0], [-0.4, 0.5, 0.0], [-0.4, -0.5, 0.0], [0.0, 0.0, 1.0]])
                vertices = corners * np.asarray(size)[..., np.newaxis, np.newaxis]
                return ConvexPolyhedron(
                    vertices_m=vertices, faces=((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)), burial_m=0.1
                )

    sizes = np.array([0.4, 0.5, 0.9])
    for together, *apart in zip(
        view_shape(solid(sizes[:, np.newaxis]), offset, 15.0, altitude, slope_rad=0.02),
        *(view_shape(solid(float(size)), offset, 15.0, altitude, slope_rad=0.02) for size in sizes),
        strict=True,
    ):
        assert together.shape == (3, 4)
        np.testing.assert_allclose(together, apart, rtol=0.0, atol=1e-12)
    assert np.isnan(together[:, 3]).all()
    assert np.isfinite(together[:, :3]).all()


def test_a_cylinder_turns_through_across_track_without_a_jump() -> None:
    offset = np.linspace(-0.24, 0.24, 13)
    steps = np.concatenate(([0.0], 10.0 ** np.arange(-16.0, -5.0)))
    azimuth = RIGHT + np.concatenate((-steps, steps))[:, np.newaxis]
    view = view_shape(Cylinder(radius_m=0.25, length_m=2.0, azimuth_rad=azimuth), offset, 20.0, 5.0)
    for values in view:
        assert np.ptp(values, axis=0).max() < 1e-4
    height = 0.25 + np.sqrt(0.25**2 - offset**2)
    np.testing.assert_allclose(view.shadow_end_m[0], 5.0 * 21.0 / (5.0 - height), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(view.front_slant_range_m[0], np.hypot(19.0, 5.0 - height), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("azimuth", [5e-324, -5e-324, 1e-310, 1e-200, -1e-160])
def test_azimuths_next_to_zero_are_zero(azimuth: float) -> None:
    offset = np.array([-1.0, -0.3, 0.0, 0.5, 0.9999999, 1.0])
    for exact, near in zip(
        view_shape(Cylinder(radius_m=0.25, length_m=2.0), offset, 20.0, 5.0),
        view_shape(Cylinder(radius_m=0.25, length_m=2.0, azimuth_rad=azimuth), offset, 20.0, 5.0),
        strict=True,
    ):
        np.testing.assert_allclose(near, exact, rtol=0.0, atol=1e-12)
    for exact, near in zip(
        view_shape(Box(length_m=2.0, width_m=0.5, height_m=0.3), offset, 20.0, 5.0),
        view_shape(Box(length_m=2.0, width_m=0.5, height_m=0.3, azimuth_rad=azimuth), offset, 20.0, 5.0),
        strict=True,
    ):
        np.testing.assert_allclose(near, exact, rtol=0.0, atol=1e-12)


@settings(max_examples=50)
@given(ANY_SOLID)
@example(Cylinder(radius_m=0.25, length_m=2.0, azimuth_rad=RIGHT))
@example(Cylinder(radius_m=0.25, length_m=2.0, azimuth_rad=0.0))
def test_slices_from_one_edge_to_the_other_are_seen_and_no_others(shape: Shape) -> None:
    """The seen offsets form an interval, which ends where the solid's outline on or over the floor does."""
    altitude = 10.0 * height_m(shape)
    reach = reach_m(shape)
    offset = np.linspace(-reach, reach, 2001)
    end = view_shape(shape, offset, 3.0 * reach + 2.0 * altitude, altitude).shadow_end_m
    seen = np.flatnonzero(~np.isnan(end))
    assert seen.size
    assert np.array_equal(seen, np.arange(seen[0], seen[-1] + 1))
    assume(isinstance(shape, Sphere | Cylinder))
    assert isinstance(shape, Sphere | Cylinder)
    sunk = max(0.0, float(shape.burial_m - shape.radius_m))
    half = math.sqrt(max(0.0, float(shape.radius_m) ** 2 - sunk**2))
    if isinstance(shape, Cylinder):
        half = half * abs(math.sin(shape.azimuth_rad)) + 0.5 * float(shape.length_m) * abs(math.cos(shape.azimuth_rad))
    assert offset[seen[[0, -1]]] == pytest.approx([-half, half], abs=1.01 * reach / 1000.0)


def test_poses_that_side_scan_cannot_have_are_refused() -> None:
    shape = Sphere(radius_m=0.5)
    with pytest.raises(ValueError, match="altitude_m must be positive, got 0: leave out pings"):
        view_shape(shape, 0.0, 10.0, [5.0, 0.0])
    for ground_range in (0.5, 0.0, -10.0):
        with pytest.raises(ValueError, match="m from the point of the floor nearest to the sonar"):
            view_shape(shape, [0.0, 9.0], ground_range, 5.0)
    with pytest.raises(ValueError, match="slope_rad must be between"):
        view_shape(shape, 0.0, 10.0, 5.0, slope_rad=1.6)
    # Uphill the nearest point of the floor moves away from below the sonar.
    with pytest.raises(ValueError, match="place it farther away"):
        view_shape(shape, 0.0, 2.0, 5.0, slope_rad=0.4)


def test_solids_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="radius_m of a Sphere must be positive, got -1"):
        Sphere(radius_m=-1.0)
    with pytest.raises(ValueError, match="radius_m of a Cylinder must be positive, got nan"):
        Cylinder(radius_m=math.nan, length_m=1.0)
    with pytest.raises(ValueError, match="burial_m of a Box must not be negative"):
        Box(length_m=1.0, width_m=1.0, height_m=1.0, burial_m=-0.1)
    with pytest.raises(ValueError, match=r"top_radius_m 0\.6 must not exceed base_radius_m 0\.5"):
        TruncatedCone(base_radius_m=0.5, top_radius_m=0.6, height_m=0.4)


def test_polyhedra_that_are_not_convex_and_closed_are_refused() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    faces = ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3))
    ConvexPolyhedron(vertices_m=corners, faces=faces)
    with pytest.raises(ValueError, match=r"edges \[\(0, 2\), \(0, 3\), \(2, 3\)\] do not belong to exactly two"):
        ConvexPolyhedron(vertices_m=corners, faces=faces[:3])
    with pytest.raises(ValueError, match="three or more indices below 4"):
        ConvexPolyhedron(vertices_m=corners, faces=((0, 1, 4), *faces[1:]))
    with pytest.raises(ValueError, match="all vertices on one side"):
        ConvexPolyhedron(
            vertices_m=np.vstack((corners, [[0.1, 0.1, 0.1]])), faces=((0, 1, 4), (1, 2, 4), (2, 0, 4), *faces[1:])
        )
    with pytest.raises(ValueError, match="all vertices on one side"):
        ConvexPolyhedron(vertices_m=corners * [1.0, 1.0, 0.0], faces=faces)
    with pytest.raises(ValueError, match=r"shape \(\.\.\., n_vertices, 3\), got shape \(4, 2\)"):
        ConvexPolyhedron(vertices_m=corners[:, :2], faces=faces)


@given(st.floats(0.3, 100.0), st.floats(0.0, 1.0).map(lambda part: 10.0 ** (-12.0 + 14.0 * part)))
def test_ground_range_keeps_its_digits_near_nadir(altitude: float, excess: float) -> None:
    slant_range = altitude * (1.0 + excess)
    with localcontext() as context:
        context.prec = 60
        exact = float((Decimal(slant_range) ** 2 - Decimal(altitude) ** 2).sqrt())
    assert flat_ground_range_m(slant_range, altitude) == pytest.approx(exact, rel=1e-15, abs=0.0)
    assert flat_ground_range_m(0.9 * altitude, altitude) == 0.0
