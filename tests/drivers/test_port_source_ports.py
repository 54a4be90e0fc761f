"""Check the bytes of several ports as one stream of events: by their stamps alone, in time, and with failing
decoders."""

from __future__ import annotations

import re
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clean_text import is_clean
from auv_mcm.errors import UsageError
from auv_mcm.records import EchoTrace, NavSample, Notice, Ping, SourceEvent
from auv_mcm.settings.config import config_yaml, parse_config
from auv_mcm.settings.port_settings import SONAR_NAMES, NavUnitName
from drivers.heads import HeadPairer
from drivers.links.can_frame import CanFrame
from drivers.navigation.n2k_messages import Heading, Identifier, can_id_of, encode
from drivers.navigation.nav_protocols import CAN_PROTOCOL, TEXT_PROTOCOLS
from drivers.port_intake import NO_PORT, PortIntake
from drivers.port_stream import pack_can, unpack_can
from drivers.ports import open_to_all, read_ports, without_sonar
from drivers.sonar.imagenex import commands as sportscan_commands
from drivers.sonar.jsf_messages import PING_RANGE, Command, JsfMessage, to_wire
from drivers.sonar.ping_messages import Nack
from drivers.sonar.ping_messages import encode as encode_ping
from drivers.sonar.ping_protocol import PingDecoder
from drivers.sonar.sonar_decoder import SonarSettings
from drivers.sonar.sonars import SONARS
from sim_replay.fakes.uart import misread
from tests.drivers.port_traffic import (
    INTERVAL_S,
    PORTS,
    Chunk,
    config_of,
    fix,
    is_close,
    profile,
    stamp,
    time_of,
    traffic,
)

HEADS = """
ports:
  - {name: left, link: "tcp://10.0.0.2:1", device: ping_protocol, sonar: {sides: port}}
  - {name: right, link: "tcp://10.0.0.3:1", device: ping_protocol, sonar: {sides: starboard}}
"""


def taken_in(text: str, chunks: list[Chunk]) -> tuple[list[SourceEvent], PortIntake]:
    intake = PortIntake(config_of(text))
    return [event for chunk in chunks for event in intake.feed(*chunk)] + intake.finish(), intake


def pings_of(events: list[SourceEvent]) -> list[Ping]:
    return [event for event in events if isinstance(event, Ping)]


def test_pings_have_the_times_of_their_transmission_and_both_sides() -> None:
    pings = pings_of(taken_in(PORTS, list(traffic(100)))[0])
    assert [ping.number for ping in pings] == list(range(100))
    # The sonar counts milliseconds; its minimum delay is not known.
    assert all(is_close(ping.time_s, time_of(ping.number), 2e-3) for ping in pings[20:])
    assert all(ping.port is not None and ping.starboard is not None for ping in pings)
    assert {ping.transfer for ping in pings} == {"intensity"}


def test_navigation_comes_out_in_order_at_the_times_of_arrival() -> None:
    samples = [event for event in taken_in(PORTS, list(traffic(50)))[0] if isinstance(event, NavSample)]
    times_s = [sample.time_s for sample in samples]
    assert times_s == sorted(times_s)
    positions = [sample for sample in samples if sample.latitude_deg == sample.latitude_deg]
    assert len(positions) == 50
    assert all(is_close(sample.time_s, time_of(0) + k * INTERVAL_S, 0.02) for k, sample in enumerate(positions))


def test_everything_is_counted_by_port() -> None:
    chunks = list(traffic(10))
    broken = chunks[4]._replace(data=chunks[4].data[:-1] + b"\xff")
    _, intake = taken_in(PORTS, [*chunks[:4], broken, *chunks[5:], Chunk("sonor", b"x", chunks[-1].stamp)])
    counters = intake.counters
    assert counters["port.sonar.ping_protocol.refused.checksum"] == 1
    assert counters["port.sonar.ping_protocol.messages"] == 19
    assert counters["port.gnss.nmea.messages"] == 30
    assert counters["intake.unknown_port"] == 1


