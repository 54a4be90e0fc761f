"""Draw the tiles and the model that rows of waterfall and detection work on, and sum boxes exactly."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.bands import WINDOW, FeatureBox
from auv_mcm.detect.cascade.model import MAX_LEAF, MAX_STUMPS, SCORE_UNIT, Calibration, CascadeModel, Stump, check_model
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


def drawn_model(seed: int, largest: float = 3.0, n_stumps: int = 12) -> CascadeModel:
    """Draw comparisons of boxes at least 0.5 m long and wide, thresholds from 1 / largest to largest.

    They drop nothing.
    """
    random = random_of(seed)

    def box() -> FeatureBox:
        top, near = random.uniform(-1.0, 0.4, 2)
        length, width = random.uniform(0.5, 1.0 - top), random.uniform(0.5, 1.0 - near)
        return FeatureBox(
            float(top), float(top + length), float(near), 0.0, float(near + width), float(random.uniform(0.0, 1.0))
        )

    stumps = []
    for k in range(n_stumps):
        threshold = float(largest ** random.uniform(-1.0, 1.0))
        leaf = int(random.integers(-900, 900))
        if k % 2:
            stumps.append(Stump(kind="ratio", a=box(), b=box(), threshold=threshold, below=-leaf, above=leaf))
        else:
            against = threshold - 1.0 / threshold
            stumps.append(
                Stump(kind="contrast", a=box(), b=box(), w=WINDOW, threshold=against, below=-leaf, above=leaf)
            )
    model = CascadeModel(
        kind="soft",
        trained_on="nothing",
        training_sha256="",
        row_spacing_m=(0.001, 10.0),
        column_spacing_m=(0.001, 10.0),
        calibration=Calibration(score=(-3 * SCORE_UNIT, 3 * SCORE_UNIT), log_odds=(-6.0, 6.0)),
        reject=(-MAX_STUMPS * MAX_LEAF,),
        groups=(tuple(stumps),),
    )
    check_model(model, "made here")
    return model
