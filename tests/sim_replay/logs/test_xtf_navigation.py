"""Positions in packets of their own serve the pings that they stand among, whatever their clock and their length."""

from __future__ import annotations

import calendar
import math
import struct
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import pyxtf

from auv_mcm.records import NavSample
from auv_mcm.settings.config import SonarConfig
from drivers.navigation.nmea0183 import sentence
from sim_replay.logs.xtf import XtfLog
from tests.sim_replay.logs.xtf_logs import (
    START_S,
    codes_of,
    edit_file_header,
    edit_headers,
    navigation,
    navigation_of,
    packet_offsets,
    ping,
    pings_of,
    read,
    written,
)

N_PINGS = 80  # more than are read ahead
AT_START = {"MagicNumber": 0xFACE, "Year": 2023, "Month": 11, "Day": 14, "Hour": 22, "Minute": 13, "Second": 20}


def in_packets(path: Path, hours: int, only: int | None) -> Path:
    """Move positions into packets 107, which all or one are so many hours off the clock of the pings."""
    written(path, N_PINGS)
    places: list[bytes] = []

    def move(index: int, header: Any) -> None:
        packet = pyxtf.XTFPosRawNavigation()
        packet.MagicNumber, packet.HeaderType, packet.NumBytesThisRecord = 0xFACE, 107, 64
        for name in ("Year", "Month", "Day", "Hour", "Minute", "Second"):
            setattr(packet, name, getattr(header, name))
        packet.Hour += hours if only in (None, index) else 0
        packet.Microsecond = 100 * header.HSeconds
        packet.RawXcoordinate, packet.RawYcoordinate = header.SensorXcoordinate, header.SensorYcoordinate
        header.SensorXcoordinate = header.SensorYcoordinate = header.ShipXcoordinate = header.ShipYcoordinate = 0.0
        places.append(bytes(packet))

    edit_headers(path, move)
    data = path.read_bytes()
    starts = packet_offsets(data)
    ends = [*starts[1:], len(data)]
    pings = b"".join(place + data[start:end] for place, start, end in zip(places, starts, ends, strict=True))
    path.write_bytes(data[: starts[0]] + pings)
    return path


def fixes_of(events: list[Any]) -> list[NavSample]:
    return [sample for sample in navigation_of(events) if sample.latitude_deg == sample.latitude_deg]


@pytest.mark.parametrize(("hours", "only"), [(0, None), (1, None), (-1, None), (1, 20), (-1, 60)])
def test_a_clock_of_navigation_that_is_hours_off_or_once_wrong_costs_no_position(
    tmp_path: Path, hours: int, only: int | None
) -> None:
    events, log = read(in_packets(tmp_path / "log.xtf", hours, only))
    fixes = fixes_of(events)
    assert [fix.latitude_deg for fix in fixes] == pytest.approx([navigation(n).latitude_deg for n in range(N_PINGS)])
    late_s = [abs(fix.time_s - ping.time_s) for fix, ping in zip(fixes, pings_of(events), strict=True)]
    assert max(late_s[1:]) < 0.2, "what stands before the first ping may be old"
    n_doubted = 0 if not hours else 1 if only else N_PINGS - (hours < 0)
    assert log.counters["reader.packet_time_doubted"] == n_doubted
    assert ("reader.packet_time_doubted" in codes_of(events)) == bool(hours)


@pytest.mark.parametrize("n_late", [1, 3, 12])
def test_a_position_written_behind_later_pings_is_not_lost(tmp_path: Path, n_late: int) -> None:
    path = in_packets(tmp_path / "log.xtf", 0, None)
    data = path.read_bytes()
    starts = packet_offsets(data)
    packets = [data[start:end] for start, end in zip(starts, [*starts[1:], len(data)], strict=True)]
    places, pings = [b"", *packets[2::2]], packets[1::2]
    late = [b""] * n_late + places
    path.write_bytes(data[: starts[0]] + packets[0] + b"".join(ping + late[n] for n, ping in enumerate(pings)))
    times_s = [sample.time_s for sample in navigation_of(read(path)[0])]
    assert times_s == sorted(times_s)
    assert len(fixes_of(read(path)[0])) == N_PINGS - n_late


