"""Find the messages in a stream of bytes, however damaged and however cut up.

A grammar describes one wire format; a framer searches for its messages. A candidate that is refused costs one byte: the
search goes on right behind its first byte, because only a message that was proven may be skipped. So after any damage
the next intact message is found.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from typing import Final, Generic, NamedTuple, Protocol, TypeAlias, TypeVar

from auv_mcm.clock import Stamp

M = TypeVar("M")
M_co = TypeVar("M_co", covariant=True)

Refused: TypeAlias = dict[str, int]
"""Numbers of refused candidates, by reason."""

_SLICE_BYTES: Final = 1 << 16  # of what is fed at once, so that a large chunk does not make a large buffer


class Framed(NamedTuple, Generic[M]):
    """Hold a message and the bytes [offset, offset + n_bytes) of the stream that it was read from."""

    message: M
    offset: int
    n_bytes: int


class Decoder(Protocol[M_co]):
    """Decode bytes of one link. Never raises, whatever the bytes.

    counters: by dotted name, NAME.messages for every message that was whole and NAME.refused.REASON for what was
    refused. Notices and the self-check judge by the first whether a port can be read.
    """

    @property
    def counters(self) -> Counter[str]: ...

    def feed(self, data: bytes, stamp: Stamp) -> Sequence[M_co]:
        """Return what a chunk completes, in order; bytes of a message may come in any number of chunks.

        stamp: when the chunk's last byte was read.
        """
        ...

    def finish(self) -> Sequence[M_co]:
        """Return what still waited at the end of a log or link."""
        ...


class Grammar(Protocol[M_co]):
    """Recognise messages of one wire format. It never raises, whatever the bytes. One instance serves one framer.

    The results of `find` and `read` depend on the bytes alone. Neither may cost more than a bounded amount of work per
    byte fed, however many candidates there are and however long the messages that they promise: junk can be nothing but
    candidates.

    name: prefix of the counters. head_bytes: as many must be there before `find` can see a candidate; 1 or more.
    max_message_bytes: more are never waited for. proven: a message proves itself intact by its own bytes (a checksum).
    If it does not, one whose end is missing may have swallowed the beginning of the next; unless another follows at
    once, the search then goes back over its last bytes.
    """

    @property
    def name(self) -> str:
        """Name the grammar, for counters."""

    @property
    def head_bytes(self) -> int:
        """Return how many bytes must be there before `find` can see a candidate."""

    @property
    def max_message_bytes(self) -> int:
        """Return the length of the longest message."""

    @property
    def proven(self) -> bool:
        """Find whether a message proves itself intact by its own bytes, as by a checksum."""

    def find(self, buffer: bytearray, start: int, refused: Refused) -> int:
        """Find the first candidate in buffer[start:] that `read` may take or wait for; -1 if there is none.

        Candidates passed over, which `read` would refuse, are added to `refused`, a number by reason; none may be
        passed over whose message may be incomplete. What is found may still be refused by `read`; a candidate at
        `start` needs no look, as it is the next message as a rule.
        """
        ...

    def read(self, buffer: bytearray, at: int) -> tuple[M_co, int] | int | str:
        """Read the candidate at `at`.

        Return the message and its length in bytes; or how many bytes, counted from `at`, are needed to decide; or why
        it is refused, in one word for a counter.
        """
        ...

    def forget(self, n_bytes: int) -> None:
        """Follow the buffer, which has lost its first bytes. For grammars that keep sums over it."""
        return


class Framer(Generic[M]):
    """Find the messages of one stream. The result depends on the bytes alone, not on how they were cut into chunks.

    Holds max_message_bytes and one slice of a chunk at most. `counters`: NAME.messages, NAME.bytes_skipped (outside
    messages), and NAME.refused.REASON.
    """

    def __init__(self, grammar: Grammar[M]) -> None:
        self.counters: Counter[str] = Counter()
        self.n_fed = 0  # bytes
        self._grammar = grammar
        self._buffer = bytearray()
        self._start = 0  # where in the buffer the search goes on
        self._done = 0  # up to here every byte was in a message or is counted as skipped
        self._after_message = False
        self._needed = 1  # bytes in the buffer before it is worth looking again

    @property
    def held_from(self) -> int:
        """Return the stream offset of the first byte that may still become part of a message."""
        return self.n_fed - len(self._buffer)

    def feed(self, data: bytes | bytearray | memoryview) -> list[Framed[M]]:
        """Return the messages that these bytes complete, in order."""
        if len(data) <= _SLICE_BYTES:
            return self._feed(data)
        view = memoryview(data)
        return [
            framed
            for start in range(0, len(data), _SLICE_BYTES)
            for framed in self._feed(view[start : start + _SLICE_BYTES])
        ]

    def finish(self) -> list[Framed[M]]:
        """End the stream: refuse what waits for more bytes, search it for messages, and start anew."""
        found = self._search(final=True)
        self._forget(len(self._buffer))
        self._start, self._needed, self._after_message = 0, 1, False
        return found

    def _feed(self, data: bytes | bytearray | memoryview) -> list[Framed[M]]:
        self._buffer += data
        self.n_fed += len(data)
        return self._search(final=False) if len(self._buffer) >= self._needed else []

    def _search(self, *, final: bool) -> list[Framed[M]]:
        grammar, buffer = self._grammar, self._buffer
        find, read_at, is_proven = grammar.find, grammar.read, grammar.proven
        last_start = len(buffer) - grammar.head_bytes
        origin = self.held_from
        found: list[Framed[M]] = []
        refused: Refused = {}
        at = self._first(refused, final=final)
        while at >= 0:
            read = read_at(buffer, at)
            if isinstance(read, int):
                if not final and read <= grammar.max_message_bytes:
                    self._start, self._needed = at, at + read
                    break
                read = "truncated" if final else "oversize"
            if isinstance(read, str):
                refused[read] = refused.get(read, 0) + 1
                at = find(buffer, at + 1, refused)
            else:
                message, n_bytes = read
                found.append(Framed(message, origin + at, n_bytes))
                if at > self._done:
                    self._skip_to(at)
                self._start = self._done = stop = at + n_bytes
                if not is_proven or stop > last_start:
                    self._after_message = not is_proven
                    at = self._first(refused, final=final)
                    continue
                at = find(buffer, stop, refused)
            if at < 0:
                self._wait_for_head()
        if found:
            self.counters[f"{grammar.name}.messages"] += len(found)
        for reason, count in refused.items():
            self.counters[f"{grammar.name}.refused.{reason}"] += count
        keep = self._start - (grammar.head_bytes - 1 if self._after_message else 0)
        self._forget(max(keep, 0))
        return found

    def _first(self, refused: Refused, *, final: bool) -> int:
        """Return the index of the first candidate, or -1 with `_start` and `_needed` set for more bytes."""
        grammar, buffer, start = self._grammar, self._buffer, self._start
        if len(buffer) - start < grammar.head_bytes and not final:
            self._needed = start + grammar.head_bytes
            return -1
        if self._after_message:
            self._after_message = False
            if grammar.find(buffer, start, {}) == start:
                return start
            start = max(start - grammar.head_bytes + 1, 0)
        at = grammar.find(buffer, start, refused)
        if at < 0:
            self._wait_for_head()
        return at

    def _wait_for_head(self) -> None:
        """Skip a buffer without a candidate; the next may begin in its last bytes."""
        self._start = max(len(self._buffer) - self._grammar.head_bytes + 1, 0)
        self._needed = self._start + self._grammar.head_bytes

    def _skip_to(self, index: int) -> None:
        if index > self._done:
            self.counters[f"{self._grammar.name}.bytes_skipped"] += index - self._done
            self._done = index

    def _forget(self, n_bytes: int) -> None:
        """Drop the first bytes of the buffer; whatever counts them as skipped does so only once."""
        self._skip_to(n_bytes)
        del self._buffer[:n_bytes]
        self._grammar.forget(n_bytes)
        self._start -= n_bytes
        self._done -= n_bytes
        self._needed -= n_bytes


class StampedMessage(NamedTuple, Generic[M]):
    """Hold a message, when its last chunk was read, and the bytes from its first to the end of that chunk."""

    message: M
    received: Stamp
    n_bytes: int


class StampedFramer(Generic[M]):
    """Find messages and stamp them with their arrival, even those that were proven only later."""

    def __init__(self, grammar: Grammar[M]) -> None:
        self._framer = Framer(grammar)
        self.counters = self._framer.counters
        self._chunks: deque[tuple[int, Stamp]] = deque()  # stream offset of the end of each chunk that is still needed

    def feed(self, data: bytes, stamp: Stamp) -> list[StampedMessage[M]]:
        """Return the messages that a chunk completes, in order. stamp: when the chunk was read."""
        if not data:
            return []
        self._chunks.append((self._framer.n_fed + len(data), stamp))
        return self._stamped(self._framer.feed(data))

    def finish(self) -> list[StampedMessage[M]]:
        """Return the messages that the end of the stream completes."""
        return self._stamped(self._framer.finish())

    def _stamped(self, found: list[Framed[M]]) -> list[StampedMessage[M]]:
        arrived = []
        for message, offset, n_bytes in found:
            self._forget_before(offset + n_bytes)
            chunk_end, stamp = self._chunks[0]
            arrived.append(StampedMessage(message, stamp, chunk_end - offset))
        self._forget_before(self._framer.held_from + 1)
        return arrived

    def _forget_before(self, end: int) -> None:
        while self._chunks and self._chunks[0][0] < end:
            self._chunks.popleft()
