"""Check a whole mission over serial ports: the replay of its recording gives the live result."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.clock import Stamp
from auv_mcm.commands import read_config
from auv_mcm.records import EchoTrace, NavSample, Ping, SourceEvent
from auv_mcm.settings.config import Config, parse_config
from auv_mcm.shell.recovery import RECORDING
from drivers.framing import Framer
from drivers.ports import read_ports
from drivers.recording.session_layout import Recorded
from drivers.sonar.jsf import JsfGrammar
from drivers.sonar.jsf_messages import DATA_HEADER, SIDE_SCAN, JsfMessage, SideScanHeader
from drivers.sonar.jsf_messages import to_wire as jsf_wire
from drivers.sonar.ping_messages import OsMonoProfile, PingMessage, decode, to_wire
from drivers.sonar.ping_protocol import PingGrammar
from sim_replay.fakes.sonar import DeviceTime, JsfSonar
from sim_replay.logs.open_log import logs_config
from sim_replay.logs.session_reader import Session
from sim_replay.replay import replay
from sim_replay.simulator.scene import SampleRecorder, SceneObject, Sonar
from sim_replay.wire_logs import jsf_string, nmea_packet, svlog_head
from tests.auv_mcm import short_missions
from tests.drivers.port_devices import Devices, Message, served
from tests.drivers.port_traffic import POWER_UP_S, fix, profile
from tests.sim_replay.logs.sonar_logs import UTC_S

PingBytes = Callable[[Ping, float], bytes]
BAUD: Final = 4_000_000
PING_RATE_HZ: Final = 12.0
RANGE_M: Final = 22.0
SPEED_MPS: Final = 1.8
FULL_SCALE_DB: Final = 80.0
CONFIG: Final = """
mission: over serial ports
service:
  {{source: ports, output_directory: "{folder}/out", health_period_s: 0.5, queue_pings: 4096, stop_within_s: 600}}
ports:
  - name: sonar
    link: "serial://{folder}/sonar?baud=4000000"
    device: {device}
    sonar: {{range_m: 22, n_samples: 512}}
  - {{name: ins, link: "serial://{folder}/ins?baud=4000000", device: nmea0183}}
"""


def flown() -> list[SourceEvent]:
    """Past a cylinder and a sphere on bare sand."""
    objects = (
        SceneObject(kind="cylinder", leg=0, along_m=14.0, across_m=12.0, azimuth_deg=20.0, length_m=2.0, width_m=0.53),
        SceneObject(kind="sphere", leg=0, along_m=30.0, across_m=-14.0, width_m=0.8),
    )
    recorder = SampleRecorder(samples="amplitude_float32", seabed_counts=100.0)
    sonar = Sonar(range_m=RANGE_M, n_samples=512, ping_rate_hz=PING_RATE_HZ, recorder=recorder)
    scene = short_missions.one_leg(objects, sonar, length_m=44.0, altitude_m=4.0, speed_mps=SPEED_MPS)
    return list(short_missions.flown(scene))


def side(number: int, channel: int, time_s: float, trace: EchoTrace | None) -> bytes:
    assert trace is not None
    power_db = 20.0 * np.log10(np.maximum(trace.samples, 1e-3))
    return profile(number, channel, time_s, np.clip(np.rint(power_db / FULL_SCALE_DB * 65535.0), 0, 65535), RANGE_M)


def profiles(ping: Ping, time_s: float) -> bytes:
    """A ping as an Omniscan sends it."""
    return side(ping.number, 0, time_s, ping.port) + side(ping.number, 1, time_s, ping.starboard)


def edgetech(config: Config) -> PingBytes:
    """An EdgeTech that has heard the commands of a configuration."""
    sonar = JsfSonar()
    for command in read_ports(config)[0].commands:
        sonar.heard(command, DeviceTime(0.0, UTC_S))
    return lambda ping, time_s: b"".join(sonar.ping(ping, DeviceTime(time_s, UTC_S + time_s)))


def messages_of(events: list[SourceEvent], ping_bytes: PingBytes) -> list[Message]:
    """When each message is due, s since the first ping, at which port."""
    messages = []
    start_s = next(event.time_s for event in events if isinstance(event, Ping))
    for event in events:
        assert isinstance(event, Ping | NavSample)
        time_s = event.time_s - start_s
        if isinstance(event, NavSample):
            data = fix(time_s, event.latitude_deg, event.longitude_deg, event.heading_rad, event.speed_mps)
            messages.append((time_s, "ins", data))
        else:
            messages.append((time_s + 2.0 * RANGE_M / 1500.0, "sonar", ping_bytes(event, time_s)))
    return sorted(messages, key=lambda message: message[0])


def received_of(recording: Path) -> list[Recorded]:
    return [recorded for recorded in Session(recording) if recorded.direction == "in"]


def device_time_s(message: PingMessage | JsfMessage) -> float | None:
    """Return the sonar's own time of a side of a ping; None for other messages."""
    if isinstance(message, JsfMessage):
        ping = message.message_type == SIDE_SCAN
        return SideScanHeader(*DATA_HEADER.unpack_from(message.body)).utc_s if ping else None
    profile = decode(message)
    return 1e-3 * profile.timestamp_ms if isinstance(profile, OsMonoProfile) else None


