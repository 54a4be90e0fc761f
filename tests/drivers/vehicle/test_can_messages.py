"""Messages on the vehicle's CAN bus: what is written is read back, the DBC file says the same, and nobody takes them
for NMEA 2000."""

from __future__ import annotations

import math
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from auv_mcm.settings.vehicle_settings import CanSettings
from drivers.links.can_frame import CanFrame
from drivers.navigation import n2k_messages as n2k
from drivers.navigation.n2k_bus import N2kBus
from drivers.vehicle import can_messages as can
from drivers.vehicle.can_dbc import dbc_text
from drivers.vehicle.can_receiver import CanReceiver
from drivers.vehicle.can_translation import (
    command_message,
    command_of,
    report_from_can,
    report_message,
    text_message,
    text_of,
)
from drivers.vehicle.dialect import Command, GoTo, Steer, Vertical
from drivers.vehicle.talkers.can_talker import CanTalker
from tests.drivers.vehicle import vehicle_loop
from tests.drivers.vehicle.can_traffic import records

DBC = Path(__file__).parents[3] / "deploy" / "auv_mcm.dbc"
ADDRESS = {"payload": CanSettings().payload_address, "vehicle": CanSettings().vehicle_address}
REPORT = msgspec.structs.replace(
    vehicle_loop.REPORT,
    session=0x1_1234_5678,
    latitude_deg=54.1234567,
    longitude_deg=-10.7654321,
    belief={"truncated_cone": 0.75, "clutter": 0.125, "unknown": 0.125},
    width_m=NAN,
    width_sigma_m=NAN,
)


def sent(record: can.Record, sequence: int = 0) -> list[CanFrame]:
    return can.encode(record, ADDRESS[can.BY_RECORD[type(record)].sender], sequence)


def crc_bitwise(data: bytes, n_bits: int, polynomial: int, start: int, reflected: bool, final: int) -> int:
    crc, top, mask = start, 1 << n_bits - 1, (1 << n_bits) - 1
    for byte in data:
        for bit in range(8) if reflected else range(7, -1, -1):
            out = bool(crc & top) ^ bool(byte >> bit & 1)
            crc = crc << 1 & mask ^ polynomial * out
    return (int(f"{crc:0{n_bits}b}"[::-1], 2) if reflected else crc) ^ final


@cache
def database() -> Any:
    cantools = pytest.importorskip("cantools", reason="cantools, which reads DBC files, is not installed")
    return cantools.database.load_file(DBC)


@given(records(), st.integers(0, 255))
def test_what_is_written_is_read_back(record: can.Record, sequence: int) -> None:
    message = can.BY_RECORD[type(record)]
    receiver = CanReceiver("can", message.sender, ADDRESS[message.sender], Counter())
    frames = sent(record, sequence)
    assert len(frames) == len(message.parts)
    assert all(frame.extended and len(frame.data) == can.FRAME_BYTES for frame in frames)
    *before, received = [receiver.add(frame, 0.0) for frame in frames]
    assert before == [None] * (len(frames) - 1)
    assert received is not None
    assert type(received.record) is type(record)
    assert str(received.record) == str(record), "NaN and all"
    assert sent(received.record, sequence) == frames


@given(records(), st.integers(0, 255))
def test_the_dbc_file_writes_and_reads_every_bit_as_we_do(record: can.Record, sequence: int) -> None:
    message = can.BY_RECORD[type(record)]
    theirs = database().get_message_by_name(message.name)
    values = dict(zip(record._fields, record, strict=True))
    for frame in sent(record, sequence):
        assert theirs.frame_id == frame.can_id
        raw = theirs.decode(frame.data, decode_choices=False, scaling=False)
        assert theirs.encode(raw, scaling=False, padding=True, strict=False) == frame.data
        reported = theirs.decode(frame.data, decode_choices=False)
        assert theirs.encode(reported, padding=True, strict=False) == frame.data, "as quantities, too"
        for placed in message.placed:
            name = placed.signal.name
            if name in reported and not math.isnan(values[name]):
                assert reported[name] == values[name]
                step = placed.signal.scale or 1  # whole numbers of steps: 15710 steps of 1e-4 are not 1.571 in binary
                assert round(placed.signal.low / step) <= raw[name] <= round(placed.signal.high / step)
            elif name in reported:
                assert str(theirs.decode(frame.data)[name]) == "not available"
            reported.pop(name, None)
        assert set(reported) <= {"part", "sequence", "crc"}


def test_the_dbc_file_is_that_of_the_table() -> None:
    assert DBC.read_text(encoding="ascii") == dbc_text(), (
        "make it anew: python -m drivers.vehicle.can_dbc > deploy/auv_mcm.dbc"
    )