def test_a_decoder_that_fails_is_reported_counted_and_survived(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(self: PingDecoder, data: bytes, stamp: Any) -> Any:
        if b"BR" in data and int.from_bytes(data[8:12], "little") in (3, 5):
            raise IndexError("a defect")
        return decode(self, data, stamp)

    decode = PingDecoder.feed
    monkeypatch.setattr(PingDecoder, "feed", failing)
    events, intake = taken_in(PORTS, list(traffic(10)))
    assert [ping.number for ping in pings_of(events)] == [0, 1, 2, 4, 6, 7, 8, 9]
    assert intake.counters["port.sonar.decoder.failed"] == 4
    assert intake.counters["port.sonar.ping_protocol.messages"] == 16
    (notice,) = [event for event in events if isinstance(event, Notice)]
    assert notice.code == "decoder_failed"
    assert "port 'sonar' failed (IndexError('a defect')) and was started anew" in notice.text


def reported_codes(events: list[SourceEvent], place: str) -> list[str]:
    return [event.code for event in events if isinstance(event, Notice) and event.place == place]


def test_a_wrong_rate_is_reported_once_and_its_end_too() -> None:
    """The device sends at 38400 baud what is read at 115200, and is put right after five seconds."""
    chunks = [
        chunk._replace(
            data=misread(chunk.data, 38_400, 115_200) if chunk.stamp.mono_ns < stamp(5.0).mono_ns else chunk.data
        )
        for chunk in traffic(100)
        if chunk.port == "gnss"
    ]
    events, intake = taken_in(PORTS, chunks)
    assert reported_codes(events, "gnss") == ["port_unreadable", "port_readable"]
    (text,) = [event.text for event in events if isinstance(event, Notice) and event.code == "port_unreadable"]
    assert re.search(
        r"\d+ bytes in 2\.\d s held no message of 'nmea0183'.*same rate, here 115200 baud.*serial:///dev/ttyS0", text
    )
    assert intake.counters["port.gnss.nmea.messages"] == 150


@given(st.integers(0, 2**32), st.integers(2, 30))
def test_noise_however_much_is_not_reported_while_a_message_comes_through_now_and_then(seed: int, n_apart: int) -> None:
    noise = np.random.Generator(np.random.PCG64(seed))
    chunks = [
        Chunk("sonar", noise.bytes(5000) + (profile(k, 0, 0.1 * k) if k % n_apart % 18 == 0 else b""), stamp(0.1 * k))
        for k in range(120)
    ]
    assert not reported_codes(taken_in(PORTS, chunks)[0], "sonar")


def test_a_unit_that_says_little_or_seldom_is_readable() -> None:
    seldom = [
        Chunk("gnss", fix(10.0 * k, 43.0, 5.0), stamp(10.0 * k + 0.01 * part)) for k in range(30) for part in range(3)
    ]
    whole = fix(0.0, 43.0, 5.0)
    halves = [
        Chunk("gnss", part, stamp(9.0 * k + s)) for k in range(30) for s, part in ((0.0, whole[:90]), (8.0, whole[90:]))
    ]
    little = [Chunk("gnss", b"x", stamp(1.0 * k)) for k in range(200)]
    for chunks in (seldom, halves, little):
        assert not reported_codes(taken_in(PORTS, chunks)[0], "gnss")


def test_a_port_that_comes_and_goes_is_reported_of_so_often_only() -> None:
    chunks = [
        Chunk("gnss", fix(0.1 * k, 43.0, 5.0) if k // 40 % 2 else bytes(300), stamp(0.1 * k)) for k in range(4000)
    ]
    assert len(reported_codes(taken_in(PORTS, chunks)[0], "gnss")) == 20


def test_what_comes_out_does_not_depend_on_ticks_but_what_is_missed_is_reported_by_them() -> None:
    chunks = list(traffic(30))
    ticked = [item for chunk in chunks for item in (chunk, Chunk(NO_PORT, b"", chunk.stamp))]
    late = [Chunk(NO_PORT, b"", stamp(3.0 + 0.25 * k)) for k in range(20)]
    reported = taken_in(PORTS, chunks)[0]
    assert [str(event) for event in taken_in(PORTS, ticked)[0]] == [str(event) for event in reported]
    missed = [event.code for event in taken_in(PORTS, chunks + late)[0] if isinstance(event, Notice)]
    assert "nav_quantity_lost" in missed
    assert not [event for event in reported if isinstance(event, Notice)]


def test_a_set_clock_of_this_computer_is_reported_and_moves_pings_and_navigation_together() -> None:
    chunks = [
        chunk._replace(stamp=chunk.stamp._replace(utc_ns=chunk.stamp.utc_ns + 3_600_000_000_000 * (k >= 150)))
        for k, chunk in enumerate(traffic(100))
    ]
    events, _ = taken_in(PORTS, chunks)
    assert [event.code for event in events if isinstance(event, Notice)] == ["utc_stepped"]
    last_ping, last_sample = pings_of(events)[-1], [event for event in events if isinstance(event, NavSample)][-1]
    assert is_close(last_ping.time_s, time_of(99) + 3600.0, 5e-3)
    assert is_close(last_sample.time_s, time_of(99) + 3600.0, 5e-3)


@pytest.mark.parametrize(
    ("sides", "n_port", "n_starboard"),
    [("as_told", 3, 2), ("swapped", 2, 3), ("port", 3, None), ("starboard", None, 3)],
)
def test_sides_are_those_of_the_mounting(sides: str, n_port: int | None, n_starboard: int | None) -> None:
    text = f"ports: [{{name: sonar, link: 'tcp://10.0.0.2:1', device: ping_protocol, sonar: {{sides: {sides}}}}}]"
    chunks = [Chunk("sonar", profile(1, 0, 0.0, [1, 2, 3]) + profile(1, 1, 0.0, [1, 2]), stamp(0.05))]
    (ping,) = pings_of(taken_in(text, chunks)[0])
    assert (None if ping.port is None else len(ping.port.samples)) == n_port
    assert (None if ping.starboard is None else len(ping.starboard.samples)) == n_starboard


def test_a_configured_sound_speed_rescales_the_ranges() -> None:
    chunks = list(traffic(3))
    (reported, *_), (slower, *_) = (
        pings_of(taken_in(text, chunks)[0]) for text in (PORTS, PORTS + "sonar: {sound_speed_mps: 1425}\n")
    )
    assert reported.port is not None
    assert slower.port is not None
    assert slower.port.spacing_m == pytest.approx(0.95 * reported.port.spacing_m)
    assert slower.sound_speed_mps == 1425.0


def test_two_heads_on_wires_of_their_own_are_one_sonar() -> None:
    chunks = []
    for number in range(20):
        chunks.append(Chunk("left", profile(number, 0, number * INTERVAL_S), stamp(number * INTERVAL_S + 0.05)))
        chunks.append(
            Chunk("right", profile(number + 7, 0, number * INTERVAL_S + 3.0), stamp(number * INTERVAL_S + 0.055))
        )
    events, intake = taken_in(HEADS, chunks)
    assert [ping.number for ping in pings_of(events)] == list(range(20))
    assert all(ping.port is not None and ping.starboard is not None for ping in pings_of(events))
    assert intake.counters["heads.joined"] == 20


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=40), st.floats(-0.015, 0.015))
def test_whatever_heads_miss_every_side_comes_out_once_and_only_with_its_own(
    heard: list[tuple[bool, bool]], apart_s: float
) -> None:
    trace = EchoTrace(samples=np.ones(100), first_range_m=0.0, spacing_m=0.3)
    pairer = HeadPairer()
    out: list[Ping] = []
    for number, (left, right) in enumerate(heard):
        if left:
            out += pairer.add(Ping(number=number, time_s=0.1 * number, port=trace, starboard=None, place=str(number)))
        if right:
            out += pairer.add(
                Ping(number=number, time_s=0.1 * number + apart_s, port=None, starboard=trace, place=str(number))
            )
    out += pairer.finish()
    assert sorted((ping.number, ping.port is not None, ping.starboard is not None) for ping in out) == [
        (number, left, right) for number, (left, right) in enumerate(heard) if left or right
    ]


