"""Match shadow contours, for comparison with the likelihood: the distance of an extracted shadow from a simulated one.

After S. Reed, Y. Petillot, J. Bell, IEE Proc. Radar Sonar Navig. 151, 2004. Their Hausdorff distance is the largest gap
between the two contours, which one grain of speckle decides; it does not decide a quantile of the gaps (D. Huttenlocher
et al., IEEE PAMI 15, 1993).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.shape import Array, ImageRowSums, Solid, intervals

Mask = NDArray[np.bool_]


def contour_distance_m(
    observed: Mask, simulated: Mask, row_spacing_m: float, column_spacing_m: float, *, quantile: float
) -> float:
    """Return the distance between the contours of two shadows on one grid, (n_rows, n_columns) bool; infinite if only
    one exists.

    quantile: of the gaps, the larger of both ways, from 0 to 1; 1 is the Hausdorff distance itself. Raises ValueError
    for masks of different shapes, spacings that are not positive, or another quantile.
    """
    if observed.ndim != 2 or observed.shape != simulated.shape:
        raise ValueError(f"masks must be planes of one shape, not {observed.shape} and {simulated.shape}")
    if not (row_spacing_m > 0.0 and column_spacing_m > 0.0 and 0.0 <= quantile <= 1.0):
        raise ValueError(
            f"spacings must be positive and quantile from 0 to 1, not {row_spacing_m}, {column_spacing_m} and "
            f"{quantile}"
        )
    if not observed.any() and not simulated.any():
        return 0.0
    if not (observed.any() and simulated.any()):
        return math.inf
    from scipy.ndimage import distance_transform_edt

    contours = [_contour(mask) for mask in (observed, simulated)]
    away = [distance_transform_edt(~contour, sampling=(row_spacing_m, column_spacing_m)) for contour in contours]
    gaps = away[1][contours[0]], away[0][contours[1]]
    return max(float(np.quantile(gap, quantile)) for gap in gaps)


def shadow_mask(solid: Solid, hypothesis: Array, image: ImageRowSums) -> Mask:
    """Return pixels (n_rows, n_columns) whose middle lies in the shadow of a solid; hypothesis: (8,) as for
    shape_costs.
    """
    ends = intervals(solid, hypothesis[np.newaxis], image)[0, :, 0]
    middle = np.arange(image.echoes.shape[1] - 1) + 0.5
    return np.asarray((middle >= ends[:, 1:2]) & (middle < ends[:, 2:3]), dtype=np.bool_)


def _contour(mask: Mask) -> Mask:
    """Return pixels of the mask with a neighbour, of four, outside it."""
    framed = np.pad(mask, 1)
    inside = framed[:-2, 1:-1] & framed[2:, 1:-1] & framed[1:-1, :-2] & framed[1:-1, 2:]
    return np.asarray(mask & ~inside, dtype=np.bool_)