def test_a_position_that_is_repeated_is_none_whatever_packets_without_one_stand_between(tmp_path: Path) -> None:
    path = in_packets(tmp_path / "log.xtf", 0, None)
    data = bytearray(path.read_bytes())
    for number, start in enumerate(packet_offsets(bytes(data))[::2]):
        packet = pyxtf.XTFPosRawNavigation.from_buffer(data, start)
        packet.RawXcoordinate, packet.RawYcoordinate = (math.nan, math.nan) if number % 2 else (5.0, 43.0)
    path.write_bytes(data)
    assert len(fixes_of(read(path)[0])) == 1


def test_packets_without_a_place_do_not_stand_in_the_way_of_those_that_have_one(tmp_path: Path) -> None:
    path = in_packets(tmp_path / "log.xtf", 0, None)
    data = path.read_bytes()
    starts = packet_offsets(data)
    written_anew = bytearray(data[: starts[0]])
    for start, end in zip(starts, [*starts[1:], len(data)], strict=True):
        packet = bytearray(data[start:end])
        if packet[2] == 107:
            place, packet[23:39] = packet[23:39], bytes(16)
            microseconds = struct.pack("<I8x", 100 * int.from_bytes(packet[21:23], "little"))
            written_anew += packet[:2] + b"\x2a" + packet[3:21] + microseconds + place + bytes(15)
        written_anew += packet
    path.write_bytes(written_anew)
    assert len(fixes_of(read(path)[0])) == N_PINGS


@pytest.mark.parametrize("units", [0, 3])
def test_nan_for_place_and_gyro_leaves_the_fish_where_zeros_do(tmp_path: Path, units: int) -> None:
    places = []
    for nothing in (0.0, math.nan):
        path = written(tmp_path / "log.xtf")

        def tow(_: int, header: Any, nothing: float = nothing) -> None:
            header.ShipXcoordinate, header.ShipYcoordinate = header.SensorXcoordinate, header.SensorYcoordinate
            header.SensorXcoordinate = header.SensorYcoordinate = header.ShipGyro = nothing
            header.Layback = 20.0

        edit_headers(path, tow)
        edit_file_header(path, lambda header: setattr(header, "NavUnits", units))
        places.append([(sample.latitude_deg, sample.longitude_deg) for sample in navigation_of(read(path)[0])])
    assert places[0] == places[1] != []


@pytest.mark.parametrize(("numbers", "n_left"), [([40], N_PINGS - 1), ([40, 41], N_PINGS), ([N_PINGS - 1], N_PINGS)])
def test_one_ping_of_an_earlier_time_is_left_out_and_two_are_a_clock_that_was_set(
    tmp_path: Path, numbers: list[int], n_left: int
) -> None:
    path = written(tmp_path / "log.xtf", N_PINGS)
    edit_headers(path, lambda n, header: setattr(header, "Hour", header.Hour - 3 * (n in numbers)))
    events, log = read(path)
    assert len(pings_of(events)) == n_left
    assert log.counters["reader.time_outlier"] == N_PINGS - n_left


def test_navigation_packets_that_are_too_short_are_left_out(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 3)
    data = path.read_bytes()
    start = packet_offsets(data)[1]
    short = [
        (b"\xce\xfa" + bytes([kind]) + bytes(7) + n.to_bytes(4, "little") + b"\x07" * 50)[:n]
        for kind in (3, 6, 42, 84, 107)
        for n in range(14, 64)
    ]
    path.write_bytes(data[:start] + b"".join(short) + data[start:])
    events, _ = read(path)
    assert len(pings_of(events)) == 3


TICKS = {"Microsecond": 250_000}
PLACE = {"RawXcoordinate": 5.25, "RawYcoordinate": 43.5, "RawAltitude": 12.3}
ANGLES = {"Heading": 123.0, "Pitch": 2.5, "Roll": -4.0, "Heave": 0.7}
HERE, NOWHERE = (43.5, 5.25), (math.nan, math.nan)


