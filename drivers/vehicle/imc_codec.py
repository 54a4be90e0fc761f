"""Decode and encode LSTS's Inter-Module Communication protocol (IMC 5.4) as typed records, from one table.

A packet is a header (u16 sync 0xFE54, u16 message id, u16 bytes of payload, f64 UTC seconds since 1970, u16 source and
u8 entity of it, u16 destination and u8 entity), the payload, and CRC-16/ARC of both; the sync number gives the byte
order. Text is a u16 length and UTF-8. A message inside another is its u16 id, 65535 for none, and its payload; a list
of them has a u16 count before.

The codec is our own. imcpy, the public one, decodes a sound packet just as well and serves the tests as oracle, but its
stream parser (1.1.2) believes lengths before checksums: in a campaign of faults it lost 4135 of 6828 intact packets,
this one none. And it neither reads nor writes messages that its table does not have, such as the two of our own.
"""

from __future__ import annotations

from struct import Struct
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import msgspec

from drivers.vehicle.imc_messages import (
    Abort,
    Announce,
    DesiredSpeed,
    DesiredZ,
    EntityState,
    EstimatedState,
    FollowReference,
    FollowRefState,
    Heartbeat,
    ImcMessage,
    Message,
    MineContact,
    MineContactTaken,
    PlanControl,
    PlanControlState,
    PlanManeuver,
    PlanSpecification,
    PlanStatistics,
    PlanTransition,
    Reference,
    Target,
    VehicleState,
)

Order: TypeAlias = Literal["<", ">"]
"""Byte order in the notation of `struct`."""

MAX_TEXT_BYTES: Final = 1024  # of a text, longer ones are cut; bounds a packet
MAX_PAYLOAD_BYTES: Final = 4096  # of kinds whose length varies, and of those that are not known here
MAX_DEPTH: Final = 6  # of messages inside messages; to start a plan of one manoeuvre takes three
_NO_MESSAGE: Final = 0xFFFF  # id that stands for none (IMC.xml)


class One(NamedTuple):
    """Describe a message without header, or none. kind: which it must be, None for any."""

    kind: type[Message] | None = None


class Many(NamedTuple):
    """Describe a counted list of messages without headers."""

    kind: type[Message] | None = None


class Numbers(NamedTuple):
    """Describe neighbouring numbers, read and written at once."""

    n: int
    layouts: dict[Order, Struct]


Field: TypeAlias = Literal["u8", "u16", "u32", "i32", "f32", "f64", "text"] | One | Many
_Part: TypeAlias = Numbers | Literal["text"] | One | Many
_CODES: Final = {"u8": "B", "u16": "H", "u32": "I", "i32": "i", "f32": "f", "f64": "d"}
_FEWEST_BYTES: Final = 2  # of a text, a message or a list


class ImcLayout(NamedTuple):
    """Hold one row of the table. min_bytes, max_bytes: plausible payload of this message."""

    number: int
    kind: Any
    parts: tuple[_Part, ...]
    min_bytes: int
    max_bytes: int


def _layout(number: int, kind: type[Message], *fields: Field) -> ImcLayout:
    assert len(fields) == len(kind.__struct_fields__), f"{kind.__name__}: one field of the wire for one of the record"
    parts: list[_Part] = []
    run = ""
    for field in (*fields, None):
        if isinstance(field, str) and field != "text":
            run += _CODES[field]
            continue
        if run:
            parts.append(Numbers(len(run), {"<": Struct("<" + run), ">": Struct(">" + run)}))
            run = ""
        if field is not None:
            parts.append("text" if isinstance(field, str) else field)
    min_bytes = sum(part.layouts["<"].size if isinstance(part, Numbers) else _FEWEST_BYTES for part in parts)
    fixed = all(isinstance(part, Numbers) for part in parts)
    return ImcLayout(number, kind, tuple(parts), min_bytes, min_bytes if fixed else MAX_PAYLOAD_BYTES)


def _times(n: int, field: Field) -> tuple[Field, ...]:
    return (field,) * n


_ROWS: Final = (
    _layout(1, EntityState, "u8", "u8", "text"),
    _layout(150, Heartbeat),
    _layout(151, Announce, "text", "u8", "u16", "f64", "f64", "f32", "text"),
    _layout(350, EstimatedState, "f64", "f64", *_times(18, "f32")),
    _layout(401, DesiredZ, "f32", "u8"),
    _layout(402, DesiredSpeed, "f64", "u8"),
    _layout(478, FollowReference, "u16", "u8", "f32", "f32", "f32"),
    _layout(479, Reference, "u8", One(DesiredSpeed), One(DesiredZ), "f64", "f64", "f32"),
    _layout(480, FollowRefState, "u16", "u8", One(Reference), "u8", "u8"),
    _layout(500, VehicleState, "u8", "u8", "text", "u16", "f64", "u16", "u32", "u8", "text", "f64"),
    _layout(550, Abort),
    _layout(
        551,
        PlanSpecification,
        *_times(3, "text"),
        Many(),
        "text",
        Many(PlanManeuver),
        Many(PlanTransition),
        Many(),
        Many(),
    ),
    _layout(552, PlanManeuver, "text", One(FollowReference), Many(), Many()),
    _layout(553, PlanTransition, *_times(3, "text"), Many()),
    _layout(559, PlanControl, "u8", "u8", "u16", "text", "u16", One(), "text"),
    _layout(560, PlanControlState, "u8", "text", "i32", "f32", "text", "u16", "i32", "u8"),
    _layout(564, PlanStatistics, "text", "u8", "u8", *_times(4, "text")),
    _layout(800, Target, "text", "f64", "f64", "f32", "u8", "f32", "f32"),
    _layout(
        1700, MineContact, "u32", "u32", "u16", *_times(3, "f64"), *_times(3, "f32"), "u8", "u16", *_times(12, "f32")
    ),
    _layout(1701, MineContactTaken, "u32", "u32", "u16", "u8", "text"),
)
LAYOUTS: Final = {row.number: row for row in _ROWS}
_BY_KIND: Final[dict[type, ImcLayout]] = {row.kind: row for row in _ROWS}


