"""Measure cumulants of samples inside windows of four pings at one range, averaged over parts of a trace.

Windows of neighbouring pings, of every second and of every fourth one lie in a block of 16 pings. Second and third
cumulants are unbiased (k-statistics: Kendall and Stuart, The Advanced Theory of Statistics, vol. 1, ch. 12).

C and numpy agree to the bit.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call

Values = NDArray[np.float64]

BLOCK_PINGS: Final = 16  # four windows of four pings, at strides of 1, 2 or 4 pings
# pings between the members of a window; three of them show how the cumulants grow with time; equal in C
STRIDES: Final = (1, 2, 4)
WINDOW_PINGS: Final = 4  # of a window, from which second and third cumulants are estimated; equal in C


class WindowTable(NamedTuple):
    """Hold the statistics of the n parts of a trace.

    kept: (n,) bool, False for parts with a sample that is not finite or too large; the rest of those parts is
    undefined. mean, at_zero, covariance: (n, n_cells), at_zero as a share. cumulants: (n_strides, n, n_cells, 2, 2) by
    stride, part, cell and half of the windows:
    second and third. highest: (n,), at_highest: (n,) share of samples.
    """

    kept: NDArray[np.bool_]
    mean: Values
    cumulants: Values
    covariance: Values
    highest: Values
    at_highest: Values
    at_zero: Values


@functools.lru_cache(maxsize=8)
def cell_edges(n_part: int, n_cells: int) -> NDArray[np.int64]:
    """Divide a part of n_part samples, at least n_cells, into cells: (n_cells + 1,) first samples, and n_part.

    Read-only.
    """
    edges = np.linspace(0, n_part, n_cells + 1).astype(np.int64)
    edges.flags.writeable = False
    return edges


def ping_windows(samples: Values, n_part: int, n_cells: int, lags: Sequence[int], largest: float) -> WindowTable:
    """Measure a block of pings: samples (16, n_parts * n_part) float64, which is overwritten.

    lags: samples between those whose covariance is measured, in windows of the largest stride. Raises ValueError for
    another shape.
    """
    if samples.ndim != 2 or samples.shape[0] != BLOCK_PINGS or samples.shape[1] % n_part or n_part < n_cells:
        raise ValueError(
            f"samples must be ({BLOCK_PINGS}, n_parts * {n_part}), not {samples.shape}, with at least {n_cells} a part"
        )
    n_parts = samples.shape[1] // n_part
    by_cell = (n_parts, n_cells)
    table = WindowTable(
        kept=np.empty(n_parts, dtype=np.bool_),
        mean=np.empty(by_cell),
        cumulants=np.empty((len(STRIDES), *by_cell, 2, 2)),
        covariance=np.empty(by_cell),
        highest=np.empty(n_parts),
        at_highest=np.empty(n_parts),
        at_zero=np.empty(by_cell),
    )
    x = np.ascontiguousarray(samples, dtype=np.float64)
    settings = [np.array(values, dtype=np.int64) for values in (cell_edges(n_part, n_cells), STRIDES, lags)]
    scratch = np.empty((BLOCK_PINGS + 5, samples.shape[1]))
    numbers, room = (n_parts, n_part, n_cells), (scratch, scratch[BLOCK_PINGS:])
    if not call("ping_windows", *numbers, *settings[:2], len(lags), settings[2], largest, x, *table, *room):
        return ping_windows_numpy(samples, n_part, n_cells, lags, largest)
    return table


def ping_windows_numpy(samples: Values, n_part: int, n_cells: int, lags: Sequence[int], largest: float) -> WindowTable:
    """Do as ping_windows, in numpy alone."""
    x = np.ascontiguousarray(samples, dtype=np.float64)
    n_columns = x.shape[1]
    n_parts = n_columns // n_part
    by_part = x.reshape(BLOCK_PINGS, n_parts, n_part)
    kept = np.asarray((np.abs(by_part) <= largest).all(axis=(0, 2)))
    by_part[:, ~kept] = 0.0
    edges = cell_edges(n_part, n_cells)

    def by_cell(columns: Values) -> Values:
        return _cell_means(columns.reshape(n_parts, n_part), edges)

    cumulants = np.empty((len(STRIDES), n_parts, n_cells, 2, 2))
    deviation = x
    for index, stride in enumerate(STRIDES):
        # Windows of pings i, i + stride, i + 2 stride, i + 3 stride.
        windows = x.reshape(-1, WINDOW_PINGS, stride, n_columns)
        deviation = windows - windows.mean(axis=1, keepdims=True)
        power = deviation * deviation
        second = power.sum(axis=1).reshape(-1, n_columns) / (WINDOW_PINGS - 1)
        power *= deviation
        third = power.sum(axis=1).reshape(-1, n_columns) * (WINDOW_PINGS / ((WINDOW_PINGS - 1) * (WINDOW_PINGS - 2)))
        for half in range(2):
            cumulants[index, :, :, half, 0] = by_cell(second[half::2].mean(axis=0))
            cumulants[index, :, :, half, 1] = by_cell(third[half::2].mean(axis=0))
    deviation = deviation.reshape(BLOCK_PINGS, n_columns)  # in windows of the largest stride, in the order of pings
    covariance = np.zeros(n_columns)
    for lag in lags:
        covariance[:-lag] += (deviation[:, lag:] * deviation[:, :-lag]).sum(axis=0)
    covariance /= (WINDOW_PINGS - 1) * (BLOCK_PINGS // WINDOW_PINGS) * len(lags)
    highest = by_part.max(axis=(0, 2))
    return WindowTable(
        kept,
        by_cell(x.mean(axis=0)),
        cumulants,
        by_cell(covariance),
        highest,
        (by_part == highest[:, None]).mean(axis=(0, 2)),
        by_cell((x == 0.0).mean(axis=0)),
    )


def _cell_means(values: Values, edges: NDArray[np.int64]) -> Values:
    """Average columns (n_parts, n_part) over cells (n_parts, n_cells), one column after the other."""
    lengths = np.diff(edges)
    total = values[:, edges[:-1]].copy()
    for column in range(1, int(lengths.max())):
        longer = lengths > column
        total[:, longer] += values[:, edges[:-1][longer] + column]
    return np.asarray(total / lengths)