@given(st.integers(0, 2**29 - 1), st.binary(max_size=64), st.booleans())
def test_can_frames_survive_packing(can_id: int, data: bytes, extended: bool) -> None:
    assert unpack_can(pack_can(CanFrame(can_id, data, extended))) == CanFrame(can_id, data, extended)


@given(st.binary(max_size=20))
def test_no_bytes_for_a_bus_raise(data: bytes) -> None:
    intake = PortIntake(config_of("ports: [{name: bus, link: 'socketcan://can0', device: nmea2000}]"))
    intake.feed("bus", data, stamp(0.0))
    assert not intake.counters["port.bus.decoder.failed"]


def test_units_on_a_bus_share_the_settings_of_its_port() -> None:
    text = "ports: [{name: bus, link: 'socketcan://can0', device: nmea2000, navigation: {heading_offset_deg: 90}}]"
    pgn, data = encode(Heading(0, 0.5, 0.0, 0.0, 0.0))
    frame = pack_can(CanFrame(can_id_of(Identifier(2, pgn, 255, 35)), data))
    events, _ = taken_in(text, [Chunk("bus", frame, stamp(0.0))])
    assert [event.heading_rad for event in events if isinstance(event, NavSample)] == [pytest.approx(0.5 + np.pi / 2)]


@pytest.mark.parametrize(
    ("port", "message"),
    [
        (
            "link: 'tcp://10.0.0.2:1', device: nmea2000",
            "ports[0].link 'tcp://10.0.0.2:1': a device 'nmea2000' needs a slcan:",
        ),
        ("link: 'socketcan://can0', device: jsf", "ports[0].link 'socketcan://can0': a device 'jsf' needs a serial:"),
        (
            "link: 'serial:///dev/ttyS0?baud=9601', device: nmea0183",
            "ports[0].link 'serial:///dev/ttyS0?baud=9601': baud=9601",
        ),
        ("link: 'tcp://10.0.0.2:1', device: sportscan", "ports[0].sonar.range_m is empty"),
        (
            "link: 'tcp://10.0.0.2:1', device: ping_protocol, sonar: {enabled: false}",
            "ports[0].sonar.enabled is false, but no command is sent without range_m",
        ),
        ("link: 'tcp://10.0.0.2:1', device: jsf, sonar: {gain: 9}", "ports[0].sonar.gain is set, but no command"),
        (
            "link: 'tcp://10.0.0.2:1', device: jsf, sonar: {sound_speed_mps: 1480}",
            "ports[0].sonar.sound_speed_mps is set, but no command",
        ),
        (
            "link: 'tcp://10.0.0.2:1', device: sportscan, sonar: {range_m: 31}",
            "ports[0].sonar: sportscan: a range of 31 m",
        ),
        (
            "link: 'tcp://10.0.0.2:1', device: ping_protocol, sonar: {range_m: 30, gain: 9}",
            "ports[0].sonar: ping_protocol: a gain of 9",
        ),
    ],
)
def test_ports_that_cannot_be_are_refused_with_the_key(port: str, message: str) -> None:
    with pytest.raises(UsageError, match=re.escape(message)):
        read_ports(config_of(f"ports: [{{name: one, {port}}}]"))


