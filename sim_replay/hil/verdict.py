"""Judge whether a run met its expectations."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from typing import Any, Final, NamedTuple
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from auv_mcm.clean_text import clean
from auv_mcm.geometry.geodesy import LocalFrame
from sim_replay.hil.announced import CONTACT, announced_in, stored_otherwise
from sim_replay.hil.evidence import Line, Report, Restart
from sim_replay.hil.resources import Sample, steady
from sim_replay.hil.rules import (
    AboveFloor,
    AnnouncedOnce,
    AnswersStop,
    AsReplayed,
    ContactTimes,
    Counted,
    CounterRule,
    DeviceRule,
    EndsWithin,
    ExitCode,
    Expectation,
    FreshHealth,
    InsideFence,
    JoinedAsTwin,
    LeftAlone,
    LineRule,
    NoticeRule,
    OfDevice,
    OwnPlanAtEnd,
    Passed,
    RecordedWhole,
    Reopened,
    ReportedAsStored,
    ReportedInTime,
    ReportRule,
    Restarted,
    Rule,
    SameCount,
    SettingsRule,
    Sharper,
    Silence,
    Steady,
    StoredAsAnnounced,
    SummaryRule,
    TargetsFound,
    Watched,
    Window,
)
from sim_replay.hil.service_manager import watched
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

_NOT_IN_SUMMARY: Final = "not in summary.json"
_STOPPING: Final = re.compile(r"\bstopping: ")


class Placed(NamedTuple):
    """Place a contact, or a target of the truth (p_mine 1)."""

    latitude_deg: float
    longitude_deg: float
    p_mine: float
    classification: str


class Evidence(NamedTuple):
    """Hold the evidence of a run. exit_code: None if the service had to be killed. summary: {} if it wrote none.

    targets: of the truth; replayed: contacts of a direct replay, None where nobody asked for it. killed_s: when the
    service was killed by intent; stopped_s: when it was requested to stop. fence_deg: of the service's configuration.
    restarts: of the service, by intent. not_joined: what is wrong with the joined replay, None where nobody asked.
    ended_s: when the service had ended. lost_s: what each restart cost of the recording. samples: of its processes.
    stored: features of contacts.geojson. journal: contacts.jsonl. health_age_s: of what health.json states, at the
    service's end. managed: what the service reported to its manager. recorded_bytes: of input, by port.
    undone: what the run did not do although its scenario says so, in words. utc_s: between
    which the processes ran, by this computer.
    """

    exit_code: int | None
    lines: Sequence[Line]
    reports: Mapping[str, Sequence[Report]]
    summary: Mapping[str, Any]
    contacts: Sequence[Placed]
    targets: Sequence[Placed]
    replayed: Sequence[Placed] | None
    killed_s: float | None = None
    stopped_s: float | None = None
    fence_deg: Sequence[tuple[float, float]] = ()
    restarts: Sequence[Restart] = ()
    not_joined: Sequence[str] | None = None
    ended_s: float = math.nan
    lost_s: Sequence[float] = ()
    samples: Sequence[Sample] = ()
    stored: Sequence[Mapping[str, Any]] = ()
    journal: bytes = b""
    health_age_s: float = math.nan
    managed: Sequence[Line] = ()
    recorded_bytes: Mapping[str, int] = {}
    undone: Sequence[str] = ()
    utc_s: tuple[float, float] = (math.nan, math.nan)


class Verdict(NamedTuple):
    """State one expectation's outcome, in words for a person."""

    test: str
    expected: str
    found: str
    passed: bool


def judged(expectations: Sequence[Expectation], evidence: Evidence) -> list[Verdict]:
    """Judge a run: by each expectation, and as failed where it was not the run that its scenario describes."""
    verdicts = [judge(expectation, evidence) for expectation in expectations]
    undone = [*evidence.undone]
    is_judged = any(isinstance(expectation.expected, ExitCode) for expectation in expectations)
    if evidence.stopped_s is None and evidence.killed_s is None and not is_judged:
        undone.append(f"the service ended by itself after {evidence.ended_s:.1f} s, exit code {evidence.exit_code}")
    if undone:
        expected = "every fault begins, and every fake device and the service last until the end"
        verdicts.append(Verdict("the run is that of the scenario", expected, "; ".join(undone), False))
    return verdicts


def judge(expectation: Expectation, evidence: Evidence) -> Verdict:
    """Judge whether the evidence meets the expectation."""
    expected, found, passed = _judged(expectation.expected, evidence)
    return Verdict(expectation.test, expected, found, passed)


