"""Verdicts: what was found is held against what was expected, and no evidence is never a pass."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from typing import Any
from xml.etree import ElementTree

import pytest

from sim_replay.hil.evidence import Line, Report, Restart
from sim_replay.hil.rules import (
    AnnouncedOnce,
    AnswersStop,
    AsReplayed,
    ContactTimes,
    CounterRule,
    DeviceRule,
    ExitCode,
    Expectation,
    FreshHealth,
    LineRule,
    NoticeRule,
    RecordedWhole,
    Reopened,
    ReportRule,
    Rule,
    SameCount,
    SettingsRule,
    StoredAsAnnounced,
    SummaryRule,
    TargetsFound,
    Watched,
)
from sim_replay.hil.verdict import Evidence, Placed, as_junit, contacts_of, judge, judged, table_rows, targets_of

LATITUDE_DEG, LONGITUDE_DEG = 43.0, 5.0
METRES_PER_DEGREE = 111_100.0


def placed(north_m: float, p_mine: float = 0.9, classification: str = "cylinder") -> Placed:
    return Placed(LATITUDE_DEG + north_m / METRES_PER_DEGREE, LONGITUDE_DEG, p_mine, classification)


def evidence(**changes: Any) -> Evidence:
    sound = Evidence(
        exit_code=0,
        lines=[
            Line(1.0, "notice port_up: port 'sonar' is up"),
            Line(5.0, "notice port_down: gone"),
            Line(6.0, "notice port_up: back"),
        ],
        reports={
            "sonar": [
                Report(0.1, "settings", {"applied": "on, 30 m"}),
                Report(5.0, "mended", {"do": "unplug"}),
                Report(5.05, "reopened", {"after_s": 0.05}),
                Report(9.0, "counters", {"device.skipped": 2}),
            ]
        },
        summary={
            "pings": 148,
            "area": {"km2": 0.5},
            "counters": {"port.a.refused.length": 2, "port.a.refused.checksum": 3, "ping.gap": 1},
        },
        contacts=[placed(0.0), placed(10.2, 0.6), placed(20.0, 0.01, "clutter")],
        targets=[placed(0.5), placed(10.0)],
        replayed=[placed(0.1), placed(10.0, 0.7)],
        stopped_s=9.0,
        ended_s=9.5,
    )
    return sound._replace(**changes)


def passes(rule: Rule, **changes: Any) -> bool:
    return judge(Expectation(test="what is looked at", expected=rule), evidence(**changes)).passed


@pytest.mark.parametrize(
    ("stopped_s", "texts", "holds"),
    [
        (10.0, {10.4: "INFO auv_mcm.shell.service: stopping: 0 pings still queued"}, True),
        (10.0, {13.0: "INFO auv_mcm.shell.service: stopping: 0 pings still queued"}, False),
        (10.0, {9.0: "INFO auv_mcm.shell.service: stopping: 0 pings still queued", 10.1: "something else"}, False),
        (None, {10.4: "INFO auv_mcm.shell.service: stopping: 0 pings still queued"}, False),
    ],
)
def test_a_service_answers_when_it_announces_its_stop_soon(
    stopped_s: float | None, texts: dict[float, str], holds: bool
) -> None:
    lines = [Line(at_s, text) for at_s, text in texts.items()]
    assert passes(AnswersStop(within_s=2.0), lines=lines, stopped_s=stopped_s) is holds


def test_an_exit_code_is_what_it_is_and_a_killed_service_has_none() -> None:
    assert passes(ExitCode())
    assert not passes(ExitCode(), exit_code=4)
    assert passes(ExitCode(code=4), exit_code=4)
    assert not passes(ExitCode(), exit_code=None)


def test_a_service_that_ends_unasked_and_calls_it_a_success_gave_up() -> None:
    assert not passes(ExitCode(), stopped_s=None)
    assert passes(ExitCode(code=4), exit_code=4, stopped_s=None)
    assert passes(ExitCode(code=-9), exit_code=-9, stopped_s=None)


def test_counters_are_summed_by_pattern_and_absent_ones_are_zero() -> None:
    assert passes(CounterRule(name="port.a.refused.*", at_least=5, at_most=5))
    assert passes(CounterRule(name="ping.gap", at_least=1))
    assert passes(CounterRule(name="nothing", at_most=0))
    assert not passes(CounterRule(name="ping.gap", at_most=0))


def test_without_a_summary_nothing_about_its_numbers_holds() -> None:
    assert not passes(CounterRule(name="nothing", at_most=0), summary={})
    assert not passes(SummaryRule(key="pings", at_most=1000), summary={})
    assert not passes(SummaryRule(key="unheard_of", at_least=-1e9))
    assert passes(SummaryRule(key="pings", at_least=148, at_most=148))
    assert passes(SummaryRule(key="area.km2", at_least=0.5, at_most=0.5))
    assert not passes(SummaryRule(key="area.km2.more", at_least=-1e9))


def test_notices_and_lines_are_counted_within_their_time() -> None:
    assert passes(NoticeRule(code="port_up", at_least=2, at_most=2))
    assert passes(NoticeRule(code="port_up", at_least=1, at_most=1, between_s=(5.0, 7.0)))
    assert not passes(NoticeRule(code="port_up", at_least=1, between_s=(2.0, 5.0)))
    assert not passes(NoticeRule(code="port", at_least=1))
    assert passes(LineRule(matching=r"is up$|gone", at_least=2, at_most=2))


def test_nothing_is_known_of_a_time_that_the_run_did_not_come_to() -> None:
    rules: list[Rule] = [
        NoticeRule(code="port_down", at_most=0, between_s=(7.0, 20.0)),
        LineRule(matching="gone", at_most=0, between_s=(7.0, 20.0)),
        ReportRule(device="sonar", what="mended", at_most=0, between_s=(7.0, 20.0)),
    ]
    for rule in rules:
        assert passes(rule)
        assert not passes(rule, ended_s=6.5)


def test_what_devices_report_counts() -> None:
    assert passes(SettingsRule(device="sonar", containing="30 m", at_least=1, at_most=1))
    assert not passes(SettingsRule(device="sonar", containing="60 m", at_least=1))
    assert passes(DeviceRule(device="sonar", counter="device.skipped", at_most=2))
    assert not passes(DeviceRule(device="sonar", counter="device.skipped", at_most=1))


def test_of_a_device_that_died_without_its_counters_nothing_holds() -> None:
    rule = DeviceRule(device="sonar", counter="device.skipped", at_most=2)
    assert not passes(rule, reports={"sonar": [Report(0.1, "settings", {"applied": "on, 30 m"})]})
    assert passes(rule, reports={"sonar": [Report(9.0, "counters", {})]})


def test_a_run_that_was_not_that_of_its_scenario_fails_whatever_it_expects() -> None:
    expectations = [Expectation(test="it ends", expected=ExitCode())]
    assert [verdict.passed for verdict in judged(expectations, evidence())] == [True]
    of_another = judged(expectations, evidence(undone=["1 of 1 faults 'unplug' of 'nav' did not begin"]))
    assert [verdict.passed for verdict in of_another] == [True, False]
    assert "'unplug' of 'nav'" in of_another[1].found


def test_a_service_that_ends_unasked_fails_a_run_that_does_not_judge_its_end() -> None:
    silent = [Expectation(test="no notice is raised", expected=NoticeRule(code="port_unreadable", at_most=0))]
    crashed = {"exit_code": 70, "stopped_s": None, "ended_s": 2.0}
    (_, verdict) = judged(silent, evidence(**crashed))
    assert (verdict.passed, verdict.found) == (False, "the service ended by itself after 2.0 s, exit code 70")
    judging = [*silent, Expectation(test="it gives up", expected=ExitCode(code=70))]
    assert all(each.passed for each in judged(judging, evidence(**crashed)))
    assert all(each.passed for each in judged(silent, evidence(**crashed, killed_s=1.0)))


def test_strict_readers_of_xml_take_what_a_scenario_says_in_any_characters() -> None:
    named = Expectation(test="no \x1b[31m & <\x00>", expected=LineRule(matching="\x1b", at_least=1))
    suite = ElementTree.fromstring(as_junit("odd\x07", judged([named], evidence()), 1.8e9, 12.34567))
    assert [part.tag for part in suite] == ["properties", "testcase", "system-out", "system-err"]
    assert [case.get("name") for case in suite.iter("testcase")] == ["no \\x1b[31m & <\\x00>"]
    assert (suite.get("name"), suite.get("failures")) == ("odd\\x07", "1")
    # what JUnit.xsd, which many readers hold a report against, requires
    assert set(suite.keys()) >= {"name", "timestamp", "hostname", "tests", "failures", "errors", "time"}
    assert (suite.get("timestamp"), suite.get("time")) == ("2027-01-15T08:00:00", "12.346")
    assert set(suite[1].keys()) == {"classname", "name", "time"}
    assert set(suite[1][0].keys()) == {"type", "message"}


@pytest.mark.parametrize(
    ("times", "holds"),
    [
        (["2026-01-01T00:00:05.000Z", "2026-01-01T00:00:10.500Z"], True),
        (["2026-01-01T00:00:05.000Z", "2026-01-01T01:00:05.000Z"], False),
        (["2025-12-31T23:59:58.000Z"], False),
        ([None], False),
        ([], False),
    ],
)
def test_contacts_have_times_of_the_run(times: list[str | None], holds: bool) -> None:
    began_s = datetime(2026, 1, 1, tzinfo=UTC).timestamp()
    stored = [{"properties": {"time": time}} for time in times]
    assert passes(ContactTimes(), stored=stored, utc_s=(began_s, began_s + 10.0)) is holds
    assert not passes(ContactTimes(), stored=stored), "nobody knows when it ran"


@pytest.mark.parametrize(
    ("reports", "passed"),
    [
        ([("mended", {"do": "unplug"}), ("reopened", {"after_s": 0.1})], True),
        ([("mended", {"do": "unplug"}), ("reopened", {"after_s": 0.2})], False),
        ([("mended", {"do": "power_off"})], False),
        ([("mended", {"do": "garbage"})], False),
        ([("mended", {"do": "unplug"}), ("reopened", {"after_s": 0.0}), ("mended", {"do": "unplug"})], False),
    ],
)
def test_a_wire_has_to_be_opened_in_time_after_every_return(
    reports: list[tuple[str, dict[str, Any]]], passed: bool
) -> None:
    found = [Report(float(index), what, details) for index, (what, details) in enumerate(reports)]
    assert passes(Reopened(device="sonar", within_s=0.1), reports={"sonar": found}) == passed


def test_a_target_needs_a_likely_contact_of_its_own_nearby() -> None:
    assert passes(TargetsFound(within_m=1.0, min_p_mine=0.5, at_least=2))
    assert passes(TargetsFound(within_m=1.0, min_p_mine=0.7, at_least=1, at_most=1))
    assert passes(TargetsFound(within_m=0.3, min_p_mine=0.5, at_least=1, at_most=1))
    both_at_one = [placed(0.0), placed(0.2)]
    assert passes(
        TargetsFound(within_m=1.0, min_p_mine=0.5, at_least=1, at_most=1), targets=both_at_one, contacts=[placed(0.1)]
    )
    assert not passes(TargetsFound(within_m=1.0, min_p_mine=0.5, at_least=1), contacts=[])


AS_REPLAYED = AsReplayed(within_m=0.5, min_p_mine=0.3, p_mine_within=0.15)


def test_contacts_as_replayed_agree_in_place_probability_and_class() -> None:
    assert passes(AS_REPLAYED)
    assert not passes(AS_REPLAYED, contacts=[placed(0.0), placed(10.6, 0.7)])
    assert not passes(AS_REPLAYED, contacts=[placed(0.0), placed(10.0, 0.5)])
    assert not passes(AS_REPLAYED, contacts=[placed(0.0), placed(10.0, 0.7, "sphere")])
    assert not passes(AS_REPLAYED, contacts=[placed(0.0)])
    assert not passes(AS_REPLAYED, contacts=[placed(0.0), placed(10.0, 0.7), placed(30.0)])


def test_contacts_at_the_threshold_of_probability_need_a_partner_but_no_luck() -> None:
    assert passes(AS_REPLAYED, replayed=[placed(0.0, 0.31)], contacts=[placed(0.0, 0.29)])
    assert passes(AS_REPLAYED, replayed=[placed(0.0), placed(9.0, 0.29)], contacts=[placed(0.0), placed(9.0, 0.31)])


def test_a_replay_without_contacts_compares_nothing_and_fails() -> None:
    assert not passes(AS_REPLAYED, replayed=[], contacts=[])
    assert not passes(AS_REPLAYED, replayed=None)


def test_the_table_shows_expectation_and_outcome() -> None:
    rules: list[Rule] = [ExitCode(), NoticeRule(code="port_down", at_most=0), SummaryRule(key="none", at_least=1)]
    rows = table_rows([judge(Expectation(test="ends when stopped", expected=rule), evidence()) for rule in rules])
    assert [row[0] for row in rows] == ["passed", "FAILED", "FAILED"]
    assert rows[1][2] == "at most 0 notices port_down"
    assert rows[1][3].endswith("1")
    assert rows[2][3].endswith("not in summary.json")


def test_contacts_and_targets_are_read_from_their_files() -> None:
    feature = {"geometry": {"coordinates": [5.0, 43.0]}, "properties": {"p_mine": 0.5, "class": "wedge"}}
    assert contacts_of({"features": [feature]}) == [Placed(43.0, 5.0, 0.5, "wedge")]
    scene_objects = [
        {"lat": 43.0, "lon": 5.0, "is_target": True, "kind": "wedge"},
        {"lat": 0.0, "lon": 0.0, "is_target": False, "kind": "rock"},
    ]
    assert targets_of({"objects": scene_objects}) == [Placed(43.0, 5.0, 1.0, "wedge")]


@pytest.mark.parametrize(("counted", "holds"), [(2, True), (3, False)])
def test_a_counter_has_to_be_what_the_other_side_counted(counted: int, holds: bool) -> None:
    same = SameCount(name="vehicle.reports_acknowledged", device="sonar", counter="device.skipped")
    assert passes(same, summary={"counters": {"vehicle.reports_acknowledged": counted}}) is holds
    assert not passes(same, summary={"counters": {}})
    nothing = SameCount(name="vehicle.reports_acknowledged", device="sonar", counter="vehicle.reports")
    assert not passes(nothing, summary={"counters": {}}), "of nothing on either side"


@pytest.mark.parametrize(
    ("announced", "holds"),
    [
        ([(7, "C00001"), (7, "C00002"), (9, "C00001")], True),
        ([(7, "C00001"), (9, "C00001"), (7, "C00001")], False),
        ([], False),
    ],
)
def test_no_contact_is_announced_twice_for_the_same_event(announced: list[tuple[int, str]], holds: bool) -> None:
    records = [{"event": number, "contact": {"properties": {"id": name}}} for number, name in announced]
    journal = b"".join(json.dumps(record).encode() + b"\n" for record in records)
    assert passes(AnnouncedOnce(), journal=journal) is holds
    assert passes(AnnouncedOnce(), journal=journal + b'{"event": 7') is holds, "what was cut off counts for nothing"


@pytest.mark.parametrize(("held", "holds"), [({"a": 900}, True), ({"a": 899}, False), ({}, False)])
def test_the_recording_has_to_hold_all_that_came_in(held: dict[str, int], holds: bool) -> None:
    came = {"counters": {"port.a.link.bytes_in": 900}}
    assert passes(RecordedWhole(port="a"), summary=came, recorded_bytes=held) is holds
    assert not passes(RecordedWhole(port="b"), summary=came, recorded_bytes=held), "nothing of it came in"


def feature(name: str, p_mine: float = 0.69, latitude_deg: float = 43.0) -> dict[str, Any]:
    properties = {"id": name, "p_mine": p_mine, "time": "2026-01-01T00:00:00.000Z"}
    return {"geometry": {"coordinates": [5.0, latitude_deg]}, "properties": properties}


@pytest.mark.parametrize(
    ("announced", "stored", "holds"),
    [
        ([feature("C00001")], [feature("C00001")], True),
        ([feature("C00001"), feature("C00001", 0.99)], [feature("C00001", 0.99)], True),
        ([feature("C00001")], [feature("C00001", 0.99)], False),
        ([feature("C00001")], [feature("C00001", latitude_deg=43.0001)], False),
        ([feature("C00001"), feature("C00002")], [feature("C00001")], False),
        ([feature("C00001")], [feature("C00001"), feature("C00002")], False),
        ([], [], False),
    ],
)
def test_contacts_have_to_be_stored_as_they_were_announced_last(
    announced: list[dict[str, Any]], stored: list[dict[str, Any]], holds: bool
) -> None:
    records = [{"event": number, "contact": contact} for number, contact in enumerate(announced)]
    found = {"journal": b"".join(json.dumps(record).encode() + b"\n" for record in records), "stored": stored}
    lines = [Line(5.0, "contact C00001 new: cylinder, p_mine 0.69, 43.0 5.0, 1 views") for _ in announced]
    assert passes(StoredAsAnnounced(), lines=lines, **found) is holds
    assert passes(StoredAsAnnounced(), lines=lines, restarts=[Restart(6.0, 7.0)], **found) is holds
    assert not passes(StoredAsAnnounced(), lines=lines, restarts=[Restart(4.0, 4.5)], **found), "none to forget"


@pytest.mark.parametrize(("age_s", "holds"), [(0.5, True), (-0.5, True), (3600.0, False), (math.nan, False)])
def test_health_has_to_state_the_time_of_the_services_end(age_s: float, holds: bool) -> None:
    assert passes(FreshHealth(within_s=5.0), health_age_s=age_s) is holds


@pytest.mark.parametrize(
    ("reported", "holds"),
    [
        ({1.0: "READY=1", 1.1: "WATCHDOG=1", 3.0: "WATCHDOG=1", 5.0: "STOPPING=1"}, True),
        ({1.0: "READY=1", 1.1: "WATCHDOG=1", 5.0: "STOPPING=1"}, False),
        ({1.0: "READY=1", 1.1: "WATCHDOG=1", 3.0: "WATCHDOG=1"}, False),
        ({1.1: "WATCHDOG=1", 3.0: "WATCHDOG=1", 5.0: "STOPPING=1"}, False),
        ({}, False),
    ],
)
def test_signs_of_life_have_to_come_as_often_as_the_manager_asks(reported: dict[float, str], holds: bool) -> None:
    managed = [Line(at_s, state) for at_s, state in reported.items()]
    assert passes(Watched(watchdog_s=3.0), managed=managed) is holds
