"""IMC packets: header, payload and checksum, in either byte order.

The checksum is CRC-16/ARC over header and payload: polynomial 0x8005, reflected, from 0.
"""

from __future__ import annotations

from collections.abc import Iterable
from struct import Struct
from typing import Final, NamedTuple

from drivers.vehicle.imc_messages import LAYOUTS, MAX_PAYLOAD_BYTES, ImcMessage, Order, encode, in_limits, number_of

SYNC: Final = 0xFE54
ANYONE: Final = 0xFFFF
ANY_ENTITY: Final = 0xFF

_HEADERS: Final[dict[Order, Struct]] = {"<": Struct("<HHHdHBHB"), ">": Struct(">HHHdHBHB")}
_BEGINNINGS: Final[dict[Order, Struct]] = {"<": Struct("<HHH"), ">": Struct(">HHH")}  # of a header, up to the size
_CHECKSUMS: Final[dict[Order, Struct]] = {"<": Struct("<H"), ">": Struct(">H")}
_LITTLE, _BIG = SYNC.to_bytes(2, "little"), SYNC.to_bytes(2, "big")
HEADER_BYTES: Final = _HEADERS["<"].size
CHECKSUM_BYTES: Final = 2
_BEGINNING_BYTES: Final = _BEGINNINGS["<"].size
_MAX_PAYLOAD: Final = max(MAX_PAYLOAD_BYTES, *(layout.most for layout in LAYOUTS.values()))


def _crc_table() -> tuple[int, ...]:
    table = []
    for remainder in range(256):
        for _ in range(8):
            remainder = (remainder >> 1) ^ (0xA001 if remainder & 1 else 0)
        table.append(remainder)
    return tuple(table)


_CRC: Final = _crc_table()


def crc16_arc(data: Iterable[int]) -> int:
    """CRC-16/ARC of bytes."""
    crc, table = 0, _CRC
    for byte in data:
        crc = (crc >> 8) ^ table[(crc ^ byte) & 0xFF]
    return crc


class Packet(NamedTuple):
    """A message as it travels. time_s: UTC seconds since 1970."""

    number: int
    payload: bytes
    source: int
    source_entity: int = ANY_ENTITY
    destination: int = ANYONE
    destination_entity: int = ANY_ENTITY
    time_s: float = 0.0
    order: Order = "<"


def packed(message: ImcMessage, source: int, *, entity: int = ANY_ENTITY, to: int = ANYONE, time_s: float = 0.0) -> bytes:
    """A message as the bytes of a packet. Raises as `encode` does."""
    return to_wire(Packet(number_of(type(message)), encode(message), source, entity, to, ANY_ENTITY, time_s))


def to_wire(packet: Packet) -> bytes:
    """The packet as bytes, checksum included."""
    number, payload, source, source_entity, destination, destination_entity, time_s, order = packet
    head = _HEADERS[order].pack(SYNC, number, len(payload), time_s, source, source_entity, destination, destination_entity)
    body = head + payload
    return body + _CHECKSUMS[order].pack(crc16_arc(body))


class ImcGrammar:
    """Length believed only if it is plausible for its message id."""

    name = "imc"
    head_bytes = 2
    max_message_bytes = HEADER_BYTES + _MAX_PAYLOAD + CHECKSUM_BYTES
    proven = True

    def find(self, buffer: bytearray, start: int) -> int:
        little = buffer.find(_LITTLE, start)
        big = buffer.find(_BIG, start) if little < 0 else buffer.find(_BIG, start, little + 1)
        return little if big < 0 else big

    def read(self, buffer: bytearray, at: int) -> tuple[Packet, int] | int | str:
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
        if _CHECKSUMS[order].unpack_from(buffer, stop)[0] != crc16_arc(buffer[at:stop]):
            return "checksum"
        _, _, _, time_s, source, source_entity, destination, destination_entity = _HEADERS[order].unpack_from(buffer, at)
        payload = bytes(buffer[at + HEADER_BYTES : stop])
        return Packet(number, payload, source, source_entity, destination, destination_entity, time_s, order), n_bytes
