"""Find what a folder shows, and serve it until interrupted."""

from __future__ import annotations

import asyncio
import getpass
import signal
import threading
import webbrowser
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

from auv_mcm.clean_text import clean
from auv_mcm.commands import read_config
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.settings.config import Config
from auv_mcm.shell.journal import Journal
from auv_mcm.shell.latest_session import latest_session
from auv_mcm.shell.snippet_files import make_results_directory
from sim_replay.logs.archive import logs_of
from sim_replay.logs.open_log import is_session, logs_config
from sim_replay.logs.session_parts import recordings_of, session_of
from sim_replay.results_folder import default_results, is_replayed, resolved_log
from sim_replay.verdicts import MAX_TYPE
from sim_replay.view.background_replay import BackgroundReplay
from sim_replay.view.chart import read_chart
from sim_replay.view.mission import ReplayAgain, ShownMission
from sim_replay.view.mission_feed import MissionFeed, OpenedMission, follow_session, open_logs
from sim_replay.view.mission_files import CONTACTS, JOURNAL, SUMMARY, read_summary, summary_config
from sim_replay.view.server import LOOPBACK, MissionServer
from sim_replay.view.waterfall_store import WaterfallStore

Opens = Callable[[threading.Event], OpenedMission | None]
_POLL_S: Final = 0.5  # s between two looks for a session that is to begin


def show(
    paths: list[Path],
    *,
    live: bool = False,
    logs: list[Path],
    config_path: Path | None = None,
    host: str = LOOPBACK,
    port: int = 0,
    by: str = "",
    chart_path: Path | None = None,
    open_browser: bool = False,
) -> int:
    """Serve the page of a mission until SIGINT or SIGTERM. Returns the exit code.

    Parameters
    ----------
    paths
        Folder of results or of a session; or logs, or a folder of logs, which are replayed while they are shown. None
        with `live` for the last session below service.output_directory.
    live
        Wait for the session to begin.
    logs
        For the waterfall, in place of those that the results name.
    config_path
        Configuration file in place of the one that the results or the session hold.
    host, port
        Where to listen; port 0 for any that is free.
    by
        Who judges; "" for the user's name.
    chart_path
        GeoTIFF to show below the map.
    open_browser
        Open the page in the default browser.

    Raises
    ------
    UsageError
        For a folder that is missing, BadInputError for one that shows nothing, HardwareError for an address that
        cannot be had.
    """
    by = by or _user()
    if len(clean(by)) > MAX_TYPE:
        raise UsageError(
            f"{len(clean(by))} characters name who judges, a verdict has room for {MAX_TYPE}: shorten --by"
        )
    config = None if config_path is None else read_config(config_path)
    chart = None if chart_path is None else read_chart(chart_path)
    if not paths and not live:
        raise UsageError("name logs, the folder of results or of a session, or give --live")
    if live and (len(paths) > 1 or any(path.is_file() for path in paths)):
        raise UsageError("--live follows one session: name its folder, or none for the last; logs are shown without it")
    folder = paths[0] if paths else latest_session(Path((config or Config()).service.output_directory))
    if live:
        wait_for_session(folder)
    if live or (len(paths) == 1 and is_shown(folder)):
        mission = open_shown(folder, logs, config, by)
    else:
        mission = open_new(logs_named(paths), config, by)
    _serve_until_closed(mission, MissionServer(mission, host, port, chart=chart), open_browser)
    return 0


def _serve_until_closed(mission: ShownMission, server: MissionServer, open_browser: bool) -> None:
    try:
        asyncio.run(_serve(mission, server, open_browser))
    except (KeyboardInterrupt, asyncio.CancelledError):
        print("closed")
    finally:
        if mission.replay is not None:
            if mission.replay.is_running:
                print("the replay is not finished: what it found so far goes with the next one")
            mission.replay.close()
        mission.feed.close()


def open_shown(folder: Path, logs: list[Path], config: Config | None, by: str) -> ShownMission:
    """Open a folder and begin to make its waterfall.

    Parameters
    ----------
    folder
        Of results, or of a session.
    logs
        In place of those that the results name.
    config
        In place of the one in the results or the session.
    by
        Who judges.

    Raises
    ------
    BadInputError
        For a folder that shows nothing.
    """
    # 'latest' may point to another session later; this one is shown to its end.
    folder = session_of(folder).resolve()
    recordings = recordings_of(folder) if folder.is_dir() else []
    if not is_shown(folder):
        raise BadInputError(
            f"{folder} holds neither results nor a session. Name a folder that auv-mcm replay or auv-mcm run wrote, "
            "or give --live to wait for a session."
        )
    summary = read_summary(folder)
    is_live = summary is None and (bool(recordings) or _is_written(folder / JOURNAL))  # else its replay did not end
    opens: Opens
    if logs:
        used = config or (summary_config(summary, folder) if summary else Config())
        opens = lambda stop: open_logs(logs, used)  # noqa: E731
    elif recordings and not is_live:
        opens = lambda stop: open_logs([folder], config or logs_config([folder]) or Config())  # noqa: E731
    elif is_live:
        opens = partial(follow_session, folder, config)
    else:
        opens = lambda stop: _open_replayed(folder, config)  # noqa: E731

    def again() -> ReplayAgain:
        last = read_summary(folder) or summary  # of the last replay, which this one removes
        assert last is not None
        used, named = config or summary_config(last, folder), logs or named_logs(last, folder)
        return ReplayAgain(_feed(lambda stop: open_logs(named, used)), BackgroundReplay(named, folder, used))

    is_whole = summary is not None and not recordings
    is_early = summary is None and not recordings and not logs
    mission = ShownMission(
        folder,
        _feed(opens),
        by=by,
        is_live=is_live,
        again=again if is_whole else None,
        later=(lambda: _feed(lambda stop: _open_replayed(folder, config))) if is_early else None,
    )
    mission.refresh()
    mission.feed.start()
    return mission


