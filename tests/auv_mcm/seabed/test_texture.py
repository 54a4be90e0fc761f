"""Textures against measuring one window at a time, and of floors whose texture is known."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.records import SEABED_TYPES, VALID
from auv_mcm.seabed.seabed_cells import seabed_cells
from auv_mcm.seabed.seabed_model import shipped_seabed_model
from auv_mcm.seabed.texture import BLOCK_M, CELL_BLOCKS, NAMES, WINDOWS, Texture, measure_texture
from tests.auv_mcm.seabed.seabed_tiles import COLUMN_M, ROW_M, rippled, speckled, tile_of

Array = NDArray[np.float64]
AT = {name: index for index, name in enumerate(NAMES)}


N = CELL_BLOCKS * WINDOWS["small"]
ROWS, COLUMNS = round(BLOCK_M / ROW_M), round(BLOCK_M / COLUMN_M)


def window_of(
    intensity: Array, mask: NDArray[np.uint8], cell: tuple[int, int], core_start: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Mean echoes of the blocks of the small window around a cell, with a margin of four blocks, and which of them are
    valid."""
    echo, valid = np.zeros((N + 8, N + 8)), np.zeros((N + 8, N + 8), dtype=np.bool_)
    margin = (N - CELL_BLOCKS) // 2 + 4
    for i in range(N + 8):
        for j in range(N + 8):
            row = core_start + (cell[0] * CELL_BLOCKS - margin + i) * ROWS
            column = (cell[1] * CELL_BLOCKS - margin + j) * COLUMNS
            values = [
                min(intensity[r, c], 20.0)
                for r in range(row, row + ROWS)
                for c in range(column, column + COLUMNS)
                if 0 <= r < intensity.shape[0] and 0 <= c < intensity.shape[1] and mask[r, c] == VALID
            ]
            if 2 * len(values) >= ROWS * COLUMNS:
                echo[i, j], valid[i, j] = np.mean(values), True
    return echo, valid


def one_by_one(intensity: Array, mask: NDArray[np.uint8], cell: tuple[int, int], core_start: int) -> dict[str, float]:
    """Features of the small window around a cell from its blocks, gathered one at a time."""
    wide, wide_valid = window_of(intensity, mask, cell, core_start)
    inner = slice(4, 4 + N)
    echo, there = wide[inner, inner], wide_valid[inner, inner]
    wide_level = np.log(np.maximum(wide, 1e-2))
    level = wide_level[inner, inner]
    reported = {
        "spread": math.log(level[there].var()),
        "skewness": float(np.mean((level[there] - level[there].mean()) ** 3) / level[there].std() ** 3),
        "dark": math.log(float(np.mean(echo[there] < 0.35)) + 0.003),
        "bright": math.log(float(np.mean(echo[there] > 2.5)) + 0.003),
    }
    for name, lag in (("grain", 1), ("lag", 4)):
        for way, (down, right) in (("along", (lag, 0)), ("across", (0, lag))):
            further = slice(4 + down, 4 + down + N), slice(4 + right, 4 + right + N)
            both = there & wide_valid[further]
            step = (wide_level[further] - level)[both]
            reported[f"{name}_{way}"] = math.log(0.5 * float(np.mean(step**2)) + 0.003)
            if name == "lag" and way == "across":
                reported["rise_far"] = float(np.mean(step**3) / (np.mean(step**2) + 0.003) ** 1.5)
    for name, n in (("medium", 2), ("coarse", 4)):
        boxes = []
        for i in range(0, N, n):
            for j in range(0, N, n):
                part = there[i : i + n, j : j + n]
                if 2 * np.count_nonzero(part) >= n * n:
                    boxes.append(math.log(echo[i : i + n, j : j + n][part].mean()))
        reported[f"spread_{name}"] = math.log(float(np.var(boxes)) + 0.003)
    return reported


def cell(texture: Texture, name: str, at: tuple[int, int]) -> float:
    return float(texture.features[(*at, AT[name])])


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1000), holes=st.floats(0.0, 0.3))
def test_features_are_those_of_one_window_at_a_time(seed: int, holes: float) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    intensity = speckled(rng, (200, 300)) * np.exp(rng.normal(0.0, 0.5, (200, 300)))
    mask = np.where(rng.uniform(size=(200, 300)) < holes, 0, VALID).astype(np.uint8)
    texture = measure_texture(tile_of(intensity, mask, core=(40, 150)))
    for at in ((1, 2), (2, 4), (4, 6)):
        for name, value in one_by_one(intensity, mask, at, 40).items():
            assert cell(texture, f"{name}_small", at) == pytest.approx(value, rel=1e-3, abs=2e-3), name


def test_speckle_alone_has_the_spread_of_its_number_of_looks() -> None:
    rng = np.random.Generator(np.random.PCG64(1))
    texture = measure_texture(tile_of(speckled(rng, (400, 500))))
    inner = texture.features[2:-2, 2:-2]
    # The logarithm of a mean of n single looks has the variance trigamma(n): of 2 x 4 pixels a block, and four blocks
    # together.
    assert np.exp(np.median(inner[..., AT["spread_large"]])) == pytest.approx(0.1331, rel=0.05)
    assert np.exp(np.median(inner[..., AT["spread_medium_large"]])) == pytest.approx(0.0317 + 0.003, rel=0.07)
    # Pixels by themselves: the contrast in a block of eight is 1 less what its mean takes of it, and neighbours are not
    # alike.
    assert np.median(inner[..., AT["contrast_fine_large"]]) == pytest.approx(7.0 / 9.0, abs=0.05)
    alone = np.median(inner[..., AT["likeness_fine_large"]])
    smeared = measure_texture(tile_of(speckled(rng, (400, 125)).repeat(4, axis=1))).features[
        2:-2, 2:-2, AT["likeness_fine_large"]
    ]
    assert alone < 0.2 < 0.4 < np.median(smeared)


