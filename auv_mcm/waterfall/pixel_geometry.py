"""Lay out the pixels of a block of pings: slant ranges and grazing angles, computed once per height of the sonar.

The first return is tracked in bins of 5 cm and smoothed by medians, so that pings in a row mostly share it to the bit;
what follows from it alone is the same for them and for both sides.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import LOW_RESOLUTION
from auv_mcm.settings.config import WaterfallConfig
from auv_mcm.waterfall.bottom import BottomTrack
from auv_mcm.waterfall.floor_watch import NEAR_M, REACH_M, REACH_SHARE
from auv_mcm.waterfall.ground import ground_edges_m

LEVEL_BIN_M: Final = 0.05
"""Slant range, m, over which echoes are averaged for levels of water and floor."""
_N_NEAR_BINS: Final = 40  # of that size, spread over the first metres of sea floor
_MIN_RETURN_M = 0.05  # m: keeps divisions finite where no bottom was found


class RepeatedValues(NamedTuple):
    """Hold values of pings without repetitions.

    values: (n,), without those that repeat the ping before; row: (n_pings,) int64, the value of each ping.
    """

    values: NDArray[Any]
    row: NDArray[np.int64]


class PixelGeometry(NamedTuple):
    """Hold the geometry of n_columns pixels across the track.

    return_m: first returns; edges_m: (n returns, n_columns + 1) float64, slant range of the pixels' edges; near_m: (n
    returns, n) float64, slant range at which bins of the first metres of sea floor begin and end, in turn.
    level_m: first returns without what rises from the bottom, which the angle response must not follow; tangent: (n
    levels, n_columns) float64, of the grazing angle; coarse: the same shape, uint8, LOW_RESOLUTION where the angle is
    too steep or too shallow, else 0.
    """

    ground_m: NDArray[np.float64]
    return_m: RepeatedValues
    edges_m: NDArray[np.float64]
    near_m: NDArray[np.float64]
    level_m: RepeatedValues
    tangent: NDArray[np.float64]
    coarse: NDArray[np.uint8]


def pixel_geometry(track: BottomTrack, n_columns: int, waterfall: WaterfallConfig) -> PixelGeometry:
    """Lay out the pixels of a block's pings over a flat bottom."""
    return_m = runs(np.maximum(track.first_return_m, _MIN_RETURN_M))
    level_m = runs(np.maximum(track.level_return_m, _MIN_RETURN_M))
    ground_m = (np.arange(n_columns, dtype=np.float64) + 0.5) * waterfall.column_spacing_m
    tangent = level_m.values[:, np.newaxis] / ground_m
    flattest, steepest = (
        math.tan(math.radians(waterfall.min_grazing_deg)),
        math.tan(math.radians(waterfall.max_grazing_deg)),
    )
    coarse = ((tangent > steepest) | (tangent < flattest)) * np.uint8(LOW_RESOLUTION)
    edges_m = ground_edges_m(return_m.values, n_columns, waterfall.column_spacing_m)
    return PixelGeometry(ground_m, return_m, edges_m, _near_m(return_m.values), level_m, tangent, coarse)


def _near_m(return_m: NDArray[np.float64]) -> NDArray[np.float64]:
    reach_m = np.maximum(REACH_M, REACH_SHARE * return_m)
    starts_m = (return_m + NEAR_M)[:, np.newaxis] + reach_m[:, np.newaxis] * np.linspace(0.0, 1.0, _N_NEAR_BINS)
    return np.stack([starts_m, starts_m + LEVEL_BIN_M], axis=-1).reshape(len(starts_m), -1)


def runs(values: NDArray[Any]) -> RepeatedValues:
    """Drop values (n_pings,) that equal the one before."""
    starts = np.concatenate([[True], values[1:] != values[:-1]])
    return RepeatedValues(values[starts], np.cumsum(starts) - 1)
