"""Closed forms where their square roots, arc sines, cosines and quotients end: rays that graze, axes across the track,
low sonars."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.solids.shapes import Box, Cylinder, Shape, SolidView, Sphere, TruncatedCone, Wedge, view_shape

Array = NDArray[np.float64]
RIGHT = 0.5 * math.pi
SOLIDS: dict[str, Callable[[float], Shape]] = {
    "sphere": lambda s: Sphere(radius_m=0.4 * s, burial_m=0.1 * s),
    "cylinder": lambda s: Cylinder(radius_m=0.25 * s, length_m=1.8 * s, azimuth_rad=0.6, burial_m=0.05 * s),
    "truncated_cone": lambda s: TruncatedCone(
        base_radius_m=0.49 * s, top_radius_m=0.25 * s, height_m=0.47 * s, burial_m=0.1 * s
    ),
    "box": lambda s: Box(length_m=1.0 * s, width_m=0.6 * s, height_m=0.4 * s, azimuth_rad=0.3, burial_m=0.1 * s),
    "wedge": lambda s: Wedge(length_m=1.02 * s, width_m=0.8 * s, height_m=0.385 * s, azimuth_rad=2.0, burial_m=0.1 * s),
}
EVERY_SOLID = pytest.mark.parametrize("kind", SOLIDS)
PINGS = np.linspace(-1.3, 1.3, 53)


@pytest.fixture(autouse=True)
def _no_floating_point_flag() -> Iterator[None]:
    with np.errstate(all="raise", under="ignore"):
        yield


def whole(view: SolidView) -> bool:
    """Every ping sees all three numbers or none, in order."""
    seen = np.isfinite(view.front_slant_range_m)
    assert all((np.isnan(values) == ~seen).all() for values in view)
    # A ray may graze along a whole face, of which the tangent point is some point: then rounding orders the two.
    assert (view.front_slant_range_m[seen] <= view.tangent_slant_range_m[seen] * (1.0 + 1e-12)).all()
    return bool(seen.any())


@EVERY_SOLID
@settings(max_examples=40)
@given(exponent=st.floats(-4.0, 4.0), distance=st.floats(1.5, 60.0), altitude=st.floats(1.2, 30.0))
def test_everything_larger_by_one_factor_is_seen_larger_by_it(
    kind: str, exponent: float, distance: float, altitude: float
) -> None:
    scale = 10.0**exponent
    unit = view_shape(SOLIDS[kind](1.0), PINGS, distance, altitude)
    scaled = view_shape(SOLIDS[kind](scale), PINGS * scale, distance * scale, altitude * scale)
    for one, other in zip(unit, scaled, strict=True):
        edge = np.isnan(one) != np.isnan(other)
        assert edge.sum() <= 2  # pings that meet nothing but an edge
        np.testing.assert_allclose(other[~edge] / scale, one[~edge], rtol=1e-7, atol=1e-7)


@EVERY_SOLID
@pytest.mark.parametrize("altitude", [0.3, math.nextafter(0.3, 1.0), 0.35, 0.47, 0.6, 1.0, 30.0, 1e6])
def test_sonars_from_below_the_top_to_far_above_it_see_it_whole(kind: str, altitude: float) -> None:
    for distance in (1.31, 2.0, 20.0, 1e4):
        view = view_shape(SOLIDS[kind](1.0), PINGS, distance, altitude)
        assert whole(view)
        seen = np.isfinite(view.front_slant_range_m)
        assert (view.shadow_end_m[seen] > 0.0).all()


@EVERY_SOLID
def test_the_shadow_grows_without_a_jump_to_infinity_as_the_sonar_sinks_to_the_top(kind: str) -> None:
    solid = SOLIDS[kind](1.0)
    top = {"sphere": 0.7, "cylinder": 0.45, "truncated_cone": 0.37, "box": 0.3, "wedge": 0.285}[kind]
    above = top * (1.0 + np.concatenate((2.0 ** np.arange(0.0, -50.0, -1.0), [0.0])))
    end = view_shape(solid, 0.0, 5.0, above).shadow_end_m
    assert (np.diff(end) > 0.0).all()
    assert end[:40].max() < math.inf
    assert (
        np.isinf(view_shape(solid, 0.0, 5.0, top * (1.0 - np.array([1e-6, 0.1, 0.5]))).shadow_end_m[:1]).all()
        or kind == "wedge"
    )


@EVERY_SOLID
def test_a_track_that_comes_to_the_solid_is_refused_and_just_beside_it_is_not(kind: str) -> None:
    solid, middle = SOLIDS[kind](1.0), np.zeros(1)
    near, far = 0.0, 3.0  # by bisection: where the slice through the middle begins
    for _ in range(80):
        distance = 0.5 * (near + far)
        try:
            assert whole(view_shape(solid, middle, distance, 5.0))
            far = distance
        except ValueError as refusal:
            assert "place it farther away" in str(refusal)  # noqa: PT017  # which of the two happens is what is looked for
            near = distance
    assert 0.1 < far < 1.3
    assert far - near < 1e-12
    for wrong in (0.0, -5.0, 0.5 * near):
        with pytest.raises(ValueError, match="place it farther away"):
            view_shape(solid, middle, wrong, 5.0)


@given(st.floats(0.05, 1.0), st.integers(-60, -1), st.sampled_from([-1.0, 1.0]))
def test_slices_that_graze_a_sphere_are_a_point_where_it_is(radius: float, power: int, side: float) -> None:
    offset = side * radius * (1.0 - 2.0**power)
    view = view_shape(Sphere(radius_m=radius), [offset, side * radius * (1.0 + 1e-12)], 12.0, 4.0)
    width = math.sqrt(max(0.0, (radius - abs(offset)) * (radius + abs(offset))))
    if abs(offset) < radius:
        assert view.front_slant_range_m[0] == pytest.approx(math.hypot(12.0, 4.0 - radius) - width, rel=1e-12)
        assert view.tangent_slant_range_m[0] == pytest.approx(
            math.sqrt(12.0**2 + (4.0 - radius) ** 2 - width**2), rel=1e-12
        )
    assert np.isnan([values[1] for values in view]).all()


@pytest.mark.parametrize("taper", [0.0, 5e-324, 1e-300, 1e-16, 1e-9, 1e-3, 1.0])
def test_cones_from_a_hair_narrower_at_the_top_to_a_point_are_seen_whole(taper: float) -> None:
    cone = TruncatedCone(base_radius_m=0.5, top_radius_m=0.5 * (1.0 - taper), height_m=0.4)
    offset = np.concatenate((np.linspace(-0.51, 0.51, 41), [-0.5, 0.5, math.nextafter(0.5, 0.0), 0.0]))
    for altitude in (0.3, 0.4, 1.0, 12.0):
        assert whole(view_shape(cone, offset, 9.0, altitude))


@EVERY_SOLID
def test_a_solid_sunk_to_its_top_or_deeper_is_a_spot_or_nothing(kind: str) -> None:
    top = {"sphere": 0.8, "cylinder": 0.5, "truncated_cone": 0.47, "box": 0.4, "wedge": 0.385}[kind]
    for burial in (math.nextafter(top, 0.0), top * (1.0 - 1e-12), top, math.nextafter(top, 1.0), 2.0 * top, 1e9):
        sunk = SOLIDS[kind](1.0)
        fields = {name: getattr(sunk, name) for name in sunk.__struct_fields__}
        view = view_shape(type(sunk)(**{**fields, "burial_m": burial}), PINGS, 15.0, 5.0)
        seen = np.isfinite(view.shadow_end_m)
        assert burial <= top or not seen.any()
        assert (view.shadow_end_m[seen] <= 15.0 + 1.4).all()


@EVERY_SOLID
def test_pings_without_navigation_see_nothing_and_spoil_no_other(kind: str) -> None:
    offset, distance, altitude = (np.full(4, value) for value in (0.05, 15.0, 5.0))
    offset[0], distance[1], altitude[2] = math.nan, math.nan, math.nan
    with np.errstate(invalid="ignore"):
        view = view_shape(SOLIDS[kind](1.0), offset, distance, altitude)
    alone = view_shape(SOLIDS[kind](1.0), 0.05, 15.0, 5.0)
    for values, value in zip(view, alone, strict=True):
        assert np.isnan(values[:3]).all()
        assert values[3] == value
