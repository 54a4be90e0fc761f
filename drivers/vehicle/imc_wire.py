"""Frame IMC packets: header, payload and checksum, in either byte order.

The checksum is CRC-16/ARC over header and payload, see `imc_crc`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from struct import Struct
from typing import Final, NamedTuple

from drivers.framing import Grammar, Refused
from drivers.vehicle.imc_crc import RunningRemainder, crc16_arc
from drivers.vehicle.imc_messages import LAYOUTS, MAX_PAYLOAD_BYTES, ImcMessage, Order, encode, in_limits, number_of

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
            for at in map(_START_OF, _PLAUSIBLE.finditer(buffer, first.start())):
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
        elif first is not None:
            return first.start(), 0
        begun = _BEGUN.search(buffer, max(start, n_there - _BEGINNING_BYTES + 1))
        return -1 if begun is None else begun.start(), n_checksum

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
