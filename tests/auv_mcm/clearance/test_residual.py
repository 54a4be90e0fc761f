"""What a search leaves, against playing it out at random, and against the truth of short missions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clearance.residual import (
    PRIOR_CONTACTS,
    PRIOR_SHARE,
    SHAPE,
    own_odds,
    remaining_about,
    remaining_mines,
    without_contact,
)
from tests.golden.answers import read_stored, scene_names


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
def test_a_better_search_leaves_no_more(p: float, more: float, doubtful: list[float]) -> None:
    before, after = (remaining_mines(doubtful, np.zeros(len(doubtful)), each) for each in (p, p + more * (1.0 - p)))
    assert after.expected <= before.expected + 1e-12
    assert after.p_none >= before.p_none - 1e-12
    assert after.at_most_95 <= before.at_most_95


@given(st.lists(st.floats(0.02, 1.0), max_size=40))
def test_the_share_of_mines_is_the_likeliest_under_the_prior(p_mine: list[float]) -> None:
    """Searched for on a grid, with the likelihood written out."""
    share = np.linspace(1e-4, 1.0 - 1e-4, 9999)
    p = np.array(p_mine).reshape(-1, 1)
    mixture = p * share / PRIOR_SHARE + (1.0 - p) * (1.0 - share) / (1.0 - PRIOR_SHARE)
    prior = PRIOR_CONTACTS * (PRIOR_SHARE * np.log(share) + (1.0 - PRIOR_SHARE) * np.log1p(-share))
    best = share[np.argmax(np.log(mixture).sum(axis=0) + prior)]
    assert own_odds(p_mine)[1] == pytest.approx(best, abs=3e-4)


def test_contacts_that_are_as_presumed_keep_their_odds() -> None:
    for p_mine in (np.array([1.0] * 2 + [0.0] * 8), np.full(50, PRIOR_SHARE)):
        own, share = own_odds(p_mine)
        assert share == pytest.approx(PRIOR_SHARE)
        assert own == pytest.approx(p_mine)


def test_contacts_that_are_not_mine_like_stand_for_mines_and_others_do_not() -> None:
    """The estimate was the same for a floor that showed nine mines of ten and one that hid three of four: 14 left where
    1 was; and nine were expected where one in five of the usual mines lay."""
    p_mine = np.array([0.9] * 6 + [0.1] * 20 + [0.01] * 100)
    left = remaining_mines(p_mine, p_mine >= 0.2, np.full(9, 0.6))
    own, share = own_odds(p_mine[:26])
    assert left.expected == pytest.approx(float(own[6:].sum()) + without_contact(0.6))
    assert left.share == share
    bare = remaining_mines(p_mine[6:], p_mine[6:] >= 0.2, np.full(9, 0.6))
    assert bare.share < 0.7 * left.share
    assert bare.expected < 0.8 * left.expected


def test_as_many_mines_are_expected_as_short_missions_of_the_scenes_leave() -> None:
    """Holds what p_mine presumes: with half as much again, or two thirds, the sum is outside."""
    stored = [answer for name in scene_names() if (answer := read_stored(f"scene-{name}")) is not None]
    reported = [np.array([contact["p_mine"] for contact in answer["contacts"]]) for answer in stored]
    among = sum(remaining_mines(p_mine, p_mine >= 0.2, 1.0).expected for p_mine in reported)
    seen, found = (sum(answer["totals"][name] for answer in stored) for name in ("targets_seen", "targets_found"))
    left = seen - found
    assert seen >= 50
    assert 0.95 * left <= among <= 1.5 * left, "those without a contact are among what was left"


def test_a_whole_search_without_a_doubt_leaves_nothing() -> None:
    assert remaining_mines([], [], np.ones(500))[:5] == (0.0, 0, 0, 0, 1.0)


def test_a_search_that_can_find_nothing_leaves_anything_possible() -> None:
    reported = remaining_mines([], [], np.zeros(100))
    assert math.isinf(reported.expected)
    assert reported.p_none == 0.0


def test_what_is_no_probability_is_refused() -> None:
    for doubtful, p in (([1.5], 0.5), ([math.nan], 0.5), ([0.1], 1.5), ([0.1], math.nan)):
        with pytest.raises(ValueError, match="outside 0 to 1"):
            remaining_mines(doubtful, [False], np.full(3, p))
