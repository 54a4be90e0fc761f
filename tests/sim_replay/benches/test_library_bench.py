"""What the bench of the list of mines expected lays and counts."""

from __future__ import annotations

import numpy as np
import pytest

from auv_mcm.classify.size_evidence import is_usual
from auv_mcm.classify.targets import parse_targets
from sim_replay.benches.experiment import experiment_rows
from sim_replay.benches.library import EXPERIMENT, LISTS, TYPES, Judged, judge, list_text, with_types
from sim_replay.scoring.inputs import ReportedContact, ScoredMission, Truth, TruthObject
from sim_replay.scoring.thresholds import BestScores, found_at
from sim_replay.simulator.scene_file import read_scene

DEGREE_M = 111_194.0  # along a meridian, near the equator


def judged(targets: list[float], rocks: list[float], false_alarms: list[float]) -> Judged:
    alarms = np.array(false_alarms)
    return Judged(BestScores(np.array(targets), np.array(rocks), alarms, alarms, 0.1), len(targets), 0)


def test_only_types_of_the_list_are_laid_as_many_as_the_scene_has() -> None:
    before = read_scene("mixed")
    after = with_types(before)
    targets = [group for group in after.scatter if group.kind in ("cylinder", "sphere", "truncated_cone")]
    assert sum(group.count for group in targets) == 6 + 5 + 5 + 5 + 3
    assert {group.kind for group in after.scatter} & {"wedge", "box"} == set()
    (cone,) = (group for group in targets if group.kind == "truncated_cone")
    assert (cone.width_m, cone.height_m) == ((0.98, 0.98), (0.47, 0.47))
    assert [group for group in after.scatter if group.kind == "rock"] == [
        group for group in before.scatter if group.kind == "rock"
    ]


def test_lists_are_right_wrong_and_incomplete() -> None:
    right, large, incomplete = (
        parse_targets(text, "a list") for text in (list_text(), list_text(1.2), list_text(without="sphere"))
    )
    assert all(is_usual(mine) for mine in right.mines)
    assert [mine.__struct_config__.tag for mine in incomplete.mines] == ["cylinder", "truncated_cone"]
    assert large.mines[1].diameter_m == pytest.approx(1.2 * TYPES["sphere"]["diameter_m"])  # type: ignore[union-attr]  # a sphere


def test_the_best_contact_of_a_target_calls_it_and_names_its_kind() -> None:
    def here(kind: str, north_m: float, is_target: bool) -> TruthObject:
        return TruthObject(kind=kind, latitude_deg=north_m / DEGREE_M, longitude_deg=0.0, is_target=is_target)

    def contact(north_m: float, p_mine: float, kind: str, called: bool) -> ReportedContact:
        return ReportedContact(north_m / DEGREE_M, 0.0, p_mine, classification=kind, called=called)

    objects = (
        here("sphere", 0.0, True),
        here("rock", 2.5, False),
        here("rock", 50.0, False),
        here("wedge", 90.0, True),
    )
    contacts = (
        contact(1.4, 0.9, "sphere", True),  # nearer to the rock
        contact(-0.5, 0.3, "cylinder", True),  # the lesser one on the same target
        contact(50.0, 0.6, "sphere", True),
        contact(70.0, 0.2, "unknown", False),
        contact(90.0, 0.4, "sphere", True),
    )
    found = judge(ScoredMission(contacts, Truth(area_km2=0.1, objects=objects)))
    assert (found.n_called, found.n_right) == (2, 1)


def test_targets_count_above_the_first_false_alarm_too_many() -> None:
    one = judged([0.9, 0.5, 0.2], [0.6, 0.1], [0.6, 0.4, 0.1])
    assert [found_at([one.best], limit).count for limit in (5.0, 10.0, 20.0, 30.0)] == [1, 2, 3, 3]


def test_a_list_gains_what_it_finds_more_and_the_table_has_a_row_for_each() -> None:
    without, better = judged([0.9, 0.3], [0.6], [0.6] * 11), judged([0.9, 0.7], [0.6], [0.6] * 11)
    flown = {name: without if name == LISTS[0] else better for name in LISTS}
    rows = experiment_rows(EXPERIMENT, ["flat"] * 3, [flown] * 3)
    assert [row.variant for row in rows] == list(LISTS)
    assert [row.cells["more at 100 than without a list"].value for row in rows] == [None, 0.5, 0.5, 0.5]
    assert [row.cells["rocks called at Pd 0.9"].value for row in rows] == [1.0, 0.0, 0.0, 0.0]
