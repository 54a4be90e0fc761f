"""Run a bench."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable
from typing import Final

from auv_mcm.commands import Commands, Parser, command
from auv_mcm.errors import UsageError

BENCHES: Final = {  # modules of sim_replay with EXPERIMENT, or add_arguments and run; imported when chosen
    "chain": ("benches.run_time.bench", "run time against error of the whole chain, beside a plain script"),
    "all": (
        "benches.every_stage.bench",
        "every stage's time against error, beside what a user would take instead; and under stress",
    ),
    "mutants": ("benches.mutants", "damaged logs: none may crash, hang, take memory, or report what cannot be"),
    "seabed": ("benches.seabed", "the live map of the sea floor against the truth of the named scenes"),
    "clearance": ("benches.clearance", "mines left, estimated against true"),
    "views": ("benches.views", "what further views of a contact bring, missions flown along and across"),
    "priors": ("benches.priors", "what knowing the scene's priors is worth: a network of its own beside what ships"),
    "survey": ("benches.survey", "track to clear an area by the payload's plans, and by lawnmowers"),
    "domains": ("benches.domains", "p_mine on whole domains: Pd at given false alarms, and calibration"),
    "view": ("benches.view", "screenshots and film of the documentation, taken in a browser"),
}

_BENCHES_PAGE: Final = "docs/results.md, 'Finished benches',"
_STUDIES_PAGE: Final = "docs/source-paper.md"
ALIASES: Final = {"stability": ["all", "--stress"]}  # names of an older version
FINISHED: Final = {
    ("benches-1", _BENCHES_PAGE): (
        "apertures", "archive", "augment", "cascade", "confirmation", "detect", "framers", "froc", "load", "ports",
        "resolution", "simulate", "tours", "waterfall",
    ),
    ("benches-2", _BENCHES_PAGE): ("adapt", "decibels", "left-out", "library", "limit", "performance", "soak"),
    ("c57be406", _BENCHES_PAGE): ("point", "scenes"),
    ("58369b1f", _BENCHES_PAGE): ("law",),
    ("studies-1", _STUDIES_PAGE): (
        "beliefs", "collage", "families", "figure12", "figure13", "filters", "fusion", "images", "inversion", "pfa",
        "sas", "segmentation", "shadow", "shapes", "snakes", "verifier",
    ),
}  # fmt: skip
"""Benches whose figures are in the documentation, by the tag or commit of the sources that holds them, and by the page
that says how to run them."""
INSTEAD: Final = {
    "cascade": "bench all --stages cascade", "confirmation": "bench all --stages field,contours,solids",
    "framers": "bench all --stages framers", "froc": "bench domains --log LOG",
    "left-out": "calibrate verifier", "performance": "bench clearance",
    "point": "bench domains", "scenes": "bench domains",
    "segmentation": "bench all --stages field", "shapes": "bench all --stages solids",
    "simulate": "bench all --stages simulator", "snakes": "bench all --stages contours",
    "soak": "hil soak cut_off stop_under_load", "tours": "bench all --stages planner", "waterfall": "bench chain",
}  # fmt: skip
"""What measures something like it today."""


def add(commands: Commands) -> None:
    """Add `auv-mcm bench` to the command line."""
    parser = command(
        commands,
        "bench",
        "measure speed, memory and what is found",
        "\n".join(f"{name + ':':14}{does}" for name, (_, does) in BENCHES.items())
        + "\n\nFurther arguments go to the bench.",
        ["auv-mcm bench chain --log mission.xtf", "auv-mcm bench domains --help"],
    )
    parser.add_argument(
        "bench", metavar="BENCH", choices=[*BENCHES, *ALIASES, *sum(FINISHED.values(), ())], help="what to measure"
    )
    parser.add_argument("arguments", metavar="...", nargs=argparse.REMAINDER, help="arguments of the bench")
    parser.set_defaults(command=_run)


def _run(chosen: argparse.Namespace) -> int:
    for (tag, page), names in FINISHED.items():
        if chosen.bench in names:
            instead = INSTEAD.get(chosen.bench)
            raise UsageError(
                f"'{chosen.bench}' is finished, and kept in the sources at {tag}: {page} says where its "
                "results are and how to run it"
                + (f"; 'auv-mcm {instead}' measures something like it" if instead else "")
            )
    name, *options = ALIASES.get(chosen.bench, [chosen.bench])
    module, does = BENCHES[name]
    parser = Parser(prog=f"auv-mcm bench {name}", description=f"Measure {does}.")
    run = opened(module, parser)
    return run(parser.parse_args([*options, *chosen.arguments]))


def opened(module: str, parser: argparse.ArgumentParser) -> Callable[[argparse.Namespace], int]:
    """Import a bench, add its options to a parser, and return what runs it. A declared experiment has both alike."""
    imported = importlib.import_module(f"sim_replay.{module}")
    bench = getattr(imported, "EXPERIMENT", imported)
    bench.add_arguments(parser)
    run: Callable[[argparse.Namespace], int] = bench.run
    return run
