"""Training of the detector's cascade."""

from __future__ import annotations

import argparse

from auv_mcm.commands import Commands, command


def add(commands: Commands) -> None:
    parser = command(
        commands,
        "train",
        "train the detector's cascade from simulated missions and augmented logs",
        "Renders labelled tiles as a YAML file says, or takes those of a folder, and writes a model file for 'detect.model'.\n"
        "'auv-mcm train -- --help' lists the arguments.",
        ["auv-mcm train --out model.json", "auv-mcm train theatre.yaml --out model.json --scheduler tcp://10.0.0.1:8786"],
    )
    parser.add_argument("arguments", metavar="...", nargs=argparse.REMAINDER, help="arguments of the training")
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from sim_replay.fitting.cascade.command import main

    return main([argument for argument in arguments.arguments if argument != "--"])
