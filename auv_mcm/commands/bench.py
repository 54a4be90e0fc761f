"""Benches."""

from __future__ import annotations

import argparse
from typing import Final

from auv_mcm.commands import Commands, command

_BENCHES: Final = (
    *("waterfall", "detect", "simulate", "scenes", "segmentation", "snakes", "shapes", "beliefs", "images"),
    *("cascade", "inversion", "augment", "figure9"),
)


def add(commands: Commands) -> None:
    parser = command(
        commands,
        "bench",
        "measure speed, memory and what is found",
        "waterfall: the whole chain, cost per stage; detect: the detector's cost per tile; simulate: the simulator's cost;\n"
        "scenes: what is found in the named scenes; segmentation, snakes, shapes: parts of confirmation and classification,\n"
        "error beside time; beliefs: what views make one believe; images: outlines and calls on\n"
        "real pictures; cascade: speed and budgets; inversion, augment: targets put into recorded sea floors; figure9: the\n"
        "source paper's examples of classical detection. Further arguments go to the bench.",
        ["auv-mcm bench waterfall mission.xtf", "auv-mcm bench scenes --help"],
    )
    parser.add_argument("bench", metavar="BENCH", choices=_BENCHES, help="what to measure: " + ", ".join(_BENCHES))
    parser.add_argument("arguments", metavar="...", nargs=argparse.REMAINDER, help="arguments of the bench")
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from sim_replay.benches.chain import main as bench

    return bench([arguments.bench, *arguments.arguments])
