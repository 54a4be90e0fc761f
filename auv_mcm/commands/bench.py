"""Benches."""

from __future__ import annotations

import argparse
import importlib
from typing import Final

from auv_mcm.commands import Commands, Parser, command

BENCHES: Final = {  # modules of sim_replay.benches with add_arguments and run, imported if chosen
    "waterfall": ("chain", "the whole chain, cost per stage"),
    "detect": ("detect", "the detector's cost per tile"),
    "simulate": ("simulate", "the simulator's cost"),
    "scenes": ("scenes", "what is found in the named scenes, and what each step of the close look adds"),
    "froc": ("froc", "every detector and each step after it, on missions held out from all training"),
    "segmentation": ("segmentation", "Markov-field segmentation, error beside time"),
    "snakes": ("snakes", "contours, error beside time"),
    "shapes": ("shapes", "classification by shape, error beside time"),
    "beliefs": ("beliefs", "what views make one believe"),
    "images": ("real_images", "outlines and calls on real pictures"),
    "cascade": ("cascade", "the trained cascade's speed and budgets"),
    "inversion": ("inversion", "relief recovered from images, error beside time"),
    "augment": ("augment", "whether embedded targets can be told from simulated ones"),
    "framers": ("framers", "message framing: speed, garbage, and what damage costs"),
    "mutants": ("mutants", "damaged logs: none may crash, hang, take memory, or report what cannot be"),
    "ports": ("ports", "the service at a full serial line: start, processor time, how late pings are"),
    "soak": ("soak", "the service for long, and killed: memory, counters, what is lost"),
    "law": ("law", "whether the law of a recorder is recognised, and its decibels per count"),
    "seabed": ("seabed", "the live map of the sea floor against the truth of the named scenes"),
    "clearance": ("clearance", "mines left as estimated against those really left"),
    "performance": ("performance", "predicted against realised detection, by sea floor and range"),
    "pfa": ("pfa", "false alarms per km² and per decision"),
    "tours": ("tours", "plans of survey and second looks: how near to the optimum, in what time"),
    "adapt": ("adapt", "replanning on the way beside a lawnmower laid beforehand"),
    "figure9": ("figure9", "the source paper's examples of classical detection"),
}


def add(commands: Commands) -> None:
    parser = command(
        commands,
        "bench",
        "measure speed, memory and what is found",
        "\n".join(f"{name + ':':14}{does}" for name, (_, does) in BENCHES.items()) + "\n\nFurther arguments go to the bench.",
        ["auv-mcm bench waterfall mission.xtf", "auv-mcm bench scenes --help"],
    )
    parser.add_argument("bench", metavar="BENCH", choices=list(BENCHES), help="what to measure")
    parser.add_argument("arguments", metavar="...", nargs=argparse.REMAINDER, help="arguments of the bench")
    parser.set_defaults(command=_run)


def _run(chosen: argparse.Namespace) -> int:
    module, does = BENCHES[chosen.bench]
    bench = importlib.import_module(f"sim_replay.benches.{module}")
    parser = Parser(prog=f"auv-mcm bench {chosen.bench}", description=f"Measure: {does}.")
    bench.add_arguments(parser)
    return int(bench.run(parser.parse_args(chosen.arguments)))
