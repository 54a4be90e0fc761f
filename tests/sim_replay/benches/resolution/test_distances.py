"""Distances between pictures guarantee what an observer mistakes: against quadrature, and against drawn speckle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.integrate import quad
from scipy.stats import gamma

from sim_replay.benches.resolution.distances import CHANCE_NATS, FOUND_NATS, coarser, distance_nats

MEANS = hnp.arrays(np.float64, (6, 8), elements=st.floats(0.01, 100.0))


@pytest.mark.parametrize(("one", "other", "looks"), [(1.0, 1.0, 1), (1.0, 3.0, 1), (0.05, 1.0, 1), (1.0, 7.0, 4)])
def test_a_pixel_is_as_far_as_the_overlap_of_its_densities(one: float, other: float, looks: int) -> None:
    laws = [gamma(looks, scale=mean / looks) for mean in (one, other)]
    overlap, _ = quad(lambda x: np.sqrt(laws[0].pdf(x) * laws[1].pdf(x)), 0.0, 60.0 * max(one, other), limit=200)
    assert float(distance_nats([[one]], [[other]], looks)) == pytest.approx(-np.log(overlap), abs=1e-6)


def test_the_likelihood_ratio_of_drawn_speckle_errs_less_than_guaranteed() -> None:
    random = np.random.default_rng(2)
    one, other = np.ones((4, 5)), np.ones((4, 5))
    one[1:3, 1:4], other[1:3, 2:5] = 0.5, 1.6
    at_most = 0.5 * np.exp(-float(distance_nats(one, other)))
    wrong = 0
    for is_one in (True, False):
        drawn = random.exponential(one if is_one else other, (4000, 4, 5))
        for_one = (np.log(other / one) + drawn * (1.0 / other - 1.0 / one)).sum(axis=(1, 2))
        wrong += int(np.count_nonzero((for_one > 0.0) != is_one))
    assert 0.0 < wrong / 8000 < at_most


def test_what_is_found_is_missed_as_seldom_as_guaranteed_at_the_threshold_of_chance() -> None:
    random = np.random.default_rng(3)
    n = 60
    shadow = np.full((1, n), 0.2)
    floor = np.ones((1, n))
    per_pixel = float(distance_nats(shadow, floor)) / n
    n_pixels = int(np.ceil(FOUND_NATS / per_pixel))
    drawn = random.exponential(0.2, (4000, n_pixels))
    ratio = (np.log(1.0 / 0.2) + drawn * (1.0 - 1.0 / 0.2)).sum(axis=1)
    assert np.mean(ratio < CHANCE_NATS) <= 0.05


@given(MEANS, MEANS)
def test_a_coarser_pixel_never_separates_more_and_looks_count_as_pictures(
    one: np.ndarray[tuple[int, int], np.dtype[np.float64]], other: np.ndarray[tuple[int, int], np.dtype[np.float64]]
) -> None:
    fine = float(distance_nats(one, other))
    assert float(distance_nats(coarser(one, 2), coarser(other, 2))) <= fine * (1.0 + 1e-9) + 1e-12
    assert float(distance_nats(one, other, 4)) == pytest.approx(4.0 * fine)
    assert float(distance_nats(other, one)) == pytest.approx(fine)


def test_pictures_are_averaged_over_whole_pixels() -> None:
    fine = np.arange(5.0 * 7.0).reshape(5, 7)
    assert coarser(fine, 2).tolist() == [
        [fine[2 * row : 2 * row + 2, 2 * column : 2 * column + 2].mean() for column in range(3)] for row in range(2)
    ]
