"""The network that weighs textures: its slopes, what it can learn, and that it comes out the same."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from sim_replay.fitting.seabed.network import NetworkLayer, fitted_network, log_odds, slopes

Floats = NDArray[np.float32]


def crossed(n: int, seed: int) -> tuple[Floats, Floats]:
    """Two kinds that no straight border parts: the signs of two inputs agree or not."""
    rng = np.random.Generator(np.random.PCG64(seed))
    x = rng.uniform(-1.0, 1.0, (n, 2)).astype(np.float32)
    kind = (x[:, 0] * x[:, 1] > 0.0).astype(int)
    return x, np.eye(2, dtype=np.float32)[kind]


def fitted(seed: int = 1) -> list[NetworkLayer]:
    x, shares = crossed(20_000, 2)
    return fitted_network(
        x, shares, np.ones(len(x), dtype=np.float32), n_hidden=(16, 8), epochs=60, weight_decay=0.01, seed=seed
    )


def test_a_border_that_is_not_straight_is_learnt() -> None:
    x, shares = crossed(2000, 3)
    assert (log_odds(fitted(), x).argmax(axis=1) == shares.argmax(axis=1)).mean() > 0.93


def test_the_same_seed_makes_the_same_network() -> None:
    for one, again in zip(fitted(), fitted(), strict=True):
        assert np.array_equal(one.weights, again.weights)
        assert np.array_equal(one.constants, again.constants)


def test_slopes_are_those_of_the_cross_entropy() -> None:
    rng = np.random.Generator(np.random.PCG64(4))
    sizes = (3, 4, 2)
    network = [
        NetworkLayer(rng.normal(size=(before, after)), rng.normal(size=after)) for before, after in pairwise(sizes)
    ]
    x, weight = rng.normal(size=(7, 3)), rng.uniform(0.5, 2.0, 7)
    shares = rng.dirichlet((1.0, 1.0), 7)

    def loss() -> float:
        odds = log_odds(network, x)
        return float(
            (weight * -(shares * (odds - np.logaddexp.reduce(odds, axis=1, keepdims=True))).sum(axis=1)).mean()
        )

    found = slopes(network, x, shares, weight)
    parts = [part for units in network for part in units]
    for slope, part in zip(found, parts, strict=True):
        for place in np.ndindex(part.shape):
            before = part[place]
            part[place] = before + 1e-6
            above = loss()
            part[place] = before - 1e-6
            below = loss()
            part[place] = before
            assert slope[place] == pytest.approx((above - below) / 2e-6, abs=1e-6)
