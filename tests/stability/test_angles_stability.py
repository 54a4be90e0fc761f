"""Directions that wrap: 180 degrees is -180, a cylinder has no front, and a bearing is the same after any number of
turns.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.classify.beliefs import FRAME, Array, ViewMass, combine
from auv_mcm.classify.evidence import ClassEvidence, view_mass
from auv_mcm.classify.fit import Effort, fit_shapes
from auv_mcm.solids.shapes import Box, Cylinder, Shape, Wedge, view_shape
from tests.auv_mcm.classify.closed_forms import closed_form_region

TURN = 2.0 * math.pi
ANGLE = st.floats(-math.pi, math.pi)


def mass_of(*nll: float) -> Array:
    return view_mass({name: ClassEvidence(nll=x) for name, x in zip(FRAME, nll, strict=True)}, 0.8)


FIRST, SECOND = mass_of(0.0, 9.0, 6.0, 12.0, 8.0), mass_of(0.0, 3.0, 9.0, 12.0, 5.0)


def fused(*aspects: float, symmetric: bool) -> Array:
    masses = (FIRST, SECOND, FIRST)
    return combine(
        [
            ViewMass(mass=mass, aspect_rad=aspect, half_turn_symmetric=symmetric)
            for mass, aspect in zip(masses, aspects, strict=False)
        ]
    ).mass


@given(st.tuples(ANGLE, ANGLE, ANGLE), st.tuples(*[st.integers(-3, 3)] * 3), st.booleans())
def test_whole_turns_change_no_belief_nor_half_turns_where_a_shape_looks_the_same_from_behind(
    aspects: tuple[float, ...], turns: tuple[int, ...], symmetric: bool
) -> None:
    turn = 0.5 * TURN if symmetric else TURN
    turned = [aspect + n * turn for aspect, n in zip(aspects, turns, strict=True)]
    np.testing.assert_allclose(
        fused(*turned, symmetric=symmetric), fused(*aspects, symmetric=symmetric), rtol=0, atol=1e-12
    )


@given(st.tuples(ANGLE, ANGLE, ANGLE), ANGLE, st.booleans())
def test_turning_the_compass_or_mirroring_it_changes_no_belief(
    aspects: tuple[float, ...], north: float, symmetric: bool
) -> None:
    expected = fused(*aspects, symmetric=symmetric)
    np.testing.assert_allclose(
        fused(*(aspect + north for aspect in aspects), symmetric=symmetric), expected, rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(
        fused(*(-aspect for aspect in aspects), symmetric=symmetric), expected, rtol=0, atol=1e-12
    )


@given(ANGLE, st.integers(-3, 3), st.sampled_from(["cylinder", "box", "wedge"]))
def test_turned_solids_look_the_same_where_they_are(azimuth: float, n: int, kind: str) -> None:
    turn = n * (TURN if kind == "wedge" else 0.5 * TURN)

    def solid(angle: float) -> Shape:
        if kind == "cylinder":
            return Cylinder(radius_m=0.25, length_m=1.9, azimuth_rad=angle)
        return (Box if kind == "box" else Wedge)(length_m=1.1, width_m=0.7, height_m=0.4, azimuth_rad=angle)

    offset = np.linspace(-0.9, 0.9, 31)
    for one, other in zip(
        view_shape(solid(azimuth), offset, 14.0, 5.0), view_shape(solid(azimuth + turn), offset, 14.0, 5.0), strict=True
    ):
        both = np.isfinite(one) & np.isfinite(other)
        assert (np.isfinite(one) != np.isfinite(other)).sum() <= 2  # pings that meet nothing but an edge
        ends = np.flatnonzero(both)[[0, -1]]
        both[ends] = False  # where a slice is cut by an end, rounding of the angle moves it most
        np.testing.assert_allclose(one[both], other[both], rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "shape",
    [
        Cylinder(radius_m=0.265, length_m=1.8, azimuth_rad=math.radians(89.0)),
        Cylinder(radius_m=0.265, length_m=1.8, azimuth_rad=math.radians(-89.0)),
        Wedge(length_m=1.02, width_m=0.8, height_m=0.385, azimuth_rad=math.radians(178.0)),
        Wedge(length_m=1.02, width_m=0.8, height_m=0.385, azimuth_rad=math.radians(-178.0)),
    ],
)
def test_azimuths_beside_the_wrap_of_the_search_are_found_on_either_side(shape: Cylinder | Wedge) -> None:
    region = closed_form_region(shape, 15.0, row_spacing_m=0.06, along_track_m=1.83, levels=(2.5, 0.1, 1.0))
    fits = fit_shapes(region, None, 1.0, effort=Effort(300, 6, 12, 6, 2, 10, 6)).fits
    found = next(fit.best.shape for fit in fits if type(fit.best.shape) is type(shape))
    turn = math.pi if isinstance(shape, Cylinder) else TURN
    away = math.remainder(msgspec.structs.asdict(found)["azimuth_rad"] - float(shape.azimuth_rad), turn)
    assert abs(away) < 0.12
