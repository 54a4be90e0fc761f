"""The curve over thresholds: against counting afresh, monotone, and what is read off it."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_replay.scoring import Score, ScoredMission, score_missions
from sim_replay.scoring.froc import OperatingPoint
from tests.sim_replay.scoring.scoring_cases import contact, mission, random_mission, rock, truth_object


@cache
def pooled() -> Score:
    return score_missions([random_mission(seed) for seed in range(4)])


def pd_allowed(score: Score, most_per_km2: float) -> float:
    """The best Pd with at most that many false alarms, by looking at every point."""
    return max(
        (point.pd.value or 0.0 for point in score.froc if (point.false_alarms.per_km2 or 0.0) <= most_per_km2),
        default=0.0,
    )


def numbers(point: OperatingPoint) -> tuple[int, ...]:
    return point.pd.count, point.false_alarms.count, point.on_known_clutter, point.duplicates, point.on_unseen_targets


def test_every_point_is_what_only_the_contacts_called_there_give() -> None:
    missions = [random_mission(seed, n_objects=12, extent_m=60.0) for seed in (1, 2)]
    score = score_missions(missions)
    assert [point.threshold for point in score.froc] == sorted(
        {reported.p_mine for one in missions for reported in one.contacts}, reverse=True
    )
    for point in score.froc:
        called = [
            one._replace(contacts=tuple(reported for reported in one.contacts if reported.p_mine >= point.threshold))
            for one in missions
        ]
        assert numbers(score_missions(called, threshold=0.0).at_threshold) == numbers(point)


@given(seed=st.integers(0, 10_000), extent_m=st.sampled_from([20.0, 40.0, 60.0]))
def test_no_count_falls_with_the_threshold_and_every_called_contact_is_counted_once(seed: int, extent_m: float) -> None:
    one = random_mission(seed, n_objects=10, extent_m=extent_m)
    score = score_missions([one])
    counts = np.array([numbers(point)[:2] + numbers(point)[3:] for point in score.froc])
    assert (np.diff(counts, axis=0) >= 0).all()
    assert score.froc[-1].pd.count <= score.n_targets
    called = [sum(reported.p_mine >= point.threshold for reported in one.contacts) for point in score.froc]
    assert counts.sum(axis=1).tolist() == called


def test_headline_is_the_best_pd_within_its_false_alarms() -> None:
    score = pooled()
    assert [headline.limit_per_km2 for headline in score.headlines] == [10.0, 30.0, 100.0]
    for headline in score.headlines:
        assert headline.pd.value == pd_allowed(score, headline.limit_per_km2)
        assert headline.per_km2 <= headline.limit_per_km2
        again = score_missions(
            [random_mission(seed) for seed in range(4)], threshold=headline.threshold or 1.0
        ).at_threshold
        assert again.pd == headline.pd


def test_partial_area_is_the_mean_of_pd_over_logarithmic_density() -> None:
    score = pooled()
    densities = 10.0 ** (np.arange(30_000) / 10_000.0)
    assert score.partial_area == pytest.approx(
        np.mean([pd_allowed(score, density) for density in densities[::10]]), abs=2e-3
    )


def test_perfect_contacts_have_the_whole_area_and_none_have_nothing_of_it() -> None:
    objects = [truth_object(20.0 * index, 0.0) for index in range(5)]
    perfect = score_missions([mission([contact(20.0 * index, 0.0) for index in range(5)], objects)])
    assert (perfect.partial_area, perfect.headlines[0].pd.value) == (1.0, 1.0)
    nothing = score_missions([mission([], objects)])
    assert (nothing.partial_area, nothing.headlines[0].pd.value, nothing.headlines[0].threshold) == (0.0, 0.0, None)
    assert nothing.froc == ()
    assert nothing.at_threshold.false_alarms.per_km2 == 0.0


def test_headline_is_zero_if_even_the_surest_contacts_alarm_too_often() -> None:
    score = score_missions(
        [mission([contact(50.0, 0.0, 0.9), contact(0.0, 0.0, 0.9)], [truth_object(0.0, 0.0)], area_km2=0.005)]
    )
    assert [headline.pd.value for headline in score.headlines] == [0.0, 0.0, 0.0]
    assert score.at_threshold.pd.value == 1.0


def test_threshold_between_contacts_takes_those_above_it() -> None:
    one = mission([contact(0.0, 0.0, 0.8), contact(50.0, 0.0, 0.4)], [truth_object(0.0, 0.0), truth_object(50.0, 0.0)])
    found = [
        score_missions([one], threshold=threshold).at_threshold.pd.count
        for threshold in (0.0, 0.4, 0.41, 0.8, 0.81, 1.0)
    ]
    assert found == [2, 2, 1, 1, 0, 0]
    assert [point.pd.count for point in score_missions([one]).ladder] == [0, 1, 1, 1, 1, 2, 2, 2, 2, 2]


def test_contacts_of_one_mission_do_not_meet_objects_of_another() -> None:
    found, missed = mission([contact(0.0, 0.0)], [rock(0.0, 0.0)]), mission([], [truth_object(0.0, 0.0)])
    score = score_missions([found, missed])
    assert (score.at_threshold.pd.count, score.at_threshold.false_alarms.count, score.area_km2) == (0, 1, 0.2)


# --- bootstrap by mission ---


def test_bootstrap_needs_three_missions() -> None:
    missions = [random_mission(seed) for seed in range(3)]
    assert score_missions(missions[:2]).bootstrap is None
    assert score_missions(missions).bootstrap is not None


def test_bootstrap_of_equal_missions_knows_no_spread() -> None:
    """At the usual threshold, and at the first limit, exactly: both count."""
    contacts = [contact(50.0 * number, 0.0, 0.5) for number in range(6)]
    one = mission(contacts, [truth_object(0.0, 0.0), truth_object(20.0, 0.0)], area_km2=0.5)
    bootstrap = score_missions([one] * 4).bootstrap
    assert bootstrap is not None
    assert bootstrap.fa_per_km2 is not None
    assert (bootstrap.fa_per_km2.low, bootstrap.fa_per_km2.high) == (10.0, 10.0)
    for bounds in (bootstrap.pd, *bootstrap.headline_pd):
        assert bounds is not None
        assert (bounds.low, bounds.high) == (0.5, 0.5)


def test_bootstrap_spreads_as_the_missions_differ() -> None:
    """Half of the missions found, half missed: the mean of n missions has the standard error 0.5 / sqrt(n)."""
    found, missed = mission([contact(0.0, 0.0)], [truth_object(0.0, 0.0)]), mission([], [truth_object(0.0, 0.0)])
    bootstrap = score_missions([found, missed] * 32).bootstrap
    assert bootstrap is not None
    assert bootstrap.pd is not None
    assert (bootstrap.pd.high - bootstrap.pd.low) / 2.0 == pytest.approx(1.96 * 0.5 / math.sqrt(64), rel=0.1)


def test_bootstrap_of_missions_without_targets_gives_false_alarms_only() -> None:
    empty: ScoredMission = mission([contact(0.0, 0.0)], [])
    bootstrap = score_missions([empty] * 3).bootstrap
    assert bootstrap is not None
    assert bootstrap.pd is None
    assert bootstrap.headline_pd == (None, None, None)
    assert bootstrap.fa_per_km2 is not None
    assert bootstrap.fa_per_km2.low == pytest.approx(10.0)
