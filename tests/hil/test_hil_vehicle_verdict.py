"""Judge runs with a vehicle by its reports, its commands and the targets it passed; missing evidence is never
a pass."""

from __future__ import annotations

from typing import Any

import pytest

from sim_replay.hil.evidence import Line, Report
from sim_replay.hil.rules import AboveFloor, LeftAlone, OwnPlanAtEnd, Passed, ReportedAsStored, ReportedInTime, Silence
from sim_replay.hil.vehicle_verdict import (
    above_floor,
    inside_fence,
    left_alone,
    n_passed,
    n_sharper,
    own_plan_after,
    own_plan_at_end,
    reported_as_stored,
    reported_in_time,
)

REPORTED_IN_TIME = ReportedInTime(device="vehicle", within_s=1.0, min_p_mine=0.2)
PASSED = Passed(device="vehicle", ground_range_m=(8.0, 16.0), other_look_deg=45.0, at_least=1)
FENCE = ((43.0, 5.0), (43.0, 5.1), (43.1, 5.1), (43.1, 5.0))


def line(at_s: float, number: int = 12, p_mine: float = 0.5, word: str = "new") -> Line:
    return Line(at_s, f"contact C{number:05d} {word}: cylinder, p_mine {p_mine:.2f}, 43.0 5.0, 1 views")


def contact(
    at_s: float, number: int = 12, p_mine: float = 0.5, n_views: int = 1, latitude_deg: float = 43.05
) -> Report:
    place = {"latitude_deg": latitude_deg, "longitude_deg": 5.05}
    return Report(at_s, "contact", {"number": number, "p_mine": p_mine, "n_views": n_views, **place})


CLUTTER = (contact(1.0, 13, 0.4, 1, 43.06), contact(2.0, 13, 0.2, 2, 43.06))


def passed(look_deg: float, ground_range_m: float = 12.0, number: int = 0, *, in_control: bool = True) -> Report:
    details = {"number": number, "look_deg": look_deg, "ground_range_m": ground_range_m, "in_control": in_control}
    return Report(1.0, "passed", details)


def pose(at_s: float, latitude_deg: float = 43.05, *, in_control: bool = True) -> Report:
    return Report(at_s, "pose", {"latitude_deg": latitude_deg, "longitude_deg": 5.05, "in_control": in_control})


def command(latitude_deg: float = 43.05, longitude_deg: float = 5.05) -> Report:
    return Report(1.0, "command", {"kind": "GoTo", "latitude_deg": latitude_deg, "longitude_deg": longitude_deg})


@pytest.mark.parametrize(
    ("lines", "reports", "holds"),
    [
        ([line(5.0)], [contact(5.4)], True),
        ([line(5.0)], [contact(4.9)], True),
        ([line(5.0)], [contact(2.0)], True),  # printed late
        ([line(5.0)], [contact(6.1)], False),
        ([line(5.0), line(9.0, word="updated")], [contact(5.1)], False),
        ([line(5.0)], [], False),
        ([line(5.0)], [contact(5.1, number=13)], False),
        ([line(5.0)], [contact(5.1, p_mine=0.6)], False),
        ([line(5.0), line(5.5, p_mine=0.6, word="updated")], [contact(5.6, p_mine=0.6)], True),
        ([line(5.0), line(7.5, p_mine=0.6, word="updated")], [contact(7.6, p_mine=0.6)], False),
        ([line(5.0), line(6.0, 13, 0.1)], [contact(5.1)], True),
        ([line(6.0, 13, 0.1)], [], False),
        ([Line(1.0, "notice port_up: contact")], [contact(1.0)], False),
    ],
)
def test_contacts_are_reported_in_time(lines: list[Line], reports: list[Report], holds: bool) -> None:
    assert reported_in_time(REPORTED_IN_TIME, lines, reports)[2] is holds


@pytest.mark.parametrize(
    ("reports", "n"),
    [
        ([passed(90.0, in_control=False), passed(181.0)], 1),
        ([passed(90.0, in_control=False), passed(100.0)], 0),
        ([passed(350.0, in_control=False), passed(20.0)], 0),
        ([passed(90.0, in_control=False), passed(181.0, in_control=False)], 0),
        ([passed(90.0, in_control=False), passed(181.0, 20.0)], 0),
        ([passed(90.0, in_control=False), passed(181.0), passed(270.0)], 1),
        ([passed(90.0, in_control=False), passed(90.0, number=1)], 1),
        ([], 0),
    ],
)
def test_passes_under_command_from_another_side_count(reports: list[Report], n: int) -> None:
    assert n_passed(PASSED, reports) == n


