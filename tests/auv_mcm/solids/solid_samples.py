"""Solids and poses to draw from, and how far a closed form may be from samples of the solid."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from auv_mcm.solids.shapes import Box, ConvexPolyhedron, Cylinder, Shape, SolidView, Sphere, TruncatedCone, Wedge
from tests.auv_mcm.classify.sampled_views import Array

RIGHT = 0.5 * math.pi
SIZE = st.floats(0.1, 3.0)
RADIUS = st.floats(0.1, 1.2)
SHARE = st.one_of(st.just(0.0), st.floats(0.0, 0.9))
AXES = st.sampled_from([-math.pi, -RIGHT, 0.0, RIGHT, math.pi])
# A hair from the axes is where sines and cosines vanish.
AZIMUTH = st.one_of(
    st.floats(-math.pi, math.pi),
    AXES,
    st.builds(lambda axis, power, sign: axis + sign * 10.0**power, AXES, st.floats(-17, -1), st.sampled_from([-1, 1])),
)
PINGS = st.lists(st.floats(-1.05, 1.05), min_size=6, max_size=6).map(np.array)  # in units of the horizontal reach
# Altitude over the object's height, and ground range beyond the object over altitude.
POSE = st.tuples(st.floats(1.2, 40.0), st.floats(0.0, 15.0))


def random_polyhedron(seed: int, azimuth_rad: float, buried: float) -> ConvexPolyhedron:
    """Hull of a few points in and around a box; stands on its lowest point."""
    random = np.random.Generator(np.random.PCG64(seed))
    points = random.uniform(-0.5, 0.5, size=(random.integers(5, 12), 3)) * random.uniform(0.4, 1.5, size=3)
    points[:, 2] -= points[:, 2].min()
    hull = ConvexHull(points)
    index = {int(vertex): position for position, vertex in enumerate(hull.vertices)}
    faces = tuple(tuple(index[int(vertex)] for vertex in face) for face in hull.simplices)
    return ConvexPolyhedron(
        vertices_m=points[hull.vertices],
        faces=faces,
        azimuth_rad=azimuth_rad,
        burial_m=buried * float(points[:, 2].max()),
    )


SOLIDS: dict[str, st.SearchStrategy[Shape]] = {
    "sphere": st.builds(lambda a, b: Sphere(radius_m=a, burial_m=2.0 * a * b), RADIUS, SHARE),
    "cylinder": st.builds(
        lambda a, length, azimuth, b: Cylinder(radius_m=a, length_m=length, azimuth_rad=azimuth, burial_m=2.0 * a * b),
        RADIUS,
        SIZE,
        AZIMUTH,
        SHARE,
    ),
    "truncated_cone": st.builds(
        lambda base, taper, height, b: TruncatedCone(
            base_radius_m=base, top_radius_m=base * taper, height_m=height, burial_m=height * b
        ),
        RADIUS,
        st.one_of(st.floats(0.0, 0.99), st.floats(2.0, 8.0).map(lambda power: 1.0 - 10.0**-power)),
        SIZE,
        SHARE,
    ),
    "box": st.builds(
        lambda x, y, z, azimuth, b: Box(length_m=x, width_m=y, height_m=z, azimuth_rad=azimuth, burial_m=b * z),
        SIZE,
        SIZE,
        SIZE,
        AZIMUTH,
        SHARE,
    ),
    "wedge": st.builds(
        lambda x, y, z, azimuth, b: Wedge(length_m=x, width_m=y, height_m=z, azimuth_rad=azimuth, burial_m=b * z),
        SIZE,
        SIZE,
        SIZE,
        AZIMUTH,
        SHARE,
    ),
    "polyhedron": st.builds(random_polyhedron, st.integers(0, 2**32 - 1), AZIMUTH, SHARE),
}
EVERY_SOLID = pytest.mark.parametrize("kind", sorted(SOLIDS))


def clear_of_edges(see: Callable[[Array], SolidView], offset: Array, reach: float) -> Array:
    """Pings whose neighbours at 1/500 of the reach hit or miss as they do; samples may slip through slices narrower
    than that."""
    hits = [np.isfinite(see(offset + step * reach).tangent_slant_range_m) for step in (-0.002, 0.0, 0.002)]
    return np.asarray(offset[(hits[0] == hits[1]) & (hits[1] == hits[2])])
