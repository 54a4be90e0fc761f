"""Intervals against published values, and their coverage by summing over every outcome."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import gammaln, pdtr

from sim_replay.scoring.intervals import density, poisson_interval, proportion, wilson_interval


@pytest.mark.parametrize(
    ("count", "of", "low", "high"), [(190, 200, 0.910, 0.973), (950, 1000, 0.935, 0.962), (0, 10, 0.0, 0.278)]
)
def test_wilson_gives_published_bounds(count: int, of: int, low: float, high: float) -> None:
    assert wilson_interval(count, of) == pytest.approx((low, high), abs=6e-4)


@pytest.mark.parametrize(("count", "low", "high"), [(0, 0.0, 3.69), (10, 4.80, 18.4), (100, 81.4, 121.6)])
def test_garwood_gives_published_bounds(count: int, low: float, high: float) -> None:
    assert poisson_interval(count) == pytest.approx((low, high), rel=3e-3)


@pytest.mark.parametrize("of", [10, 30, 100])
def test_wilson_covers_95_percent_on_average_and_never_much_less(of: int) -> None:
    chances = np.linspace(0.0005, 0.9995, 1000)[:, None]
    counts = np.arange(of + 1.0)
    low, high = wilson_interval(counts, of)
    log_ways = gammaln(of + 1.0) - gammaln(counts + 1.0) - gammaln(of - counts + 1.0)
    weight = np.exp(log_ways + counts * np.log(chances) + (of - counts) * np.log1p(-chances))
    coverage = np.sum(weight * ((low <= chances) & (chances <= high)), axis=1)
    assert coverage.mean() == pytest.approx(0.95, abs=0.01)
    assert coverage.min() > 0.82


def test_garwood_covers_at_least_95_percent_whatever_the_mean() -> None:
    means = np.linspace(0.01, 60.0, 2000)[:, None]
    counts = np.arange(200.0)
    low, high = poisson_interval(counts)
    weight = np.exp(counts * np.log(means) - means - gammaln(counts + 1.0))
    coverage = np.sum(weight * ((low <= means) & (means <= high)), axis=1)
    assert coverage.min() >= 0.95
    assert coverage.mean() < 0.98


@given(count=st.integers(1, 2000))
def test_garwood_bounds_leave_two_and_a_half_percent_on_either_side(count: int) -> None:
    low, high = (float(bound) for bound in poisson_interval(count))
    assert 1.0 - pdtr(count - 1.0, low) == pytest.approx(0.025, rel=1e-6)
    assert pdtr(count, high) == pytest.approx(0.025, rel=1e-6)


@given(of=st.integers(1, 5000), data=st.data())
def test_wilson_bounds_enclose_the_share_and_mirror(of: int, data: st.DataObject) -> None:
    count = data.draw(st.integers(0, of))
    low, high = (float(bound) for bound in wilson_interval(count, of))
    assert 0.0 <= low <= count / of <= high <= 1.0
    other_low, other_high = (float(bound) for bound in wilson_interval(of - count, of))
    assert (1.0 - other_high, 1.0 - other_low) == pytest.approx((low, high), abs=1e-12)


def test_wilson_is_where_the_score_test_just_rejects() -> None:
    for bound in wilson_interval(17, 40):
        assert abs(17 / 40 - bound) / np.sqrt(bound * (1.0 - bound) / 40) == pytest.approx(1.959964, rel=1e-6)


def test_no_trials_and_no_area_claim_nothing_and_bounds_are_over_the_area() -> None:
    nothing = proportion(0, 0)
    assert (nothing.value, nothing.low, nothing.high) == (None, 0.0, 1.0)
    assert density(3, None).per_km2 is None
    found = density(10, 2.0)
    assert (found.low, found.per_km2, found.high) == pytest.approx((4.80 / 2.0, 5.0, 18.4 / 2.0), rel=3e-3)