def test_the_dbc_file_describes_every_signal() -> None:
    for message in database().messages:
        assert message.comment
        assert message.is_extended_frame
        for signal in message.signals:
            assert signal.byte_order == "little_endian"
            assert signal.comment
            assert signal.minimum is not None
            assert signal.maximum is not None
            if signal.is_float or signal.scale != 1:
                assert "not available" in map(str, signal.choices.values())
                assert signal.unit or signal.maximum == 1, "shares have none"


def test_signals_neither_overlap_nor_stand_out() -> None:
    for message in can.MESSAGES:
        tail = can.CRC32_BYTES if message.is_transfer else can.CRC16_BYTES
        for part in range(len(message.parts)):
            is_last = part == len(message.parts) - 1
            end = can.HEAD_BYTES if message.is_transfer else 0
            for placed in (placed for placed in message.placed if placed.part == part):
                assert placed.first_byte == end
                end += placed.signal.n_bytes
                low, high = placed.signal.low, placed.signal.high
                assert (
                    placed.signal.scale is None
                    or max(abs(low), abs(high)) / placed.signal.scale < placed.signal.unavailable
                )
            assert end <= can.FRAME_BYTES - tail * is_last
    assert len({message.number for message in can.MESSAGES}) == len(can.MESSAGES)


def test_fields_stand_in_the_order_of_the_signals() -> None:
    for message in can.MESSAGES:
        record = message.make(*[0] * len(list(message.placed)))
        assert list(record._fields) == [placed.signal.name for placed in message.placed]


@given(records())
def test_checksums_are_the_published_ones(record: can.Record) -> None:
    message = can.BY_RECORD[type(record)]
    frames = sent(record)
    head = bytes((message.number, ADDRESS[message.sender]))
    if message.is_transfer:
        joined = head + b"".join(frame.data[2:] for frame in frames)
        crc = crc_bitwise(joined[:-4], 32, 0x04C11DB7, 0xFFFFFFFF, True, 0xFFFFFFFF)
        assert joined[-4:] == crc.to_bytes(4, "little")
    else:
        data = head + frames[0].data
        assert data[-2:] == crc_bitwise(data[:-2], 16, 0x1021, 0xFFFF, False, 0).to_bytes(2, "little")


def test_checksums_of_the_catalogue() -> None:
    assert crc_bitwise(b"123456789", 16, 0x1021, 0xFFFF, False, 0) == 0x29B1
    assert crc_bitwise(b"123456789", 32, 0x04C11DB7, 0xFFFFFFFF, True, 0xFFFFFFFF) == 0xCBF43926


def test_frames_are_as_written_down() -> None:
    status = sent(can.PayloadStatus(health=1, authority=3, demand=1, request_number=7, counter=0x2A))
    assert [(hex(frame.can_id), frame.data.hex()) for frame in status] == [("0xbff0160", "010301072aff7c6a")]
    go_to = sent(command_message(GoTo(48.1, 11.5, Vertical("altitude", 5.0), 1.5, 3.0), 3.0, 9, 7), 0x51)
    assert {hex(frame.can_id) for frame in go_to} == {"0xfff0260"}
    assert [frame.data.hex() for frame in go_to] == [
        "0051407aab1c9600",
        "0151c0c2da062c01",
        "025188130000011e",
        "035109079e4a9424",
    ]


@given(records())
def test_nobody_takes_a_frame_for_nmea_2000(record: can.Record) -> None:
    bus = N2kBus("can")
    for frame in sent(record):
        assert frame.can_id >> 24 & 3 == 3, "both page bits, as no NMEA 2000 unit sets them"
        assert n2k.identifier_of(frame.can_id).pgn > 0x1FFFF
        assert bus.feed(frame.can_id, frame.data, Stamp(0, 0)) == []
    assert set(bus.counters) == {"n2k.ignored"}


@given(st.integers(0, 7), st.integers(0, 0x1FFFF), st.integers(0, 255))
def test_no_frame_of_nmea_2000_is_taken_for_one_of_these(priority: int, pgn: int, source: int) -> None:
    assert can.number_and_address(priority << 26 | pgn << 8 | source) is None


@given(records())
def test_values_out_of_range_are_refused(record: can.Record) -> None:
    message = can.BY_RECORD[type(record)]
    for name, placed in zip(record._fields, message.placed, strict=True):
        for value in (math.inf, placed.signal.high * 1.01 + 1.0, placed.signal.low - 1.0):
            with pytest.raises(ValueError, match=name):
                sent(message.make(**record._asdict() | {name: value}))


