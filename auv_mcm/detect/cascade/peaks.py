"""Select which of the windows that passed a cascade stand for objects: the best ones, each alone within its reach."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

_STRETCH: Final = 4096  # places in a batch: bounds memory of the distances


def spaced_apart(
    rows: NDArray[np.integer],
    columns: NDArray[np.integer],
    scores: NDArray[np.number],
    half_rows: float,
    half_columns: float,
    max_kept: int,
) -> NDArray[np.intp]:
    """Select up to `max_kept` windows of (n,), best first, none within the half extents of a better one.

    Returns their indices. Of equal scores the first is better. A larger maximum never loses a window: it stays, or a
    better one within reach takes its place.
    """
    if not rows.size:
        return np.empty(0, dtype=np.intp)
    row, column = rows - int(rows.min()), columns - int(columns.min())
    down, across = math.floor(half_rows), math.floor(half_columns)
    covered = np.zeros((int(row.max()) + 1, int(column.max()) + 1), dtype=np.bool_)
    order = np.argsort(-scores.astype(np.float64), kind="stable")
    kept: list[int] = []
    # Most windows are near better ones: whole stretches of them are dropped at once.
    for start in range(0, order.size, _STRETCH):
        stretch = order[start : start + _STRETCH]
        for k in stretch[~covered[row[stretch], column[stretch]]].tolist():
            at, along = int(row[k]), int(column[k])
            if covered[at, along]:
                continue
            kept.append(k)
            if len(kept) == max_kept:
                return np.array(kept, dtype=np.intp)
            covered[max(at - down, 0) : at + down + 1, max(along - across, 0) : along + across + 1] = True
    return np.array(kept, dtype=np.intp)
