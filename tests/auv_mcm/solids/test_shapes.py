"""Closed forms of highlight and shadow against sampled solids, a height-field ray caster, and each other."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.solids.shapes import Box, Shape, SolidView, TruncatedCone, view_shape
from tests.auv_mcm.classify.sampled_views import Array, extent_m, height_m, reach_m, sampled_view
from tests.auv_mcm.solids.solid_samples import EVERY_SOLID, PINGS, POSE, SOLIDS, clear_of_edges


def assert_same(view: SolidView, sampled: SolidView, shadow_tolerance_m: float = 1e-6) -> None:
    np.testing.assert_allclose(view.shadow_end_m, sampled.shadow_end_m, rtol=1e-9, atol=shadow_tolerance_m)
    np.testing.assert_allclose(view.front_slant_range_m, sampled.front_slant_range_m, rtol=0.0, atol=1e-7)


@EVERY_SOLID
def test_shadow_ends_and_highlight_begins_where_samples_say(kind: str) -> None:
    @settings(max_examples=60)
    @given(SOLIDS[kind], PINGS, POSE)
    def check(shape: Shape, pings: Array, pose: tuple[float, float]) -> None:
        reach, altitude = reach_m(shape), pose[0] * height_m(shape)
        ground_range = reach + pose[1] * altitude
        offset = clear_of_edges(lambda offset: view_shape(shape, offset, ground_range, altitude), pings * reach, reach)
        assert_same(
            view_shape(shape, offset, ground_range, altitude), sampled_view(shape, offset, ground_range, altitude)
        )

    check()


@EVERY_SOLID
def test_the_ray_along_the_shadows_end_touches_the_solid_at_the_tangent_range(kind: str) -> None:
    """The one statement about the tangent range that also holds where the ray grazes along an edge."""

    @settings(max_examples=60)
    @given(SOLIDS[kind], PINGS, POSE)
    def check(shape: Shape, pings: Array, pose: tuple[float, float]) -> None:
        offset, altitude = pings * reach_m(shape), pose[0] * height_m(shape)
        ground_range = reach_m(shape) + pose[1] * altitude
        view = view_shape(shape, offset, ground_range, altitude)
        hit = np.isfinite(view.shadow_end_m)
        offset, end, tangent = offset[hit], view.shadow_end_m[hit], view.tangent_slant_range_m[hit]
        part = tangent / np.hypot(end, altitude)
        hair = (-1e-9, 0.0, 1e-9)  # rounding may put the point just beside a vertical face
        highest = np.max(
            [extent_m(shape, offset + x, part * end - ground_range + y)[1] for x in hair for y in hair], axis=0
        )
        assert np.all(altitude * (1.0 - part) <= highest + 1e-7)
        assert np.all(view.front_slant_range_m[hit] <= tangent + 1e-9)

    check()


def away_from_grazing(shape: Shape, offset: Array, ground_range: float, altitude: float) -> NDArray[np.bool_]:
    """Pings whose ray touches a point, not an edge or face along it: a millionth of the altitude does not move the
    point far."""
    higher, lower = (
        view_shape(shape, offset, ground_range, altitude * factor).tangent_slant_range_m
        for factor in (1.0 + 1e-6, 1.0 - 1e-6)
    )
    return np.asarray(~(np.abs(higher - lower) > 3e-5 * (1.0 + altitude)))


@EVERY_SOLID
def test_tangent_range_is_that_of_the_sampled_point_where_it_is_well_defined(kind: str) -> None:
    @settings(max_examples=40)
    @given(SOLIDS[kind], PINGS, POSE)
    def check(shape: Shape, pings: Array, pose: tuple[float, float]) -> None:
        reach, altitude = reach_m(shape), pose[0] * height_m(shape)
        ground_range = reach + pose[1] * altitude
        offset = clear_of_edges(lambda offset: view_shape(shape, offset, ground_range, altitude), pings * reach, reach)
        steady = away_from_grazing(shape, offset, ground_range, altitude)
        tangent = view_shape(shape, offset, ground_range, altitude).tangent_slant_range_m
        sampled = sampled_view(shape, offset, ground_range, altitude).tangent_slant_range_m
        np.testing.assert_allclose(tangent[steady], sampled[steady], rtol=0.0, atol=1e-5)

    check()


@EVERY_SOLID
def test_squinted_and_sloping_slices_are_those_of_the_sampled_solid(kind: str) -> None:
    @settings(max_examples=25)
    @given(SOLIDS[kind], PINGS, POSE, st.floats(-0.3, 0.3), st.booleans())
    def check(shape: Shape, pings: Array, pose: tuple[float, float], turn: float, squinted: bool) -> None:
        reach, altitude = reach_m(shape), pose[0] * height_m(shape)
        ground_range = 2.0 * reach + (0.5 + pose[1]) * altitude
        squint, slope = (turn, 0.0) if squinted else (0.0, turn)

        def see(offset: Array) -> SolidView:
            return view_shape(shape, offset, ground_range, altitude, squint_rad=squint, slope_rad=slope)

        offset = clear_of_edges(see, pings * reach - ground_range * math.tan(squint), reach)
        sampled = sampled_view(shape, offset, ground_range, altitude, squint_rad=squint, slope_rad=slope)
        assert_same(see(offset), sampled)

    check()


@EVERY_SOLID
def test_a_sonar_no_higher_than_the_object_sees_an_endless_shadow(kind: str) -> None:
    @settings(max_examples=25)
    @given(SOLIDS[kind], PINGS, st.floats(0.1, 0.999), st.floats(0.1, 15.0))
    def check(shape: Shape, pings: Array, share: float, distance: float) -> None:
        reach, altitude = reach_m(shape), share * height_m(shape)
        ground_range = reach + distance
        offset = clear_of_edges(lambda offset: view_shape(shape, offset, ground_range, altitude), pings * reach, reach)
        view, sampled = (
            view_shape(shape, offset, ground_range, altitude),
            sampled_view(shape, offset, ground_range, altitude),
        )
        np.testing.assert_allclose(view.front_slant_range_m, sampled.front_slant_range_m, rtol=0.0, atol=1e-7)
        steady = away_from_grazing(shape, offset, ground_range, altitude)
        np.testing.assert_allclose(
            view.tangent_slant_range_m[steady], sampled.tangent_slant_range_m[steady], rtol=0.0, atol=1e-5
        )
        # Where the ray is all but level the end is anywhere far away: compare its slope instead.
        np.testing.assert_allclose(altitude / view.shadow_end_m, altitude / sampled.shadow_end_m, rtol=0.0, atol=1e-8)

    check()
    over_the_middle = view_shape(Box(length_m=1.0, width_m=1.0, height_m=1.0), 0.0, 5.0, [0.5, 1.0, 1.01])
    assert np.isinf(over_the_middle.shadow_end_m).tolist() == [True, True, False]


@EVERY_SOLID
def test_a_ray_caster_over_a_height_field_finds_the_same_shadow(kind: str) -> None:
    """|error| <= 4 cells at every cell size: first order, as the running maximum of elevations over cells must be.

    Where a slope ends in a sharp edge, the last cell is lower than the edge by up to its own rise, which the bound has
    to add.
    """

    @settings(max_examples=10)
    @given(SOLIDS[kind], st.floats(3.0, 20.0), st.floats(0.0, 8.0))
    def check(shape: Shape, over_height: float, over_altitude: float) -> None:
        reach, height = reach_m(shape), height_m(shape)
        altitude = over_height * height
        ground_range = reach + over_altitude * altitude
        for cell in (0.02, 0.01, 0.005):
            offset = np.linspace(-0.9, 0.9, 7) * reach
            error, rise = height_field_error(shape, offset, ground_range, altitude, cell)
            assert np.all(error <= 4.0 * cell + rise)

    check()


def test_a_ray_caster_over_a_height_field_finds_the_shadow_of_a_truncated_cone_within_four_cells() -> None:
    cone = TruncatedCone(base_radius_m=0.49, top_radius_m=0.25, height_m=0.45)
    for cell in (0.02, 0.01, 0.005, 0.0025):
        error, _ = height_field_error(cone, np.linspace(-0.45, 0.45, 31), 25.0, 5.0, cell)
        assert error.size == 31
        assert np.all(error <= 4.0 * cell)


def height_field_error(
    shape: Shape, offset: Array, ground_range: float, altitude: float, cell: float
) -> tuple[Array, Array]:
    """How far the shadow's end is from a height field's, and how far the rise towards the highest elevation moves it
    within a cell.

    Only slices at least three cells wide count.
    """
    across = (np.arange(math.ceil((1.6 * (ground_range + reach_m(shape)) + 1.0) / cell)) + 0.5) * np.float64(cell)
    _, top = extent_m(shape, offset[:, np.newaxis], across[np.newaxis] - ground_range)
    wide = np.isfinite(top).sum(axis=1) >= 3
    offset, top = offset[wide], top[wide]
    end = view_shape(shape, offset, ground_range, altitude).shadow_end_m
    row, highest = np.arange(offset.size), ((top - altitude) / across).argmax(axis=1)
    around = top[row[:, np.newaxis], highest[:, np.newaxis] + np.arange(-2, 3)]
    steps = np.abs(np.diff(np.where(np.isfinite(around), around, np.nan), axis=1))
    rise = np.where(np.isnan(steps), 0.0, steps).max(axis=1)
    return np.abs(cast_height_field(top, across, altitude) - end), rise * end / (altitude - height_m(shape))


def cast_height_field(top: Array, across: Array, altitude: float) -> Array:
    """Place of the last floor cell of each row that the running maximum of elevations hides; NaN where none is."""
    elevation = (np.maximum(top, 0.0) - altitude) / across
    hidden = -altitude / across < np.maximum.accumulate(elevation, axis=1)
    return np.where(hidden.any(axis=1), across[across.size - 1 - hidden[:, ::-1].argmax(axis=1)], np.nan)
