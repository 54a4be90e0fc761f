"""Measure how well the tables of performance predict what looks find, on missions held out from fitting them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from auv_mcm.clearance.detection_performance import Performance, parse_performance, shipped_performance
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.safe_files import read_regular
from sim_replay.arguments import count
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.detection_performance.calibrate_performance import fly_all, tables
from sim_replay.fitting.detection_performance.fit_performance import outcomes
from sim_replay.fitting.detection_performance.judge import (
    MIN_LOOKS,
    JudgedPredictions,
    PerformanceShare,
    judge_predictions,
    mean_error,
)
from sim_replay.text_tables import NOTHING, columns, markdown

FIRST_SEED: Final = 9300  # nothing was fitted or tried on seeds from here on


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench performance`."""
    parser.add_argument("--seeds", type=count, default=12, help="missions (default 12)")
    parser.add_argument(
        "--first-seed", type=count, default=FIRST_SEED, help=f"seed of the first mission (default {FIRST_SEED})"
    )
    parser.add_argument("--workers", type=count, default=2, help="missions flown at once (default 2)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="fly on a dask cluster, tcp://HOST:PORT")
    parser.add_argument("--tables", type=Path, metavar="FILE", help="tables to judge (default: those that ship)")
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")


def run(arguments: argparse.Namespace) -> int:
    """Fly, judge and print; returns the exit code.

    Raises UsageError where no target was seen, BadInputError for bad tables.
    """
    performance = _read(arguments.tables)
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    missions = fly_all(seeds, 1, Farm(arguments.workers, arguments.scheduler), _show)
    print(file=sys.stderr)
    looks = [look for mission in missions for look in mission]
    if not looks:
        raise UsageError(f"--seeds {arguments.seeds}: no target was seen. Fly more missions")
    found = judge_predictions(performance, outcomes(looks))
    print(f"judged on seeds {seeds[0]} to {seeds[-1]}; fitted on {performance.fitted_on}\n")
    laid_out = markdown if arguments.markdown else columns
    print(tables(performance, laid_out))
    print()
    print(report(found, arguments.markdown))
    return 0


def report(found: JudgedPredictions, in_markdown: bool = False) -> str:
    """Lay out the judgement in words and tables."""
    laid_out = markdown if in_markdown else columns
    lines = [
        f"{found.n_looks} looks in {found.n_missions} missions",
        f"Brier score {found.brier:.4f}, of one probability for all {found.brier_constant:.4f}",
        f"calibration error {found.calibration_error:.3f}",
    ]
    if found.judged:
        error, by_chance, by_mission = mean_error(found.judged)
        lines.append(
            f"mean absolute error over {len(found.judged)} kinds and bands with {MIN_LOOKS} looks or more: "
            f"{error:.3f}; right tables would have {by_chance:.3f} by chance, {by_mission:.3f} with missions as "
            "different as these"
        )
    header = ("sea floor", "ground range", "looks", "predicted", "realised", "error", "by chance", "by missions")
    rows = [[place.seabed, f"{place.near_m:g}-{place.far_m:g} m", *_cells(place.share)] for place in found.places]
    two = [
        [words, NOTHING, *(_cells(pair) if pair is not None else [NOTHING] * (len(header) - 2))]
        for words, pair in (("two looks, same direction", found.same), ("two looks, others", found.other))
    ]
    return "\n".join(lines) + "\n\n" + laid_out(header, [*rows, *two])


def _read(path: Path | None) -> Performance:
    if path is None:
        return shipped_performance()
    try:
        data = read_regular(path)
    except OSError as error:
        raise BadInputError(f"--tables {path} cannot be read: {error.strerror}. Check the path") from error
    return parse_performance(data, str(path))


def _show(done: int, of: int) -> None:
    print(f"\r{done} of {of} missions flown", end="", file=sys.stderr, flush=True)


def _cells(share: PerformanceShare) -> Sequence[str]:
    numbers = (share.predicted, share.realised, share.error, share.by_chance, share.by_mission)
    return [str(share.n), *(f"{number:.3f}" for number in numbers)]
