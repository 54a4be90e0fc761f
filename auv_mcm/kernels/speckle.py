"""Measure how pixels differ from others some lags away: half the mean squared difference, the variogram.

Pairs with a pixel that is not usable are left out. C and numpy agree to 1e-12, relative: they add up in different
orders.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call

Plane = NDArray[np.float64]


def half_differences(plane: Plane, usable: NDArray[np.bool_], lags: Sequence[int], min_pairs: int) -> Plane:
    """Average along rows and along columns, (2, n_lags) float64; NaN where there are fewer than min_pairs pairs (>= 1).

    Parameters
    ----------
    plane
        (n_rows, n_columns) float64, finite where usable, bool of the same shape.
    lags
        Pixels, 1 or more; the first of the two is from one row to those after it.

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    return np.asarray(half_differences_in(plane, usable, [(0, 0, *plane.shape)], lags, min_pairs)[0], dtype=np.float64)


def half_differences_in(
    plane: Plane, usable: NDArray[np.bool_], boxes: Sequence[tuple[int, ...]], lags: Sequence[int], min_pairs: int
) -> Plane:
    """Average in each of several parts of a plane, (n_boxes, 2, n_lags) float64; see half_differences.

    boxes: first row, first column, and one past the last of each. Raises ValueError if the shapes differ or a box
    leaves the plane.
    """
    if plane.ndim != 2 or plane.shape != usable.shape:
        raise ValueError(f"plane and usable must have one 2-d shape, not {plane.shape} and {usable.shape}")
    n_rows, n_columns = plane.shape
    if not all(0 <= top <= bottom <= n_rows and 0 <= near <= far <= n_columns for top, near, bottom, far in boxes):
        raise ValueError(f"boxes must lie in a plane of {n_rows} rows and {n_columns} columns, not {boxes}")
    wanted, places = np.array(lags, dtype=np.int64), np.array(boxes, dtype=np.int64)
    shape = len(boxes), 2, len(lags)
    squares, numbers = np.zeros(shape), np.zeros(shape, dtype=np.int64)
    if not call("speckle_lags", n_columns, plane, usable, len(boxes), places, len(lags), wanted, squares, numbers):
        parts = [(slice(top, bottom), slice(near, far)) for top, near, bottom, far in boxes]
        return np.array([half_differences_numpy(plane[part], usable[part], lags, min_pairs) for part in parts])
    return np.where(numbers >= min_pairs, 0.5 * squares / np.maximum(numbers, 1), np.nan)


def half_differences_numpy(plane: Plane, usable: NDArray[np.bool_], lags: Sequence[int], min_pairs: int) -> Plane:
    """Do as half_differences, in numpy alone."""
    halves = np.full((2, len(lags)), np.nan)
    for axis, (values, counted) in enumerate(((plane.T, usable.T), (plane, usable))):
        for k, lag in enumerate(lags):
            both = counted[:, lag:] & counted[:, :-lag]
            number = int(both.sum())
            if number >= min_pairs:
                difference = np.where(both, values[:, lag:] - values[:, :-lag], 0.0)
                halves[axis, k] = 0.5 * float((difference**2).sum()) / number
    return halves
