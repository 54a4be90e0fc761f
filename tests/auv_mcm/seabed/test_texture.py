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
from auv_mcm.seabed.texture import BLOCK_M, CELL_BLOCKS, NAMES, WINDOW_BLOCKS, Texture, measure_texture
from tests.auv_mcm.seabed.seabed_tiles import COLUMN_M, ROW_M, rippled, speckled, tile_of

Array = NDArray[np.float64]
AT = {name: index for index, name in enumerate(NAMES)}


def one_by_one(intensity: Array, mask: NDArray[np.uint8], cell: tuple[int, int], core_start: int) -> dict[str, float]:
    """Features of a cell from its blocks, gathered one at a time."""
    rows, columns = round(BLOCK_M / ROW_M), round(BLOCK_M / COLUMN_M)
    echo, valid = np.zeros((WINDOW_BLOCKS,) * 2), np.zeros((WINDOW_BLOCKS,) * 2)
    margin = (WINDOW_BLOCKS - CELL_BLOCKS) // 2
    for i in range(WINDOW_BLOCKS):
        for j in range(WINDOW_BLOCKS):
            row = core_start + (cell[0] * CELL_BLOCKS - margin + i) * rows
            column = (cell[1] * CELL_BLOCKS - margin + j) * columns
            values = [
                intensity[r, c]
                for r in range(row, row + rows)
                for c in range(column, column + columns)
                if 0 <= r < intensity.shape[0] and 0 <= c < intensity.shape[1] and mask[r, c] == VALID
            ]
            if 2 * len(values) >= rows * columns:
                echo[i, j], valid[i, j] = np.mean(values), 1.0
    there = valid > 0.0
    level = np.log(np.maximum(echo, 1e-2))
    told = {
        "dark": math.log(float(np.mean(echo[there] < 0.35)) + 0.003),
        "bright": math.log(float(np.mean(echo[there] > 2.5)) + 0.003),
        "skewness": float(np.mean((level[there] - level[there].mean()) ** 3) / level[there].std() ** 3),
    }
    for name, n in (("lacunarity_fine", 1), ("lacunarity_medium", 2), ("lacunarity_coarse", 4)):
        boxes = []
        for i in range(0, WINDOW_BLOCKS, n):
            for j in range(0, WINDOW_BLOCKS, n):
                part = there[i : i + n, j : j + n]
                if 2 * np.count_nonzero(part) >= n * n:
                    boxes.append(echo[i : i + n, j : j + n][part].mean())
        told[name] = math.log(float(np.var(boxes) / np.mean(boxes) ** 2) + 0.003)
    tensor = np.zeros((2, 2))
    for i in range(1, WINDOW_BLOCKS - 1):
        for j in range(1, WINDOW_BLOCKS - 1):
            gradient = [
                (level[i + 1, j] - level[i - 1, j]) * valid[i + 1, j] * valid[i - 1, j],
                (level[i, j + 1] - level[i, j - 1]) * valid[i, j + 1] * valid[i, j - 1],
            ]
            tensor += np.outer(gradient, gradient)
    small, large = np.linalg.eigvalsh(tensor)
    told["anisotropy"] = float((large - small) / (large + small))
    return told


def cell(texture: Texture, name: str, at: tuple[int, int]) -> float:
    return float(texture.features[(*at, AT[name])])


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1000), holes=st.floats(0.0, 0.3))
def test_features_are_those_of_one_window_at_a_time(seed: int, holes: float) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    intensity = speckled(rng, (200, 300)) * np.exp(rng.normal(0.0, 0.5, (200, 300)))
    mask = np.where(rng.uniform(size=(200, 300)) < holes, 0, VALID).astype(np.uint8)
    texture = measure_texture(tile_of(intensity, mask, core=(40, 150)))
    for at in ((0, 1), (1, 2), (2, 3)):
        for name, value in one_by_one(intensity, mask, at, 40).items():
            # Windows have the border's gradients as well, which one window by itself has not.
            tolerance = 0.08 if name == "anisotropy" else 1e-5
            assert cell(texture, name, at) == pytest.approx(value, rel=1e-5, abs=tolerance), name


def test_speckle_alone_has_the_lacunarity_of_its_number_of_looks() -> None:
    rng = np.random.Generator(np.random.PCG64(1))
    texture = measure_texture(tile_of(speckled(rng, (400, 500))))
    inner = texture.features[1:-1, 1:-1]
    # A block of 2 x 4 independent pixels has the variance 1/8, two by two of them 1/32.
    assert np.exp(np.median(inner[..., AT["lacunarity_fine"]])) == pytest.approx(1.0 / 8.0 + 0.003, rel=0.05)
    assert np.exp(np.median(inner[..., AT["lacunarity_medium"]])) == pytest.approx(1.0 / 32.0 + 0.003, rel=0.07)


@pytest.mark.parametrize("wavelength_m", [0.8, 1.3, 2.2])
@pytest.mark.parametrize("direction_deg", [0.0, 35.0, 90.0, 140.0])
def test_ripples_are_a_peak_at_their_wavelength_and_direction(wavelength_m: float, direction_deg: float) -> None:
    rng = np.random.Generator(np.random.PCG64(2))
    plain = measure_texture(tile_of(speckled(rng, (400, 500))))
    texture = measure_texture(tile_of(rippled(rng, (400, 500), wavelength_m, math.radians(direction_deg))))
    inner = slice(1, -1), slice(1, -1)
    off = np.angle(np.exp(2j * (texture.ripple_rad[inner] - math.radians(direction_deg)))) / 2.0
    assert np.rad2deg(np.abs(off)).max() < 9.0
    assert np.median(texture.wavelength_m[inner]) == pytest.approx(wavelength_m, rel=0.15)
    peaks, others = (each.features[(*inner, AT["ripple_peak"])] for each in (texture, plain))
    if wavelength_m < 2.0:  # few wavenumbers are as small as longer ones: among these a peak stands out less
        assert peaks.min() > others.max()


def test_what_is_not_measured_is_told_as_such() -> None:
    mask = np.full((200, 300), VALID, dtype=np.uint8)
    mask[:, 150:] = 0
    texture = measure_texture(tile_of(np.ones((200, 300)), mask))
    assert np.isnan(texture.features[:, -1]).all()
    assert np.isfinite(texture.features[1:-2, 1]).all()


@pytest.mark.parametrize("value", [0.0, 1.0, 1e-30, 1e6])
def test_constant_floors_give_finite_features(value: float) -> None:
    with np.errstate(all="raise"):
        texture = measure_texture(tile_of(np.full((200, 300), value)))
    assert np.isfinite(texture.features[1:-2, 1:-1]).all()


def test_where_the_tile_is_cut_makes_no_difference() -> None:
    rng = np.random.Generator(np.random.PCG64(3))
    intensity = speckled(rng, (400, 300))
    cell_rows = CELL_BLOCKS * round(BLOCK_M / ROW_M)
    whole = measure_texture(tile_of(intensity, core=(32, 32 + 8 * cell_rows)))
    later = measure_texture(tile_of(intensity, core=(32 + 3 * cell_rows, 32 + 8 * cell_rows)))
    assert np.array_equal(later.features, whole.features[3:], equal_nan=True)


def test_grazing_goes_by_range_over_altitude_and_without_one_nothing_is_told() -> None:
    tile = tile_of(speckled(np.random.Generator(np.random.PCG64(7)), (200, 300)))
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
