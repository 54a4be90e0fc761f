"""Find where a record holds only noise, such as in the water column, and measure its speckle there.

Noise has the speckle of the sea floor, as all of it passes the same receiver, but no texture. Such cells lie far below
the middle of the trace, and samples a few range cells apart are independent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.waterfall.regions import Regions, RegionTable
from auv_mcm.waterfall.shape import Shape

_FAR_BELOW_STD: Final = 4.0  # of samples, from the middle of the trace: 23 dB of a single look, 6 dB of 8 looks
_MIN_BLOCKS: Final = 3  # blocks of pings in which a cell is quiet, minimum
_MIN_CELLS: Final = 4  # cells that show quiet water, minimum
# Where the bottom comes nearer, or a fish swims, a block is left out; so is a cell that loses half of its blocks.
_MAX_BLOCK_VARIANCE: Final = 2.0  # of the cell's median; of a single look 3 sigma
_STEADY_SHARE: Final = 0.5
_MAX_COVARIANCE: Final = 0.04  # of the variance; a flat floor of single looks has 0.02, a rippled one of 8 looks over 1
_COVARIANCE_SIGMAS: Final = 2.0
_SPECKLES_PER_CELL: Final = 50.0  # independent ones, of 16 pings by a 160th of the trace
_MAX_GROWTH: Final = 1.12  # of the variance from stride 2 to 4; 1.06 where speckle lasts over two pings
_MAX_VARIANCE: Final = 1.3  # of the median of quiet cells: the edge of the bottom
_MAX_SCATTER: Final = 2.0  # of the third cumulant from block to block, of its median
_MAX_AT_ZERO: Final = 0.05  # share of samples: what is cut off is allowed for, by one level per cell
_N_GROUPS: Final = 4  # of cells by level


def quiet_shapes(
    blocks: Sequence[Regions], joined: RegionTable, cumulants: NDArray[np.float64], min_variance: float, *, is_cut: bool
) -> tuple[Shape, ...]:
    """Measure groups of quiet cells, in the order of their level; none where a record has no such cells.

    Parameters
    ----------
    joined
        The tables of all blocks.
    cumulants
        (n_strides, n, n_cells, 2), those of the table over both halves, less what rounding adds.
    min_variance
        Counts squared, below which a cell shows nothing.
    is_cut
        The recorder stores nothing below zero.
    """
    places, n_blocks = np.unique(joined.place, return_counts=True)
    rows = np.isin(joined.place, places[n_blocks == len(blocks)])
    if not rows.any():
        return ()

    def by_block(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return values[rows].reshape(len(blocks), -1)

    mean = by_block(joined.mean)
    level = np.median(mean, axis=0)
    usual = np.median(by_block(cumulants[-1, ..., 0]), axis=0)
    is_low = level < np.median(level) - _FAR_BELOW_STD * np.sqrt(np.maximum(usual, 0.0))
    low = np.flatnonzero(is_low & (usual > min_variance))
    if len(low) == 0:
        return ()
    level, usual = level[low], usual[low]
    second, third = by_block(cumulants[-1, ..., 0])[:, low], by_block(cumulants[-1, ..., 1])[:, low]
    steady = (second < _MAX_BLOCK_VARIANCE * usual) & (np.abs(mean[:, low] - level) < np.sqrt(usual))
    n_steady = np.maximum(steady.sum(axis=0), 1)

    def averaged(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.where(steady, values, 0.0).sum(axis=0) / n_steady)

    variance = averaged(second)
    max_covariance = _MAX_COVARIANCE + _COVARIANCE_SIGMAS / np.sqrt(n_steady * _SPECKLES_PER_CELL)
    quiet = n_steady >= max(_STEADY_SHARE * len(blocks), _MIN_BLOCKS)
    quiet &= averaged(by_block(joined.covariance)[:, low]) < max_covariance * variance
    quiet &= variance < _MAX_GROWTH * averaged(by_block(cumulants[-2, ..., 0])[:, low])
    if is_cut:
        quiet &= averaged(by_block(joined.at_zero)[:, low]) <= _MAX_AT_ZERO
    if not quiet.any():
        return ()
    scatter = np.sqrt(averaged((third - averaged(third)) ** 2))
    is_even = variance < _MAX_VARIANCE * np.median(variance[quiet])
    quiet &= is_even & (scatter < _MAX_SCATTER * np.median(scatter[quiet]))
    cells = np.flatnonzero(quiet)
    if len(cells) < _MIN_CELLS:
        return ()
    groups = np.array_split(cells[np.argsort(level[cells], kind="stable")], _N_GROUPS)
    shapes = []
    for group in groups:
        kept = steady[:, group]
        mean_here = float(level[group].mean()) if is_cut else np.inf
        shapes.append(_shape(second[:, group][kept], third[:, group][kept], mean_here))
    return tuple(shapes)


def _shape(second: NDArray[np.float64], third: NDArray[np.float64], mean: float) -> Shape:
    """Join second and third cumulants (n,) of cells and blocks alike."""
    variance = float(second.mean())
    skewness = float(third.mean()) / variance**1.5
    # What each of them adds to the skewness, to first order.
    influence = third / variance**1.5 - 1.5 * skewness * second / variance
    root_n = math.sqrt(len(second))
    log_std_sigma = 0.5 * float(np.std(second)) / variance / root_n
    return Shape(math.sqrt(variance), skewness, log_std_sigma, float(np.std(influence)) / root_n, mean)
