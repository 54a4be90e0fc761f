"""Read the messages of a file in chunks, in bounded memory."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Generic, TypeVar

from auv_mcm.errors import BadInputError
from auv_mcm.records import Notice
from auv_mcm.safe_files import open_regular
from drivers.framing import Framed, Framer, Grammar

M = TypeVar("M")


class MessageFile(Generic[M]):
    """Iterate over the messages of one file, with their offsets; every iteration starts at its beginning.

    `counters`: those of the framer behind `reader.`, e.g. reader.jsf.bytes_skipped.
    """

    def __init__(
        self, path: Path, make_grammar: Callable[[int], Grammar[M]], chunk_bytes: int, header_bytes: int = 0
    ) -> None:
        """Check that the file can be read. make_grammar: given its size in bytes, for one iteration.

        header_bytes: before the first message. Raises BadInputError for a file that cannot be read.
        """
        self.path = path
        self.bytes_read = 0
        self._make_grammar = make_grammar
        self._chunk_bytes, self._header_bytes = chunk_bytes, header_bytes
        try:
            self.size_bytes = os.stat(path).st_size
        except OSError as error:
            raise _unreadable(path, error) from error
        self._grammar = make_grammar(self.size_bytes)
        self._framer = Framer(self._grammar)

    @property
    def counters(self) -> Counter[str]:
        return Counter({f"reader.{name}": n for name, n in self._framer.counters.items()})

    def damage(self) -> Notice | None:
        """Report how many bytes so far belong to no message, None if all do."""
        n_bytes = self._framer.counters[f"{self._grammar.name}.bytes_skipped"]
        if not n_bytes:
            return None
        text = (
            f"{n_bytes} bytes of {self.path} belong to no whole message and are left out. If it is much, fetch the "
            "file again."
        )
        return Notice(code="reader.damaged_bytes", text=text, place=self.path.name)

    def __iter__(self) -> Iterator[Framed[M]]:
        """Iterate. Raises BadInputError where the file can no longer be read."""
        self._grammar = self._make_grammar(self.size_bytes)
        self._framer = framer = Framer(self._grammar)
        try:
            with open_regular(self.path, 0) as file:
                framer.n_fed = self.bytes_read = len(file.read(self._header_bytes))
                while chunk := file.read(self._chunk_bytes):
                    self.bytes_read += len(chunk)
                    yield from framer.feed(chunk)
        except OSError as error:
            raise _unreadable(self.path, error) from error
        yield from framer.finish()


def _unreadable(path: Path, error: OSError) -> BadInputError:
    return BadInputError(f"{path} cannot be read: {error.strerror}. Check the path and its permissions.")
