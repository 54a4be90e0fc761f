"""Make the report of a session, finished or not."""

from __future__ import annotations

import argparse
from pathlib import Path

from auv_mcm.clean_text import clean
from auv_mcm.commands import Commands, Progress, add_config_option, command, read_config, whole
from auv_mcm.errors import UsageError


def add(commands: Commands) -> None:
    """Add `auv-mcm report` to the command line."""
    parser = command(
        commands,
        "report",
        "make the report of a session, also while it runs",
        "Replays what the session recorded so far, with the configuration it was recorded with, into SESSION/report/:\n"
        "report.html and all other results of a replay. What people judged of the session is in it. The session's own\n"
        "files stay as they are. A session that went on after a cut is one mission: its recordings are joined.",
        [
            "auv-mcm report auv-mcm-out/latest",
            "auv-mcm report auv-mcm-out/latest --out report --threads 2",
        ],
    )
    parser.add_argument("session", metavar="SESSION", type=Path, help="folder of a session ('auv-mcm run')")
    parser.add_argument("--out", metavar="DIR", type=Path, help="folder for the results (default SESSION/report)")
    parser.add_argument("--threads", metavar="N", type=whole(1, 64), default=1, help="threads that share the work")
    add_config_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from sim_replay.logs.open_log import logs_config
    from sim_replay.logs.session_parts import recordings_of, session_of
    from sim_replay.replay import replay

    session = session_of(arguments.session)
    if not recordings_of(session):
        raise UsageError(
            f"{session} holds no recording. Name the folder of a session that reads ports; of a log, "
            f"'auv-mcm replay {session} --out results' makes the report."
        )
    config = read_config(arguments.config) if arguments.config is not None else None
    out = arguments.out or session / "report"
    with Progress("report") as progress:
        summary = replay(
            [session],
            out,
            config or logs_config([session]) or read_config(None),
            threads=arguments.threads,
            progress=progress.show,
            verdicts=session,
        )
    print(
        f"{summary['pings']} pings so far, {summary['contacts']} contacts, {summary['contacts_mine_like']} of them "
        f"mine-like: {clean(str(out / 'report.html'))}"
    )
    return 0
