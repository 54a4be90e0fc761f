"""Cut chips for the convolutional verifier: the sea floor around a detection, normalised for geometry.

A chip has two pictures of the same rows. One has even pixels in metres, for the object. In the other a column stands
for the height of what would throw a shadow that ends there, so that a mine's shadow is as long at every range and
altitude. Constant planes state what cannot be normalised away.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.region import Region

ROW_M: Final = 0.15
"""Height of a chip's pixels along the track, m: 24 rows show 3.6 m, the longest mine and what lies beside it."""
N_ROWS: Final = 24
"""Rows of a chip."""
N_COLUMNS: Final = 32
"""Columns of a chip."""
N_PLANES: Final = 5
"""Pictures by metres and by height, grazing, footprint of the beam, and spread of the floor's echo."""
_COLUMN_M: Final = 0.1  # of the picture by metres
_NEAR_M: Final = 1.2  # of it before the highlight's centre; 2 m lie behind
_HEIGHT_M: Final = 0.05  # of a column of the picture by height: 32 of them end at 1.6 m, above any mine
_FLOOR: Final = 1e-3  # of the mean floor, -30 dB: what is darker is noise
_SCALE_DB: Final = 10.0  # pictures lie within -3 and 3
_LIMIT: Final = 3.0  # of _SCALE_DB

Chip = NDArray[np.float32]


def chip_of(region: Region) -> Chip:
    """Cut the chip around a region's highlight; (N_PLANES, N_ROWS, N_COLUMNS) float32. Unmeasured pixels are 0.

    Every pixel is the mean of the intensities that it covers, weighed by the area in common, in decibels over the mean
    floor by _SCALE_DB. Pixels finer than the sonar's repeat the nearest.
    """
    edges = np.arange(max(N_ROWS, N_COLUMNS) + 1, dtype=np.float64)
    row_edges = region.row + ROW_M * (edges[: N_ROWS + 1] - 0.5 * N_ROWS) / region.row_spacing_m
    rows = _shares(row_edges, len(region.intensity))
    centre_m = region.first_ground_range_m + region.column * region.column_spacing_m
    by_metres_m = centre_m - _NEAR_M + _COLUMN_M * edges[: N_COLUMNS + 1]
    by_height_m = shadow_ends_m(centre_m, region.altitude_m, _HEIGHT_M * edges[: N_COLUMNS + 1])
    n_columns = region.intensity.shape[1]
    valid = region.valid.astype(np.float64)
    sound = np.where(region.valid, region.intensity, 0.0)
    chip = np.zeros((N_PLANES, N_ROWS, N_COLUMNS), dtype=np.float32)
    for plane, edges_m in enumerate((by_metres_m, by_height_m)):
        columns = _shares((edges_m - region.first_ground_range_m) / region.column_spacing_m, n_columns).T
        measured = rows @ valid @ columns
        level = np.divide(rows @ sound @ columns, measured, out=np.ones_like(measured), where=measured > 0.0)
        level_db = 10.0 * np.log10(np.maximum(level, _FLOOR))
        chip[plane] = np.clip(level_db / _SCALE_DB, -_LIMIT, _LIMIT)
    chip[2] = math.log(max(centre_m, _COLUMN_M) / region.altitude_m)
    chip[3] = region.beam_width_rad * math.hypot(centre_m, region.altitude_m)
    chip[4] = _spread(region)
    return chip


def shadow_ends_m(ground_range_m: float, altitude_m: float, height_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute where on a level floor the shadow of a top of height (n,) at a ground range ends, m.

    Similar triangles: altitude * range / (altitude - height). Heights end 5 cm below the sonar.
    """
    return np.asarray(altitude_m * ground_range_m / np.maximum(altitude_m - height_m, 0.05))


def _shares(edges: NDArray[np.float64], n_pixels: int) -> NDArray[np.float64]:
    """Compute how much of each pixel lies between neighbouring edges, (n - 1, n_pixels), in pixels."""
    pixel = np.arange(n_pixels)
    low, high = edges[:-1, None], edges[1:, None]
    return np.asarray(np.clip(np.minimum(high, pixel + 1.0) - np.maximum(low, pixel), 0.0, 1.0))


def _spread(region: Region) -> float:
    """Compute the standard deviation of the region's level, in _SCALE_DB: more looks are smoother."""
    sound = region.intensity[region.valid]
    if not len(sound):
        return 0.0
    return float(np.std(np.log10(np.maximum(sound, _FLOOR))))
