"""Normalise the gain of a whole survey: empirical gain normalisation, as mosaics are made for the eye.

The mean echo of every cell of slant range and grazing angle over all pings is the sonar's beam pattern, spreading and
gain together. Divided by it, the same sea floor has the same level near and far, and another sea floor keeps its own,
which the levelling of single tiles takes away.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates  # bench extra

from auv_mcm.records import SIDES, Side, Tile
from auv_mcm.waterfall.grid import LEVEL_COLUMNS

_RANGE_M: Final = 1.0  # of a cell; a beam pattern changes by less than a decibel over it beyond 10 m
_ANGLE_RAD: Final = np.pi / 90.0  # of a cell: 2 degrees, a few hundred samples on a line of 100 m
_N_ANGLES: Final = 47  # cells to 90 degrees, and two more
_FEW: Final = 10.0  # values that the mean over all angles at that range counts as: a single object moves no cell
_MAX_CELLS: Final = 2048  # of range: 2 km


class SurveyGain:
    """Learn the mean level of each cell from tiles with levels as recorded, then take it off the same tiles."""

    def __init__(self) -> None:
        self._sums: dict[Side, NDArray[np.float64]] = {side: np.zeros((2, _MAX_CELLS, _N_ANGLES)) for side in SIDES}
        self._means: dict[Side, NDArray[np.float64]] = {}

    def learn(self, tile: Tile) -> None:
        """Add the core of a tile to the means."""
        if tile.level is None:
            return
        level = tile.level[tile.core_start : tile.core_stop].astype(np.float64)
        known = np.isfinite(level)
        at = [cells[tile.core_start : tile.core_stop][known] for cells in _cells(tile)]
        cell = [np.floor(part).astype(np.intp) for part in at]
        for right, up in ((0, 0), (0, 1), (1, 0), (1, 1)):  # as much into each cell as it has in what is read between
            share = [np.abs(1.0 - step - part + low) for step, part, low in zip((right, up), at, cell, strict=True)]
            weight = share[0] * share[1]
            index = (cell[0] + right) * _N_ANGLES + cell[1] + up
            sums = [np.bincount(index, of, _MAX_CELLS * _N_ANGLES) for of in (weight, weight * np.exp(level[known]))]
            self._sums[tile.side] += np.stack(sums).reshape(2, _MAX_CELLS, _N_ANGLES)
        self._means.clear()

    def applied(self, tile: Tile) -> Tile:
        """Give the tile with its echoes against the survey's mean at their range and angle; 1 is that mean."""
        if tile.level is None:
            return tile
        level = tile.level.astype(np.float64)
        gain = level - map_coordinates(self._mean(tile.side), _cells(tile), order=1, mode="nearest")
        # The level is of every so manieth column.
        n_columns = tile.intensity.shape[1]
        at = (np.arange(n_columns) - LEVEL_COLUMNS // 2) / LEVEL_COLUMNS
        at = np.clip(at, 0.0, level.shape[1] - 1.0)
        left = np.minimum(at.astype(np.intp), max(level.shape[1] - 2, 0))
        share = at - left
        gain = np.where(np.isfinite(gain), gain, 0.0)
        right = np.minimum(left + 1, level.shape[1] - 1)
        factor = np.exp(gain[:, left] * (1.0 - share) + gain[:, right] * share)
        return msgspec.structs.replace(tile, intensity=(tile.intensity * factor).astype(np.float32))

    def _mean(self, side: Side) -> NDArray[np.float64]:
        """Compute ln of the mean of each cell; where little was seen it leans on all angles at that range."""
        if side not in self._means:
            count, total = self._sums[side]
            at_range = total.sum(axis=1) / np.maximum(count.sum(axis=1), 1.0)
            seen = np.flatnonzero(at_range > 0.0)
            everywhere = np.interp(np.arange(_MAX_CELLS), seen, at_range[seen]) if len(seen) else np.ones(_MAX_CELLS)
            mean = (total + _FEW * everywhere[:, np.newaxis]) / (count + _FEW)
            self._means[side] = np.log(mean)
        return self._means[side]


def _cells(tile: Tile) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute the cell of each value of the level, as fractions: range and grazing angle, both (n_rows, n)."""
    assert tile.level is not None
    n_columns = tile.intensity.shape[1]
    some = np.minimum(np.arange(tile.level.shape[1]) * LEVEL_COLUMNS + LEVEL_COLUMNS // 2, n_columns - 1)
    ground_m = (some + 0.5) * tile.column_spacing_m
    height_m = np.maximum(tile.first_return_m, 0.0)[:, np.newaxis]
    ranges = np.hypot(ground_m, height_m) / _RANGE_M
    angles = np.arctan2(height_m, ground_m) / _ANGLE_RAD
    return np.minimum(ranges, _MAX_CELLS - 2.0), angles
