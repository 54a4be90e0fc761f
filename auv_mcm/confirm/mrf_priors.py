"""What a sonar image must look like whatever its speckle: highlight followed by shadow, highlight in small clusters.

After the potentials of Mignotte, Collet, Perez and Bouthemy (CVIU 76, 1999) and Reed, Petillot and Bell (IEEE JOE 28, 2003), in a form that
adds to the cost of single cells and is recomputed from the labels met before, so that inference stays pairwise.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region

Plane = NDArray[np.float64]
Labels = NDArray[np.uint8]

_HIGHEST_M: Final = 1.2  # objects sought
_REACH_MARGIN_M: Final = 1.0
_ATTACHED_M: Final = 1.5  # a shadow starts no further behind its highlight's near edge: depth of an object and the witness
_WITNESS_M: Final = 0.3  # side of the square of shadow that fully supports a highlight
_UNSUPPORTED: Final = 2.0  # nats; support earns no reward, or the sea floor in front of every shadow would be highlight
_ORPHAN: Final = 0.5  # weak: ripples and dips cast shadows without highlights
_CLUSTER_AREA_M2: Final = (0.02, 4.0)
_CLUSTER_EXTENT_M: Final = 3.5


def pair_costs(labels: Labels, region: Region, factors: tuple[int, int]) -> Plane:
    """Cost, nats, of each label of each cell given where highlights and shadows were: (3, n_rows, n_columns) float64.

    labels: (n_rows, n_columns) uint8 of cells of `factors` pixels of the region. Looks along the line of sight, one row to either
    side: behind a highlight for the near end of a shadow, before a shadow as far as the shadow of the highest object reaches.
    """
    n_rows, n_columns = labels.shape
    row_m, column_m = region.row_spacing_m * factors[0], region.column_spacing_m * factors[1]
    range_m = region.first_ground_range_m + (np.arange(n_columns) + 0.5) * column_m
    clearance_m = max(region.altitude_m - _HIGHEST_M, 0.1 * _HIGHEST_M)
    # A region's masked border may lie beyond the track.
    reach = np.clip((_HIGHEST_M * range_m / clearance_m + _REACH_MARGIN_M) / column_m, 0, n_columns).astype(np.intp)
    columns = np.arange(n_columns)
    slope = math.tan(region.squint_rad) * column_m / row_m  # rows per column the line of sight moves ahead

    shadow = _row_sums(_sheared(labels == SHADOW, slope))
    attached = max(1, round(_ATTACHED_M / column_m))
    behind = shadow[:, np.minimum(columns + 1 + attached, n_columns)] - shadow[:, columns + 1]
    highlight = _row_sums(_sheared(labels == HIGHLIGHT, slope))
    before = highlight[:, columns] - highlight[:, np.maximum(columns - reach, 0)]
    n_shadow, n_highlight = (_unsheared(_three_rows(plane), slope, n_rows) for plane in (behind, before))

    cost = np.zeros((3, n_rows, n_columns))
    # By degrees, not by yes or no: behind any cell there is a dark speck somewhere.
    support = np.minimum(1.0, n_shadow * (row_m * column_m / _WITNESS_M**2))
    cost[HIGHLIGHT] = _UNSUPPORTED * (1.0 - support)
    cost[SHADOW] = _ORPHAN * (1.0 - np.minimum(1.0, n_highlight * (row_m * column_m / _CLUSTER_AREA_M2[0])))
    return cost


def without_odd_clusters(labels: Labels, row_m: float, column_m: float) -> Labels:
    """Labels with highlights too small, too large or too long for a mine made background. Cells are row_m by column_m."""
    from scipy import ndimage  # late: the payload's main process must start fast

    cluster, n_clusters = ndimage.label(labels == HIGHLIGHT, structure=np.ones((3, 3)))
    if n_clusters == 0:
        return labels
    area_m2 = np.bincount(cluster.ravel(), minlength=n_clusters + 1) * row_m * column_m
    odd = (area_m2 < _CLUSTER_AREA_M2[0]) | (area_m2 > _CLUSTER_AREA_M2[1])
    for number, (rows, columns) in enumerate(ndimage.find_objects(cluster), start=1):
        odd[number] |= math.hypot((rows.stop - rows.start) * row_m, (columns.stop - columns.start) * column_m) > _CLUSTER_EXTENT_M
    odd[0] = False
    return np.where(odd[cluster], np.uint8(BACKGROUND), labels)


def _row_sums(mask: NDArray[np.bool_]) -> Plane:
    """Sums of the first 0, 1, ... n_columns of each row."""
    sums = np.zeros((mask.shape[0], mask.shape[1] + 1))
    np.cumsum(mask, axis=1, out=sums[:, 1:])
    return sums


def _three_rows(plane: Plane) -> Plane:
    total = plane.copy()
    total[1:] += plane[:-1]
    total[:-1] += plane[1:]
    return total


def _shift(n_columns: int, slope: float) -> NDArray[np.intp]:
    shift = np.rint(slope * np.arange(n_columns)).astype(np.intp)
    return np.asarray(shift - shift.min())


def _sheared(mask: NDArray[np.bool_], slope: float) -> NDArray[np.bool_]:
    """Rows along the line of sight: column c moved back by slope * c rows, on as many rows as that takes."""
    if slope == 0.0:
        return mask
    shift = _shift(mask.shape[1], slope)
    most = int(shift.max(initial=0))
    sheared = np.zeros((mask.shape[0] + most, mask.shape[1]), dtype=np.bool_)
    row = np.arange(mask.shape[0])[:, None] + (most - shift)
    sheared[row, np.arange(mask.shape[1])] = mask
    return sheared


def _unsheared(plane: Plane, slope: float, n_rows: int) -> Plane:
    if slope == 0.0:
        return plane
    shift = _shift(plane.shape[1], slope)
    row = np.arange(n_rows)[:, None] + (int(shift.max(initial=0)) - shift)
    return np.asarray(plane[row, np.arange(plane.shape[1])])
