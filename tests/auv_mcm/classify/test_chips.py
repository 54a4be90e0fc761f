"""Tests of the chips that the verifier sees."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from auv_mcm.classify.chips import N_COLUMNS, N_HEIGHTS, N_ROWS, chip_of, chips_beside, floor_of, shadow_ends_m
from auv_mcm.confirm.region import Region
from tests.auv_mcm.classify.slow_chips import slow_levels_db

ROW_M, COLUMN_M, NEAR_M, HEIGHT_M = 0.125, 0.1, 2.0, 0.05


def region(seed: int = 1, rows: int = 67, columns: int = 190, **changes: float) -> Region:
    random = np.random.default_rng(seed)
    values: dict[str, float] = {
        "row_spacing_m": 0.12,
        "column_spacing_m": 0.06,
        "first_ground_range_m": 14.0,
        "altitude_m": 5.0,
        "row": 33.4,
        "column": 51.7,
        "beam_width_rad": 0.007,
    }
    return Region(
        intensity=random.exponential(size=(rows, columns)),
        valid=random.random((rows, columns)) < 0.9,
        **(values | changes),
    )


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1000), row=st.floats(0.0, 67.0), column=st.floats(0.0, 190.0), altitude=st.floats(1.0, 20.0))
def test_a_pixel_is_the_mean_of_what_it_covers(seed: int, row: float, column: float, altitude: float) -> None:
    seen = region(seed, row=row, column=column, altitude_m=altitude)
    chip = chip_of(seen)
    rows = row + ROW_M * (np.arange(N_ROWS + 1, dtype=np.float64) - 0.5 * N_ROWS) / 0.12
    middle_m = 14.0 + column * 0.06
    by_metres = (middle_m - NEAR_M + COLUMN_M * np.arange(N_COLUMNS + 1, dtype=np.float64) - 14.0) / 0.06
    tops_m = HEIGHT_M * np.arange(N_HEIGHTS + 1, dtype=np.float64)
    by_height = (altitude * middle_m / np.maximum(altitude - tops_m, 0.05) - 14.0) / 0.06
    metres_db, heights_db = (slow_levels_db(seen, rows, columns) for columns in (by_metres, by_height))
    known = metres_db[~np.isnan(metres_db)]
    middle_db = float(np.median(known)) if len(known) else 0.0
    spread_db = 1.4826 * float(np.median(np.abs(known - middle_db))) if len(known) else 1.0
    for found, expected_db in ((chip.by_metres, metres_db), (chip.by_height, heights_db)):
        expected = np.nan_to_num((expected_db - middle_db) / max(spread_db, 0.5), nan=0.0).clip(-8.0, 8.0)
        np.testing.assert_allclose(found, expected, atol=2e-5)


@given(gain_db=st.floats(-15.0, 15.0))
@settings(max_examples=10, deadline=None)
def test_gain_drops_out(gain_db: float) -> None:
    seen = region()
    louder = structs.replace(seen, intensity=seen.intensity * 10.0 ** (0.1 * gain_db))
    for one, other in zip(chip_of(seen), chip_of(louder), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-4)


def test_compression_of_the_levels_drops_out() -> None:
    levels_db = np.random.default_rng(3).normal(size=(N_ROWS, N_COLUMNS)) * 4.0
    middle_db, spread_db = floor_of(levels_db.ravel())
    other_db, other_spread_db = floor_of(0.5 * levels_db.ravel() + 7.0)
    np.testing.assert_allclose(
        (levels_db - middle_db) / spread_db, (0.5 * levels_db + 7.0 - other_db) / other_spread_db
    )


def test_the_floor_s_spread_hardly_moves_for_an_object() -> None:
    levels_db = np.random.default_rng(3).normal(size=(N_ROWS, N_COLUMNS)) * 4.0
    _, spread_db = floor_of(levels_db.ravel())
    levels_db[15:25, 20:24] = 20.0
    levels_db[15:25, 24:40] = -30.0
    assert floor_of(levels_db.ravel())[1] == pytest.approx(spread_db, rel=0.1)


def test_nothing_measured_is_a_chip_of_zeros() -> None:
    seen = region()
    blank = structs.replace(seen, valid=np.zeros_like(seen.valid))
    chip = chip_of(blank)
    assert not chip.by_metres.any()
    assert not chip.by_height.any()


def test_a_shadow_ends_where_the_ray_over_the_top_meets_the_floor() -> None:
    ends_m = shadow_ends_m(20.0, 5.0, np.array([0.0, 1.0, 4.9, 5.0, 9.0]))
    assert ends_m[0] == 20.0
    assert ends_m[1] - 20.0 == pytest.approx(1.0 / math.tan(math.atan2(5.0 - 1.0, 20.0)))
    assert np.isfinite(ends_m).all()


def test_chips_beside_are_the_mirror_image_and_two_of_a_highlight_a_little_off() -> None:
    seen = region()
    chip = chip_of(seen)
    mirrored, nearer, farther = chips_beside(seen, chip)
    np.testing.assert_array_equal(mirrored.by_metres, chip.by_metres[::-1])
    np.testing.assert_array_equal(mirrored.by_height, chip.by_height[::-1])
    for off_m, beside in ((-0.2, nearer), (0.2, farther)):
        moved = structs.replace(seen, row=seen.row + off_m / 0.12, column=seen.column + off_m / 0.06)
        for one, other in zip(beside, chip_of(moved), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-4)
