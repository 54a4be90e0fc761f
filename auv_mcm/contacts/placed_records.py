"""Know records by number: where each lies in a file or, where the disk did not take it, the record itself.

A record far away and long ago costs the twelve bytes of its place.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Container, Iterable, Iterator
from typing import Final, Generic, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.record_file import RecordFile, RecordPlace, packed, record_decoder

T = TypeVar("T", bound=msgspec.Struct)

_UNKNOWN: Final = -1  # instead of a start in the file: no such record
_IN_MEMORY: Final = -2  # instead of a start in the file: not written yet


class PlacedRecords(Generic[T]):
    """Keep the newest version of each record of one kind, by number."""

    def __init__(self, file: RecordFile, kind: type[T]) -> None:
        self._file = file
        self._decoder = record_decoder(kind)
        self._starts, self._sizes = array("q"), array("I")  # bytes, by number
        self._in_memory: dict[int, bytes] = {}

    @property
    def n_in_memory(self) -> int:
        """Count the records that the disk did not take."""
        return len(self._in_memory)

    def state(self) -> tuple[array[int], array[int], dict[int, bytes]]:
        """Give starts and sizes in the file, by number, and what is in memory."""
        return self._starts, self._sizes, self._in_memory

    def restore(
        self, state: tuple[array[int], array[int], dict[int, bytes]], numbers: Container[int] | None = None
    ) -> None:
        """Take the state of records of the same kind in the same file. numbers: of those to know, None for all."""
        self._starts, self._sizes, self._in_memory = state
        if numbers is not None:
            for number in range(len(self._starts)):
                if number not in numbers:
                    self._starts[number] = _UNKNOWN
                    self._in_memory.pop(number, None)

    def __len__(self) -> int:
        """Count the numbers up to the highest known."""
        return len(self._starts)

    def numbers(self) -> NDArray[np.int64]:
        """List the numbers known, ascending: (n,)."""
        return np.flatnonzero(np.array(self._starts) != _UNKNOWN)

    def keep(self, number: int, record: RecordPlace | T) -> None:
        """Take the newest version of a record: its place or, to be held in memory, the record itself."""
        n_new = number + 1 - len(self._starts)
        self._starts.extend([_UNKNOWN] * n_new)
        self._sizes.extend([0] * n_new)
        if isinstance(record, RecordPlace):
            self._starts[number], self._sizes[number] = record
            self._in_memory.pop(number, None)
        else:
            self._starts[number] = _IN_MEMORY
            self._in_memory[number] = packed(record)

    def __contains__(self, number: int) -> bool:
        return number < len(self._starts) and self._starts[number] != _UNKNOWN

    def place(self, number: int) -> RecordPlace | None:
        """Return where a record lies; None for one that is in memory or not known."""
        if number >= len(self._starts) or self._starts[number] < 0:
            return None
        return RecordPlace(self._starts[number], self._sizes[number])

    def __getitem__(self, number: int) -> T:
        """Read a record. Raises OSError if the disk does not give it back, KeyError for a number not known."""
        place = self.place(number)
        return self._decoder.decode(self._in_memory[number]) if place is None else self._file.read(place, self._decoder)


class Selection(Generic[T]):
    """Iterate over records in the order of the numbers given, without those that cannot be read.

    They are read one at a time, and anew in each iteration.
    """

    def __init__(self, read: Callable[[int], T], numbers: Iterable[int]) -> None:
        self._read = read
        self._numbers = numbers

    def __iter__(self) -> Iterator[T]:
        for number in self._numbers:
            try:
                record = self._read(number)
            except OSError:
                continue
            yield record
