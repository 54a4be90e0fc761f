"""What a session that was cut off, or whose disk was full, left out of its results, and how a person still gets it."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from auv_mcm.errors import AuvMcmError
from auv_mcm.outputs import Journal
from auv_mcm.records import Notice

RECORDING: Final = "recording"
"""The folder, among the results, for what live ports received and were sent."""
JOURNAL: Final = "contacts.jsonl"
"""The file, among the results, of contacts as they were announced."""
SUMMARY: Final = "summary.json"
"""The file that is written last: its presence says that the session came to its end."""


def unfinished_session(parent: Path) -> Notice | None:
    """Report that the session to which `latest` points has a recording but no results: it was killed, or the power was cut."""
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
    return Notice(code="results_missing", text=text + (f" {_replay_advice(folder)}" if (folder / RECORDING).is_dir() else ""))


def _replay_advice(folder: Path) -> str:
    return f"To get them run: auv-mcm replay {shlex.quote(str(folder / RECORDING))} --out {shlex.quote(str(folder / 'replayed'))}"
