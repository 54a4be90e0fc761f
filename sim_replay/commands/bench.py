"""Run a bench."""

from __future__ import annotations

import argparse
import importlib
from typing import Final

from auv_mcm.commands import Commands, Parser, command
from auv_mcm.errors import UsageError

BENCHES: Final = {  # modules of sim_replay with add_arguments and run, imported when chosen
    "chain": ("benches.run_time.bench", "run time against error of the whole chain, beside a plain script"),
    "all": ("benches.every_stage.bench", "every stage's time against error, beside what a user would take instead"),
    "stability": ("benches.stability.bench", "the largest error of every numerical stage, against exact arithmetic"),
    "waterfall": ("benches.chain", "the whole chain, cost per stage"),
    "detect": ("benches.detect", "the detector's cost per tile"),
    "confirmation": ("benches.confirmation", "the cost of confirmation, step by step"),
    "simulate": ("benches.simulate", "the simulator's cost"),
    "scenes": ("benches.scenes", "what is found in the named scenes, and what each step of confirmation adds"),
    "froc": ("benches.froc", "every detector and each step after it, on missions held out from all training"),
    "cascade": ("benches.cascade", "the trained cascade's speed and budgets"),
    "augment": ("benches.augment", "whether embedded targets can be separated from simulated ones"),
    "framers": ("benches.framers", "message framing: speed, garbage, and what damage costs"),
    "mutants": ("benches.mutants", "damaged logs: none may crash, hang, take memory, or report what cannot be"),
    "ports": ("benches.ports", "the service at a full serial line: start, processor time, how late pings are"),
    "archive": ("benches.archive", "a batch that is killed on its way against one that is not: the same bytes"),
    "soak": ("benches.soak", "the service for long, and killed: memory, counters, what is lost"),
    "load": ("benches.load", "the worst floors, ping by ping, and a ledger of 100,000 contacts"),
    "law": ("benches.law", "whether the law of a recorder is recognised, and its decibels per count"),
    "decibels": ("benches.decibels", "what wrong decibels per count cost in detection"),
    "seabed": ("benches.seabed", "the live map of the sea floor against the truth of the named scenes"),
    "clearance": ("benches.clearance", "mines left, estimated against true"),
    "performance": ("benches.performance", "predicted against realised detection, by sea floor and range"),
    "point": (
        "benches.point",
        "false alarms at the operating point against those requested, and Pd, on domains left out",
    ),
    "limit": ("benches.limit", "how far from the limit: an ideal observer beside the chain, and one view beside two"),
    "resolution": ("benches.resolution.bench", "pixels from 1.5 to 48 cm: the best observer, and the chain"),
    "library": ("benches.library", "what a list of the mines expected is worth: right, wrong, incomplete"),
    "apertures": ("benches.apertures", "sub-apertures of one pass beside further passes, on synthetic aperture"),
    "domains": ("benches.domains", "p_mine on whole domains: Pd at given false alarms, and calibration"),
    "left-out": (
        "benches.left_out",
        "the odds of a mine on domains left out, and what each measurement is worth there",
    ),
    "tours": ("benches.tours", "plans of survey and second views: how near to the optimum, in what time"),
    "adapt": ("benches.adapt", "replanning on the way beside a lawnmower laid beforehand"),
    "view": ("benches.view", "whole missions judged in a browser, and heights measured there; makes the screenshots"),
}

FROZEN: Final = (
    "beliefs", "collage", "families", "figure12", "figure13", "filters", "fusion", "images", "inversion", "pfa", "sas",
    "segmentation", "shadow", "shapes", "snakes", "verifier",
)  # fmt: skip
"""Finished studies: their figures are in the documentation, their programs at a tag of the sources."""
_CURVES: Final = {"segmentation": "field", "snakes": "contours", "shapes": "solids"}
"""Stages of `bench all` that measure what a study did."""


def add(commands: Commands) -> None:
    """Add `auv-mcm bench` to the command line."""
    parser = command(
        commands,
        "bench",
        "measure speed, memory and what is found",
        "\n".join(f"{name + ':':14}{does}" for name, (_, does) in BENCHES.items())
        + "\n\nFurther arguments go to the bench.",
        ["auv-mcm bench waterfall mission.xtf", "auv-mcm bench scenes --help"],
    )
    parser.add_argument("bench", metavar="BENCH", choices=[*BENCHES, *FROZEN], help="what to measure")
    parser.add_argument("arguments", metavar="...", nargs=argparse.REMAINDER, help="arguments of the bench")
    parser.set_defaults(command=_run)


def _run(chosen: argparse.Namespace) -> int:
    if chosen.bench in FROZEN:
        curve = _CURVES.get(chosen.bench)
        instead = f"; 'auv-mcm bench all --stages {curve}' measures its curve" if curve else ""
        raise UsageError(
            f"'{chosen.bench}' is a finished study, kept in the sources at the tag studies-1: the page 'The source "
            f"paper's experiments' has its results and says how to run it{instead}"
        )
    module, does = BENCHES[chosen.bench]
    bench = importlib.import_module(f"sim_replay.{module}")
    parser = Parser(prog=f"auv-mcm bench {chosen.bench}", description=f"Measure {does}.")
    bench.add_arguments(parser)
    return int(bench.run(parser.parse_args(chosen.arguments)))
