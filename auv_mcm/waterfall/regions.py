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

BLOCK_PINGS: Final = 16  # four windows of four pings, at strides of 1, 2 or 4 pings
STRIDES: Final = (1, 2, 4)
N_CELLS: Final = 4
WINDOW_PINGS: Final = 4
_TRACE_PARTS: Final = 40
_MIN_PART_SAMPLES: Final = 16
# Of range: farther than speckle reaches where a recorder takes up to four samples per resolution cell.
_APART_SAMPLES: Final = (6, 8)
_MAX_SAMPLE: Final = 1e19


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
            low, high = np.quantile(usable, (0.01, 0.99))
            lows.append(float(low))
            highs.append(float(high))
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
    by_part = x.reshape(BLOCK_PINGS, n_parts, n_part)
    kept = (np.abs(by_part) <= _MAX_SAMPLE).all(axis=(0, 2))
    by_part[:, ~kept] = 0.0

    edges = np.linspace(0, n_part, N_CELLS + 1).astype(np.int64)

    def by_cell(columns: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.add.reduceat(columns.reshape(n_parts, n_part)[kept], edges[:-1], axis=1) / np.diff(edges))

    cumulants = np.empty((len(STRIDES), int(kept.sum()), N_CELLS, 2, 2))
    for index, stride in enumerate(STRIDES):
        # Windows of pings i, i + stride, i + 2 stride, i + 3 stride.
        windows = x.reshape(-1, WINDOW_PINGS, stride, x.shape[1])
        deviation = windows - windows.mean(axis=1, keepdims=True)
        power = deviation * deviation
        second = power.sum(axis=1).reshape(-1, x.shape[1]) / (WINDOW_PINGS - 1)
        power *= deviation
        third = power.sum(axis=1).reshape(-1, x.shape[1]) * (WINDOW_PINGS / ((WINDOW_PINGS - 1) * (WINDOW_PINGS - 2)))
        for half in range(2):
            cumulants[index, :, :, half, 0] = by_cell(second[half::2].mean(axis=0))
            cumulants[index, :, :, half, 1] = by_cell(third[half::2].mean(axis=0))
    # `deviation` is that of the largest stride here.
    apart = np.zeros(x.shape[1])
    for lag in _APART_SAMPLES:
        apart[:-lag] += (deviation[..., lag:] * deviation[..., :-lag]).sum(axis=(0, 1, 2))
    apart /= (WINDOW_PINGS - 1) * len(second) * len(_APART_SAMPLES)
    highest = by_part.max(axis=(0, 2))
    return RegionTable(
        by_cell(x.mean(axis=0)),
        cumulants,
        by_cell(apart),
        highest[kept],
        (by_part == highest[:, None]).mean(axis=(0, 2))[kept],
        by_cell((x == 0.0).mean(axis=0)),
        np.tile(np.diff(edges) / n_part, (int(kept.sum()), 1)),
        side * _TRACE_PARTS * 2 + np.flatnonzero(kept),
    )


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
