"""Size boxes by the shadow that an object casts: from metres to whole pixels, in bands of equal shadow.

An object of height h seen at ground range y from altitude H throws a shadow of h y / (H - h). Across-track edges of
boxes are a part in metres, which scales with the object, and a part in shadows, which scales with the shadow of a
reference height. Shadow lengths fall into 24 bands of equal ratio and every band has boxes of its own, so that a window
costs the same wherever it stands. The band of a pixel depends on y / (H - h) alone, not on where its tile was cut.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

N_BANDS: Final = 24  # of shadow length: one is 12 % longer than the one before
# m: of the shortest shadow with enough pixels, and of the longest that a window holds
SHADOW_LIMITS_M: Final = (0.4, 6.0)
REFERENCE_HEIGHT_M: Final = 0.35
"""Of the object whose shadow is the unit of boxes, unless a model says otherwise."""

WINDOW_ROWS_M: Final = 1.0  # m along the track on either side of the middle: a mine and the sea floor beside it
WINDOW_NEAR_M: Final = 1.0  # m in front of the object
WINDOW_FAR_M: Final = 1.0  # m behind the end of the shadow
WINDOW_SHADOWS: Final = 1.2
"""What a box may reach: so far along the track either way, towards the sonar, and away from it plus so many shadows."""

_MIN_CLEARANCE_M: Final = 0.3  # of the sonar above the reference height
_SNAP_PX: Final = 1e-6  # what rounding of metres to binary may take from a half


class FeatureBox(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Hold a box around a pixel's centre, the middle of the highlight looked for.

    Along track from top_m to bottom_m. Across track, away from the sonar positive, from near_m + near_shadow * shadow
    to far_m + far_shadow * shadow, where shadow is the band's shadow length in metres.
    """

    top_m: float
    bottom_m: float
    near_m: float
    near_shadow: float
    far_m: float
    far_shadow: float


WINDOW: Final = FeatureBox(-WINDOW_ROWS_M, WINDOW_ROWS_M, -WINDOW_NEAR_M, 0.0, WINDOW_FAR_M, 1.0)
"""Surroundings of an object and its shadow."""


@functools.cache
def shadow_edges_m() -> NDArray[np.float64]:
    """Compute the shadow lengths between the bands, m, (N_BANDS + 1,) float64, read-only."""
    edges_m = np.geomspace(*SHADOW_LIMITS_M, N_BANDS + 1)
    edges_m.flags.writeable = False
    return edges_m


def band_shadows_m() -> NDArray[np.float64]:
    """Compute the shadow lengths that boxes of each band are made for, m, (N_BANDS,) float64: geometric centres."""
    edges = shadow_edges_m()
    return np.sqrt(edges[:-1] * edges[1:])


def band_edges(
    first_return_m: NDArray[np.float64],
    n_columns: int,
    column_spacing_m: float,
    reference_height_m: float = REFERENCE_HEIGHT_M,
) -> NDArray[np.int32]:
    """Find the columns of each band in each row, (n_rows, N_BANDS + 1) int32.

    Band k of a row holds columns [edges[k], edges[k + 1]).

    The first and the last band take all beyond. first_return_m: (n_rows,) float64, altitude of each row; NaN counts as
    the lowest possible.
    """
    clearance_m = np.fmax(np.asarray(first_return_m, dtype=np.float64) - reference_height_m, _MIN_CLEARANCE_M)
    ground_range_m = (clearance_m / reference_height_m)[:, np.newaxis] * shadow_edges_m()[1:-1]
    edges = np.empty((clearance_m.size, N_BANDS + 1), dtype=np.int32)
    edges[:, 0], edges[:, -1] = 0, n_columns
    edges[:, 1:-1] = np.clip(np.ceil(ground_range_m / column_spacing_m - 0.5), 0, n_columns)
    return edges


