"""Append records to a file that outlives its processes.

One process appends. A process that is spawned with the file inherits it; either end reads any record whose place it
knows, at any time, for nothing that has a place is overwritten.
"""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path
from typing import IO, Any, Final, NamedTuple, TypeVar

import msgspec
import numpy as np

from auv_mcm.safe_files import open_for_update

T = TypeVar("T", bound=msgspec.Struct)


class RecordPlace(NamedTuple):
    """Hold the place of a record in its file, in bytes."""

    start: int
    size: int


class RecordFile:
    """Append records to a file and read them. n_unreadable: how often the disk did not give a record back.

    file: raw and open for reading and writing; None where there is no disk: it takes nothing then.
    """

    def __init__(self, file: IO[bytes] | None) -> None:
        self.n_unreadable = 0
        self.end = 0  # bytes, where the next record begins
        self._file = file

    def __reduce__(self) -> tuple[Any, ...]:
        """Pass the open file on to a process as it is spawned; there is no path to open it by."""
        from multiprocessing.reduction import DupFd

        return _inherited, (None if self._file is None else DupFd(self._file.fileno()),)

    def append(self, record: msgspec.Struct) -> RecordPlace | None:
        """Append a record and return its place; None where the disk does not take it, being full or gone."""
        data = packed(record)
        try:
            self._write(data)
        except OSError:
            return None  # the next record overwrites what was written of this one
        place = RecordPlace(self.end, len(data))
        self.end += len(data)
        return place

    def go_on(self) -> None:
        """Append behind all that the file holds: what a process before has written keeps its place. Raises OSError."""
        if self._file is not None:
            self.end = os.fstat(self._file.fileno()).st_size

    def sync(self) -> None:
        """Wait until the disk holds what was appended. Raises OSError."""
        if self._file is not None:
            os.fsync(self._file.fileno())

    def take_back(self, end: int) -> None:
        """Free the space from byte `end` on, where nothing lies that has been given a place to keep."""
        self.end = end

    def read(self, place: RecordPlace, decoder: msgspec.msgpack.Decoder[T]) -> T:
        """Read a record; its arrays cannot be written to. Raises OSError if the disk does not give it back."""
        try:
            return decoder.decode(self._read(place))
        except (OSError, msgspec.DecodeError) as error:
            self.n_unreadable += 1
            raise OSError(errno.EIO, f"the record at byte {place.start} cannot be read back: {error}") from error

    def close(self) -> None:
        """Give the disk space back once the other process has closed it too. Records cannot be read any more."""
        if self._file is not None:
            self._file.close()

    def _write(self, data: bytes) -> None:
        """Write all bytes. Raises OSError."""
        if self._file is None:
            raise OSError(errno.ENOENT, "there is no file")
        written = 0
        while written < len(data):
            written += os.pwrite(self._file.fileno(), data[written:], self.end + written)

    def _read(self, place: RecordPlace) -> bytes:
        if self._file is None:
            raise OSError(errno.ENOENT, "there is no file")
        return os.pread(self._file.fileno(), place.size, place.start)


def open_record_file(path: Path) -> RecordFile:
    """Open a record file that outlives its processes, made if it is not there; what it holds stays.

    Where it cannot be opened it takes nothing.
    """
    with contextlib.suppress(OSError):
        return RecordFile(open_for_update(path))
    return RecordFile(None)


def _inherited(descriptor: Any) -> RecordFile:
    """Open what `RecordFile.__reduce__` passed on."""
    return RecordFile(None if descriptor is None else open(descriptor.detach(), "r+b", buffering=0))


def packed(record: msgspec.Struct) -> bytes:
    """Pack a record as msgpack, its arrays with their kind and shape."""
    return _ENCODER.encode(record)


def record_decoder(kind: type[T]) -> msgspec.msgpack.Decoder[T]:
    """Make what unpacks records of one kind."""
    return msgspec.msgpack.Decoder(kind, dec_hook=_unpacked_array)


def _packed_array(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"{type(value).__name__} in a record")


def _unpacked_array(kind: Any, array: Any) -> Any:
    dtype, shape, data = array
    return np.frombuffer(data, dtype).reshape(shape)


_ENCODER: Final = msgspec.msgpack.Encoder(enc_hook=_packed_array)
