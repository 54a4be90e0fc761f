"""Chips against cells summed up pixel by pixel."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.fitting.cascade.classical.chips import (
    CENTRE_COLUMN,
    CENTRE_ROW,
    N_COLUMNS,
    N_OBJECT_COLUMNS,
    N_ROWS,
    Chips,
    cut_chips,
    picture,
    reference_shadow_m,
)
from tests.sim_replay.fitting.cascade.classical.chip_samples import ALTITUDE_M, COLUMN_M, ROW_M, generator

Codes = NDArray[np.uint16]
Valid = NDArray[np.bool_]


def _oracle(
    codes: Codes, valid: Valid, first_return_m: NDArray[np.float64], row: int, column: int
) -> NDArray[np.float64]:
    """One chip, each pixel shared out to the cells it overlaps."""
    shadow_m = min(max(0.35 * (column + 0.5) * COLUMN_M / (max(first_return_m[row], 0.65) - 0.35), 0.4), 6.0)
    widths_m = [0.08] * 20 + [0.05 * shadow_m] * 24
    mean = np.full((N_ROWS, N_COLUMNS), math.nan)
    for i in range(N_ROWS):
        top = row + 0.5 + (i - 8.5) * 0.12 / ROW_M
        for j in range(N_COLUMNS):
            left = column + 0.5 + (-1.0 + sum(widths_m[:j])) / COLUMN_M
            mean[i, j] = _cell(codes, valid, (top, top + 0.12 / ROW_M), (left, left + widths_m[j] / COLUMN_M))
    median = float(np.median(mean[np.isfinite(mean)])) if np.isfinite(mean).any() else 0.0
    if median <= 0.0:
        return np.zeros((N_ROWS, N_COLUMNS))
    return np.where(np.isfinite(mean), np.log(np.maximum(mean / median, 0.01)), 0.0)


def _cell(codes: Codes, valid: Valid, rows: tuple[float, float], columns: tuple[float, float]) -> float:
    total = weight = 0.0
    for row in range(math.floor(rows[0]), math.ceil(rows[1])):
        for column in range(math.floor(columns[0]), math.ceil(columns[1])):
            if 0 <= row < codes.shape[0] and 0 <= column < codes.shape[1] and valid[row, column]:
                share = (min(rows[1], row + 1) - max(rows[0], row)) * (
                    min(columns[1], column + 1) - max(columns[0], column)
                )
                total += share * float(codes[row, column])
                weight += share
    area = (rows[1] - rows[0]) * (columns[1] - columns[0])
    return total / weight if weight > 0.5 * area else math.nan


def _speckle(seed: int, shape: tuple[int, int] = (40, 300)) -> Codes:
    return np.asarray(np.rint(np.minimum(generator(seed).exponential(1.0, shape), 8.0) * 1024.0), dtype=np.uint16)


def _cut(codes: Codes, valid: Valid, first_return_m: NDArray[np.float64], *places: tuple[int, int]) -> Chips:
    rows, columns = np.array(places, dtype=np.int32).T
    return cut_chips(picture(codes, valid, first_return_m, ROW_M, COLUMN_M), rows, columns)


@settings(max_examples=12, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    place=st.tuples(st.integers(0, 39), st.integers(0, 299)),
    altitude_m=st.sampled_from([0.1, 2.0, 6.0, 15.0]),
    hole=st.tuples(st.integers(0, 30), st.integers(0, 280)),
)
def test_chips_hold_the_mean_of_every_cell_over_their_median(
    seed: int, place: tuple[int, int], altitude_m: float, hole: tuple[int, int]
) -> None:
    codes = _speckle(seed)
    valid = np.ones(codes.shape, dtype=np.bool_)
    valid[hole[0] : hole[0] + 8, hole[1] : hole[1] + 20] = False
    # A cell just half of which is known may go either way by rounding: nothing is measured there.
    altitude = np.full(40, altitude_m * (1.0 + 1e-4 * math.sqrt(2.0)))
    chips = _cut(codes, valid, altitude, place)
    assert chips.contrast[0] == pytest.approx(_oracle(codes, valid, altitude, *place), abs=1e-6)


def test_what_masked_pixels_hold_changes_nothing() -> None:
    codes, other = _speckle(1), _speckle(2)
    valid = generator(3).random(codes.shape) < 0.8
    first, second = (
        _cut(np.where(valid, codes, filled), valid, np.full(40, 6.0), (20, 100), (0, 0)) for filled in (0, other)
    )
    assert np.array_equal(first.contrast, second.contrast)


@pytest.mark.parametrize("gain", [2, 8])
def test_a_gain_changes_nothing(gain: int) -> None:
    codes = np.minimum(_speckle(4), 1024)
    valid = np.ones(codes.shape, dtype=np.bool_)
    first, second = (
        _cut(np.asarray(codes * np.uint16(g)), valid, np.full(40, 6.0), (20, 100), (39, 299)) for g in (1, gain)
    )
    assert first.contrast == pytest.approx(second.contrast, abs=1e-9)


def test_a_tile_turned_round_gives_mirrored_chips() -> None:
    codes = _speckle(5)
    valid = generator(6).random(codes.shape) < 0.9
    first = _cut(codes, valid, np.full(40, 6.0), (15, 140))
    second = _cut(codes[::-1], valid[::-1], np.full(40, 6.0), (24, 140))
    assert second.contrast[0][::-1] == pytest.approx(first.contrast[0], abs=1e-6)


def test_a_shadow_of_the_reference_object_ends_in_the_same_column_at_all_ranges() -> None:
    ends = set()
    for column in (120, 300, 600, 780):
        codes = np.full((40, 1000), 1024, dtype=np.uint16)
        shadow_m = float(reference_shadow_m(np.array((column + 0.5) * COLUMN_M), np.array(ALTITUDE_M)))
        start = column + 0.5 + 0.6 / COLUMN_M
        codes[:, round(start) : round(start + shadow_m / COLUMN_M)] = 32
        contrast = _cut(codes, np.ones(codes.shape, dtype=np.bool_), np.full(40, ALTITUDE_M), (20, column)).contrast[0]
        ends.add(int(np.flatnonzero(contrast[CENTRE_ROW] < contrast[CENTRE_ROW].mean())[-1]))
    assert ends <= {N_OBJECT_COLUMNS + 19, N_OBJECT_COLUMNS + 20}


def test_the_centre_of_a_chip_is_the_pixel_it_was_cut_around() -> None:
    codes = np.full((40, 300), 100, dtype=np.uint16)
    codes[20, 130] = 10_000
    contrast = _cut(codes, np.ones(codes.shape, dtype=np.bool_), np.full(40, 6.0), (20, 130)).contrast[0]
    assert np.unravel_index(contrast.argmax(), contrast.shape) == (CENTRE_ROW, CENTRE_COLUMN)


@pytest.mark.parametrize("code", [0, 1024, 16384])
def test_a_floor_without_any_variation_has_no_contrast(code: int) -> None:
    codes = np.full((40, 300), code, dtype=np.uint16)
    chips = _cut(codes, np.ones(codes.shape, dtype=np.bool_), np.full(40, 6.0), (20, 130), (0, 0))
    assert chips.contrast == pytest.approx(0.0, abs=1e-9)


def test_chips_mostly_beyond_the_tile_or_masked_are_not_known() -> None:
    codes = _speckle(7)
    valid = np.ones(codes.shape, dtype=np.bool_)
    valid[:, 200:] = False
    chips = _cut(codes, valid, np.full(40, 6.0), (20, 100), (0, 0), (20, 260))
    assert chips.known.tolist() == [True, False, False]
    assert np.array_equal(chips.contrast[2, :, -1], np.zeros(N_ROWS))


@pytest.mark.parametrize("first_return_m", [math.nan, 0.0, -1.0])
def test_an_altitude_not_known_counts_as_a_low_one(first_return_m: float) -> None:
    assert reference_shadow_m(np.array([0.0, 1.0, 100.0]), np.full(3, first_return_m)) == pytest.approx(
        [0.4, 0.35 / 0.3, 6.0]
    )
