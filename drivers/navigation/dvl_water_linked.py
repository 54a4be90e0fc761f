"""Decode Water Linked DVL text: `wrz` velocities and `wrp` attitude, with a CRC-8. Water Linked, "DVL serial protocol".

`w` never occurs inside a message and `*` only at its end, so whatever came before an intact message cannot swallow it.
"""

from __future__ import annotations

import math
import re
from typing import Any, Final, NamedTuple, TypeAlias

from auv_mcm.records import NAN
from drivers.framing import Grammar
from drivers.message_candidates import MessageCandidates

_MAX_MESSAGE_BYTES: Final = 384  # of a message; bounds how long junk can hold one back
_BODY: Final = rb"[\x20-\x29\x2b-\x76\x78-\x7e]"
_MESSAGE: Final = re.compile(rb"(w%b{3,%d})\*([0-9A-Fa-f]{2})" % (_BODY, _MAX_MESSAGE_BYTES - 4))
_RUN: Final = re.compile(rb"w%b*" % _BODY)
_MAX_RUN_BYTES: Final = _MAX_MESSAGE_BYTES - 3
_CANDIDATES: Final = MessageCandidates(
    (b"w",),
    alive=rb"w(?:%b{3,%d}+\*(?:[0-9A-Fa-f]{2}|.?\Z)|%b{0,%d}+\Z)"
    % (_BODY, _MAX_MESSAGE_BYTES - 4, _BODY, _MAX_RUN_BYTES - 1),
    dead=rb"((?:w(?=w))++)|w(?:(%b{%d})|%b*+(?:(?=(w))|(?=(\*))|()))" % (_BODY, _MAX_RUN_BYTES, _BODY),
    reasons=("interrupted", "oversize", "interrupted", "checksum_malformed", "malformed"),
)
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d{1,2})?")
_MAX_VELOCITY_MPS: Final = 20.0  # m/s: faster than any vehicle or lock on the bottom
_CLOCK_SET_S: Final = 946_684_800.0  # year 2000: a time of validity before it counts from power-up


class Velocity(NamedTuple):
    """Hold wrz. Forward, to starboard, down over ground, in the instrument's axes; NaN where good is False.

    covariance: 9 numbers row by row, m2/s2. validity_us: of the measurement, transmission_us: of this message, on the
    unit's clock, which is UTC where it was set.
    """

    forward_mps: float
    starboard_mps: float
    down_mps: float
    good: bool
    altitude_m: float
    figure_of_merit_mps: float
    covariance: tuple[float, ...]
    validity_us: int
    transmission_us: int
    interval_ms: float
    status: int


class WaterLinkedAttitude(NamedTuple):
    """Hold wrp. Position and heading are the unit's own dead reckoning since it was last reset, in the axes of then."""

    time_s: float
    x_m: float
    y_m: float
    z_m: float
    sigma_m: float
    roll_rad: float
    pitch_rad: float
    heading_rad: float
    status: int


Record: TypeAlias = Velocity | WaterLinkedAttitude


class TextGrammar(Grammar[str]):
    """Frame messages; a message is its text up to the `*`."""

    name = "water_linked"
    head_bytes = 1
    max_message_bytes = _MAX_MESSAGE_BYTES
    proven = True
    find = staticmethod(_CANDIDATES.find)

    def read(self, buffer: bytearray, at: int) -> tuple[str, int] | int | str:
        match = _MESSAGE.match(buffer, at)
        if match is not None:
            body, checksum = match.groups()
            return (body.decode("ascii"), match.end() - at) if crc8(body) == int(checksum, 16) else "checksum"
        run = _RUN.match(buffer, at)
        assert run is not None  # `find` saw its first character
        end = run.end()
        if end - at > _MAX_RUN_BYTES:
            return "oversize"
        if end == len(buffer) or (buffer[end] == ord("*") and len(buffer) < end + 3 and end - at >= 4):
            return end - at + 3
        return {ord("*"): "checksum_malformed", ord("w"): "interrupted"}.get(buffer[end], "malformed")


