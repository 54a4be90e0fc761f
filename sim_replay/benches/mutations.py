"""Damage copies of XTF logs, reproducibly from a seed: bytes, packets, header fields, navigation, clocks and
samples."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pyxtf

FILE_HEADER_BYTES: Final = 1024  # of XTF
_PING_HEADER_BYTES: Final = 256  # of XTF
_CHANNEL_HEADER_BYTES: Final = 64  # of XTF
_SONAR: Final = 0  # packet type
_METRES_PER_DEGREE: Final = 111_320.0  # of latitude
_SHORTEST_JUMP_M: Final = 10.0  # m: below the noise of a poor receiver
_LONGEST_JUMP_M: Final = 90.0 * _METRES_PER_DEGREE
_NONSENSE: Final = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-30, 1e30, 1e9, -1e9, 360.0, 90.001)


class XtfPieces(NamedTuple):
    """Hold an XTF file in pieces: its header, and its packets in order."""

    header: bytearray
    packets: list[bytearray]

    def joined(self) -> bytes:
        """Join the pieces to a file."""
        return bytes(self.header) + b"".join(self.packets)


Random = np.random.Generator
Change = Callable[[XtfPieces, Random], "XtfPieces | bytes"]


def split(data: bytes, max_packets: int) -> XtfPieces:
    """Split an undamaged log into its header and its first packets, up to a maximum."""
    packets: list[bytearray] = []
    offset = FILE_HEADER_BYTES
    while offset + 14 <= len(data) and len(packets) < max_packets:
        n_bytes = int.from_bytes(data[offset + 10 : offset + 14], "little")
        if n_bytes < 14:
            break
        packets.append(bytearray(data[offset : offset + n_bytes]))
        offset += n_bytes
    return XtfPieces(bytearray(data[:FILE_HEADER_BYTES]), packets)


def mutated(log: XtfPieces, kinds: Sequence[str], random: Random) -> bytes:
    """Change the log in these ways, in order; kinds that work on packets come before kinds that work on bytes."""
    log = XtfPieces(bytearray(log.header), [bytearray(packet) for packet in log.packets])
    for kind in sorted(kinds, key=lambda kind: kind in BYTES):
        changed = CHANGES[kind](log, random)
        if isinstance(changed, bytes):
            return changed
        log = changed
    return log.joined()


# --- pings -----------------------------------------------------------------------------------------------------------


def _pings(log: XtfPieces) -> list[Any]:
    """View the headers of the pings, which write through to the packets."""
    return [
        pyxtf.XTFPingHeader.from_buffer(packet)
        for packet in log.packets
        if packet[2] == _SONAR and len(packet) >= _PING_HEADER_BYTES
    ]


def _some(random: Random, n: int) -> slice:
    """Choose a stretch of 1 to n pings."""
    length = max(1, min(n, round(math.exp(random.uniform(0.0, math.log(max(n, 2)))))))
    first = int(random.integers(0, n - length + 1)) if n else 0
    return slice(first, first + length)


def _move(header: Any, north_deg: float, east_deg: float) -> None:
    for prefix in ("Ship", "Sensor"):
        if getattr(header, f"{prefix}Ycoordinate") or getattr(header, f"{prefix}Xcoordinate"):
            setattr(header, f"{prefix}Ycoordinate", getattr(header, f"{prefix}Ycoordinate") + north_deg)
            setattr(header, f"{prefix}Xcoordinate", getattr(header, f"{prefix}Xcoordinate") + east_deg)


def _jump(random: Random) -> tuple[float, float]:
    """Draw north and east of a jump of 10 m to 90 degrees, in degrees; all orders of magnitude are equally likely."""
    length_deg = math.exp(random.uniform(math.log(_SHORTEST_JUMP_M), math.log(_LONGEST_JUMP_M))) / _METRES_PER_DEGREE
    direction = random.uniform(0.0, 2.0 * math.pi)
    return length_deg * math.cos(direction), length_deg * math.sin(direction)


def _moved(chosen: Callable[[list[Any], Random], list[Any]]) -> Change:
    """Move some pings by one jump."""

    def change(log: XtfPieces, random: Random) -> XtfPieces:
        pings, jump = _pings(log), _jump(random)
        for header in chosen(pings, random):
            _move(header, *jump)
        return log

    return change


def _scattered_fixes(log: XtfPieces, random: Random) -> XtfPieces:
    share = random.uniform(0.05, 0.9)
    for header in _pings(log):
        if random.random() < share:
            _move(header, *_jump(random))
    return log


def _drifting_fixes(log: XtfPieces, random: Random) -> XtfPieces:
    step_deg = math.exp(random.uniform(math.log(1.0), math.log(1e5))) / _METRES_PER_DEGREE
    for number, header in enumerate(_pings(log)):
        _move(header, number * step_deg, 0.0)
    return log


def _nonsense(random: Random, share: float, spread: float) -> float:
    """Draw one of the values that are nonsense, or by 1 - share a number of so wide a spread."""
    if random.random() < share:
        return _NONSENSE[int(random.integers(len(_NONSENSE)))]
    return float(random.normal(0.0, spread))


def _set_fields(*names: str) -> Change:
    """Set one of the fields to one value, over a stretch of pings or in all."""

    def change(log: XtfPieces, random: Random) -> XtfPieces:
        name = names[int(random.integers(len(names)))]
        value = _nonsense(random, 0.6, 100.0)
        pings = _pings(log)
        for header in pings if random.random() < 0.5 else pings[_some(random, len(pings))]:
            _set(header, name, value)
        return log

    return change


def _set(structure: Any, name: str, value: float) -> None:
    """Store a number in a field of any type; integers wrap round."""
    kind = {field[0]: field[1] for field in structure._fields_}[name]
    if issubclass(kind, (ctypes.c_float, ctypes.c_double)):
        setattr(structure, name, value)
    elif not issubclass(kind, ctypes.Array):
        setattr(structure, name, int(value) if math.isfinite(value) else -1)


def _random_fields(log: XtfPieces, random: Random) -> XtfPieces:
    pings = _pings(log)
    if not pings:
        return log
    names = [
        field[0] for field in pyxtf.XTFPingHeader._fields_ if field[0] not in ("MagicNumber", "NumBytesThisRecord")
    ]
    for _ in range(int(random.integers(1, 30))):
        name, value = names[int(random.integers(len(names)))], _nonsense(random, 0.5, 1e4)
        _set(pings[int(random.integers(len(pings)))], name, value)
    return log


def _turned_heading(log: XtfPieces, random: Random) -> XtfPieces:
    degrees = float(random.choice([90.0, 180.0, -90.0, random.uniform(0.0, 360.0)]))
    for header in _pings(log):
        header.SensorHeading = (header.SensorHeading + degrees) % 360.0
        header.ShipGyro = (header.ShipGyro + degrees) % 360.0
    return log


def _mirrored_position(log: XtfPieces, random: Random) -> XtfPieces:
    swaps = random.random() < 0.5
    for header in _pings(log):
        for prefix in ("Ship", "Sensor"):
            latitude, longitude = getattr(header, f"{prefix}Ycoordinate"), getattr(header, f"{prefix}Xcoordinate")
            setattr(header, f"{prefix}Ycoordinate", longitude if swaps else -latitude)
            setattr(header, f"{prefix}Xcoordinate", latitude if swaps else -longitude)
    return log


def _near_pole_or_antimeridian(log: XtfPieces, random: Random) -> XtfPieces:
    pings = _pings(log)
    placed = next((header for header in pings if header.SensorYcoordinate or header.ShipYcoordinate), None)
    if placed is None:
        return log
    latitude = placed.SensorYcoordinate or placed.ShipYcoordinate
    longitude = placed.SensorXcoordinate or placed.ShipXcoordinate
    at_pole = random.random() < 0.5
    north, east = (math.copysign(89.9999, latitude) - latitude, 0.0) if at_pole else (0.0, 179.9999 - longitude)
    for header in pings:
        _move(header, north, east)
    return log


def _clock(log: XtfPieces, random: Random) -> XtfPieces:
    """Make a clock stop, run backwards, leap, or give any value."""
    pings = _pings(log)
    part = pings[_some(random, len(pings))]
    how = int(random.integers(4))
    fields = ("Year", "Month", "Day", "Hour", "Minute", "Second", "HSeconds")
    times = [[getattr(header, name) for name in fields] for header in part]
    for header, first, backwards in zip(part, times[:1] * len(part), times[::-1], strict=True):
        if how < 2:
            for name, value in zip(fields, backwards if how else first, strict=True):
                setattr(header, name, value)
        elif how == 2:
            header.Year = int(random.choice([1970, 1980, 2150, 9999]))
        else:
            for name, end in (("Hour", 26), ("Minute", 62), ("Second", 62), ("HSeconds", 110)):
                setattr(header, name, int(random.integers(0, end)))
    return log


# --- packets, channels, samples --------------------------------------------------------------------------------------


def _order(how: Callable[[list[bytearray], Random], list[bytearray]]) -> Change:
    def change(log: XtfPieces, random: Random) -> XtfPieces:
        part = _some(random, len(log.packets))
        return XtfPieces(
            log.header, [*log.packets[: part.start], *how(log.packets[part], random), *log.packets[part.stop :]]
        )

    return change


def _shuffled(packets: list[bytearray], random: Random) -> list[bytearray]:
    return [packets[index] for index in random.permutation(len(packets))]


def _thinned(packets: list[bytearray], random: Random) -> list[bytearray]:
    share = random.random()
    return [packet for packet in packets if random.random() > share]


def _repeated(packets: list[bytearray], random: Random) -> list[bytearray]:
    return [bytearray(packet) for packet in packets for _ in range(1 + int(random.random() < 0.5))]


def _channel_fields(log: XtfPieces, random: Random) -> XtfPieces:
    names = [field[0] for field in pyxtf.XTFPingChanHeader._fields_]
    for _ in range(int(random.integers(1, 20)) if log.packets else 0):
        packet = log.packets[int(random.integers(len(log.packets)))]
        if packet[2] != _SONAR or len(packet) < _PING_HEADER_BYTES + _CHANNEL_HEADER_BYTES:
            continue
        value = _nonsense(random, 0.5, 1e3)
        _set(
            pyxtf.XTFPingChanHeader.from_buffer(packet, _PING_HEADER_BYTES),
            names[int(random.integers(len(names)))],
            value,
        )
    return log


def _samples(log: XtfPieces, random: Random) -> XtfPieces:
    """Make samples zero, full scale, noise, stuck, or anything, over a stretch of pings."""
    how = int(random.integers(4))
    for packet in log.packets[_some(random, len(log.packets))]:
        start = _PING_HEADER_BYTES + _CHANNEL_HEADER_BYTES
        n_bytes = len(packet) - start
        if n_bytes > 0 and packet[2] == _SONAR:
            packet[start:] = (
                bytes(n_bytes),
                b"\xff" * n_bytes,
                random.bytes(n_bytes),
                b"\x07\x00" * (n_bytes // 2) + bytes(n_bytes % 2),
            )[how]
    return log


# --- bytes -----------------------------------------------------------------------------------------------------------


def _flipped_bits(n_bits: int, n_bytes: int | None) -> Change:
    """Flip fewer bits than so many, in the first bytes or anywhere."""

    def change(log: XtfPieces, random: Random) -> bytes:
        data = bytearray(log.joined())
        for _ in range(int(random.integers(1, n_bits))):
            data[int(random.integers(n_bytes or len(data)))] ^= 1 << int(random.integers(8))
        return bytes(data)

    return change


def _truncated(log: XtfPieces, random: Random) -> bytes:
    data = log.joined()
    return data[: int(random.integers(len(data)))]


def _inserted(log: XtfPieces, random: Random) -> bytes:
    data = log.joined()
    at = int(random.integers(FILE_HEADER_BYTES, len(data) + 1))
    return data[:at] + random.bytes(int(random.integers(1, 5000))) + data[at:]


def _removed(log: XtfPieces, random: Random) -> bytes:
    data = log.joined()
    at = int(random.integers(FILE_HEADER_BYTES, len(data) + 1))
    return data[:at] + data[at + int(random.integers(1, 20_000)) :]


def _zeroed(log: XtfPieces, random: Random) -> bytes:
    data = bytearray(log.joined())
    at, n_bytes = int(random.integers(len(data))), int(random.integers(1, 20_000))
    data[at : at + n_bytes] = bytes(len(data[at : at + n_bytes]))
    return bytes(data)


def _joined_twice(log: XtfPieces, random: Random) -> bytes:
    return log.joined() * 2


JUMPS: Final[dict[str, Change]] = {
    "jump and back": _moved(lambda pings, random: pings[_some(random, len(pings))]),
    "jump that stays": _moved(lambda pings, random: pings[int(random.integers(0, max(len(pings), 1))) :]),
    "wrong first fixes": _moved(lambda pings, random: pings[: int(random.integers(1, 12))]),
    "every n-th fix elsewhere": _moved(lambda pings, random: pings[:: int(random.integers(2, 6))]),
    "half of the fixes elsewhere": _moved(lambda pings, random: [one for one in pings if random.random() < 0.5]),
    "scattered fixes": _scattered_fixes,
    "drifting fixes": _drifting_fixes,
}
"""Navigation jumps of 10 m to 90 degrees."""

BYTES: Final[dict[str, Change]] = {
    "flipped bits": _flipped_bits(200, None),
    "flipped bits in the file header": _flipped_bits(20, FILE_HEADER_BYTES),
    "cut off": _truncated,
    "bytes inserted": _inserted,
    "bytes removed": _removed,
    "bytes zeroed": _zeroed,
    "joined to itself": _joined_twice,
}
CHANGES: Final[dict[str, Change]] = {
    **JUMPS,
    "nonsense in positions": _set_fields(
        "SensorYcoordinate", "SensorXcoordinate", "ShipYcoordinate", "ShipXcoordinate"
    ),
    "mirrored positions": _mirrored_position,
    "pole or antimeridian": _near_pole_or_antimeridian,
    "nonsense in heading": _set_fields("SensorHeading", "ShipGyro"),
    "turned heading": _turned_heading,
    "nonsense in altitude and depth": _set_fields("SensorPrimaryAltitude", "SensorDepth", "SensorAuxAltitude"),
    "nonsense in attitude": _set_fields("SensorPitch", "SensorRoll", "Yaw"),
    "nonsense in speeds": _set_fields("SensorSpeed", "ShipSpeed", "SoundVelocity"),
    "nonsense in the clock": _clock,
    "nonsense anywhere in ping headers": _random_fields,
    "nonsense in channel headers": _channel_fields,
    "samples": _samples,
    "packets out of order": _order(_shuffled),
    "packets backwards": _order(lambda packets, _: packets[::-1]),
    "packets lost": _order(_thinned),
    "packets twice": _order(_repeated),
    **BYTES,
}
"""Kinds of damage by name."""
