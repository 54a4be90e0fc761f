"""Find packets in an XTF file, however damaged.

XTF (eXtended Triton Format, Triton Imaging, rev. 42): a file header of n * 1024 bytes, then packets that start with the
magic number 0xFACE, their type, and their length in bytes. Here damage is survived: where no packet starts, or one has
an impossible length, the next trustworthy packet is searched for, byte by byte.
"""

from __future__ import annotations

import struct
from collections.abc import Container, Iterator
from typing import BinaryIO, Final, NamedTuple, TypeAlias

import msgspec

MAGIC: Final = b"\xce\xfa"
FILE_FORMAT: Final = 0x7B  # first byte of a file header
HEADER_BLOCK: Final = 1024  # bytes: a file header is a multiple of it (XTF)
MAX_PACKET_BYTES: Final = 64 << 20  # water-column packets reach some MB; anything above this is a damaged length

_START: Final = struct.Struct("<2sBBHxxxxI")  # magic, type, sub-channel, channels to follow, reserved, packet length
_SEARCH_BYTES: Final = 1 << 16  # read at a time to find the next packet after damage; bounds memory


class XtfPacket(msgspec.Struct, frozen=True, gc=False):
    """Hold a whole packet of a wanted type, or the mere place of another (`data` is empty then)."""

    offset: int
    kind: int
    data: bytes


class FileHeader(NamedTuple):
    """Mark another file header in the middle of the file: two logs were joined."""

    offset: int
    data: bytes


class DamagedBytes(NamedTuple):
    """Mark `n_bytes` from `offset` on that no packet could be made of. `at_end`: nothing readable follows."""

    offset: int
    n_bytes: int
    what: str
    at_end: bool


Item: TypeAlias = XtfPacket | FileHeader | DamagedBytes


def read_packets(file: BinaryIO, first_packet: int, size: int, wanted: Container[int]) -> Iterator[Item]:
    """Yield packets of `file` (seekable, `size` bytes) from offset `first_packet` on, in file order, one at a time."""
    position = first_packet
    search_from = first_packet  # no packet that was already delivered starts at or after this
    newest_wanted: int | None = None  # where it starts
    file.seek(position)
    while position < size:
        start = file.read(_START.size)
        fault, n_bytes, kind = _fault(start, position, size)
        if fault is None:
            if kind in wanted:
                newest_wanted = position
                yield XtfPacket(position, kind, start + file.read(n_bytes - _START.size))
                position += n_bytes
            else:
                newest_wanted, search_from = None, position + _START.size
                yield XtfPacket(position, kind, b"")
                position += n_bytes
                file.seek(position)
            continue
        if newest_wanted is not None:
            search_from, newest_wanted = newest_wanted + len(MAGIC), None  # it may have lost bytes of its samples
        header = _file_header(file, position, size)
        if header is not None:
            yield header
            position += len(header.data)
            search_from = position
            file.seek(position)
            continue
        if start[:2] == MAGIC:
            search_from = position + len(MAGIC)
        found = _next_packet(file, search_from, size)
        # The packet before may have claimed more bytes than it holds: then the next one starts before `position`.
        damaged_from = min(position, found)
        yield DamagedBytes(damaged_from, found - damaged_from, fault, at_end=found >= size)
        position = found
        file.seek(position)


def _fault(start: bytes, position: int, size: int) -> tuple[str | None, int, int]:
    """Return the error of the packet that starts with these bytes (None: none), its length and its type."""
    if len(start) < _START.size:
        return "the file ends inside a packet's header", 0, -1
    magic, kind, _, _, n_bytes = _START.unpack(start)
    if magic != MAGIC:
        return "no packet starts where the one before ended", 0, -1
    if n_bytes < _START.size or n_bytes > MAX_PACKET_BYTES:
        return f"a packet claims an impossible length of {n_bytes} bytes", 0, -1
    if position + n_bytes > size:
        return f"a packet of {n_bytes} bytes is cut off by the end of the file", 0, -1
    return None, n_bytes, kind


def _file_header(file: BinaryIO, position: int, size: int) -> FileHeader | None:
    file.seek(position)
    block = file.read(HEADER_BLOCK)
    if len(block) < HEADER_BLOCK or block[0] != FILE_FORMAT:
        return None
    length = header_bytes(file, position, size)
    file.seek(position)
    return FileHeader(position, file.read(length)) if length is not None else None


def header_bytes(file: BinaryIO, position: int, size: int) -> int | None:
    """Return the length of the file header at `position`: the first multiple of 1024 before a packet; None if none.

    Six channels fit into one block. Writers disagree on how many more fit into each further one, so the packets decide.
    """
    for length in range(HEADER_BLOCK, 9 * HEADER_BLOCK, HEADER_BLOCK):
        if position + length > size:
            return None
        file.seek(position + length)
        if file.read(len(MAGIC)) == MAGIC:
            return length
    return None


def _next_packet(file: BinaryIO, position: int, size: int) -> int:
    """Return the offset of the first trustworthy packet at or after `position`, `size` if there is none.

    Two bytes are easily met by chance among samples: a packet is trusted only if another one, or the end of the file,
    follows it.
    """
    while position < size:
        file.seek(position)
        block = file.read(_SEARCH_BYTES)
        at = block.find(MAGIC)
        while at >= 0:
            file.seek(position + at)
            fault, n_bytes, _ = _fault(file.read(_START.size), position + at, size)
            if fault is None:
                end = position + at + n_bytes
                file.seek(end)
                if end == size or file.read(len(MAGIC)) == MAGIC:
                    return position + at
            at = block.find(MAGIC, at + 1)
        position += max(len(block) - 1, 1)  # the magic may straddle two blocks
    return size
