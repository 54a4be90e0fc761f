"""Made-up tiles of sea floor."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import Side, Tile
from tests.make.records import pose_of, tile_with

ROW_M, COLUMN_M = 0.12, 0.06
Array = NDArray[np.float64]


def speckled(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Single-look intensity of mean 1, every pixel by itself."""
    return rng.exponential(1.0, shape)


def rippled(
    rng: np.random.Generator, shape: tuple[int, int], wavelength_m: float, direction_rad: float, depth: float = 0.7
) -> Array:
    """Speckle on waves that follow one another in a direction: 0 along the track, pi / 2 towards far range."""
    along, across = np.meshgrid(np.arange(shape[0]) * ROW_M, np.arange(shape[1]) * COLUMN_M, indexing="ij")
    phase = 2.0 * np.pi * (along * math.cos(direction_rad) + across * math.sin(direction_rad)) / wavelength_m
    return np.asarray((1.0 + depth * np.cos(phase)) * speckled(rng, shape))


def tile_of(
    intensity: Array,
    mask: NDArray[np.uint8] | None = None,
    *,
    side: Side = "starboard",
    core: tuple[int, int] | None = None,
    heading_deg: Array | float = 0.0,
) -> Tile:
    row = np.arange(len(intensity), dtype=np.float64)
    pose = pose_of(
        len(row),
        time_s=row * 0.07,
        latitude_deg=43.0 + row * ROW_M / 111e3,
        heading_rad=np.radians(heading_deg),
        altitude_m=5.0,
    )
    first, stop = core or (0, len(row))
    spacing = {"row_spacing_m": ROW_M, "column_spacing_m": COLUMN_M}
    return tile_with(intensity, mask, side=side, core_start=first, core_stop=stop, pose=pose, **spacing)