def test_a_recording_is_replayed_whatever_its_sonar_was_not_commanded() -> None:
    PortIntake(config_of("ports: [{name: one, link: 'tcp://10.0.0.2:1', device: jsf, sonar: {enabled: false}}]"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ports: [{name: a, link: x}]", "missing required field `device` - at `ports[0]`"),
        ("ports: [{name: A, link: x, device: jsf}]", "`ports[0].name`"),
        ("ports: [{name: a, link: x, device: jsf, sonar: {range: 3}}]", "unknown field `range` - at `ports[0].sonar`"),
        ("ports: [{name: a, link: x, device: pd6, navigation: {roll_sign: 0}}]", "`ports[0].navigation.roll_sign`"),
        ("ports: [{name: a, link: x, device: pd6, sonar: {}}]", "is not a sonar"),
        ("ports: [{name: a, link: x, device: pd6}, {name: a, link: y, device: pd6}]", "two ports are called 'a'"),
        ("ports: [{name: a, link: x, device: jsf}, {name: b, link: y, device: jsf}]", "several sonars"),
        ("ports: {name: a}", "`ports`"),
    ],
)
def test_mistakes_in_ports_are_refused_by_place_and_key(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=re.escape(message)):
        config_of(text)


def test_ports_survive_the_file_and_empty_keys_are_defaults() -> None:
    text = """
ports:
  - name: ins
    link: serial:///dev/ttyS1?baud=115200
    device: pixse
    sonar:
    navigation: {roll_sign: -1, delivers: [heading, attitude], lever_arm_m: [0.5, 0, -1e-3], baud: }
  - {name: sonar, link: 'tcp://10.0.0.2:1', device: jsf, sonar: {range_m: 75}, navigation: {}}
"""
    config = config_of(text)
    assert config.ports[0].navigation is not None
    assert config.ports[0].navigation.lever_arm_m == (0.5, 0.0, -1e-3)
    assert parse_config(config_yaml(config), "f.yaml") == config


