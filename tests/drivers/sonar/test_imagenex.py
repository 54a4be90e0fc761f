"""SportScan's switch command and return, byte by byte."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from auv_mcm.errors import UsageError
from drivers.sonar.imagenex import (
    BOTH,
    PORT,
    STARBOARD,
    IgxReturn,
    SportScanDecoder,
    SwitchCommand,
    commands,
    decode_command,
    encode_command,
    encode_return,
)
from drivers.sonar.sonar_decoder import SonarSettings
from tests.drivers.sonar.sonar_frames import NOW, frames_of

ECHO = (np.arange(400) % 128).astype(np.uint8)


def test_the_return_stands_as_the_description_has_it() -> None:
    wire = encode_return(IgxReturn(30, BOTH, ECHO))
    assert len(wire) == 413
    assert wire[:12] == bytes((0x49, 0x47, 0x58, 0x10, 0x40, 0, 3, 30, 0, 0, 0x1C, 0x03))
    # n = ((b11 & 0x7E) >> 1) << 8 | (b11 & 1) << 7 | b10 & 0x7F, and n - 12 echo bytes
    assert ((wire[11] & 0x7E) >> 1) << 8 | ((wire[11] & 1) << 7 | wire[10] & 0x7F) == 412
    assert wire[12:412] == ECHO.tobytes()
    assert wire[412] == 0xFC


def test_both_sides_come_in_turn_starboard_first() -> None:
    decoder = SportScanDecoder()
    first, second = frames_of(decoder, encode_return(IgxReturn(30, BOTH, ECHO)) * 2)
    assert (first.number, second.number) == (0, 1)
    assert first.starboard is not None
    assert first.port is not None
    assert first.starboard.samples.tolist() == ECHO[0::2].tolist()
    assert first.port.samples.tolist() == ECHO[1::2].tolist()
    assert (first.port.spacing_m, first.port.first_range_m) == (0.15, 0.075)
    assert (first.transfer, first.device_time_s, first.received, first.n_bytes) == (None, None, NOW, 826)
    assert decoder.counters == {"sportscan.messages": 2}


@pytest.mark.parametrize("channel", [PORT, STARBOARD])
def test_one_side_has_all_the_samples(channel: int) -> None:
    (frame,) = frames_of(SportScanDecoder(), encode_return(IgxReturn(60, channel, ECHO)))
    there, absent = (frame.port, frame.starboard) if channel == PORT else (frame.starboard, frame.port)
    assert absent is None
    assert there is not None
    assert there.samples.tolist() == ECHO.tolist()
    assert there.spacing_m == 0.15


@pytest.mark.parametrize(
    ("index", "value", "reason"),
    [
        (3, 0x11, "header"),
        (5, 2, "header"),
        (6, 0, "header"),
        (7, 31, "header"),
        (10, 5, "length"),
        (100, 0x80, "echo"),
        (412, 0, "terminator"),
    ],
)
def test_returns_that_cannot_be_are_refused_and_counted(index: int, value: int, reason: str) -> None:
    wire = bytearray(encode_return(IgxReturn(30, BOTH, ECHO)))
    wire[index] = value
    decoder = SportScanDecoder()
    assert frames_of(decoder, bytes(wire)) == []
    assert decoder.counters[f"sportscan.refused.{reason}"] == 1
    assert decoder.counters["sportscan.bytes_skipped"] == 413


def test_a_count_without_the_header_is_believed_too() -> None:
    wire = bytearray(encode_return(IgxReturn(30, BOTH, ECHO, status=0xC0)))
    wire[10:12] = 400 & 0x7F, 400 >> 7
    decoder = SportScanDecoder()
    assert len(frames_of(decoder, bytes(wire))) == 1
    assert decoder.counters["sportscan.command_overrun"] == 1


def test_the_command_stands_as_the_description_has_it() -> None:
    command = SwitchCommand(60, gain_db=15, absorption=21, pulse_us=80, data_points=50, frequency=1)
    wire = encode_command(command)
    assert (len(wire), wire[0], wire[1], wire[26]) == (27, 0xFE, 0x44, 0xFD)
    assert (wire[3], wire[8], wire[10], wire[14], wire[19], wire[25]) == (60, 15, 21, 80, 50, 1)
    assert decode_command(wire) == command
    for damaged in (wire[:-1], b"\xff" + wire[1:], wire[:5] + b"\xfd" + wire[6:], wire[:-1] + b"\0"):
        assert decode_command(damaged) is None


def test_no_value_may_end_the_command() -> None:
    with pytest.raises(UsageError, match="ends the command"):
        encode_command(SwitchCommand(60, pulse_us=0xFD))


def test_settings_become_one_command_per_ping() -> None:
    (wire,) = commands(SonarSettings(range_m=60.0, gain=12))
    reported = decode_command(wire)
    assert reported is not None
    assert (reported.range_m, reported.gain_db) == (60, 12)
    assert commands(SonarSettings(range_m=60.0, enabled=False)) == ()


@pytest.mark.parametrize("changes", [{"range_m": 50.0}, {"range_m": 60.0, "gain": 41}, {"range_m": 240.0}])
def test_settings_the_head_cannot_have_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=r"sportscan: .* Give "):
        commands(SonarSettings(**changes))
