"""Benches."""

from __future__ import annotations

import argparse
from typing import Final

from auv_mcm.commands import Commands, command

_BENCHES: Final = {
    "waterfall": "the whole chain, cost per stage",
    "detect": "the detector's cost per tile",
    "simulate": "the simulator's cost",
    "scenes": "what is found in the named scenes, and what each step of the close look adds",
    "froc": "every detector and each step after it, on missions held out from all training",
    "segmentation": "Markov-field segmentation, error beside time",
    "snakes": "contours, error beside time",
    "shapes": "classification by shape, error beside time",
    "beliefs": "what views make one believe",
    "images": "outlines and calls on real pictures",
    "cascade": "the trained cascade's speed and budgets",
    "inversion": "relief recovered from images, error beside time",
    "augment": "whether embedded targets can be told from simulated ones",
    "framers": "message framing: speed, garbage, and what damage costs",
    "ports": "the service at a full serial line: start, processor time, how late pings are",
    "soak": "the service for long, and killed: memory, counters, what is lost",
    "seabed": "kinds of sea floor told apart on missions held out",
    "performance": "predicted against realised detection, by sea floor and range",
    "pfa": "false alarms per km² and per decision",
    "tours": "plans of survey and second looks: how near to the optimum, in what time",
    "adapt": "replanning on the way beside a lawnmower laid beforehand",
    "figure9": "the source paper's examples of classical detection",
}


def add(commands: Commands) -> None:
    parser = command(
        commands,
        "bench",
        "measure speed, memory and what is found",
        "\n".join(f"{name + ':':14}{does}" for name, does in _BENCHES.items()) + "\n\nFurther arguments go to the bench.",
        ["auv-mcm bench waterfall mission.xtf", "auv-mcm bench scenes --help"],
    )
    parser.add_argument("bench", metavar="BENCH", choices=list(_BENCHES), help="what to measure")
    parser.add_argument("arguments", metavar="...", nargs=argparse.REMAINDER, help="arguments of the bench")
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from sim_replay.benches.chain import main as bench

    return bench([arguments.bench, *arguments.arguments])