def table_rows(verdicts: Sequence[Verdict]) -> list[tuple[str, str, str, str]]:
    """Give a row per verdict: passed or FAILED, test, expectation, outcome."""
    return [("passed" if each.passed else "FAILED", each.test, each.expected, each.found) for each in verdicts]


def as_junit(name: str, verdicts: Sequence[Verdict], began_s: float, took_s: float) -> bytes:
    """Format the verdicts of a scenario as a JUnit test suite: a test case each, failures with what was found.

    It has every attribute and element that strict readers ask for, in their order (windyroad's JUnit.xsd). Characters
    that XML forbids are written out. began_s: UTC.
    """
    n_failed = sum(not verdict.passed for verdict in verdicts)
    counts = {"tests": str(len(verdicts)), "failures": str(n_failed), "errors": "0", "skipped": "0"}
    began = f"{datetime.fromtimestamp(began_s, UTC):%Y-%m-%dT%H:%M:%S}"
    about = {"name": clean(name), "timestamp": began, "hostname": "localhost", **counts, "time": f"{took_s:.3f}"}
    suite = Element("testsuite", about)
    SubElement(suite, "properties")
    for verdict in verdicts:
        case = SubElement(suite, "testcase", classname=f"hil.{clean(name)}", name=clean(verdict.test), time="0")
        if not verdict.passed:
            found = clean(f"expected: {verdict.expected}; found: {verdict.found}")
            SubElement(case, "failure", type="expectation", message=found)
    for output in ("system-out", "system-err"):
        SubElement(suite, output)
    document: bytes = tostring(suite, encoding="utf-8", xml_declaration=True)
    return document


def contacts_of(geojson: Mapping[str, Any]) -> list[Placed]:
    """Read contacts of a contacts.geojson."""
    placed = []
    for feature in geojson["features"]:
        longitude_deg, latitude_deg = feature["geometry"]["coordinates"][:2]
        placed.append(
            Placed(latitude_deg, longitude_deg, feature["properties"]["p_mine"], feature["properties"]["class"])
        )
    return placed


def targets_of(truth: Mapping[str, Any]) -> list[Placed]:
    """Read targets of a truth.json."""
    return [
        Placed(scene_object["lat"], scene_object["lon"], 1.0, scene_object["kind"])
        for scene_object in truth["objects"]
        if scene_object["is_target"]
    ]


def _ended(rule: ExitCode, evidence: Evidence) -> tuple[str, str, bool]:
    """Judge how the service ended. One that ended unasked and calls that a success gave the mission up."""
    code = evidence.exit_code
    unasked = " without a request to stop" if evidence.stopped_s is None else ""
    found = "had to be killed" if code is None else f"exit code {code}{unasked}"
    return f"exit code {rule.code}", found, code == rule.code and not (code == 0 and unasked)


def _answered(rule: AnswersStop, evidence: Evidence) -> tuple[str, str, bool]:
    expected = f"it announces within {rule.within_s:g} s that it stops"
    stopped_s = evidence.stopped_s
    if stopped_s is None:
        return expected, "it was not requested to stop", False
    after_s = [
        line.at_s - stopped_s for line in evidence.lines if line.at_s >= stopped_s and _STOPPING.search(line.text)
    ]
    return (
        expected,
        f"after {after_s[0]:.2f} s" if after_s else "it announced nothing",
        bool(after_s) and after_s[0] <= rule.within_s,
    )


def _announced_once(journal: bytes) -> tuple[str, str, bool]:
    announced = Counter(announced_in(journal))
    twice = [f"{contact_id} of event {number}" for (number, contact_id), n in announced.items() if n > 1]
    found = f"{', '.join(twice) or 'none'} of {len(announced)} twice"
    return "no contact is announced twice for the same event", found, bool(announced) and not twice


def _on_disk(rule: AnnouncedOnce | StoredAsAnnounced | RecordedWhole, evidence: Evidence) -> tuple[str, str, bool]:
    match rule:
        case AnnouncedOnce():
            return _announced_once(evidence.journal)
        case StoredAsAnnounced():
            return _stored_as_announced(evidence)
        case RecordedWhole():
            came = evidence.summary.get("counters", {}).get(f"port.{rule.port}.link.bytes_in", 0)
            held = evidence.recorded_bytes.get(rule.port, 0)
            return f"the recording holds all bytes of port '{rule.port}'", f"{held} of {came}", held == came > 0


