"""Draw the tiles and the model that rows of waterfall and detection work on, and sum boxes exactly."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sim_replay.benches.stability.rows import random_of

Plane = NDArray[np.float32]
Values = NDArray[np.float64]

ROUNDED: Final = 1.8e-7  # 3 roundings of float32: of a sample, of its copy, and of their product
TILE: Final = (96, 160)  # pixels of a small tile
BIG_TILE: Final = (2048, 1024)  # of a tile as the chain cuts them at 1.5 cm


def speckle(shape: tuple[int, ...], seed: int = 0) -> Plane:
    """Draw single-look speckle of mean 1."""
    return random_of(seed).exponential(size=shape).astype(np.float32)


def with_shadow(shape: tuple[int, ...]) -> Plane:
    """Draw speckle with a shadow."""
    plane = speckle(shape)
    plane[..., shape[-1] // 2 :] *= np.float32(1e-30)
    return plane


def with_spike(shape: tuple[int, ...]) -> Plane:
    """Draw speckle with a spike."""
    plane = speckle(shape)
    plane[..., shape[-1] - 1] = np.float32(65535.0**2)
    return plane


INTENSITIES: Final[dict[str, Callable[[tuple[int, ...]], Plane]]] = {
    "one look": speckle,
    "constant": lambda shape: np.full(shape, 0.3, dtype=np.float32),
    "saturated": lambda shape: np.full(shape, 65535.0**2, dtype=np.float32),
    "offset 1e6": lambda shape: np.float32(1e6) + speckle(shape),
    "gain 1e-30": lambda shape: speckle(shape) * np.float32(1e-30),
    "gain 1e30": lambda shape: speckle(shape) * np.float32(1e30),
    "denormal": lambda shape: speckle(shape) * np.float32(1e-41),
    "ring-down of 100 dB": lambda shape: speckle(shape) * np.where(np.arange(shape[-1]) < 9, 1e10, 1).astype("f4"),
}
"""Intensities (any shape) float32 by name."""


def places_in(shape: tuple[int, int], n: int) -> list[tuple[int, int]]:
    """Draw pixels, the far corner with them."""
    random = random_of(5)
    rows, columns = random.integers(0, shape[0], n).tolist(), random.integers(0, shape[1], n).tolist()
    return [(shape[0] - 1, shape[1] - 1), *zip(rows, columns, strict=True)]


def box_of(shape: tuple[int, int], place: tuple[int, int], half: tuple[int, int]) -> tuple[slice, slice]:
    """Cut a box about a place out of a plane."""
    rows, columns = (slice(max(at - reach, 0), at + reach + 1) for at, reach in zip(place, half, strict=True))
    return rows, columns


def box_sum(plane: NDArray[Any], place: tuple[int, int], half: tuple[int, int]) -> float:
    """Sum the box about a place."""
    return math.fsum(plane[box_of(plane.shape, place, half)].astype(np.float64).ravel().tolist())


def box_count(shape: tuple[int, int], place: tuple[int, int], half: tuple[int, int]) -> int:
    """Count the pixels of the box about a place."""
    return math.prod(
        min(at + reach, n - 1) - max(at - reach, 0) + 1 for at, reach, n in zip(place, half, shape, strict=True)
    )
