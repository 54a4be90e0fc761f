"""Weigh co-occurrences of grey levels into kinds of sea floor, as a user of scikit-image would.

Statistics of matrices of co-occurrence (R. M. Haralick, K. Shanmugam and I. Dinstein, IEEE Trans. SMC 3, 1973) of the
pixels around a cell and, coarser and wider, of blocks, go through a network of the size of the payload's own. What
fitted it is in the sources at the tag benches-1: `python -m sim_replay.benches.every_stage.fit_grey_levels FILE`.
"""

from __future__ import annotations

import math
from importlib import import_module
from importlib.resources import files
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import Tile
from auv_mcm.seabed.seabed_model import bounded
from auv_mcm.seabed.texture import BLOCK_M, CELL_BLOCKS

Array = NDArray[np.float64]

_N_LEVELS: Final = 16  # chosen: 1.4 dB each
_RANGE_DB: Final = (-13.0, 10.0)  # of levels, dB over the floor's mean
_STEPS: Final = (1, 2, 4)  # pixels from one to the other
_ANGLES_RAD: Final = (0.0, 0.25 * math.pi, 0.5 * math.pi, 0.75 * math.pi)
_STATISTICS: Final = ("contrast", "dissimilarity", "homogeneity", "energy", "correlation")
_STEEPEST: Final = 0.2  # cotangent of the grazing angle; logarithms start here


class _Window(NamedTuple):
    n_cells: int  # along each side
    n_pixels: int  # along a block's side


_WINDOWS: Final = (_Window(3, 2), _Window(7, 1))
"""Pixels around a cell, and blocks farther around: the payload's textures have the same windows."""
_REACH_CELLS: Final = 3  # of the largest window beyond its cell


class GreyLevelModel(msgspec.Struct, frozen=True, kw_only=True):
    """Hold a network of grey levels. layers: weights (n_inputs, n_units) and constants, from inputs to kinds."""

    fitted_on: str
    centre: list[float]
    scale: list[float]
    layers: list[tuple[list[list[float]], list[float]]]


def shipped_grey_levels() -> GreyLevelModel:
    """Read the model that ships."""
    path = files("sim_replay.benches").joinpath("models", "grey_levels.json")
    return msgspec.json.decode(path.read_bytes(), type=GreyLevelModel)


def grey_level_odds(inputs: Array, model: GreyLevelModel) -> Array:
    """Weigh inputs (n, n_inputs) up to what is the same for all kinds, (n, n_kinds)."""
    units = bounded((inputs - model.centre) / model.scale)
    for number, (weights, constants) in enumerate(model.layers):
        units = units @ np.array(weights) + constants
        units = np.tanh(units) if number + 1 < len(model.layers) else units
    return np.asarray(units)


def grey_level_inputs(tile: Tile, cells: NDArray[np.intp], cot_grazing: Array) -> Array:
    """Measure cells of a tile, (n, n_inputs).

    Parameters
    ----------
    cells
        (n, 2), places of the cells along and across.
    cot_grazing
        (n_across,), cotangent of the grazing angle of cells in this place.
    """
    feature = import_module("skimage.feature")
    measured = []
    for window in _WINDOWS:
        levels, side = _levels(tile, window.n_pixels)
        around = window.n_cells // 2
        for along, across in cells + _REACH_CELLS:
            part = levels[
                (along - around) * side : (along + around + 1) * side,
                (across - around) * side : (across + around + 1) * side,
            ]
            counts = feature.graycomatrix(part, _STEPS, _ANGLES_RAD, _N_LEVELS + 1, symmetric=True)
            kept = counts[1:, 1:].astype(np.float64)  # the first level stands for what was not seen
            measured.append(np.concatenate([feature.graycoprops(kept, name).ravel() for name in _STATISTICS]))
    of_window = np.array(measured).reshape(len(_WINDOWS), len(cells), -1)
    grazing = np.log(np.maximum(cot_grazing, _STEEPEST))[cells[:, 1]]
    return np.asarray(np.nan_to_num(np.column_stack([*of_window, grazing])))


def _levels(tile: Tile, n_pixels: int) -> tuple[NDArray[np.uint8], int]:
    """Average a tile's core and what lies around, quantised; 0 where less than half was seen. And a cell's side."""
    size = [max(1, round(BLOCK_M / spacing / n_pixels)) for spacing in (tile.row_spacing_m, tile.column_spacing_m)]
    side = CELL_BLOCKS * n_pixels
    cell = np.array(size) * side
    margin = _REACH_CELLS * cell
    n = -(-np.array([tile.core_stop - tile.core_start, tile.mask.shape[1]]) // cell) * cell + 2 * margin
    around = ((margin[0], n[0]), (margin[1], n[1]))
    seen = np.pad(tile.mask.astype(np.float64), around)[tile.core_start :][: n[0], : n[1]]
    echo = np.pad(np.where(tile.mask, tile.intensity, 0.0), around)[tile.core_start :][: n[0], : n[1]]
    count, total = (
        plane.reshape(n[0] // size[0], size[0], n[1] // size[1], size[1]).sum(axis=(1, 3)) for plane in (seen, echo)
    )
    level_db = 10.0 * np.log10(np.maximum(total / np.maximum(count, 1.0), 1e-6))
    low_db, high_db = _RANGE_DB
    level = np.clip((level_db - low_db) / (high_db - low_db) * _N_LEVELS, 0, _N_LEVELS - 1).astype(np.uint8) + 1
    return np.where(count >= 0.5 * size[0] * size[1], level, 0).astype(np.uint8), side