def _stored_as_announced(evidence: Evidence) -> tuple[str, str, bool]:
    until_s = evidence.restarts[-1].killed_s if evidence.restarts else math.inf
    n_before = len({match[1] for line in evidence.lines if line.at_s < until_s and (match := CONTACT.match(line.text))})
    problems = stored_otherwise(evidence.journal, evidence.stored)
    problems += [] if n_before else ["none was announced before the last kill"]
    found = "; ".join(problems) or f"{len(evidence.stored)} contacts, {n_before} of them announced before the last kill"
    return "contacts are stored as they were announced last", found, not problems


def _times_of_contacts(rule: ContactTimes, evidence: Evidence) -> tuple[str, str, bool]:
    texts = [feature["properties"]["time"] for feature in evidence.stored]
    times_s = [math.inf if text is None else datetime.fromisoformat(text).timestamp() for text in texts]
    off_s = [max(evidence.utc_s[0] - time_s, time_s - evidence.utc_s[1], 0.0) for time_s in times_s]
    found = f"{len(off_s)} contacts, {max(off_s, default=0.0):.1f} s outside at most"
    expected = f"contacts have times of the run, within {rule.within_s:g} s"
    return expected, found, bool(off_s) and max(off_s) <= rule.within_s


def _restarted(rule: Restarted, evidence: Evidence) -> tuple[str, str, bool]:
    expected = f"ready within {rule.ready_within_s:g} s of each kill, {rule.lost_s:g} s of the recording lost at most"
    if not evidence.restarts:
        return expected, "it was not started again", False
    slowest_s = max(restart.ready_s - restart.killed_s for restart in evidence.restarts)
    lost_s = max(evidence.lost_s, default=math.inf)
    found = f"{len(evidence.restarts)} kills: ready after {slowest_s:.2f} s, {lost_s:.2f} s lost, at most"
    return expected, found, slowest_s <= rule.ready_within_s and lost_s <= rule.lost_s


def _judged(rule: Rule, evidence: Evidence) -> tuple[str, str, bool]:
    match rule:
        case ExitCode():
            return _ended(rule, evidence)
        case EndsWithin():
            took_s = evidence.ended_s - (math.nan if evidence.stopped_s is None else evidence.stopped_s)
            return f"it ends within {rule.within_s:g} s", f"after {took_s:.2f} s", took_s <= rule.within_s
        case AnswersStop():
            return _answered(rule, evidence)
        case CounterRule():
            counters = evidence.summary.get("counters", {})
            value = float(sum(count for name, count in counters.items() if fnmatchcase(name, rule.name)))
            return _limited(rule, value, rule.name, unknown="" if evidence.summary else _NOT_IN_SUMMARY)
        case SummaryRule():
            reported: Any = evidence.summary
            for part in rule.key.split("."):
                reported = reported.get(part) if isinstance(reported, Mapping) else None
            if not isinstance(reported, int | float):
                return _limited(rule, math.nan, rule.key, unknown=_NOT_IN_SUMMARY)
            return _limited(rule, float(reported), rule.key)
        case NoticeRule():
            matching = re.compile(rf"^notice {re.escape(rule.code)}: ")
            return _limited_within(rule, _n_lines(evidence, matching, rule.between_s), f"notices {rule.code}", evidence)
        case LineRule():
            n_lines = _n_lines(evidence, re.compile(rule.matching), rule.between_s)
            return _limited_within(rule, n_lines, f"lines with '{rule.matching}'", evidence)
        case TargetsFound():
            likely = [contact for contact in evidence.contacts if contact.p_mine >= rule.min_p_mine]
            n_found = len(_matched(evidence.targets, likely, rule.within_m))
            what = f"of {len(evidence.targets)} targets with p_mine >= {rule.min_p_mine:g} within {rule.within_m:g} m"
            return _limited(rule, n_found, what)
        case AsReplayed():
            return _as_replayed(rule, evidence)
        case JoinedAsTwin():
            problems = evidence.not_joined
            found = f"{len(evidence.restarts)} cuts: {'; '.join(problems or ()) or 'to the byte'}"
            return "the joined replay is that of its undisturbed twin", found, problems is not None and not problems
        case FreshHealth():
            age_s = evidence.health_age_s
            expected = f"health.json is at most {rule.within_s:g} s off the service's end"
            return expected, f"{age_s:.1f} s before it", abs(age_s) <= rule.within_s
        case Watched():
            return watched(rule, evidence.managed)
        case AnnouncedOnce() | StoredAsAnnounced() | RecordedWhole():
            return _on_disk(rule, evidence)
        case ContactTimes():
            return _times_of_contacts(rule, evidence)
        case Restarted():
            return _restarted(rule, evidence)
        case Steady():
            return steady(rule.share, evidence.samples)
        case _:
            return _of_device(rule, evidence, evidence.reports[rule.device])


