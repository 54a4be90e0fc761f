"""Append lines of JSON to a file so that each is durable before it is announced."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

from auv_mcm.safe_files import open_for_append, open_for_update, open_regular, sync_directory
from auv_mcm.shell.whole_files import TAKES_NOTHING, finite


class Journal:
    """Append lines of JSON, on disk when `append` returns.

    The file is locked as long as the process lives; see `is_in_use`. On a disk that takes nothing it is opened by the
    first append that finds room.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: BinaryIO | None = None
        self._whole_bytes = 0
        self._owed = b""  # lines that a failed append could not write
        try:
            self._open()
        except OSError as error:
            if error.errno not in TAKES_NOTHING:
                raise

    def _open(self) -> BinaryIO:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open_for_append(self._path)
        with contextlib.suppress(OSError):  # not every file system has locks
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._whole_bytes = self._file.seek(0, os.SEEK_END)  # the file ends in a whole line here
        sync_directory(self._path.parent)
        return self._file

    @staticmethod
    def is_in_use(path: Path) -> bool:
        """Check whether a process that lives holds the journal at `path`. Raises OSError if there is none."""
        with open_regular(path) as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
            except OSError:
                return False
        return False

    @staticmethod
    def cut_torn_line(path: Path) -> None:
        """Cut off what a kill or a power cut left of a last line, which was never announced. Raises OSError.

        A disk that can only be read keeps it.
        """
        if path.exists():
            try:
                with open_for_update(path) as file:
                    file.truncate(file.read().rfind(b"\n") + 1)
            except OSError as error:
                if error.errno != errno.EROFS:
                    raise

    def append(self, records: Iterable[Any]) -> None:
        """Append records. Raises OSError, as on a full disk.

        The file then ends in a whole line, and the records are written with the next ones.
        """
        lines = [
            json.dumps(finite(record), ensure_ascii=False, allow_nan=False, separators=(",", ":")) + "\n"
            for record in records
        ]
        self._owed += "".join(lines).encode("utf-8", "replace")
        self.write_owed()

    def close(self) -> None:
        """Close the file. Raises OSError if lines are still owed and cannot be written."""
        try:
            if self._owed:
                self.write_owed()
        finally:
            if self._file is not None:
                self._file.close()

    def write_owed(self) -> None:
        """Open the file if the disk did not take it, and write what is owed. Raises OSError."""
        if self._file is not None and not self._owed:
            return
        if self._file is None:
            self.cut_torn_line(self._path)
        file = self._file or self._open()
        try:
            written = 0
            while written < len(self._owed):
                written += file.write(self._owed[written:]) or 0
            os.fsync(file.fileno())
        except OSError:
            with contextlib.suppress(OSError):
                file.truncate(self._whole_bytes)
            raise
        self._whole_bytes += len(self._owed)
        self._owed = b""
