"""Sum a picture over cells of any size, whose edges may lie inside pixels, each pixel by the area in common.

Sums go down the rows first, then along each row of cells. C and numpy agree to the bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call

Plane = NDArray[np.float64]


def cell_sums(values: Plane, valid: NDArray[np.bool_], rows: Plane, columns: Plane) -> Plane:
    """Sum values and valid area over cells, (2, n_rows - 1, n_columns - 1) float64.

    Parameters
    ----------
    values
        (height, width) float64, finite where valid, bool of the same shape, one pixel or more.
    rows, columns
        (n_rows,) and (n_columns,) edges of the cells in pixels, 0 at the outer edge of the first one. A cell is between
        two edges that follow each other; what lies outside the picture is nothing.

    Raises
    ------
    ValueError
        If the shapes differ or the picture is empty.
    """
    if values.shape != valid.shape or not values.size:
        raise ValueError(f"values and valid must have one shape, not empty, not {values.shape} and {valid.shape}")
    (row, row_part), (column, column_part) = _places(rows, values.shape[0]), _places(columns, values.shape[1])
    n_down, n_across = len(row) - 1, len(column) - 1
    cells = np.empty((2, n_down, n_across))
    sums, strip = np.empty((values.shape[0] + 1, values.shape[1])), np.empty(values.shape[1] + 1)
    place = n_down, row, row_part, n_across, column, column_part
    if not call("cell_sums", *values.shape, values, valid, *place, sums, strip, cells):
        return cell_sums_numpy(values, valid, rows, columns)
    return cells


def cell_sums_numpy(values: Plane, valid: NDArray[np.bool_], rows: Plane, columns: Plane) -> Plane:
    """Do as cell_sums, in numpy alone."""
    sums = np.zeros((2, valid.shape[0] + 1, valid.shape[1] + 1))
    np.cumsum(np.where(valid, values, 0.0), axis=0, out=sums[0, 1:, 1:])
    np.cumsum(valid, axis=0, dtype=np.float64, out=sums[1, 1:, 1:])
    strips = np.diff(_between(sums, rows, 1), axis=1)
    np.cumsum(strips, axis=2, out=strips)
    return np.diff(_between(strips, columns, 2), axis=2)


def _between(sums: Plane, edges: Plane, axis: int) -> Plane:
    """Read cumulative sums at fractional places along an axis."""
    whole, part = _places(edges, sums.shape[axis] - 1)
    part = part.reshape([-1 if k == axis else 1 for k in range(sums.ndim)])
    below = sums.take(whole, axis=axis)
    return np.asarray(below + part * (sums.take(whole + 1, axis=axis) - below))


def _places(edges: Plane, n_pixels: int) -> tuple[NDArray[np.int64], Plane]:
    """Split places into the pixel edge before and the share of the next pixel."""
    places = np.clip(edges, 0.0, n_pixels)
    whole = np.minimum(places.astype(np.int64), n_pixels - 1)
    return whole, places - whole