def test_the_wire_takes_time_on_serial_lines_only() -> None:
    port, unit = read_ports(config_of())
    assert (port.baud, unit.baud) == (None, 115_200)
    assert unit.unit is not None
    assert unit.unit.baud == 115_200
    assert (port.unit, port.ask_every_s, len(port.commands)) == (None, None, 2)


def test_a_sonar_that_pings_when_asked_is_asked_at_its_interval() -> None:
    text = (
        "ports: [{name: s, link: 'serial:///dev/ttyS0?baud=115200', device: sportscan, sonar: {range_m: 30, "
        "ping_interval_s: 0.25}}]"
    )
    (port,) = read_ports(config_of(text))
    assert (port.commands, port.ask_every_s) == (sportscan_commands(SonarSettings(range_m=30)), 0.25)


def test_commands_may_have_a_wire_of_their_own() -> None:
    text = "ports: [{name: s, link: 'tcp://10.0.0.2:1601', device: jsf, sonar: {range_m: 75, command_link: 'tcp://10.0.0.2:1600'}}]"
    data, commands = read_ports(config_of(text))
    assert (data.name, data.address.place, data.commands) == ("s", "tcp://10.0.0.2:1601", ())
    assert (commands.name, commands.address.place) == ("s.commands", "tcp://10.0.0.2:1600")
    assert commands.commands == SONARS["jsf"].commands(SonarSettings(range_m=75))
    refusal = to_wire(JsfMessage(PING_RANGE, b"", Command.ERROR))
    events, intake = taken_in(text, [Chunk("s.commands", refusal, stamp(0.0))])
    assert [event.code for event in events if isinstance(event, Notice)] == ["sonar_refused"]
    assert intake.counters["port.s.commands.sonar.refused"] == 1


@pytest.mark.parametrize(
    ("device", "harm"),
    [("nmea0183", "move its position"), ("imc", "grant control"), ("ping_protocol", "hide contacts")],
)
def test_a_udp_port_that_hears_every_sender_is_reported_by_name_with_what_to_do(device: str, harm: str) -> None:
    def reported(link: str) -> list[Notice]:
        return open_to_all(read_ports(config_of(f"ports: [{{name: a, link: '{link}', device: {device}}}]")))

    (notice,) = reported("udp://0.0.0.0:6001")
    assert (notice.code, notice.place) == ("port_open_to_all", "a")
    assert harm in notice.text
    assert "peer=HOST:PORT" in notice.text
    for link in ("udp://0.0.0.0:6001?peer=10.0.0.2:6002", "udp://0.0.0.0:6001?peer=10.0.0.2", "tcp://10.0.0.2:6002"):
        assert reported(link) == []


def test_the_words_of_a_refusal_forge_no_line_and_fill_no_log() -> None:
    text = "ports: [{name: s, link: 'serial:///dev/ttyS0?baud=115200', device: ping_protocol, sonar: {range_m: 30}}]"
    words = "no\x1b[2J\r\nnotice port_up: port 's' is up" + "x" * 900
    nack = encode_ping(Nack(2197, words))
    events, _ = taken_in(text, [Chunk("s", nack, stamp(0.0))])
    (notice,) = [event for event in events if isinstance(event, Notice)]
    assert notice.code == "sonar_refused"
    assert is_clean(notice.text)
    assert "no\\x1b[2J\\r\\nnotice port_up" in notice.text
    assert len(notice.text) < 500


def test_the_names_in_the_configuration_are_those_of_the_drivers() -> None:
    assert set(SONAR_NAMES) == set(SONARS)
    assert set(get_args(NavUnitName)) == {*TEXT_PROTOCOLS, CAN_PROTOCOL, "pixse"}


@pytest.mark.parametrize(
    ("devices", "codes"), [(["nmea0183"], ["no_sonar"]), (["nmea0183", "ping_protocol"], []), (["jsf"], [])]
)
def test_a_configuration_without_a_sonar_is_reported(devices: list[str], codes: list[str]) -> None:
    ports = ", ".join(
        f"{{name: {device}, link: 'tcp://10.0.0.2:{6000 + n}', device: {device}}}" for n, device in enumerate(devices)
    )
    assert [notice.code for notice in without_sonar(read_ports(config_of(f"ports: [{ports}]")))] == codes
