"""What a search leaves, against playing it out at random."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clearance.residual import (
    DOUBTFUL_SHARE,
    SHAPE,
    remaining_about,
    remaining_mines,
    sweep_width_m,
    without_contact,
)


@pytest.mark.parametrize("expected", [0.3, 4.0, 40.0])
def test_intervals_are_those_of_missions_played_out(expected: float) -> None:
    """A Poisson count about a mean that differs from mission to mission."""
    rng = np.random.Generator(np.random.PCG64(1))
    left = rng.poisson(rng.gamma(SHAPE, expected / SHAPE, 400_000))
    reported = remaining_about(expected)
    assert reported.p_none == pytest.approx((left == 0).mean(), abs=0.005)
    assert (left <= reported.at_most_95).mean() >= 0.95 - 0.002
    assert (left <= reported.at_most_95 - 1).mean() < 0.95 + 0.002
    assert ((left >= reported.low) & (left <= reported.high)).mean() >= 0.95 - 0.004
    assert (left > reported.high).mean() <= 0.025 + 0.002
    assert (left < reported.low).mean() <= 0.025 + 0.002


@given(p=st.floats(0.05, 0.98), more=st.floats(0.0, 1.0), doubtful=st.lists(st.floats(0.0, 0.2), max_size=30))
def test_a_better_search_and_fewer_doubts_leave_no_more(p: float, more: float, doubtful: list[float]) -> None:
    before = remaining_mines(doubtful, np.full(1000, p))
    after = remaining_mines(doubtful[1:], np.full(1000, p + more * (1.0 - p)))
    assert after.expected <= before.expected + 1e-12
    assert after.p_none >= before.p_none - 1e-12
    assert after.at_most_95 <= before.at_most_95


def test_contacts_that_are_not_called_stand_for_mines() -> None:
    """The estimate was the same for a floor that showed nine mines of ten and one that hid three of four: 14 left where
    1 was."""
    p = np.full(500, 0.6)
    clear, cluttered = (remaining_mines(np.full(n, 0.1), p) for n in (20, 200))
    assert clear.expected == pytest.approx(DOUBTFUL_SHARE * 2.0 + without_contact(0.6))
    assert cluttered.expected - clear.expected == pytest.approx(DOUBTFUL_SHARE * 18.0)


def test_a_whole_search_without_a_doubt_leaves_nothing() -> None:
    assert remaining_mines([], np.ones(500)) == (0.0, 0, 0, 0, 1.0)


def test_a_search_that_can_find_nothing_leaves_anything_possible() -> None:
    reported = remaining_mines([], np.zeros(100))
    assert math.isinf(reported.expected)
    assert reported.p_none == 0.0


def test_what_is_no_probability_is_refused() -> None:
    for doubtful, p in (([1.5], 0.5), ([math.nan], 0.5), ([0.1], 1.5), ([0.1], math.nan)):
        with pytest.raises(ValueError, match="outside 0 to 1"):
            remaining_mines(doubtful, np.full(3, p))


def test_sweep_width_is_the_integral_over_range() -> None:
    ground = np.linspace(0.0, 50.0, 501)
    assert sweep_width_m(ground, np.full(501, 0.8)) == pytest.approx(40.0)
    assert sweep_width_m(ground, 1.0 - ground / 50.0) == pytest.approx(25.0)
    with pytest.raises(ValueError, match="must rise"):
        sweep_width_m(ground[::-1], ground)
