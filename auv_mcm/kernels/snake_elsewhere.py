"""Search a window for a repetition of a pair of contours: the evidence of the same polygons, shifted.

Evidence of a polygon of N pixels with mean m over the window's is that of speckle for a highlight or a shadow, N (m - 1
- ln m), and none on the wrong side of 1. Ripples and grass hold dark patches behind bright ones, but they repeat a
little farther on.

C and numpy agree to the last bit where numpy takes logarithms from the C library, and to 1e-12 otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels import snake
from auv_mcm.kernels.signatures import call
from auv_mcm.kernels.snake_criterion import HIGHLIGHT

Nodes = NDArray[np.float64]
Polygons = Sequence[tuple[int, Nodes]]

_ROW_STEP, _COLUMN_STEP = 2, 4  # pixels between the places where contours are tried again
_COMMON: Final = 0.95  # equal in C
_FAINTEST: Final = 1e-6  # times the region's mean: keeps the logarithm of an empty shadow's mean finite


def elsewhere(table: NDArray[np.float64], polygons: Polygons) -> tuple[float, float]:
    """Compare evidence of polygons shifted clear of themselves with that in place.

    The best, and what one shift in twenty exceeds.

    Both over the evidence in place: 0 where there is no room to shift, infinite where there is no evidence in place.

    Parameters
    ----------
    table
        Of `snake.window_row_sums`.
    polygons
        HIGHLIGHT or SHADOW with (n, 2) nodes in the window, (0, 2) for none; at least one must have some.

    Raises
    ------
    ValueError
        For nodes outside the window.
    """
    n_rows, n_columns = table.shape[0], table.shape[1] - 1
    nodes = np.concatenate([np.asarray(each, dtype=np.float64) for _, each in polygons])
    if not ((nodes >= 0.0) & (nodes <= (n_rows, n_columns))).all():
        raise ValueError(f"a polygon has nodes outside the window of {n_rows} rows and {n_columns} columns")
    n_room = (n_rows // _ROW_STEP + 1) * (n_columns // _COLUMN_STEP + 1)
    numbers = np.array([[which for which, _ in polygons], [len(each) for _, each in polygons]], dtype=np.int64)
    steps = np.array([_ROW_STEP, _COLUMN_STEP], dtype=np.int64)
    sides, offset, room = np.empty(2 * n_rows, dtype=np.int64), np.empty(n_room, dtype=np.int64), np.empty(3 * n_room)
    found = np.empty(2)
    given = table, len(polygons), *numbers, nodes, steps
    if not call("snake_elsewhere", n_rows, n_columns, *given, sides, offset, room, room[2 * n_room :], found):
        return elsewhere_numpy(table, polygons)
    best, common = found.tolist()
    return best, common


def elsewhere_numpy(table: NDArray[np.float64], polygons: Polygons) -> tuple[float, float]:
    """Do as elsewhere, in numpy alone."""
    n_rows, n_columns = table.shape[0], table.shape[1] - 1
    here = 0.0
    shifts = _shifts(np.concatenate([nodes for _, nodes in polygons]), n_rows, n_columns)
    there = np.zeros(len(shifts))
    for which, nodes in polygons:
        if len(nodes) == 0:
            continue
        near, far = snake.sides_numpy(nodes, n_rows, n_columns)
        rows = np.flatnonzero((near >= 0) & (far > near))
        near, far = near[rows], far[rows]
        here += evidence(which, *(table[rows, far] - table[rows, near]).sum(axis=0).tolist())
        at = rows[:, None] + shifts[:, 0]
        inside = table[at, far[:, None] + shifts[:, 1]] - table[at, near[:, None] + shifts[:, 1]]
        there += evidences(which, *inside.sum(axis=0).T)
    if here <= 0.0:
        return math.inf, math.inf
    if len(there) == 0:
        return 0.0, 0.0
    return float(there.max()) / here, float(np.quantile(there, _COMMON)) / here


def _shifts(nodes: Nodes, n_rows: int, n_columns: int) -> NDArray[np.int64]:
    """Give shifts (row, column) that keep all nodes in the window and clear of where they are, (n, 2) int64."""
    (top, near), (bottom, far) = np.floor(nodes.min(axis=0)), np.ceil(nodes.max(axis=0))
    rows = np.arange(-int(top), n_rows - int(bottom) + 1, _ROW_STEP)
    columns = np.arange(-int(near), n_columns - int(far) + 1, _COLUMN_STEP)
    row, column = (grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij"))
    clear = (np.abs(row) >= bottom - top) | (np.abs(column) >= far - near)
    return np.stack([row[clear], column[clear]], axis=1)


def evidence(which: int, total: float, count: float) -> float:
    """Weigh `count` pixels of mean m over the window's: N (m - 1 - ln m), 0 on the wrong side of 1."""
    if count < 1.0:
        return 0.0
    mean = max(total / count, _FAINTEST)
    right = mean > 1.0 if which == HIGHLIGHT else mean < 1.0
    return count * (mean - 1.0 - math.log(mean)) if right else 0.0


def evidences(which: int, total: NDArray[np.float64], count: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weigh many regions at once as `evidence` does; arrays of one shape."""
    mean = np.maximum(total / np.maximum(count, 1.0), _FAINTEST)
    right = (mean > 1.0) if which == HIGHLIGHT else (mean < 1.0)
    return np.where(right, count * (mean - 1.0 - np.log(mean)), 0.0)
