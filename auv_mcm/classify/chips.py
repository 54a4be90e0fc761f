"""Cut chips for the verifier: the sea floor around a detection as two small pictures of fixed size.

One picture has even pixels in metres. In the other a column stands for the height of what would throw a shadow that
ends there, so that a mine's shadow is as long at every range and altitude. Levels are in decibels about the middle of
the chip's own floor, divided by its spread: how samples were stored, averaged or compressed drops out.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.region import Region
from auv_mcm.detect.gate import LOG_RANGE
from auv_mcm.kernels.cell_sums import cell_sums
from auv_mcm.kernels.order import median

N_ROWS: Final = 40
"""Rows of both pictures, along the track."""
N_COLUMNS: Final = 72
"""Columns of the picture by metres."""
N_HEIGHTS: Final = 36
"""Columns of the picture by height."""
N_PLACE: Final = 3
"""Numbers that state the place: ln(ground range / altitude), altitude and the beam's footprint."""
_ROW_M: Final = 0.125  # 40 rows show 5 m: the longest mine, and the floor beside it
_COLUMN_M: Final = 0.1  # 72 columns show 7.2 m
_NEAR_M: Final = 2.0  # of them before the highlight's middle
_BESIDE_M: Final = 0.2  # two pixels, as far as the highlight's middle is off on speckle. Chosen
_HEIGHT_M: Final = 0.05  # of a column by height: 36 end at 1.8 m, above any mine
_LEAST_ABOVE_M: Final = 0.05  # of the sonar above a top whose shadow has an end
_DARKEST: Final = 1e-4  # of the mean floor, -40 dB: the lowest code of a snippet
_SIGMAS_PER_DEVIATION: Final = 1.4826  # of a normal law, from its median absolute deviation
_LEAST_SPREAD_DB: Final = 0.5  # a floor averaged over 80 looks; below it rounding would be enlarged
_LIMIT: Final = 8.0  # spreads about the floor's middle, as far as either picture reaches

Picture = NDArray[np.float32]


class Chip(NamedTuple):
    """Hold a chip. by_metres: (N_ROWS, N_COLUMNS), by_height: (N_ROWS, N_HEIGHTS), place: (N_PLACE,), all float32.

    Levels are in spreads of the floor, 0 where nothing was measured.
    """

    by_metres: Picture
    by_height: Picture
    place: Picture


def chip_of(region: Region, along_m: float = 0.0, across_m: float = 0.0) -> Chip:
    """Cut the chip around a region's highlight.

    Every pixel is the mean of the intensities that it covers, each weighed by the area in common. Pixels finer than the
    sonar's repeat the nearest.

    Parameters
    ----------
    along_m, across_m
        From the highlight's middle to the place that the chip is cut around, in the order of rows and of columns.
    """
    rows = _ROW_M * (np.arange(N_ROWS + 1, dtype=np.float64) - 0.5 * N_ROWS)
    rows = region.row + (along_m + rows) / region.row_spacing_m
    top = min(max(int(rows[0]), 0), len(region.valid) - 1)
    end = min(max(int(rows[-1]) + 1, top + 1), len(region.valid))
    centre_m = region.first_ground_range_m + region.column * region.column_spacing_m + across_m
    by_metres_m = centre_m - _NEAR_M + _COLUMN_M * np.arange(N_COLUMNS + 1, dtype=np.float64)
    by_height_m = shadow_ends_m(centre_m, region.altitude_m, _HEIGHT_M * np.arange(N_HEIGHTS + 1, dtype=np.float64))
    edges = (np.concatenate([by_metres_m, by_height_m]) - region.first_ground_range_m) / region.column_spacing_m
    total, area = cell_sums(region.intensity[top:end], region.valid[top:end], rows - top, edges)
    measured = area > 1e-6  # pixels: what is less is the rounding of a difference of sums
    mean = np.divide(total, area, out=np.ones(area.shape), where=measured)
    levels_db = 10.0 * np.log10(np.maximum(mean, _DARKEST))
    middle_db, spread_db = floor_of(levels_db[:, :N_COLUMNS][measured[:, :N_COLUMNS]])
    spreads = np.minimum(np.maximum((levels_db - middle_db) / spread_db, -_LIMIT), _LIMIT)
    levels = np.where(measured, spreads, 0.0).astype(np.float32)
    # Between the two pictures lies what is a cell of neither.
    by_metres, by_height = levels[:, :N_COLUMNS].copy(), levels[:, N_COLUMNS + 1 :].copy()
    return Chip(by_metres, by_height, _place(region, centre_m))


def chips_beside(region: Region, chip: Chip) -> list[Chip]:
    """Cut chips that show the same object as a region's chip: its mirror image along the track, and two a little off.

    Parameters
    ----------
    chip
        Of `chip_of(region)`.
    """
    mirrored = Chip(np.ascontiguousarray(chip.by_metres[::-1]), np.ascontiguousarray(chip.by_height[::-1]), chip.place)
    return [mirrored, chip_of(region, -_BESIDE_M, -_BESIDE_M), chip_of(region, _BESIDE_M, _BESIDE_M)]


def shadow_ends_m(ground_range_m: float, altitude_m: float, height_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute where on a level floor the shadow of a top of height (n,) at a ground range ends, m.

    Similar triangles: altitude * range / (altitude - height). Heights end 5 cm below the sonar.
    """
    return np.asarray(altitude_m * ground_range_m / np.maximum(altitude_m - height_m, _LEAST_ABOVE_M))


def floor_of(levels_db: NDArray[np.float64]) -> tuple[float, float]:
    """Estimate the middle and the spread of the floor's level, dB, from levels that were measured, (n,).

    Median and median absolute deviation, which an object and its shadow hardly move.
    """
    if not levels_db.size:
        return 0.0, 1.0
    middle_db = median(levels_db)
    spread_db = _SIGMAS_PER_DEVIATION * median(np.abs(levels_db - middle_db))
    return middle_db, max(spread_db, _LEAST_SPREAD_DB)


def _place(region: Region, centre_m: float) -> Picture:
    ratio = max(centre_m, _COLUMN_M) / region.altitude_m
    slant_m = math.hypot(centre_m, region.altitude_m)
    log_range = min(max(math.log(ratio), LOG_RANGE[0]), LOG_RANGE[1])
    footprint_m = min(region.beam_width_rad * slant_m, 2.0)
    return np.array([log_range - 1.0, math.log(region.altitude_m / 5.0), 4.0 * (footprint_m - 0.25)], dtype=np.float32)
