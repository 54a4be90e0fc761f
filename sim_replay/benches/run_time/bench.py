"""Measure run time against error of the whole chain, beside a plain script: operating points, targets, and what
moved."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec

from auv_mcm.errors import UsageError
from auv_mcm.shell.whole_files import write_file
from sim_replay.arguments import add_line_options, count, new_file
from sim_replay.benches.run_time.apart import Apart, measure_apart
from sim_replay.benches.run_time.lines import FIRST_SEED, BenchMission, augment_logs, fly_empty, fly_scenes
from sim_replay.benches.run_time.measure import measure_settings, this_machine
from sim_replay.benches.run_time.one_run import DEFAULT
from sim_replay.benches.run_time.points import PLAIN, ChainSetting, chain_settings
from sim_replay.benches.run_time.quick import quick_checks
from sim_replay.benches.run_time.results import (
    POINT_HEADER,
    RunTimeResults,
    changes_since,
    point_rows,
    read_results,
    reason_words,
    require_same_missions,
)
from sim_replay.benches.run_time.targets import FLAT, TARGET_HEADER, CostTarget, cost_targets, target_rows
from sim_replay.missions import SCENES
from sim_replay.simulator.scene_file import read_scene
from sim_replay.text_tables import columns, markdown

SCANNED: Final = ("flat", "mixed", "ripple", "rough")
"""Scenes that knobs are turned on."""
_FAILED: Final = 5  # exit code of a check that fails


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench chain`."""
    parser.add_argument(
        "--scenes", help=f"scenes by name, with commas between (default: {','.join(SCANNED)}; with --targets all ten)"
    )
    parser.add_argument("--seeds", type=count, default=1, help="missions per scene (default 1)")
    add_line_options(parser, 2)
    parser.add_argument(
        "--repeat", type=count, default=3, help="repetitions of every run, all points in turn (default 3)"
    )
    parser.add_argument(
        "--knobs", help="turn only these knobs, with commas between, beside the default and the references"
    )
    instead = parser.add_mutually_exclusive_group()
    for name, does in {
        "--targets": "the default and the plain script alone, on all that the targets are about",
        "--quick": "check errors and counts of work on two small missions; no time is judged",
    }.items():
        instead.add_argument(name, action="store_true", help=does)
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write everything measured to FILE")
    parser.add_argument(
        "--compare", type=Path, metavar="OLD", help="say what moved beyond noise since a run that --json wrote"
    )
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")


def run(arguments: argparse.Namespace) -> int:
    """Fly, run, score and print; returns the exit code. Raises UsageError for scenes or knobs that are not there."""
    if arguments.quick:
        return _quick()
    old = None if arguments.compare is None else read_results(arguments.compare)
    usual = SCENES if arguments.targets else SCANNED
    names = tuple(arguments.scenes.split(",")) if arguments.scenes else usual
    for name in names:
        read_scene(name)
    chosen = _chosen(arguments.knobs, arguments.targets)
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="auv-mcm-bench-") as made:
        folder = Path(made)
        lines = _missions(arguments, names, folder)
        if old is not None:
            require_same_missions(old, [line.name for line in lines])
        found = measure_settings(chosen, lines, arguments.repeat, folder, progress)
        apart = _apart(lines, folder, chosen[0]) if arguments.targets else Apart()
    print(file=sys.stderr)
    aims: list[CostTarget] = []
    by_name = {point.name: point for point in found}
    if arguments.targets:
        aims = cost_targets(by_name[DEFAULT], by_name[PLAIN], lines, apart)
    results = RunTimeResults(
        machine=this_machine(load),
        repeat=arguments.repeat,
        missions=tuple(line.name for line in lines),
        sonar_s=sum(run.sonar_s for run in by_name[DEFAULT].runs.values()),
        points=tuple(found),
        targets=tuple(aims),
    )
    _print(results, markdown if arguments.markdown else columns)
    if old is not None:
        print("\nmoved beyond noise:\n" + ("\n".join(changes_since(old, results)) or "nothing"))
    write_result("--json", arguments.json, msgspec.json.format(msgspec.json.encode(results), indent=1))
    return 0


