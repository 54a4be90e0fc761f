"""Frame IMC packets: header, payload and checksum, in either byte order.

The checksum is CRC-16/ARC over header and payload, see `imc_crc`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from itertools import islice
from struct import Struct
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.framing import Grammar, Refused
from drivers.vehicle.imc_codec import LAYOUTS, MAX_PAYLOAD_BYTES, Order, encode, in_limits, number_of
from drivers.vehicle.imc_crc import RunningRemainder, crc16_arc
from drivers.vehicle.imc_messages import ImcMessage

SYNC: Final = 0xFE54  # first two bytes of a packet; their order gives the byte order (IMC 5.4)
ANYONE: Final = 0xFFFF  # destination: all
ANY_ENTITY: Final = 0xFF  # entity: all

_HEADERS: Final[dict[Order, Struct]] = {"<": Struct("<HHHdHBHB"), ">": Struct(">HHHdHBHB")}
_BEGINNINGS: Final[dict[Order, Struct]] = {"<": Struct("<HHH"), ">": Struct(">HHH")}  # of a header, up to the size
_CHECKSUMS: Final[dict[Order, Struct]] = {"<": Struct("<H"), ">": Struct(">H")}
_LITTLE, _BIG = SYNC.to_bytes(2, "little"), SYNC.to_bytes(2, "big")
HEADER_BYTES: Final = _HEADERS["<"].size
CHECKSUM_BYTES: Final = 2  # CRC-16/ARC after the payload
_BEGINNING_BYTES: Final = _BEGINNINGS["<"].size
_MAX_PAYLOAD: Final = max(MAX_PAYLOAD_BYTES, *(layout.max_bytes for layout in LAYOUTS.values()))
_FRAME_BYTES: Final = HEADER_BYTES + CHECKSUM_BYTES
_LITTLE_LENGTH, _BIG_LENGTH = Struct("<HH").unpack_from, Struct(">HH").unpack_from  # message id and size of payload
_HIGHEST_SIZE: Final = re.escape(bytes((_MAX_PAYLOAD >> 8,)))  # its high byte
_OTHER_LIMITS: Final = (0, MAX_PAYLOAD_BYTES)
_LIMITS: Final = {number: (layout.min_bytes, layout.max_bytes) for number, layout in LAYOUTS.items()}

# Sync and a size that is plausible for some message; one byte wide, as two may overlap.
_PLAUSIBLE: Final = re.compile(
    rb"\x54(?=\xfe...[\x00-%b])|\xfe(?=\x54..[\x00-%b].)" % (2 * (_HIGHEST_SIZE,)), re.DOTALL
)
_BEGUN: Final = re.compile(rb"(?:\x54\xfe|\xfe\x54).{0,3}\Z", re.DOTALL)
_START_OF: Final = re.Match.start
_FIRST_STRETCH_BYTES: Final = 512  # chosen: what follows costs no more than the calls themselves, 40 us
_FEW: Final = 48  # candidates looked at one by one, 0.7 us each: those of 100 bytes; the others many at once


class ImcPacket(NamedTuple):
    """Hold a message as sent. time_s: UTC seconds since 1970."""

    number: int
    payload: bytes
    source: int
    source_entity: int = ANY_ENTITY
    destination: int = ANYONE
    destination_entity: int = ANY_ENTITY
    time_s: float = 0.0
    order: Order = "<"


def packed(
    message: ImcMessage, source: int, *, entity: int = ANY_ENTITY, to: int = ANYONE, time_s: float = 0.0
) -> bytes:
    """Encode a message as the bytes of a packet. Raises as `encode` does."""
    return to_wire(ImcPacket(number_of(type(message)), encode(message), source, entity, to, ANY_ENTITY, time_s))


def to_wire(packet: ImcPacket) -> bytes:
    """Encode the packet, checksum included."""
    number, payload, source, source_entity, destination, destination_entity, time_s, order = packet
    head = _HEADERS[order].pack(
        SYNC, number, len(payload), time_s, source, source_entity, destination, destination_entity
    )
    body = head + payload
    return body + _CHECKSUMS[order].pack(crc16_arc(body))


class ImcGrammar(Grammar[ImcPacket]):
    """Frame packets; a length must be plausible for its message id."""

    name = "imc"
    head_bytes = 2
    max_message_bytes = HEADER_BYTES + _MAX_PAYLOAD + CHECKSUM_BYTES
    proven = True

    def __init__(self) -> None:
        self._remainder = RunningRemainder()

    def find(self, buffer: bytearray, start: int, refused: Refused) -> int:
        found, n_checksum = self._first_alive(buffer, start)
        end = len(buffer) if found < 0 else found + 1  # a sync takes two bytes
        n_length = buffer.count(_LITTLE, start, end) + buffer.count(_BIG, start, end) - n_checksum
        if n_length:
            refused["length"] = refused.get("length", 0) + n_length
        if n_checksum:
            refused["checksum"] = refused.get("checksum", 0) + n_checksum
        return found

    def _first_alive(self, buffer: bytearray, start: int) -> tuple[int, int]:
        """Find the first candidate of plausible size that is incomplete or has the right checksum, -1 if none.

        Return also how many before it are refused for their checksum; all others are refused for their length.
        """
        n_there, n_checksum = len(buffer), 0
        first = _PLAUSIBLE.search(buffer, start)
        if first is not None and n_there - first.start() >= _FRAME_BYTES:
            plain = self._remainder.plain(buffer)
            swapped: Sequence[int] = ()
            last = first.start()
            for at in map(_START_OF, islice(_PLAUSIBLE.finditer(buffer, last), _FEW)):
                last = at
                if buffer[at] == _LITTLE[0]:
                    number, n_payload = _LITTLE_LENGTH(buffer, at + 2)
                    end = at + _FRAME_BYTES + n_payload
                    if end > n_there or plain[at] == plain[end]:
                        return at, n_checksum
                else:
                    number, n_payload = _BIG_LENGTH(buffer, at + 2)
                    end = at + _FRAME_BYTES + n_payload
                    if end > n_there:
                        return at, n_checksum
                    swapped = swapped or self._remainder.swapped(buffer)
                    if plain[at] == swapped[end - CHECKSUM_BYTES]:
                        return at, n_checksum
                low, high = _LIMITS.get(number, _OTHER_LIMITS)
                if low <= n_payload <= high:
                    n_checksum += 1
            found, n_more = self._first_of_many(buffer, last + 1)
            n_checksum += n_more
            if found >= 0:
                return found, n_checksum
        elif first is not None:
            return first.start(), 0
        begun = _BEGUN.search(buffer, max(start, n_there - _BEGINNING_BYTES + 1))
        return -1 if begun is None else begun.start(), n_checksum

    def _first_of_many(self, buffer: bytearray, start: int) -> tuple[int, int]:
        """Do as `_first_alive` for candidates with a whole beginning, many at once.

        Each stretch is four times as long as the one before: where a few bytes came, a few candidates are decided, and
        the others that the buffer holds are not looked at again and again.
        """
        end, width, n_refused = len(buffer) - _BEGINNING_BYTES + 1, _FIRST_STRETCH_BYTES, 0
        while start < end:
            stop = min(start + width, end)
            found, n_more = self._first_in(buffer, start, stop)
            n_refused += n_more
            if found >= 0:
                return found, n_refused
            start, width = stop, 4 * width
        return -1, n_refused

    def _first_in(self, buffer: bytearray, start: int, stop: int) -> tuple[int, int]:
        """Do as `_first_of_many` for candidates that begin in buffer[start:stop]."""
        n_there = len(buffer)
        data = np.frombuffer(buffer, np.uint8, stop - start + _BEGINNING_BYTES - 1, start)
        first, second, fifth, sixth = data[:-5], data[1:-4], data[4:-1], data[5:]
        highest = _MAX_PAYLOAD >> 8
        is_little = (first == _LITTLE[0]) & (second == _LITTLE[1]) & (sixth <= highest)
        at = np.flatnonzero(is_little | ((first == _BIG[0]) & (second == _BIG[1]) & (fifth <= highest)))
        if not len(at):
            return -1, 0
        is_little = is_little[at]
        words = data[at[:, np.newaxis] + np.where(is_little[:, np.newaxis], [3, 2, 5, 4], [2, 3, 4, 5])].astype(np.intp)
        number, n_payload = 256 * words[:, 0] + words[:, 1], 256 * words[:, 2] + words[:, 3]
        at += start
        end = at + _FRAME_BYTES + n_payload
        is_alive = end > n_there
        whole = np.flatnonzero(~is_alive)
        is_whole_little, to = is_little[whole], end[whole]
        plain = np.frombuffer(self._remainder.plain(buffer), np.uint16)
        expected = plain[to]
        if not is_whole_little.all():
            swapped = np.frombuffer(self._remainder.swapped(buffer), np.uint16)
            expected = np.where(is_whole_little, expected, swapped[to - CHECKSUM_BYTES])
        is_alive[whole] = plain[at[whole]] == expected
        n_dead = int(is_alive.argmax()) if is_alive.any() else len(at)
        low, high = _limits_of_all()
        is_long_enough = (low[number] <= n_payload) & (n_payload <= high[number])
        return int(at[n_dead]) if n_dead < len(at) else -1, int(np.count_nonzero(is_long_enough[:n_dead]))

    def read(self, buffer: bytearray, at: int) -> tuple[ImcPacket, int] | int | str:
        n_there = len(buffer) - at
        if n_there < _BEGINNING_BYTES:
            return _BEGINNING_BYTES
        order: Order = "<" if buffer[at] == _LITTLE[0] else ">"
        _, number, n_payload = _BEGINNINGS[order].unpack_from(buffer, at)
        if not in_limits(number, n_payload):
            return "length"
        stop = at + HEADER_BYTES + n_payload
        n_bytes: int = HEADER_BYTES + n_payload + CHECKSUM_BYTES
        if n_there < n_bytes:
            return n_bytes
        plain = self._remainder.plain(buffer)
        if plain[at] != (plain[stop + CHECKSUM_BYTES] if order == "<" else self._remainder.swapped(buffer)[stop]):
            return "checksum"
        _, _, _, time_s, source, source_entity, destination, destination_entity = _HEADERS[order].unpack_from(
            buffer, at
        )
        payload = bytes(buffer[at + HEADER_BYTES : stop])
        return ImcPacket(
            number, payload, source, source_entity, destination, destination_entity, time_s, order
        ), n_bytes

    def forget(self, n_bytes: int) -> None:
        self._remainder.forget(n_bytes)


@cache
def _limits_of_all() -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the lowest and highest plausible size by message id, each (65536,) int32."""
    low, high = np.full(0x10000, _OTHER_LIMITS[0], np.int32), np.full(0x10000, _OTHER_LIMITS[1], np.int32)
    for number, limits in _LIMITS.items():
        low[number], high[number] = limits
    return low, high
