"""Score contacts against the truth."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from auv_mcm.commands import Commands, command
from auv_mcm.errors import UsageError
from sim_replay.arguments import new_file


def add(commands: Commands) -> None:
    """Add `auv-mcm score` to the command line."""
    parser = command(
        commands,
        "score",
        "score contacts against the truth: detections, false alarms, errors",
        "Takes pairs of a contacts.geojson and a truth.json; several pairs are pooled. Prints Pd with Wilson and false "
        "alarms\n"
        "per km² with exact Poisson intervals (95 %) over thresholds of p_mine, and where they come from.",
        [
            "auv-mcm score results/contacts.geojson sim/truth.json",
            (
                "auv-mcm score r1/contacts.geojson s1/truth.json r2/contacts.geojson s2/truth.json --json score.json "
                "--plot froc.png"
            ),
        ],
    )
    parser.add_argument(
        "files", metavar="FILE", nargs="+", type=Path, help="contacts.geojson and truth.json of each mission, in pairs"
    )
    parser.add_argument(
        "--gate-m",
        metavar="M",
        type=float,
        default=2.0,
        help="maximum distance of a contact from its object, m (default 2)",
    )
    parser.add_argument(
        "--threshold",
        metavar="P",
        type=float,
        default=0.5,
        help="minimum p_mine of a contact that counts as a call (default 0.5)",
    )
    parser.add_argument(
        "--json",
        metavar="PATH",
        nargs="?",
        const="-",
        help="write everything as JSON to PATH, too; without a PATH, behind the files, print it and nothing else",
    )
    parser.add_argument("--brief", action="store_true", help="print one sentence")
    parser.add_argument(
        "--plot", metavar="PATH", type=new_file, help="draw the curve of Pd over false alarms (.png, .svg, .pdf)"
    )
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from sim_replay.scoring import plot, score_files, score_json, sentence, table

    scored = {path.resolve() for path in arguments.files}
    for option, path in (("--json", arguments.json), ("--plot", arguments.plot)):
        if path is not None and Path(path).resolve() in scored:
            raise UsageError(f"{option} {path} is what is scored, and is never overwritten. Name another file")
    score = score_files(arguments.files, gate_m=arguments.gate_m, threshold=arguments.threshold)
    if arguments.json == "-":
        sys.stdout.write(score_json(score).decode())
    else:
        print(sentence(score) if arguments.brief else table(score))
    if arguments.json not in (None, "-"):
        try:
            Path(arguments.json).write_bytes(score_json(score))
        except OSError as error:
            raise UsageError(f"--json {arguments.json} cannot be written: {error.strerror}") from error
    if arguments.plot is not None:
        plot(score, arguments.plot)
    return 0
