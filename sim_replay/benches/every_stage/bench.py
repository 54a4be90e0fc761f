"""Measure every stage's time against its error, beside what a user would take instead, in one run and one form.

Under stress stages get the inputs that hurt most: gains of 1e-30 and 1e30, offsets, constants, saturation, denormal
numbers, nadir, 65,535 samples, poles. Tests hold the same rows, with fewer inputs, to the same bounds.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec

from auv_mcm.errors import UsageError
from sim_replay.arguments import count, new_file
from sim_replay.benches.every_stage.rows import Alternative, Cost, StageRow, measured
from sim_replay.benches.every_stage.stages import STAGES, every_row
from sim_replay.benches.run_time.bench import progress, write_result
from sim_replay.benches.run_time.measure import BenchMachine, this_machine
from sim_replay.benches.run_time.results import read_bench_file
from sim_replay.benches.stability.rows import STRESS_HEADER, NumberResult, measure_row, stress_cells
from sim_replay.text_tables import NOTHING, columns, markdown

HEADER: Final = ("stage", "setting", "ms", "error", "unit", "alternative", "its ms", "its error", "")
_FORMAT_VERSION: Final = 1  # of the file; a change of its fields raises it
_FAILED: Final = 5  # exit code of a check that fails
_QUICK: Final = (2, 1)  # inputs and repetitions
_N_INPUTS: Final = 8  # regions, worlds and objects of a class per row; a minute in all
_MIN_CHANGE: Final = 0.15  # of a time: what runs of the same program differ by on a computer that is not idle
_SAME_ERROR: Final = 1e-9  # relative, and absolute: rounding is no change of an error


class EveryStageResults(msgspec.Struct, frozen=True, kw_only=True):
    """Hold one run of the bench. n_inputs: per row; stages: by name; stress: rows under stress, if asked for."""

    format_version: int = _FORMAT_VERSION
    machine: BenchMachine
    n_inputs: int
    repeat: int
    stages: tuple[str, ...]
    rows: tuple[StageRow, ...]
    stress: tuple[NumberResult, ...] = ()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench all`."""
    parser.add_argument(
        "--quick", action="store_true", help="few inputs, once each; ends with code 5 if an error exceeds its limit"
    )
    parser.add_argument(
        "--stress",
        action="store_true",
        help="instead, the inputs that hurt most against exact arithmetic; ends with code 5 if a bound does not hold",
    )
    parser.add_argument("--stages", help=f"stages, with commas between (default: {','.join(STAGES)})")
    parser.add_argument("--repeat", type=count, default=5, help="repetitions of every work, in turn (default 5)")
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write everything measured to FILE")
    parser.add_argument(
        "--compare", type=Path, metavar="OLD", help="say what moved beyond noise since a run that --json wrote"
    )
    parser.add_argument("--markdown", action="store_true", help="print the table in Markdown")


def run(arguments: argparse.Namespace) -> int:
    """Measure, print and write; returns 5 if an error exceeds its limit. Raises UsageError for unknown stages."""
    chosen = tuple(arguments.stages.split(",")) if arguments.stages else tuple(STAGES)
    unknown = [name for name in chosen if name not in STAGES]
    if unknown:
        raise UsageError(f"--stages: there is no '{unknown[0]}'; the stages are {', '.join(STAGES)}")
    if arguments.stress and arguments.compare is not None:
        raise UsageError("--compare goes by times and errors of stages, which --stress does not measure: leave one out")
    old = None if arguments.compare is None else read_every_stage(arguments.compare)
    n_inputs, repeat = _QUICK if arguments.quick else (_N_INPUTS, arguments.repeat)
    load, rows, stress = os.getloadavg()[0], list[StageRow](), list[NumberResult]()
    for row in every_row() if arguments.stress else ():
        progress(row.name)
        stress.append(measure_row(row, arguments.quick))
    for name in () if arguments.stress else chosen:
        progress(name)
        rows += measured(STAGES[name](n_inputs), repeat)
    progress("")
    results = EveryStageResults(
        machine=this_machine(load),
        n_inputs=n_inputs,
        repeat=repeat,
        stages=() if arguments.stress else chosen,
        rows=tuple(rows),
        stress=tuple(stress),
    )
    _print(results, markdown if arguments.markdown else columns)
    if old is not None:
        print("\nmoved beyond noise:\n" + ("\n".join(moved_since(old, results)) or "nothing"))
    write_result("--json", arguments.json, msgspec.json.format(msgspec.json.encode(results), indent=1))
    return 0 if all([*(row.holds for row in rows), *(row.holds for row in stress)]) else _FAILED


