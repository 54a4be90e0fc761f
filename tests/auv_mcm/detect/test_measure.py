"""Highlights and shadows of known place and size, drawn on even and on speckled sea floor, and what is measured of
them.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.detect.contrasts import contrasts
from auv_mcm.detect.measure import ROWS_M, Measurement, _bridged, measure, without_footprint
from auv_mcm.detect.prescreen import Peak
from auv_mcm.records import SATURATED, TURN, VALID, Tile
from auv_mcm.snippet import pack_snippet
from tests.auv_mcm.detect.scene_tiles import COLUMN_M, FIRST_RETURN_M, ROW_M, Plane, make_tile, speckle

SHAPE = (120, 320)


class Drawn(NamedTuple):
    """An object in pixels: edges at whole numbers, so that centre and sizes are exact.

    The shadow follows the highlight at once.
    """

    row: int  # of its first row
    column: int  # of its first column
    rows: int
    columns: int
    shadow_columns: int
    ellipse: bool = False

    @property
    def centre(self) -> tuple[float, float]:
        return self.row + 0.5 * self.rows, self.column + 0.5 * self.columns

    @property
    def height_m(self) -> float:
        """Of the last lit point, by the ray that grazes it: its height is to the altitude as the ray's rest is to the
        whole ray.
        """
        top_m = (self.column + self.columns) * COLUMN_M
        whole_m = math.hypot(top_m + self.shadow_columns * COLUMN_M, FIRST_RETURN_M)
        return FIRST_RETURN_M * (whole_m - math.hypot(top_m, FIRST_RETURN_M)) / whole_m

    @property
    def height_error(self) -> float:
        """Relative, that two columns of shadow make, but a tenth at least."""
        return max(0.1, 2.0 / self.shadow_columns)


def draw(plane: Plane, drawn_object: Drawn, bright: float = 8.0, dark: float = 0.03) -> Plane:
    drawn = plane.copy()
    row, column = np.indices(plane.shape) + 0.5
    along = (row - drawn_object.centre[0]) / (0.5 * drawn_object.rows)
    across = (column - drawn_object.centre[1]) / (0.5 * drawn_object.columns)
    inside = along**2 + across**2 < 1.0 if drawn_object.ellipse else (np.abs(along) < 1.0) & (np.abs(across) < 1.0)
    behind = column - (drawn_object.column + drawn_object.columns)
    drawn[(np.abs(along) < 1.0) & (behind > 0.0) & (behind < drawn_object.shadow_columns)] *= np.float32(dark)
    drawn[inside] *= np.float32(bright)
    return drawn


def even(shape: tuple[int, int] = SHAPE) -> Plane:
    return np.ones(shape, dtype=np.float32)


def measured_at(tile: Tile, peak: Peak, beam_width_rad: float) -> Measurement:
    return measure(tile, contrasts(tile, 5e-4).floor(peak.row, peak.column), peak, beam_width_rad)


def measured(tile: Tile, drawn_object: Drawn, beam_width_rad: float = 0.0) -> Measurement:
    """Of the best peak within a metre of the object."""
    centre = drawn_object.centre
    near = [
        peak
        for peak in contrasts(tile, 5e-4).peaks(0.4)
        if math.hypot((peak.row + 0.5 - centre[0]) * ROW_M, (peak.column + 0.5 - centre[1]) * COLUMN_M) < 1.0
    ]
    assert near, "no peak near the object"
    return measured_at(tile, near[0], beam_width_rad)


OBJECTS = st.builds(
    Drawn,
    row=st.integers(40, 64),
    column=st.integers(80, 220),
    rows=st.integers(3, 16),
    columns=st.integers(4, 9),
    shadow_columns=st.integers(8, 60),
    ellipse=st.booleans(),
)


@settings(max_examples=30)
@given(drawn_object=OBJECTS, bright=st.floats(4.5, 60.0), dark=st.floats(0.0, 0.04))
@example(drawn_object=Drawn(40, 80, 3, 4, 46), bright=5.0, dark=0.0)
@example(drawn_object=Drawn(40, 80, 15, 8, 8), bright=4.5, dark=0.0)
def test_on_an_even_floor_place_size_and_height_are_right_to_the_pixel(
    drawn_object: Drawn, bright: float, dark: float
) -> None:
    found = measured(make_tile(draw(even(), drawn_object, bright, dark)), drawn_object)
    assert found.has_highlight
    assert found.has_shadow
    assert not found.touches_border
    assert found.row == pytest.approx(drawn_object.centre[0], abs=0.3)
    assert found.column == pytest.approx(drawn_object.centre[1], abs=0.5)
    # The ends of a small ellipse are single pixels. Two are taken off for the rim that the 3 x 3 mean adds on either
    # side: below about 5 no column of it stands out next to the shadow, nor, on a floor estimated a little too
    # bright, on the other side.
    extent_error = 2.0 + 1e-9 if drawn_object.ellipse or bright < 5.0 else 1.5
    assert found.along_m / ROW_M == pytest.approx(drawn_object.rows, abs=extent_error)
    assert found.across_m / COLUMN_M == pytest.approx(drawn_object.columns, abs=extent_error)
    # Two pixels to the rounding of metres: a shadow may be measured exactly two short.
    assert found.shadow_length_m / COLUMN_M == pytest.approx(drawn_object.shadow_columns, abs=2.0 + 1e-9)
    assert found.height_m == pytest.approx(drawn_object.height_m, rel=drawn_object.height_error)


@pytest.mark.parametrize(
    "drawn_object",
    [
        Drawn(58, 147, 5, 7, 20),
        Drawn(56, 198, 9, 5, 40),
        Drawn(50, 240, 16, 6, 50),
        Drawn(57, 160, 6, 8, 25, ellipse=True),
    ],
)
def test_in_speckle_place_size_and_height_are_right_within_two_pixels(drawn_object: Drawn) -> None:
    """Highlight 10 dB above, shadow 13 dB below a floor of correlated single-look speckle; median over twelve
    floors."""
    found = [
        measured(make_tile(draw(speckle(seed, SHAPE, spread_pixels=1.0), drawn_object, 10.0, 0.05)), drawn_object)
        for seed in range(12)
    ]
    row_error = np.array([m.row for m in found]) - drawn_object.centre[0]
    column_error = np.array([m.column for m in found]) - drawn_object.centre[1]
    assert np.sqrt(np.mean(row_error**2)) < 0.7
    assert np.sqrt(np.mean(column_error**2)) < 0.7
    assert np.median([m.along_m for m in found]) / ROW_M == pytest.approx(drawn_object.rows, abs=1.5)
    assert np.median([m.across_m for m in found]) / COLUMN_M == pytest.approx(drawn_object.columns, abs=1.5)
    assert np.nanmedian([m.shadow_length_m for m in found]) / COLUMN_M == pytest.approx(
        drawn_object.shadow_columns, abs=2.0
    )
    assert np.nanmedian([m.height_m for m in found]) == pytest.approx(
        drawn_object.height_m, rel=drawn_object.height_error
    )


def test_decibels_are_those_of_the_drawing() -> None:
    drawn_object = Drawn(76, 198, 9, 8, 40)
    found = measured(make_tile(draw(even(), drawn_object, 10.0, 0.01)), drawn_object)
    assert 7.0 < found.highlight_db <= 10.01  # the rim of the smoothed outline belongs to it
    assert found.shadow_db == pytest.approx(-20.0, abs=3.0)


@pytest.mark.parametrize("apart_rows", [13, 14, 20])
def test_two_objects_side_by_side_along_the_track_are_measured_apart(apart_rows: int) -> None:
    """13 rows are 1.6 m from centre to centre."""
    first = Drawn(46, 150, 5, 6, 20)
    second = Drawn(46 + apart_rows, 150, 5, 6, 20)
    for floor in (even(), *(speckle(seed, SHAPE, spread_pixels=1.0) for seed in (1, 2, 3))):
        tile = make_tile(draw(draw(floor, first, 12.0), second, 12.0))
        for drawn_object in (first, second):
            found = measured(tile, drawn_object)
            assert found.row == pytest.approx(drawn_object.centre[0], abs=1.0)
            assert found.column == pytest.approx(drawn_object.centre[1], abs=1.0)
            assert found.along_m < 1.2


def test_two_objects_one_behind_the_other_are_measured_apart() -> None:
    """1.6 m from centre to centre, the second clear of the first one's shadow."""
    first, second = Drawn(78, 120, 5, 6, 10), Drawn(78, 147, 5, 6, 12)
    tile = make_tile(draw(draw(even(), first), second))
    for drawn_object in (first, second):
        found = measured(tile, drawn_object)
        assert found.column == pytest.approx(drawn_object.centre[1], abs=0.5)
        assert found.across_m / COLUMN_M == pytest.approx(drawn_object.columns, abs=1.5)
        assert found.shadow_length_m / COLUMN_M == pytest.approx(drawn_object.shadow_columns, abs=2.0)


