"""Compute priors of any sonar image: highlight followed by shadow, highlight in small clusters.

After the potentials of Mignotte, Collet, Perez and Bouthemy (CVIU 76, 1999) and Reed, Petillot and Bell (IEEE JOE 28,
2003), in a form that adds to the cost of single cells and is recomputed from the labels met before, so that inference
stays pairwise.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, Region
from auv_mcm.kernels.pair_costs import Lack, pair_costs

Plane = NDArray[np.float64]
Labels = NDArray[np.uint8]

_HIGHEST_M: Final = 1.2  # m: height of the highest object sought
_REACH_MARGIN_M: Final = 1.0  # m beyond the longest shadow that a highlight may cast: its own extent and the pulse
# a shadow starts no further behind its highlight's near edge: depth of an object and the witness
_ATTACHED_M: Final = 1.5
_WITNESS_M: Final = 0.3  # side of the square of shadow that fully supports a highlight
_UNSUPPORTED: Final = 2.0  # nats; support is not rewarded, or the sea floor in front of every shadow would be highlight
_ORPHAN: Final = 0.5  # nats; weak: ripples and dips cast shadows without highlights
# m²: a highlight or shadow outside of it is no mine's; from the sizes of mines and the pixel
_CLUSTER_AREA_M2: Final = (0.02, 4.0)
_CLUSTER_EXTENT_M: Final = 3.5  # m: longer than the longest mine with its blur along the track


class PairPrior(NamedTuple):
    """Hold how highlights and shadows of a field support each other.

    reach: (n_columns,) int64, columns before each in which highlights support a shadow; attached: columns behind each
    in which shadows support a highlight. slope: rows by which the line of sight moves ahead per column.
    """

    reach: NDArray[np.int64]
    attached: int
    highlight: Lack
    shadow: Lack
    slope: float

    def costs(self, labels: Labels) -> Plane:
        """Weigh each label of each cell, in nats, given where both were, (3, n_rows, n_columns) float64.

        labels: (n_rows, n_columns) uint8. Looks along the line of sight, one row to either side: behind a highlight for
        the near end of a shadow, before a shadow as far as the shadow of the highest object reaches. By degrees, not by
        yes or no: behind any cell there is a dark speck somewhere.
        """
        sheared = _sheared(labels, self.slope)
        cost = pair_costs(sheared, self.reach, self.attached, highlight=self.highlight, shadow=self.shadow)
        if self.slope == 0.0:
            return cost
        return np.array([_unsheared(plane, self.slope, labels.shape[0]) for plane in cost])


def pair_prior(region: Region, factors: tuple[int, int], n_columns: int) -> PairPrior:
    """Set the prior of a field whose cells are `factors` pixels of the region."""
    row_m, column_m = region.row_spacing_m * factors[0], region.column_spacing_m * factors[1]
    range_m = region.first_ground_range_m + (np.arange(n_columns) + 0.5) * column_m
    clearance_m = max(region.altitude_m - _HIGHEST_M, 0.1 * _HIGHEST_M)
    # A region's masked border may lie beyond the track.
    reach = np.clip((_HIGHEST_M * range_m / clearance_m + _REACH_MARGIN_M) / column_m, 0, n_columns).astype(np.int64)
    slope = math.tan(region.squint_rad) * column_m / row_m  # rows per column the line of sight moves ahead
    return PairPrior(
        reach,
        max(1, round(_ATTACHED_M / column_m)),
        Lack(_UNSUPPORTED, row_m * column_m / _WITNESS_M**2),
        Lack(_ORPHAN, row_m * column_m / _CLUSTER_AREA_M2[0]),
        slope,
    )


def without_odd_clusters(labels: Labels, row_m: float, column_m: float) -> Labels:
    """Turn highlights too small, too large or too long for a mine into background.

    Cells are row_m by column_m.
    """
    highlight = (labels == HIGHLIGHT).astype(np.uint8)
    _, cluster, statistics, _ = cv2.connectedComponentsWithStats(highlight, connectivity=8)
    area_m2 = statistics[:, cv2.CC_STAT_AREA] * row_m * column_m
    extent_m = np.hypot(statistics[:, cv2.CC_STAT_HEIGHT] * row_m, statistics[:, cv2.CC_STAT_WIDTH] * column_m)
    odd = (area_m2 < _CLUSTER_AREA_M2[0]) | (area_m2 > _CLUSTER_AREA_M2[1]) | (extent_m > _CLUSTER_EXTENT_M)
    odd[0] = False
    return np.where(odd[cluster], np.uint8(BACKGROUND), labels)


def _shift(n_columns: int, slope: float) -> NDArray[np.intp]:
    shift = np.rint(slope * np.arange(n_columns)).astype(np.intp)
    return np.asarray(shift - shift.min())


def _sheared(labels: Labels, slope: float) -> Labels:
    """Shift rows along the line of sight: column c moved back by slope * c rows, on as many rows as that takes."""
    if slope == 0.0:
        return labels
    shift = _shift(labels.shape[1], slope)
    max_shift = int(shift.max(initial=0))
    sheared = np.full((labels.shape[0] + max_shift, labels.shape[1]), BACKGROUND, dtype=np.uint8)
    row = np.arange(labels.shape[0])[:, None] + (max_shift - shift)
    sheared[row, np.arange(labels.shape[1])] = labels
    return sheared


def _unsheared(plane: Plane, slope: float, n_rows: int) -> Plane:
    shift = _shift(plane.shape[1], slope)
    row = np.arange(n_rows)[:, None] + (int(shift.max(initial=0)) - shift)
    return np.asarray(plane[row, np.arange(plane.shape[1])])
