"""Find what a folder shows, and serve it until interrupted."""

from __future__ import annotations

import asyncio
import getpass
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
from sim_replay.logs.session_parts import recordings_of, session_of
from sim_replay.view.mission import ShownMission
from sim_replay.view.mission_feed import MissionFeed, OpenedMission, follow_session, open_logs
from sim_replay.view.mission_files import CONTACTS, JOURNAL, SUMMARY, read_summary, summary_config
from sim_replay.view.server import LOOPBACK, MissionServer
from sim_replay.view.waterfall_store import WaterfallStore

_POLL_S: Final = 0.5  # s between two looks for a session that is to begin


def show(
    folder: Path | None,
    *,
    live: bool = False,
    logs: list[Path],
    config_path: Path | None = None,
    host: str = LOOPBACK,
    port: int = 0,
    by: str = "",
    open_browser: bool = False,
) -> int:
    """Serve the page of a folder until interrupted. Returns the exit code.

    Parameters
    ----------
    folder
        Of results or of a session; None with `live` for the last session below service.output_directory.
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
    open_browser
        Open the page in the default browser.

    Raises
    ------
    UsageError
        For a folder that is missing, BadInputError for one that shows nothing, HardwareError for an address that
        cannot be had.
    """
    config = None if config_path is None else read_config(config_path)
    if folder is None:
        if not live:
            raise UsageError("name the folder of results or of a session, or give --live")
        folder = Path((config or Config()).service.output_directory) / "latest"
    if live:
        wait_for_session(folder)
    mission = open_shown(folder, logs, config, by or _user())
    try:
        asyncio.run(_serve(mission, host, port, open_browser))
    except KeyboardInterrupt:
        print("closed")
    finally:
        mission.feed.close()
        mission.store.close()
    return 0


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
    if not recordings and not any((folder / name).exists() for name in (SUMMARY, CONTACTS, JOURNAL)):
        raise BadInputError(
            f"{folder} holds neither results nor a session. Name a folder that auv-mcm replay or auv-mcm run wrote, "
            "or give --live to wait for a session."
        )
    summary = read_summary(folder)
    is_live = summary is None
    opens: Callable[[threading.Event], OpenedMission | None]
    if logs:
        used = config or (summary_config(summary, folder) if summary else Config())
        opens = lambda stop: open_logs(logs, used)  # noqa: E731
    elif recordings or is_live:
        opens = partial(follow_session, folder, config)
    else:
        assert summary is not None
        opens = lambda stop: open_logs(named_logs(summary, folder), config or summary_config(summary, folder))  # noqa: E731
    store = WaterfallStore()
    mission = ShownMission(folder, store, MissionFeed(store, opens), by=by, is_live=is_live)
    mission.refresh()
    mission.feed.start()
    return mission


def named_logs(summary: dict[str, Any], folder: Path) -> list[Path]:
    """Find the logs that a summary names: where they were, or beside the results.

    Raises BadInputError for one that has moved.
    """
    found = []
    for entry in summary.get("logs") or []:
        named = Path(str(entry.get("path", "")))
        places = [named, folder / named.name, folder.parent / named.name]
        path = next((place for place in places if place.exists()), None)
        if path is None:
            raise BadInputError(f"there is no waterfall: the log {named} has moved. Name it with --log.")
        found.append(path)
    if not found:
        raise BadInputError("there is no waterfall: the results name no log. Name it with --log.")
    return found


async def _serve(mission: ShownMission, host: str, port: int, open_browser: bool) -> None:
    server = MissionServer(mission, host, port)
    await server.open()
    try:
        print(f"{clean(str(mission.folder))}: {server.url} (Ctrl-C ends)", flush=True)
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