def bands_at(edges: NDArray[np.int32], rows: NDArray[np.integer], columns: NDArray[np.integer]) -> NDArray[np.int32]:
    """Find the band of each pixel, (n,) int32.

    Parameters
    ----------
    edges
        Of band_edges.
    rows, columns
        (n,) int.
    """
    return np.asarray((edges[rows, 1:-1] <= columns[:, np.newaxis]).sum(axis=1), dtype=np.int32)


def pixel_boxes(boxes: Sequence[FeatureBox], row_spacing_m: float, column_spacing_m: float) -> NDArray[np.int32]:
    """Round boxes to half-open offsets from a pixel's indices: top, bottom, left, right; (N_BANDS, n_boxes, 4) int32.

    Edges fall on the nearest edge between pixels, halves away from zero as counted from the pixel's first edge; a box
    is at least a pixel wide and high.
    """
    edges_m = np.array([msgspec.structs.astuple(box) for box in boxes], dtype=np.float64).reshape(-1, 6)
    shadow_m = band_shadows_m()[:, np.newaxis]
    result = np.empty((N_BANDS, len(edges_m), 4), dtype=np.int32)
    for column, metres, spacing_m in (
        (0, edges_m[:, 0], row_spacing_m),
        (1, edges_m[:, 1], row_spacing_m),
        (2, edges_m[:, 2] + edges_m[:, 3] * shadow_m, column_spacing_m),
        (3, edges_m[:, 4] + edges_m[:, 5] * shadow_m, column_spacing_m),
    ):
        result[:, :, column] = _whole(metres / spacing_m + 0.5)
    result[:, :, 1] = np.maximum(result[:, :, 1], result[:, :, 0] + 1)
    result[:, :, 3] = np.maximum(result[:, :, 3], result[:, :, 2] + 1)
    return result


def areas(boxes_px: NDArray[np.int32]) -> NDArray[np.int32]:
    """Count the pixels of boxes (..., 4), (...) int32."""
    return np.asarray((boxes_px[..., 1] - boxes_px[..., 0]) * (boxes_px[..., 3] - boxes_px[..., 2]), dtype=np.int32)


def margins_px(row_spacing_m: float, column_spacing_m: float) -> tuple[int, int, int]:
    """Compute how far boxes reach along the track either way, towards the sonar and away from it, whole pixels."""
    far_m = WINDOW_FAR_M + WINDOW_SHADOWS * float(band_shadows_m()[-1])
    reaches = (WINDOW_ROWS_M / row_spacing_m, WINDOW_NEAR_M / column_spacing_m, far_m / column_spacing_m)
    rows, near, far = (math.ceil(reach) + 2 for reach in reaches)
    return rows, near, far


def box_fault(box: FeatureBox) -> str | None:
    """Describe what is wrong with a box; None if it is not empty and stays within the largest window in every band."""
    if not all(math.isfinite(value) for value in msgspec.structs.astuple(box)):
        return "its edges must be finite"
    if not -WINDOW_ROWS_M <= box.top_m < box.bottom_m <= WINDOW_ROWS_M:
        return f"top_m must be less than bottom_m and both within {WINDOW_ROWS_M} m"
    for shadow_m in SHADOW_LIMITS_M:
        near_m, far_m = box.near_m + box.near_shadow * shadow_m, box.far_m + box.far_shadow * shadow_m
        if not -WINDOW_NEAR_M <= near_m < far_m <= WINDOW_FAR_M + WINDOW_SHADOWS * shadow_m:
            return (
                f"with a shadow of {shadow_m} m it goes from {near_m:.3g} to {far_m:.3g} m across the track; it must "
                f"not be empty and stay between {-WINDOW_NEAR_M} and {WINDOW_FAR_M} m + {WINDOW_SHADOWS} shadows"
            )
    return None


def _whole(position: NDArray[np.float64]) -> NDArray[np.int32]:
    return np.asarray(np.copysign(np.floor(np.abs(position) + (0.5 + _SNAP_PX)), position), dtype=np.int32)