def fix_fields(record: Record) -> dict[str, Any]:
    """Return the fields of a fix that a record gives; a yaw since the unit was reset is not a heading."""
    if isinstance(record, WaterLinkedAttitude):
        time_utc_s = record.time_s if record.time_s >= _CLOCK_SET_S else None
        return {"time_utc_s": time_utc_s, "pitch_rad": record.pitch_rad, "roll_rad": record.roll_rad}
    validity_s = record.validity_us * 1e-6
    fields: dict[str, Any] = {
        "time_utc_s": validity_s if validity_s >= _CLOCK_SET_S else None,
        "age_s": max((record.transmission_us - record.validity_us) * 1e-6, 0.0),
        "valid": record.good,
    }
    if record.good:
        fields.update(
            speed_mps=math.hypot(record.forward_mps, record.starboard_mps),
            drift_rad=math.atan2(record.starboard_mps, record.forward_mps),
            speed_sigma_mps=record.figure_of_merit_mps,
            altitude_m=record.altitude_m if record.altitude_m > 0.0 else NAN,
        )
    return fields


def parse(body: str) -> Record | None:
    """Decode a message's text to its record; None for an unknown kind. Raises ValueError for what cannot be true."""
    kind, *fields = body.split(",")
    if kind == "wrz":
        if len(fields) != 11 or fields[3] not in ("y", "n"):
            raise ValueError(f"not a wrz: {body}")
        good = fields[3] == "y"
        velocities = [_number(text, _MAX_VELOCITY_MPS) if good else NAN for text in fields[:3]]
        covariance = tuple(_number(text) for text in fields[6].split(";"))
        if len(covariance) != 9:
            raise ValueError(f"not a wrz: {body}")
        validity_us, transmission_us = _integer(fields[7]), _integer(fields[8])
        altitude_m, merit_mps, interval_ms = _number(fields[4], 12_000.0), _number(fields[5]), _number(fields[9])
        forward, starboard, down = velocities
        return Velocity(
            forward,
            starboard,
            down,
            good,
            altitude_m,
            merit_mps,
            covariance,
            validity_us,
            transmission_us,
            interval_ms,
            _integer(fields[10]),
        )
    if kind == "wrp":
        if len(fields) != 9:
            raise ValueError(f"not a wrp: {body}")
        time_s, x, y, z, sigma = (_number(text) for text in fields[:5])
        roll, pitch, heading = (math.radians(_number(text, 360.0)) for text in fields[5:8])
        return WaterLinkedAttitude(time_s, x, y, z, sigma, roll, pitch, heading, _integer(fields[8]))
    return None


def message_of(record: Record) -> bytes:
    """Encode a record as a message, with CR LF."""
    if isinstance(record, Velocity):
        velocities = [velocity if record.good else 0.0 for velocity in record[:3]]
        texts = [f"{velocity:.3f}" for velocity in velocities]
        texts += ["y" if record.good else "n", f"{record.altitude_m:.2f}", f"{record.figure_of_merit_mps:.3f}"]
        texts += [
            ";".join(f"{value:.6g}" for value in record.covariance),
            str(record.validity_us),
            str(record.transmission_us),
        ]
        body = ",".join(["wrz", *texts, f"{record.interval_ms:.2f}", str(record.status)])
    else:
        metres = [f"{value:.3f}" for value in record[:5]]
        degrees = [f"{math.degrees(value):.3f}" for value in record[5:8]]
        body = ",".join(["wrp", *metres, *degrees, str(record.status)])
    data = body.encode("ascii")
    return b"%b*%02x\r\n" % (data, crc8(data))


def _crc8_table() -> tuple[int, ...]:
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value << 1) ^ (0x107 if value & 0x80 else 0)
        table.append(value & 0xFF)
    return tuple(table)


_CRC8: Final = _crc8_table()


def crc8(data: bytes) -> int:
    """Return the CRC-8 with polynomial 0x07, start 0, most significant bit first."""
    crc = 0
    for byte in data:
        crc = _CRC8[crc ^ byte]
    return crc


def _number(text: str, limit: float = 1e15) -> float:
    if _NUMBER.fullmatch(text) is None or not abs(value := float(text)) <= limit:
        raise ValueError(f"not a number here: {text}")
    return value


def _integer(text: str) -> int:
    if not text.isdecimal() or len(text) > 18:
        raise ValueError(f"not a whole number: {text}")
    return int(text)
