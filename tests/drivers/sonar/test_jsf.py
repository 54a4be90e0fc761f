"""JSF as its description lays it out: every field at its offset, samples and ranges in their units."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from auv_mcm.errors import UsageError
from auv_mcm.records import Notice
from drivers.framing import Framer
from drivers.sonar.jsf import JsfDecoder, JsfGrammar, commands
from drivers.sonar.jsf_messages import (
    DATA_HEADER,
    PING_ENABLE,
    PING_GAIN,
    PING_RANGE,
    SYSTEM_TIME,
    Command,
    DataFormat,
    JsfMessage,
    PositionUnits,
    SideScanData,
    SideScanHeader,
    Validity,
    decode_data,
    encode_data,
    time_reply,
    to_wire,
)
from drivers.sonar.sonar_decoder import SonarFrame, SonarSettings
from tests.drivers.sonar.sonar_frames import frames_of, items_of, replies_of

# Offset and struct format of each field behind the message header, from EdgeTech's description.
OFFSETS: dict[str, tuple[int, str]] = {
    "time_s": (0, "i"),
    "start_depth_samples": (4, "I"),
    "ping_number": (8, "I"),
    "msb": (16, "H"),
    "lsb_1": (18, "H"),
    "lsb_2": (20, "H"),
    "id_code": (28, "h"),
    "validity": (30, "H"),
    "data_format": (34, "h"),
    "antenna_aft_cm": (36, "h"),
    "antenna_starboard_cm": (38, "h"),
    "pipe_km": (44, "f"),
    "heave_m": (48, "f"),
    "gap_filler_lateral_m": (76, "f"),
    "longitude": (80, "i"),
    "latitude": (84, "i"),
    "units": (88, "h"),
    "annotation": (90, "24s"),
    "samples_low": (114, "H"),
    "interval_ns": (116, "I"),
    "adc_gain": (120, "H"),
    "transmit_level_percent": (122, "h"),
    "start_frequency_dahz": (126, "H"),
    "end_frequency_dahz": (128, "H"),
    "sweep_ms": (130, "H"),
    "pressure_mpsi": (132, "i"),
    "depth_mm": (136, "i"),
    "sample_frequency_hz": (140, "H"),
    "pulse_id": (142, "H"),
    "altitude_mm": (144, "i"),
    "sound_speed_mps": (148, "f"),
    "mixer_hz": (152, "f"),
    "year": (156, "h"),
    "day_of_year": (158, "h"),
    "hour": (160, "h"),
    "minute": (162, "h"),
    "second": (164, "h"),
    "time_basis": (166, "h"),
    "weighting": (168, "h"),
    "pulses_in_water": (170, "h"),
    "heading_cdeg": (172, "H"),
    "pitch_counts": (174, "h"),
    "roll_counts": (176, "h"),
    "trigger_source": (182, "h"),
    "mark_low": (184, "H"),
    "course_deg": (192, "h"),
    "speed_dkn": (194, "h"),
    "milliseconds_today": (200, "I"),
    "max_adc": (204, "H"),
    "software_version": (210, "6s"),
    "packet_number": (220, "H"),
    "water_temperature_ddeg": (226, "h"),
    "layback_m": (228, "f"),
    "cable_out_dm": (236, "H"),
}

FIELDS_OF: dict[int, set[str]] = {
    Validity.POSITION: {"latitude_deg", "longitude_deg"},
    Validity.HEADING: {"heading_rad"},
    Validity.PITCH_ROLL: {"pitch_rad", "roll_rad"},
    Validity.DEPTH: {"depth_m"},
    Validity.ALTITUDE: {"altitude_m"},
    Validity.SPEED: {"speed_mps"},
}


def header(**changes: Any) -> SideScanHeader:
    """Ping 12 of a sonar that samples every 20 us and knows its sound speed."""
    made = SideScanHeader(
        time_s=1_700_000_000, ping_number=12, milliseconds_today=80_123_456, interval_ns=20_000, sound_speed_mps=1480.0
    )._replace(validity=Validity.SOUND_SPEED)
    return made._replace(**changes)


def side(channel: int, values: Any = (100, 200, 300), *, subsystem: int = 21, **changes: Any) -> bytes:
    reported = header(**changes)
    envelope = reported.data_format == DataFormat.ENVELOPE
    data = SideScanData(reported, np.array(values, dtype=np.uint16) if envelope else np.array(values, dtype=np.int16))
    return encode_data(data, subsystem, channel)


def read(wire: bytes) -> JsfMessage:
    framer = Framer(JsfGrammar())
    (framed,) = framer.feed(wire) + framer.finish()
    return framed.message


def test_every_field_stands_where_the_description_has_it() -> None:
    random = np.random.Generator(np.random.PCG64(4))
    body = bytearray(240)
    wanted: dict[str, Any] = {}
    for name, (offset, kind) in OFFSETS.items():
        raw = struct.pack("<f", random.normal()) if kind == "f" else random.bytes(struct.calcsize("<" + kind))
        body[offset : offset + len(raw)] = raw
        wanted[name] = struct.unpack("<" + kind, raw)[0]
    body[34:36], wanted["data_format"] = bytes(2), 0
    body[16:18], wanted["msb"] = b"\x21\xa0", 0xA021  # no high bits of the number of samples, so that it stays small
    body[114:116], wanted["samples_low"] = b"\x05\x00", 5
    reported = decode_data(bytes(body) + np.arange(5, dtype="<u2").tobytes())
    assert reported is not None
    assert reported.header._asdict() == wanted
    assert reported.values.tolist() == [0, 1, 2, 3, 4]
    message = read(encode_data(reported, subsystem=20, channel=1, sequence=9))
    assert (message.message_type, message.subsystem, message.channel, message.sequence) == (80, 20, 1, 9)
    assert message.body == bytes(body) + np.arange(5, dtype="<u2").tobytes()


def test_the_message_header_stands_where_the_description_has_it() -> None:
    wire = to_wire(
        JsfMessage(2002, b"$ab", command=2, subsystem=101, channel=3, sequence=4, session=5, version=6, reserved=0x0708)
    )
    assert wire.hex(" ") == "01 16 06 05 d2 07 02 65 03 04 08 07 03 00 00 00 24 61 62"
    assert read(wire) == JsfMessage(2002, b"$ab", 2, 101, 3, 4, 5, 6, 0x0708)


def test_high_bits_are_joined_to_the_low_ones() -> None:
    joined = SideScanHeader(msb=0xCBA9, samples_low=0x1234, start_frequency_dahz=0x5678, end_frequency_dahz=0x9ABC)
    assert joined.n_samples == 0xB1234
    assert (joined.start_frequency_hz, joined.end_frequency_hz) == (10 * 0x95678, 10 * 0xA9ABC)
    assert SideScanHeader(interval_ns=10, lsb_1=0x1180).sample_interval_s == pytest.approx(10.5e-9)
    many = np.zeros(70_000, dtype=np.uint16)
    assert decode_data(read(side(0, many)).body[:-1]) is None
    reported_many = decode_data(read(side(0, many)).body)
    assert reported_many is not None
    assert reported_many.header.n_samples == 70_000


def test_both_sides_are_one_frame_in_metres_and_seconds() -> None:
    (frame,) = frames_of(
        JsfDecoder(), side(0, (16, 32), weighting=4, start_depth_samples=100), side(1, (48, 64), weighting=-1)
    )
    assert frame.port is not None
    assert frame.starboard is not None
    assert frame.transfer == "amplitude"
    assert frame.port.samples.tolist() == [1.0, 2.0]
    assert frame.starboard.samples.tolist() == [96.0, 128.0]
    assert frame.port.spacing_m == pytest.approx(0.5 * 1480.0 * 20e-6)
    assert frame.port.first_range_m == pytest.approx(100 * frame.port.spacing_m)
    assert frame.starboard.first_range_m == 0.0
    assert (frame.number, frame.device_time_is_utc) == (12, True)
    assert frame.device_time_s == pytest.approx(1_700_000_000.456, abs=1e-6)
    assert frame.sound_speed_mps == 1480.0
    assert math.isnan(frame.altitude_m)
    assert frame.navigation is None


@given(values=st.lists(st.tuples(st.integers(-32768, 32767), st.integers(-32768, 32767)), min_size=1, max_size=20))
def test_analytic_samples_become_their_modulus(values: list[tuple[int, int]]) -> None:
    flat = [value for pair in values for value in pair]
    (frame,) = frames_of(JsfDecoder(), side(0, flat, data_format=DataFormat.ANALYTIC, weighting=1))
    assert frame.port is not None
    assert frame.port.samples.tolist() == pytest.approx([0.5 * math.hypot(*pair) for pair in values])


def test_only_what_is_valid_is_reported() -> None:
    reported = {
        "longitude": round(-8.7051 * 600_000),
        "latitude": round(41.1852 * 600_000),
        "heading_cdeg": 27_050,
        "pitch_counts": 910,
        "roll_counts": -1820,
        "depth_mm": 12_500,
        "altitude_mm": 7_250,
        "speed_dkn": 35,
    }
    everything = 0x7FFF
    (frame,) = frames_of(JsfDecoder(), side(0, validity=everything, **reported))
    navigation = frame.navigation
    assert navigation is not None
    assert navigation.time_s == frame.device_time_s
    assert navigation.latitude_deg == pytest.approx(41.1852, abs=1e-6)
    assert navigation.longitude_deg == pytest.approx(-8.7051, abs=1e-6)
    assert math.degrees(navigation.heading_rad) == pytest.approx(270.5)
    assert math.degrees(navigation.pitch_rad) == pytest.approx(4.9988, abs=1e-3)
    assert math.degrees(navigation.roll_rad) == pytest.approx(-9.9976, abs=1e-3)
    assert (navigation.depth_m, navigation.altitude_m, frame.altitude_m) == (12.5, 7.25, 7.25)
    assert navigation.speed_mps == pytest.approx(3.5 * 1852.0 / 3600.0)
    for validity, names in FIELDS_OF.items():
        (frame,) = frames_of(JsfDecoder(), side(0, validity=validity, **reported))
        assert frame.navigation is not None
        values = structs.asdict(frame.navigation)
        assert {name for name, value in values.items() if math.isfinite(value)} == {"time_s", "position_leaps", *names}
        assert math.isnan(frame.altitude_m) == (validity != Validity.ALTITUDE)
    (frame,) = frames_of(JsfDecoder(), side(0, validity=Validity.ALTITUDE, altitude_mm=0))
    assert math.isnan(frame.altitude_m)
    for change in ({"units": PositionUnits.DECIMETRES}, {"latitude": 91 * 600_000}, {"longitude": -181 * 600_000}):
        (frame,) = frames_of(JsfDecoder(), side(0, validity=everything, **reported | change))
        assert frame.navigation is not None
        assert math.isnan(frame.navigation.latitude_deg + frame.navigation.longitude_deg)


@pytest.mark.parametrize(("degrees", "given"), [(-90.0, 270.0), (-0.5, 359.5), (180.0, 180.0), (359.99, 359.99)])
def test_a_heading_of_a_half_turn_to_either_side_is_read(degrees: float, given: float) -> None:
    (frame,) = frames_of(JsfDecoder(), side(0, validity=Validity.HEADING, heading_cdeg=round(100 * degrees) & 0xFFFF))
    assert frame.navigation is not None
    assert math.degrees(frame.navigation.heading_rad) == pytest.approx(given)


def test_a_position_repeated_until_the_next_fix_is_reported_once() -> None:
    """Ten pings a second with a receiver of one fix a second; then the vehicle lies still."""
    decoder = JsfDecoder()
    north = [1000 + 10 * min(ping // 10, 3) for ping in range(80)]
    stream = [
        side(
            0,
            ping_number=ping,
            time_s=1_700_000_000 + ping // 10,
            milliseconds_today=100 * ping,
            validity=Validity.POSITION | Validity.HEADING,
            latitude=north[ping],
        )
        for ping in range(80)
    ]
    reported = [
        frame.number
        for frame in frames_of(decoder, *stream)
        if frame.navigation and math.isfinite(frame.navigation.latitude_deg)
    ]
    assert reported == [0, 10, 20, 30, 43, 56, 69]
    assert decoder.counters["jsf.repeated_position"] == 80 - len(reported)


def test_small_changes_of_sound_speed_keep_the_sample_layout() -> None:
    decoder = JsfDecoder()
    speeds = [1480.0, 1480.3, 1479.8, 1480.6, 1480.4, 0.0]
    frames = frames_of(decoder, *(side(0, ping_number=i, sound_speed_mps=speed) for i, speed in enumerate(speeds)))
    assert [frame.sound_speed_mps for frame in frames] == pytest.approx(
        [1480.0, 1480.0, 1480.0, 1480.6, 1480.6, 1480.6]
    )
    assert decoder.counters["jsf.sound_speed_not_told"] == 1
    (frame,) = frames_of(JsfDecoder(), side(0, validity=0))
    assert frame.sound_speed_mps == 1500.0


def test_a_clock_that_was_never_set_is_no_time() -> None:
    (frame,) = frames_of(JsfDecoder(), side(0, time_s=0))
    assert (frame.device_time_s, frame.device_time_is_utc) == (None, False)


def test_one_frequency_is_used_and_the_others_are_counted() -> None:
    decoder = JsfDecoder(subsystem=20)
    stream = (
        side(0, subsystem=20),
        side(0),
        side(1, subsystem=20),
        side(1),
        side(0, subsystem=40),
        side(2, subsystem=20),
    )
    (frame,) = frames_of(decoder, *stream)
    assert frame.starboard is not None
    not_used = [
        decoder.counters[f"jsf.not_used.{name}"] for name in ("subsystem_20", "subsystem_21", "other_subsystem")
    ]
    assert not_used == [1, 2, 1]


@pytest.mark.parametrize("order", [(20, 21), (21, 20), (21, 22), (20, 22)])
def test_the_highest_frequency_that_is_heard_is_used(order: tuple[int, int]) -> None:
    decoder = JsfDecoder()
    stream = [side(channel, ping_number=n, subsystem=s) for n in range(40) for s in order for channel in (0, 1)]
    items = items_of(decoder, *stream)
    notices = [item.text for item in items if isinstance(item, Notice)]
    assert len(notices) == 1
    assert f"{max(order)} is used. Set sonar.subsystem: {min(order)}" in notices[0]
    assert decoder.counters[f"jsf.not_used.subsystem_{min(order)}"] >= 70
    assert sum(isinstance(item, SonarFrame) and item.number >= 5 for item in items) == 35


def test_the_low_frequency_is_used_where_it_is_alone() -> None:
    decoder = JsfDecoder()
    stream = [side(channel, ping_number=n, subsystem=20) for n in range(40) for channel in (0, 1)]
    assert sum(isinstance(item, SonarFrame) for item in items_of(decoder, *stream)) >= 37


def test_a_lower_frequency_is_used_once_the_higher_has_ended() -> None:
    stream = [side(0, ping_number=n, subsystem=21 if n < 1000 else 20) for n in range(1400)]
    numbers = [item.number for item in items_of(JsfDecoder(), *stream) if isinstance(item, SonarFrame)]
    assert {*range(1000), *range(1200, 1400)} <= set(numbers)


def test_a_damaged_header_changes_no_frequency() -> None:
    decoder = JsfDecoder()
    stream = [side(0, ping_number=n, subsystem=22 if n % 50 == 7 else 21) for n in range(600)]
    assert sum(isinstance(item, SonarFrame) for item in items_of(decoder, *stream)) == 588


def test_the_real_part_of_a_signal_counts_by_its_magnitude() -> None:
    (frame,) = frames_of(JsfDecoder(), side(0, (-3, 4, -32768), data_format=DataFormat.REAL))
    assert frame.port is not None
    assert frame.port.samples.tolist() == [3.0, 4.0, 32768.0]


@pytest.mark.parametrize("n_body", [18_000, 200_000, 3_000_000])
@pytest.mark.parametrize("is_file", [False, True])
def test_a_long_message_is_believed_where_another_or_the_end_of_the_file_follows(n_body: int, is_file: bool) -> None:
    random = np.random.Generator(np.random.PCG64(n_body))
    body = random.bytes(n_body // 2) + side(0) + side(1) + random.bytes(n_body - n_body // 2)  # no pings, by chance
    long = to_wire(JsfMessage(3000, body, subsystem=40))
    stream = side(0) + long + side(1) + long
    framer = Framer(JsfGrammar(len(stream) if is_file else None))
    found = framer.feed(stream) + framer.finish()
    kinds = [framed.message.message_type for framed in found]
    if is_file:
        assert kinds == [80, 3000, 80, 3000]
        assert framer.counters["jsf.bytes_skipped"] == 0
    elif n_body < 2**18:
        assert kinds[:3] == [80, 3000, 80]
    else:
        assert set(kinds) == {80}, "nobody waits for 3 MB on a link"


def test_a_size_that_nothing_confirms_hides_no_ping() -> None:
    for n_lost in (1, 400):
        long = to_wire(JsfMessage(3000, bytes(20_000), subsystem=40))[:-n_lost]
        stream = side(0) + long + b"".join(side(n % 2, ping_number=n) for n in range(300))
        framer = Framer(JsfGrammar(len(stream)))
        found = framer.feed(stream) + framer.finish()
        assert sum(framed.message.message_type == 80 for framed in found) == 301


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"data_format": DataFormat.RAW}, "data_format"),
        ({"interval_ns": 0}, "range"),
        ({"interval_ns": 2**32 - 1}, "range"),
        ({"start_depth_samples": 2**32 - 1}, "range"),
        ({"weighting": 3000}, "weighting"),
        ({"weighting": -3000}, "weighting"),
    ],
)
def test_pings_that_cannot_be_are_refused_and_counted(changes: dict[str, Any], reason: str) -> None:
    decoder = JsfDecoder()
    assert items_of(decoder, side(0, **changes)) == []
    assert decoder.counters[f"jsf.refused.{reason}"] == 1


def test_a_number_of_samples_that_the_size_denies_is_refused() -> None:
    wire = bytearray(side(0) + bytes(500))
    wire[16 + 114] += 100
    framer = Framer(JsfGrammar())
    assert framer.feed(bytes(wire)) + framer.finish() == []
    assert framer.counters["jsf.refused.length"] == 1


@pytest.mark.parametrize("n_bytes", [1, 400])
def test_samples_in_a_form_of_the_makers_own_are_whole_messages_of_any_size(n_bytes: int) -> None:
    packed = read(side(0))._replace(body=DATA_HEADER.pack(*header(data_format=256, samples_low=3)) + bytes(n_bytes))
    framer, wire = Framer(JsfGrammar()), to_wire(packed) + side(1)
    assert [framed.message.channel for framed in framer.feed(wire) + framer.finish()] == [0, 1]
    decoder = JsfDecoder()
    assert [frame.port for frame in frames_of(decoder, wire)] == [None]
    assert decoder.counters["jsf.refused.data_format"] == 1


def test_commands_say_what_was_meant() -> None:
    reported = [read(command) for command in commands(SonarSettings(range_m=75.0, gain=40, subsystem=20))]
    assert [(m.message_type, m.command, m.subsystem, int.from_bytes(m.body, "little")) for m in reported] == [
        (PING_RANGE, Command.SET, 20, 75_000),
        (PING_GAIN, Command.SET, 20, 40),
        (PING_ENABLE, Command.SET, 20, 1),
    ]
    kept = [read(command) for command in commands(SonarSettings(range_m=75.0, enabled=False))]
    assert [(m.message_type, m.subsystem, m.body[0]) for m in kept] == [(PING_RANGE, 21, 0xF8), (PING_ENABLE, 21, 0)]
    for settings in (SonarSettings(range_m=2000.0), SonarSettings(range_m=50.0, gain=101)):
        with pytest.raises(UsageError, match=r"jsf: .* Give "):
            commands(settings)


def test_the_reply_to_a_request_for_the_clock_gives_its_time() -> None:
    (reply,) = replies_of(JsfDecoder(), time_reply(1_700_000_000.25))
    assert (reply.request, reply.accepted, reply.utc_s) == (SYSTEM_TIME, True, 1_700_000_000.25)
    for body in (b"", struct.pack("<II", 1, 1000)):
        (reply,) = replies_of(JsfDecoder(), to_wire(JsfMessage(SYSTEM_TIME, body, Command.REPLY)))
        assert reply.utc_s is None


def test_refused_commands_are_reported_and_other_messages_counted() -> None:
    decoder = JsfDecoder()
    (reply,) = replies_of(
        decoder, to_wire(JsfMessage(PING_RANGE, bytes(4), Command.ERROR)) + to_wire(JsfMessage(2020, bytes(44)))
    )
    assert (reply.request, reply.accepted, reply.utc_s) == (PING_RANGE, False, None)
    assert decoder.counters["jsf.other_messages"] == 1