@pytest.mark.parametrize("epsg", [None, 32631])
@pytest.mark.parametrize(
    ("kind", "layout", "values", "given"),
    [
        (42, pyxtf.XTFHeaderNavigation, TICKS | PLACE, (*HERE, math.nan, *NOWHERE)),
        (84, pyxtf.XTFHeaderGyro, TICKS | {"Gyro": 123.0}, (*NOWHERE, 123.0, *NOWHERE)),
        (3, pyxtf.XTFAttitudeData, {"Millisecond": 250} | ANGLES, (*NOWHERE, 123.0, 2.5, -4.0)),
        (107, pyxtf.XTFPosRawNavigation, {"Microsecond": 2500} | PLACE | ANGLES, (*HERE, 123.0, 2.5, -4.0)),
        (6, pyxtf.XTFRawSerialHeader, {"HSeconds": 25}, (*HERE, math.nan, *NOWHERE)),
    ],
)
def test_each_kind_of_packet_gives_its_own_quantities_at_its_own_time(
    kind: int, layout: Any, values: dict[str, Any], given: tuple[float, ...], epsg: int | None, tmp_path: Path
) -> None:
    path = written(tmp_path / "log.xtf", [ping(n) for n in range(6)])
    edit_file_header(path, lambda header: setattr(header, "NavUnits", 3 if epsg is None else 0))
    text = sentence("GPGGA,221320.25,4330.0000,N,00515.0000,E,1,08,1.0,0.0,M,0.0,M,,") if kind == 6 else b""
    one, n_bytes = layout(), 64 + 64 * bool(text)
    if epsg is not None and "RawXcoordinate" in values:
        values = values | {"RawXcoordinate": 681_902.261, "RawYcoordinate": 4_818_800.590}  # UTM zone 31
    for name, value in (AT_START | {"HeaderType": kind, "NumBytesThisRecord": n_bytes} | values).items():
        setattr(one, name, value)
    data, start = path.read_bytes(), packet_offsets(path.read_bytes())[3]
    path.write_bytes(data[:start] + (bytes(one) + text).ljust(n_bytes, b"\0") + data[start:])
    events = list(XtfLog(path, SonarConfig(), epsg=epsg))
    (sample,) = [each for each in navigation_of(events) if abs(each.time_s - START_S - 0.25) < 1e-6]
    angles = (math.degrees(angle) for angle in (sample.heading_rad, sample.pitch_rad, sample.roll_rad))
    assert (sample.latitude_deg, sample.longitude_deg, *angles) == pytest.approx(given, abs=2e-6, nan_ok=True)


def test_the_ship_stands_in_for_a_sensor_whose_position_stands_still(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", [ping(n, time_s=START_S + n) for n in range(20)])

    def tow(n: int, header: Any) -> None:  # the sensor is 10 m behind and 4 m to starboard of the ship
        header.SensorHeading = 45.0 if n < 5 else 90.0
        header.ShipYcoordinate, header.ShipXcoordinate = 43.0 + 2e-5 * n, 5.5
        header.SensorYcoordinate, header.SensorXcoordinate = 43.0 + 2e-5 * min(n, 4) - 8.910e-5, 5.5 - 5.212e-5

    edit_headers(path, tow)
    last = fixes_of(read(path)[0])[-1]
    assert (last.latitude_deg - 43.0 - 2e-5 * 19) * 111_100.0 == pytest.approx(-4.0, abs=0.05)
    assert (last.longitude_deg - 5.5) * 81_400.0 == pytest.approx(-10.0, abs=0.05)


def changed(field: str, value: int, _: int, header: Any) -> None:
    setattr(header, field, value)


def test_leap_seconds_and_years_of_two_digits_have_their_times(tmp_path: Path) -> None:
    leap, late, early = (2023, 11, 14, 22, 14, 0), (2079, 11, 14, 22, 13, 20), (1980, 11, 14, 22, 13, 20)
    for field, value, date in (("Second", 60, leap), ("Year", 79, late), ("Year", 80, early)):
        path = written(tmp_path / "log.xtf", 1)
        edit_headers(path, partial(changed, field, value))
        assert pings_of(read(path)[0])[0].time_s == calendar.timegm(date)
