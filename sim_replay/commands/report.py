"""Make the report of a session, finished or not, or draw that of results again."""

from __future__ import annotations

import argparse
from pathlib import Path

from auv_mcm.commands import Commands, Progress, add_config_option, add_json_option, answer, command, read_config, whole
from auv_mcm.errors import UsageError


def add(commands: Commands) -> None:
    """Add `auv-mcm report` to the command line."""
    parser = command(
        commands,
        "report",
        "make the report of a session, also while it runs, or draw that of results again",
        "Of a session: replays what it recorded so far, all starts of it as one mission, with the configuration it was "
        "recorded with, into SESSION/report/: report.html and all other results of a replay. The session's own files "
        "stay as they are. Of results: draws report.html and one-page.html again without a replay. What people judged "
        "until now is in either.",
        [
            "auv-mcm report auv-mcm-out/latest",
            "auv-mcm report results",
            "auv-mcm report auv-mcm-out/latest --out report --threads 2",
        ],
    )
    parser.add_argument(
        "session", metavar="SESSION|RESULTS", type=Path, help="folder of a session ('auv-mcm run'), or of results"
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="folder for the results (default SESSION/report)")
    parser.add_argument("--threads", metavar="N", type=whole(1, 64), default=1, help="threads that share the work")
    add_config_option(parser)
    add_json_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from auv_mcm.shell.recovery import SUMMARY
    from sim_replay.logs.session_parts import recordings_of, session_of

    session = session_of(arguments.session)
    if recordings_of(session):
        return _of_session(arguments, session)
    if not (arguments.session / SUMMARY).is_file():
        raise UsageError(
            f"{arguments.session} holds neither a recording nor results. Name the folder of a session that reads "
            f"ports, or of results; of a log, 'auv-mcm replay {arguments.session} --out results' makes the report."
        )
    if arguments.out is not None or arguments.config is not None:
        raise UsageError("--out and --config are for sessions: results are drawn again as they are")
    from sim_replay.report.report_file import REPORT, redraw_report
    from sim_replay.verdicts import newest_verdicts

    n_verdicts = len(newest_verdicts(redraw_report(arguments.session).mission.verdicts))
    path = arguments.session / REPORT
    answer({"verdicts": n_verdicts, "report": path}, [f"{n_verdicts} verdicts: {path}"], as_json=arguments.json)
    return 0


def _of_session(arguments: argparse.Namespace, session: Path) -> int:
    from sim_replay.commands.replay import notice_words
    from sim_replay.logs.open_log import logs_config
    from sim_replay.replay import replay

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
    found = (
        f"{summary['pings']} pings so far, {summary['contacts']} contacts, {summary['contacts_mine_like']} of them "
        f"mine-like: {out / 'report.html'}"
    )
    words = [found, *map(notice_words, summary["notices"])]
    answer({**summary, "report": out / "report.html"}, words, as_json=arguments.json)
    return 0
