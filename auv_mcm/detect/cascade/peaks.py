"""Which of the windows that passed a cascade stand for objects: the best ones, each alone within its reach."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def apart(
    rows: NDArray[np.integer],
    columns: NDArray[np.integer],
    scores: NDArray[np.number],
    half_rows: float,
    half_columns: float,
    most: int,
) -> NDArray[np.intp]:
    """Indices of up to `most` windows of (n,), best first, none within the half extents of a better one kept.

    Of equal scores the first is better. More windows never lose one: it stays, or a better one within reach takes its place.
    """
    left = np.argsort(-scores.astype(np.float64), kind="stable")
    kept: list[int] = []
    while left.size and len(kept) < most:
        best = int(left[0])
        kept.append(best)
        left = left[(np.abs(rows[left] - rows[best]) > half_rows) | (np.abs(columns[left] - columns[best]) > half_columns)]
    return np.array(kept, dtype=np.intp)
