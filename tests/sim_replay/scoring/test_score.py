"""What each contact and object counts as, and where the rates are booked."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from auv_mcm.errors import BadInputError, UsageError
from sim_replay.scoring import ReportedContact, Score, ScoredMission, score_files, score_missions, table
from sim_replay.scoring.breakdown import Group
from sim_replay.scoring.seabed_map import encode
from tests.sim_replay.scoring.scoring_cases import (
    FRAME,
    contact,
    mission,
    random_mission,
    rock,
    truth_object,
    write_pair,
)


def scored(contacts: list[dict[str, Any]], objects: list[dict[str, Any]], **options: Any) -> Score:
    return score_missions([mission(contacts, objects)], **options)


def sandy_and_rocky() -> dict[str, Any]:
    """A map of 100 m by 100 m from the common origin: sand in the west, rock in the east, the northern rows not
    swept."""
    cells = np.zeros((50, 50), dtype=np.int64)
    cells[:, 30:] = 1
    cells[40:] = -1
    seabed = encode(
        cells, types=["sand", "rock"], cell_m=2.0, latitude_deg=FRAME.latitude_deg, longitude_deg=FRAME.longitude_deg
    )
    facts: dict[str, Any] = msgspec.to_builtins(seabed)
    return facts


def group(groups: tuple[Group, ...], name: str) -> tuple[int, int, int]:
    """Detections, targets, false alarms."""
    (found,) = (one for one in groups if one.name == name)
    return found.pd.count, found.pd.of, found.false_alarms.count


# --- what a contact counts as ---


def test_contact_within_the_gate_is_a_detection_and_beyond_it_a_false_alarm() -> None:
    objects = [truth_object(0.0, 0.0), truth_object(30.0, 0.0)]
    point = scored([contact(1.99, 0.0), contact(30.0, 2.01)], objects).at_threshold
    assert (point.pd.count, point.pd.of, point.false_alarms.count) == (1, 2, 1)
    assert scored([contact(1.99, 0.0), contact(30.0, 2.01)], objects, gate_m=2.5).at_threshold.pd.count == 2


def test_uncertain_contact_has_a_wider_gate() -> None:
    assert scored([contact(2.9, 0.0, sigma_m=1.0)], [truth_object(0.0, 0.0)]).at_threshold.pd.count == 1
    assert scored([contact(4.1, 0.0, sigma_m=9.0)], [truth_object(0.0, 0.0)]).at_threshold.pd.count == 0


def test_second_contact_on_a_target_is_a_duplicate_and_no_false_alarm() -> None:
    point = scored([contact(0.0, 0.0), contact(0.5, 0.0), contact(0.0, 1.0)], [truth_object(0.0, 0.0)]).at_threshold
    assert (point.pd.count, point.duplicates, point.false_alarms.count) == (1, 2, 0)


def test_contacts_on_a_rock_are_false_alarms_on_known_clutter_and_the_rock_is_called_once() -> None:
    score = scored([contact(0.0, 0.0), contact(0.5, 0.0), contact(40.0, 0.0)], [rock(0.0, 0.0), rock(20.0, 0.0)])
    point, rocks = score.at_threshold, score.rocks_called_mines
    assert (point.false_alarms.count, point.on_known_clutter, point.duplicates) == (3, 2, 0)
    assert (rocks.count, rocks.of) == (1, 2)


def test_contact_on_a_rock_beside_a_missed_target_is_no_detection() -> None:
    point = scored([contact(0.0, 0.0)], [rock(0.1, 0.0), truth_object(1.5, 0.0)]).at_threshold
    assert (point.pd.count, point.on_known_clutter) == (0, 1)


def test_target_that_no_pass_saw_counts_neither_as_missed_nor_its_contact_as_a_false_alarm() -> None:
    unseen = [truth_object(0.0, 0.0, looks=[]), rock(20.0, 0.0, looks=[]), truth_object(40.0, 0.0, looks=[])]
    score = scored([contact(0.0, 0.0), contact(20.0, 0.0)], unseen)
    point = score.at_threshold
    assert (point.pd.of, point.on_unseen_targets, point.false_alarms.count, point.on_known_clutter) == (0, 1, 1, 0)
    assert score.rocks_called_mines.of == 0
    assert (score.left_out.targets_never_seen, score.left_out.other_objects_never_seen) == (2, 1)
    assert (score.kinds, score.position_errors.total_m.n, score.missed_targets_of_unknown_range) == ((), 0, 0)


def test_second_contact_on_a_target_that_no_pass_saw_is_no_duplicate() -> None:
    point = scored([contact(0.0, 0.0), contact(0.5, 0.0)], [truth_object(0.0, 0.0, looks=[])]).at_threshold
    assert (point.on_unseen_targets, point.duplicates, point.false_alarms.count) == (2, 0, 0)


def test_contact_without_a_position_is_left_out_and_counted() -> None:
    lost = contact(0.0, 0.0) | {"geometry": None}
    score = scored([lost], [truth_object(0.0, 0.0)])
    assert (score.n_contacts, score.left_out.contacts_without_position, score.at_threshold.false_alarms.count) == (
        0,
        1,
        0,
    )


def test_contact_outside_the_swept_area_is_left_out_unless_it_is_on_a_target() -> None:
    contacts = [contact(50.0, 81.0), contact(10.0, 90.0), contact(-5.0, 10.0), contact(50.0, 20.0)]
    score = score_missions([mission(contacts, [truth_object(50.0, 79.5)], seabed_map=sandy_and_rocky())])
    assert score.left_out.contacts_outside_swept_area == 2
    assert (score.at_threshold.pd.count, score.at_threshold.false_alarms.count) == (1, 1)


def test_truth_without_targets_gives_false_alarms_only() -> None:
    score = scored([contact(0.0, 0.0)], [])
    assert (score.at_threshold.pd.value, score.partial_area, score.headlines[0].pd.value) == (None, None, None)
    assert score.at_threshold.false_alarms.per_km2 == pytest.approx(10.0)


def test_places_across_the_antimeridian_are_near() -> None:
    truth = mission([], [truth_object(0.0, 0.0)]).truth
    there = msgspec.structs.replace(truth.objects[0], latitude_deg=0.0, longitude_deg=180.0)
    contacts = (ReportedContact(0.0, -179.999999, 0.9), ReportedContact(0.0, 179.9, 0.9))
    point = score_missions([ScoredMission(contacts, msgspec.structs.replace(truth, objects=(there,)))]).at_threshold
    assert (point.pd.count, point.false_alarms.count) == (1, 1)


# --- where it is booked ---


def test_kinds_separate_targets_and_others() -> None:
    objects = [
        truth_object(0.0, 0.0),
        truth_object(20.0, 0.0),
        truth_object(40.0, 0.0, "sphere"),
        rock(60.0, 0.0),
        truth_object(80.0, 0.0, is_target=False),
    ]
    score = scored([contact(0.0, 0.0), contact(60.0, 0.0)], objects)
    rows = [(row.kind, row.is_target, row.called.count, row.called.of) for row in score.kinds]
    assert rows == [("cylinder", True, 1, 2), ("sphere", True, 0, 1), ("cylinder", False, 0, 1), ("rock", False, 1, 1)]


def test_range_is_that_of_the_nearest_look_and_of_the_contact_for_false_alarms() -> None:
    looks = [
        {"side": "port", "ground_range_m": range_m, "time": "2024-05-01T10:00:00Z"} for range_m in (45.0, 20.0, 31.0)
    ]
    contacts = [
        contact(0.0, 0.0, ground_range_m=45.0),
        contact(60.0, 0.0, ground_range_m=9.99),
        contact(80.0, 0.0, ground_range_m=300.0),
    ]
    score = scored(
        [*contacts, contact(99.0, 0.0)], [truth_object(0.0, 0.0, looks=looks), truth_object(20.0, 0.0, looks=looks[2:])]
    )
    assert [one.name for one in score.ranges] == ["0-10 m", "20-30 m", "30-50 m", "over 150 m", "unknown"]
    assert [group(score.ranges, one.name) for one in score.ranges] == [
        (0, 0, 1),
        (1, 1, 0),
        (0, 1, 0),
        (0, 0, 1),
        (0, 0, 1),
    ]
    assert score.missed_targets_of_unknown_range == 0


def test_missed_target_without_looks_is_of_unknown_range_and_said_so() -> None:
    score = scored([contact(0.0, 0.0, ground_range_m=12.0)], [truth_object(0.0, 0.0), truth_object(20.0, 0.0)])
    assert group(score.ranges, "10-20 m") == (1, 1, 0)
    assert group(score.ranges, "unknown") == (0, 1, 0)
    assert score.missed_targets_of_unknown_range == 1


def test_sea_floor_has_its_own_area_and_is_looked_up_where_the_object_does_not_state_it() -> None:
    objects = [truth_object(10.0, 10.0), truth_object(90.0, 10.0), truth_object(20.0, 20.0, seabed="rock")]
    contacts = [contact(10.0, 10.0), contact(30.0, 30.0), contact(90.0, 40.0)]
    score = score_missions([mission(contacts, objects, seabed_map=sandy_and_rocky())])
    assert group(score.seabeds, "sand") == (1, 1, 1)
    assert group(score.seabeds, "rock") == (0, 2, 1)
    areas = {one.name: one.false_alarms.area_km2 for one in score.seabeds}
    assert areas == pytest.approx({"sand": 60 * 80 / 1e6, "rock": 40 * 80 / 1e6})


def test_missions_with_and_without_a_map_are_booked_side_by_side() -> None:
    mapped = mission([contact(30.0, 30.0)], [], seabed_map=sandy_and_rocky())
    score = score_missions([mapped, mapped, mission([contact(30.0, 30.0)], [], area_km2=0.25)])
    found = {one.name: (one.false_alarms.count, one.false_alarms.area_km2) for one in score.seabeds}
    assert found == {"rock": (0, pytest.approx(0.0064)), "sand": (2, pytest.approx(0.0096)), "unknown": (1, 0.25)}


def test_groups_add_up_to_the_whole() -> None:
    score = score_missions([random_mission(seed) for seed in range(3)])
    whole = (score.at_threshold.pd.count, score.n_targets, score.at_threshold.false_alarms.count)
    for groups in (score.ranges, score.seabeds):
        assert tuple(map(sum, zip(*(group(groups, one.name) for one in groups), strict=True))) == whole
    assert sum(row.pd.count for row in score.missions) == whole[0]
    assert sum(row.false_alarms.count for row in score.missions) == whole[2]
    assert sum(row.called.of for row in score.kinds if row.is_target) == whole[1]
    others = [row.called for row in score.kinds if not row.is_target]
    assert sum(row.count for row in others) == score.rocks_called_mines.count


@pytest.mark.parametrize("threshold", [0.39, 0.4, 0.41, 0.8, 0.81])
def test_groups_and_rates_are_at_the_same_threshold(threshold: float) -> None:
    score = scored([contact(0.0, 0.0, 0.8), contact(50.0, 0.0, 0.4)], [truth_object(0.0, 0.0)], threshold=threshold)
    point = score.at_threshold
    assert group(score.seabeds, "unknown") == (point.pd.count, point.pd.of, point.false_alarms.count)
    assert point.pd.count + point.false_alarms.count == sum(p_mine >= threshold for p_mine in (0.8, 0.4))


def test_confusion_has_kinds_against_classes() -> None:
    objects = [truth_object(0.0, 0.0), truth_object(20.0, 0.0), truth_object(40.0, 0.0, "sphere"), rock(60.0, 0.0)]
    named: list[tuple[float, float, str]] = [
        (0.0, 0.9, "sphere"),
        (20.0, 0.9, "cylinder"),
        (60.0, 0.9, "wedge"),
        (40.0, 0.1, "sphere"),
    ]
    contacts = [contact(east_m, 0.0, p_mine, name) for east_m, p_mine, name in named]
    matrix = scored([*contacts, contact(90.0, 0.0, named="odd")], objects).confusion
    assert matrix.columns == ("cylinder", "sphere", "wedge", "odd", "not called")
    assert [(row.kind, row.counts) for row in matrix.rows] == [
        ("cylinder", (1, 1, 0, 0, 0)),
        ("sphere", (0, 0, 0, 0, 1)),
        ("rock", (0, 0, 1, 0, 0)),
    ]
    assert matrix.nothing_there == (0, 0, 0, 1, 0)


def test_position_errors_are_contact_less_truth() -> None:
    errors = [(0.3, 0.4), (-0.6, 0.8), (0.3, 0.0)]
    objects = [truth_object(20.0 * index, 0.0) for index in range(3)]
    contacts = [contact(20.0 * index + east_m, north_m, sigma_m=0.5) for index, (east_m, north_m) in enumerate(errors)]
    found = scored(contacts, objects).position_errors
    assert found.east_m.n == 3
    assert found.east_m.median == pytest.approx(0.3, abs=1e-4)
    assert found.north_m.median == pytest.approx(0.4, abs=1e-4)
    assert found.total_m.median == pytest.approx(0.5, abs=1e-4)
    assert found.in_sigmas.median == pytest.approx(1.0, abs=1e-3)
    assert found.total_m.p95_absolute == pytest.approx(np.quantile([0.5, 1.0, 0.3], 0.95), abs=1e-4)


@pytest.mark.parametrize(("tilted", "error_m"), [({}, 0.05), ({"rise_m": 0.6}, -0.25)])
def test_size_errors_take_the_height_above_the_floor_and_skip_what_is_not_stated(
    tilted: dict[str, float], error_m: float
) -> None:
    sizes: dict[str, Any] = {"length_m": 2.0, "width_m": 0.5, "height_m": 0.5, "burial_m": 0.2, **tilted}
    contacts = [
        contact(0.0, 0.0, length_m=1.8, width_m=None, height_m=0.35),
        contact(20.0, 0.0, length_m=9.0, height_m=9.0),
    ]
    found = scored(contacts, [truth_object(0.0, 0.0, **sizes), truth_object(20.0, 0.0)]).size_errors
    assert (found.length_m.n, found.height_m.n) == (1, 1)
    assert (found.length_m.median, found.length_m.p95_absolute) == pytest.approx((-0.2, 0.2))
    assert found.height_m.median == pytest.approx(error_m)
    assert (found.width_m.n, found.width_m.median, found.width_m.p95_absolute) == (0, None, None)


# --- asked for in vain ---


@pytest.mark.parametrize("gate_m", [0.0, -1.0, math.nan, math.inf])
def test_impossible_gate_is_refused(gate_m: float) -> None:
    with pytest.raises(UsageError, match="--gate-m"):
        scored([], [], gate_m=gate_m)


@pytest.mark.parametrize("threshold", [-0.01, 1.01, math.nan])
def test_impossible_threshold_is_refused(threshold: float) -> None:
    with pytest.raises(UsageError, match="--threshold"):
        scored([], [], threshold=threshold)


def test_nothing_to_score_is_refused() -> None:
    with pytest.raises(UsageError, match="no missions"):
        score_missions([])


def test_the_payloads_own_calls_are_scored_beside_what_was_asked(tmp_path: Path) -> None:
    contacts = [
        contact(0.0, 0.0, 0.3, called=True),
        contact(20.0, 0.0, 0.9, called=False),
        contact(40.0, 0.0, 0.4, called=True),
        contact(60.0, 0.0, 0.5, called=True),
    ]
    objects = [truth_object(0.0, 0.0), truth_object(20.0, 0.0), rock(40.0, 0.0)]
    paths = write_pair(tmp_path, contacts, {"area_km2": 0.1, "objects": objects})
    asked_nowhere = score_files(paths).called
    assert asked_nowhere is not None
    assert asked_nowhere.asked_per_km2 is None
    for text in ("{}", "["):
        (tmp_path / "summary.json").write_text(text)
        silent = score_files(paths).called
        assert silent == asked_nowhere
    (tmp_path / "summary.json").write_text('{"operating_point": {"asked_per_km2": 25.0}}')
    score = score_files(paths)
    assert score.called is not None
    assert score.called.asked_per_km2 == 25.0
    assert (score.called.pd.count, score.called.pd.of) == (1, 2)
    assert score.called.false_alarms.count == 2
    assert score.called.false_alarms.per_km2 == pytest.approx(20.0)
    assert score.called.on_known_clutter == 1
    text = table(score)
    assert "called by the payload" in text
    assert "2.5 on this area" in text


def test_missions_without_contacts_count_among_calls_and_have_to_be_asked_for_the_same() -> None:
    found = mission([contact(0.0, 0.0, called=True)], [truth_object(0.0, 0.0)])._replace(asked_per_km2=25.0)
    missed = mission([], [truth_object(0.0, 0.0)])
    for asked_per_km2, said in ((25.0, 25.0), (30.0, None)):
        called = score_missions([found, missed._replace(asked_per_km2=asked_per_km2)]).called
        assert called is not None
        assert (called.asked_per_km2, called.pd.count, called.pd.of) == (said, 1, 2)


def test_contacts_that_do_not_say_whether_they_are_called_have_no_operating_point() -> None:
    score = score_missions([mission([contact(0.0, 0.0, called=True), contact(5.0, 0.0)], [truth_object(0.0, 0.0)])])
    assert score.called is None
    assert "called by the payload" not in table(score)


def test_p_mine_is_compared_with_what_lay_there() -> None:
    contacts = [contact(10.0 * number, 0.0, 0.25) for number in range(4)] + [
        contact(0.5, 0.5, 0.9),
        contact(100.0, 0.0, 0.9),
    ]
    objects = [truth_object(0.0, 0.0), truth_object(100.0, 0.0, looks=[])]
    kept = score_missions([mission(contacts, objects)]).calibration
    assert kept is not None
    assert [(each.low, each.on_mines.count, each.on_mines.of) for each in kept.bins] == [(0.2, 1, 4), (0.9, 1, 1)]
    assert kept.error == pytest.approx((4 * 0.0 + 1 * 0.1) / 5)
    assert "expected calibration error of p_mine, in ten bins: 0.020" in table(
        score_missions([mission(contacts, objects)])
    )


def test_without_contacts_there_is_no_calibration() -> None:
    score = score_missions([mission([], [truth_object(0.0, 0.0)])])
    assert score.calibration is not None
    assert score.calibration.error is None
    assert "calibration" not in table(score)


def test_the_truth_of_another_place_is_refused_and_a_mission_that_found_nothing_is_not(tmp_path: Path) -> None:
    truth = {"area_km2": 0.1, "objects": [truth_object(-30_000.0, 0.0), truth_object(0.0, 0.0)]}
    missed = write_pair(tmp_path, [contact(9_000.0, 0.0)], truth, "missed")
    assert score_files(missed).n_contacts == 1
    elsewhere = write_pair(tmp_path, [contact(30_000.0, 0.0)], truth, "elsewhere")
    with pytest.raises(BadInputError, match=r"truth of another place.* 30 km away"):
        score_files([*missed, *elsewhere])
    assert score_files(write_pair(tmp_path, [], truth, "nothing")).n_contacts == 0
