"""One run of fake devices: what came in at its ports, and what the sonar's own recorders make of the same messages."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from struct import Struct
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from msgspec import structs

from auv_mcm.clock import Stamp
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, NavSample, Ping, SourceEvent
from auv_mcm.settings.config import Config, config_yaml, parse_config
from drivers.port_intake import PortIntake
from drivers.ports import read_ports
from drivers.recording.session_layout import Recorded, SessionDescription
from drivers.recording.session_writer import SessionWriter
from drivers.sonar.jsf_messages import JsfMessage
from drivers.sonar.jsf_messages import to_wire as jsf_wire
from drivers.sonar.ping_messages import MAVLINK_WRAPPER, NMEA_WRAPPER, JsonWrapper, PingMessage, encode
from drivers.sonar.ping_messages import to_wire as ping_wire
from sim_replay.fakes.device import SONARS
from sim_replay.fakes.navigation import Nmea0183Unit
from sim_replay.fakes.sonar import DeviceTime
from sim_replay.logs.recorded import open_mission
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene, SceneObject, Sonar, Track

SonarKind = Literal["jsf", "ping_protocol"]
UTC_S: Final = 1_700_000_000.0
RANGE_M: Final = 20.0
ECHO_S: Final = 2.0 * RANGE_M / 1500.0
JSF_TIME: Final = Struct("<ii4x")
_POWER_UP_S: Final = 77.0
_MONO_S: Final = 5000.0


class Run(NamedTuple):
    """A run: the configuration of its ports and what came in there."""

    config: Config
    recorded: tuple[Recorded, ...]


@cache
def mission(leg_m: float = 30.0) -> tuple[NavSample | Ping, ...]:
    """A straight line past two boxes, in order of time."""
    boxes = tuple(
        SceneObject(kind="box", leg=0, along_m=along_m, across_m=across_m, length_m=0.9, width_m=0.7, height_m=0.45)
        for along_m, across_m in ((10.0, 9.0), (20.0, -8.0))
    )
    sonar = Sonar(range_m=RANGE_M, n_samples=800, ping_rate_hz=12.5, beam_lines=3)
    track = Track(plan=Lawnmower(heading_deg=20.0, n_legs=1, leg_m=leg_m), altitude_m=5.0)
    return tuple(Mission(Scene(objects=boxes, sonar=sonar, track=track)).events())


@cache
def run_of(kind: SonarKind, late_s: float = 0.0, leg_m: float = 30.0) -> Run:
    """The mission with a fake sonar and a satellite compass at two ports; every message arrives up to late_s late.

    Everything happens at full milliseconds, the resolution of the sonars' clocks. The compass needs as long as an echo
    for its sentences, which come just before the ping of the same instant: SonarView's logs do not record when a
    sentence came.
    """
    text = f"""
ports:
  - {{name: sonar, link: "tcp://192.168.2.92:51200", device: {kind}, sonar: {{range_m: {RANGE_M}, n_samples: 800}}}}
  - {{name: compass, link: "tcp://192.168.2.93:2000", device: nmea0183, navigation: {{latency_s: {ECHO_S}}}}}