def test_what_stands_up_is_bright_before_it_is_dark() -> None:
    """Differences towards far range fall steeply from highlight to shadow; seen from the other side they rise."""
    rng = np.random.Generator(np.random.PCG64(4))
    intensity = speckled(rng, (400, 500))
    for row, column in rng.integers(0, (390, 470), (400, 2)):
        intensity[row : row + 4, column : column + 8] *= 6.0
        intensity[row : row + 4, column + 8 : column + 24] *= 0.02
    seen, mirrored = (
        measure_texture(tile_of(part)).features[2:-3, 3:-3, AT["rise_far_large"]]
        for part in (intensity, intensity[:, ::-1])
    )
    assert np.median(seen) < -0.2
    assert np.median(mirrored) > 0.2


def test_levels_are_those_of_the_mission_and_zero_where_there_are_none() -> None:
    tile = tile_of(speckled(np.random.Generator(np.random.PCG64(5)), (400, 480)))
    assert (measure_texture(tile).features[2:-2, 2:-2, AT["level_small"]] == 0.0).all()
    level = np.zeros((400, 60), dtype=np.float32)
    level[200:] = 2.0
    features = measure_texture(msgspec.structs.replace(tile, level=level)).features
    n_along = features.shape[0]
    assert np.median(features[: n_along // 2 - 2, 2:-2, AT["level_small"]]) == pytest.approx(0.0, abs=0.1)
    assert np.median(features[n_along // 2 + 2 : -1, 2:-2, AT["level_small"]]) == pytest.approx(2.0, abs=0.1)
    assert np.median(features[n_along // 2, 4:-4, AT["level_spread"]]) > 0.8
    assert np.median(features[2, 4:-4, AT["level_spread"]]) < 0.2


@pytest.mark.parametrize("wavelength_m", [0.8, 1.3, 2.2])
@pytest.mark.parametrize("direction_deg", [0.0, 35.0, 90.0, 140.0])
def test_ripples_are_a_peak_at_their_wavelength_and_direction(wavelength_m: float, direction_deg: float) -> None:
    rng = np.random.Generator(np.random.PCG64(2))
    plain = measure_texture(tile_of(speckled(rng, (400, 500))))
    texture = measure_texture(tile_of(rippled(rng, (400, 500), wavelength_m, math.radians(direction_deg))))
    inner = slice(2, -2), slice(2, -2)
    off = np.angle(np.exp(2j * (texture.ripple_rad[inner] - math.radians(direction_deg)))) / 2.0
    assert np.rad2deg(np.abs(off)).max() < 9.0
    assert np.median(texture.wavelength_m[inner]) == pytest.approx(wavelength_m, rel=0.15)
    peaks, others = (each.features[(*inner, AT["ripple_peak"])] for each in (texture, plain))
    if wavelength_m < 2.0:  # few wavenumbers are as small as longer ones: among these a peak stands out less
        assert peaks.min() > others.max()


def test_what_is_not_measured_counts_as_such() -> None:
    mask = np.full((200, 300), VALID, dtype=np.uint8)
    mask[:, 150:] = 0
    texture = measure_texture(tile_of(np.ones((200, 300)), mask))
    assert np.isnan(texture.features[:, -1]).all()
    assert np.isfinite(texture.features[1:-2, 2]).all()


@pytest.mark.parametrize("value", [0.0, 1.0, 1e-30, 1e6])
def test_constant_floors_give_finite_features(value: float) -> None:
    with np.errstate(all="raise"):
        texture = measure_texture(tile_of(np.full((200, 300), value)))
    assert np.isfinite(texture.features[1:-2, 1:-1]).all()


def test_where_the_tile_is_cut_makes_no_difference() -> None:
    rng = np.random.Generator(np.random.PCG64(3))
    intensity = speckled(rng, (400, 300))
    cell_rows = CELL_BLOCKS * round(BLOCK_M / ROW_M)
    level = rng.normal(size=(400, 38)).astype(np.float32)
    first, stop = 64, 64 + 12 * cell_rows
    whole = measure_texture(msgspec.structs.replace(tile_of(intensity, core=(first, stop)), level=level))
    # The spectrum is that of two by two cells, and tiles are cut between them.
    first += 4 * cell_rows
    later = measure_texture(msgspec.structs.replace(tile_of(intensity, core=(first, stop)), level=level))
    assert np.array_equal(later.features, whole.features[4:], equal_nan=True)


def test_grazing_goes_by_range_over_altitude_and_without_one_nothing_is_reported() -> None:
    tile = tile_of(speckled(np.random.Generator(np.random.PCG64(7)), (200, 300)))
    tile = msgspec.structs.replace(tile, column_spacing_m=0.07)
    texture = measure_texture(tile)
    middle_m = (np.arange(len(texture.cot_grazing)) + 0.5) * texture.cell_m[1]
    assert texture.cot_grazing == pytest.approx(middle_m / float(np.median(tile.first_return_m)))
    higher = measure_texture(msgspec.structs.replace(tile, first_return_m=2.0 * tile.first_return_m))
    assert higher.cot_grazing == pytest.approx(0.5 * texture.cot_grazing)
    assert np.array_equal(higher.features, texture.features, equal_nan=True)
    without = msgspec.structs.replace(tile, first_return_m=np.full_like(tile.first_return_m, np.nan))
    assert np.isnan(measure_texture(without).features).all()
    cells = seabed_cells(without, shipped_seabed_model())
    assert (cells.kind == SEABED_TYPES.index("unknown")).all()
    assert (cells.confidence == 0.0).all()
