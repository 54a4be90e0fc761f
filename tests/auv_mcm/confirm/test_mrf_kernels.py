"""The minimisers of a Potts energy against all labellings of tiny grids, and the C code against numpy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from auv_mcm import kernels
from auv_mcm.confirm.likelihoods import BackgroundLaw
from auv_mcm.confirm.mean_field import fit_means, fit_means_numpy, start_means
from auv_mcm.confirm.mrf_priors import PairPrior
from auv_mcm.kernels.mean_field import softmin, sweep, sweep_numpy
from auv_mcm.kernels.pair_costs import Lack
from auv_mcm.kernels.trws import energy_of, icm, icm_numpy, trws, trws_numpy

needs_c = pytest.mark.skipif(kernels.backend() != "c", reason=f"no C kernels: {kernels.loaded().reason}")

costs = st.integers(-6, 6).map(float) | st.floats(-20.0, 20.0)
weights = hnp.arrays(np.float64, (4,), elements=st.sampled_from([0.0, 0.5, 1.0, 2.0**-0.5, 3.0]))


def grids(rows: int, columns: int) -> st.SearchStrategy[NDArray[np.float64]]:
    return hnp.arrays(np.float64, st.tuples(st.integers(1, rows), st.integers(1, columns), st.just(3)), elements=costs)


def energy_by_definition(labels: NDArray[np.uint8], unary: NDArray[np.float64], weight: NDArray[np.float64]) -> float:
    n_rows, n_columns = labels.shape
    energy = 0.0
    for row, column in itertools.product(range(n_rows), range(n_columns)):
        energy += unary[row, column, labels[row, column]]
        for w, (down, right) in zip(weight, ((0, 1), (1, -1), (1, 0), (1, 1)), strict=True):
            if row + down < n_rows and 0 <= column + right < n_columns:
                energy += w * (labels[row, column] != labels[row + down, column + right])
    return energy


def minimum_energy(unary: NDArray[np.float64], weight: NDArray[np.float64]) -> float:
    n_rows, n_columns, _ = unary.shape
    every = np.array(list(itertools.product(range(3), repeat=n_rows * n_columns)), dtype=np.uint8).reshape(
        -1, n_rows, n_columns
    )
    energy = np.zeros(len(every))
    for row, column in itertools.product(range(n_rows), range(n_columns)):
        energy += unary[row, column][every[:, row, column]]
    for w, a, b in (
        (weight[0], every[:, :, 1:], every[:, :, :-1]),
        (weight[1], every[:, 1:, :-1], every[:, :-1, 1:]),
        (weight[2], every[:, 1:], every[:, :-1]),
        (weight[3], every[:, 1:, 1:], every[:, :-1, :-1]),
    ):
        energy += w * (a != b).sum(axis=(1, 2))
    return float(energy.min())


@given(unary=grids(6, 6), weight=weights, data=st.data())
@settings(deadline=None, max_examples=50)
def test_energy_is_the_sum_over_cells_and_edges(
    unary: NDArray[np.float64], weight: NDArray[np.float64], data: st.DataObject
) -> None:
    labels = data.draw(hnp.arrays(np.uint8, unary.shape[:2], elements=st.integers(0, 2)))
    assert energy_of(labels, unary, weight) == pytest.approx(energy_by_definition(labels, unary, weight), abs=1e-9)


@given(unary=grids(3, 3), weight=weights)
@settings(deadline=None, max_examples=60)
def test_bound_never_exceeds_the_least_energy_of_all_labellings(
    unary: NDArray[np.float64], weight: NDArray[np.float64]
) -> None:
    lowest = minimum_energy(unary, weight)
    minimum = trws(unary, weight, 30)
    assert (minimum.trace[:, 0] <= lowest + 1e-9).all()
    assert minimum.energy >= lowest - 1e-9
    assert minimum.energy == pytest.approx(energy_of(minimum.labels, unary, weight), abs=1e-9)


def test_finds_the_best_of_all_labellings_of_noisy_grids() -> None:
    random = np.random.Generator(np.random.PCG64(1))
    for _ in range(3):
        unary = random.exponential(1.0, (3, 4, 3))
        weight = np.array([0.4, 0.3, 0.4, 0.3])
        minimum = trws(unary, weight, 60)
        lowest = minimum_energy(unary, weight)
        assert minimum.lower_bound <= lowest + 1e-9
        assert minimum.energy == pytest.approx(lowest, rel=1e-3)


@given(unary=grids(1, 9) | grids(9, 1), weight=weights)
@settings(deadline=None, max_examples=60)
def test_chain_is_solved_exactly(unary: NDArray[np.float64], weight: NDArray[np.float64]) -> None:
    step = weight[0] if unary.shape[0] == 1 else weight[2]
    cost = np.zeros(3)
    for here in unary.reshape(-1, 3):  # the best path, by dynamic programming
        cost = np.minimum(cost, cost.min() + step) + here
    minimum = trws(unary, weight, 2)
    assert minimum.lower_bound == pytest.approx(cost.min(), abs=1e-9)
    assert minimum.energy == pytest.approx(cost.min(), abs=1e-9)


@given(unary=grids(7, 8), weight=weights)
@settings(deadline=None, max_examples=60)
def test_bound_rises_and_stays_below_every_energy(unary: NDArray[np.float64], weight: NDArray[np.float64]) -> None:
    bound, energy = trws(unary, weight, 12).trace.T
    slack = 1e-9 * (1.0 + np.abs(unary).sum())
    assert (np.diff(bound) >= -slack).all()
    assert bound.max() <= energy.min() + slack


@given(unary=grids(6, 6), weight=weights)
@settings(deadline=None, max_examples=40)
def test_bound_holds_from_messages_of_another_problem(unary: NDArray[np.float64], weight: NDArray[np.float64]) -> None:
    other = trws(unary[::-1, ::-1] * 3.0, weight, 3).messages
    warm, cold = trws(unary, weight, 20, messages=other), trws(unary, weight, 20)
    slack = 1e-9 * (1.0 + np.abs(unary).sum())
    assert max(warm.lower_bound, cold.lower_bound) <= min(warm.energy, cold.energy) + slack


@given(unary=grids(6, 6), weight=weights, data=st.data())
@settings(deadline=None, max_examples=40)
def test_icm_never_raises_the_energy_and_ends_where_no_single_change_helps(
    unary: NDArray[np.float64], weight: NDArray[np.float64], data: st.DataObject
) -> None:
    labels = data.draw(hnp.arrays(np.uint8, unary.shape[:2], elements=st.integers(0, 2)))
    energy = energy_of(labels, unary, weight)
    for _ in range(40):
        labels, _ = icm(unary, weight, labels, 1)
        lowered = energy_of(labels, unary, weight)
        assert lowered <= energy + 1e-9
        energy = lowered
    for row, column, label in itertools.product(*map(range, (*labels.shape, 3))):
        changed = labels.copy()
        changed[row, column] = label
        assert energy_of(changed, unary, weight) >= energy - 1e-9


@needs_c
@given(
    unary=grids(9, 10),
    weight=weights,
    n_sweeps=st.integers(1, 4),
    tolerance=st.sampled_from([0.0, 0.1]),
    warm=st.booleans(),
)
@settings(deadline=None, max_examples=60)
def test_c_and_numpy_agree_to_the_bit(
    unary: NDArray[np.float64], weight: NDArray[np.float64], n_sweeps: int, tolerance: float, warm: bool
) -> None:
    messages = trws(unary * 0.5, weight, 1).messages if warm else None
    fast = trws(unary, weight, n_sweeps, tolerance=tolerance, messages=messages)
    plain = trws_numpy(unary, weight, n_sweeps, tolerance=tolerance, messages=messages)
    for one, other in zip(fast, plain, strict=True):
        np.testing.assert_array_equal(one, other)
    start = unary.argmin(axis=2).astype(np.uint8)
    for sweeps in (1, 8):
        labels, done = icm(unary, weight, start, sweeps)
        labels_numpy, done_numpy = icm_numpy(unary, weight, start, sweeps)
        np.testing.assert_array_equal(labels, labels_numpy, strict=True)
        assert done == done_numpy


def test_equal_costs_give_the_smaller_label() -> None:
    for cost in (1.0, 1e308):  # of an infinite sum
        assert np.full((4, 5), 255, dtype=np.uint8).all()  # in memory that the labels may then lie in
        assert not trws(np.full((4, 5, 3), cost), np.ones(4), 2).labels.any()


@pytest.mark.parametrize(
    ("unary", "weight", "n_sweeps"),
    [
        (np.zeros((3, 3, 2)), np.ones(4), 1),
        (np.zeros((0, 3, 3)), np.ones(4), 1),
        (np.full((2, 2, 3), np.nan), np.ones(4), 1),
        (np.zeros((2, 2, 3)), np.array([1.0, -1.0, 1.0, 1.0]), 1),
        (np.zeros((2, 2, 3)), np.ones(3), 1),
        (np.zeros((2, 2, 3)), np.ones(4), 0),
    ],
)
def test_what_is_no_energy_is_refused(unary: NDArray[np.float64], weight: NDArray[np.float64], n_sweeps: int) -> None:
    with pytest.raises(ValueError, match=r"must|holds"):
        trws(unary, weight, n_sweeps)
    with pytest.raises(ValueError, match=r"must|holds"):
        icm(unary, weight, np.zeros(unary.shape[:2], dtype=np.uint8), n_sweeps)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (6, 1), (9, 14)])
def test_c_sweeps_the_mean_field_as_numpy_does(shape: tuple[int, int]) -> None:
    random = np.random.Generator(np.random.PCG64(4))
    cost, weight = random.exponential(4.0, (3, *shape)), np.array([1.0, 0.7, 1.3, 0.7])
    start = softmin(random.exponential(1.0, (3, *shape)))
    found = sweep(cost, weight, 3, start)
    np.testing.assert_allclose(found, sweep_numpy(cost, weight, 3, start), rtol=1e-12, atol=1e-300)
    np.testing.assert_allclose(found.sum(axis=0), 1.0, rtol=1e-12)


@needs_c
@given(
    shape=st.tuples(st.integers(1, 12), st.integers(1, 14)),
    looks=st.floats(0.5, 8.0),
    level=st.floats(0.2, 5.0),
    dark=st.floats(0.0, 0.4),
    seed=st.integers(0, 2**32 - 1),
)
@settings(deadline=None, max_examples=40)
def test_means_in_context_are_those_of_the_twin(
    shape: tuple[int, int], looks: float, level: float, dark: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    scale = random.choice([level, 0.05, 9.0], shape, p=(0.9 - dark, dark, 0.1))
    blocks = np.clip(random.gamma(looks, scale / looks, shape), 1e-6, 1e6)
    samples = random.choice([0.0, 0.6, 2.5], shape)
    prior = PairPrior(random.integers(0, shape[1] + 1, shape[1]), 3, Lack(2.0, 0.4), Lack(0.5, 0.9), 0.0)
    given = blocks, samples, samples / looks, start_means(level), BackgroundLaw(looks, np.inf), np.full(4, 0.6), prior
    (means, probability), (expected, of_twin) = fit_means(*given), fit_means_numpy(*given)
    np.testing.assert_allclose(means, expected, rtol=1e-9)
    np.testing.assert_allclose(probability, of_twin, atol=1e-9)
