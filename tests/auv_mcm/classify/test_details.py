"""Plain measures: finite whatever was measured or was not, in the units that their names state."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.classify.details import contour_details, detection_details, solid_details
from auv_mcm.classify.fit import Highlight, Optimum, ShapeFit, ShapeFits
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW
from auv_mcm.kernels.shape import Solid
from auv_mcm.solids.shapes import Cylinder, Sphere
from tests.auv_mcm.classify.drawn_looks import bare_floor, detection, no_contours, no_fits

LABELS = np.array([[HIGHLIGHT, SHADOW, SHADOW, BACKGROUND]], dtype=np.uint8)

anything = st.floats() | st.sampled_from([math.nan, math.inf, -math.inf])


def fit_of(solid: Solid, cost: float, second_cost: float | None = None) -> ShapeFit:
    shape = Sphere(radius_m=0.4) if solid == "sphere" else Cylinder(radius_m=0.25, length_m=2.0, azimuth_rad=0.0)
    best = Optimum(shape=shape, row=5.0, ground_range_m=12.0, altitude_ratio=1.0, cost=cost)
    return ShapeFit(
        solid=solid,
        best=best,
        second=None if second_cost is None else msgspec.structs.replace(best, cost=second_cost),
        sigma={},
        ends=((0.0, 0.0, 0.0),),
        plausibility=1.0,
        contrast=(4.0, 0.2),
        highlight=Highlight(model_across_m=0.2, observed_across_m=0.3, n_samples=20.0),
        refined=True,
        flags=(),
    )


@given(
    st.fixed_dictionaries(
        dict.fromkeys(("ground_range_m", "altitude_m", "length_m", "height_m", "shadow_length_m"), anything)
    )
)
def test_any_detection_is_described_by_finite_numbers(measured: dict[str, float]) -> None:
    assert all(map(math.isfinite, detection_details(detection(**measured)).values()))


@given(
    st.fixed_dictionaries(dict.fromkeys(("gain", "highlight_mean", "shadow_mean", "length_m", "repetition"), anything))
)
def test_any_contours_are_described_by_finite_numbers(measured: dict[str, float]) -> None:
    assert all(map(math.isfinite, contour_details(no_contours(**measured), bare_floor()).values()))


@given(st.lists(anything, min_size=2, max_size=2), anything)
def test_any_solids_are_described_by_finite_numbers_of_the_same_names(costs: list[float], contour_cost: float) -> None:
    fits = ShapeFits(fits=(fit_of("sphere", *costs),), contour_cost=contour_cost, n_hypotheses=1, flags=())
    found, none = solid_details(fits, LABELS, bare_floor()), solid_details(no_fits(), LABELS, bare_floor())
    assert found.keys() == none.keys()
    assert all(map(math.isfinite, (*found.values(), *none.values())))


def test_a_beam_is_as_wide_as_its_angle_makes_it_at_the_slant_range() -> None:
    region = msgspec.structs.replace(
        bare_floor(), first_ground_range_m=28.0, column=20.0, column_spacing_m=0.1, altitude_m=40.0
    )
    assert contour_details(no_contours(), region)["beam_footprint_m"] == pytest.approx(region.beam_width_rad * 50.0)


def test_solids_are_described_by_what_each_costs_and_how_the_best_lies() -> None:
    region = msgspec.structs.replace(
        bare_floor(), row=3.0, row_spacing_m=0.5, column=10.0, column_spacing_m=0.1, first_ground_range_m=10.0
    )
    fits = ShapeFits(
        fits=(fit_of("cylinder", -20.0, -15.0), fit_of("sphere", -12.0)), contour_cost=-5.0, n_hypotheses=9, flags=()
    )
    reported = solid_details(fits, LABELS, region)
    assert (reported["cylinder_nats"], reported["sphere_nats"], reported["solid_nats"], reported["contour_nats"]) == (
        -20.0,
        -12.0,
        -20.0,
        -5.0,
    )
    assert reported["wedge_nats"] > 0.0, "a solid that cannot be seen costs more than bare floor"
    assert reported["contour_over_solid_nats"] == 15.0
    assert reported["second_solid_behind_nats"] == 5.0
    assert reported["solid_along_off_m"] == pytest.approx(1.0)
    assert reported["solid_across_off_m"] == pytest.approx(1.0)
    assert (reported["solid_highlight_contrast"], reported["solid_shadow_contrast"]) == (4.0, 0.2)
    assert (reported["labelled_highlight_share"], reported["labelled_shadow_share"]) == (0.25, 0.5)
