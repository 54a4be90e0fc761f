"""Sizes of solids as people give them."""

from __future__ import annotations

import math
from typing import get_args

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.classify.dimensions import Dimensions, dimensions
from auv_mcm.records import ContactClass, ShapeModel
from auv_mcm.solids.shapes import Cylinder, Shape, Sphere, TruncatedCone, Wedge, view_shape

NOWHERE = np.empty((0, 2))


def model(classification: ContactClass, sizes: dict[str, float], sigma: dict[str, float] | None = None) -> ShapeModel:
    return ShapeModel(classification=classification, sizes=sizes, sigma=sigma or {}, highlight=NOWHERE, shadow=NOWHERE)


def assert_sizes(reported: Dimensions, expected: tuple[float, ...]) -> None:
    assert reported == pytest.approx(expected, nan_ok=True)


def test_a_sphere_is_as_long_and_wide_and_high_as_its_diameter() -> None:
    reported = dimensions(model("sphere", {"radius_m": 0.4, "burial_m": 0.1}, {"radius_m": 0.03, "burial_m": 0.08}))
    assert_sizes(reported, (0.8, 0.8, 0.7, 0.06, 0.06, 0.1))


def test_a_cylinder_lies() -> None:
    sizes = {"radius_m": 0.25, "length_m": 2.0, "azimuth_rad": 0.7, "burial_m": 0.2}
    reported = dimensions(
        model("cylinder", sizes, {"radius_m": 0.02, "length_m": 0.1, "azimuth_rad": 0.05, "burial_m": 0.03})
    )
    assert_sizes(reported, (2.0, 0.5, 0.3, 0.1, 0.04, 0.05))


def test_a_cylinder_shorter_than_wide_is_as_long_as_wide() -> None:
    reported = dimensions(model("cylinder", {"radius_m": 0.5, "length_m": 0.6}, {"radius_m": 0.02, "length_m": 0.1}))
    assert_sizes(reported, (1.0, 0.6, 1.0, 0.04, 0.1, 0.04))


def test_a_truncated_cone_is_as_wide_as_its_base() -> None:
    sizes = {"base_radius_m": 0.5, "top_radius_m": 0.25, "height_m": 0.45, "burial_m": 0.05}
    reported = dimensions(model("truncated_cone", sizes, {"base_radius_m": 0.04, "height_m": 0.03, "burial_m": 0.04}))
    assert_sizes(reported, (1.0, 1.0, 0.4, 0.08, 0.08, 0.05))


@pytest.mark.parametrize("along_m", [1.0, 0.5])
def test_the_longer_side_of_a_wedge_is_its_length_whichever_way_it_slopes(along_m: float) -> None:
    sizes = {"length_m": along_m, "width_m": 0.8, "height_m": 0.4, "azimuth_rad": 2.0, "burial_m": 0.1}
    reported = dimensions(model("wedge", sizes, {"length_m": 0.1, "width_m": 0.2, "height_m": 0.03, "burial_m": 0.04}))
    long, short = ((1.0, 0.1), (0.8, 0.2)) if along_m == 1.0 else ((0.8, 0.2), (0.5, 0.1))
    assert_sizes(reported, (long[0], short[0], 0.3, long[1], short[1], 0.05))


SOLIDS: dict[ContactClass, Shape] = {
    "sphere": Sphere(radius_m=0.4, burial_m=0.1),
    "cylinder": Cylinder(radius_m=0.25, length_m=2.0, burial_m=0.1),
    "truncated_cone": TruncatedCone(base_radius_m=0.5, top_radius_m=0.25, height_m=0.45, burial_m=0.1),
    "wedge": Wedge(length_m=1.0, width_m=0.8, height_m=0.4, burial_m=0.1),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_length_and_height_are_those_that_the_solid_shows_to_the_sonar(name: ContactClass) -> None:
    """Unburied, its extent along the track by the pings that see it; buried, the height that its shadow implies from
    very far away."""
    shape = SOLIDS[name]
    sizes = {field: float(getattr(shape, field)) for field in shape.__struct_fields__}
    reported = dimensions(model(name, sizes))
    offset_m = np.linspace(-1.5, 1.5, 3001)
    end_m = np.nanmax(view_shape(shape, offset_m, 1e4, 1e3).shadow_end_m)
    assert 1e3 * (1.0 - 1e4 / end_m) == pytest.approx(reported.height_m, abs=0.05)
    unburied = view_shape(msgspec.structs.replace(shape, burial_m=0.0), offset_m, 1e4, 1e3)
    assert np.ptp(offset_m[~np.isnan(unburied.shadow_end_m)]) == pytest.approx(reported.length_m, abs=0.01)


@pytest.mark.parametrize("name", SOLIDS)
def test_what_was_not_measured_has_no_sigma(name: ContactClass) -> None:
    sizes = {field: float(getattr(SOLIDS[name], field)) for field in SOLIDS[name].__struct_fields__}
    reported = dimensions(model(name, sizes))
    assert all(map(math.isfinite, reported[:3]))
    assert all(map(math.isnan, reported[3:]))


@given(st.floats(0.05, 5.0), st.floats(0.05, 5.0), st.floats(0.05, 5.0))
def test_length_is_never_less_than_width(length_m: float, width_m: float, height_m: float) -> None:
    wedge = dimensions(model("wedge", {"length_m": length_m, "width_m": width_m, "height_m": height_m}))
    assert (wedge.length_m, wedge.width_m) == (max(length_m, width_m), min(length_m, width_m))
    cylinder = dimensions(model("cylinder", {"length_m": length_m, "radius_m": width_m}))
    assert cylinder.length_m >= cylinder.width_m


@pytest.mark.parametrize("name", sorted(set(get_args(ContactClass)) - set(SOLIDS)))
def test_what_is_no_solid_has_no_size(name: ContactClass) -> None:
    with pytest.raises(ValueError, match=f"{name} is not a solid"):
        dimensions(model(name, {"length_m": 1.0}))
