"""Tiles of extreme pictures, for whatever detects in tiles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import VALID, Tile
from tests.make.records import pose_of, tile_with

SHAPE = (130, 220)
ROW_M, COLUMN_M = 0.12, 0.06


def tile_of(
    intensity: NDArray[Any],
    mask: NDArray[np.uint8] | None = None,
    *,
    row_m: float = ROW_M,
    column_m: float = COLUMN_M,
    first_return_m: float = 5.0,
) -> Tile:
    bits = np.full(intensity.shape, VALID, dtype=np.uint8) if mask is None else mask
    along_m = (np.arange(len(intensity)) + 0.5) * row_m
    place = np.stack((0.0 * along_m, along_m, 0.0 * along_m), axis=-1)
    latitude, longitude, _ = LocalFrame(latitude_deg=60.0, longitude_deg=5.0).to_geodetic(place)
    pose = pose_of(len(along_m), time_s=along_m / 1.5, latitude_deg=latitude, longitude_deg=longitude)
    seen = np.where((bits & VALID) != 0, intensity, 0.0)
    spacing = {"row_spacing_m": row_m, "column_spacing_m": column_m}
    return tile_with(seen, bits, side="port", pose=pose, first_return_m=first_return_m, **spacing)


def speckle(seed: int = 0, shape: tuple[int, int] = SHAPE) -> NDArray[np.float64]:
    return np.random.default_rng(seed).exponential(1.0, shape)


def with_object(floor: NDArray[np.float64], row: int = 60, column: int = 100) -> NDArray[np.float64]:
    drawn = floor.copy()
    drawn[row : row + 5, column : column + 6] *= 15.0
    drawn[row : row + 5, column + 6 : column + 26] *= 0.02
    return drawn


def holes(share: float) -> NDArray[np.uint8]:
    return np.where(np.random.default_rng(1).random(SHAPE) < share, 0, VALID).astype(np.uint8)


def ripples(direction_deg: float) -> NDArray[np.float64]:
    """Sand ripples 0.3 m from crest to crest, 6 dB deep."""
    row, column = np.indices(SHAPE)
    direction = np.deg2rad(direction_deg)
    phase = 2.0 * np.pi * (row * ROW_M * np.cos(direction) + column * COLUMN_M * np.sin(direction)) / 0.3
    return np.asarray(speckle() * (1.0 + 0.6 * np.sin(phase)))


ROWS, COLUMNS = np.indices(SHAPE)
PICTURES: dict[str, NDArray[Any]] = {
    "constant": np.ones(SHAPE),
    "zero": np.zeros(SHAPE),
    "checkerboard": ((ROWS + COLUMNS) % 2).astype(np.float64),
    "impulse": np.where((ROWS == 60) & (COLUMNS == 100), 1e6, 1.0),
    "one bit": (speckle() > 1.0).astype(np.float64),
    "gain ramp of 40 dB": speckle() * 10.0 ** (4.0 * COLUMNS / SHAPE[1] - 2.0),
    "gain ramp along track": speckle() * 10.0 ** (4.0 * ROWS / SHAPE[0] - 2.0),
    "smallest numbers": speckle() * 1e-44,
    "largest numbers": np.minimum(speckle() * 1e38, 3e38),
    "half zero": speckle() * (ROWS < 65),
    "half dark": np.where(COLUMNS < 110, speckle(), 1e-4 * speckle(1)),
    "single pixels of echo in nothing": (np.random.default_rng(2).random(SHAPE) < 0.01).astype(np.float64),
    "ripples along track": ripples(0.0),
    "ripples across track": ripples(90.0),
    "ripples aslant": ripples(45.0),
}
