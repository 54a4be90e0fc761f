"""The comparison of all detectors: what each reports of one short mission, rates at limits, and how rocks are
counted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import Contact
from sim_replay.benches import froc
from sim_replay.benches.froc import SYSTEMS, FlownLine, HeldOutAugmentedLine, HeldOutSimulatedLine, outdone
from sim_replay.missions import config_for
from sim_replay.scoring import ScoredMission, parse_truth, score_missions
from sim_replay.scoring.inputs import ReportedContact
from sim_replay.scoring.thresholds import pd_at
from sim_replay.simulator import mission as simulated
from sim_replay.simulator.scene import Lawnmower, Scatter, Scene, Track
from sim_replay.simulator.scene_file import read_scene
from tests.auv_mcm.classify.drawn_looks import contact, detection

PLACE = LocalFrame(latitude_deg=43.7, longitude_deg=10.3)


def at(north_m: float, p_mine: float) -> ReportedContact:
    latitude, longitude, _ = PLACE.to_geodetic((0.0, north_m, 0.0))
    return ReportedContact(float(latitude), float(longitude), p_mine)


def truth_of(*norths_m: float, kind: str = "sphere", is_target: bool = True) -> dict[str, Any]:
    places = [PLACE.to_geodetic((0.0, north_m, 0.0)) for north_m in norths_m]
    objects = [{"kind": kind, "lat": float(lat), "lon": float(lon), "is_target": is_target} for lat, lon, _ in places]
    return {"area_km2": 0.01, "objects": objects}


def test_the_best_pd_at_a_limit_takes_as_many_false_alarms_as_are_allowed() -> None:
    contacts = (at(0.0, 0.9), at(50.0, 0.8), at(100.0, 0.7), at(150.0, 0.6), at(200.0, 0.5))
    score = score_missions([ScoredMission(contacts, parse_truth(truth_of(0.0, 100.0, 200.0), "here"), "here")])
    assert [pd_at(score, limit).count for limit in (0.0, 100.0, 200.0)] == [1, 2, 3]


def test_false_alarms_on_rocks_can_be_left_out() -> None:
    truth = truth_of(0.0, 100.0)
    rocks = truth_of(50.0, kind="rock", is_target=False)
    both = {"area_km2": 0.01, "objects": [*truth["objects"], *rocks["objects"]]}
    contacts = (at(0.0, 0.9), at(50.0, 0.8), at(100.0, 0.7), at(150.0, 0.6))
    score = score_missions([ScoredMission(contacts, parse_truth(both, "here"), "here")])
    assert pd_at(score, 0.0).value == 0.5
    assert pd_at(score, 0.0, on_clutter=False).value == 1.0


def test_a_threshold_is_outdone_only_where_neither_error_is_worse_and_one_is_less() -> None:
    truth = parse_truth(truth_of(0.0, 100.0), "here")
    ours, baseline, worse = (
        score_missions([ScoredMission(tuple(at(north_m, p) for north_m, p in contacts), truth, "here")])
        for contacts in (
            ((0.0, 0.9), (50.0, 0.8), (100.0, 0.7)),  # one, one and a false alarm, both and that
            ((50.0, 0.9), (0.0, 0.8), (150.0, 0.7), (100.0, 0.6)),
            ((0.0, 0.9),),
        )
    )
    assert outdone(ours, baseline) == (3, 3)
    assert outdone(ours, ours) == (3, 1)  # the first and the last are the best that it has
    assert outdone(worse, ours) == (3, 1)
    assert outdone(ours, score_missions([ScoredMission((at(50.0, 0.9),), truth, "here")])) == (0, 0)


def test_without_contacts_the_best_pd_is_none_of_the_targets() -> None:
    score = score_missions([ScoredMission((), parse_truth(truth_of(0.0, 100.0), "here"), "here")])
    assert pd_at(score, 10.0).value == 0.0


def test_rocks_count_by_views_and_by_the_most_mine_like_contact_near_them() -> None:
    truth = parse_truth(truth_of(0.0, 100.0, 200.0, kind="rock", is_target=False), "here")

    def seen(north_m: float, p_mine: float, n_views: int) -> Contact:
        latitude, longitude, _ = PLACE.to_geodetic((0.0, north_m, 0.0))
        place: dict[str, Any] = {"latitude_deg": float(latitude), "longitude_deg": float(longitude)}
        return contact(**place, p_mine=p_mine, views=tuple(detection(**place) for _ in range(n_views)))

    found = list(
        froc._rocks([seen(0.5, 0.1, 1), seen(-0.5, 0.9, 2), seen(100.0, 0.2, 1)], ScoredMission((), truth, "here"))
    )
    assert [(rock.n_views, rock.called) for rock in found] == [(2, True), (1, False), (0, False)]


def test_missions_are_pooled_without_the_sea_floor_held_out() -> None:
    def flown(group: str) -> FlownLine:
        return FlownLine(group, {}, ())

    groups = dict(froc._groups([flown("flat"), flown("ripple"), flown("seagrass"), flown("log1"), flown("log2")]))
    assert [one.group for one in groups["all simulated but held-out sea floors"]] == ["flat", "ripple"]
    assert [one.group for one in groups["all recorded"]] == ["log1", "log2"]
    assert set(groups) >= {"flat", "ripple", "seagrass", "log1", "log2"}


def test_every_system_reports_of_one_mission() -> None:
    scene = Scene(
        seed=3,
        sonar=read_scene("flat").sonar,
        track=Track(plan=Lawnmower(n_legs=1, leg_m=40.0), altitude_m=6.0),
        scatter=(Scatter(kind="rock", count=2), Scatter(kind="cylinder", count=2)),
    )
    mission = simulated.Mission(scene)
    found = froc._seen(HeldOutSimulatedLine("flat", 3), config_for(scene), mission.events(), mission.truth)
    assert set(found.reported) == set(SYSTEMS)
    assert all(one.truth is found.reported["chain"].truth for one in found.reported.values())
    assert len(found.reported["chain"].contacts) == len(found.reported["confirmation"].contacts) > 0


def test_a_scene_that_is_not_there_is_refused_by_name() -> None:
    with pytest.raises(UsageError, match="nowhere"):
        read_scene("nowhere")
    assert HeldOutAugmentedLine(Path("/data/line.xtf"), 1).group == "line"
