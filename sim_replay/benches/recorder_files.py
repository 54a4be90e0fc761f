"""Write small logs as recorders of Lowrance, Humminbird and Klein do, byte by byte from the public layouts.

Places of fields are those of the descriptions that the readers name, not the readers' own, so that one does not hide
the other's errors. Navigation is that of the last sample before a ping; fish finders round positions to metres and
samples to 8 bits of decibels.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace, NavSample, Ping

Event = NavSample | Ping

_COUNTS_PER_DB: Final = 255.0 / 90.0  # 8 bits hold the 90 dB of 16 bits
_FEET: Final = 1.0 / 0.3048  # per metre
_KNOTS: Final = 3600.0 / 1852.0  # per m/s
_KC: Final = 1.0067642927  # of Humminbird's latitude
_SON_SAMPLE_M: Final = 2.0 / math.pi * math.asin(1500.0 / (0.108 * 455e3))  # m, of a Humminbird's sample
_UNKNOWN_SON: Final = b"\xa1\xb2\xc3\xd4"  # in fields of which nothing is known


def _soundings(events: Iterable[Event]) -> Iterator[tuple[Ping, NavSample]]:
    navigation = NavSample(time_s=math.nan)
    for event in events:
        if isinstance(event, NavSample):
            navigation = event
        else:
            yield event, navigation


def _decibels(trace: EchoTrace | None) -> NDArray[np.uint8]:
    values = np.empty(0) if trace is None else 20.0 * np.log10(1.0 + trace.samples.astype(np.float64))
    return np.clip(np.rint(values * _COUNTS_PER_DB), 0.0, 255.0).astype(np.uint8)


def _packed(n_bytes: int, order: str, fields: dict[int, tuple[str, Any]]) -> bytes:
    """Pack values, each a form and a value, at their places."""
    data = bytearray(n_bytes)
    for at, (form, value) in fields.items():
        struct.pack_into(order + form, data, at, value)
    return bytes(data)


def _mercator_m(radius_m: float, longitude_deg: float, latitude_rad: float) -> tuple[int, int]:
    north_m = radius_m * math.log(math.tan(0.25 * math.pi + 0.5 * latitude_rad))
    return round(radius_m * math.radians(longitude_deg)), round(north_m)


def write_lowrance(path: Path, events: Iterable[Event], *, version: int = 2, composite: bool = True) -> None:
    """Write an SL2 or SL3 log, by the version; not composite: a frame per side. A sounder's frame is among them."""
    at = {
        2: {"n": 144, "size": 28, "before": 30, "channel": 32, "packet": 34, "index": 36, "limits": 40, "start": 60}
        | {"depth": 64, "speed": 100, "x": 108, "y": 112, "course": 120, "flags": 132, "ms": 140},
        3: {"n": 168, "size": 8, "before": 10, "channel": 12, "packet": 44, "index": 16, "limits": 20, "start": 40}
        | {"depth": 48, "speed": 84, "x": 92, "y": 96, "course": 104, "flags": 116, "ms": 124},
    }[version]
    data, before, start_s = bytearray(struct.pack("<HHHH", version, 1, 3200, 0)), 0, 0
    for index, (ping, nav) in enumerate(_soundings(events)):
        start_s = start_s or int(ping.time_s)
        x, y = _mercator_m(6_356_752.3142, nav.longitude_deg, math.radians(nav.latitude_deg))
        port, starboard = _decibels(ping.port), _decibels(ping.starboard)
        trace = ping.port or ping.starboard
        range_ft = 0.0 if trace is None else trace.spacing_m * trace.samples.size * _FEET
        frames = [(0, 0.0, np.full(40, 7, np.uint8))] if index == 1 else []
        if composite:
            frames.append((5, -range_ft, np.concatenate([port[::-1], starboard])))
        else:
            frames += [(3, 0.0, port), (4, 0.0, starboard)]
        for channel, first_ft, samples in frames:
            fields = {
                0: ("I", len(data)),
                at["size"]: ("H", at["n"] + samples.size),
                at["before"]: ("H", before),
                at["channel"]: ("H", channel),
                at["packet"]: ("H" if version == 2 else "I", samples.size),
                at["index"]: ("I", index),
                at["limits"]: ("f", first_ft),
                at["limits"] + 4: ("f", range_ft),
                at["start"]: ("I", start_s),
                at["depth"]: ("f", nav.altitude_m * _FEET),
                at["speed"]: ("f", nav.speed_mps * _KNOTS),
                at["x"]: ("i", x),
                at["y"]: ("i", y),
                at["course"]: ("f", nav.heading_rad % math.tau),
                at["flags"]: ("H", 0x02BE),
                at["ms"]: ("I", round(1e3 * (ping.time_s - start_s))),
            } | ({52: ("H", 4)} if version == 3 else {})
            data += _packed(at["n"], "<", fields) + samples.tobytes()
            before = at["n"] + samples.size
    path.write_bytes(data)


