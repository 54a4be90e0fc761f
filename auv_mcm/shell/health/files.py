"""Keep the newest record of health in a file that any monitor can read, and a history of what changed."""

from __future__ import annotations

import contextlib
import errno
import logging
import math
import os
from functools import partial
from pathlib import Path
from typing import Final

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.safe_files import open_for_append, open_regular, replacing
from auv_mcm.shell.health.record import Health, parse_health
from auv_mcm.shell.journal import Journal

log = logging.getLogger(__name__)

HEALTH: Final = "health.json"
"""The file of the newest record: in the session, and in the folder that RUNTIME_DIRECTORY names, as systemd sets it."""
HISTORY: Final = "health.jsonl"
"""The file, in the session, of records: one a minute, and one whenever a state or a reason changed."""

_HISTORY_S: Final = 60.0  # s between two records of the history: 360 of some 2 kB in a mission of 6 h
_MAX_BYTES: Final = 1 << 20  # of a record that is read; one takes some 2 kB


class HealthFiles:
    """Write each record for monitors. A disk that does not take one costs a warning alone."""

    def __init__(self, session: Path) -> None:
        runtime = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
        self._paths = [session / HEALTH, *([Path(runtime) / HEALTH] if runtime else [])]
        self._history = session / HISTORY
        self._is_whole = False  # the history, for certain: a kill or a full disk may have cut off its last line
        self._written_s = -math.inf
        self._was: tuple[tuple[str, ...], str] | None = None
        self._has_failed = False

    def write(self, health: Health, now_s: float) -> None:
        """Replace the newest record, and add it to the history if it is due. now_s: monotonic."""
        data = health.to_json() + b"\n"
        errors: list[OSError] = []
        # Each for itself: where the disk of the session is full, monitors still learn it from the other folder.
        steps = [partial(_replace, data, self._paths[0]), partial(self._keep, health, data, now_s)]
        for step in (*steps, *(partial(_publish, data, path) for path in self._paths[1:])):
            try:
                step()
            except OSError as error:
                errors.append(error)
        if errors and not self._has_failed:
            first = errors[0]
            log.warning("health is not on disk: %s: %s. Free space on the disk.", first.filename, first.strerror)
        self._has_failed = bool(errors)

    def _keep(self, health: Health, data: bytes, now_s: float) -> None:
        """Add the record to the history if it is due. Raises OSError."""
        judged = health.reasons, health.state
        if judged != self._was or now_s - self._written_s >= _HISTORY_S:
            if not self._is_whole:
                Journal.cut_torn_line(self._history)
            with open_for_append(self._history) as history:
                self._is_whole = history.write(data) == len(data)
            if not self._is_whole:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._history))
            self._was, self._written_s = judged, now_s

    def close(self) -> None:
        """Remove the record outside of the session: the service ends, and nobody keeps it up to date."""
        for path in self._paths[1:]:
            with contextlib.suppress(OSError):
                path.unlink()


def _replace(data: bytes, path: Path) -> None:
    # Not durable: after a power cut nobody asks how the payload was a second before.
    with replacing(path, durable=False) as file:
        file.write(data)


def _publish(data: bytes, path: Path) -> None:
    _replace(data, path)
    path.chmod(0o644)  # it holds no position of a contact


def read_health(path: Path) -> Health:
    """Read a record. Raises UsageError if there is none, BadInputError for a file that holds none."""
    try:
        with open_regular(path) as file:
            return parse_health(file.read(_MAX_BYTES))
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}. Name a session's folder, or start the service") from error
    except ValueError as error:
        raise BadInputError(f"{path} holds no record of health: {error}") from error
