"""Large shadows against boxes counted one by one, and what is and is not one."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.clearance.coverage import cover_tile
from auv_mcm.clearance.shadowed import BLOCK_M, DARK, LARGE_M, in_large_shadow
from auv_mcm.records import VALID, Tile
from auv_mcm.settings.config import SonarConfig
from tests.auv_mcm.clearance import covered_tiles

Mask = NDArray[np.bool_]

ROW_M, COLUMN_M = covered_tiles.ROW_M, 0.06
SHAPE = (256, 400)


def tile_of(
    intensity: NDArray[np.float32], mask: NDArray[np.uint8], row_m: float = ROW_M, column_m: float = COLUMN_M
) -> Tile:
    return msgspec.structs.replace(
        covered_tiles.tile_of(mask), intensity=intensity, row_spacing_m=row_m, column_spacing_m=column_m
    )


def by_boxes(tile: Tile) -> Mask:
    """Every box that the blocks allow, one after the other."""
    block = [max(1, round(BLOCK_M / spacing)) for spacing in (tile.row_spacing_m, tile.column_spacing_m)]
    n = [size // of_block for size, of_block in zip(tile.mask.shape, block, strict=True)]
    spacing = block[0] * tile.row_spacing_m, block[1] * tile.column_spacing_m
    found = np.zeros(tile.mask.shape, dtype=np.bool_)
    valid = (tile.mask & VALID) > 0
    for size_m in LARGE_M:
        size = [
            2 * max(round((extent / of_block - 1.0) / 2.0), 0) + 1
            for extent, of_block in zip(size_m, spacing, strict=True)
        ]
        for i in range(n[0] - size[0] + 1):
            for j in range(n[1] - size[1] + 1):
                box = slice(i * block[0], (i + size[0]) * block[0]), slice(j * block[1], (j + size[1]) * block[1])
                inside = valid[box]
                if inside.mean() >= 0.5 and tile.intensity[box][inside].mean() < DARK:
                    reached = [
                        slice(part.start, whole if part.stop == last * of_block else part.stop)
                        for part, whole, last, of_block in zip(box, tile.mask.shape, n, block, strict=True)
                    ]
                    found[reached[0], reached[1]] = True
    return found


def speckled(seed: int, mean: NDArray[np.float64]) -> NDArray[np.float32]:
    return (mean * np.random.Generator(np.random.PCG64(seed)).exponential(1.0, mean.shape)).astype(np.float32)


@settings(max_examples=30, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 60), st.integers(1, 140)),
    spacing_m=st.tuples(st.sampled_from([0.12, 0.2, 0.5]), st.sampled_from([0.06, 0.11, 0.3])),
    top=st.integers(0, 50),
    height=st.integers(0, 60),
    level=st.sampled_from([0.0, 0.02, 0.3]),
    lost=st.sampled_from([0.0, 0.3, 0.6]),
    seed=st.integers(0, 1000),
)
@example((59, 139), (0.12, 0.06), 10, 49, 0.02, 0.0, 1)  # rows and columns that fill no block are in the dark
def test_every_dark_box_is_found_and_nothing_else(
    shape: tuple[int, int], spacing_m: tuple[float, float], top: int, height: int, level: float, lost: float, seed: int
) -> None:
    mean = np.ones(shape)
    mean[top : top + height] = level
    mask = (np.random.Generator(np.random.PCG64(seed)).uniform(size=shape) >= lost).astype(np.uint8) * VALID
    tile = tile_of(speckled(seed, mean) * (mask > 0), mask, *spacing_m)
    assert (in_large_shadow(tile) == by_boxes(tile)).all()


@pytest.mark.parametrize(
    ("along_m", "across_m", "is_large"),
    [
        (2.5, 2.2, False),  # a long cylinder's
        (0.6, 5.0, False),  # a sphere's, far out
        (1.2, 8.0, True),  # a mast's
        (12.0, 4.0, True),  # a hull's
    ],
)
def test_what_is_larger_than_a_mines_shadow_is_large(along_m: float, across_m: float, is_large: bool) -> None:
    mean = np.ones(SHAPE)
    hidden = slice(60, 60 + round(along_m / ROW_M)), slice(150, 150 + round(across_m / COLUMN_M))
    mean[hidden] = 0.02
    tile = tile_of(speckled(1, mean), np.full(SHAPE, VALID, dtype=np.uint8))
    found = in_large_shadow(tile)
    assert found.any() == is_large
    if is_large:
        assert found[hidden].mean() > 0.85
        assert found.sum() < 1.25 * np.prod(found[hidden].shape)


def test_ripples_and_speckle_hide_no_floor() -> None:
    range_m = np.arange(SHAPE[1]) * COLUMN_M
    rippled = np.broadcast_to(np.exp(2.5 * np.sin(2.0 * math.pi * range_m / 1.5)), SHAPE)
    for mean in (np.ones(SHAPE), rippled / rippled.mean()):
        assert not in_large_shadow(tile_of(speckled(3, mean), np.full(SHAPE, VALID, dtype=np.uint8))).any()


def test_hidden_floor_earns_no_coverage_and_is_reported() -> None:
    mean = np.ones(SHAPE)
    mean[60:160, 200:300] = 0.01
    tile = tile_of(speckled(4, mean), np.full(SHAPE, VALID, dtype=np.uint8))
    patch = cover_tile(tile, SonarConfig())
    hidden_m2 = float(in_large_shadow(tile).sum()) * ROW_M * COLUMN_M
    assert patch.lost_m2["shadow"] == pytest.approx(hidden_m2)
    assert hidden_m2 == pytest.approx(100 * 100 * ROW_M * COLUMN_M, rel=0.2)
    assert patch.covered_m2 + hidden_m2 == pytest.approx(SHAPE[0] * SHAPE[1] * ROW_M * COLUMN_M)
