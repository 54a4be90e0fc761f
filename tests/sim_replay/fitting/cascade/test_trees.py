"""Boosted trees: against one grown by trying every question, and what they must learn and must not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.fitting.cascade import trees
from sim_replay.fitting.cascade.trees import N_LEAVES, GrownTree, boost, leaves
from tests.make.random_numbers import generator

Array = NDArray[np.float64]


def walked(tree: GrownTree, row: Array) -> int:
    """Leaf of one row, question by question."""
    place = 0 if len(tree.feature) else -1
    while place >= 0:
        no, yes = tree.leads[place].tolist()
        place = yes if row[tree.feature[place]] > tree.threshold[place] else no
    return -1 - place


def log_loss(odds: Array, is_target: NDArray[np.bool_], weight: Array) -> float:
    return float(weight @ (np.logaddexp(0.0, odds) - is_target * odds) / weight.sum())


def boosted(trees: list[GrownTree], values: Array, start: Array) -> Array:
    return start + sum((tree.nats[leaves(tree, values)] for tree in trees), np.zeros(len(values)))


def bump(n: int, seed: int) -> tuple[Array, NDArray[np.bool_]]:
    """Targets where one feature is middling and another high: no sum of them separates, splits do. Two more features
    are noise.
    """
    random = generator(seed)
    values = random.normal(0.0, 1.0, (n, 4))
    p = np.where((np.abs(values[:, 0]) < 0.7) & (values[:, 1] > 0.0), 0.9, 0.1)
    return values, random.random(n) < p


@pytest.mark.parametrize("seed", range(4))
def test_rows_reach_the_leaves_that_questions_lead_them_to(seed: int) -> None:
    values, is_target = bump(400, seed)
    for tree in boost(values, is_target, np.ones(400), np.zeros(400), 5):
        assert leaves(tree, values).tolist() == [walked(tree, row) for row in values]


def best_parting(values: Array, gradient: Array, hessian: Array) -> tuple[float, int, float]:
    """Gain, feature and threshold of the best parting, by trying every one."""

    def worth(chosen: NDArray[np.bool_]) -> float:
        return float(gradient[chosen].sum() ** 2 / (hessian[chosen].sum() + trees._RIDGE))

    found = (0.0, -1, 0.0)
    for column, some in enumerate(values.T):
        for threshold in np.unique(some)[:-1].tolist():
            above = some > threshold
            if min(hessian[above].sum(), hessian[~above].sum()) < trees._MIN_HESSIAN:
                continue
            gain = worth(above) + worth(~above) - worth(np.ones(len(some), dtype=np.bool_))
            if gain > found[0] + 1e-9:
                found = (gain, column, threshold)
    return found


def test_the_leaf_that_gains_most_is_parted_next_and_as_well_as_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every example and feature is seen, and values are so few that each is a threshold."""
    monkeypatch.setattr(trees, "_EXAMPLES", 1.1)
    monkeypatch.setattr(trees, "_FEATURES", 1.0)
    values, is_target = bump(300, 7)
    values = values.round(1).clip(-2.0, 2.0)
    (tree,) = boost(values, is_target, np.ones(300), np.zeros(300), 1)
    gradient, hessian = is_target.astype(np.float64) - 0.5, np.full(300, 0.25)
    open_leaves = [(np.ones(300, dtype=np.bool_))]
    for feature, threshold in zip(tree.feature.tolist(), tree.threshold.tolist(), strict=True):
        partings = [best_parting(values[rows], gradient[rows], hessian[rows]) for rows in open_leaves]
        at = max(range(len(partings)), key=lambda place: partings[place][0])
        assert partings[at][1:] == (feature, threshold)
        above = values[:, feature] > threshold
        open_leaves[at : at + 1] = [open_leaves[at] & ~above, open_leaves[at] & above]
    assert len(open_leaves) <= N_LEAVES
    reached = leaves(tree, values)
    for number, rows in enumerate(open_leaves):
        assert (reached[rows] == number).all()
        assert tree.nats[number] == pytest.approx(
            trees._RATE * gradient[rows].sum() / (hessian[rows].sum() + trees._RIDGE)
        )


def test_what_no_sum_separates_is_learnt() -> None:
    values, is_target = bump(3000, 1)
    weight, start = np.ones(3000), np.zeros(3000)
    trees = boost(values, is_target, weight, start, 200)
    fresh, truth = bump(3000, 2)
    odds = boosted(trees, fresh, start)
    assert ((odds > 0.0) == truth).mean() > 0.87, "0.9 is all there is to know"
    assert log_loss(odds, truth, weight) < 0.36 < log_loss(start, truth, weight)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_every_tree_lowers_the_loss_that_it_is_grown_on(seed: int) -> None:
    values, is_target = bump(400, seed)
    weight = generator(seed).choice([1.0, 4.0], 400)
    start = np.full(400, -1.0)
    trees = boost(values, is_target, weight, start, 12)
    losses = [log_loss(boosted(trees[:n], values, start), is_target, weight) for n in (0, 4, 8, 12)]
    assert losses == sorted(losses, reverse=True)


def test_what_is_known_already_is_not_learnt_again() -> None:
    random = generator(3)
    values = random.normal(0.0, 1.0, (4000, 2))
    known = 2.0 * values[:, 0]
    is_target = random.random(4000) < 1.0 / (1.0 + np.exp(-known))
    trees = boost(values, is_target, np.ones(4000), known, 40)
    assert np.abs(boosted(trees, values, known) - known).mean() < 0.25


def test_noise_teaches_little() -> None:
    random = generator(4)
    values, is_target = random.normal(0.0, 1.0, (4000, 6)), random.random(4000) < 0.3
    start = np.full(4000, np.log(0.3 / 0.7))
    odds = boosted(boost(values, is_target, np.ones(4000), start, 40), random.normal(0.0, 1.0, (4000, 6)), start)
    assert np.abs(odds - start).mean() < 0.25


def test_units_of_a_feature_change_nothing_but_thresholds() -> None:
    values, is_target = bump(500, 5)
    weight, start = np.ones(500), np.zeros(500)
    plain = boost(values, is_target, weight, start, 10)
    scaled = boost(np.exp(0.5 * values), is_target, weight, start, 10)
    for one, other in zip(plain, scaled, strict=True):
        assert one.feature.tolist() == other.feature.tolist()
        np.testing.assert_allclose(one.nats, other.nats, atol=1e-12)


@pytest.mark.parametrize("value", [0.0, -3.5, 1e9])
def test_features_that_never_vary_leave_only_the_constant_to_learn(value: float) -> None:
    trees = boost(np.full((50, 2), value), np.arange(50) < 10, np.ones(50), np.zeros(50), 5)
    for tree in trees:
        assert set(leaves(tree, np.full((1, 2), value)).tolist()) == {0}
        assert tree.nats[0] < 0.0, "fewer than half are targets"
        assert len(tree.nats) == 1


def test_the_same_examples_give_the_same_trees() -> None:
    values, is_target = bump(300, 6)
    once, again = (boost(values, is_target, np.ones(300), np.zeros(300), 8) for _ in range(2))
    for one, other in zip(once, again, strict=True):
        assert all(np.array_equal(mine, its) for mine, its in zip(one, other, strict=True))
