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
    "segmentation": ("studies.segmentation", "Markov-field segmentation, error beside time"),
    "snakes": ("studies.snakes", "contours, error beside time"),
    "shapes": ("studies.shapes", "classification by shape, error beside time"),
    "sas": ("studies.sas", "outlines and classes in synthetic aperture images, simulated and recorded"),
    "filters": ("studies.speckle_filters", "speckle filters before detection: what they cost and what is found"),
    "beliefs": ("studies.beliefs", "what belief several views lead to"),
    "images": ("studies.real_images", "outlines and calls on real pictures"),
    "cascade": ("benches.cascade", "the trained cascade's speed and budgets"),
    "inversion": ("studies.inversion", "relief recovered from images, error beside time"),
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
    "pfa": ("studies.pfa", "false alarms per km² and per decision"),
    "tours": ("benches.tours", "plans of survey and second views: how near to the optimum, in what time"),
    "adapt": ("benches.adapt", "replanning on the way beside a lawnmower laid beforehand"),
    "view": ("benches.view", "whole missions judged in a browser, and heights measured there; makes the screenshots"),
    "families": ("studies.families", "the source paper's classical detection: families of features, one by one"),
    "shadow": ("studies.shadow_normalisation", "chips whose shadow is scaled by range beside chips in plain metres"),
    "fusion": ("studies.classifier_fusion", "several classifiers fused by simple rules, beside each and one of all"),
    "collage": ("studies.floor_collage", "the source paper's targets on a collage of recorded sea floor"),
    "figure12": ("studies.figure12", "the source paper's detection against false alarms, with bands"),
    "figure13": ("studies.figure13", "the source paper's cones in a complex scene, over many seeds"),
}


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
    parser.add_argument("bench", metavar="BENCH", choices=list(BENCHES), help="what to measure")
    parser.add_argument("arguments", metavar="...", nargs=argparse.REMAINDER, help="arguments of the bench")
    parser.set_defaults(command=_run)


def _run(chosen: argparse.Namespace) -> int:
    module, does = BENCHES[chosen.bench]
    try:
        bench = importlib.import_module(f"sim_replay.{module}")
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("sim_replay.studies"):
            raise
        raise UsageError(
            f"'{chosen.bench}' is a study, which is not installed: run it from a checkout of the sources"
        ) from error
    parser = Parser(prog=f"auv-mcm bench {chosen.bench}", description=f"Measure {does}.")
    bench.add_arguments(parser)
    return int(bench.run(parser.parse_args(chosen.arguments)))
