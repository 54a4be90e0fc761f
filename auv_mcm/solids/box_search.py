"""Find the lowest points of a cost over a box: many starts spread evenly, then the best of them walk downhill.

Everything is the same in every run: starts and directions come from the additive recurrence of M. Roberts' generalised
golden ratio.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

APART: Final = 0.1  # share of the box in some coordinate, between starts that are kept and between distinct optima
MIN_STRIDE: Final = 0.1  # grains
GROWTH, SHRINKAGE = 1.5, 0.7  # of strides
_RISE: Final = 10.0  # nats
_FLATTEST, _STEEPEST = 0.05, 1e6


class SearchBox(NamedTuple):
    """Define the box searched.

    low, high: (d,) float64. wraps: (d,) bool, whether a coordinate is periodic. grain: (d,) float64, distance below
    which values hardly differ; walks measure their steps by it.
    """

    low: Array
    high: Array
    wraps: NDArray[np.bool_]
    grain: Array

    def points(self, unit: Array) -> Array:
        """Map coordinates of 0 to 1 to points; those beyond wrap, or are reflected."""
        return np.asarray(self.low + self.folded(unit) * (self.high - self.low), dtype=np.float64)

    def folded(self, unit: Array) -> Array:
        """Fold coordinates into 0 to 1 that stand for the same points."""
        return np.where(self.wraps, unit % 1.0, 1.0 - np.abs(1.0 - unit % 2.0))


class Optima(NamedTuple):
    """Hold optima.

    unit: (n, d) float64 coordinates from 0 to 1 in the box, best first. cost: (n,) float64.
    """

    unit: Array
    cost: Array


@functools.lru_cache(maxsize=32)
def spread(n: int, n_dimensions: int, first: int = 0) -> Array:
    """Give points first to first + n - 1 of a sequence that fills the unit cube evenly, (n, d), read-only."""
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (n_dimensions + 1))
    steps = ratio ** -np.arange(1.0, n_dimensions + 1.0)
    points = np.asarray((0.5 + np.arange(first + 1, first + n + 1)[:, np.newaxis] * steps) % 1.0, dtype=np.float64)
    points.flags.writeable = False
    return points


def directions(n_steps: int, n_tries: int, n_dimensions: int) -> Array:
    """Give directions to try at each step of a walk, (n_steps, n_tries, d) float64 from -1 to 1."""
    return 2.0 * spread(n_steps * n_tries, n_dimensions).reshape(n_steps, n_tries, n_dimensions) - 1.0


def look_around(cost: Callable[[Array], Array], box: SearchBox, n_starts: int, n_kept: int) -> Optima:
    """Find the best of n_starts places, each apart from better ones."""
    unit = spread(n_starts, box.low.size)
    return apart(Optima(unit, cost(box.points(unit))), box, n_kept)


def walk(
    cost: Callable[[Array], Array], box: SearchBox, optima: Optima, n_steps: int, n_tries: int, *, first_stride: float
) -> Optima:
    """Walk each place n_steps times to the best of n_tries steps if that is better.

    Steps grow with success and shrink without.

    first_stride: in grains.
    """
    grain = box.grain / (box.high - box.low)
    unit, best = optima.unit, optima.cost
    n, d = unit.shape
    strides = np.full(n, first_stride)
    for way in directions(n_steps, n_tries, d):
        there = unit[:, np.newaxis] + strides[:, np.newaxis, np.newaxis] * (grain * way)
        costs = cost(box.points(there.reshape(-1, d))).reshape(n, n_tries)
        choice = costs.argmin(axis=1)
        lowest = costs[np.arange(n), choice]
        better = lowest < best
        unit = np.where(better[:, np.newaxis], there[np.arange(n), choice], unit)
        best = np.where(better, lowest, best)
        strides = np.maximum(strides * np.where(better, GROWTH, SHRINKAGE), MIN_STRIDE)
    return best_first(box, unit, best)


def best_first(box: SearchBox, unit: Array, cost: Array) -> Optima:
    """Sort places (n, d) that may lie beyond the box, with their costs (n,), into optima."""
    order = np.argsort(cost, kind="stable")
    return Optima(box.folded(unit)[order], cost[order])


def apart(optima: Optima, box: SearchBox, n_kept: int) -> Optima:
    """Select the n_kept best of those that differ from every better one."""
    kept: list[int] = []
    for index in np.argsort(optima.cost, kind="stable").tolist():
        away = np.abs(optima.unit[kept] - optima.unit[index])
        away = np.where(box.wraps, np.minimum(away, 1.0 - away), away)
        if not kept or (away.max(axis=1) > APART).all():
            kept.append(index)
            if len(kept) == n_kept:
                break
    return Optima(optima.unit[kept], optima.cost[kept])


def curvature_covariance(cost: Callable[[Array], Array], box: SearchBox, point: Array) -> Array:
    """Compute the covariance (d, d) of a point at the minimum of `cost`, a negative log likelihood.

    It is the inverse of the second differences.

    Steps are a quarter to eight grains, the shortest at which the cost rises by ten nats: shorter ones follow single
    pixels. A direction that is flat up to eight grains is given a standard deviation of a few times that.
    """
    d = point.size
    scales = 0.25 * 2.0 ** np.arange(6)
    offsets = scales[:, np.newaxis, np.newaxis] * np.diag(box.grain)

    def at(points: Array) -> Array:
        unit = (points - box.low) / (box.high - box.low)
        return cost(box.points(unit.reshape(-1, d))).reshape(points.shape[:-1])

    here, ahead, back = np.split(
        at(np.concatenate([point[np.newaxis], (point + offsets).reshape(-1, d), (point - offsets).reshape(-1, d)])),
        (1, 1 + 6 * d),
    )
    rise = (0.5 * (ahead + back) - here).reshape(len(scales), d)
    enough = rise >= _RISE
    choice = np.where(enough.any(axis=0), enough.argmax(axis=0), len(scales) - 1)
    step = scales[choice] * box.grain
    moves = np.diag(step)
    second = np.diag(2.0 * rise[choice, np.arange(d)])
    first, other = np.triu_indices(d, 1)
    same, opposite = moves[first] + moves[other], moves[first] - moves[other]
    corners = at(np.stack((point + same, point - same, point + opposite, point - opposite)))
    second[first, other] = second[other, first] = 0.25 * (corners[0] + corners[1] - corners[2] - corners[3])
    values, vectors = np.linalg.eigh(np.clip(second, -_STEEPEST, _STEEPEST))
    covariance = (vectors / np.clip(values, _FLATTEST, None)) @ vectors.T
    return np.asarray(covariance * np.outer(step, step), dtype=np.float64)
