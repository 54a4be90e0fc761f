"""Keep on disk the events that came in since the last checkpoints, so that perception can be fed them again.

Files of entries, each with its length and a checksum: events by their number, and marks of how they were fed. A thread
writes them, so that the event loop never waits for the disk; it is at most `WRITE_S` behind, and what it wrote outlives
a power cut after `SYNC_S`. A file ends where its checksums end: what a kill or a power cut left of the last entries is
not read.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import struct
import threading
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

import msgspec

from auv_mcm.contacts.record_file import packed, record_decoder
from auv_mcm.records import NavSample, Notice, Ping, SourceEvent
from auv_mcm.safe_files import open_new, sync_directory

log = logging.getLogger(__name__)

WRITE_S: Final = 0.05
"""s that an event waits in memory: what a kill may cost."""
SYNC_S: Final = 0.5
"""s between two syncs, as of the recording: what a power cut may cost."""
QUEUE_BYTES: Final = 32 << 20  # bytes that wait for the disk, as of the recording; bounds memory while the disk stalls
_HEAD: Final = struct.Struct("<IIQB")  # bytes of the body, checksum, number, kind
_CHECKED: Final = struct.Struct("<QB")  # the part of the head that the checksum covers beside the body
_ROOM: Final = struct.Struct("<d")
_NUMBER: Final = struct.Struct("<Q")
_PATTERN: Final = "events-??????.bin"
_PATIENCE_S: Final = 10.0  # s for the disk to answer, as of the recording; a dead one must not keep the service
_MAX_BODY_BYTES: Final = 64 << 20  # far more than a ping has: a damaged length does not claim memory

_KINDS: Final[dict[type, int]] = {Ping: 1, NavSample: 2, Notice: 3}
_ROOM_KIND: Final = 4  # an entry that is no event, by number behind those that are
_DROPPED_KIND: Final = 5  # as above
_RESERVED_KIND: Final = 6  # as above


class Spooled(NamedTuple):
    """Hold an event as it was fed: its number, and the share of the time that work on tiles might take from it on."""

    number: int
    event: SourceEvent
    room: float


class EventSpool:
    """Append events, numbered from 1 in the order in which they came, and read them back.

    No method raises for a disk that is full or gone: what it does not take is missing when it is read back, and counted
    in `n_lost`. It is tried again with the next file, after `forget`.
    """

    def __init__(self, folder: Path, after: int = 0) -> None:
        """Go on behind what the folder holds, and behind event `after`; those before keep their numbers."""
        self.n_lost = 0
        self._folder = folder
        self._last_in_file = {path: _last_number(path) for path in _files(folder)}  # numbers of events
        self.last = max([after, *self._last_in_file.values()])
        """Number of the newest event."""
        self._state = threading.Condition()
        self._waiting: list[bytes] = []
        self._waiting_bytes = 0
        self._is_sound = True
        self._n_asked = self._n_done = 0  # flushes
        self._forget_to = -1  # number of an event
        self._is_closing = False
        self._thread = threading.Thread(target=self._run, name="event-spool", daemon=True)
        self._thread.start()

    def append(self, event: SourceEvent) -> int:
        """Take an event; return its number. Does not wait."""
        self.last += 1
        self._put(self.last, _KINDS[type(event)], packed(event))
        return self.last

    def mark_room(self, number: int, room: float) -> None:
        """Note that an event was fed with less room than all."""
        self._put(number, _ROOM_KIND, _ROOM.pack(room))

    def mark_dropped(self, first: int, stop: int) -> None:
        """Note that events [first, stop) were dropped and never fed."""
        self._put(first, _DROPPED_KIND, _NUMBER.pack(stop))

    def mark_reserved(self, number: int, n_contacts: int) -> None:
        """Note that the numbers of contacts up to n_contacts were left out before an event was fed."""
        self._put(number, _RESERVED_KIND, _NUMBER.pack(n_contacts))

    def reservations(self) -> dict[int, int]:
        """Read what `mark_reserved` noted: numbers of contacts, by the event before which they were left out."""
        return {
            entry.number: _NUMBER.unpack(entry.body)[0]
            for entry in _entries(self._folder)
            if entry.kind == _RESERVED_KIND
        }

    def flush(self) -> None:
        """Wait until what was appended outlives a power cut. Not for the event loop."""
        with self._state:
            self._n_asked += 1
            asked = self._n_asked
            self._state.notify_all()
            self._state.wait_for(lambda: self._n_done >= asked or not self._thread.is_alive(), timeout=_PATIENCE_S)

    def forget(self, number: int) -> None:
        """Begin a new file, and give back the disk space of those that hold no event behind a number. Does not wait."""
        with self._state:
            self._forget_to = number
            self._n_asked += 1
            self._state.notify_all()

    def read(self, after: int, until: int) -> Iterator[Spooled]:
        """Read the events with numbers in (after, until] that were not dropped, in order; see `flush`."""
        return read_events(self._folder, after, until)

    def close(self) -> None:
        """Write what waits, and end."""
        with self._state:
            self._is_closing = True
            self._state.notify_all()
        self._thread.join(_PATIENCE_S)

    def _put(self, number: int, kind: int, body: bytes) -> None:
        checksum = zlib.crc32(body, zlib.crc32(_CHECKED.pack(number, kind)))
        entry = _HEAD.pack(len(body), checksum, number, kind) + body
        with self._state:
            if not self._is_sound or self._waiting_bytes + len(entry) > QUEUE_BYTES:
                self._lose(1, "the disk is too slow")
                return
            self._waiting.append(entry)
            self._waiting_bytes += len(entry)

    def _lose(self, n_entries: int, why: str) -> None:
        if not self.n_lost:
            log.error(
                "what comes in is not kept for a restart: %s: %s. The mission goes on. Check the disk.",
                self._folder,
                why,
            )
        self.n_lost += n_entries
        self._is_sound = False

    def _run(self) -> None:
        """Write, in a thread of its own, which alone touches the files."""
        for before in self._last_in_file:  # a run that was killed has not synced the last of it
            with contextlib.suppress(OSError), before.open("rb") as left:
                os.fsync(left.fileno())
        path, file = self._new_file()
        unsynced_s, is_last = 0.0, False
        while not is_last:
            with self._state:
                if self._n_asked == self._n_done and not self._is_closing:
                    self._state.wait(WRITE_S)
                entries, self._waiting, self._waiting_bytes = self._waiting, [], 0
                is_last, asked, last = self._is_closing, self._n_asked, self.last
                forget_to, self._forget_to = self._forget_to, -1
            if entries:
                self._write(file, entries)
                self._last_in_file[path] = last
            unsynced_s += WRITE_S
            if asked > self._n_done or is_last or unsynced_s >= SYNC_S:
                unsynced_s = 0.0
                if file is not None:
                    with contextlib.suppress(OSError):
                        os.fsync(file.fileno())
            if forget_to >= 0:
                _close(file)
                self._remove_files(forget_to, except_for=path)
                path, file = self._new_file()
            with self._state:
                self._n_done = asked
                self._state.notify_all()
        _close(file)

    def _write(self, file: BinaryIO | None, entries: list[bytes]) -> None:
        data = memoryview(b"".join(entries))
        try:
            if file is None:
                raise OSError(errno.ENOENT, "no file can be opened")
            while data:
                data = data[file.write(data) :]
        except OSError as error:
            with self._state:
                self._lose(len(entries), error.strerror or str(error))

    def _new_file(self) -> tuple[Path, BinaryIO | None]:
        number = max((_file_number(path) for path in self._last_in_file), default=0) + 1
        path = self._folder / f"events-{number:06d}.bin"
        self._last_in_file[path] = 0
        file: BinaryIO | None = None
        try:
            file = open_new(path)
            sync_directory(self._folder)
        except OSError:
            _close(file)
            return path, None
        with self._state:
            self._is_sound = True
        return path, file

    def _remove_files(self, number: int, except_for: Path) -> None:
        """Remove the files that hold no event behind a number, once. The last may hold marks of how others were fed."""
        for path, last in list(self._last_in_file.items()):
            if path != except_for and last <= number:
                with contextlib.suppress(OSError):
                    path.unlink()
                del self._last_in_file[path]


def read_events(folder: Path, after: int = 0, until: int | None = None) -> Iterator[Spooled]:
    """Read the events of a folder with numbers in (after, until] that were not dropped, in order."""
    rooms: dict[int, float] = {}
    dropped: set[int] = set()
    for entry in _entries(folder):
        if entry.kind == _ROOM_KIND and entry.number > after:
            rooms[entry.number] = _ROOM.unpack(entry.body)[0]
        elif entry.kind == _DROPPED_KIND:
            dropped.update(range(max(entry.number, after + 1), _NUMBER.unpack(entry.body)[0]))
    for entry in _entries(folder):
        is_wanted = entry.number > after and (until is None or entry.number <= until) and entry.number not in dropped
        if entry.kind in _DECODERS and is_wanted:
            event = _DECODERS[entry.kind].decode(entry.body)
            yield Spooled(entry.number, event, rooms.get(entry.number, 1.0))


class _Entry(NamedTuple):
    number: int
    kind: int
    body: bytes


_DECODERS: Final[dict[int, msgspec.msgpack.Decoder[SourceEvent]]] = {
    kind: record_decoder(record) for record, kind in _KINDS.items()
}


def _entries_of(path: Path) -> Iterator[_Entry]:
    """Read the whole entries of a file, up to the first that is damaged. Raises OSError."""
    with path.open("rb") as file:
        while len(head := file.read(_HEAD.size)) == _HEAD.size:
            n_bytes, checksum, number, kind = _HEAD.unpack(head)
            if n_bytes > _MAX_BODY_BYTES:
                return
            body = file.read(n_bytes)
            if len(body) < n_bytes or zlib.crc32(body, zlib.crc32(_CHECKED.pack(number, kind))) != checksum:
                return
            yield _Entry(number, kind, body)


def _entries(folder: Path) -> Iterator[_Entry]:
    for path in _files(folder):
        with contextlib.suppress(OSError):
            yield from _entries_of(path)


def _files(folder: Path) -> list[Path]:
    return sorted(folder.glob(_PATTERN), key=_file_number)


def _file_number(path: Path) -> int:
    return int(path.stem.removeprefix("events-"))


def _last_number(path: Path) -> int:
    with contextlib.suppress(OSError):
        return max((entry.number for entry in _entries_of(path) if entry.kind in _DECODERS), default=0)
    return 0


def _close(file: BinaryIO | None) -> None:
    if file is not None:
        with contextlib.suppress(OSError):
            file.close()  # synced before