def test_a_report_is_read_back() -> None:
    message = report_message(REPORT, 300)
    receiver = CanReceiver("can", "payload", 96, Counter())
    again = next(whole for frame in sent(message, 9) if (whole := receiver.add(frame, 0.0))).record
    assert isinstance(again, can.ReportMessage)
    assert again.ticket == 300
    report = report_from_can(again)
    assert report.session == 0x1234_5678, "the lower 32 bits"
    assert report.belief == pytest.approx(REPORT.belief)
    for name in REPORT.__struct_fields__:
        if name not in ("session", "belief"):
            reported, meant = getattr(report, name), getattr(REPORT, name)
            assert reported == meant or reported == pytest.approx(meant, abs=1e-6, rel=0.0, nan_ok=True)


def test_sizes_and_errors_too_large_are_reported_as_the_largest() -> None:
    message = report_message(
        msgspec.structs.replace(REPORT, sigma_m=2000.0, length_m=math.inf, depth_m=-0.2, n_views=900), 1
    )
    sent(message)
    assert (message.sigma_m, message.length_m, message.depth_m, message.n_views) == (655.0, 65.53, 0.0, 255)
    assert math.isnan(message.width_m)


commands = st.builds(
    GoTo,
    st.floats(-90.0, 90.0),
    st.floats(-180.0, 180.0),
    st.builds(Vertical, st.sampled_from(can.REFERENCES), st.floats(0.0, 6000.0)),
    st.floats(0.0, 10.0),
    st.floats(0.0, 100.0),
) | st.builds(
    Steer,
    st.floats(-10.0, 10.0),
    st.builds(Vertical, st.sampled_from(can.REFERENCES), st.floats(0.0, 6000.0)),
    st.floats(0.0, 10.0),
)


@given(commands)
def test_commands_are_read_back_within_a_step_and_never_deeper_or_faster(command: Command) -> None:
    frames = sent(command_message(command, 3.0, 1, 1))
    receiver = CanReceiver("can", "payload", ADDRESS["payload"], Counter())
    message = next(whole for frame in frames if (whole := receiver.add(frame, 0.0))).record
    assert isinstance(message, can.GoToMessage | can.SteerMessage)
    again = command_of(message)
    assert again.vertical.reference == command.vertical.reference
    rise_m = (again.vertical.value_m - command.vertical.value_m) * (
        1.0 if command.vertical.reference == "altitude" else -1.0
    )
    assert -1e-8 <= rise_m <= 1.001e-3
    assert -1e-9 <= command.speed_mps - again.speed_mps <= 0.010001
    if isinstance(command, GoTo) and isinstance(again, GoTo):
        assert abs(again.latitude_deg - command.latitude_deg) <= 0.501e-7
        assert abs(again.longitude_deg - command.longitude_deg) <= 0.501e-7
        assert abs(again.radius_m - command.radius_m) <= 0.005001
    elif isinstance(command, Steer) and isinstance(again, Steer):
        assert 0.0 <= again.heading_rad < 2.0 * math.pi
        assert abs(math.remainder(again.heading_rad - command.heading_rad, 2.0 * math.pi)) <= 0.501e-4
    else:
        raise AssertionError("one kind became the other")


def test_a_course_that_rounds_to_a_full_turn_is_read_back_as_the_north_that_a_vehicle_takes_it_for() -> None:
    frames = sent(command_message(Steer(math.tau - 1e-6, Vertical("depth", 5.0), 1.5), 3.0, 1, 1))
    read = CanTalker(CanSettings()).commands_in(frames)
    assert {round(command.heading_rad or 0.0, 4) for command in read if command is not None} == {0.0}


@given(commands, st.integers(0, 8))
def test_a_command_that_leaves_something_open_is_none(command: Command, place: int) -> None:
    whole = command_message(command, 3.0, 1, 1)
    message = can.BY_RECORD[type(whole)]
    fields = [placed.signal.name for placed in message.placed if placed.signal.scale is not None]
    without = message.make(**whole._asdict() | {fields[place % len(fields)]: NAN})
    assert isinstance(without, can.GoToMessage | can.SteerMessage)
    with pytest.raises(ValueError, match="all fields"):
        command_of(without)


@given(st.text(alphabet=st.characters(exclude_characters="\0", exclude_categories=["Cs"])))
def test_a_text_is_reported_as_far_as_it_fits(text: str) -> None:
    reported = text_of(text_message(text))
    assert text.startswith(reported)
    assert reported == text or 40 < len(reported.encode()) <= 44
