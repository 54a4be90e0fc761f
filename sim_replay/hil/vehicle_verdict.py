"""Judge a run with a vehicle: its reports, its commands, the targets it passed, and who commanded."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from itertools import pairwise
from typing import Any, Final, TypeAlias

from auv_mcm.records import EARLY_NUMBERS, contact_number
from sim_replay.hil.evidence import Line, Report
from sim_replay.hil.rules import AboveFloor, LeftAlone, OwnPlanAtEnd, Passed, ReportedAsStored, ReportedInTime, Silence

Judged: TypeAlias = tuple[str, str, bool]
"""What was expected, what was found, and whether it is that."""

_CONTACT: Final = re.compile(r"^contact C(\d+) (?:new|updated): \w+, p_mine (\d\.\d+),")
_FLOOR_WITHIN_S: Final = 1.5  # s around a command whose poses give the floor below it; one comes each second
_AT_TARGET_M: Final = 5.0  # m from a target of the truth: chosen, five times what contacts are off under command
_M_PER_DEG: Final = 111_195.0  # m, of latitude on a sphere of 6371 km
_PLACE_WITHIN_DEG: Final = 3e-6  # 0.3 m of latitude: a wire has steps of 1e-4 minutes
_TIME_WITHIN_S: Final = 0.1  # a wire has steps of milliseconds
_SIZE_WITHIN_M: Final = 0.06  # m: a wire has steps of 0.1 m
_STOPS: Final = ("abort", "stop_plan")  # faults by which a person stops a vehicle
_P_MINE_WITHIN: Final = 0.02  # two digits on the console, a byte on some wires


def reported_in_time(rule: ReportedInTime, lines: Sequence[Line], reports: Sequence[Report]) -> Judged:
    """Check that every contact came within its time; one that changed again by then may come in its later form.

    The service reports to the vehicle before it prints, and a busy disk may come between: a report that is older than
    its line is in time unless it was that of an earlier line of the contact.
    """
    expected = f"every contact with p_mine >= {rule.min_p_mine:g} reaches '{rule.device}' within {rule.within_s:g} s"
    announced = [(line.at_s, int(found[1]), float(found[2])) for line in lines if (found := _CONTACT.match(line.text))]
    reported = [
        (report.at_s, report.details["number"], report.details["p_mine"])
        for report in reports
        if report.what == "contact"
    ]
    late = []
    slowest_s = 0.0
    n_announced = 0
    answered_s: dict[int, float] = {}
    for index, (at_s, number, p_mine) in enumerate(announced):
        since_s = min(at_s - rule.within_s, answered_s.get(number, -math.inf))
        if p_mine < rule.min_p_mine + _P_MINE_WITHIN:
            continue
        n_announced += 1
        after_s = [t - at_s for t, n, p in reported if n == number and abs(p - p_mine) < _P_MINE_WITHIN and t > since_s]
        changed = any(n == number and t <= at_s + rule.within_s for t, n, _ in announced[index + 1 :])
        if after_s and min(after_s) <= rule.within_s:
            slowest_s = max(slowest_s, min(after_s))
            answered_s[number] = at_s + min(after_s)
        elif not changed:
            late.append(f"C{number:05d} of {at_s:.1f} s" + (f" after {min(after_s):.1f} s" if after_s else " never"))
    outcome = "; ".join(late) or f"{n_announced} contacts, the slowest {slowest_s:.2f} s after it was announced"
    return expected, outcome, bool(n_announced) and not late


def reported_as_stored(
    rule: ReportedAsStored, stored: Sequence[Mapping[str, Any]], reports: Sequence[Report]
) -> Judged:
    """Check that a vehicle was left with the contacts that contacts.geojson holds, and with no early one."""
    expected = f"the last reports to '{rule.device}' are the contacts stored, p_mine {rule.min_p_mine:g} or more"
    last = {details["number"]: details for details in _details(reports, "contact")}
    problems = [
        f"early contact {number} was not taken back"
        for number, details in last.items()
        if number > EARLY_NUMBERS and (details["p_mine"] or details["n_views"])
    ]
    features = {contact_number(feature["properties"]["id"]): feature for feature in stored}
    wanted = {n for n, feature in features.items() if feature["properties"]["p_mine"] >= rule.min_p_mine}
    problems += [f"C{number:05d} was not reported" for number in sorted(wanted - last.keys())]
    kept = {number: details for number, details in last.items() if number <= EARLY_NUMBERS}
    problems += [f"C{number:05d} is not stored" for number in sorted(kept.keys() - features.keys())]
    for number in sorted(kept.keys() & features.keys()):
        problems += [f"C{number:05d}: {words}" for words in _differences(kept[number], features[number])]
    if not wanted:
        problems.append("nothing is stored that had to be reported")
    found = "; ".join(problems) or f"{len(kept)} contacts as stored, {len(last) - len(kept)} early ones taken back"
    return expected, found, not problems


def _differences(reported: Mapping[str, Any], feature: Mapping[str, Any]) -> list[str]:
    """List in which values a report differs from a stored contact by more than wires round, in words."""
    properties = feature["properties"]
    longitude_deg, latitude_deg = feature["geometry"]["coordinates"][:2]
    numbers = {
        "latitude_deg": (latitude_deg, _PLACE_WITHIN_DEG),
        "longitude_deg": (longitude_deg, _PLACE_WITHIN_DEG),
        "time_s": (datetime.fromisoformat(properties["time"]).timestamp(), _TIME_WITHIN_S),
        "p_mine": (properties["p_mine"], _P_MINE_WITHIN),
        "n_views": (properties["n_views"], 0.0),
        **{key: (properties[key], _SIZE_WITHIN_M) for key in ("sigma_m", "length_m", "width_m", "height_m", "depth_m")},
    }
    found = [
        f"{key} {reported[key]} where {value} is stored"
        for key, (value, within) in numbers.items()
        if (reported[key] is None) != (value is None) or (value is not None and abs(reported[key] - value) > within)
    ]
    if reported["classification"] != properties["class"]:
        found.append(f"a {reported['classification']} where a {properties['class']} is stored")
    return found


def n_passed(rule: Passed, reports: Sequence[Report]) -> int:
    """Count targets passed as the rule requires."""
    looks_deg: dict[int, list[float]] = {}
    numbers = set()
    for details in _details(reports, "passed"):
        number, look_deg = details["number"], details["look_deg"]
        off_deg = [abs(math.remainder(look_deg - before_deg, 360.0)) for before_deg in looks_deg.get(number, [])]
        looks_deg.setdefault(number, []).append(look_deg)
        in_range = rule.ground_range_m[0] <= details["ground_range_m"] <= rule.ground_range_m[1]
        if details["in_control"] and in_range and min(off_deg, default=180.0) >= rule.other_look_deg:
            numbers.add(number)
    return len(numbers)


def n_sharper(reports: Sequence[Report], targets_deg: Sequence[tuple[float, float]]) -> int:
    """Count contacts that a second view brought nearer to the truth; 0 if it talked one of a target down.

    A contact at a target of the truth has to get likelier to be a mine, any other less likely.
    """
    reported: dict[int, list[Mapping[str, Any]]] = {}
    for details in _details(reports, "contact"):
        reported.setdefault(details["number"], []).append(details)
    ends = [(reports_of_one[0], reports_of_one[-1]) for reports_of_one in reported.values()]
    rises = [
        (last["p_mine"] - first["p_mine"], _is_at_one(last, targets_deg))
        for first, last in ends
        if first["n_views"] == 1 and last["n_views"] >= 2
    ]
    if any(rise < 0.0 and is_target for rise, is_target in rises):
        return 0
    return sum(rise > 0.0 if is_target else rise < 0.0 for rise, is_target in rises)


def _is_at_one(contact: Mapping[str, Any], targets_deg: Sequence[tuple[float, float]]) -> bool:
    """Find whether a contact lies at a target, by a plane that is exact enough for metres."""
    latitude_deg, longitude_deg = contact["latitude_deg"], contact["longitude_deg"]
    m_per_deg_east = _M_PER_DEG * math.cos(math.radians(latitude_deg))
    return any(
        math.hypot(_M_PER_DEG * (latitude_deg - target[0]), m_per_deg_east * (longitude_deg - target[1]))
        <= _AT_TARGET_M
        for target in targets_deg
    )


def inside_fence(fence_deg: Sequence[tuple[float, float]], reports: Sequence[Report]) -> Judged:
    """Check that commands and the commanded vehicle stayed inside."""
    commands = list(_details(reports, "command"))
    sent = [(command["latitude_deg"], command["longitude_deg"]) for command in commands if "latitude_deg" in command]
    been = [(pose["latitude_deg"], pose["longitude_deg"]) for pose in _details(reports, "pose") if pose["in_control"]]
    n_outside = (
        sum(not _is_inside(place, fence_deg) for place in sent),
        sum(not _is_inside(place, fence_deg) for place in been),
    )
    found = (
        f"{n_outside[0]} of {len(sent)} places and {n_outside[1]} of {len(been)} poses outside, {len(commands)} "
        "commands"
    )
    return (
        "commands, and the vehicle under command, stay inside the fence",
        found,
        n_outside == (0, 0) and bool(commands),
    )


def above_floor(rule: AboveFloor, reports: Sequence[Report]) -> Judged:
    """Check that no command led below a minimum altitude over the true floor, the shallowest of poses around it."""
    expected = f"commands stay {rule.min_altitude_m:g} m above the true sea floor"
    floors = [
        (report.at_s, report.details["depth_m"] + report.details["altitude_m"])
        for report in reports
        if report.what == "pose"
    ]
    heights_m = []
    for report in reports:
        if report.what == "command":
            reference, value_m = report.details["vertical"]
            below_m = [floor_m for at_s, floor_m in floors if abs(at_s - report.at_s) <= _FLOOR_WITHIN_S]
            heights_m.append(value_m if reference == "altitude" else min(below_m, default=-math.inf) - value_m)
    if not heights_m:
        return expected, "it was never commanded", False
    n_low = sum(not height_m >= rule.min_altitude_m for height_m in heights_m)
    found = f"{n_low} of {len(heights_m)} commands lower, the lowest {min(heights_m):.1f} m above it"
    return expected, found, not n_low


def own_plan_at_end(rule: OwnPlanAtEnd, reports: Sequence[Report]) -> Judged:
    """Check that the vehicle flew its own plan in the last seconds."""
    poses = [report for report in reports if report.what == "pose"]
    last = [report.details["in_control"] for report in poses if report.at_s >= poses[-1].at_s - rule.last_s]
    found = f"commanded in {sum(last)} of {len(last)} poses"
    return f"'{rule.device}' flies its own plan in the last {rule.last_s:g} s", found, bool(last) and not any(last)


def own_plan_after(rule: Silence, killed_s: float | None, reports: Sequence[Report]) -> Judged:
    """Check that the vehicle left the last command in time, and was not commanded again."""
    expected = f"'{rule.device}' is back on its own plan within {rule.within_s:g} s of the kill, and stays there"
    if killed_s is None:
        return expected, "the service was never killed", False
    released_s = [report.at_s - killed_s for report in reports if report.what == "released" and report.at_s > killed_s]
    later = [
        report.details["in_control"]
        for report in reports
        if report.what == "pose" and report.at_s > killed_s + rule.within_s + 0.5
    ]
    if not released_s or not later:
        return expected, "it was not released, or not seen afterwards", False
    found = f"released after {released_s[0]:.1f} s, commanded in {sum(later)} of {len(later)} poses after that"
    return expected, found, released_s[0] <= rule.within_s and not any(later)


def left_alone(rule: LeftAlone, reports: Sequence[Report]) -> Judged:
    """Check that a vehicle that a person stopped was neither asked nor commanded until it flew its own plan again."""
    expected = f"'{rule.device}' is left alone while a person has stopped it, and commanded again afterwards"
    stops_s: list[float] = []
    ends_s: list[float] = []
    for report in reports:
        if report.what in ("fault", "mended") and report.details["do"] in _STOPS:
            (stops_s if report.what == "fault" else ends_s).append(report.at_s)
    if not stops_s or len(ends_s) != len(stops_s):
        return expected, "it was not stopped, or not started again", False
    asked = [
        report
        for report in reports
        for stop_s, end_s in zip(stops_s, ends_s, strict=True)
        if report.what in ("granted", "command") and stop_s < report.at_s < end_s
    ]
    n_later = sum(report.what == "command" and report.at_s > ends_s[-1] for report in reports)
    words = ", ".join(f"{report.what} at {report.at_s:.1f} s" for report in asked[:3])
    found = f"{words or 'nothing'} in {len(stops_s)} stops, {n_later} commands after the last"
    return expected, found, not asked and bool(n_later)


def _details(reports: Iterable[Report], what: str) -> Iterable[Mapping[str, Any]]:
    return (report.details for report in reports if report.what == what)


def _is_inside(place_deg: tuple[float, float], corners_deg: Sequence[tuple[float, float]]) -> bool:
    """Apply the even-odd rule in latitude and longitude, exact enough for an area without the poles or the date
    line."""
    latitude, longitude = place_deg
    inside = False
    for (lat0, lon0), (lat1, lon1) in pairwise([*corners_deg, *corners_deg[:1]]):
        if (lat0 > latitude) != (lat1 > latitude) and longitude < lon0 + (latitude - lat0) / (lat1 - lat0) * (
            lon1 - lon0
        ):
            inside = not inside
    return inside