@pytest.mark.parametrize(
    ("reports", "n"),
    [
        ([contact(1.0), contact(2.0, p_mine=0.9, n_views=2)], 1),
        ([contact(1.0, p_mine=0.2), contact(2.0, p_mine=0.4, n_views=2)], 1),
        ([contact(1.0, p_mine=0.6), contact(2.0, p_mine=0.2, n_views=2)], 0),
        ([contact(1.0), contact(2.0, p_mine=0.9)], 0),
        ([contact(2.0, p_mine=0.9, n_views=2)], 0),
        ([contact(1.0), contact(2.0, number=13, p_mine=0.9, n_views=2)], 0),
        ([CLUTTER[0], contact(2.0, 13, 0.2, 2, 43.06)], 1),
        ([CLUTTER[0], contact(2.0, 13, 0.9, 2, 43.06)], 0),
        ([*CLUTTER, contact(1.0, p_mine=0.6), contact(2.0, p_mine=0.5, n_views=2)], 0),
        ([*CLUTTER, contact(1.0, p_mine=0.6), contact(2.0, p_mine=0.7, n_views=2)], 2),
    ],
)
def test_contacts_that_a_second_view_brings_nearer_to_the_truth_count_unless_a_mine_is_talked_down(
    reports: list[Report], n: int
) -> None:
    assert n_sharper(reports, [(43.05, 5.05)]) == n


@pytest.mark.parametrize(
    ("reports", "holds"),
    [
        ([command(), pose(1.0)], True),
        ([command(43.2), pose(1.0)], False),
        ([command(43.05, 5.2)], False),
        ([command(), pose(1.0, 43.2)], False),
        ([command(), pose(1.0, 43.2, in_control=False)], True),
        ([Report(1.0, "command", {"kind": "Steer", "heading_rad": 1.0}), pose(1.0)], True),
        ([pose(1.0)], False),
    ],
)
def test_whoever_commands_stays_inside_the_fence(reports: list[Report], holds: bool) -> None:
    assert inside_fence(FENCE, reports)[2] is holds


@pytest.mark.parametrize(
    ("killed_s", "reports", "holds"),
    [
        (10.0, [Report(14.0, "released", {}), pose(20.0, in_control=False)], True),
        (10.0, [Report(18.0, "released", {}), pose(20.0, in_control=False)], False),
        (10.0, [Report(14.0, "released", {}), pose(20.0)], False),
        (10.0, [Report(9.0, "released", {}), pose(20.0, in_control=False)], False),
        (10.0, [Report(14.0, "released", {})], False),
        (None, [Report(14.0, "released", {}), pose(20.0, in_control=False)], False),
    ],
)
def test_a_vehicle_whose_payload_is_dead_has_its_own_plan(killed_s: Any, reports: list[Report], holds: bool) -> None:
    assert own_plan_after(Silence(device="vehicle", within_s=6.0), killed_s, reports)[2] is holds


def test_a_vehicle_is_on_its_own_at_the_end() -> None:
    rule = OwnPlanAtEnd(device="vehicle")
    assert own_plan_at_end(rule, [pose(1.0), pose(9.0, in_control=False), pose(10.0, in_control=False)])[2]
    assert not own_plan_at_end(rule, [pose(1.0, in_control=False), pose(9.0), pose(10.0, in_control=False)])[2]
    assert not own_plan_at_end(rule, [])[2]


def ordered(at_s: float, reference: str, value_m: float) -> Report:
    return Report(at_s, "command", {"kind": "Steer", "vertical": [reference, value_m]})


def floor_at(at_s: float, floor_m: float) -> Report:
    return Report(at_s, "pose", {"depth_m": floor_m - 5.0, "altitude_m": 5.0, "in_control": True})


