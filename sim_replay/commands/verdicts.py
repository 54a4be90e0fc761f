"""Count what people judged, and how far it is from correcting the odds."""

from __future__ import annotations

import argparse
from pathlib import Path

from auv_mcm.commands import Commands, add_json_option, answer, command
from auv_mcm.commands.tables import show_table
from auv_mcm.errors import UsageError


def add(commands: Commands) -> None:
    """Add `auv-mcm verdicts` to the command line."""
    parser = command(
        commands,
        "verdicts",
        "count what people judged, and say what it takes to correct the odds",
        "Reads the verdicts of 'auv-mcm view' in each folder. Objects that were drawn or judged mine-like and that no "
        "contact stands for count as missed, others without a contact as unmatched: they have no odds. 'auv-mcm "
        "calibrate odds --verdicts' takes the same folders once there is enough.",
        ["auv-mcm verdicts results", "auv-mcm verdicts monday tuesday wednesday --json"],
    )
    parser.add_argument(
        "folders", metavar="RESULTS", nargs="+", type=Path, help="folder of results, or of a session, that was judged"
    )
    add_json_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from sim_replay.verdicts import Judged, count_judged, evidence_words, read_verdicts
    from sim_replay.view.mission_files import ContactFile, overview

    def judged(folder: Path) -> Judged:
        contacts = ContactFile(folder)
        contacts.refresh()
        return count_judged(read_verdicts(folder), [overview(one).place for one in contacts.features.values()])

    missing = next((folder for folder in arguments.folders if not folder.is_dir()), None)
    if missing is not None:
        raise UsageError(f"there is no folder {missing}. Name results of a replay, or a session.")
    missions = {str(folder): judged(folder) for folder in arguments.folders}
    words = evidence_words(list(missions.values()))
    if arguments.json:
        answer(
            {"missions": {name: one._asdict() for name, one in missions.items()}, "evidence": words}, (), as_json=True
        )
        return 0
    header = ("mission", "mine-like", "not mine-like", "undecided", "missed", "unmatched")
    show_table("", header, [(name, *map(str, one)) for name, one in missions.items()])
    print(words)
    return 0