"""
    config = parse_config(text, "vehicle.yaml")
    sonar, unit = SONARS[kind](), Nmea0183Unit()
    for command in read_ports(config)[0].commands:
        sonar.heard(command, DeviceTime(0.0, UTC_S))
    random = np.random.Generator(np.random.PCG64(7))
    start_s = mission(leg_m)[0].time_s
    arrivals: list[tuple[float, str, bytes]] = []
    for event in mission(leg_m):
        at_s = round(event.time_s - start_s, 3)
        if isinstance(event, NavSample):
            measured = unit.measured(event, UTC_S + at_s)
            data = b"".join(bytes(message) for message in measured)  # type: ignore[arg-type]  # no frame of a bus
            arrivals.append((at_s + ECHO_S + random.uniform(0.0, late_s), "compass", data))
            continue
        arrival_s = at_s + 2.0 * RANGE_M / event.sound_speed_mps + random.uniform(0.0, late_s)
        for message in sonar.ping(event, DeviceTime(_POWER_UP_S + at_s, UTC_S + at_s)):
            arrivals.append((arrival_s, "sonar", message))
    arrivals.sort(key=lambda arrival: arrival[0])
    return Run(config, tuple(Recorded(port, "in", stamp_at(at_s), data) for at_s, port, data in arrivals))


def stamp_at(at_s: float) -> Stamp:
    return Stamp(round((_MONO_S + at_s) * 1e9), round((UTC_S + at_s) * 1e9))


def live_events(run: Run) -> Iterator[SourceEvent]:
    """What the service was given, as the bytes came in."""
    intake = PortIntake(run.config)
    for recorded in run.recorded:
        yield from intake.feed(recorded.port, recorded.data, recorded.stamp)
    yield from intake.finish()


def contacts_of(events: Iterator[SourceEvent], config: Config) -> list[Contact]:
    pipeline = Pipeline(structs.replace(config, ports=()))
    for event in events:
        pipeline.feed(event)
    pipeline.finish()
    return sorted(pipeline.contacts, key=lambda contact: contact.id)


@cache
def live_contacts(kind: SonarKind, late_s: float = 0.0) -> tuple[Contact, ...]:
    run = run_of(kind, late_s)
    return tuple(contacts_of(live_events(run), run.config))


def write_session(run: Run, folder: Path) -> Path:
    """The recording of the service."""
    description = SessionDescription(
        version="0.1.0", started=run.recorded[0].stamp, config_yaml=config_yaml(run.config), ports=()
    )
    writer = SessionWriter(folder, description)
    for recorded in run.recorded:
        writer.add(recorded)
    writer.close()
    return folder


def jsf_string(text: bytes, stamp: Stamp) -> bytes:
    """Type 2002 as the topside writes it."""
    seconds, nanoseconds = divmod(stamp.utc_ns, 1_000_000_000)
    return jsf_wire(JsfMessage(2002, JSF_TIME.pack(seconds, nanoseconds // 1_000_000) + text + b"\0", subsystem=101))


def write_jsf(run: Run, path: Path) -> Path:
    """What EdgeTech's topside records.

    The sonar's messages as they came, and the sentences with the times at which they did.
    """
    parts = []
    for recorded in run.recorded:
        if recorded.port == "sonar":
            parts.append(recorded.data)
        else:
            parts += [jsf_string(line, recorded.stamp) for line in recorded.data.splitlines(keepends=True)]
    path.write_bytes(b"".join(parts))
    return path


def svlog_head(time_s: float) -> bytes:
    return encode(JsonWrapper({"session_id": 1, "timestamp": datetime.fromtimestamp(time_s, UTC).isoformat()}))


def mavlink(kind: str, since_boot_s: float, **fields: Any) -> bytes:
    content = {
        "header": {"system_id": 1},
        "message": {"type": kind, "time_boot_ms": round(1e3 * since_boot_s), **fields},
    }
    return ping_wire(PingMessage(MAVLINK_WRAPPER, json.dumps(content).encode()))


def write_svlog(run: Run, path: Path) -> Path:
    """What SonarView records: a head with the time of the first ping, then packets and sentences as they came."""
    parts = [svlog_head(UTC_S + first_ping_s())]
    for recorded in run.recorded:
        if recorded.port == "sonar":
            parts.append(recorded.data)
        else:
            lines = recorded.data.splitlines(keepends=True)
            parts += [ping_wire(PingMessage(NMEA_WRAPPER, line)) for line in lines]
    path.write_bytes(b"".join(parts))
    return path


def first_ping_s() -> float:
    return next(event.time_s for event in mission() if isinstance(event, Ping)) - mission()[0].time_s


Write = Callable[[Run, Path], Path]
WRITERS: dict[SonarKind, Write] = {"jsf": write_jsf, "ping_protocol": write_svlog}


def written(kind: SonarKind, path: Path) -> Path:
    return WRITERS[kind](run_of(kind), path)


def replayed(path: Path, config: Config) -> list[Contact]:
    return contacts_of(open_mission([path], config).events(), config)


def pings(events: Iterator[SourceEvent]) -> list[Ping]:
    return [event for event in events if isinstance(event, Ping)]


def apart_m(one: Contact, other: Contact) -> float:
    east = math.cos(math.radians(one.latitude_deg)) * (one.longitude_deg - other.longitude_deg)
    return 111_200.0 * math.hypot(one.latitude_deg - other.latitude_deg, east)


def bytes_of(contact: Contact) -> tuple[Any, ...]:
    return (
        contact.id,
        contact.time_s,
        contact.latitude_deg,
        contact.longitude_deg,
        contact.p_mine,
        contact.covariance_m2.tobytes(),
    )
