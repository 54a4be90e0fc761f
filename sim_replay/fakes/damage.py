"""Damage streams of messages at random places, as cables and drivers do, and say what is still whole."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from typing import Final, Literal, NamedTuple, get_args

import numpy as np

FaultKind = Literal["flip", "drop", "insert", "truncate", "duplicate"]
FAULT_KINDS: Final[tuple[FaultKind, ...]] = get_args(FaultKind)

_LONGEST_FAULT_BYTES: Final = 64  # bytes of one fault
_MAX_CHUNK_BYTES: Final = 400  # bytes of one read


class Damaged(NamedTuple):
    """Hold a stream after faults.

    intact: which of the messages it was made of are still in it, unbroken. n_faults: by kind.
    """

    stream: bytes
    intact: list[bool]
    n_faults: dict[FaultKind, int]


def damaged(messages: list[bytes], n_faults: int, random: np.random.Generator) -> Damaged:
    """Damage the joined messages at random places, as cables and drivers do.

    Bits flip, bytes get lost, are repeated or come from nowhere (at random, or as a piece of a message), and messages
    lose their end.
    """
    stream = b"".join(messages)
    ends = np.cumsum([len(message) for message in messages])
    starts = ends - [len(message) for message in messages]
    intact = np.ones(len(messages), dtype=np.bool_)
    n_by_kind: dict[FaultKind, int] = dict.fromkeys(FAULT_KINDS, 0)
    parts: list[bytes] = []
    done = 0
    for place in np.sort(random.integers(0, len(stream), n_faults)).tolist():
        if place < done:
            continue  # what is gone already
        kind = FAULT_KINDS[random.integers(len(FAULT_KINDS))]
        n_by_kind[kind] += 1
        parts.append(stream[done:place])
        stop = min(place + int(random.integers(1, _LONGEST_FAULT_BYTES + 1)), len(stream))
        piece = np.frombuffer(stream[place:stop], np.uint8)
        if kind == "truncate":
            stop = int(ends[np.searchsorted(ends, place, side="right")])
        if kind == "insert":
            inserted = stream[stop : 2 * stop - place] if random.random() < 0.5 else random.bytes(stop - place)
            parts.append(inserted)
            stop = place
            hit = (starts < place) & (place < ends)
        elif kind == "duplicate":
            parts.append(2 * piece.tobytes())
            hit = (starts < place) & (stop < ends)  # else one of its two copies is whole
        else:
            if kind == "flip":
                masks = np.left_shift(1, random.integers(0, 8, piece.shape)).astype(np.uint8)
                masks[1:] *= random.random(piece.shape[0] - 1) < 4.0 / _LONGEST_FAULT_BYTES
                parts.append((piece ^ masks).tobytes())
            hit = (starts < stop) & (place < ends)
        intact &= ~hit
        done = stop
    parts.append(stream[done:])
    return Damaged(b"".join(parts), intact.tolist(), n_by_kind)


def cut(stream: bytes, random: np.random.Generator) -> Iterator[bytes]:
    """Cut the stream into chunks of any length."""
    start = 0
    while start < len(stream):
        stop = start + int(random.integers(1, _MAX_CHUNK_BYTES + 1))
        yield stream[start:stop]
        start = stop


def n_missing(wanted: list[Hashable], found: list[Hashable]) -> int:
    """Count those of `wanted` that do not come in `found` in this order, whatever else comes between."""
    n_lost, position = 0, 0
    for item in wanted:
        try:
            position = found.index(item, position) + 1
        except ValueError:
            n_lost += 1
    return n_lost