@pytest.mark.parametrize(
    ("commands", "holds"),
    [
        ([], False),
        ([ordered(5.0, "depth", 13.0)], True),
        ([ordered(5.0, "depth", 93.0)], False),
        ([ordered(5.0, "depth", 16.1), ordered(5.5, "depth", 7.0)], False),
        ([ordered(7.4, "depth", 13.5)], False),  # the floor rises to 15 m
        ([ordered(99.0, "depth", 1.0)], False),  # nobody saw the floor then
        ([ordered(5.0, "altitude", 2.0)], True),
        ([ordered(5.0, "altitude", 1.9)], False),
    ],
)
def test_commands_are_held_against_the_true_floor_around_them(commands: list[Report], holds: bool) -> None:
    poses = [floor_at(float(at_s), 18.0 if at_s < 8 else 15.0) for at_s in range(12)]
    assert above_floor(AboveFloor(device="vehicle", min_altitude_m=2.0), [*poses, *commands])[2] is holds


def fault(at_s: float, what: str = "fault", do: str = "abort") -> Report:
    return Report(at_s, what, {"do": do})


STOP = (fault(10.0), fault(20.0, "mended"))
LATER = Report(22.0, "command", {})


@pytest.mark.parametrize(
    ("reports", "holds"),
    [
        ([Report(9.0, "granted", {}), *STOP, LATER], True),
        ([*STOP, Report(15.0, "granted", {}), LATER], False),
        ([*STOP, Report(15.0, "command", {}), LATER], False),
        ([*STOP, fault(30.0, do="stop_plan"), fault(40.0, "mended", "stop_plan"), Report(42.0, "command", {})], True),
        ([*STOP, LATER, fault(30.0, do="stop_plan"), fault(40.0, "mended", "stop_plan")], False),
        ([*STOP], False),
        ([fault(10.0, do="revoke"), fault(20.0, "mended", "revoke"), LATER], False),
        ([fault(10.0), LATER], False),
    ],
)
def test_a_vehicle_that_a_person_stopped_is_left_alone_until_it_flies_again(reports: list[Report], holds: bool) -> None:
    assert left_alone(LeftAlone(device="vehicle"), reports)[2] is holds


REPORTED = {
    "number": 3,
    "p_mine": 0.75,
    "n_views": 1,
    "classification": "cylinder",
    "time_s": 1_700_000_000.4,
    "latitude_deg": 43.05,
    "longitude_deg": 5.05,
    "sigma_m": 1.0,
    "depth_m": None,
    "length_m": 1.95,
    "width_m": 0.5,
    "height_m": 0.5,
}
STORED = {
    "geometry": {"coordinates": [5.05, 43.05]},
    "properties": {
        "id": "C00003",
        "time": "2023-11-14T22:13:20.400Z",
        "p_mine": 0.751,
        "class": "cylinder",
        "n_views": 1,
        "sigma_m": 1.0,
        "depth_m": None,
        "length_m": 1.954,
        "width_m": 0.5,
        "height_m": 0.5,
    },
}


def last_report(**changes: Any) -> Report:
    return Report(9.0, "contact", {**REPORTED, **changes})


EARLY = last_report(number=1_000_001)
TAKEN_BACK = last_report(number=1_000_001, p_mine=0.0, n_views=0, classification="unknown")


@pytest.mark.parametrize(
    ("reports", "holds"),
    [
        ([last_report(p_mine=0.3), last_report()], True),
        ([last_report(), last_report(p_mine=0.3)], False),
        ([last_report(longitude_deg=5.0501)], False),
        ([last_report(longitude_deg=-5.05)], False),
        ([last_report(time_s=1_700_000_001.4)], False),
        ([last_report(classification="sphere")], False),
        ([last_report(depth_m=-12.0)], False),
        ([last_report(length_m=0.5)], False),
        ([last_report(n_views=2)], False),
        ([last_report(), last_report(number=4)], False),
        ([last_report(), EARLY, TAKEN_BACK], True),
        ([last_report(), EARLY], False),
        ([], False),
    ],
)
def test_a_vehicle_is_left_with_the_contacts_that_are_stored(reports: list[Report], holds: bool) -> None:
    rule = ReportedAsStored(device="vehicle", min_p_mine=0.2)
    assert reported_as_stored(rule, [STORED], reports)[2] is holds
    assert not reported_as_stored(rule, [], reports)[2]
