"""Shadows and highlights of solids that stand on the floor, against closed forms."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.solids.shapes import Box, Cylinder, Shape, SolidView, Sphere, TruncatedCone, Wedge, view_shape
from sim_replay.simulator.backscatter import TABLE_SIZE
from sim_replay.simulator.bodies import CONE, CYLINDER, ELLIPSOID, Body, pack
from sim_replay.simulator.world import PATCH
from tests.sim_replay.simulator.rendered_lines import BURIED, TURN, block, flat_patches, rays, rendered

ONLY_BODIES = np.stack([np.zeros(TABLE_SIZE, dtype=np.float32), np.ones(TABLE_SIZE, dtype=np.float32)])


class Standing(NamedTuple):
    """A solid, what the renderer is given for it, and where the ray meets it.

    body: at the origin, length along north; turned when placed. height_m: of its top over the floor. rise: steepest
    slope of its top. along_m, across_m: of the place on it through which the ray goes, in its own axes.
    """

    shape: Shape
    body: Body
    azimuth_rad: float
    height_m: float
    rise: float
    along_m: float
    across_m: float


def sphere(radius: float, buried: float, u: float, v: float) -> Standing:
    burial = buried * radius
    body = Body(ELLIPSOID, 0.0, 0.0, 0.0, 0.0, radius, (radius, radius, radius, radius - burial), 1)
    return Standing(
        Sphere(radius_m=radius, burial_m=burial), body, 0.0, 2.0 * radius - burial, 0.0, u * radius, v * radius
    )


def cylinder(radius: float, length: float, azimuth: float, buried: float, u: float) -> Standing:
    burial = buried * radius
    body = Body(
        CYLINDER, 0.0, 0.0, 0.0, 0.0, math.hypot(radius, length), (radius, 0.5 * length, radius - burial, 0.0, 1.0), 1
    )
    shape = Cylinder(radius_m=radius, length_m=length, azimuth_rad=azimuth, burial_m=burial)
    return Standing(shape, body, azimuth, 2.0 * radius - burial, 0.0, 0.5 * u * length, 0.0)


def cone(base: float, taper: float, height: float, buried: float, u: float, v: float) -> Standing:
    burial, top = buried * height, taper * base
    body = Body(CONE, 0.0, 0.0, 0.0, 0.0, base, (base, top, height, burial), 1)
    shape = TruncatedCone(base_radius_m=base, top_radius_m=top, height_m=height, burial_m=burial)
    return Standing(shape, body, 0.0, height - burial, 0.0, u * top, v * top)


def box(length: float, width: float, height: float, azimuth: float, buried: float, u: float, v: float) -> Standing:
    burial = buried * height
    shape = Box(length_m=length, width_m=width, height_m=height, azimuth_rad=azimuth, burial_m=burial)
    body = block(length, width, ((0.0, 0.0, height - burial),))
    return Standing(shape, body, azimuth, height - burial, 0.0, 0.5 * u * length, 0.5 * v * width)


def wedge(length: float, width: float, height: float, azimuth: float, u: float, v: float) -> Standing:
    shape = Wedge(length_m=length, width_m=width, height_m=height, azimuth_rad=azimuth)
    body = block(length, width, ((height / length, 0.0, 0.5 * height),))
    return Standing(shape, body, azimuth, height, height / length, 0.5 * u * length, 0.5 * v * width)


SIZE, LOW, INSIDE = st.floats(0.4, 2.0), st.floats(0.3, 0.9), st.floats(-0.7, 0.7)
SOLIDS = st.one_of(
    st.builds(sphere, st.floats(0.25, 0.6), BURIED, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    st.builds(cylinder, st.floats(0.2, 0.5), st.floats(0.6, 2.5), TURN, BURIED, INSIDE),
    st.builds(cone, st.floats(0.4, 0.9), st.floats(0.3, 0.9), LOW, BURIED, INSIDE, INSIDE),
    st.builds(box, SIZE, SIZE, LOW, TURN, BURIED, INSIDE, INSIDE),
    st.builds(wedge, SIZE, SIZE, LOW, TURN, INSIDE, INSIDE),
)


class Seen(NamedTuple):
    """Ground range at which the shadow ends, NaN if nothing is hidden, and slant range at which the highlight begins,
    m.
    """

    shadow_end_m: float
    front_m: float


def closed_form(solid: Standing, ground_range_m: float, altitude_m: float) -> SolidView:
    offset = solid.along_m * math.cos(solid.azimuth_rad) - solid.across_m * math.sin(solid.azimuth_rad)
    return view_shape(solid.shape, offset, ground_range_m, altitude_m)


def viewed(
    solid: Standing,
    ground_range_m: float,
    altitude_m: float,
    heading_rad: float,
    cell_m: float,
    bin_m: float,
    part: float,
) -> Seen:
    """The same by one ray to starboard. part: of a cell that the first node lies from the sonar's foot towards a node
    of the grid.
    """
    end_m = float(closed_form(solid, ground_range_m, altitude_m).shadow_end_m)
    n_nodes = math.ceil(1.1 * end_m / cell_m) + 5
    offset = solid.along_m * math.cos(solid.azimuth_rad) - solid.across_m * math.sin(solid.azimuth_rad)
    ahead, aside = (
        np.array([math.cos(heading_rad), math.sin(heading_rad)]),
        np.array([-math.sin(heading_rad), math.cos(heading_rad)]),
    )
    foot = np.array([part, 0.5 * part]) * cell_m
    place = foot - offset * ahead + ground_range_m * aside
    body = solid.body._replace(
        north_m=float(place[0]), east_m=float(place[1]), azimuth_rad=heading_rad + solid.azimuth_rad
    )
    lines = rays(foot[0] / cell_m, foot[1] / cell_m, heading_rad + 0.5 * math.pi, altitude_m)
    n_bins = math.ceil(math.hypot(end_m, altitude_m) / bin_m)
    size = 2 * math.ceil(n_nodes / PATCH + 1)
    out = rendered(
        lines,
        flat_patches(size),
        tables=ONLY_BODIES,
        bodies=pack([body]),
        cell_m=cell_m,
        n_nodes=n_nodes,
        n_bins=n_bins,
        bin_m=bin_m,
        keep_nodes=True,
    )
    assert out.lit is not None
    hidden = np.flatnonzero(out.lit[0, 1:] < 1.0) + 1
    shadow_end_m = float(hidden[-1] - out.lit[0, hidden[-1]]) * cell_m if len(hidden) else math.nan
    return Seen(shadow_end_m, float(np.flatnonzero(out.energy[0])[0]) * bin_m)


@given(
    solid=SOLIDS, slope=st.floats(1.0, 6.0), altitude_m=st.floats(3.0, 9.0), heading_rad=TURN, part=st.floats(-0.5, 0.5)
)
@settings(max_examples=300)
def test_shadows_end_and_highlights_begin_as_in_the_closed_forms(
    solid: Standing, slope: float, altitude_m: float, heading_rad: float, part: float
) -> None:
    """A node misses the edge that casts the shadow by up to a cell; on the floor that is a cell as cast from the edge's
    height, more where the top falls towards the sonar.
    """
    cell_m, bin_m, ground_range_m = 0.05, 0.01, slope * altitude_m
    view = closed_form(solid, ground_range_m, altitude_m)
    seen = viewed(solid, ground_range_m, altitude_m, heading_rad, cell_m, bin_m, part)
    over = altitude_m - solid.height_m
    cast = altitude_m / over * (1.0 + solid.rise * (ground_range_m + 2.0) / over)
    if math.isnan(seen.shadow_end_m):
        assert math.hypot(float(view.shadow_end_m), altitude_m) - float(view.tangent_slant_range_m) < cell_m * cast
    else:
        assert abs(seen.shadow_end_m - float(view.shadow_end_m)) <= cell_m * cast + 1e-4
    assert abs(seen.front_m - float(view.front_slant_range_m)) <= cell_m * (1.0 + solid.rise) + bin_m


FIXED = {
    "sphere": sphere(0.4, 0.2, 0.3, 0.0),
    "cylinder": cylinder(0.265, 2.0, 0.6, 0.1, 0.3),
    "cone": cone(0.49, 0.5, 0.47, 0.1, 0.3, 0.2),
    "wedge": wedge(1.02, 0.8, 0.385, 2.5, 0.2, 0.3),
    "box": box(1.1, 0.9, 0.45, 0.4, 0.1, 0.2, -0.3),
}


@pytest.mark.parametrize("name", FIXED)
def test_errors_of_shadow_ends_shrink_with_the_cell(name: str) -> None:
    altitude_m = 6.0

    def error_m(cell_m: float) -> float:
        errors = []
        for ground_range_m in np.linspace(21.0, 21.3, 24):
            end_m = float(closed_form(FIXED[name], ground_range_m, altitude_m).shadow_end_m)
            errors.append(viewed(FIXED[name], ground_range_m, altitude_m, 0.7, cell_m, 0.05, 0.3).shadow_end_m - end_m)
        return float(np.abs(errors).mean())

    errors = np.array([error_m(cell_m) for cell_m in (0.16, 0.08, 0.04, 0.02)])
    assert np.all(errors[1:] < 0.65 * errors[:-1])
