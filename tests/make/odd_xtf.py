"""Write the line as XTF with odd properties."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyxtf

from auv_mcm.records import NavSample, Ping
from sim_replay.logs import xtf_writer
from tests.make.odd_line import line
from tests.make.odd_ports import gga, hdt, scattered

UTM_EPSG: Final = 32631
_FILE_HEADER: Final = 1024
_SPEEDS: Final = {"right": 1.0, "zero": 0.0, "half": 0.5144, "thrice": 3.0, "absent": math.nan}


def write_xtf(path: Path, values: dict[str, str], seed: int) -> None:
    """Write the line; values: of each property, see `tests.make.odd_recordings`."""
    xtf_writer.write_xtf(path, line().events, sample_type="float32")
    data = bytearray(path.read_bytes())
    random = np.random.default_rng(seed)
    packets: list[bytes] = []
    offset, number, held = _FILE_HEADER, 0, _Held()
    if values["units"] != "degrees":
        pyxtf.XTFFileHeader.from_buffer(data).NavUnits = 0
    pings = [event for event in line().events if isinstance(event, Ping)]
    while offset < len(data):
        length = int.from_bytes(data[offset + 10 : offset + 14], "little")
        packet = bytearray(data[offset : offset + length])
        header = pyxtf.XTFPingHeader.from_buffer(packet)
        sample = NavSample(
            time_s=pings[number].time_s,
            latitude_deg=header.SensorYcoordinate,
            longitude_deg=header.SensorXcoordinate,
            heading_rad=math.radians(header.SensorHeading),
        )
        if values["position"] == "scatter":
            sample = scattered(sample, random)
        packets += _extra_packets(header, sample, values)
        _spoil(header, sample, values, held, pings[number].time_s - pings[0].time_s)
        del header
        packets.append(bytes(packet))
        offset += length
        number += 1
    path.write_bytes(bytes(data[:_FILE_HEADER]) + b"".join(packets))


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
    x, y = held.place
    by_packet = values["position"] in ("packet_107", "packets_42_84", "serial")
    header.SensorXcoordinate = header.SensorYcoordinate = 0.0
    if values["position"] == "ship":
        header.ShipXcoordinate, header.ShipYcoordinate = x, y
    elif not by_packet:
        header.SensorXcoordinate, header.SensorYcoordinate = x, y
    header.SensorSpeed = header.SensorSpeed * _SPEEDS[values["speed"]]
    heading_deg = header.SensorHeading
    if values["heading"] != "right" or by_packet:
        header.SensorHeading = math.nan if values["heading"] == "absent" and not by_packet else 0.0
        header.ShipGyro = heading_deg if values["heading"] == "ship" else 0.0
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
