"""Make bytes that cost a framer the maximum: they look like beginnings of messages to the last deciding byte.

Each is a piece to be repeated. Distances between beginnings are as short as the format lets them be, and promised
lengths as long.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from drivers.links import slcan
from drivers.links.can_frame import CanFrame
from drivers.sonar import ping_messages
from drivers.vehicle import can_messages
from drivers.vehicle.imc_codec import MAX_PAYLOAD_BYTES

_IGX: Final = (
    b"IGX\x10\xfc\x00\x03\x1e\x00\x00\x10\x03"  # its status is the terminator of another that begins 408 bytes before
)
_PROFILE: Final = struct.pack(
    "<2sHH", b"BR", ping_messages.PROFILE_HEADER.size + 2 * 1200, ping_messages.OS_MONO_PROFILE
)
_SIDE_SCAN: Final = struct.pack("<HBBHBBBBHI", 0x1601, 1, 0, 80, 0, 20, 0, 0, 0, 240 + 2000)
_TEXT: Final[dict[str, bytes]] = {"beginnings, each followed by a letter": b"a", "beginnings alone": b""}


def _sentences(start: bytes) -> dict[str, bytes]:
    return {
        **{name: start + rest for name, rest in _TEXT.items()},
        "beginnings, ended in three ways": start + b"a\r" + start + b"a\x80" + start + b"a*",
        "shortest with a wrong checksum": start + b"aaaa*01",
        "shortest with a right checksum": start + b"aaaa*00",
        "longest": start + b"a" * 249,
        "too long": start + b"a" * 250,
        "never ending": b"a" * 4096,
    }


def _extended(can_id: int, data: bytes) -> bytes:
    return slcan.encode(CanFrame(can_id, data, True))


def _can_part(sequence: int) -> bytes:
    """Encode the first part of a payload's report."""
    report = can_messages.ReportMessage(1, 1, 7, 1, 1e9, 1.0, 1.0, 1.0, 0.5, 18.0, 0, 1, *[0.5] * 12)
    return slcan.encode(can_messages.encode(report, 96, sequence)[0])


WORST_BYTES: Final[Mapping[str, Mapping[str, bytes]]] = MappingProxyType(
    {
        "ping_protocol": {
            "syncs": b"BR",
            "syncs with lengths": b"BR\x00\x01",
            "nested headers": b"BR" + struct.pack("<HH", 4096, 7),
            "nested profiles": _PROFILE + bytes(2),
            "longest": struct.pack("<2sHHBB", b"BR", 4096, 7, 0, 0) + bytes(2000),
            "shortest with a right checksum": struct.pack("<2sHHBBH", b"BR", 0, 7, 0, 0, 0x9B),
        },
        "jsf": {
            "syncs": b"\x01\x16",
            "overlapping headers": b"\x01\x16\x00\x00",
            "headers": struct.pack("<HBBHBBBBHI", 0x1601, 1, 0, 2002, 0, 0, 0, 0, 0, 1 << 14),
            "side-scan headers": _SIDE_SCAN,
            "side-scans": _SIDE_SCAN + bytes(500),
        },
        "sportscan": {
            "syncs": b"IGX",
            "headers": _IGX,
            "broken headers": b"IGX\x10",
            "without terminators": _IGX[:4] + b"\0" + _IGX[5:],
        },
        "nmea0183": _sentences(b"$"),
        "bluefin": _sentences(b"$"),
        "iver": _sentences(b"$"),
        "pixse": _sentences(b"!"),
        "water_linked": {
            **{name: b"w" + rest for name, rest in _TEXT.items()},
            "beginnings, ended in three ways": b"wrz\r" + b"wrz\x80" + b"wrz*",
            "shortest with a wrong checksum": b"wrz,*00",
            "shortest with a right checksum": b"wrz,*05",
            "longest": b"w" + b"a" * 380,
            "too long": b"w" + b"a" * 381,
        },
        "pd6": {
            **{name: b":" + rest for name, rest in _TEXT.items()},
            "beginnings, ended in three ways": b":TS\r" + b":TS\x80" + b":TS",
            "shortest": b":TS,1\r",
            "longest": b":TS," + b"1" * 123,
            "too long": b":TS," + b"1" * 124,
        },
        "recon": {
            **{name: b"#" + rest for name, rest in _TEXT.items()},
            "beginnings, ended in three ways": b"#S\r" + b"#S\x80" + b"#S,*0",
            "shortest with a wrong checksum": b"#S,*00",
            "shortest with a right checksum": b"#S,*CC",
            "longest": b"#S," + b"1" * 246 + b",*00",
            "too long": b"#S," + b"1" * 260,
        },
        "imc": {
            "syncs": b"\x54\xfe",
            "overlapping headers": b"\x54\xfe\x0f",
            "nested headers": b"\x54\xfe" + struct.pack("<HH", 1, 4000),
            "overlapping headers, some too long": b"\x54\xfe\x54\xfe\x00\x0f",
            "headers in the other byte order": b"\xfe\x54\x00\x00\x0f",
            "longest": b"\x54\xfe" + struct.pack("<HH", 60_000, MAX_PAYLOAD_BYTES) + bytes(300),
            "shortest with a wrong checksum": b"\x54\xfe" + struct.pack("<HH", 60_000, 0) + bytes(16),
            "shortest with a right checksum": b"\xfe\x54" + struct.pack(">HH", 60_000, 0) + bytes(14) + b"\xc4\x21",
        },
        "slcan": {
            "ends": b"\r",
            "ends and refusals": b"\r\a",
            "answers and junk": b"\rx\r",
            "beginnings": b"T\r",
            "shortest frames": b"t0000\r",
            "shortest extended frames": b"T000000000\r",
            "never ending": b"T" * 4096,
        },
        "fast_packet": {
            "first frames": b"".join(_extended(0x09F80500 | number, b"\x00\xdf" + bytes(6)) for number in range(200)),
            "frames without a first": _extended(0x09F80501, b"\x01" + bytes(7)),
            "shortest frames": _extended(0x09F80501, b"\x00\x01"),
            "too short": _extended(0x09F80501, b""),
        },
        "vehicle_can": {
            "parts of many transfers": b"".join(_can_part(number & 0xFF) for number in range(256)),
            "repeated parts": _can_part(1),
            "of nobody": _extended(0x09F80501, b""),
        },
    }
)
"""By wire, as `WIRES` names it, and by what is in it."""
