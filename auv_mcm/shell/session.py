"""Begin a session, or go on with the one that was cut off, and know what that one has announced."""

from __future__ import annotations

import contextlib
import errno
import os
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from auv_mcm.clock import Clock
from auv_mcm.errors import UsageError
from auv_mcm.records import Contact, EarlyContact, Notice, PipelineEvent
from auv_mcm.safe_files import remove_unfinished
from auv_mcm.settings.config import Config
from auv_mcm.shell.latest_session import SESSION, point_latest_to
from auv_mcm.shell.recovery import (
    STATE,
    Announced,
    SessionMemory,
    Unfinished,
    read_announced,
    resumable_session,
    session_kind,
    unfinished_session,
    write_memory,
)
from auv_mcm.shell.whole_files import make_directory

_FULL: Final = (errno.ENOSPC, errno.EDQUOT)  # errors of a full disk


class Session(NamedTuple):
    """Hold the session of a run: its folder, what runs before this one knew and announced, and what to say about it.

    memory: with this start counted. announced: empty for a new session.
    """

    folder: Path
    memory: SessionMemory
    announced: Announced
    notices: tuple[Notice, ...]


class AnnouncedBefore:
    """Say what of the answers to events that are fed again was announced before."""

    def __init__(self, session: Session, fed_again_to: int) -> None:
        """fed_again_to: number of the newest event that a run before has kept."""
        self._known = session.announced.known
        self._notices = Counter(session.memory.notices)
        self._fed_again_to = fed_again_to

    def has(self, number: int, event: PipelineEvent) -> bool:
        """Check what came of event `number`. A notice counts as often as it was raised."""
        match event:
            case Contact():
                return (number, event.id, "") in self._known
            case EarlyContact():
                return (number, event.contact.id, event.state) in self._known
            case Notice() if number <= self._fed_again_to and self._notices[event]:
                self._notices[event] -= 1
                return True
        return False


def open_session(parent: Path, config: Config, clock: Clock, *, may_resume: bool) -> Session:
    """Choose the session to go on with, if the last one was cut off a short time ago; else make a new one.

    Parameters
    ----------
    parent
        The folder of sessions.
    may_resume
        Go on with a session where the configuration allows it.

    A session that may be resumed goes on without its folder while the disk is full, see `keep_session`. Raises
    UsageError for a folder that holds sessions of a thousand seconds from now on, and OSError.
    """
    kind, now_s = session_kind(config), clock.utc_s()
    within_h = config.service.resume_within_h if may_resume else 0.0
    found = resumable_session(parent, kind, now_s, within_h) if within_h > 0.0 else None
    if isinstance(found, Unfinished):
        memory = msgspec.structs.replace(found.memory, n_starts=found.memory.n_starts + 1)
        notice = _resumed(found.folder, memory.n_starts)
        with contextlib.suppress(OSError):  # on a disk that can only be read
            remove_unfinished(found.folder)
        return Session(found.folder, memory, read_announced(found.folder), (notice,))
    unfinished = found or unfinished_session(parent)
    notices: tuple[Notice, ...] = () if unfinished is None else (unfinished,)
    try:
        folder, began_s = _new_folder(parent, now_s)
    except OSError as error:
        if not may_resume or error.errno not in _FULL:
            raise
        folder, began_s = _free_folder(parent, now_s)
        notices += (_no_room(folder),)
    memory = SessionMemory(kind=kind, started_s=began_s, n_starts=1, elapsed_s=0.0)
    return Session(folder, memory, Announced(frozenset(), {}, {}), notices)


def _resumed(folder: Path, n_starts: int) -> Notice:
    text = (
        f"the session in {folder} was cut off and goes on: start {n_starts} of it. Contacts keep their numbers; what "
        "was recorded and not worked off is worked off first."
    )
    return Notice(code="session_resumed", text=text, for_the_record=True)


def _no_room(folder: Path) -> Notice:
    text = (
        f"the disk is full: {folder} cannot be made. The mission goes on, and contacts are announced; nothing of it is "
        "on disk, and a restart would begin with new numbers. Make room: results, recording and what a restart goes on "
        "from are written as soon as there is some."
    )
    return Notice(code="session_not_kept", text=text)


def keep_session(folder: Path, memory: SessionMemory, write_journals: Callable[[], None]) -> None:
    """Write the service's own memory; where the disk took no session yet, begin to keep it.

    The journals come first: a restart that did not know all that was announced would give its numbers to others.
    Raises OSError.

    Parameters
    ----------
    write_journals
        Writes what the disk did not take of them. Raises OSError.
    """
    write_journals()
    if not (folder / STATE).is_dir():
        (folder / STATE).mkdir()
        point_latest_to(folder)
    write_memory(folder, memory)


def _free_folder(parent: Path, now_s: float) -> tuple[Path, float]:
    """Name a session's folder that is not there, by its time; return also that.

    A clock that nobody sets and that begins again with the computer names no two sessions alike.
    """
    for began_s in (now_s + second for second in range(1000)):
        folder = parent / datetime.fromtimestamp(began_s, UTC).strftime(f"{SESSION}%Y%m%dT%H%M%SZ")
        if not os.path.lexists(folder):
            return folder, began_s
    raise UsageError(f"{parent} holds a thousand sessions up to {folder.name}: the computer's clock does not run")


def _new_folder(parent: Path, now_s: float) -> tuple[Path, float]:
    """Make a new folder per run, so that a restart never overwrites earlier results; `latest` points to it.

    Return also the time in its name.
    """
    try:
        make_directory(parent)
    except UsageError as error:
        if isinstance(full := error.__cause__, OSError) and full.errno in _FULL:
            raise full from None  # no other configuration helps, but room does
        raise
    while True:
        folder, began_s = _free_folder(parent, now_s)
        with contextlib.suppress(FileExistsError):  # of a service that was started just now
            folder.mkdir()
            point_latest_to(folder)
            return folder, began_s
