"""Borders under a point spread: the cost written out, and every border moved to where smearing started from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm import kernels
from auv_mcm.confirm.region import BACKGROUND, SHADOW
from auv_mcm.kernels.soft_edges import point_spread, smeared, smeared_numpy, soft_edges, soft_edges_numpy
from auv_mcm.kernels.trws import energy_of

needs_c = pytest.mark.skipif(kernels.backend() != "c", reason=f"no C kernels: {kernels.loaded().reason}")

LEVEL = np.array([1.0, 0.126, 8.0])
WEIGHT = np.array([0.3, 0.2, 0.25, 0.2])
INFORMATION = 0.2


def cost(
    labels: NDArray[np.uint8],
    start: NDArray[np.uint8],
    intensity: NDArray[np.float64],
    usable: NDArray[np.bool_],
    spreads: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> float:
    """As defined; what is beyond the grid is as it was at the start."""
    mean = smeared(LEVEL[start], *spreads)
    spread = np.outer(*spreads)
    reach_rows, reach_columns = spread.shape[0] // 2, spread.shape[1] // 2
    for row, column in zip(*np.nonzero(labels != start), strict=True):
        step = LEVEL[labels[row, column]] - LEVEL[start[row, column]]
        for a, b in np.ndindex(spread.shape):
            r, c = row + a - reach_rows, column + b - reach_columns
            if 0 <= r < mean.shape[0] and 0 <= c < mean.shape[1]:
                mean[r, c] += step * spread[a, b]
    data = np.where(usable, np.log(mean) + intensity / mean, 0.0).sum()
    return float(INFORMATION * data + energy_of(labels, np.zeros((*labels.shape, 3)), WEIGHT))


def noisy(seed: int, n_rows: int, n_columns: int) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.uint8]]:
    random = np.random.Generator(np.random.PCG64(seed))
    labels = random.integers(0, 3, (-(-n_rows // 3), -(-n_columns // 3))).astype(np.uint8)
    labels = np.kron(labels, np.ones((3, 3), dtype=np.uint8))[:n_rows, :n_columns]
    return random.exponential(LEVEL[labels]), random.random(labels.shape) < 0.9, labels


@pytest.mark.parametrize("seed", range(4))
def test_ends_where_no_single_change_of_a_border_pixel_lowers_the_cost(seed: int) -> None:
    intensity, usable, start = noisy(seed, 8, 9)
    spreads = point_spread(0.9), point_spread(0.6)
    labels = soft_edges(
        intensity, usable, start, level=LEVEL, spread_rows=spreads[0], spread_columns=spreads[1], weight=WEIGHT,
        information=INFORMATION, n_sweeps=50,
    )  # fmt: skip
    reached = cost(labels, start, intensity, usable, spreads)
    assert reached <= cost(start, start, intensity, usable, spreads) + 1e-9
    for row, column in np.ndindex(labels.shape):
        around = labels[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2]
        for label in np.unique(around):
            changed = labels.copy()
            changed[row, column] = label
            assert cost(changed, start, intensity, usable, spreads) >= reached - 1e-9


@needs_c
@given(
    seed=st.integers(0, 2**32),
    shape=st.tuples(st.integers(1, 12), st.integers(1, 12)),
    sigmas=st.tuples(*[st.sampled_from([0.0, 0.7, 1.3])] * 2),
)
@settings(deadline=None, max_examples=40)
def test_c_and_numpy_agree_to_the_bit(seed: int, shape: tuple[int, int], sigmas: tuple[float, float]) -> None:
    intensity, usable, start = noisy(seed, *shape)
    results = [
        function(
            intensity,
            usable,
            start,
            level=LEVEL,
            spread_rows=point_spread(sigmas[0]),
            spread_columns=point_spread(sigmas[1]),
            weight=WEIGHT,
            information=INFORMATION,
            n_sweeps=3,
        )
        for function in (soft_edges, soft_edges_numpy)
    ]
    np.testing.assert_array_equal(results[0], results[1], strict=True)


@pytest.mark.parametrize("grown", [-2, 0, 2])
def test_border_goes_where_smearing_started_from(grown: int) -> None:
    truth = np.full((40, 50), BACKGROUND, dtype=np.uint8)
    truth[10:30, 12:40] = SHADOW
    start = np.full((40, 50), BACKGROUND, dtype=np.uint8)
    start[10 - grown : 30 + grown, 12 - grown : 40 + grown] = SHADOW
    spread, none = point_spread(1.0), point_spread(0.0)
    intensity = smeared(LEVEL[truth], spread, spread)  # without speckle
    usable = np.ones(truth.shape, dtype=np.bool_)
    found = [
        soft_edges(
            intensity, usable, start, level=LEVEL, spread_rows=kernel, spread_columns=kernel, weight=np.full(4, 1e-3),
            information=INFORMATION, n_sweeps=50,
        )
        for kernel in (spread, none)
    ]  # fmt: skip
    assert (found[0] != truth).sum() <= 4  # at corners
    assert (found[1] == SHADOW).sum() < 0.92 * (truth == SHADOW).sum()


def test_what_does_not_fit_is_refused() -> None:
    intensity, usable, start = noisy(1, 6, 6)
    one = point_spread(0.0)
    for wrong in (
        {"labels": start[:5]},
        {"labels": start + np.uint8(3)},
        {"level": np.array([1.0, 0.0, 2.0])},
        {"spread_rows": np.ones(2)},
        {"weight": np.ones(3)},
    ):
        right = {"labels": start, "level": LEVEL, "spread_rows": one, "spread_columns": one, "weight": WEIGHT}
        with pytest.raises(ValueError, match="must"):
            soft_edges(intensity, usable, information=1.0, n_sweeps=1, **(right | wrong))


@pytest.mark.parametrize("shape", [(1, 1), (2, 9), (11, 3), (20, 31)])
@pytest.mark.parametrize("sigmas", [(0.0, 0.0), (0.7, 1.3), (2.0, 0.0)])
def test_c_smears_as_numpy_does_to_the_last_bit(shape: tuple[int, int], sigmas: tuple[float, float]) -> None:
    plane = np.random.Generator(np.random.PCG64(3)).exponential(1.0, shape)
    spreads = [point_spread(sigma) for sigma in sigmas]
    np.testing.assert_array_equal(smeared(plane, *spreads), smeared_numpy(plane, *spreads))
