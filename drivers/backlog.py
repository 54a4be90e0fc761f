"""Queue bytes for decoding in order of arrival, so that decoding takes a bounded part of each turn of the event
loop."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from typing import Final, NamedTuple

from auv_mcm.clock import Stamp

TURN_S: Final = 0.01
"""Processor time for decoding in one turn of the event loop: signals, timers and other wires wait for no longer than
this and one chunk."""
MAX_WAITING_BYTES: Final = 1 << 20
"""Per port. At 0.3 s per MB, the allowance of `auv-mcm bench all --stages framers`, junk delays other ports by no more
than 0.3 s."""
_CHUNK_BYTES: Final = (
    256  # that a chunk counts for besides its own: what is done for each, however short, takes about 0.1 ms
)


class Chunk(NamedTuple):
    """Hold bytes of a port and when they were read."""

    port: str
    data: bytes
    stamp: Stamp


class Backlog:
    """Queue chunks, bounded for each port.

    Chunks are never reordered, so the result does not depend on processing time.

    n_refused: bytes by port that found no room.
    """

    def __init__(self, cpu_s: Callable[[], float], max_waiting_bytes: int = MAX_WAITING_BYTES) -> None:
        """cpu_s: processor time of this thread, in seconds."""
        self.n_refused: Counter[str] = Counter()
        self._cpu_s = cpu_s
        self._max_waiting_bytes = max_waiting_bytes
        self._chunks: deque[Chunk] = deque()
        self._waiting: Counter[str] = Counter()
        self._left_s = TURN_S

    def __bool__(self) -> bool:
        return bool(self._chunks)

    def add(self, chunk: Chunk) -> bool:
        """Queue a chunk; return False if too much of its port waits already. A single chunk always finds room."""
        waiting = self._waiting[chunk.port]
        if waiting and waiting + _weight(chunk) > self._max_waiting_bytes:
            self.n_refused[chunk.port] += len(chunk.data)
            return False
        self._waiting[chunk.port] = waiting + _weight(chunk)
        self._chunks.append(chunk)
        return True

    def begin_turn(self) -> None:
        """Start a turn of the event loop, with a new allowance of processor time."""
        self._left_s = TURN_S

    def work(self, decode: Callable[[Chunk], None]) -> bool:
        """Decode chunks until none waits or the allowance of this turn is used up; return whether any still waits."""
        while self._chunks and self._left_s > 0.0:
            began_s = self._cpu_s()
            chunk = self._chunks.popleft()
            self._waiting[chunk.port] -= _weight(chunk)
            decode(chunk)
            self._left_s -= self._cpu_s() - began_s
        return bool(self._chunks)

    def give_up(self) -> None:
        """Drop all chunks that still wait, and count them as refused."""
        for chunk in self._chunks:
            self.n_refused[chunk.port] += len(chunk.data)
        self._chunks.clear()
        self._waiting.clear()


def _weight(chunk: Chunk) -> int:
    return len(chunk.data) + _CHUNK_BYTES
