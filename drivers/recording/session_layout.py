"""Define what a recorded session holds and its layout in files.

A session is a folder of MCAP files (https://mcap.dev/spec), each readable without the others: uncompressed chunks with
a CRC-32, a channel per port and direction, one message per chunk of bytes. A message's log time is UTC and its publish
time the monotonic clock, as the bytes were read; its sequence counts the chunks of the whole session. The first message
of a file says what the session is.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple, TypeAlias

import msgspec

from auv_mcm.clock import Stamp

Direction: TypeAlias = Literal["in", "out"]

PROFILE: Final = "auv-mcm-session"
HEAD_TOPIC: Final = "session/head"
LOST_TOPIC: Final = "session/lost"
FILE_PATTERN: Final = "session-*.mcap"
SEQUENCE_SPAN: Final = 2**32  # of the 32-bit sequence number of MCAP


class Recorded(NamedTuple):
    """Hold the bytes of one read of a port (`in`) or one write to it (`out`), and when.

    Empty ones are ticks of the clock.
    """

    port: str
    direction: Direction
    stamp: Stamp
    data: bytes

    @property
    def ends_events(self) -> bool:
        """Find whether no event came of what follows: the service had stopped, and talked to its vehicle alone."""
        return not self.port and self.direction == "out"


class PartEnd(NamedTuple):
    """Mark, between recordings of one session, that its service ended and was started again.

    is_cut_off: it was killed or lost its power, so that decoders lost what they held.
    """

    is_cut_off: bool


class PortDescription(msgspec.Struct, frozen=True, kw_only=True):
    """Describe a port, by its name in the configuration. uri: where it is; device: the name of its driver."""

    name: str
    uri: str
    device: str


class SessionDescription(msgspec.Struct, frozen=True, kw_only=True):
    """Hold what a replay needs.

    version: of the program that recorded; config_yaml: its whole configuration; started: when.
    """

    version: str
    started: Stamp
    config_yaml: str
    ports: tuple[PortDescription, ...]


class FileHead(msgspec.Struct, frozen=True, kw_only=True):
    """Begin each file with the session. file_number: 0, 1 ... in the order of recording."""

    file_number: int
    session: SessionDescription


class Lost(msgspec.Struct, frozen=True, kw_only=True):
    """Count bytes that came too fast for the disk, between the messages before and behind. n_bytes: by port."""

    n_chunks: int
    n_bytes: dict[str, int]
    first: Stamp
    last: Stamp


def file_name(number: int) -> str:
    """Name a file of a session. number: from 0."""
    return f"session-{number:05d}.mcap"