def zero_utc_s(received: list[Recorded], grammar: PingGrammar | JsfGrammar) -> float:
    """Return the UTC at which the sonar's clock was zero, by the ping that was on its way for the least time.

    The first one may come late on a busy computer.
    """
    framer: Framer[Any] = Framer(grammar)
    began_s = [
        1e-9 * recorded.stamp.utc_ns - 2.0 * RANGE_M / 1500.0 - time_s
        for recorded in received
        if recorded.port == "sonar"
        for framed in framer.feed(recorded.data)
        if (time_s := device_time_s(framed.message)) is not None
    ]
    return min(began_s)


def write_svlog(recording: Path, path: Path) -> Path:
    """Write the same bytes as SonarView would: the sonar's packets, and between them the unit's sentences."""
    received = received_of(recording)
    first_s = zero_utc_s(received, PingGrammar()) + POWER_UP_S
    parts, framer, said = [svlog_head(first_s)], Framer(PingGrammar()), b""
    for recorded in received:
        if recorded.port == "sonar":
            parts += [to_wire(framed.message) for framed in framer.feed(recorded.data)]
        else:
            *lines, said = (said + recorded.data).split(b"\n")
            parts += [nmea_packet(line + b"\n") for line in lines]
    path.write_bytes(b"".join(parts))
    return path


def write_topside_jsf(recording: Path, path: Path) -> Path:
    """Write the same bytes as EdgeTech's topside would: the sonar's messages, with the unit's data by the sonar's
    clock."""
    received = received_of(recording)
    zero_s = zero_utc_s(received, JsfGrammar())
    parts, framer = [], Framer(JsfGrammar())
    for recorded in received:
        if recorded.port == "sonar":
            parts += [jsf_wire(framed.message) for framed in framer.feed(recorded.data)]
        else:
            at = Stamp(recorded.stamp.mono_ns, recorded.stamp.utc_ns - round(zero_s * 1e9))
            parts += [jsf_string(line, at) for line in recorded.data.splitlines(keepends=True)]
    path.write_bytes(b"".join(parts))
    return path


def apart_m(one: dict[str, Any], other: dict[str, Any]) -> float:
    (east, north), (other_east, other_north) = (feature["geometry"]["coordinates"][:2] for feature in (one, other))
    return 111_200.0 * math.hypot((east - other_east) * math.cos(math.radians(north)), north - other_north)


def mine_like(contacts: Path) -> list[dict[str, Any]]:
    """Features of contacts that are mines rather than not, from west to east."""
    features = json.loads(contacts.read_bytes())["features"]
    likely = [feature for feature in features if feature["properties"]["p_mine"] >= MINE_LIKE_P]
    return sorted(likely, key=lambda feature: feature["geometry"]["coordinates"][0])


@pytest.mark.parametrize("device", ["ping_protocol", "jsf"])
def test_a_recorded_session_gives_the_same_contacts_to_the_byte_and_a_sonars_own_log_those_contacts(
    device: str, tmp_path: Path
) -> None:
    config = parse_config(CONFIG.format(folder=tmp_path, device=device), "vehicle.yaml")
    messages = messages_of(flown(), profiles if device == "ping_protocol" else edgetech(config))
    devices = Devices(tmp_path, {"sonar": BAUD, "ins": BAUD}, messages, UTC_S)
    live = served(config, devices)

    assert logs_config([live / RECORDING]) == config != read_config(None)
    replay([live / RECORDING], tmp_path / "again", config)
    for name in ("contacts.geojson", "contacts.csv", "coverage.geojson", "waypoints.geojson"):
        assert (live / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name

    found = mine_like(live / "contacts.geojson")
    assert [feature["properties"]["class"] for feature in found] == ["sphere", "cylinder"]
    # A topside's clock counts milliseconds; SonarView does not say when between two pings a sentence came.
    write_log = write_svlog if device == "ping_protocol" else write_topside_jsf
    replay([write_log(live / RECORDING, tmp_path / "survey")], tmp_path / "log", config)
    again = mine_like(tmp_path / "log" / "contacts.geojson")
    assert len(again) == len(found)
    for one, other in zip(found, again, strict=True):
        assert apart_m(one, other) < SPEED_MPS / PING_RATE_HZ

    assert devices.received["sonar"].startswith(b"BR" if device == "ping_protocol" else b"\x01\x16")
    summary = json.loads((live / "summary.json").read_bytes())
    assert summary["counters"]["port.sonar.commands_sent"] >= 2
    assert not [name for name in summary["counters"] if name.endswith(("_lost", "_dropped"))]
