"""Measure blocks of pings region by region: cumulants of samples inside short windows of pings.

Texture changes little from one ping to the next at the same range; speckle is drawn anew. So cumulants are measured
inside windows of four pings at one range sample, by unbiased estimators (k-statistics: Kendall and Stuart, The Advanced
Theory of Statistics, vol. 1, ch. 12), and averaged over a region of 16 pings by a fortieth of the trace, in four cells
of range. Windows of neighbouring pings, of every second and of every fourth ping show how far texture and speckle reach
along the track.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.order import quantile
from auv_mcm.kernels.ping_windows import BLOCK_PINGS, STRIDES, cell_edges, ping_windows

N_CELLS: Final = 4  # cells along a region, whose spread shows texture; equal in C
_TRACE_PARTS: Final = 40  # regions along a trace
_MIN_PART_SAMPLES: Final = 16  # samples of a region: four for each cell
# Of range: farther than speckle reaches where a recorder takes up to four samples per resolution cell.
_APART_SAMPLES: Final = (6, 8)
_MAX_SAMPLE: Final = 1e19
_PERCENTILES: Final = (0.01, 0.99)
_SORTED_BYTES: Final = 2  # sample sizes up to which numpy sorts by digits, in less time than it takes quantiles


class RegionTable(NamedTuple):
    """Hold the statistics of n regions.

    mean: (n, n_cells) counts. cumulants: (n_strides, n, n_cells, 2, 2) float64, by stride, region, cell and half of the
    windows: second and third; for strides of 2 and 4 the halves share no ping. covariance: (n, n_cells) of samples 6 to
    8 apart in range, in windows of the largest stride. highest: (n,) counts. at_highest: (n,) share of samples.
    at_zero: (n, n_cells) share of samples. cell_share: (n, n_cells) of a region's samples. place: (n,) side and range,
    increasing.
    """

    mean: NDArray[np.float64]
    cumulants: NDArray[np.float64]
    covariance: NDArray[np.float64]
    highest: NDArray[np.float64]
    at_highest: NDArray[np.float64]
    at_zero: NDArray[np.float64]
    cell_share: NDArray[np.float64]
    place: NDArray[np.int64]


class Regions(NamedTuple):
    """Hold the regions of one block of pings.

    integer: counts are integers. lowest, percentile_1, percentile_99: counts, of the block.
    """

    table: RegionTable
    integer: bool
    lowest: float
    percentile_1: float
    percentile_99: float


def measure_regions(sides: Sequence[NDArray[Any]]) -> Regions:
    """Measure a block of pings: sides of (16, n_samples) samples each, of any real type, near to far.

    Regions with samples that are not finite, or beyond 1e19, are left out.
    """
    parts = [_measure_side(samples, side) for side, samples in enumerate(sides)]
    lows, highs, lowest = [], [], []
    for samples in sides:
        usable = samples[np.isfinite(samples)] if samples.dtype.kind == "f" else samples
        if usable.size:
            low, high = _percentiles(usable)
            lows.append(low)
            highs.append(high)
            lowest.append(float(usable.min()))
    return Regions(
        join_tables(parts),
        integer=all(samples.dtype.kind in "ui" for samples in sides),
        lowest=min(lowest, default=0.0),
        percentile_1=min(lows, default=0.0),
        percentile_99=max(highs, default=0.0),
    )


def join_tables(tables: Sequence[RegionTable]) -> RegionTable:
    """Put the regions of several tables one after the other."""
    return RegionTable(
        np.concatenate([table.mean for table in tables]),
        np.concatenate([table.cumulants for table in tables], axis=1),
        np.concatenate([table.covariance for table in tables]),
        np.concatenate([table.highest for table in tables]),
        np.concatenate([table.at_highest for table in tables]),
        np.concatenate([table.at_zero for table in tables]),
        np.concatenate([table.cell_share for table in tables]),
        np.concatenate([table.place for table in tables]),
    )


def _measure_side(samples: NDArray[Any], side: int) -> RegionTable:
    n_part = max(samples.shape[1] // _TRACE_PARTS, _MIN_PART_SAMPLES)
    # The first part holds the transmitter's ring-down.
    n_parts = max(samples.shape[1] // n_part - 1, 0)
    if n_parts == 0:
        return _EMPTY
    x = samples[:BLOCK_PINGS, n_part : (n_parts + 1) * n_part].astype(np.float64)
    table = ping_windows(x, n_part, N_CELLS, _APART_SAMPLES, _MAX_SAMPLE)
    kept = table.kept
    return RegionTable(
        table.mean[kept],
        table.cumulants[:, kept],
        table.covariance[kept],
        table.highest[kept],
        table.at_highest[kept],
        table.at_zero[kept],
        np.tile(np.diff(cell_edges(n_part, N_CELLS)) / n_part, (int(kept.sum()), 1)),
        side * _TRACE_PARTS * 2 + np.flatnonzero(kept),
    )


def _percentiles(samples: NDArray[Any]) -> tuple[float, float]:
    """Take the 1st and 99th percentile of samples of any shape, one or more, interpolated as numpy.quantile does."""
    if samples.dtype.kind not in "ui" or samples.dtype.itemsize > _SORTED_BYTES:
        low, high = np.quantile(samples, _PERCENTILES)
        return float(low), float(high)
    ordered = np.sort(samples, axis=None, kind="stable")
    low, high = (quantile(ordered, share) for share in _PERCENTILES)
    return low, high


_EMPTY: Final = RegionTable(
    np.zeros((0, N_CELLS)),
    np.zeros((len(STRIDES), 0, N_CELLS, 2, 2)),
    np.zeros((0, N_CELLS)),
    np.zeros(0),
    np.zeros(0),
    np.zeros((0, N_CELLS)),
    np.zeros((0, N_CELLS)),
    np.zeros(0, dtype=np.int64),
)
