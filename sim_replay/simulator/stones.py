"""Scatter stones by place and seed alone, so that any area can be requested at any time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

import numpy as np
import scipy.special
from numpy.typing import NDArray

from sim_replay.simulator.fields import FloatArray
from sim_replay.simulator.seabeds import Cover

Array: TypeAlias = NDArray[np.float64]
LabelAt: TypeAlias = Callable[[Array, Array], NDArray[np.uint8]]

# Columns of a table of stones.
EAST, NORTH, LENGTH, WIDTH, HEIGHT, AZIMUTH = range(6)

_SQUARE_M: Final = 4.0  # m: squares whose stones are drawn together
_SIZE_EXPONENT: Final = 2.5  # of the power law of sizes
_LARGEST_M: Final = 6.0  # m: of a stone, maximum
_LARGEST_RATIO: Final = 8.0  # times the smallest, maximum
# An outline bulges to three sides by this much of r^3, which carries it out to 1.12 radii.
_BULGE: Final = 0.18
_OUTLINE_RADII: Final = 1.12
_M2_PER_HA: Final = 10_000.0


def _mixed(value: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Mix bits by the finaliser of SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators",
    2014)."""
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


def _uniform(keys: NDArray[np.uint64], attributes: int) -> Array:
    """Return numbers in [0, 1) of keys: (attributes, *shape of keys); attributes are independent of each other."""
    steps = np.arange(1, attributes + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    return (_mixed(np.add.outer(steps, keys)) >> np.uint64(11)).astype(np.float64) * 2.0**-53


def largest_m(stone_m: float) -> float:
    """Return the length that no stone exceeds where stones are longer than stone_m."""
    return max(stone_m, min(_LARGEST_RATIO * stone_m, _LARGEST_M))


class Stones:
    """Scatter the stones of a sea floor made of `covers`."""

    def __init__(self, covers: Sequence[Cover], seed: int) -> None:
        self._per_m2 = np.array([cover.stones_per_ha / _M2_PER_HA for cover in covers])
        self._smallest_m = np.array([cover.stone_m for cover in covers])
        self._largest_m = np.array([largest_m(cover.stone_m) for cover in covers])
        self._seed = seed
        with_stones = self._per_m2 > 0.0
        self.reach_m = float(0.5 * _OUTLINE_RADII * np.max(self._largest_m, where=with_stones, initial=0.0))
        mean = float(self._per_m2.max()) * _SQUARE_M**2
        counts = np.arange(math.ceil(mean + 10.0 * math.sqrt(mean) + 10.0))
        self._count_below = scipy.special.pdtr(counts, mean)

    def __bool__(self) -> bool:
        """Report whether there are any stones."""
        return self.reach_m > 0.0

    def within(self, east_min: float, east_max: float, north_min: float, north_max: float, label_at: LabelAt) -> Array:
        """Return stones whose middles lie in an area (m, lower bounds included).

        Their order is the same for every area.

        Returns (n, 6) float64: east, north, length, width, height above the floor (m), azimuth of the length (rad).

        Parameters
        ----------
        label_at
            Gives the kind of sea floor at places (east, north).
        """
        # As a square's stones are drawn for the stoniest kind, others keep their part of them.
        rows = np.arange(math.floor(north_min / _SQUARE_M), math.floor(north_max / _SQUARE_M) + 1)
        columns = np.arange(math.floor(east_min / _SQUARE_M), math.floor(east_max / _SQUARE_M) + 1)
        squares = _mixed(
            rows.astype(np.uint64) + np.array([self._seed], dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        )
        squares = _mixed(squares[:, None] ^ (columns.astype(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F))[None, :])
        counts = np.searchsorted(self._count_below, _uniform(squares, 1)[0], side="right")
        if not counts.any():
            return np.empty((0, 6))
        row, column = np.nonzero(counts)
        repeats = counts[row, column]
        ordinal = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
        keys = _mixed(
            np.repeat(squares[row, column], repeats) + ordinal.astype(np.uint64) * np.uint64(0xD6E8FEB86659FD93)
        )
        draws = _uniform(keys, 7)
        north = (np.repeat(rows[row], repeats) + draws[0]) * _SQUARE_M
        east = (np.repeat(columns[column], repeats) + draws[1]) * _SQUARE_M
        inside = np.flatnonzero((east >= east_min) & (east < east_max) & (north >= north_min) & (north < north_max))
        label = label_at(east[inside], north[inside])
        kept = draws[2, inside] * self._per_m2.max() < self._per_m2[label]
        inside, label = inside[kept], label[kept]
        # Inverse of N(>d) = ((d / smallest)^-2.5 - rest) / (1 - rest), rest being what the law has beyond the largest.
        smallest, largest = self._smallest_m[label], self._largest_m[label]
        rest = np.where(largest > smallest, (largest / smallest) ** -_SIZE_EXPONENT, 0.0)
        _, _, _, rank, slimness, flatness, turn = draws[:, inside]
        length = np.minimum(smallest * (rest + (1.0 - rest) * (1.0 - rank)) ** (-1.0 / _SIZE_EXPONENT), largest)
        width = length * (0.6 + 0.35 * slimness)
        height = width * (0.3 + 0.35 * flatness)
        return np.stack([east[inside], north[inside], length, width, height, 2.0 * math.pi * turn], axis=1)


def raise_stones(layer: FloatArray, stones: Array, first_row: int, first_column: int, cell_m: float) -> None:
    """Raise half-buried irregular ellipsoids out of a layer of heights; where stones overlap, the higher counts.

    Parameters
    ----------
    layer
        (rows, columns) float32 heights in m, changed in place; its element (0, 0) is node (first_row, first_column).
    stones
        (n, 6) as `Stones.within` gives them.
    first_row, first_column
        Of the layer.
    cell_m
        Distance between nodes.
    """
    half = np.ceil(0.5 * _OUTLINE_RADII * stones[:, LENGTH] / cell_m).astype(np.int64) + 1
    # Stones of about one size are drawn together: the sizes' power law makes nearly all of them small.
    reach = 1 << np.ceil(np.log2(half)).astype(np.int64)
    for cells in np.unique(reach):
        group = stones[reach == cells]
        nodes = np.arange(-cells, cells + 1)
        row, column = (
            np.rint(group[:, NORTH] / cell_m).astype(np.int64),
            np.rint(group[:, EAST] / cell_m).astype(np.int64),
        )
        north = ((row[:, None] + nodes) * cell_m - group[:, NORTH, None]).astype(np.float32)[:, :, None]
        east = ((column[:, None] + nodes) * cell_m - group[:, EAST, None]).astype(np.float32)[:, None, :]
        azimuth = group[:, AZIMUTH, None, None]
        along, across = 2.0 / group[:, LENGTH, None, None], 2.0 / group[:, WIDTH, None, None]
        sine, cosine = np.sin(azimuth), np.cos(azimuth)
        u = north * (cosine * along).astype(np.float32) + east * (sine * along).astype(np.float32)
        v = east * (cosine * across).astype(np.float32) - north * (sine * across).astype(np.float32)
        u2, v2 = u * u, v * v
        square = u2 + v2
        dome = 1.0 - square + np.float32(_BULGE) * u * (u2 - 3.0 * v2)
        dome[square > _OUTLINE_RADII**2] = 0.0
        height = np.sqrt(np.maximum(dome, 0.0)) * group[:, HEIGHT, None, None].astype(np.float32)
        size = 2 * int(cells) + 1
        for block, top, left in zip(
            height, (row - cells - first_row).tolist(), (column - cells - first_column).tolist(), strict=True
        ):
            rows = slice(max(top, 0), min(top + size, layer.shape[0]))
            columns = slice(max(left, 0), min(left + size, layer.shape[1]))
            if rows.start < rows.stop and columns.start < columns.stop:
                part = layer[rows, columns]
                np.maximum(
                    part,
                    block[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left],
                    out=part,
                )
