"""Hand the samples of pings from one process to another through a ring buffer in shared memory."""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace, Ping, SourceEvent

_ALIGNMENT: Final = 64  # bytes: a cache line, so that arrays in shared memory begin on one


class Ring:
    """Track who holds which bytes of a ring buffer; space is given back in the order it was taken."""

    def __init__(self, n_bytes: int) -> None:
        self.n_bytes = n_bytes
        self._taken: deque[tuple[int, int]] = deque()

    def take(self, n_bytes: int) -> int | None:
        """Take `n_bytes` in one piece and give their offset, or None as long as there is no room."""
        n_bytes = max(-(-n_bytes // _ALIGNMENT), 1) * _ALIGNMENT
        if not self._taken:
            start, limit = 0, self.n_bytes
        else:
            oldest, newest_end = self._taken[0][0], self._taken[-1][1]
            if newest_end <= oldest:
                start, limit = newest_end, oldest
            elif newest_end + n_bytes <= self.n_bytes:
                start, limit = newest_end, self.n_bytes
            else:
                start, limit = 0, oldest
        if start + n_bytes > limit:
            return None
        self._taken.append((start, start + n_bytes))
        return start

    def give_back(self) -> None:
        """Free the oldest piece."""
        self._taken.popleft()


class RingTrace(NamedTuple):
    """Say where a trace's samples lie."""

    offset: int
    shape: tuple[int, ...]
    dtype: str
    first_range_m: float
    spacing_m: float


class RingPing(NamedTuple):
    """Hold a ping whose samples are in the ring. room: see Pipeline.leave_room."""

    rest: Ping  # without its traces
    port: RingTrace | None
    starboard: RingTrace | None
    room: float


def bytes_in_ring(event: SourceEvent) -> int:
    """Compute what an event takes in the ring at most; 0 for what has no samples."""
    traces = (event.port, event.starboard) if isinstance(event, Ping) else ()
    return sum(trace.samples.nbytes + _ALIGNMENT for trace in traces if trace is not None)


def into_ring(ping: Ping, memory: NDArray[np.uint8], offset: int, room: float) -> RingPing:
    """Copy a ping's samples into the memory from an offset on."""

    def place(trace: EchoTrace | None) -> RingTrace | None:
        nonlocal offset
        if trace is None:
            return None
        samples = np.ndarray(trace.samples.shape, trace.samples.dtype, memory, offset)
        samples[...] = trace.samples
        placed = RingTrace(offset, samples.shape, samples.dtype.str, trace.first_range_m, trace.spacing_m)
        offset += -(-trace.samples.nbytes // _ALIGNMENT) * _ALIGNMENT
        return placed

    port, starboard = place(ping.port), place(ping.starboard)
    return RingPing(msgspec.structs.replace(ping, port=None, starboard=None), port, starboard, room)


def out_of_ring(ping: RingPing, memory: NDArray[np.uint8]) -> Ping:
    """Copy a ping's samples out of the memory."""

    def copy(trace: RingTrace | None) -> EchoTrace | None:
        if trace is None:
            return None
        samples = np.ndarray(trace.shape, np.dtype(trace.dtype), memory, trace.offset).copy()
        return EchoTrace(samples=samples, first_range_m=trace.first_range_m, spacing_m=trace.spacing_m)

    return msgspec.structs.replace(ping.rest, port=copy(ping.port), starboard=copy(ping.starboard))
