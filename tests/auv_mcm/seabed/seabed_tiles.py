"""Made-up tiles of sea floor."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import VALID, PoseTrack, Side, Tile

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
    heading_deg: float = 0.0,
) -> Tile:
    n_rows = intensity.shape[0]
    nothing: dict[str, Any] = dict.fromkeys(
        ("depth_m", "pitch_rad", "roll_rad", "speed_mps", "longitude_deg"), np.zeros(n_rows)
    )
    pose = PoseTrack(
        time_s=np.arange(n_rows, dtype=np.float64) * 0.07,
        latitude_deg=43.0 + np.arange(n_rows, dtype=np.float64) * ROW_M / 111e3,
        heading_rad=np.full(n_rows, math.radians(heading_deg)),
        altitude_m=np.full(n_rows, 5.0),
        stale=np.zeros(n_rows, dtype=np.bool_),
        **nothing,
    )
    return Tile(
        side=side,
        index=0,
        first_row=0,
        core_start=0 if core is None else core[0],
        core_stop=n_rows if core is None else core[1],
        row_spacing_m=ROW_M,
        column_spacing_m=COLUMN_M,
        intensity=intensity.astype(np.float32),
        mask=np.full(intensity.shape, VALID, dtype=np.uint8) if mask is None else mask,
        pose=pose,
        first_return_m=np.full(n_rows, 5.0),
        first_return_sigma_m=np.full(n_rows, 0.1),
        ping_number=np.arange(n_rows, dtype=np.int64),
    )