def _is_written(journal: Path) -> bool:
    return journal.exists() and Journal.is_in_use(journal)


def is_shown(folder: Path) -> bool:
    """Find whether a folder holds results or a session, finished or not."""
    recordings = recordings_of(folder) if folder.is_dir() else []
    return bool(recordings) or any((folder / name).exists() for name in (SUMMARY, CONTACTS, JOURNAL))


def logs_named(paths: list[Path]) -> list[Path]:
    """List the logs that paths name, a folder standing for all the logs below it.

    Raises UsageError for a path that is not there or a folder of results among logs, BadInputError for a folder that
    holds neither logs nor results.
    """
    found: list[Path] = []
    for path in paths:
        if not path.exists():
            raise UsageError(f"there is no {path}. Name a log, a folder of logs, results of a replay, or a session.")
        if len(paths) > 1 and path.is_dir() and (path / SUMMARY).exists():
            raise UsageError(f"{path} is a folder of results, which is shown by itself. Name it alone.")
        if path.is_file() or is_session(path):
            found.append(path)
            continue
        try:
            logs = [log.path for log in logs_of(path, path / "results")]
        except BadInputError as error:
            raise BadInputError(
                f"{path} holds neither results nor a session nor a log. Name a folder that auv-mcm replay or auv-mcm "
                "run wrote, logs, or give --live to wait for a session."
            ) from error
        pings = [log for log in logs if not is_session(log)]
        if pings and len(pings) < len(logs):
            print(f"left out: {len(logs) - len(pings)} recorded sessions, each of which is shown by itself")
        found += pings or logs[:1]
    return found


def open_new(logs: list[Path], config: Config | None, by: str) -> ShownMission:
    """Begin to show logs that have no results yet, and to replay them; what was replayed before is shown at once.

    Parameters
    ----------
    logs
        Of one mission, or of many that share a map.
    config
        In place of the one that a recorded session holds.
    by
        Who judges.
    """
    used = config or logs_config(logs) or Config()
    folder = default_results(logs).absolute()
    if is_replayed(folder, used):
        print(f"replayed before: {clean(str(folder))}", flush=True)
        return open_shown(folder, logs, config, by)
    make_results_directory(folder)

    def again() -> ReplayAgain:
        return ReplayAgain(_feed(lambda stop: open_logs(logs, used)), BackgroundReplay(logs, folder, used))

    feed, found = again()
    mission = ShownMission(folder, feed, by=by, is_live=False, replay=found, again=again)
    feed.start()
    return mission


def _open_replayed(folder: Path, config: Config | None) -> OpenedMission:
    """Open the logs that results name. Raises BadInputError, also where no replay has ended."""
    summary = read_summary(folder)
    if summary is None:
        raise BadInputError(
            "the waterfall waits: no replay has ended here, so the results name no log. It is shown once one "
            "ends; if none runs, replay the log again, or name it with --log."
        )
    return open_logs(named_logs(summary, folder), config or summary_config(summary, folder))


def _feed(opens: Opens) -> MissionFeed:
    return MissionFeed(WaterfallStore(), opens)


def named_logs(summary: dict[str, Any], folder: Path) -> list[Path]:
    """Find the logs that a summary names: where they were, as seen from the results, or beside them.

    Raises BadInputError for one that has moved.
    """
    try:
        found = [resolved_log(entry, folder) for entry in summary.get("logs") or []]
    except FileNotFoundError as error:
        raise BadInputError(f"there is no waterfall: the log {error} has moved. Name it with --log.") from error
    if not found:
        raise BadInputError("there is no waterfall: the results name no log. Name it with --log.")
    return found


async def _serve(mission: ShownMission, server: MissionServer, open_browser: bool) -> None:
    serving = asyncio.current_task()
    assert serving is not None
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, serving.cancel)
    await server.open()
    try:
        print(f"{clean(str(mission.folder))}: {server.url} (Ctrl-C ends)", flush=True)
        if mission.replay is not None:
            mission.replay.start()  # after the page can be had
        if open_browser:
            await asyncio.to_thread(webbrowser.open, server.url)
        await asyncio.Event().wait()
    finally:
        await server.close()


def wait_for_session(folder: Path) -> None:
    """Wait until a folder holds the beginning of a session, or results."""
    if not folder.exists():
        print(f"waiting for a session at {clean(str(folder))}", flush=True)
    waiting = threading.Event()
    while not any((folder / name).exists() for name in (SUMMARY, JOURNAL, "recording")):
        waiting.wait(_POLL_S)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "unknown"