def test_a_shadow_alone_is_placed_where_it_starts() -> None:
    drawn_object = Drawn(76, 150, 8, 1, 30)
    found = measured(make_tile(draw(even(), drawn_object, bright=1.0)), drawn_object)
    assert found.has_shadow
    assert not found.has_highlight
    assert math.isnan(found.highlight_db)
    assert found.row == pytest.approx(drawn_object.centre[0], abs=4.0)
    assert found.column == pytest.approx(151.0, abs=2.0)


def test_a_highlight_alone_has_no_height() -> None:
    drawn_object = Drawn(78, 150, 5, 6, 0)
    tile = make_tile(draw(even(), drawn_object, bright=30.0))
    found = measured_at(tile, Peak(5.0, 80, 152), 0.0)
    assert found.has_highlight
    assert not found.has_shadow
    assert math.isnan(found.height_m)
    assert math.isnan(found.shadow_length_m)
    assert math.isnan(found.shadow_db)


def test_bright_speckle_inside_a_shadow_does_not_end_it() -> None:
    drawn_object = Drawn(76, 150, 9, 6, 40)
    plane = draw(even(), drawn_object)
    plane[76:85, 170:173] = 1.0
    assert measured(make_tile(plane), drawn_object).shadow_length_m / COLUMN_M == pytest.approx(40, abs=2.0)


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), gap=st.integers(0, 8))
def test_holes_up_to_the_gap_are_filled_and_nothing_else_is_changed(seed: int, gap: int) -> None:
    random = np.random.default_rng(seed)
    mask = random.random((3, int(random.integers(1, 40)))) < random.choice([0.1, 0.3, 0.7])
    expected = mask.copy()
    for i, row in enumerate(mask):
        marks = np.flatnonzero(row)
        for a, b in pairwise(marks):
            if b - a - 1 <= gap:
                expected[i, a:b] = True
    np.testing.assert_array_equal(_bridged(mask, gap), expected)