def number_of(kind: type[Message]) -> int:
    """Return the message id of a kind of record."""
    return _BY_KIND[kind].number


def in_limits(number: int, n_bytes: int) -> bool:
    """Return whether a payload of this length is plausible for this message."""
    layout = LAYOUTS.get(number)
    return n_bytes <= MAX_PAYLOAD_BYTES if layout is None else layout.min_bytes <= n_bytes <= layout.max_bytes


def encode(message: ImcMessage, order: Order = "<") -> bytes:
    """Encode a record as a payload.

    Longer texts than MAX_TEXT_BYTES are cut. Raises struct.error or OverflowError for numbers that do not fit.
    """
    pieces: list[bytes] = []
    _write(message, order, pieces)
    return b"".join(pieces)


def decode(number: int, payload: bytes, order: Order = "<") -> ImcMessage:
    """Decode a payload of a message in LAYOUTS. Raises ValueError for one that does not fit its kind."""
    reader = _Reader(payload, order)
    message = reader.message(LAYOUTS[number], 0)
    if reader.at != len(payload):
        raise ValueError(f"{len(payload) - reader.at} bytes behind the end of message {number}")
    return message


def _write(message: ImcMessage, order: Order, pieces: list[bytes]) -> None:
    u16 = Struct(order + "H")
    values = iter(msgspec.structs.astuple(message))
    for part in _BY_KIND[type(message)].parts:
        if isinstance(part, Numbers):
            pieces.append(part.layouts[order].pack(*(next(values) for _ in range(part.n))))
            continue
        value = next(values)
        if part == "text":
            text = value.encode("utf-8", "replace")
            if len(text) > MAX_TEXT_BYTES:
                text = text[:MAX_TEXT_BYTES].decode("utf-8", "ignore").encode("utf-8")  # no part of a character
            pieces += (u16.pack(len(text)), text)
            continue
        if isinstance(part, Many):
            pieces.append(u16.pack(len(value)))
        for inner in value if isinstance(part, Many) else (value,):
            pieces.append(u16.pack(_NO_MESSAGE if inner is None else number_of(type(inner))))
            if inner is not None:
                _write(inner, order, pieces)


class _Reader:
    """Read on from `at`; raise ValueError for an impossible payload."""

    def __init__(self, payload: bytes, order: Order) -> None:
        self.at = 0
        self._payload = payload
        self._order = order
        self._u16 = Struct(order + "H")

    def message(self, layout: ImcLayout, depth: int) -> ImcMessage:
        if depth > MAX_DEPTH:
            raise ValueError(f"messages inside messages deeper than {MAX_DEPTH}")
        values: list[Any] = []
        for part in layout.parts:
            if isinstance(part, Numbers):
                values += self._numbers(part.layouts[self._order])
            elif part == "text":
                values.append(self._take(self._count()).decode("utf-8", "replace"))
            elif isinstance(part, One):
                values.append(self._inner(part.kind, depth))
            else:
                values.append(tuple(self._listed(part.kind, depth) for _ in range(self._count())))
        message: ImcMessage = layout.kind(*values)
        return message

    def _inner(self, kind: type[Message] | None, depth: int) -> ImcMessage | None:
        number = self._count()
        if number == _NO_MESSAGE:
            return None
        layout = LAYOUTS.get(number)
        if layout is None or kind not in (None, layout.kind):
            raise ValueError(f"message {number} inside another, whose length is not known here")
        return self.message(layout, depth + 1)

    def _listed(self, kind: type[Message] | None, depth: int) -> ImcMessage:
        inner = self._inner(kind, depth)
        if inner is None:
            raise ValueError("a list with an empty message")
        return inner

    def _count(self) -> int:
        (count,) = self._numbers(self._u16)
        return int(count)

    def _numbers(self, layout: Struct) -> tuple[Any, ...]:
        return layout.unpack(self._take(layout.size))

    def _take(self, n_bytes: int) -> bytes:
        piece = self._payload[self.at : self.at + n_bytes]
        if len(piece) < n_bytes:
            raise ValueError(f"the payload ends {n_bytes - len(piece)} bytes early")
        self.at += n_bytes
        return piece
