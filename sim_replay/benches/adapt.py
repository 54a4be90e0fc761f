"""Measure whether replanning clears an area with less track than a lawnmower laid beforehand.

Over missions on mixed sea floor.

Both are flown through the same simulated worlds with the same chain; looks are worth the same to both planners. What
lies where is not known when the lawnmower is laid: it is the shortest that is expected to do what is ordered even on
the worst sea floor, and is flown to its end. The replanned flight goes on until the order is met and its map is as good
as the lawnmower would have made it, and a little better.
"""

from __future__ import annotations

import argparse
import gc
from pathlib import Path
from typing import Final

import msgspec

from auv_mcm.clearance.detection_performance import shipped_performance
from auv_mcm.errors import UsageError
from auv_mcm.shell.whole_files import write_file
from sim_replay.adaptive.compare import Compared, compare, fly_comparison
from sim_replay.adaptive.flight_picture import mission_png
from sim_replay.adaptive.order import REQUIRED, SIDE_M, drawn_scene, usual_order
from sim_replay.adaptive.summary import HEADER, planned_words, rows
from sim_replay.arguments import count, new_file
from sim_replay.benches.progress import counted
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.text_tables import markdown

FIRST_SEED: Final = 9430  # on seeds from here on nothing was ever tuned


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench adapt`."""
    parser.add_argument("--missions", type=count, default=30, help="worlds, each flown both ways (default 30)")
    parser.add_argument(
        "--first-seed", type=count, default=FIRST_SEED, help=f"seed of the first world (default {FIRST_SEED})"
    )
    parser.add_argument("--workers", type=count, default=2, help="worlds flown at once (default 2)")
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write the result of each mission to FILE")
    parser.add_argument(
        "--picture",
        type=new_file,
        metavar="FILE",
        help="draw the first world, flown both ways, to FILE (PNG), and fly no other",
    )


def run(arguments: argparse.Namespace) -> int:
    """Fly, score and print; returns the exit code. Raises UsageError for files that cannot be written."""
    first = arguments.first_seed
    if arguments.picture is not None:
        order = usual_order()
        flights = fly_comparison(first, order, shipped_performance())
        drawn = mission_png(
            drawn_scene(first, order.side_m), order, {"replanned": flights.adaptive, "lawnmower": flights.fixed}
        )
        _write("--picture", arguments.picture, drawn)
        return 0
    seeds = range(first, first + arguments.missions)
    missions: list[Compared] = []
    for mission in run_tasks(fly_both, seeds, Farm(arguments.workers), counted(len(seeds), "worlds flown")):
        missions.append(mission)
        if arguments.json is not None:
            _write("--json", arguments.json, msgspec.json.format(msgspec.json.encode(missions), indent=1))
    where = f"{len(missions)} worlds of {SIDE_M:g} m by {SIDE_M:g} m, seeds {seeds.start} to {seeds.stop - 1}"
    print(f"{where}; clearance ordered: {REQUIRED:g} on average over the area")
    print(f"\n{planned_words(missions)}\n")
    print(markdown(HEADER, rows(missions)))
    return 0


def fly_both(seed: int) -> Compared:
    """Fly one world both ways."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    return compare(seed)


def _write(option: str, path: Path, data: bytes) -> None:
    try:
        write_file(path, data)
    except OSError as error:
        raise UsageError(f"{option} {path} cannot be written: {error.strerror}") from error
