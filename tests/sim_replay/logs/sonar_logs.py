"""One run of fake devices: what came in at its ports, and what the sonar's own recorders make of the same messages."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from msgspec import structs

from auv_mcm.clock import Stamp
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, NavSample, Ping, SourceEvent
from auv_mcm.settings.config import Config, parse_config
from drivers.port_intake import PortIntake
from drivers.sonar.ping_messages import MAVLINK_WRAPPER, PingMessage
from drivers.sonar.ping_messages import to_wire as ping_wire
from sim_replay.logs.recorded import open_mission
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene, SceneObject, Sonar, Track
from sim_replay.wire_logs import Run, later, played, write_jsf, write_svlog

SonarKind = Literal["jsf", "ping_protocol"]
UTC_S: Final = 1_700_000_000.0
RANGE_M: Final = 20.0
ECHO_S: Final = 2.0 * RANGE_M / 1500.0


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
    random = np.random.Generator(np.random.PCG64(7))
    config = parse_config(text, "vehicle.yaml")
    return played(mission(leg_m), config, stamp_at(0.0), lambda event: ECHO_S + random.uniform(0.0, late_s))


def stamp_at(at_s: float) -> Stamp:
    return later(Stamp(5_000_000_000_000, round(UTC_S * 1e9)), at_s)


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


def mavlink(kind: str, since_boot_s: float, **fields: Any) -> bytes:
    content = {
        "header": {"system_id": 1},
        "message": {"type": kind, "time_boot_ms": round(1e3 * since_boot_s), **fields},
    }
    return ping_wire(PingMessage(MAVLINK_WRAPPER, json.dumps(content).encode()))


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
