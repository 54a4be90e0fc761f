"""A threshold lets through what it may and no more, and a resampled interval holds what it is of."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from sim_replay.scoring.inputs import ReportedContact, ScoredMission, Truth, TruthObject
from sim_replay.scoring.score import score_missions
from sim_replay.scoring.thresholds import banded_at, best_scores, found_at, pd_at, resampled, threshold_at

scores = st.lists(st.floats(-5.0, 5.0).map(lambda x: round(x, 1)), max_size=30)


@given(false_alarms=scores, n_allowed=st.floats(0.0, 40.0))
def test_no_more_false_alarms_lie_above_than_allowed_and_no_lower_threshold_does_as_well(
    false_alarms: list[float], n_allowed: float
) -> None:
    above = threshold_at(false_alarms, n_allowed)
    assert sum(one > above for one in false_alarms) <= n_allowed
    lower = [one for one in {*false_alarms, -math.inf} if one < above]
    assert all(sum(one > low for one in false_alarms) > n_allowed for low in lower)


def test_a_resampled_mean_has_the_interval_of_its_standard_error() -> None:
    values = np.random.Generator(np.random.PCG64(4)).normal(2.0, 1.0, 100)
    found = resampled(lambda chosen: float(values[list(chosen)].mean()), len(values), seed=1)
    assert found.value == pytest.approx(values.mean())
    half = 1.96 * values.std() / math.sqrt(len(values))
    assert found.high - found.value == pytest.approx(half, rel=0.1)
    assert found.value - found.low == pytest.approx(half, rel=0.1)
    assert resampled(lambda chosen: float(values[list(chosen)].mean()), len(values), seed=1) == found


DEGREE_M = 111_194.0  # along a meridian, near the equator


def here(north_m: float, kind: str = "sphere") -> TruthObject:
    return TruthObject(kind=kind, latitude_deg=north_m / DEGREE_M, longitude_deg=0.0, is_target=kind != "rock")


def mission(contacts: dict[float, float], *objects: TruthObject) -> ScoredMission:
    """A mission of 0.01 km² with contacts of this p_mine at these places."""
    placed = tuple(ReportedContact(north_m / DEGREE_M, 0.0, p_mine) for north_m, p_mine in contacts.items())
    return ScoredMission(placed, Truth(area_km2=0.01, objects=objects))


def test_the_best_pd_at_a_limit_takes_as_many_false_alarms_as_are_allowed_with_or_without_rocks() -> None:
    one = mission({0.0: 0.9, 50.0: 0.8, 100.0: 0.7, 150.0: 0.6, 200.0: 0.5}, *map(here, (0.0, 100.0, 200.0)))
    assert [pd_at(score_missions([one]), limit).count for limit in (0.0, 100.0, 200.0)] == [1, 2, 3]
    assert [found_at([best_scores(one)], limit).count for limit in (0.0, 100.0, 200.0)] == [1, 2, 3]
    rock = mission({0.0: 0.9, 50.0: 0.8, 100.0: 0.7}, here(0.0), here(100.0), here(50.0, "rock"))
    assert [pd_at(score_missions([rock]), 0.0, on_clutter=on).value for on in (True, False)] == [0.5, 1.0]
    assert found_at([best_scores(rock)], 0.0).value == 0.5
    assert pd_at(score_missions([mission({}, here(0.0))]), 10.0).value == 0.0
    assert found_at([best_scores(mission({}, here(0.0)))], 10.0).value == 0.0


def test_contacts_are_placed_on_targets_before_other_objects_and_the_best_counts() -> None:
    unseen = structs.replace(here(120.0), looks=())
    objects = (here(0.0), here(2.5, "rock"), here(50.0, "rock"), here(90.0), unseen)
    found = best_scores(mission({1.4: 0.9, -0.5: 0.3, 50.0: 0.6, 70.0: 0.2, 90.0: 0.4, 120.0: 0.7}, *objects))
    assert sorted(found.targets.tolist()) == [0.4, 0.9]
    assert sorted(found.false_alarms.tolist()) == [0.2, 0.6]


def test_a_band_holds_what_missions_drawn_again_give_and_what_so_few_targets_bound() -> None:
    good, bad = best_scores(mission({0.0: 0.9}, here(0.0))), best_scores(mission({}, here(0.0)))
    assert tuple(banded_at([good] * 4, 10.0)) == pytest.approx((1.0, 0.5101, 1.0), abs=1e-4)  # Wilson's of 4 of 4
    assert banded_at([good, bad] * 20, 10.0)[:1] == (0.5,)
    many = [good] * 30 + [best_scores(mission({}, *map(here, (0.0, 100.0, 200.0, 300.0))))]
    value, low, high = banded_at(many, 10.0)
    wilson = found_at(many, 10.0)
    assert low < (wilson.low or 0.0) < value < (wilson.high or 0.0) < high
