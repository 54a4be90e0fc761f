"""Find out what a session that was cut off, or whose disk was full, left out of its results, and report how to get
it."""

from __future__ import annotations

import contextlib
import os
import shlex
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from auv_mcm.errors import AuvMcmError
from auv_mcm.records import Notice
from auv_mcm.shell.journal import Journal

RECORDING: Final = "recording"
"""The folder, among the results, for what live ports received and were sent."""
JOURNAL: Final = "contacts.jsonl"
"""The file, among the results, of contacts as they were announced."""
EARLY_JOURNAL: Final = "early.jsonl"
"""The file of early contacts as they were announced, and of what became of them; there is none without early
contacts."""
SUMMARY: Final = "summary.json"
"""The file that is written last: its presence shows that the session came to its end."""

BALLAST_BYTES: Final = 16 << 20  # contacts.geojson takes about 1 kB a contact, contacts.csv 0.2 kB
_MIN_BALLAST_BYTES: Final = 1 << 16  # bytes; where less than this can be had, none is held


class Ballast:
    """Hold disk space until the results are written. Pictures, recording and other programs thus leave some for them.

    n_bytes: what is held, 0 where the disk is full or cannot set space aside.
    """

    def __init__(self, folder: Path, max_bytes: int = BALLAST_BYTES) -> None:
        """Take `max_bytes`, or the largest half, quarter ... of it that there is. The file has no name and goes with
        the process."""
        self.n_bytes = 0
        self._file = contextlib.ExitStack()
        with contextlib.suppress(OSError):
            file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115, open as long as the mission
            descriptor = self._file.enter_context(file).fileno()
            while max_bytes >= _MIN_BALLAST_BYTES and not self.n_bytes:
                try:
                    os.posix_fallocate(descriptor, 0, max_bytes)
                    self.n_bytes = max_bytes
                except OSError:
                    os.ftruncate(descriptor, 0)
                    max_bytes //= 2

    def release(self) -> None:
        """Give the space back."""
        self._file.close()


def unfinished_session(parent: Path) -> Notice | None:
    """Report that the session to which `latest` points has a recording but no results.

    It was killed, or the power was cut.
    """
    try:
        last = parent / os.readlink(parent / "latest")
        if (last / SUMMARY).exists() or not any((last / RECORDING).iterdir()) or Journal.is_in_use(last / JOURNAL):
            return None
    except (OSError, AuvMcmError):  # there is no such session, or it has no recording
        return None
    return in_recording(last, f"the session before, in {last}, was cut off")


def in_recording(folder: Path, why: str) -> Notice:
    """Report that contacts which were not announced are in the recording of a session alone."""
    text = f"{why}: contacts that were not announced yet are in the recording alone. {_replay_advice(folder)}"
    return Notice(code="contacts_in_recording", text=text)


def all_written(writers: Mapping[str, Callable[[], None]]) -> dict[str, OSError]:
    """Call every writer. Returns what failed, by name: of a disk that is nearly full, small files take what is left."""
    errors = {}
    for name, write in writers.items():
        try:
            write()
        except OSError as error:
            errors[name] = error
    return errors


def results_missing(folder: Path, errors: Mapping[str, OSError]) -> Notice:
    """Report the results that could not be written, why, and what there is instead."""
    text = (
        f"{', '.join(errors)} cannot be written to {folder}: {next(iter(errors.values())).strerror}. "
        f"Contacts announced while there was room are in {JOURNAL} there. Make room on the disk."
    )
    return Notice(
        code="results_missing", text=text + (f" {_replay_advice(folder)}" if (folder / RECORDING).is_dir() else "")
    )


def _replay_advice(folder: Path) -> str:
    return (
        f"To get them run: auv-mcm replay {shlex.quote(str(folder / RECORDING))} --out "
        f"{shlex.quote(str(folder / 'replayed'))}"
    )
