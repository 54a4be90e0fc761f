"""Fit a small network to shares of kinds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]
"""float32 for learning, float64 for checking slopes."""

# Adam with decoupled weight decay (I. Loshchilov and F. Hutter, "Decoupled weight decay regularization", ICLR 2019).
_BATCH: Final = 2048
_RATE: Final = 3e-3  # of learning at the start; it falls to 0 along a cosine
_MEAN_DECAY: Final = 0.9
_SQUARE_DECAY: Final = 0.999
_EPSILON: Final = 1e-8


class NetworkLayer(NamedTuple):
    """Hold one layer: weights (n_inputs, n_units) and constants (n_units,)."""

    weights: Floats
    constants: Floats


def log_odds(network: Sequence[NetworkLayer], x: Floats) -> Floats:
    """Weigh inputs (n, n_inputs), up to what is the same for all kinds: (n, n_kinds)."""
    return _activations(network, x)[-1]


def fitted_network(
    x: Floats, shares: Floats, weight: Floats, *, n_hidden: Sequence[int], epochs: int, weight_decay: float, seed: int
) -> list[NetworkLayer]:
    """Minimise the weighted cross-entropy of shares (n, n_kinds) by inputs (n, n_inputs).

    The same seed makes the same network on one computer.

    Parameters
    ----------
    weight
        (n,).
    n_hidden
        Units of each hidden layer.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    sizes = [x.shape[1], *n_hidden, shares.shape[1]]
    network = [
        NetworkLayer(
            rng.normal(0.0, 1.0 / math.sqrt(before), (before, after)).astype(np.float32),
            np.zeros(after, dtype=np.float32),
        )
        for before, after in pairwise(sizes)
    ]
    parts = [part for units in network for part in units]  # changed in place below
    means, squares = ([np.zeros_like(part) for part in parts] for _ in range(2))
    n_steps, step = epochs * math.ceil(len(x) / _BATCH), 0
    for _ in range(epochs):
        order = rng.permutation(len(x))
        for start in range(0, len(x), _BATCH):
            chosen = order[start : start + _BATCH]
            rate = np.float32(_RATE * 0.5 * (1.0 + math.cos(math.pi * step / n_steps)))
            step += 1
            for number, slope in enumerate(slopes(network, x[chosen], shares[chosen], weight[chosen])):
                means[number] = _MEAN_DECAY * means[number] + (1.0 - _MEAN_DECAY) * slope
                squares[number] = _SQUARE_DECAY * squares[number] + (1.0 - _SQUARE_DECAY) * slope * slope
                mean = means[number] / (1.0 - _MEAN_DECAY**step)
                square = squares[number] / (1.0 - _SQUARE_DECAY**step)
                decay = weight_decay if parts[number].ndim == 2 else 0.0
                parts[number] -= rate * (mean / (np.sqrt(square) + _EPSILON) + decay * parts[number])
    return network


def slopes(network: Sequence[NetworkLayer], x: Floats, shares: Floats, weight: Floats) -> list[Floats]:
    """Differentiate the mean weighted cross-entropy by weights and constants of each layer, in order."""
    units = _activations(network, x)
    p = np.exp(units[-1] - units[-1].max(axis=1, keepdims=True))
    p /= p.sum(axis=1, keepdims=True)
    back = (p - shares) * (weight / np.float32(len(x)))[:, np.newaxis]
    found: list[Floats] = []
    for number in range(len(network) - 1, -1, -1):
        below = units[number]
        found = [below.T @ back, back.sum(axis=0), *found]
        if number:
            back = (back @ network[number].weights.T) * (1.0 - below * below)
    return found


def _activations(network: Sequence[NetworkLayer], x: Floats) -> list[Floats]:
    """Compute the inputs, the activations of each hidden layer, and the sums of the last."""
    units = [x]
    for number, layer in enumerate(network):
        sums = units[-1] @ layer.weights + layer.constants
        units.append(np.tanh(sums) if number < len(network) - 1 else sums)
    return units
