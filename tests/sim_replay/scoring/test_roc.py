"""A curve counts at each threshold what the score counts, and its band holds the curve."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_replay.scoring.inputs import ObjectPass, ReportedContact, ScoredMission, Truth, TruthObject
from sim_replay.scoring.roc import N_RESAMPLES, RankedMission, ranked, resampled, roc
from sim_replay.scoring.score import score_missions

DEG_PER_M = 1.0 / 111_320.0


def _mission(seed: int, n_targets: int = 12, n_contacts: int = 60) -> ScoredMission:
    """Scatter objects of three kinds and contacts of rounded p_mine over 60 m, so that they crowd and tie."""
    random = np.random.default_rng(seed)
    places = random.uniform(0.0, 60.0, (n_targets + 6, 2)) * DEG_PER_M
    kinds = ("truncated_cone", "wedge", "cylinder")
    objects = tuple(
        TruthObject(
            kind=kinds[k % 3] if k < n_targets else "rock",
            latitude_deg=north,
            longitude_deg=east,
            is_target=k < n_targets,
            looks=() if k == 0 else (ObjectPass(ground_range_m=20.0),),
        )
        for k, (north, east) in enumerate(places.tolist())
    )
    at = random.uniform(0.0, 60.0, (n_contacts, 2)) * DEG_PER_M
    contacts = tuple(
        ReportedContact(north, east, round(p, 1))
        for (north, east), p in zip(at.tolist(), random.uniform(0.0, 1.0, n_contacts).tolist(), strict=True)
    )
    return ScoredMission(contacts, Truth(area_km2=0.01, objects=objects))


@pytest.mark.parametrize("seed", range(4))
def test_every_threshold_counts_what_the_score_counts(seed: int) -> None:
    mission = _mission(seed)
    one = ranked("made up", mission)
    every = np.concatenate(list(one.targets.values()))
    for point in score_missions([mission]).froc:
        assert np.count_nonzero(every >= point.threshold) == point.pd.count
        assert np.count_nonzero(one.false_alarms >= point.threshold) == point.false_alarms.count
    assert len(every) == 11  # the target that no pass saw is left out


def _ranked(found: list[float], false_alarms: list[float]) -> RankedMission:
    return RankedMission("made up", {"wedge": np.array(found)}, np.array(false_alarms), 0.1)


def test_a_curve_worked_out_by_hand() -> None:
    one = _ranked([0.9, 0.5, 0.2, -math.inf], [0.6, 0.3])
    found = roc([one], ["wedge"], np.array([0.0, 9.9, 10.0, 20.0, 1e6]))
    assert found.pd.tolist() == [0.25, 0.25, 0.5, 0.75, 0.75]
    assert found.n_targets == 4
    assert found.last_per_km2 == pytest.approx(20.0)


def test_a_band_holds_its_curve_and_is_open_where_all_resamples_agree() -> None:
    missions = [_ranked([0.9, 0.4], [0.5]), _ranked([0.8, 0.7], [0.3]), _ranked([0.6, 0.95], [])]
    found = roc(missions, ["wedge"], np.logspace(0.0, 3.0, 13))
    assert np.all(found.low <= found.pd)
    assert np.all(found.pd <= found.high)
    assert found.pd[-1] == 1.0
    assert found.low[-1] < 0.7  # six of six, by Wilson


def test_systems_on_the_same_missions_draw_the_same_missions() -> None:
    missions = [_ranked([0.9], []), _ranked([-math.inf], []), _ranked([0.9], [])]
    limit = np.array([100.0])
    worse = [one._replace(targets={"wedge": one.targets["wedge"] - 0.5}) for one in missions]
    assert np.array_equal(resampled(missions, ["wedge"], limit), resampled(worse, ["wedge"], limit))
    assert resampled(missions, ["wedge"], limit).shape == (N_RESAMPLES, 1)


def test_a_kind_is_counted_alone_against_all_false_alarms() -> None:
    one = RankedMission("made up", {"wedge": np.array([0.9]), "cylinder": np.array([0.1])}, np.array([0.5]), 1.0)
    limits = np.array([0.5, 1.0])
    assert roc([one], ["wedge"], limits).pd.tolist() == [1.0, 1.0]
    assert roc([one], ["cylinder"], limits).pd.tolist() == [0.0, 1.0]
    assert roc([one], ["wedge", "cylinder"], limits).pd.tolist() == [0.5, 1.0]
