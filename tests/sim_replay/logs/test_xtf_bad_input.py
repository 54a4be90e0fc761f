"""Damaged and unusable logs: a clear refusal that names the file, or everything that is sound and a count of what is
not.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.errors import BadInputError
from auv_mcm.records import Notice
from auv_mcm.settings.config import SonarConfig
from sim_replay.logs.xtf import XtfLog
from tests.sim_replay.logs.xtf_logs import (
    START_S,
    codes_of,
    edit_channels,
    edit_file_header,
    edit_headers,
    navigated,
    navigation,
    navigation_of,
    packet_offsets,
    ping,
    pings_of,
    read,
    same_trace,
    written,
)


def refusal(path: Path) -> str:
    with pytest.raises(BadInputError) as caught:
        list(XtfLog(path, SonarConfig()))
    text = str(caught.value)
    assert str(path) in text
    return text


# --- nothing can be made of these ---


def turned_to_bathymetry(header: Any) -> None:
    for info in header.ChanInfo:
        info.TypeOfChannel = 3


def without_channels(header: Any) -> None:
    header.NumberOfSonarChannels = 0
    for info in header.ChanInfo:
        info.TypeOfChannel = 0


def stored_as(sample_format: int, width: int) -> Callable[[Any], None]:
    def spoil(header: Any) -> None:
        header.ChanInfo[0].SampleFormat, header.ChanInfo[0].BytesPerSample = sample_format, width

    return spoil


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (turned_to_bathymetry, "no side-scan channel.*8 sonar packets"),
        (without_channels, "no channels at all"),
        (lambda header: setattr(header.ChanInfo[1], "CorrectionFlags", 2), "ground range"),
        (stored_as(1, 4), "sample format"),
        (stored_as(0, 3), "sample format"),
        (stored_as(0, 0), "sample format"),
    ],
)
def test_a_file_header_that_serves_for_nothing_is_refused(
    change: Callable[[Any], None], words: str, tmp_path: Path
) -> None:
    path = written(tmp_path / "log.xtf")
    edit_file_header(path, change)
    assert re.search(words, refusal(path))


@pytest.mark.parametrize(
    ("name", "n_pings", "n_bytes", "words"),
    [
        ("cut inside the file header", 8, 700, "700 of 1024"),
        ("no ping", 0, None, "no usable side-scan ping"),
        ("cut inside the first ping", 1, 1500, "no usable side-scan ping"),
    ],
)
def test_a_log_that_holds_no_ping_is_refused(
    name: str, n_pings: int, n_bytes: int | None, words: str, tmp_path: Path
) -> None:
    path = written(tmp_path / f"{name}.xtf", n_pings)
    path.write_bytes(path.read_bytes()[:n_bytes])
    assert words in refusal(path)


def test_what_is_no_file_or_another_file_is_refused_by_the_reader_itself(tmp_path: Path) -> None:
    (tmp_path / "empty.xtf").touch()
    (tmp_path / "picture.xtf").write_bytes(b"\x89PNG" + bytes(4000))
    os.mkfifo(tmp_path / "pipe.xtf")
    for name, words in (
        ("none.xtf", "does not exist"),
        (".", "directory"),
        ("pipe.xtf", "not a regular file"),
        ("empty.xtf", "empty"),
        ("picture.xtf", "not an XTF file"),
    ):
        assert words in refusal(tmp_path / name)


def test_projected_coordinates(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf")
    edit_file_header(path, lambda header: setattr(header, "NavUnits", 0))
    edit_headers(path, lambda _, header: setattr(header, "SensorYcoordinate", 4_771_000.0))
    text = refusal(path)
    assert "NavUnits 0" in text
    assert "navigation.epsg" in text


def test_degrees_that_are_said_to_be_metres_are_read_with_a_notice(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf")
    edit_file_header(path, lambda header: setattr(header, "NavUnits", 0))
    events, _ = read(path)
    assert len(pings_of(events)) == 8
    assert "reader.units_by_value" in codes_of(events)


@pytest.mark.parametrize(
    ("runs", "knots", "interval_s"), [(True, 1.0, 1.0), (False, 1.0, 0.1973 / 0.51444), (False, 0.0, 2 * 12.0 / 1500.0)]
)
def test_without_dates_times_are_by_clock_way_or_range(
    runs: bool, knots: float, interval_s: float, tmp_path: Path
) -> None:
    path = written(tmp_path / "log.xtf")

    def forget(index: int, header: Any) -> None:
        header.Month, header.Hour, header.HSeconds, header.SensorSpeed = 13, 0, 0, knots
        header.Minute, header.Second = 0, max(index - 4, 0) * runs
        if runs and index < 4:
            header.Hour, header.Minute, header.Second = 23, 59, 56 + index

    edit_headers(path, forget)
    events, log = read(path)
    assert np.diff([ping.time_s for ping in pings_of(events)]) == pytest.approx([interval_s] * 7, rel=1e-3)
    assert "reader.time_unknown" in codes_of(events)
    assert log.counters["reader.time_invalid"] == 0


# --- these are read as far as they are sound ---


def test_cut_off_anywhere_delivers_every_whole_ping(tmp_path: Path) -> None:
    whole = written(tmp_path / "whole.xtf", 4).read_bytes()
    ends = [*packet_offsets(whole)[1:], len(whole)]
    path = tmp_path / "cut.xtf"
    for length in range(ends[0], len(whole), 13):
        path.write_bytes(whole[:length])
        events, log = read(path)
        n_whole = sum(end <= length for end in ends)
        assert [p.number for p in pings_of(events)] == list(range(n_whole))
        assert log.counters["reader.damaged_packet"] == (length not in ends)
        assert all(same_trace(p.port, ping(p.number).port) for p in pings_of(events))


def test_a_cut_is_reported_with_its_place(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 3)
    data = path.read_bytes()
    last = packet_offsets(data)[2]
    path.write_bytes(data[: last + 300])
    (notice,) = [event for event in read(path)[0] if isinstance(event, Notice)]
    assert notice.code == "reader.damaged_packet"
    assert notice.place == f"log.xtf, byte {last}"
    assert "end of the file" in notice.text
    assert "300 bytes" in notice.text


@pytest.mark.parametrize("n_bytes", [1, 2, 100, 70_000])
@pytest.mark.parametrize("fill", [b"\x00", b"\xce\xfa", b"\xff", b"\x7b"])
def test_garbage_between_packets_loses_no_ping(tmp_path: Path, n_bytes: int, fill: bytes) -> None:
    path = written(tmp_path / "log.xtf", 5)
    data = path.read_bytes()
    at = packet_offsets(data)[2]
    path.write_bytes(data[:at] + (fill * n_bytes)[:n_bytes] + data[at:])
    events, log = read(path)
    assert [p.time_s for p in pings_of(events)] == pytest.approx([START_S + 0.1 * n for n in range(5)])
    assert log.counters["reader.damaged_packet"] == 1
    assert "reader.damaged_packet" in codes_of(events)


@pytest.mark.parametrize("claimed", [0, 1, 13, 100, 400, 1000, 2_000, 1 << 26, (1 << 32) - 1])
def test_an_impossible_packet_length_costs_at_most_that_ping(tmp_path: Path, claimed: int) -> None:
    path = written(tmp_path / "log.xtf", 5)
    data = bytearray(path.read_bytes())
    at = packet_offsets(bytes(data))[2]
    data[at + 10 : at + 14] = claimed.to_bytes(4, "little")
    path.write_bytes(data)
    events, log = read(path)
    tenths = [round((p.time_s - START_S) * 10) for p in pings_of(events)]
    assert [n for n in tenths if n != 2] == [0, 1, 3, 4]
    assert log.counters["reader.damaged_packet"] >= 1
    assert "reader.damaged_packet" in codes_of(events)


def test_channels_that_do_not_fit_their_packet_cost_that_ping(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 5)
    edit_headers(path, lambda index, header: setattr(header, "NumChansToFollow", 60000 if index == 2 else 2))
    events, log = read(path)
    assert len(pings_of(events)) == 4
    assert log.counters["reader.damaged_packet"] == 1


def test_much_damage_is_reported_a_few_times_and_counted_always(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 60)
    edit_headers(path, lambda index, header: setattr(header, "NumChansToFollow", 60000 if index % 2 else 2))
    events, log = read(path)
    assert log.counters["reader.damaged_packet"] == 30
    assert codes_of(events).count("reader.damaged_packet") == 10


@given(spots=st.lists(st.tuples(st.floats(0.0, 1.0), st.binary(min_size=1, max_size=40)), min_size=1, max_size=6))
@settings(max_examples=150)
def test_no_overwritten_bytes_ever_break_the_reader(
    tmp_path_factory: pytest.TempPathFactory, spots: list[tuple[float, bytes]]
) -> None:
    folder = tmp_path_factory.mktemp("spoilt")
    data = bytearray(written(folder / "log.xtf", 4).read_bytes())
    for where, garbage in spots:
        at = int(where * (len(data) - len(garbage)))
        data[at : at + len(garbage)] = garbage
    path = folder / "spoilt.xtf"
    path.write_bytes(data)
    try:
        events, log = read(path, port_order="auto")
    except BadInputError:
        return  # rejected: the text of such a message has tests of its own
    assert log.counters["reader.pings"] == len(pings_of(events)) > 0


@given(tail=st.binary(max_size=3000))
@settings(max_examples=60)
def test_random_packets_area_is_refused_or_read(tmp_path_factory: pytest.TempPathFactory, tail: bytes) -> None:
    folder = tmp_path_factory.mktemp("random")
    path = written(folder / "log.xtf", 1)
    path.write_bytes(path.read_bytes()[:1024] + tail)
    with pytest.raises(BadInputError):
        read(path)


def test_one_channel_only(tmp_path: Path) -> None:
    for side in ("port", "starboard"):
        path = written(tmp_path / f"{side}.xtf", 4, sides=(side,))
        found = pings_of(read(path)[0])
        assert [(p.port is None, p.starboard is None) for p in found] == [(side == "starboard", side == "port")] * 4
        assert all(same_trace(p.port or p.starboard, getattr(ping(p.number), side)) for p in found)


def test_a_side_that_comes_and_goes(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", navigated([ping(n, starboard=n % 2 == 0) for n in range(6)]))
    assert [p.starboard is None for p in pings_of(read(path)[0])] == [False, True] * 3


@pytest.mark.parametrize("n_without", [1, 5])
def test_a_header_without_any_navigation_brings_none(n_without: int, tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", navigated([ping(n) for n in range(5)]))

    def forget(index: int, header: Any) -> None:
        for name in ("Heading", "Pitch", "Roll", "Depth", "Speed", "PrimaryAltitude", "Ycoordinate", "Xcoordinate"):
            setattr(header, f"Sensor{name}", getattr(header, f"Sensor{name}") * (index >= n_without))

    edit_headers(path, forget)
    events, log = read(path)
    assert len(pings_of(events)) == 5
    assert math.isnan(pings_of(events)[0].altitude_m)
    assert len(navigation_of(events)) == 5 - n_without
    assert log.counters["reader.zero_navigation"] == n_without
    assert codes_of(events) == ["reader.zero_navigation"]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("field", "quantity"),
    [
        ("SensorYcoordinate", "latitude_deg"),
        ("SensorXcoordinate", "longitude_deg"),
        ("SensorHeading", "heading_rad"),
        ("SensorPitch", "pitch_rad"),
        ("SensorRoll", "roll_rad"),
        ("SensorDepth", "depth_m"),
        ("SensorPrimaryAltitude", "altitude_m"),
        ("SensorSpeed", "speed_mps"),
    ],
)
def test_nan_in_navigation_is_unknown(tmp_path: Path, field: str, quantity: str, value: float) -> None:
    path = written(tmp_path / "log.xtf", 5)
    edit_headers(path, lambda index, header: setattr(header, field, value) if index == 2 else None)
    events, log = read(path)
    samples = navigation_of(events)
    assert [math.isnan(getattr(s, quantity)) for s in samples] == [n == 2 for n in range(5)]
    assert log.counters["reader.nan_navigation"] == 1
    assert codes_of(events) == ["reader.nan_navigation"]
    if "tude_deg" in quantity:
        assert math.isnan(samples[2].latitude_deg)
        assert math.isnan(samples[2].longitude_deg)


@pytest.mark.parametrize(("latitude", "longitude"), [(91.0, 5.0), (-1e300, 5.0), (43.0, 361.0), (0.0, 0.0)])
def test_an_impossible_position_is_unknown(tmp_path: Path, latitude: float, longitude: float) -> None:
    path = written(tmp_path / "log.xtf", 2)

    def move(_: int, header: Any) -> None:
        header.SensorYcoordinate, header.SensorXcoordinate = latitude, longitude

    edit_headers(path, move)
    events, log = read(path)
    assert [math.isnan(s.latitude_deg) and math.isnan(s.longitude_deg) for s in navigation_of(events)] == [True] * 2
    assert not any(math.isnan(s.heading_rad) for s in navigation_of(events))
    assert log.counters["reader.impossible_position" if latitude else "reader.zero_position"] == 2


def test_time_going_backwards_is_delivered_and_counted(tmp_path: Path) -> None:
    times = [START_S + t for t in (0.0, 0.1, 0.2, -5.0, -4.9, -4.8)]
    path = written(
        tmp_path / "log.xtf",
        [event for n, t in enumerate(times) for event in (navigation(n, time_s=t), ping(n, time_s=t))],
    )
    events, log = read(path)
    assert [p.time_s for p in pings_of(events)] == pytest.approx(times)
    assert [s.time_s for s in navigation_of(events)] == pytest.approx(times)
    assert log.counters["reader.time_backwards"] == 1
    assert codes_of(events) == ["reader.time_backwards"]


def test_an_impossible_date_costs_that_ping(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 5)
    edit_headers(path, lambda index, header: setattr(header, "Day", 31 if index != 2 else 32))
    edit_headers(path, lambda index, header: setattr(header, "Month", 12))
    events, log = read(path)
    assert len(pings_of(events)) == 4
    assert log.counters["reader.time_invalid"] == 1
    assert codes_of(events) == ["reader.time_invalid"]


def test_another_number_of_samples_is_delivered_and_reported_once(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", navigated([ping(n, n_samples=96 if n < 2 else 64) for n in range(5)]))
    events, log = read(path)
    assert [p.port.samples.shape[0] for p in pings_of(events) if p.port] == [96, 96, 64, 64, 64]
    assert log.counters["reader.sample_count_change"] == 2
    assert codes_of(events) == ["reader.sample_count_change"]


@pytest.mark.parametrize("value", [0.0, -3.0, math.nan, math.inf])
@pytest.mark.parametrize(
    ("channels", "counter", "without_port"),
    [((0, 1), "ping_empty", [False] * 3), ((0,), "side_empty", [False, True] * 2)],
)
def test_a_ping_or_side_without_slant_range_is_left_out(
    channels: tuple[int, ...], counter: str, without_port: list[bool], value: float, tmp_path: Path
) -> None:
    path = written(tmp_path / "log.xtf", 5)

    def change(index: int, channel: int, header: Any) -> None:
        if index in (1, 3) and channel in channels:
            header.SlantRange, header.TimeDuration = value, 0.0

    edit_channels(path, change)
    events, log = read(path)
    assert [p.port is None for p in pings_of(events)][:4] == without_port
    assert log.counters[f"reader.{counter}"] == 2
    assert codes_of(events) == [f"reader.{counter}"]


def test_a_ping_without_samples_is_skipped(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 3)
    edit_channels(
        path, lambda index, channel, header: setattr(header, "NumSamples", 0) if channel == 1 and index == 1 else None
    )
    edit_headers(path, lambda index, header: setattr(header, "NumChansToFollow", 0 if index == 2 else 2))
    events, log = read(path)
    assert [p.starboard is None for p in pings_of(events)] == [False, True]
    assert log.counters["reader.ping_without_side_scan"] == 1


def test_samples_that_are_not_numbers_are_delivered_and_reported(tmp_path: Path) -> None:
    spoilt = ping(1, dtype="float32")
    assert spoilt.port is not None
    spoilt.port.samples[5] = np.nan
    events, log = read(
        written(tmp_path / "log.xtf", navigated([ping(0, dtype="float32"), spoilt]), sample_type="float32")
    )
    assert len(pings_of(events)) == 2
    assert log.counters["reader.sample_not_finite"] == 1


def test_a_joined_log_that_cannot_be_used_ends_the_pings_only(tmp_path: Path) -> None:
    first, second = written(tmp_path / "a.xtf", 3), written(tmp_path / "b.xtf", 3)
    edit_file_header(second, lambda header: setattr(header, "NavUnits", 0))
    joined = tmp_path / "joined.xtf"
    joined.write_bytes(first.read_bytes() + second.read_bytes())
    events, log = read(joined)
    assert len(pings_of(events)) == 3
    assert "reader.joined_log_unusable" in codes_of(events)
    assert log.counters["reader.ping_without_side_scan"] + log.counters["reader.damaged_packet"] == 3
