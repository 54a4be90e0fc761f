"""Read commands from the bytes of every dialect, without any of the product's tables: an oracle for what is sent."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

KNOT_MPS = 1852.0 / 3600.0
_IMC_HEADER_BYTES = 20
_IMC_REFERENCE = 479
_CAN_GO_TO, _CAN_STEER = 0x02, 0x03


class Sent(NamedTuple):
    """Hold the numbers of one message that commands; None for those that it lacks."""

    depth_m: float | None = None
    altitude_m: float | None = None
    heading_deg: float | None = None
    speed_mps: float | None = None
    place_deg: tuple[float, float] | None = None
    holds_s: float | None = None


def commands_of(name: str, items: Sequence[Any]) -> list[Sent]:
    """Return the commands among what a dialect sends, in order. Raises for one that its maker does not describe."""
    if name == "vehicle_can":
        return _of_frames(items)
    read = _of_packet if name == "imc" else _of_line
    return [sent for item in items if (sent := read(item)) is not None]


def _of_packet(packet: bytes) -> Sent | None:
    number, n_bytes = struct.unpack_from("<HH", packet, 2)
    payload = packet[_IMC_HEADER_BYTES : _IMC_HEADER_BYTES + n_bytes]
    if number != _IMC_REFERENCE or payload[0] & 0x80:
        return None
    at, found = 1, []
    for layout in ("<dB", "<fB"):
        (inline,) = struct.unpack_from("<H", payload, at)
        at += 2
        found.append(None if inline == 0xFFFF else struct.unpack_from(layout, payload, at))
        at += 0 if inline == 0xFFFF else struct.calcsize(layout)
    (speed_mps, speed_units), (z_m, z_units) = found  # type: ignore[misc]  # a command has both
    latitude_rad, longitude_rad = struct.unpack_from("<dd", payload, at)
    assert speed_units == 0
    return Sent(
        depth_m=z_m if z_units == 1 else None,
        altitude_m=z_m if z_units == 2 else None,
        speed_mps=speed_mps,
        place_deg=(math.degrees(latitude_rad), math.degrees(longitude_rad)),
    )


def _of_line(line: bytes) -> Sent | None:
    fields = line.decode("ascii").split("*")[0].rstrip(",").split(",")
    match fields:
        case ["$BPRMB", _, heading, vertical, mode, speed, "1", "0"]:
            depth_m, altitude_m = (float(vertical), None) if mode == "0" else (None, float(vertical))
            return Sent(depth_m, altitude_m, float(heading), float(speed))
        case ["$OMS", heading, depth, _, speed_kn, timeout]:
            return Sent(float(depth), None, float(heading), float(speed_kn) * KNOT_MPS, None, float(timeout))
        case ["#C", "Heading", "Goal", heading]:
            return Sent(heading_deg=float(heading))
        case ["#C", "Depth", "Depth", depth]:
            return Sent(depth_m=float(depth))
        case ["#C", "Speed", speed]:
            return Sent(speed_mps=float(speed.removesuffix(" meters/sec")))
    assert fields[0] not in ("$BPRMB", "$OMS", "$OMW", "#C"), line
    return None


def _of_frames(frames: Sequence[Any]) -> list[Sent]:
    contents: dict[tuple[int, int], dict[int, bytes]] = {}
    for frame in frames:
        number = frame.can_id >> 8 & 0xFF
        assert number != _CAN_STEER, "it goes from place to place"
        if number == _CAN_GO_TO:
            contents.setdefault((number, frame.data[1]), {})[frame.data[0]] = frame.data[2:]
    sent = []
    for parts in contents.values():
        (latitude, speed), (longitude, _) = struct.unpack("<iH", parts[0]), struct.unpack("<iH", parts[1])
        vertical, reference, valid = struct.unpack("<IBB", parts[2])
        vertical_m = vertical * 1e-3
        depth_m, altitude_m = (vertical_m, None) if reference == 0 else (None, vertical_m)
        place_deg = (latitude * 1e-7, longitude * 1e-7)
        sent.append(Sent(depth_m, altitude_m, None, speed * 0.01, place_deg, valid * 0.1))
    return sent