def _of_device(rule: OfDevice, evidence: Evidence, reports: Sequence[Report]) -> tuple[str, str, bool]:
    """Judge what a device reported."""
    match rule:
        case SettingsRule():
            reported = [str(report.details["applied"]) for report in reports if report.what == "settings"]
            n_explained = sum(rule.containing in settings for settings in reported)
            return _limited(rule, n_explained, f"times '{rule.device}' is set to '{rule.containing}'")
        case DeviceRule():
            return _limited(
                rule,
                _count_of(reports, rule.counter),
                f"{rule.counter} of '{rule.device}'",
                unknown="" if any(report.what == "counters" for report in reports) else "it reported no counters",
            )
        case SameCount():
            counted, seen = evidence.summary.get("counters", {}).get(rule.name, 0), _count_of(reports, rule.counter)
            expected = f"{rule.name} is {rule.counter} of '{rule.device}', and more than 0"
            return expected, f"{counted:g} and {seen:g}", counted == seen > 0
        case Reopened():
            return _reopened(rule, reports)
        case ReportRule():
            first_s, last_s = rule.between_s or (-math.inf, math.inf)
            reports = [report for report in reports if report.what == rule.what and first_s <= report.at_s <= last_s]
            n_reports = sum(rule.containing in json.dumps(report.details) for report in reports)
            containing = f" with {rule.containing}" if rule.containing else ""
            return _limited_within(rule, n_reports, f"times '{rule.device}' reports {rule.what}{containing}", evidence)
        case Passed():
            low_m, high_m = rule.ground_range_m
            what = (
                f"passes under command at {low_m:g} to {high_m:g} m, {rule.other_look_deg:g} degrees or more from "
                "looks before"
            )
            return _limited(rule, n_passed(rule, reports), what)
        case Sharper():
            what = "contacts with one view first, with more last, and then nearer to the truth; no mine talked down"
            targets_deg = [target[:2] for target in evidence.targets]
            return _limited(rule, n_sharper(reports, targets_deg), what)
        case ReportedInTime():
            return reported_in_time(rule, evidence.lines, reports)
        case ReportedAsStored():
            return reported_as_stored(rule, evidence.stored, reports)
        case LeftAlone():
            return left_alone(rule, reports)
        case InsideFence():
            return inside_fence(evidence.fence_deg, reports)
        case AboveFloor():
            return above_floor(rule, reports)
        case OwnPlanAtEnd():
            return own_plan_at_end(rule, reports)
        case Silence():
            return own_plan_after(rule, evidence.killed_s, reports)


def _count_of(reports: Sequence[Report], counter: str) -> float:
    """Read a counter of a device, 0 where it is missing."""
    return float(next((report.details for report in reports if report.what == "counters"), {}).get(counter, 0))


def _limited(rule: Counted, value: float, what: str, *, unknown: str = "") -> tuple[str, str, bool]:
    """Hold a number against its bounds. unknown: why there is none, which never passes."""
    low, high = rule.at_least, rule.at_most
    if low is not None and low == high:
        limits = f"{low:g}"
    elif low is not None and high is not None:
        limits = f"{low:g} to {high:g}"
    else:
        limits = f"at least {low:g}" if low is not None else f"at most {high:g}"
    passed = not unknown and (low is None or value >= low) and (high is None or value <= high)
    return f"{limits} {what}", unknown or f"{value:g}", passed


def _limited_within(
    rule: NoticeRule | LineRule | ReportRule, value: float, what: str, evidence: Evidence
) -> tuple[str, str, bool]:
    """Hold a number of a window against its bounds; of one that the run did not come to, nothing is known."""
    is_over = rule.between_s is not None and rule.between_s[0] > evidence.ended_s
    unknown = f"the service had ended after {evidence.ended_s:.1f} s" if is_over else ""
    return _limited(rule, value, what + _window(rule.between_s), unknown=unknown)


