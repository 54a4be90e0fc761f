"""Approximate a Potts field of three labels by mean field: each cell's probabilities given its eight neighbours.

A sweep sets all cells at once: p = softmin(cost - sum of the neighbours' weights times their probabilities).
C and numpy agree to 1e-12, their exponentials may differ in the last bit; means of classes to 1e-9.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call

Plane = NDArray[np.float64]


def sweep(cost: Plane, weight: Plane, n_sweeps: int, probability: Plane) -> Plane:
    """Make n_sweeps sweeps from `probability`; returns the probabilities then, (3, n_rows, n_columns) float64.

    Parameters
    ----------
    cost, probability
        (3, n_rows, n_columns) float64.
    weight
        (4,) float64, of the edges right, down-left, down, down-right; both diagonals count as the last one.
    """
    found, room = np.array(probability, dtype=np.float64, order="C"), np.empty((2, *cost.shape[1:]))
    if not call("mean_field", *cost.shape[1:], cost, weight, n_sweeps, found, *room):
        return sweep_numpy(cost, weight, n_sweeps, probability)
    return found


def sweep_numpy(cost: Plane, weight: Plane, n_sweeps: int, probability: Plane) -> Plane:
    """Do as sweep, in numpy alone."""
    for _ in range(n_sweeps):
        probability = softmin(cost - _neighbour_sum(probability, weight))
    return probability


def softmin(cost: Plane) -> Plane:
    """Turn costs (3, ...) into probabilities of the same shape."""
    probability = np.exp(cost.min(axis=0) - cost)
    return np.asarray(probability / probability.sum(axis=0))


def _neighbour_sum(probability: Plane, weight: Plane) -> Plane:
    """Sum the probabilities of the eight neighbours with their weights."""
    beside = np.zeros_like(probability)
    beside[:, :, 1:] += probability[:, :, :-1]
    beside[:, :, :-1] += probability[:, :, 1:]
    across = weight[2] * probability + weight[3] * beside
    heard: Plane = weight[0] * beside
    heard[:, 1:] += across[:, :-1]
    heard[:, :-1] += across[:, 1:]
    return heard