def beam(footprint_m: float, step_m: float) -> NDArray[np.float64]:
    """Share of the energy per step along track of a beam that is Gaussian and `footprint_m` wide at half power."""
    reach = math.ceil(3.0 * footprint_m / step_m)
    share = 2.0 ** -((2.0 * np.arange(-reach, reach + 1) * step_m / footprint_m) ** 2)
    return np.asarray(share / share.sum())


@settings(max_examples=40)
@given(length_m=st.floats(0.05, 6.0), footprint_m=st.floats(0.05, 1.5), level=st.floats(0.01, 0.5))
def test_an_even_object_of_any_contrast_keeps_its_length_and_a_point_is_short(
    length_m: float, footprint_m: float, level: float
) -> None:
    """Against the image drawn step by step and measured with a ruler."""
    step_m = 0.004
    n_steps = round(length_m / step_m)
    image = np.convolve(np.ones(n_steps), beam(footprint_m, step_m))
    extent_m = np.count_nonzero(image >= level * image.max()) * step_m
    found_m = without_footprint(extent_m, footprint_m, level)
    if length_m > 0.6 * footprint_m:
        assert found_m == pytest.approx(n_steps * step_m, rel=0.02, abs=2.5 * step_m)
    else:
        assert found_m < 0.7 * footprint_m + 2.5 * step_m
    point_m = 2.0 * math.floor(0.5 * footprint_m * math.sqrt(math.log2(1.0 / level)) / step_m) * step_m
    assert without_footprint(point_m, footprint_m, level) <= 0.11 * footprint_m * math.sqrt(math.log2(1.0 / level))


def test_without_a_beam_an_object_is_as_long_as_its_image() -> None:
    for level in (1e-3, 0.1, 0.5, 0.9):
        assert without_footprint(2.0, 0.0, level) == pytest.approx(2.0, rel=1e-6)


