"""Measure the largest error of every numerical stage against exact or high-precision arithmetic.

Stages get the inputs that hurt most: gains of 1e-30 and 1e30, offsets, constants, saturation, denormal numbers, nadir,
65,535 samples, poles. Tests hold the same rows, with fewer inputs, to the same bounds.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from pathlib import Path
from typing import Final

import msgspec

from auv_mcm.errors import UsageError
from auv_mcm.shell.whole_files import write_file
from sim_replay.arguments import new_file
from sim_replay.benches.run_time.measure import BenchMachine, this_machine
from sim_replay.benches.stability.back_rows import back_rows
from sim_replay.benches.stability.front_rows import front_rows
from sim_replay.benches.stability.rows import NumberResult, NumberRow, measure_row
from sim_replay.text_tables import columns, markdown

HEADER: Final = ("stage", "inputs", "against", "largest error", "bound", "in float32", "condition", "exceptions", "")
_FAILED: Final = 5  # exit code of a check that fails
_FORMAT_VERSION: Final = 1  # of the file; a change of its fields raises it


class StabilityResults(msgspec.Struct, frozen=True, kw_only=True):
    """Hold one run. quick: whether few inputs were tried; infinite errors are written as null."""

    format_version: int = _FORMAT_VERSION
    machine: BenchMachine
    quick: bool
    rows: tuple[NumberResult, ...]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench stability`."""
    parser.add_argument("--quick", action="store_true", help="fewer inputs per row, as the tests try them")
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write everything measured to FILE")
    parser.add_argument("--markdown", action="store_true", help="print the table in Markdown")


def run(arguments: argparse.Namespace) -> int:
    """Measure every row and print the table; returns 5 if a row fails."""
    path: Path | None = arguments.json
    load = os.getloadavg()[0]
    found = []
    for row in every_row():
        print(f"\r\x1b[K{row.name}", end="", file=sys.stderr, flush=True)
        found.append(measure_row(row, arguments.quick))
    print("\r\x1b[K", end="", file=sys.stderr, flush=True)
    machine = this_machine(load)
    versions = ", ".join(f"{name} {version}" for name, version in machine.versions.items())
    print(f"{machine.processor}, kernels: {machine.kernels}, {versions}, {machine.date}\n")
    print((markdown if arguments.markdown else columns)(HEADER, [cells(result) for result in found]))
    failed = [result for result in found if not result.holds]
    print(f"\n{len(found) - len(failed)} of {len(found)} rows hold")
    if path is not None:
        results = StabilityResults(machine=machine, quick=arguments.quick, rows=tuple(found))
        try:
            write_file(path, msgspec.json.format(msgspec.json.encode(results), indent=1))
        except OSError as error:
            raise UsageError(f"--json {path} cannot be written: {error.strerror}") from error
    return _FAILED if failed else 0


def every_row() -> list[NumberRow]:
    """List all rows in the order of the chain."""
    return [*front_rows(), *back_rows()]


def cells(result: NumberResult) -> list[str]:
    """Write one row of the table."""
    unit = "" if result.unit == "relative" else f" {result.unit}"
    return [
        result.stage,
        result.inputs,
        result.reference,
        f"{_number(result.error)}{unit}",
        _number(result.bound),
        _number(result.single),
        _number(result.condition),
        ", ".join(result.exceptions),
        "ok" if result.holds else "FAILED",
    ]


def _number(value: float) -> str:
    if math.isnan(value):
        return ""
    return f"{value:.0f}" if value == 0.0 else f"{value:.1e}"
