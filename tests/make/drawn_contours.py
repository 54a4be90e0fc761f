"""Draw a highlight and its shadow in single-look speckle, outlines in closed form, and starts of contours."""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.region import Region
from auv_mcm.confirm.snake import Start

Mask: TypeAlias = NDArray[np.bool_]

SHAPE: Final = (128, 128)  # pixels, what the detector hands on about a large object (chosen)
_ROW_M, _COLUMN_M = 0.1, 0.06  # of a ping at 1.5 m/s and 15 Hz, and of the default grid
_ALTITUDE_M, _GROUND_M = 6.0, 22.0  # usual of a survey at 450 kHz: shadows of 1.4 to 3.4 m (chosen)
_SHADOW, _HIGHLIGHT = 10.0**-1.0, 10.0**0.8  # of the floor's mean: -10 dB and +8 dB (chosen)


class DrawnRegion(NamedTuple):
    """Hold a single-look region and the true masks of highlight and shadow."""

    region: Region
    highlight: Mask
    shadow: Mask


def drawn_pair(seed: int) -> DrawnRegion:
    """Draw white single-look speckle over a highlight of +8 dB and its shadow of -10 dB.

    Outlines are leaning parallelograms for even seeds, half ellipses for odd ones, of an object 0.35 to 0.8 m high and
    0.8 to 2.2 m long.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    rows, columns = np.meshgrid(np.arange(SHAPE[0]) + 0.5, np.arange(SHAPE[1]) + 0.5, indexing="ij")
    half = random.uniform(0.8, 2.2) / _ROW_M / 2.0
    height_m = random.uniform(0.35, 0.8)
    length = height_m * _GROUND_M / (_ALTITUDE_M - height_m) / _COLUMN_M
    depth, lean = random.uniform(0.3, 0.5) / _COLUMN_M, random.uniform(-0.6, 0.6)
    centre, foot = 0.5 * SHAPE[0] + random.uniform(-3.0, 3.0), 45.0 + random.uniform(-3.0, 3.0)
    across = (rows - centre) / half
    if seed % 2:
        start = np.full(SHAPE, foot)
        end = foot + length * np.sqrt(np.clip(1.0 - across**2, 0.0, 1.0))
    else:
        start = foot + lean * (rows - centre)
        end = start + length
    reached = np.abs(across) <= 1.0
    shadow = reached & (columns >= start) & (columns < end)
    highlight = reached & (columns >= start - depth) & (columns < start)
    mean = np.where(shadow, _SHADOW, np.where(highlight, _HIGHLIGHT, 1.0))
    region = plain_region(mean * random.exponential(1.0, SHAPE), row=centre, column=foot - 0.5 * depth)
    return DrawnRegion(region, highlight, shadow)


def plain_region(intensity: NDArray[np.float64], *, row: float, column: float) -> Region:
    """Return a region of the drawings' geometry, all of it measured."""
    return Region(
        intensity=intensity,
        valid=np.ones(intensity.shape, dtype=np.bool_),
        row_spacing_m=_ROW_M,
        column_spacing_m=_COLUMN_M,
        first_ground_range_m=_GROUND_M - 45.0 * _COLUMN_M,
        altitude_m=_ALTITUDE_M,
        row=row,
        column=column,
        beam_width_rad=0.0,
    )


def random_start(drawn: DrawnRegion, seed: int) -> Start:
    """Draw boxes off by up to 4 pixels either way and 0.4 to 1.3 times as large as the truth."""
    random = np.random.Generator(np.random.PCG64(seed))
    rows, columns = np.nonzero(drawn.shadow)
    middle, foot = 0.5 * (rows.min() + rows.max() + 1), float(np.median(np.nonzero(drawn.highlight)[1])) + 3.0
    row, column = middle + random.uniform(-4.0, 4.0), foot + random.uniform(-4.0, 4.0)
    half = 0.5 * float(np.ptp(rows)) * random.uniform(0.4, 1.3)
    length = float(np.ptp(columns)) * random.uniform(0.4, 1.3)
    top, bottom = max(row - half, 0.0), min(row + half, SHAPE[0])
    far = min(column + length, SHAPE[1] - 1.0)
    return Start(box(top, column - 8.0, bottom, column), box(top, column, bottom, far))


def box(top: float, near: float, bottom: float, far: float) -> NDArray[np.float64]:
    """Return nodes of a rectangle, down its far side."""
    return np.array([(top, near), (top, far), (bottom, far), (bottom, near)], dtype=np.float64)