def test_what_is_measured_grows_with_the_image_and_never_beyond_it() -> None:
    for level in (0.01, 0.1, 0.5, 0.9):
        found = [without_footprint(extent_m, 0.8, level) for extent_m in np.linspace(0.01, 8.0, 200)]
        assert np.all(np.diff(found) > 0.0)
        assert np.all(np.array(found) <= np.linspace(0.01, 8.0, 200) + 1e-6)


def through_beam(plane: Plane, footprint_m: float) -> Plane:
    share = beam(footprint_m, ROW_M)
    reach = len(share) // 2
    padded = np.pad(plane.astype(np.float64), ((reach, reach), (0, 0)), mode="edge")
    return np.asarray(sum(weight * padded[k : k + plane.shape[0]] for k, weight in enumerate(share)), dtype=np.float32)


@settings(max_examples=30)
@given(rows=st.integers(1, 4), bright=st.floats(20.0, 1000.0), footprint_m=st.floats(0.5, 1.2))
def test_a_short_object_seen_through_a_wide_beam_is_short_up_to_30_db_over_the_sea_floor(
    rows: int, bright: float, footprint_m: float
) -> None:
    drawn_object = Drawn(58, 200, rows, 6, 40)
    tile = make_tile(through_beam(draw(even(), drawn_object, bright, 0.01), footprint_m))
    slant_m = math.hypot(drawn_object.centre[1] * COLUMN_M, FIRST_RETURN_M)
    found = measured_at(tile, Peak(5.0, drawn_object.row + rows // 2, 203), footprint_m / slant_m)
    assert found.has_highlight
    # Three whole rows of the beam's edge, and half a row by which edges are interpolated. At 37 dB it is 4.7 rows.
    assert found.along_m < max(rows * ROW_M, 0.5 * footprint_m) + 3.5 * ROW_M


@pytest.mark.parametrize("bright", [6.0, 30.0, 300.0])
@pytest.mark.parametrize("footprint_m", [0.3, 0.8, 1.2])
def test_a_long_object_seen_through_a_wide_beam_keeps_its_length(bright: float, footprint_m: float) -> None:
    drawn_object = Drawn(52, 200, 18, 6, 40)
    tile = make_tile(through_beam(draw(even(), drawn_object, bright, 0.01), footprint_m))
    slant_m = math.hypot(drawn_object.centre[1] * COLUMN_M, FIRST_RETURN_M)
    found = measured_at(tile, Peak(5.0, 61, 203), footprint_m / slant_m)
    assert found.along_m == pytest.approx(18 * ROW_M, abs=2.5 * ROW_M)
    assert found.row == pytest.approx(drawn_object.centre[0], abs=0.5)


def test_dark_speckle_beside_a_shadow_does_not_lengthen_it() -> None:
    """Single-look speckle that changes every third row only, as where pings are far apart: dark pixels run together for
    metres.
    """
    drawn_object = Drawn(57, 200, 9, 6, 50)
    lengths = []
    for seed in range(12):
        floor = np.repeat(speckle(seed, (SHAPE[0] // 3, SHAPE[1]), spread_pixels=1.0), 3, axis=0)
        found = measured(make_tile(draw(floor, drawn_object, 20.0, 0.05)), drawn_object, 0.04)
        assert not found.touches_border
        lengths.append(found.along_m)
    assert np.median(lengths) == pytest.approx(9 * ROW_M, abs=1.5 * ROW_M)
    assert max(lengths) < 3.0


def test_an_object_that_leaves_the_region_is_said_to_but_one_cut_off_by_the_end_of_the_track_is_not() -> None:
    n_rows = 2 * round(ROWS_M / ROW_M) + 40
    ridge = draw(even((n_rows, 300)), Drawn(0, 150, n_rows, 6, 20))
    tile = make_tile(ridge)
    assert measured_at(tile, Peak(5.0, n_rows // 2, 152), 0.0).touches_border
    at_start = Drawn(0, 150, 4, 6, 20)
    assert not measured(make_tile(draw(even(), at_start)), at_start).touches_border
    at_end = Drawn(SHAPE[0] - 4, 150, 4, 6, 20)
    assert not measured(make_tile(draw(even(), at_end)), at_end).touches_border


@pytest.mark.parametrize(
    "drawn_object",
    [Drawn(0, 150, 5, 6, 20), Drawn(115, 150, 5, 6, 20), Drawn(70, 285, 6, 6, 29), Drawn(70, 20, 6, 6, 10)],
)
def test_objects_at_the_edge_of_the_picture_are_measured(drawn_object: Drawn) -> None:
    found = measured(make_tile(draw(even(), drawn_object)), drawn_object)
    assert found.row == pytest.approx(drawn_object.centre[0], abs=1.0)
    assert found.column == pytest.approx(drawn_object.centre[1], abs=1.0)
    assert found.shadow_length_m / COLUMN_M == pytest.approx(drawn_object.shadow_columns, abs=2.0)


def test_turns_and_clipping_are_reported_at_the_object_only() -> None:
    drawn_object = Drawn(78, 150, 5, 6, 20)
    plane = draw(even(), drawn_object)
    far = np.full(SHAPE, VALID, dtype=np.uint8)
    far[:, 240:] |= TURN | SATURATED
    at = far.copy()
    at[80, 152] |= TURN | SATURATED
    for mask, expected in ((far, False), (at, True)):
        found = measured(make_tile(plane, mask), drawn_object)
        assert (found.in_turn, found.saturated) == (expected, expected)


def test_the_picture_shows_the_object_where_it_says() -> None:
    drawn_object = Drawn(78, 150, 5, 6, 20)
    tile = make_tile(draw(speckle(1, SHAPE), drawn_object, 20.0))
    found = measured(tile, drawn_object)
    height, width = found.snippet.shape
    first_row, first_column = round(found.row - found.snippet_row), round(found.column - found.snippet_column)
    part = tile.intensity[first_row : first_row + height, first_column : first_column + width]
    np.testing.assert_array_equal(found.snippet, pack_snippet(part))
    assert not np.shares_memory(found.snippet, tile.intensity)


def wild_tile(seed: int) -> Tile:
    random = np.random.default_rng(seed)
    shape = (int(random.integers(1, 90)), int(random.integers(1, 220)))
    plane = (speckle(seed, shape) * random.choice([1e-3, 1.0, 1.0, 50.0], shape)).astype(np.float32)
    plane[random.random(shape) < random.choice([0.0, 0.3])] = 0.0
    mask: NDArray[np.uint8] = np.full(shape, VALID, dtype=np.uint8)
    for bit in (SATURATED, TURN):
        mask[random.random(shape) < 0.1] |= bit
    mask[random.random(shape) < random.choice([0.0, 0.1, 0.9])] = 0
    return make_tile(
        plane,
        mask,
        row_m=float(random.choice([0.05, 0.12, 2.0])),
        column_m=float(random.choice([0.01, 0.06, 2.0])),
        first_return_m=float(random.choice([0.0, 0.3, 6.0, 100.0])),
    )


@settings(max_examples=60)
@given(seed=st.integers(0, 100_000))
def test_any_pixel_of_any_tile_can_be_measured(seed: int) -> None:
    tile = wild_tile(seed)
    n_rows, n_columns = tile.mask.shape
    random = np.random.default_rng(seed + 1)
    with np.errstate(all="raise", under="ignore"):
        for _ in range(4):
            peak = Peak(1.0, int(random.integers(0, n_rows)), int(random.integers(0, n_columns)))
            found = measured_at(tile, peak, float(random.choice([0.0, 0.01, 0.3])))
            assert 0.0 <= found.row <= n_rows
            assert 0.0 <= found.column <= n_columns
            assert (
                abs(found.row - 0.5 - peak.row) * tile.row_spacing_m
                <= max(ROWS_M, tile.row_spacing_m) + tile.row_spacing_m
            )
            assert found.along_m > 0.0
            assert found.across_m > 0.0
            assert math.isnan(found.highlight_db) is not found.has_highlight
            assert all(
                math.isnan(v) is not found.has_shadow for v in (found.shadow_db, found.shadow_length_m, found.height_m)
            )
            assert not found.height_m < 0.0
            assert not found.shadow_length_m <= 0.0
            again = measured_at(tile, peak, 0.0)._replace(snippet=found.snippet)
            assert again.row == found.row
            assert 0.0 <= found.snippet_row <= found.snippet.shape[0]
            assert 0.0 <= found.snippet_column <= found.snippet.shape[1]