def _n_lines(evidence: Evidence, matching: re.Pattern[str], between_s: Window | None) -> int:
    first_s, last_s = between_s or (-math.inf, math.inf)
    return sum(first_s <= line.at_s <= last_s and matching.search(line.text) is not None for line in evidence.lines)


def _window(between_s: Window | None) -> str:
    return "" if between_s is None else f" from {between_s[0]:g} to {between_s[1]:g} s"


def _reopened(rule: Reopened, reports: Sequence[Report]) -> tuple[str, str, bool]:
    expected = f"'{rule.device}' is open again within {rule.within_s:g} s of every return"
    n_returns = sum(report.what == "mended" and report.details["do"] in ("unplug", "power_off") for report in reports)
    after_s = [float(report.details["after_s"]) for report in reports if report.what == "reopened"]
    if not n_returns:
        return expected, "it was never plugged in again", False
    if len(after_s) < n_returns:
        return expected, f"not opened after {n_returns - len(after_s)} of {n_returns} returns", False
    return expected, "after " + ", ".join(f"{value:.3f}" for value in after_s) + " s", max(after_s) <= rule.within_s


def _as_replayed(rule: AsReplayed, evidence: Evidence) -> tuple[str, str, bool]:
    """Compare contacts with those of a replay.

    Pairs are matched among all contacts, so that one whose probability lies at the threshold does not count as missing.
    """
    expected = (
        f"contacts as replayed, within {rule.within_m:g} m and {rule.p_mine_within:g} in p_mine, of the same class"
    )
    replayed = evidence.replayed or ()
    problems = []
    partner = {
        first: (second, distance_m)
        for first, second, distance_m in _matched(replayed, evidence.contacts, rule.within_m)
    }
    n_likely = 0
    largest_m = largest_p = 0.0
    for index, contact in enumerate(replayed):
        if contact.p_mine < rule.min_p_mine:
            continue
        n_likely += 1
        if index not in partner:
            problems.append(
                f"a {contact.classification} with p_mine {contact.p_mine:.2f} has none within {rule.within_m:g} m"
            )
            continue
        second, distance_m = partner[index]
        other = evidence.contacts[second]
        largest_m, largest_p = max(largest_m, distance_m), max(largest_p, abs(other.p_mine - contact.p_mine))
        if abs(other.p_mine - contact.p_mine) > rule.p_mine_within:
            problems.append(f"p_mine {other.p_mine:.2f} where {contact.p_mine:.2f} was replayed")
        if other.classification != contact.classification:
            problems.append(f"a {other.classification} where a {contact.classification} was replayed")
    known = {second for second, _ in partner.values()}
    for index, contact in enumerate(evidence.contacts):
        if contact.p_mine >= rule.min_p_mine + rule.p_mine_within and index not in known:
            problems.append(f"a {contact.classification} with p_mine {contact.p_mine:.2f} that was not replayed")
    if not n_likely:
        problems.append(f"the replay has no contact with p_mine >= {rule.min_p_mine:g}: nothing was compared")
    found = f"{n_likely} contacts, at most {largest_m:.2f} m and {largest_p:.2f} in p_mine apart"
    return expected, "; ".join(problems) or found, not problems


def _matched(first: Sequence[Placed], second: Sequence[Placed], gate_m: float) -> list[tuple[int, int, float]]:
    """Match as many pairs as possible, one-to-one and not farther apart than gate_m, with the minimum sum of distances:
    index, index, metres.
    """
    if not first or not second:
        return []
    frame = LocalFrame(latitude_deg=first[0].latitude_deg, longitude_deg=first[0].longitude_deg)
    first_m, second_m = _plane(first, frame), _plane(second, frame)
    apart_m = np.linalg.norm(first_m[:, None, :] - second_m[None, :, :], axis=2)
    out_of_gate_m = 1.0 + gate_m * min(len(first), len(second))  # dearer than all pairs together
    pairs = zip(*linear_sum_assignment(np.where(apart_m <= gate_m, apart_m, out_of_gate_m)), strict=True)
    return [
        (int(row), int(column), float(apart_m[row, column])) for row, column in pairs if apart_m[row, column] <= gate_m
    ]


def _plane(scene_objects: Sequence[Placed], frame: LocalFrame) -> NDArray[np.float64]:
    """Project to the plane, (n, 2) east, north, m."""
    places = np.array([scene_object[:2] for scene_object in scene_objects])
    return frame.to_enu(places[:, 0], places[:, 1], np.zeros(len(scene_objects)))[:, :2]