def write_humminbird(dat: Path, events: Iterable[Event], *, model: str = "Helix", son: Path | None = None) -> None:
    """Write the .DAT file of a Helix or a Solix, and B002.SON, B003.SON and their indices in `son`, or beside it."""
    folder, sides, start_s = son or dat.with_suffix(""), {2: bytearray(), 3: bytearray()}, 0
    index = {2: bytearray(), 3: bytearray()}
    folder.mkdir(exist_ok=True)
    for number, (ping, nav) in enumerate(_soundings(events)):
        start_s = start_s or int(ping.time_s)
        latitude_rad = math.atan(math.tan(math.radians(nav.latitude_deg)) / _KC)
        east, north = _mercator_m(6_378_388.0, nav.longitude_deg, latitude_rad)
        time_ms = round(1e3 * (ping.time_s - start_s))
        for beam, trace in ((2, ping.port), (3, ping.starboard)):
            samples = _stretched(trace)
            head = b"\xc0\xde\xab\x21" + struct.pack(">BIBI", 0x80, number, 0x81, time_ms)
            head += struct.pack(">BiBi", 0x82, east, 0x83, north)
            head += struct.pack(">BHH", 0x84, 1, round(math.degrees(nav.heading_rad) % 360.0 * 10.0))
            head += struct.pack(">BHHBI", 0x85, 1, round(10.0 * nav.speed_mps), 0x86, 0)
            head += struct.pack(">BI", 0x87, round(10.0 * nav.altitude_m))
            if model == "Solix":
                head += b"".join(bytes([tag]) + _UNKNOWN_SON for tag in range(0x88, 0x90))
            head += struct.pack(">BBBBBI", 0x50, beam, 0x51, 36, 0x92, 800_000)
            head += struct.pack(">BBBBBIBBBB", 0x53, 18, 0x54, 1, 0x95, 26, 0x56, 0, 0x57, 0)
            if model == "Solix":
                head += b"".join(bytes([tag]) + _UNKNOWN_SON for tag in range(0x98, 0xA0))
            index[beam] += struct.pack(">II", time_ms, len(sides[beam]))
            sides[beam] += head + struct.pack(">BIB", 0xA0, samples.size, 0x21) + samples.tobytes()
    for beam in sides:
        (folder / f"B00{beam}.SON").write_bytes(sides[beam])
        (folder / f"B00{beam}.IDX").write_bytes(index[beam])
    n_bytes, first, order = (64, 0xC1, ">") if model == "Helix" else (96, 0xC3, "<")
    dat.write_bytes(
        _packed(n_bytes, order, {0: ("B", first), 1: ("B", 1), 20: ("I", start_s), 32: ("10s", dat.stem.encode())})
    )


def _stretched(trace: EchoTrace | None) -> NDArray[np.uint8]:
    """Resample a side to the length of a Humminbird's samples."""
    samples = _decibels(trace)
    if trace is None:
        return samples
    n_samples = round(trace.spacing_m * samples.size / _SON_SAMPLE_M)
    at = (np.arange(n_samples) + 0.5) * samples.size / n_samples - 0.5
    return np.rint(np.interp(at, np.arange(samples.size), samples)).astype(np.uint8)


def write_sdf(path: Path, events: Iterable[Event], *, version: int = 3502) -> None:
    """Write a Klein log of pages of one version; those of a System 3000 hold a low frequency of half the levels."""
    data = bytearray()
    for ping, nav in _soundings(events):
        when = datetime.fromtimestamp(int(ping.time_s), UTC)
        dates = (when.year, when.month, when.day, when.hour, when.minute, when.second)
        angles = [math.degrees(angle) for angle in (nav.heading_rad % math.tau, nav.pitch_rad, nav.roll_rad)]
        sides = [np.empty(0) if trace is None else trace.samples for trace in (ping.port, ping.starboard)]
        trace, is_uuv = ping.port or ping.starboard, version in (3501, 3502)
        assert trace is not None
        count, sample, vectors = (
            ("I", "<u4", sides) if is_uuv else ("H", "<u2", [*(side // 2 for side in sides), *sides])
        )
        if version >= 5000:
            vectors = [sides[0]] * 5 + [sides[1]] * 5
        body = b"".join(struct.pack(f"<{count}", side.size) + side.astype(sample).tobytes() for side in vectors)
        fields: dict[int, tuple[str, Any]] = {
            0: ("I", 512 + len(body)),
            4: ("I", version),
            12: ("I", ping.number),
            16: ("I", trace.samples.size),
            20: ("I", 0b00100),
            28: ("I", round(trace.spacing_m * trace.samples.size)),
            32: ("I", round(100.0 * nav.speed_mps)),
            36: ("I", round(100.0 * ping.sound_speed_mps)),
            **{68 + 4 * n: ("I", number) for n, number in enumerate(dates)},
            92: ("I", int(100.0 * (ping.time_s % 1.0))),
            132: ("f", nav.speed_mps),
            144: ("d", math.radians(nav.latitude_deg)),
            152: ("d", math.radians(nav.longitude_deg)),
            180: ("I", 512),
            216: ("f", ping.time_s % 1.0),
            404: ("I", 900),
        }
        if is_uuv:
            fields |= {136: ("f", angles[0]), 196: ("f", angles[1]), 200: ("f", angles[2])}
            fields |= {204: ("f", nav.depth_m), 208: ("f", nav.altitude_m)}
        else:
            fields |= {108 + 4 * n: ("f", angle) for n, angle in enumerate(angles)} | {124: ("f", nav.altitude_m)}
        data += b"\xff\xff\xff\xff" + _packed(512, "<", fields) + body
    path.write_bytes(data)
