"""Check the Ping Protocol against the reference library and published bytes, and the scale of the frames' samples."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.errors import UsageError
from auv_mcm.records import Transfer
from auv_mcm.settings.config import SonarConfig
from auv_mcm.waterfall.transfer import to_intensity
from drivers.framing import Framer
from drivers.sonar.ping_messages import (
    Ack,
    AsciiText,
    DeviceInformation,
    GeneralRequest,
    JsonWrapper,
    Nack,
    OsMonoProfile,
    OsPingParams,
    Payload,
    PingMessage,
    ProtocolVersion,
    SetSpeedOfSound,
    decode,
    encode,
    linear_power,
    to_wire,
)
from drivers.sonar.ping_protocol import PingDecoder, PingGrammar, commands
from drivers.sonar.sonar_decoder import SonarSettings
from tests.drivers.sonar.sonar_frames import NOW, frames_of, items_of, profile, replies_of

# Made with brping 0.2.5.
REQUEST = bytes.fromhex("42520200060000000500a100")
PROFILE = bytes.fromhex(
    "42523c0096080000070000000000000050c3000040e20100d0dd060003000400e439010017b7d13800004841000020c10000b4c20000b4420000344200005555aaaaffffa210"
)

PAYLOADS: list[Payload] = [
    Ack(2197),
    Nack(2197, "no such gain"),
    AsciiText("hello"),
    DeviceInformation(9, 1, 2, 3, 4),
    ProtocolVersion(1, 0, 0),
    GeneralRequest(2197),
    JsonWrapper({"recording": [1, 2.5, "x"]}),
    SetSpeedOfSound(1_482_000),
    OsPingParams(100, 50_000, 67, gain_index=-1, num_results=1200),
]


def read(wire: bytes) -> PingMessage:
    (framed,) = Framer(PingGrammar()).feed(wire)
    return framed.message


def test_published_request_both_ways() -> None:
    assert encode(GeneralRequest(5)) == REQUEST
    assert decode(read(REQUEST)) == GeneralRequest(5)


def test_published_profile_both_ways() -> None:
    assert encode(profile(channel_number=1, transducer_heading_deg=90.0)) == PROFILE
    reported = decode(read(PROFILE))
    assert isinstance(reported, OsMonoProfile)
    assert reported[:8] == (7, 0, 50_000, 123_456, 450_000, 3, 14_820, 1)
    assert reported[8:14] == pytest.approx((1e-4, 12.5, -10.0, -90.0, 90.0, 45.0))
    assert reported.pwr_results.tolist() == [0, 21845, 43690, 65535]


@pytest.mark.parametrize("payload", PAYLOADS, ids=lambda payload: type(payload).__name__)
def test_what_is_encoded_is_decoded_again(payload: Payload) -> None:
    reported = decode(read(encode(payload, source=3, destination=4)))
    assert type(reported) is type(payload)
    assert tuple(reported or ()) == tuple(
        pytest.approx(value) if isinstance(value, float) else value for value in payload
    )
    assert read(encode(payload, source=3, destination=4))[2:] == (3, 4)


def test_both_numbers_of_the_sound_speed_command_are_known() -> None:
    content = (1_500_000).to_bytes(4, "little")
    for message_id in (116, 1002):
        assert decode(read(to_wire(PingMessage(message_id, content)))) == SetSpeedOfSound(1_500_000)


def test_payloads_of_a_wrong_length_are_not_guessed_at() -> None:
    for message_id in (1, 4, 5, 6, 116, 2197, 2198):
        assert decode(PingMessage(message_id, b"\1")) is None
        assert Framer(PingGrammar()).feed(to_wire(PingMessage(message_id, b"\1"))) == []
    lying = bytearray(profile_payload(4))
    lying[22] = 5
    assert decode(PingMessage(2198, bytes(lying))) is None
    assert decode(PingMessage(4000, b"")) is None
    assert decode(PingMessage(10, b"{")) == JsonWrapper(None)


def profile_payload(n_results: int) -> bytes:
    return encode(profile(pwr_results=np.zeros(n_results, dtype=np.uint16)))[8:-2]


@given(
    results=st.lists(st.integers(0, 65535), min_size=1, max_size=50),
    numbers=st.lists(st.integers(0, 2**32 - 1), min_size=5, max_size=5),
    small=st.lists(st.integers(0, 65535), min_size=2, max_size=2),
    reals=st.lists(st.floats(width=32, allow_nan=False), min_size=6, max_size=6),
)
def test_profiles_agree_with_the_reference_library(
    results: list[int], numbers: list[int], small: list[int], reals: list[float]
) -> None:
    brping = pytest.importorskip(
        "brping", reason="bluerobotics-ping, the reference for the wire format, is not installed"
    )
    ours = OsMonoProfile._make((*numbers, small[0], small[1], 1, *reals, np.array(results, dtype=np.uint16), 0))
    wire = encode(ours)
    parser = brping.PingParser()
    assert [parser.parse_byte(byte) for byte in wire][-1] == brping.PingParser.NEW_MESSAGE
    theirs: Any = parser.rx_msg
    assert np.frombuffer(theirs.pwr_results, "<u2").tolist() == results
    names = (
        "ping_number",
        "start_mm",
        "length_mm",
        "timestamp_ms",
        "ping_hz",
        "gain_index",
        "sos_dmps",
        "channel_number",
    )
    assert tuple(getattr(theirs, name) for name in names) == ours[:8]
    real_names = (
        "pulse_duration_sec",
        "analog_gain",
        "max_pwr_db",
        "min_pwr_db",
        "transducer_heading_deg",
        "vehicle_heading_deg",
    )
    assert tuple(getattr(theirs, name) for name in real_names) == ours[8:14]
    assert bytes(theirs.pack_msg_data()) == wire
    reported = decode(read(wire))
    assert isinstance(reported, OsMonoProfile)
    assert reported[:14] == ours[:14]


@pytest.mark.parametrize("payload", PAYLOADS, ids=lambda payload: type(payload).__name__)
def test_other_messages_agree_with_the_reference_library(payload: Payload) -> None:
    brping = pytest.importorskip(
        "brping", reason="bluerobotics-ping, the reference for the wire format, is not installed"
    )
    parser = brping.PingParser()
    assert [parser.parse_byte(byte) for byte in encode(payload)][-1] == brping.PingParser.NEW_MESSAGE
    if not isinstance(payload, Nack | AsciiText | JsonWrapper):
        theirs = [getattr(parser.rx_msg, name) for name in parser.rx_msg.payload_field_names]
        assert theirs == [pytest.approx(value) for value in payload]


@given(
    results=st.lists(st.integers(0, 65535), min_size=1, max_size=30),
    low=st.floats(-150.0, 50.0, width=32),
    span=st.floats(1.0, 120.0, width=32),
)
def test_power_is_linear_in_what_the_decibels_mean(results: list[int], low: float, span: float) -> None:
    power = linear_power(profile(pwr_results=np.array(results, dtype=np.uint16), min_pwr_db=low, max_pwr_db=low + span))
    decibels = [low + result / 65535.0 * span for result in results]
    assert power.dtype == np.float32
    assert [10.0 * math.log10(value) for value in power.tolist()] == pytest.approx(decibels, abs=5e-5)


def test_samples_need_no_guess_of_what_they_are() -> None:
    """The frame's transfer is one a configuration takes, and undoes to the decibels of the message, whatever scale each
    message has."""
    results = np.array([0, 1000, 65535], dtype=np.uint16)
    for low, high in ((-90.0, -10.0), (-40.0, 20.0)):
        (frame,) = frames_of(PingDecoder(), encode(profile(pwr_results=results, min_pwr_db=low, max_pwr_db=high)))
        assert frame.transfer is not None
        assert SonarConfig(transfer=frame.transfer).db_per_count is None
        assert frame.port is not None
        intensity, valid = to_intensity(frame.port.samples, Transfer(frame.transfer))
        assert valid.all()
        assert 10.0 * np.log10(intensity) == pytest.approx(low + results / 65535.0 * (high - low), abs=1e-4)


def test_both_sides_of_a_ping_are_one_frame() -> None:
    port = encode(profile(start_mm=2000))
    starboard = encode(profile(channel_number=1, pwr_results=np.full(5, 9, dtype=np.uint16)))
    (frame,) = frames_of(PingDecoder(), port + starboard + b"..")
    assert frame.port is not None
    assert frame.starboard is not None
    assert (frame.number, frame.device_time_is_utc) == (7, False)
    assert frame.device_time_s == pytest.approx(123.456)
    assert (frame.port.first_range_m, frame.port.spacing_m) == (8.25, 12.5)
    assert (frame.starboard.first_range_m, frame.starboard.spacing_m) == (5.0, 10.0)
    assert frame.sound_speed_mps == pytest.approx(1482.0)
    assert math.isnan(frame.altitude_m)
    assert frame.received == NOW
    assert frame.n_bytes == len(port) + len(starboard) + 2


def test_the_profile_that_was_held_at_the_end_comes_out() -> None:
    (frame,) = frames_of(PingDecoder(), encode(profile(channel_number=1)))
    assert frame.port is None


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"channel_number": 4}, "channel"),
        ({"length_mm": 0}, "range"),
        ({"length_mm": 2**32 - 1}, "range"),
        ({"start_mm": 1_990_000}, "range"),
        ({"pwr_results": np.zeros(0, dtype=np.uint16)}, "range"),
        ({"sound_speed_dmps": 12_990}, "sound_speed"),
        ({"sound_speed_dmps": 17_010}, "sound_speed"),
        ({"max_pwr_db": math.nan}, "power_scale"),
        ({"max_pwr_db": -90.0}, "power_scale"),
        ({"min_pwr_db": -1e30}, "power_scale"),
        ({"max_pwr_db": 1e30}, "power_scale"),
    ],
)
def test_profiles_that_cannot_be_are_refused_and_counted(changes: dict[str, Any], reason: str) -> None:
    decoder = PingDecoder()
    assert items_of(decoder, encode(profile(**changes))) == []
    assert decoder.counters == {"ping_protocol.messages": 1, f"ping_protocol.refused.{reason}": 1}


def test_answers_become_replies_and_the_rest_is_counted() -> None:
    decoder = PingDecoder()
    ack, nack, device, version = replies_of(decoder, b"".join(map(encode, PAYLOADS)))
    assert (ack.request, ack.accepted) == (2197, True)
    assert (nack.request, nack.accepted, nack.text) == (2197, False, "no such gain")
    assert device.text == "device type 9 revision 1, firmware 2.3.4"
    assert version.text == "protocol 1.0.0"
    assert decoder.counters["ping_protocol.other_messages"] == len(PAYLOADS) - 4


def test_settings_arrive_as_they_were_meant() -> None:
    settings = SonarSettings(range_m=40.0, gain=5, n_samples=1200, sound_speed_mps=1482.5, enabled=False)
    sound_speed, parameters = (decode(read(command)) for command in commands(settings))
    assert sound_speed == SetSpeedOfSound(1_482_500)
    assert isinstance(parameters, OsPingParams)
    assert parameters[:3] == (0, 40_000, 0)
    assert (parameters.gain_index, parameters.num_results, parameters.enable) == (5, 1200, 0)
    automatic = decode(read(commands(SonarSettings(range_m=40.0))[1]))
    assert isinstance(automatic, OsPingParams)
    assert (automatic.gain_index, automatic.enable) == (-1, 1)


@pytest.mark.parametrize(
    "settings",
    [
        SonarSettings(range_m=0.0),
        SonarSettings(range_m=math.nan),
        SonarSettings(range_m=1e6),
        SonarSettings(range_m=40.0, gain=8),
        SonarSettings(range_m=40.0, gain=-1),
        SonarSettings(range_m=40.0, n_samples=199),
        SonarSettings(range_m=40.0, n_samples=1201),
        SonarSettings(range_m=40.0, sound_speed_mps=1399.0),
        SonarSettings(range_m=40.0, sound_speed_mps=math.inf),
    ],
)
def test_settings_the_device_cannot_have_are_refused(settings: SonarSettings) -> None:
    with pytest.raises(UsageError, match=r"ping_protocol: .* Give "):
        commands(settings)
