"""Write the line as XTF with odd properties."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyxtf
from msgspec import structs

from auv_mcm.records import NavSample, Ping
from drivers.navigation.corrections import moved
from sim_replay.logs import xtf_writer
from tests.make.odd_line import line
from tests.make.odd_ports import gga, hdt, scattered
from tests.sim_replay.logs.xtf_logs import FOUR, Stored, describe, low, packet, stored

UTM_EPSG: Final = 32631
_LAYBACK_M: Final = 25.0
_STILL_FROM_S: Final = 2.0
_SPEEDS: Final = {"right": 1.0, "zero": 0.0, "half": 0.5144, "tenth": 0.1, "thrice": 3.0, "absent": math.nan}


def write_xtf(path: Path, values: dict[str, str], seed: int) -> None:
    """Write the line; values: of each property, see `tests.make.odd_recordings`."""
    xtf_writer.write_xtf(path, line().events)
    random = np.random.default_rng(seed)
    head, kept = stored(path)
    _spoil_file_header(head, values)
    pings = [event for event in line().events if isinstance(event, Ping)]
    parts, held = [bytes(head)], _Held()
    for one, ping in zip(kept, pings, strict=True):
        data = bytearray(one.header)
        header = pyxtf.XTFPingHeader.from_buffer(data)
        sample = NavSample(
            time_s=ping.time_s,
            latitude_deg=header.SensorYcoordinate,
            longitude_deg=header.SensorXcoordinate,
            heading_rad=math.radians(header.SensorHeading),
        )
        if values["position"] == "scatter":
            sample = scattered(sample, random)
        parts += _extra_packets(header, sample, values)
        _spoil(header, sample, values, held, ping.time_s - pings[0].time_s)
        del header
        parts += [
            packet(bytes(data), some) for some in _packed([_spoilt(side, values, random) for side in one.sides], values)
        ]
    path.write_bytes(b"".join(parts))


def _spoil_file_header(head: bytearray, values: dict[str, str]) -> None:
    if values["channels"].startswith("four"):
        describe(head, FOUR)
    elif values["channels"] == "both_in_one":
        describe(head, [(1, "side scan", 450.0)])
    header = pyxtf.XTFFileHeader.from_buffer(head)
    if values["units"] != "degrees":
        header.NavUnits = 0
    if values["channels"] == "undeclared":
        header.NumberOfSonarChannels = 0
    for info in header.ChanInfo:
        info.UniPolar = values["samples"] != "signed"


def _spoilt(side: Stored, values: dict[str, str], random: np.random.Generator) -> Stored:
    """Store one side otherwise."""
    samples = np.frombuffer(side.samples, "<u2")
    if values["samples"].startswith("signed"):
        samples = ((samples // 2).astype(int) * random.choice([-1, 1], samples.shape)).astype("<i2").view("<u2")
    side = Stored(side.header, samples.tobytes())
    return side if values["range"] == "stated" else side.with_fields(SlantRange=0.0)


def _packed(sides: list[Stored], values: dict[str, str]) -> list[list[Stored]]:
    """Give the channels of a ping their numbers, and packets."""
    port, starboard = sides
    match values["channels"]:
        case "zeros" | "zeros_apart" as numbers:
            channels = [side.with_fields(ChannelNumber=0) for side in sides]
            return [channels] if numbers == "zeros" else [[one] for one in channels]
        case "from_one":
            return [[side.with_fields(ChannelNumber=n + 1) for n, side in enumerate(sides)]]
        case "apart":
            return [[port], [starboard]]
        case "four" | "four_apart" as packing:
            four = [low(port), low(starboard), port, starboard]
            channels = [side.with_fields(ChannelNumber=n) for n, side in enumerate(four)]
            return [channels] if packing == "four" else [[one] for one in channels]
        case "both_in_one":
            both = Stored(port.header, port.samples + starboard.samples)
            return [[both.with_fields(NumSamples=len(both.samples) // 2)]]
        case _:
            return [sides]


class _Held:
    """Hold the last position given."""

    def __init__(self) -> None:
        self.since_s = -math.inf
        self.place = (0.0, 0.0)


def _stored(sample: NavSample, values: dict[str, str]) -> tuple[float, float]:
    if values["units"] != "utm":
        return sample.longitude_deg, sample.latitude_deg
    from pyproj import Transformer

    x, y = Transformer.from_crs(4326, UTM_EPSG, always_xy=True).transform(sample.longitude_deg, sample.latitude_deg)
    return float(x), float(y)


def _spoil(header: Any, sample: NavSample, values: dict[str, str], held: _Held, since_s: float) -> None:
    period_s = {"each_second": 1.0, "each_5_s": 5.0}.get(values["position"], 0.0)
    if since_s - held.since_s >= period_s - 1e-6:
        held.since_s, held.place = since_s, _stored(sample, values)
    if values["position"] == "frozen" and since_s > _STILL_FROM_S:
        held.since_s = math.inf
        header.ShipXcoordinate, header.ShipYcoordinate = _stored(sample, values)
    x, y = held.place
    by_packet = values["position"] in ("packet_107", "packets_42_84", "serial")
    header.SensorXcoordinate = header.SensorYcoordinate = 0.0
    if values["position"] == "ship":
        header.ShipXcoordinate, header.ShipYcoordinate = x, y
    elif values["position"] == "ship_ahead":
        heading = sample.heading_rad
        ahead = moved(
            sample.latitude_deg, sample.longitude_deg, _LAYBACK_M * math.sin(heading), _LAYBACK_M * math.cos(heading)
        )
        ship = structs.replace(sample, latitude_deg=ahead[0], longitude_deg=ahead[1])
        header.ShipXcoordinate, header.ShipYcoordinate = _stored(ship, values)
        header.Layback, header.ShipGyro = _LAYBACK_M, math.degrees(heading)
    elif not by_packet:
        header.SensorXcoordinate, header.SensorYcoordinate = x, y
    header.SensorSpeed = header.SensorSpeed * _SPEEDS[values["speed"]]
    heading_deg = header.SensorHeading
    if values["heading"] != "right" or by_packet:
        header.SensorHeading = math.nan if values["heading"] == "absent" and not by_packet else 0.0
        header.ShipGyro = heading_deg if values["heading"] == "ship" else header.ShipGyro
    if values["clock"] == "year_0":
        for name in ("Year", "Month", "Day", "Hour", "Minute", "Second", "HSeconds"):
            setattr(header, name, 0)
    elif values["clock"] == "two_digits":
        header.Year %= 100
    elif values["clock"] == "uptime":
        header.Year, header.Month, header.Day, header.Hour = 1970, 1, 1, 0


def _extra_packets(header: Any, sample: NavSample, values: dict[str, str]) -> list[bytes]:
    year, hour = header.Year, header.Hour
    month, day = header.Month, header.Day
    if values["clock"] == "two_digits":
        year %= 100
    elif values["clock"] == "uptime":
        year, month, day, hour = 1970, 1, 1, 0
    elif values["clock"] == "year_0":
        return [] if "packet" not in values["position"] else _navigation(header, sample, values, (0, 0, 0, 0))
    return _navigation(header, sample, values, (year, month, day, hour))


def _navigation(header: Any, sample: NavSample, values: dict[str, str], when: tuple[int, int, int, int]) -> list[bytes]:
    x, y = _stored(sample, values)
    heading_deg = math.degrees(sample.heading_rad)
    if values["position"] == "packet_107":
        packet = _stamped(pyxtf.XTFPosRawNavigation(), 107, header, when)
        packet.Microsecond = 100 * header.HSeconds
        packet.RawXcoordinate, packet.RawYcoordinate, packet.Heading = x, y, heading_deg
        return [bytes(packet)]
    if values["position"] == "packets_42_84":
        place = _stamped(pyxtf.XTFHeaderNavigation(), 42, header, when)
        place.Microsecond = 10_000 * header.HSeconds
        place.RawXcoordinate, place.RawYcoordinate = x, y
        gyro = _stamped(pyxtf.XTFHeaderGyro(), 84, header, when)
        gyro.Microsecond, gyro.Gyro = 10_000 * header.HSeconds, heading_deg
        return [bytes(place), bytes(gyro)]
    if values["position"] != "serial":
        return []
    text = gga(sample) + hdt(sample)
    serial = _stamped(pyxtf.XTFRawSerialHeader(), 6, header, when)
    serial.HSeconds, serial.StringSize = header.HSeconds, len(text)
    padding = -(len(bytes(serial)) + len(text)) % 64
    serial.NumBytesThisRecord = len(bytes(serial)) + len(text) + padding
    return [bytes(serial) + text + bytes(padding)]


def _stamped(packet: Any, kind: int, header: Any, when: tuple[int, int, int, int]) -> Any:
    packet.MagicNumber, packet.HeaderType, packet.NumBytesThisRecord = 0xFACE, kind, 64
    packet.Year, packet.Month, packet.Day, packet.Hour = when
    packet.Minute, packet.Second = (header.Minute, header.Second) if when[0] else (0, 0)
    return packet