def _quick() -> int:
    """Print every check; returns 5 if one fails."""
    with tempfile.TemporaryDirectory(prefix="auv-mcm-bench-") as made:
        checks = quick_checks(Path(made), progress)
    print(file=sys.stderr)
    print(
        columns(
            ("check", "", "found"), [[check.name, "ok" if check.holds else "FAILED", check.found] for check in checks]
        )
    )
    return 0 if all(check.holds for check in checks) else _FAILED


def _missions(arguments: argparse.Namespace, names: Sequence[str], folder: Path) -> list[BenchMission]:
    seeds = range(FIRST_SEED, FIRST_SEED + arguments.seeds)
    lines = fly_scenes(names, seeds, folder, progress)
    if arguments.targets and FLAT in names:
        progress(f"flying {FLAT} without objects")
        lines.append(fly_empty(FLAT, FIRST_SEED, folder))
    return lines + augment_logs(arguments.log, range(FIRST_SEED, FIRST_SEED + arguments.log_seeds), folder, progress)


def _chosen(knobs: str | None, targets_alone: bool) -> list[ChainSetting]:
    """Choose the operating points to measure. Raises UsageError for a knob that is not there."""
    every = chain_settings()
    if targets_alone:
        return [point for point in every if point.name in (DEFAULT, PLAIN)]
    if knobs is None:
        return list(every)
    known = tuple(dict.fromkeys(point.knob for point in every if point.knob not in (DEFAULT, "reference")))
    wanted = knobs.split(",") if knobs else []
    unknown = [knob for knob in wanted if knob not in known]
    if unknown:
        raise UsageError(f"--knobs: there is no '{unknown[0]}'; the knobs are {', '.join(known)}")
    return [point for point in every if point.knob in (DEFAULT, "reference", *wanted)]


def _apart(lines: Sequence[BenchMission], folder: Path, default: ChainSetting) -> Apart:
    """Measure what the targets ask beyond the missions; nothing without flat sand."""
    scenes = [line for line in lines if line.kind == "scene"]
    flat = next((line for line in scenes if line.group == FLAT), None)
    announced = [line for line in scenes if line.group in SCANNED]
    return Apart() if flat is None else measure_apart(default, flat, announced, folder, progress)


def _print(results: RunTimeResults, laid_out: Callable[[Sequence[str], Sequence[Sequence[str]]], str]) -> None:
    machine = results.machine
    load = " to ".join(f"{value:.1f}" for value in machine.load)
    print(f"{len(results.missions)} missions, {results.sonar_s:.0f} s of sonar: {', '.join(results.missions)}")
    print(
        f"processor time of whole processes, user and system, one core, kernels: {machine.kernels}; medians of "
        f"{results.repeat} repeats,"
    )
    print("all points in turn; ratios with the lowest and highest repeat")
    print(f"{machine.processor}, {machine.cores} cores, load {load}, {machine.date}\n")
    print(laid_out(POINT_HEADER, point_rows(results)))
    print(f"\nthe default: {reason_words(results)}")
    if results.targets:
        print("\n" + laid_out(TARGET_HEADER, target_rows(results.targets)))
        for one in results.targets:
            if one.profile:
                print(f"missed: {one.name}. Processor time: {one.profile}")


def write_result(option: str, path: Path | None, data: bytes) -> None:
    """Write a file; raise UsageError where it cannot be written."""
    if path is None:
        return
    try:
        write_file(path, data)
    except OSError as error:
        raise UsageError(f"{option} {path} cannot be written: {error.strerror}") from error


def progress(words: str) -> None:
    """Write what is done now over what was done before."""
    print(f"\r\x1b[K{words}", end="", file=sys.stderr, flush=True)
