from __future__ import annotations

from fractions import Fraction
from itertools import islice

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.detect.cascade.model import SCORE_UNIT
from sim_replay.fitting.cascade.boost import N_BINS, BoostedStump, gentle_split, gentle_stumps, histograms
from tests.make.random_numbers import generator


def _slow_gentle_split(bins: np.ndarray, is_target: np.ndarray, weight: np.ndarray) -> tuple[Fraction, int, int] | None:
    """Least squared error plus ridge over every feature and bin, sample by sample in exact fractions."""
    total = Fraction(int(weight.sum()))
    best = None
    for feature in range(len(bins)):
        for last_below in range(N_BINS - 1):
            gain, sides = Fraction(0), 0
            for side in (bins[feature] <= last_below, bins[feature] > last_below):
                held = Fraction(int(weight[side].sum()))
                signed = Fraction(int(np.where(is_target, weight, -weight)[side].sum()))
                sides += held > 0
                gain += signed**2 / (held + Fraction(1, 1000) * total)
            if sides == 2 and (best is None or gain > best[0]):
                best = gain, feature, last_below
    return best


@st.composite
def samples(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n_features, n_samples = draw(st.integers(1, 4)), draw(st.integers(2, 12))
    rng = generator(draw(st.integers(0, 2**32 - 1)))
    levels = draw(st.sampled_from([1, 2, 5, 256]))
    bins = rng.integers(0, levels, (n_features, n_samples)).astype(np.uint8)
    return bins, rng.random(n_samples) < 0.4, rng.integers(1, 1000, n_samples).astype(np.float64)


def _histograms(bins: np.ndarray, is_target: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    every = np.arange(len(bins))
    target, other = np.flatnonzero(is_target), np.flatnonzero(~is_target)
    return histograms(bins, every, target, weight[target]), histograms(bins, every, other, weight[other])


@settings(max_examples=40, deadline=None)
@given(samples())
def test_best_split_is_that_of_brute_force(case: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    expected = _slow_gentle_split(*case)
    found = gentle_split(*_histograms(*case))
    if expected is None:
        assert found is None
        return
    assert found is not None
    assert found.gain == pytest.approx(float(expected[0]), rel=1e-9)


def test_of_equal_splits_the_first_feature_and_the_lowest_bin_win() -> None:
    bins = np.array([[5, 5, 9, 9], [5, 5, 9, 9]], dtype=np.uint8)
    is_target = np.array([True, True, False, False])
    found = gentle_split(*_histograms(bins, is_target, np.ones(4)))
    assert found is not None
    assert (found.feature, found.last_below) == (0, 5)


def _scores(stumps: list[BoostedStump], bins: np.ndarray) -> np.ndarray:
    return sum((stump.scores(bins) for stump in stumps), np.zeros(bins.shape[1], dtype=np.int32))


def test_a_sum_of_stumps_learns_what_no_stump_separates_alone() -> None:
    rng = generator(3)
    values = rng.integers(0, 256, (20, 2000)).astype(np.uint8)
    is_target = values[:5].astype(int).sum(axis=0) > 750
    stumps = list(gentle_stumps(values, is_target, 60, 1.0, generator(1)))
    assert {stump.feature for stump in stumps[:5]} <= set(range(5))
    assert np.mean((_scores(stumps, values) > 0) == is_target) > 0.93


def test_a_costly_miss_moves_the_balance_towards_targets() -> None:
    rng = generator(5)
    is_target = rng.random(3000) < 0.3
    bins = np.clip(rng.normal(110, 30, (6, 3000)) + 25 * is_target, 0, 255).astype(np.uint8)
    even, costly = (_scores(list(gentle_stumps(bins, is_target, 40, k, generator())), bins) > 0 for k in (1.0, 20.0))
    assert costly[is_target].mean() > even[is_target].mean()


def test_same_seed_gives_the_same_stumps_and_a_prefix_is_a_shorter_training() -> None:
    rng = generator(8)
    bins = rng.integers(0, 256, (700, 300)).astype(np.uint8)
    is_target = bins[600] > 100
    first, second = (list(islice(gentle_stumps(bins, is_target, 20, 2.0, generator(4)), 8)) for _ in range(2))
    assert first == second
    assert first != list(islice(gentle_stumps(bins, is_target, 20, 2.0, generator(5)), 8))


class TestWhatBoostingMustSurvive:
    def test_features_that_never_vary(self) -> None:
        assert list(gentle_stumps(np.full((5, 40), 7, dtype=np.uint8), np.arange(40) < 4, 10, 3.0, generator())) == []

    def test_a_feature_that_is_not_a_number_is_never_chosen(self) -> None:
        bins = generator(2).integers(0, 200, (3, 200)).astype(np.uint8)
        bins[1] = N_BINS - 1  # where quantising puts what is not a number
        stumps = list(gentle_stumps(bins, bins[0] > 50, 20, 1.0, generator()))
        assert stumps
        assert all(stump.feature != 1 for stump in stumps)

    def test_separable_samples(self) -> None:
        bins = np.arange(200, dtype=np.uint8)[np.newaxis]
        stumps = list(gentle_stumps(bins, bins[0] >= 150, 300, 10.0, generator()))
        assert all(abs(leaf) <= 4 * SCORE_UNIT for stump in stumps for leaf in (stump.below, stump.above))
        assert ((_scores(stumps, bins) > 0) == (bins[0] >= 150)).all()

    def test_one_target(self) -> None:
        bins = generator(6).integers(0, 200, (30, 1000)).astype(np.uint8)
        bins[11, 0] = 250
        stumps = list(gentle_stumps(bins, np.arange(1000) == 0, 50, 5.0, generator()))
        assert _scores(stumps, bins).argmax() == 0

    def test_samples_given_twice_count_twice_and_change_nothing_if_all_are(self) -> None:
        bins = generator(7).integers(0, 256, (10, 64)).astype(np.uint8)
        is_target = bins[2] > 128
        once = list(gentle_stumps(bins, is_target, 6, 1.0, generator()))
        twice = list(gentle_stumps(np.tile(bins, 2), np.tile(is_target, 2), 6, 1.0, generator()))
        assert [s.feature for s in once] == [s.feature for s in twice]

    def test_a_class_without_samples_is_refused(self) -> None:
        with pytest.raises(ValueError, match="0 targets among 5"):
            list(gentle_stumps(np.zeros((1, 5), dtype=np.uint8), np.zeros(5, dtype=np.bool_), 3, 1.0, generator()))
