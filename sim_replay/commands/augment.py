"""Embed targets into a recorded log."""

from __future__ import annotations

import argparse
from pathlib import Path

from auv_mcm.commands import Commands, Progress, add_config_option, add_json_option, answer, command, read_config


def add(commands: Commands) -> None:
    """Add `auv-mcm augment` to the command line."""
    parser = command(
        commands,
        "augment",
        "embed targets in a recorded log and write the log and the truth",
        "Writes the log with the targets of SPEC in it, under its own name, and truth.json, for 'auv-mcm score'. The "
        "sea floor\n"
        "around each place is inverted, so that shadows follow it and what stands before a target hides it. All "
        "samples that no\n"
        "target changes stay as they are. The same log and SPEC give the same bytes.",
        [
            "auv-mcm augment mission.xtf --targets targets.yaml --out augmented",
            "auv-mcm replay augmented/mission.xtf --out results",
            "auv-mcm score results/contacts.geojson augmented/truth.json",
        ],
    )
    parser.add_argument(
        "log", metavar="LOG", type=Path, help="XTF file with side-scan pings; other formats are not written"
    )
    parser.add_argument(
        "--targets",
        metavar="SPEC",
        type=Path,
        required=True,
        help="YAML file: targets one by one, or how many to draw where",
    )
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True, help="directory for the results, made if it is not there"
    )
    parser.add_argument("--seabed", metavar="NAME", help="seabed type to name in the truth and in scores")
    add_config_option(parser)
    add_json_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    config = read_config(arguments.config)

    from sim_replay.augment.augment_log import augment
    from sim_replay.augment.targets import read_target_spec

    spec = read_target_spec(arguments.targets)
    with Progress("augment") as progress:
        done = augment(arguments.log, spec, arguments.out, config, seabed=arguments.seabed, progress=progress.show)
    hidden = f"; {done.n_hidden} of all hidden by the sea floor" if done.n_hidden else ""
    words = [
        f"{done.n_objects} objects, {done.n_targets} of them targets{hidden}; {done.area_km2:g} km² seen",
        f"log: {done.log}",
        f"truth: {done.truth}",
    ]
    answer(done._asdict(), words, as_json=arguments.json)
    return 0
