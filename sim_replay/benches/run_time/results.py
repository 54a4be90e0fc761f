"""What the bench found as JSON, its tables, and what moved since an older run."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Final, TypeVar

import msgspec

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.safe_files import read_regular
from sim_replay.benches.run_time.measure import LIMITS_PER_KM2, BenchMachine, SettingResult, median_ratio
from sim_replay.benches.run_time.one_run import DEFAULT
from sim_replay.benches.run_time.points import PLAIN, REASON
from sim_replay.benches.run_time.targets import CostTarget
from sim_replay.text_tables import density_cell, share_cell

_Results = TypeVar("_Results", bound=msgspec.Struct)

FORMAT_VERSION: Final = 1  # of the file; a change of its fields raises it
_MIN_CHANGE: Final = 0.03  # of a cost: runs of the same program differ by as much on an idle computer


class RunTimeResults(msgspec.Struct, frozen=True, kw_only=True):
    """Hold one run of the bench. missions: by name; sonar_s: how long they last together."""

    format_version: int = FORMAT_VERSION
    machine: BenchMachine
    repeat: int
    missions: tuple[str, ...]
    sonar_s: float
    points: tuple[SettingResult, ...]
    targets: tuple[CostTarget, ...]

    def point(self, name: str) -> SettingResult | None:
        """Find an operating point, None if it was not measured."""
        return next((point for point in self.points if point.name == name), None)


POINT_HEADER: Final = (
    *("operating point", "knob", "process s", "times real time", "of the default", "of the plain script"),
    *(f"Pd at {limit:g} FA/km²" for limit in LIMITS_PER_KM2),
    *("contacts per km²", "covered km²", "peak MB"),
)


VERSION_HEADER: Final = (
    *("version", "date", "processor", "processor s per hour of sonar", "times real time", "of the plain script"),
    *(f"Pd at {limit:g} FA/km²" for limit in LIMITS_PER_KM2),
    *("contacts per km²", "peak MB"),
)


def version_cells(results: RunTimeResults) -> list[str]:
    """Write what a version did at the default operating point, after its name."""
    machine, default, plain = results.machine, results.point(DEFAULT), results.point(PLAIN)
    if default is None:
        raise BadInputError(f"{machine.date}: the default operating point was not measured. Measure anew")
    process_s = statistics.median(default.process_s())
    return [
        machine.date.partition(" ")[0],
        machine.processor,
        f"{3600.0 * process_s / results.sonar_s:.0f}",
        f"{results.sonar_s / process_s:.0f}",
        "-" if plain is None else _ratio_cell(default, plain),
        *(share_cell(pd) for pd in default.pd),
        density_cell(default.contacts),
        f"{max(run.peak_memory_mb for run in default.runs.values()):.0f}",
    ]


def point_rows(results: RunTimeResults) -> list[list[str]]:
    """Write a row of text per operating point."""
    default, plain = results.point(DEFAULT), results.point(PLAIN)
    rows = []
    for point in results.points:
        process_s = statistics.median(point.process_s())
        rows.append(
            [
                point.name,
                point.knob,
                f"{process_s:.2f}",
                f"{results.sonar_s / process_s:.0f}",
                *("-" if other is None else _ratio_cell(point, other) for other in (default, plain)),
                *(share_cell(pd) for pd in point.pd),
                density_cell(point.contacts),
                _covered_cell(point),
                f"{max(run.peak_memory_mb for run in point.runs.values()):.0f}",
            ]
        )
    return rows


def reason_words(results: RunTimeResults) -> str:
    """Explain why the default is the default.

    Names which points did better in this run in time without being worse in error.
    """
    default = results.point(DEFAULT)
    if default is None or not default.pd:
        return REASON
    better = []
    for point in results.points:
        if point.name == DEFAULT or not point.pd:
            continue
        _, _, highest = median_ratio(point, default)
        if highest < 1.0 and all(theirs.count >= ours.count for theirs, ours in zip(point.pd, default.pd, strict=True)):
            better.append(point.name)
    found = ", ".join(better) if better else "none"
    return f"{REASON}. Points that cost less in every repeat and found as many targets at every limit: {found}"


def read_results(path: Path) -> RunTimeResults:
    """Read an older run.

    Raises UsageError for a file that cannot be read, BadInputError for one that is no such run.
    """
    return read_bench_file(path, RunTimeResults, FORMAT_VERSION, "auv-mcm bench chain --json FILE")


def read_bench_file(path: Path, kind: type[_Results], format_version: int, made_by: str) -> _Results:
    """Read what a bench wrote.

    Parameters
    ----------
    kind
        Of what was written; it has a format_version.
    format_version
        The one that this program reads.
    made_by
        The command that writes such files.

    Raises
    ------
    UsageError
        For a file that cannot be read.
    BadInputError
        For another kind or version.
    """
    try:
        data = read_regular(path)
    except OSError as error:
        raise UsageError(f"--compare {path} cannot be read: {error.strerror}") from error
    try:
        found = msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: {error}. Name a file that '{made_by}' wrote") from error
    written = getattr(found, "format_version", None)
    if written != format_version:
        raise BadInputError(f"{path}: format_version {written}, but this program reads {format_version}. Measure anew")
    return found


def require_same_missions(old: RunTimeResults, missions: Sequence[str]) -> None:
    """Raise UsageError where an older run was not on these missions."""
    if set(old.missions) != set(missions):
        differing = ", ".join(sorted(set(old.missions) ^ set(missions)))
        raise UsageError(f"the older run was on other missions ({differing}): give the same scenes, seeds and logs")


def changes_since(old: RunTimeResults, new: RunTimeResults) -> list[str]:
    """Say what moved beyond noise, a line each.

    Costs are compared in units of the plain script in the same run, since computers differ and are busy. A cost has
    moved where the ranges over the repeats do not overlap; Pd and contacts where the new value lies outside the old
    one's 95 % interval.
    """
    lines = []
    for point in new.points:
        before = old.point(point.name)
        if before is None:
            lines.append(f"{point.name}: new")
            continue
        lines += [f"{point.name}: {words}" for words in _differences(before, point, old, new)]
    lines += [f"{point.name}: no longer measured" for point in old.points if new.point(point.name) is None]
    return lines


def _differences(before: SettingResult, after: SettingResult, old: RunTimeResults, new: RunTimeResults) -> list[str]:
    found = []
    old_plain, new_plain = old.point(PLAIN), new.point(PLAIN)
    if old_plain is not None and new_plain is not None and after.name != PLAIN:
        (was, low, high), (now, lowest, highest) = median_ratio(before, old_plain), median_ratio(after, new_plain)
        if abs(math.log(now / was)) > _MIN_CHANGE and (lowest > high or highest < low):
            found.append(f"cost {was:.2f} -> {now:.2f} of the plain script ({now / was - 1.0:+.0%})")
    for limit, ours, theirs in zip(LIMITS_PER_KM2, after.pd, before.pd, strict=True):
        if ours.value is not None and theirs.value is not None and not theirs.low <= ours.value <= theirs.high:
            found.append(f"Pd at {limit:g} FA/km² {theirs.value:.2f} -> {ours.value:.2f}")
    ours_km2, low_km2, high_km2 = after.contacts.per_km2, before.contacts.low, before.contacts.high
    if ours_km2 is not None and low_km2 is not None and high_km2 is not None and not low_km2 <= ours_km2 <= high_km2:
        found.append(f"contacts per km² {before.contacts.per_km2:.0f} -> {ours_km2:.0f}")
    return found


def _covered_cell(point: SettingResult) -> str:
    covered_km2 = sum(run.covered_km2 for run in point.runs.values())
    return "-" if all(not run.stages_s for run in point.runs.values()) else f"{covered_km2:.4f}"


def _ratio_cell(point: SettingResult, other: SettingResult) -> str:
    median, low, high = median_ratio(point, other)
    return f"{median:.2f} ({low:.2f}-{high:.2f})"