def _print(results: EveryStageResults, laid_out: Callable[[Sequence[str], Sequence[Sequence[str]]], str]) -> None:
    machine = results.machine
    versions = ", ".join(f"{name} {version}" for name, version in machine.versions.items())
    print(f"{machine.processor}, {machine.cores} cores, kernels: {machine.kernels}, {versions}, {machine.date}")
    if results.stress:
        print("\n" + laid_out(STRESS_HEADER, [stress_cells(row) for row in results.stress]))
        print(f"\n{sum(row.holds for row in results.stress)} of {len(results.stress)} rows hold")
        return
    print(f"processor time of one thread, medians of {results.repeat} repeats in turn\n")
    print(laid_out(HEADER, stage_cells(results.rows)))
    for words in sorted({row.alternative.missing for row in results.rows if row.alternative} - {""}):
        print(f"not measured: {words}")


def stage_cells(rows: Sequence[StageRow]) -> list[list[str]]:
    """Write a row of text per row measured."""
    written = []
    for row in rows:
        other = row.alternative or Alternative(name=NOTHING)
        written.append(
            [
                row.stage,
                row.setting,
                f"{row.cost.ms:.2f}",
                f"{row.error:.3g}",
                row.unit,
                other.name,
                NOTHING if other.cost is None else f"{other.cost.ms:.2f}",
                NOTHING if other.error is None else f"{other.error:.3g}",
                "" if row.holds else "FAILED",
            ]
        )
    return written


def stage_history(runs: Sequence[EveryStageResults]) -> list[list[str]]:
    """Write a row per stage of time in units of the alternative and errors, a cell per run."""
    last = [
        {row.stage: row for row in run.rows if row.alternative is not None and row.alternative.cost is not None}
        for run in runs
    ]
    return [
        [stage, *(_history_cell(rows[stage]) if stage in rows else NOTHING for rows in last)]
        for stage in dict.fromkeys(stage for rows in last for stage in rows)
    ]


def _history_cell(row: StageRow) -> str:
    other = row.alternative
    assert other is not None
    assert other.error is not None
    ratio = _times(row)[0]
    return f"time {ratio:.2g} of {other.name}; error {row.error:.3g}, its {other.error:.3g}: {row.unit}"


def moved_since(old: EveryStageResults, new: EveryStageResults) -> list[str]:
    """Say what moved beyond noise, a line each.

    Times are compared in units of the alternative in the same run where there is one, since computers differ and are
    busy. A time has moved where the ranges over the repeats do not overlap and medians differ by 15 % or more; an error
    where it differs at all.
    """
    before = {_key(row): row for row in old.rows}
    lines = []
    for row in new.rows:
        was = before.pop(_key(row), None)
        name = f"{row.stage}, {row.setting}"
        if was is None:
            lines.append(f"{name}: new")
            continue
        if not math.isclose(was.error, row.error, rel_tol=_SAME_ERROR, abs_tol=_SAME_ERROR):
            lines.append(f"{name}: error {was.error:.3g} -> {row.error:.3g} {row.unit}")
        (then, low, high), (now, lowest, highest) = _times(was), _times(row)
        if abs(math.log(now / then)) > _MIN_CHANGE and (lowest > high or highest < low):
            beside = "ms" if _alternative_ms(row) is None else "of the alternative"
            lines.append(f"{name}: time {then:.3g} -> {now:.3g} {beside} ({now / then - 1.0:+.0%})")
    asked = {row.stage for row in new.rows}
    return lines + [f"{row.stage}, {row.setting}: no longer measured" for row in before.values() if row.stage in asked]


def _key(row: StageRow) -> tuple[str, ...]:
    return row.stage, row.setting, row.unit, row.alternative.name if row.alternative else ""


def _alternative_ms(row: StageRow) -> float | None:
    return row.alternative.cost.ms if row.alternative and row.alternative.cost else None


def _times(row: StageRow) -> tuple[float, float, float]:
    """Take median, lowest and highest time, in units of the alternative where it was measured."""
    own = row.cost
    other = row.alternative.cost if row.alternative and row.alternative.cost else Cost((1.0,))
    return (own.ms / other.ms, min(own.times_ms) / max(other.times_ms), max(own.times_ms) / min(other.times_ms))


def read_every_stage(path: Path) -> EveryStageResults:
    """Read an older run.

    Raises UsageError for a file that cannot be read, BadInputError for one that is no such run.
    """
    return read_bench_file(path, EveryStageResults, _FORMAT_VERSION, "auv-mcm bench all --json FILE")
