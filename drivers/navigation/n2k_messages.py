"""Decode and encode NMEA 2000 messages as typed records, from one table of bit fields.

The layouts are those that canboat's analyser and other open decoders agree on. Bits count from the least significant
one of byte 0, which makes a message one little-endian number. A field whose bits are all ones (signed: the largest
number) is not available, one less is an error of the sender; both are NaN here. Angles are radians, speeds m/s,
temperatures K, pressures Pa; sid is a number, NaN if absent.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, Generic, NamedTuple, TypeAlias, TypeVar

from auv_mcm.records import NAN

ADDRESS_CLAIM: Final = 60928  # PGN (ISO 11783-5)
GLOBAL: Final = 255  # destination: all devices


class N2kField(NamedTuple):
    """Describe one number: n_bits from start_bit on, times resolution."""

    start_bit: int
    n_bits: int
    signed: bool = False
    resolution: float = 1.0


class SystemTime(NamedTuple):
    """Hold UTC of a source.

    source: 0 GPS, 1 GLONASS, 2 radio station, 3 caesium clock, 4 rubidium clock, 5 crystal clock.
    """

    sid: float
    source: float
    date_days: float
    time_of_day_s: float


class Heading(NamedTuple):
    """Hold a heading. reference: 0 true north, 1 magnetic north."""

    sid: float
    heading_rad: float
    deviation_rad: float
    variation_rad: float
    reference: float


class RateOfTurn(NamedTuple):
    """Hold the rate of turn (PGN 127251)."""

    sid: float
    rate_rad_s: float


class Heave(NamedTuple):
    """Hold heave (PGN 127252)."""

    sid: float
    heave_m: float


class Attitude(NamedTuple):
    """Hold yaw, pitch and roll (PGN 127257)."""

    sid: float
    yaw_rad: float
    pitch_rad: float
    roll_rad: float


class MagneticVariation(NamedTuple):
    """Hold magnetic variation (PGN 127258)."""

    sid: float
    source: float
    date_days: float
    variation_rad: float


class Speed(NamedTuple):
    """Hold speed through the water and over ground (PGN 128259)."""

    sid: float
    water_mps: float
    ground_mps: float
    water_type: float


class WaterDepth(NamedTuple):
    """Hold depth below the transducer. offset_m: to the waterline if positive, to the keel if negative."""

    sid: float
    depth_m: float
    offset_m: float
    max_range_m: float


class RapidPosition(NamedTuple):
    """Hold a position (PGN 129025)."""

    latitude_deg: float
    longitude_deg: float


class RapidCourse(NamedTuple):
    """Hold course and speed over ground. reference: 0 true north, 1 magnetic north."""

    sid: float
    reference: float
    course_rad: float
    speed_mps: float


class GnssPosition(NamedTuple):
    """Hold a GNSS fix.

    method: 0 no fix, 1 GNSS, 2 differential, 3 precise, 4 and 5 RTK, 6 dead reckoning, 7 by hand, 8 simulated.
    """

    sid: float
    date_days: float
    time_of_day_s: float
    latitude_deg: float
    longitude_deg: float
    height_m: float
    system: float
    method: float
    integrity: float
    n_satellites: float
    hdop: float
    pdop: float
    geoid_m: float
    n_stations: float


class Temperature(NamedTuple):
    """Hold a temperature (PGN 130312)."""

    sid: float
    instance: float
    source: float
    temperature_k: float


class Pressure(NamedTuple):
    """Hold a pressure (PGN 130314)."""

    sid: float
    instance: float
    source: float
    pressure_pa: float


Record: TypeAlias = (
    SystemTime
    | Heading
    | RateOfTurn
    | Heave
    | Attitude
    | MagneticVariation
    | Speed
    | WaterDepth
    | RapidPosition
    | RapidCourse
    | GnssPosition
    | Temperature
    | Pressure
)
R = TypeVar("R", bound=tuple[Any, ...])


class N2kMessage(NamedTuple, Generic[R]):
    """Describe a message. n_bytes: minimum of a whole one; a longer one goes on with repeated groups."""

    pgn: int
    priority: int
    n_bytes: int
    make: Callable[..., R]
    fields: tuple[N2kField, ...]


class Identifier(NamedTuple):
    """Hold the parts of a 29-bit CAN identifier. destination: GLOBAL unless the message is addressed."""

    priority: int
    pgn: int
    destination: int
    source: int


def identifier_of(can_id: int) -> Identifier:
    """Split a 29-bit identifier. SAE J1939-21: below 240 the middle byte of the group number is a destination."""
    pgn = can_id >> 8 & 0x3FFFF
    if pgn >> 8 & 0xFF < 240:
        return Identifier(can_id >> 26 & 7, pgn & 0x3FF00, pgn & 0xFF, can_id & 0xFF)
    return Identifier(can_id >> 26 & 7, pgn, GLOBAL, can_id & 0xFF)


def can_id_of(identifier: Identifier) -> int:
    """Compute the 29-bit CAN identifier of its parts."""
    priority, pgn, destination, source = identifier
    middle = destination if pgn >> 8 & 0xFF < 240 else 0
    return priority << 26 | (pgn | middle) << 8 | source


def decode(pgn: int, data: bytes) -> Record | None:
    """Decode a message's bytes to its record; None for an unknown group.

    Raises ValueError for one that is too short.
    """
    message = MESSAGES.get(pgn)
    if message is None:
        return None
    if len(data) < message.n_bytes:
        raise ValueError(f"{len(data)} bytes where PGN {pgn} has {message.n_bytes}")
    bits = int.from_bytes(data, "little")
    values = []
    for start_bit, n_bits, signed, resolution in message.fields:
        raw = bits >> start_bit & (1 << n_bits) - 1
        unavailable = (1 << n_bits - signed) - 1
        if raw < unavailable - (n_bits > 2):
            values.append(raw * resolution)
        elif raw > unavailable:
            values.append((raw - (1 << n_bits)) * resolution)
        else:
            values.append(NAN)
    record: Record = message.make(*values)
    return record


def encode(record: Record) -> tuple[int, bytes]:
    """Encode a record to PGN and bytes; unknown values, and every reserved bit, are all ones.

    Raises ValueError for one without room.
    """
    message = _BY_RECORD[type(record)]
    bits = (1 << 8 * message.n_bytes) - 1
    for (start_bit, n_bits, signed, resolution), value in zip(message.fields, record, strict=True):
        if math.isnan(value):
            raw = (1 << n_bits - signed) - 1
        else:
            raw = round(value / resolution)
            if not -(1 << n_bits - 1) * signed <= raw < (1 << n_bits - signed) - (2 if n_bits > 2 else 1):
                raise ValueError(f"PGN {message.pgn}: {value} does not fit its field")
        mask = (1 << n_bits) - 1
        bits = bits & ~(mask << start_bit) | (raw & mask) << start_bit
    return message.pgn, bits.to_bytes(message.n_bytes, "little")


_SID: Final = N2kField(0, 8)
_DATE: Final = N2kField(16, 16)
_ANGLE: Final = 1e-4  # rad per count, of headings and attitude

MESSAGES: Final[dict[int, N2kMessage[Any]]] = {
    message.pgn: message
    for message in (
        N2kMessage(126992, 3, 8, SystemTime, (_SID, N2kField(8, 4), _DATE, N2kField(32, 32, False, 1e-4))),
        N2kMessage(
            127250,
            2,
            8,
            Heading,
            (
                _SID,
                N2kField(8, 16, False, _ANGLE),
                N2kField(24, 16, True, _ANGLE),
                N2kField(40, 16, True, _ANGLE),
                N2kField(56, 2),
            ),
        ),
        N2kMessage(127251, 2, 8, RateOfTurn, (_SID, N2kField(8, 32, True, 3.125e-8))),
        N2kMessage(127252, 3, 8, Heave, (_SID, N2kField(8, 16, True, 0.01))),
        N2kMessage(127257, 3, 8, Attitude, (_SID, *(N2kField(start, 16, True, _ANGLE) for start in (8, 24, 40)))),
        N2kMessage(127258, 7, 6, MagneticVariation, (_SID, N2kField(8, 4), _DATE, N2kField(32, 16, True, _ANGLE))),
        N2kMessage(
            128259, 2, 8, Speed, (_SID, N2kField(8, 16, False, 0.01), N2kField(24, 16, False, 0.01), N2kField(40, 8))
        ),
        N2kMessage(
            128267,
            3,
            8,
            WaterDepth,
            (_SID, N2kField(8, 32, False, 0.01), N2kField(40, 16, True, 1e-3), N2kField(56, 8, False, 10.0)),
        ),
        N2kMessage(129025, 2, 8, RapidPosition, (N2kField(0, 32, True, 1e-7), N2kField(32, 32, True, 1e-7))),
        N2kMessage(
            129026,
            2,
            8,
            RapidCourse,
            (_SID, N2kField(8, 2), N2kField(16, 16, False, _ANGLE), N2kField(32, 16, False, 0.01)),
        ),
        N2kMessage(
            129029,
            3,
            43,
            GnssPosition,
            (
                _SID,
                N2kField(8, 16),
                N2kField(24, 32, False, 1e-4),
                N2kField(56, 64, True, 1e-16),
                N2kField(120, 64, True, 1e-16),
                N2kField(184, 64, True, 1e-6),
                N2kField(248, 4),
                N2kField(252, 4),
                N2kField(256, 2),
                N2kField(264, 8),
                N2kField(272, 16, True, 0.01),
                N2kField(288, 16, True, 0.01),
                N2kField(304, 32, True, 0.01),
                N2kField(336, 8),
            ),
        ),
        N2kMessage(130312, 5, 8, Temperature, (_SID, N2kField(8, 8), N2kField(16, 8), N2kField(24, 16, False, 0.01))),
        N2kMessage(130314, 5, 8, Pressure, (_SID, N2kField(8, 8), N2kField(16, 8), N2kField(24, 32, True, 0.1))),
    )
}
FAST_PACKET_GROUPS: Final = frozenset(pgn for pgn, message in MESSAGES.items() if message.n_bytes > 8)
_BY_RECORD: Final[dict[Any, N2kMessage[Any]]] = {message.make: message for message in MESSAGES.values()}
