"""Closed forms against each other and what no view may break: larger, farther, mirrored, far away."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.solids.shapes import (
    Box,
    ConvexPolyhedron,
    Cylinder,
    Shape,
    Sphere,
    TruncatedCone,
    Wedge,
    view_shape,
)
from tests.auv_mcm.classify.sampled_views import (
    Array,
    height_m,
    reach_m,
    sampled_parallel_end_m,
)
from tests.auv_mcm.solids.solid_samples import ANY_SOLID, EVERY_SOLID, PINGS, POSE, SOLIDS, clear_of_edges

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
