"""Texture as R. M. Haralick had it ("Textural features for image classification", IEEE SMC 3, 1973), to compare with."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import SATURATED, VALID, Tile
from auv_mcm.seabed.texture import BLOCK_M, CELL_BLOCKS, WINDOW_BLOCKS

Array = NDArray[np.float64]

LEVELS: Final = 8
OFFSETS: Final = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0), (2, 2), (2, -2))  # four directions, one and two blocks
NAMES: Final = ("contrast", "correlation", "entropy", "homogeneity")
_FLOOR: Final = 1e-2
_LOWEST, _HIGHEST = -2.0, 2.0  # natural logarithm of a block's mean that the grey levels reach to
_LEAST_VALID: Final = 0.6


def haralick_features(tile: Tile) -> Array:
    """(n_along, n_across, 4 * len(OFFSETS)) float64 of the same windows as `measure_texture`; NaN where too little is valid."""
    block = max(1, round(BLOCK_M / tile.row_spacing_m)), max(1, round(BLOCK_M / tile.column_spacing_m))
    n_along = max(1, -(-(tile.core_stop - tile.core_start) // (CELL_BLOCKS * block[0])))
    n_across = max(1, -(-tile.mask.shape[1] // (CELL_BLOCKS * block[1])))
    usable = (tile.mask & (VALID | SATURATED)) == VALID
    margin = (WINDOW_BLOCKS - CELL_BLOCKS) // 2
    told = np.full((n_along, n_across, len(NAMES) * len(OFFSETS)), np.nan)
    for i in range(n_along):
        for j in range(n_across):
            first_row = tile.core_start + (i * CELL_BLOCKS - margin) * block[0]
            first_column = (j * CELL_BLOCKS - margin) * block[1]
            echo, valid = _window(tile, usable, first_row, first_column, block)
            if valid.mean() >= _LEAST_VALID:
                told[i, j] = _of_window(echo, valid)
    return told


def _window(tile: Tile, usable: NDArray[np.bool_], row: int, column: int, block: tuple[int, int]) -> tuple[Array, NDArray[np.bool_]]:
    shape = WINDOW_BLOCKS * block[0], WINDOW_BLOCKS * block[1]
    echo, valid = np.zeros(shape), np.zeros(shape)
    rows = slice(max(row, 0), min(row + shape[0], usable.shape[0]))
    columns = slice(max(column, 0), min(column + shape[1], usable.shape[1]))
    place = slice(rows.start - row, rows.stop - row), slice(columns.start - column, columns.stop - column)
    if rows.start < rows.stop and columns.start < columns.stop:
        valid[place] = usable[rows, columns]
        echo[place] = tile.intensity[rows, columns] * usable[rows, columns]
    split = WINDOW_BLOCKS, block[0], WINDOW_BLOCKS, block[1]
    count = valid.reshape(split).sum(axis=(1, 3))
    return echo.reshape(split).sum(axis=(1, 3)) / np.maximum(count, 1.0), 2.0 * count >= block[0] * block[1]


def _of_window(echo: Array, valid: NDArray[np.bool_]) -> Array:
    """Contrast, correlation, entropy and homogeneity of the co-occurrence at each offset."""
    level = (np.log(np.maximum(echo, _FLOOR)) - _LOWEST) / (_HIGHEST - _LOWEST) * LEVELS
    grey = np.clip(level, 0, LEVELS - 1).astype(int)
    told = []
    up, down = np.indices((LEVELS, LEVELS))
    for d_row, d_column in OFFSETS:
        here = slice(0, WINDOW_BLOCKS - d_row), slice(max(0, -d_column), WINDOW_BLOCKS - max(0, d_column))
        there = slice(d_row, WINDOW_BLOCKS), slice(max(0, d_column), WINDOW_BLOCKS - max(0, -d_column))
        both = valid[here] & valid[there]
        pairs = np.bincount(grey[here][both] * LEVELS + grey[there][both], minlength=LEVELS * LEVELS).reshape(LEVELS, LEVELS)
        p = (pairs + pairs.T) / max(2.0 * pairs.sum(), 1.0)
        mean = float((up * p).sum())
        variance = float(((up - mean) ** 2 * p).sum())
        covariance = float(((up - mean) * (down - mean) * p).sum())
        entropy = float(-(p[p > 0.0] * np.log(p[p > 0.0])).sum())
        told += [
            float(((up - down) ** 2 * p).sum()),
            covariance / max(variance, 1e-9),
            entropy,
            float((p / (1.0 + (up - down) ** 2)).sum()),
        ]
    return np.array(told)
