"""Write a session's files in chunks, make them durable on demand, rotate them by size, stop before the disk is full."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO, Final, cast

import msgspec
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from auv_mcm.clock import Stamp
from auv_mcm.safe_files import sync_directory
from drivers.recording.session_layout import (
    HEAD_TOPIC,
    LOST_TOPIC,
    PROFILE,
    SEQUENCE_SPAN,
    Direction,
    FileHead,
    Lost,
    Recorded,
    SessionDescription,
    file_name,
)

FILE_BYTES: Final = 1 << 30  # bytes after which the next file begins: as much is lost if its index is
FILE_FLUSHES: Final = (
    1200  # ten minutes of a recorder; until a file ends, the index of each of its chunks is kept in memory
)
RESERVE_BYTES: Final = 256 << 20  # bytes left free on the disk for contacts, results and the system
_MESSAGE_BYTES: Final = 64  # at most, of a message beside its data, with its entry in the index


class DurableFile:
    """Open a new file, unbuffered, as far as the MCAP writer needs one.

    Raises OSError, and leaves no file then; FileExistsError if there is one of that name.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._n_bytes = 0
        try:
            sync_directory(path.parent)  # or a power cut may leave a file without a name
        except OSError:
            self.close()
            with contextlib.suppress(OSError):
                path.unlink()  # or its name is taken when the disk is tried again
            raise

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            n_bytes = self.write_some(rest)
            self._n_bytes += n_bytes
            rest = rest[n_bytes:]
        return len(data)

    def write_some(self, data: memoryview) -> int:
        """Write a part of the data; return how many bytes."""
        return os.write(self._descriptor, data)

    def tell(self) -> int:
        """Return how many bytes were written."""
        return self._n_bytes

    def flush(self) -> None:
        """Do nothing: no data is held back here; `sync` makes it durable."""

    def sync(self) -> None:
        """Wait until the disk holds what was written."""
        os.fsync(self._descriptor)

    def close(self) -> None:
        os.close(self._descriptor)


def free_bytes(folder: Path) -> int:
    """Return the free disk space, in bytes, for a process without privileges. Raises OSError."""
    status = os.statvfs(folder)
    return status.f_bavail * status.f_frsize


class SessionWriter:
    """Write the files of one session.

    After an OSError nothing more can be written until `go_on` succeeds; `abandon` lets go of the file.
    """

    def __init__(
        self,
        folder: Path,
        session: SessionDescription,
        *,
        file_bytes: int = FILE_BYTES,
        file_flushes: int = FILE_FLUSHES,
        reserve_bytes: int = RESERVE_BYTES,
        open_file: Callable[[Path], DurableFile] = DurableFile,
        free_bytes: Callable[[Path], int] = free_bytes,
    ) -> None:
        """Make the folder if need be, and its first file durable.

        file_bytes, file_flushes: from which size on, or after how many flushes, a new file is begun. reserve_bytes:
        disk space left to others. Raises OSError, also if the folder holds a session.
        """
        self._folder = folder
        self._session = session
        self._file_bytes = file_bytes
        self._file_flushes = file_flushes
        self._reserve_bytes = reserve_bytes
        self._open_file = open_file
        self._free_bytes = free_bytes
        self._n_files = 0
        self._n_messages = 0
        self._pending_bytes = 0
        folder.mkdir(parents=True, exist_ok=True)
        self._refuse_full_disk(reserve_bytes)
        self._begin_file()

    def add(self, recorded: Recorded) -> None:
        """Take one more message. It is durable after `flush`."""
        port, direction, stamp, data = recorded
        channel = self._channels.get((port, direction)) or self._add_channel(port, direction, "", "")
        self._mcap.add_message(channel, stamp.utc_ns, data, stamp.mono_ns, self._n_messages % SEQUENCE_SPAN)
        self._n_messages += 1
        self._pending_bytes += len(data) + _MESSAGE_BYTES

    def add_lost(self, lost: Lost) -> None:
        """Mark that bytes are missing here."""
        self._add_note(LOST_TOPIC, lost, lost.last)

    def flush(self) -> None:
        """Make everything taken so far durable; then begin a new file if this one is large or old enough."""
        if not self._pending_bytes:
            return
        self._make_durable()
        self._n_flushes += 1
        if self._file.tell() >= self._file_bytes or self._n_flushes >= self._file_flushes:
            self._finish_file()
            self._begin_file()

    def go_on(self, n_messages: int) -> None:
        """Begin a new file behind n messages, when writing has failed: those after them are to be added again.

        What is read twice then has the same number twice. Asks for twice the reserve, so that a disk at its limit does
        not make many files. Raises OSError.
        """
        self.abandon()
        self._n_messages, self._pending_bytes = n_messages, 0
        self._refuse_full_disk(2 * self._reserve_bytes)
        self._begin_file()

    def close(self) -> None:
        """Make everything durable and write the last file's summary."""
        if self._pending_bytes:
            self._make_durable()
        self._finish_file()

    def abandon(self) -> None:
        """Close the file as it is, unless that is done."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _begin_file(self) -> None:
        path = self._folder / file_name(self._n_files)
        self._file = self._open_file(path)
        try:
            self._mcap = McapWriter(cast(IO[bytes], self._file), compression=CompressionType.NONE)
            self._mcap.start(PROFILE, f"auv-mcm {self._session.version}")
            self._channels: dict[tuple[str, Direction], int] = {}
            self._notes: dict[str, int] = {}
            self._add_note(
                HEAD_TOPIC, FileHead(file_number=self._n_files, session=self._session), self._session.started
            )
            for port in self._session.ports:
                self._add_channel(port.name, "in", port.uri, port.device)
                self._add_channel(port.name, "out", port.uri, port.device)
            self._n_files += 1
            self._n_flushes = 0
            self._make_durable()
        except OSError:
            self.abandon()
            with contextlib.suppress(OSError):
                path.unlink()  # its number is free again
            raise

    def _make_durable(self) -> None:
        self._refuse_full_disk(self._reserve_bytes)
        self._mcap.flush()  # type: ignore[no-untyped-call]  # mcap leaves it unannotated
        self._file.sync()
        self._pending_bytes = 0

    def _finish_file(self) -> None:
        self._mcap.finish()  # type: ignore[no-untyped-call]  # mcap leaves it unannotated
        self._file.sync()
        self._file.close()

    def _add_channel(self, port: str, direction: Direction, uri: str, device: str) -> int:
        about = {"port": port, "direction": direction, "uri": uri, "device": device}
        channel = self._mcap.register_channel(f"{port}/{direction}", "bytes", 0, about)
        self._channels[port, direction] = channel
        return channel

    def _add_note(self, topic: str, note: FileHead | Lost, stamp: Stamp) -> None:
        if topic not in self._notes:
            self._notes[topic] = self._mcap.register_channel(topic, "json", 0)
        data = msgspec.json.encode(note)
        self._mcap.add_message(self._notes[topic], stamp.utc_ns, data, stamp.mono_ns)
        self._pending_bytes += len(data) + _MESSAGE_BYTES

    def _refuse_full_disk(self, reserve_bytes: int) -> None:
        free = self._free_bytes(self._folder)
        if free < reserve_bytes + self._pending_bytes:
            raise OSError(
                errno.ENOSPC,
                f"only {free / 1e6:.1f} MB are free, {self._reserve_bytes / 1e6:.1f} MB are reserved for results and "
                "the system",
            )
