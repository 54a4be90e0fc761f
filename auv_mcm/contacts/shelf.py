"""Records of a long mission on disk, so that what is far away and long ago costs a few bytes of memory; read back when asked for.

The file has no name: it goes with the process, however that ends, and nothing is ever recovered from it. A record that was replaced gets
room to grow, so that the file stays within a few times what is in it. What the disk does not take stays in memory, packed, and is counted.
"""

from __future__ import annotations

import errno
import os
import tempfile
from array import array
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any, Final, Generic, TypeVar

import msgspec
import numpy as np

T = TypeVar("T", bound=msgspec.Struct)

_IN_MEMORY: Final = -1


class Shelf(Generic[T]):
    """Records of one kind, numbered from 0 in the order in which they came; one at a time may be replaced.

    n_in_memory: records that the disk did not take, when they came last. n_unreadable: times the disk did not give one back.
    """

    def __init__(self, folder: Path | None, kind: type[T]) -> None:
        """folder: on the disk to use, that of temporary files if None. Where no file can be opened everything stays in memory."""
        self.n_unreadable = 0
        self._decoder = msgspec.msgpack.Decoder(kind, dec_hook=_unpacked_array)
        self._starts, self._sizes, self._rooms = array("q"), array("I"), array("I")  # in bytes
        self._in_memory: dict[int, bytes] = {}
        self._end = 0
        self._file: IO[bytes] | None = None
        try:
            self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115, open as long as the mission
        except OSError:
            return

    @property
    def n_in_memory(self) -> int:
        return len(self._in_memory)

    def __len__(self) -> int:
        return len(self._starts)

    def append(self, record: T) -> None:
        """Never raises for a disk that is full or gone."""
        self._starts.append(_IN_MEMORY)
        self._sizes.append(0)
        self._rooms.append(0)
        self[len(self) - 1] = record

    def __setitem__(self, number: int, record: T) -> None:
        """Never raises for a disk that is full or gone. Raises IndexError for a number that there is not."""
        data = _ENCODER.encode(record)
        start, room = self._starts[number], self._rooms[number]
        if len(data) > room:
            start, room = self._end, 2 * len(data) if self._sizes[number] else len(data)
        try:
            self._write(data, start)
        except OSError:
            start, room = _IN_MEMORY, 0
            self._in_memory[number] = data
        else:
            self._end = max(self._end, start + room)
            self._in_memory.pop(number, None)
        self._starts[number], self._sizes[number], self._rooms[number] = start, len(data), room

    def __getitem__(self, number: int) -> T:
        """The record, with arrays that cannot be written to. Raises OSError if the disk does not give it back, IndexError without it."""
        start, size = self._starts[number], self._sizes[number]
        try:
            return self._decoder.decode(self._in_memory[number] if start == _IN_MEMORY else self._read(start, size))
        except (OSError, msgspec.DecodeError) as error:
            self.n_unreadable += 1
            raise OSError(errno.EIO, f"record {number} cannot be read back: {error}") from error

    def selected(self, numbers: Iterable[int]) -> Selection[T]:
        """Records in the order of the numbers, which can be gone through again and again."""
        return Selection(self, numbers)

    def close(self) -> None:
        """Give the disk space back. Records cannot be read any more."""
        if self._file is not None:
            self._file.close()

    def _write(self, data: bytes, start: int) -> None:
        """Raises OSError."""
        if self._file is None:
            raise OSError(errno.ENOENT, "there is no file")
        written = 0
        while written < len(data):
            written += os.pwrite(self._file.fileno(), data[written:], start + written)

    def _read(self, start: int, size: int) -> bytes:
        assert self._file is not None
        return os.pread(self._file.fileno(), size, start)


class Selection(Generic[T]):
    """Records of a shelf, read one at a time and anew each time, without those that the disk does not give back."""

    def __init__(self, shelf: Shelf[T], numbers: Iterable[int]) -> None:
        self._shelf = shelf
        self._numbers = numbers

    def __iter__(self) -> Iterator[T]:
        for number in self._numbers:
            try:
                record = self._shelf[number]
            except OSError:
                continue
            yield record


def _packed_array(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"{type(value).__name__} in a record")


def _unpacked_array(kind: Any, packed: Any) -> Any:
    dtype, shape, data = packed
    return np.frombuffer(data, dtype).reshape(shape)


_ENCODER: Final = msgspec.msgpack.Encoder(enc_hook=_packed_array)
