"""The example package at work: its sonar, inertial unit, vehicle and logs, through the doors that its users take."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.cli import main
from auv_mcm.clock import Stamp
from auv_mcm.records import EchoTrace, NavSample, Ping, SourceEvent
from auv_mcm.settings.config import SonarConfig, parse_config
from auv_mcm.shell.recovery import RECORDING
from drivers.navigation.nav_protocols import text_decoder
from drivers.sonar.sonar_decoder import SonarFrame
from drivers.sonar.sonars import sonar_named
from sim_replay.simulator.scene import SampleRecorder, SceneObject, Sonar
from tests.auv_mcm import short_missions
from tests.drivers.port_devices import Devices, Message, served
from tests.plugin_packages import importable, install_example

RANGE_M: Final = 20.0
START_UTC_S: Final = 1.7e9
QUEUE_PINGS: Final = 4096  # more than four times the pings of the mission: a computer with other work sheds none
CONFIG: Final = """
service: {{source: ports, output_directory: "{folder}/out", queue_pings: {queue_pings}, stop_within_s: 600}}
vehicle: {{report_min_p_mine: 0.05}}
ports:
  - {{name: sonar, link: "serial://{folder}/sonar?baud=4000000", device: acme_sonar, sonar: {{range_m: 20}}}}
  - {{name: ins, link: "serial://{folder}/ins?baud=921600", device: acme_ins}}
  - {{name: vehicle, link: "serial://{folder}/vehicle?baud=921600", device: acme_vehicle, options: {{station: 7}}}}
"""


@pytest.fixture(autouse=True)
def site(tmp_path: Path) -> Iterator[Path]:
    """Install the example package."""
    install_example(tmp_path / "site")
    with importable(tmp_path / "site"):
        yield tmp_path / "site"


@pytest.fixture(scope="module")
def flown() -> list[SourceEvent]:
    """Fly past a cylinder and a sphere on bare sand."""
    objects = (
        SceneObject(kind="cylinder", leg=0, along_m=12.0, across_m=11.0, azimuth_deg=20.0, length_m=2.0, width_m=0.53),
        SceneObject(kind="sphere", leg=0, along_m=24.0, across_m=-12.0, width_m=0.8),
    )
    recorder = SampleRecorder(samples="amplitude_uint16", seabed_counts=300.0)
    sonar = Sonar(range_m=RANGE_M, n_samples=400, ping_rate_hz=12.0, recorder=recorder)
    scene = short_missions.one_leg(objects, sonar, length_m=36.0, altitude_m=4.0)
    return list(short_missions.flown(scene))


def amplitudes(trace: EchoTrace | None) -> NDArray[np.uint16]:
    assert trace is not None
    samples: NDArray[np.uint16] = trace.samples
    return samples


def wire_of(ping: Ping, time_s: float) -> bytes:
    """Encode a ping as an ACME sonar sends it. time_s: since its power-up."""
    from acme_survey.sonar import AcmePing, encode  # type: ignore[import-not-found]  # installed by the test

    port, starboard = amplitudes(ping.port), amplitudes(ping.starboard)
    return bytes(encode(AcmePing(ping.number, round(1e3 * time_s), round(100 * RANGE_M), port, starboard)))


def write_log(events: list[SourceEvent], path: Path) -> Path:
    """Write a mission as an ACME log."""
    lines = ['{"format": "acme-log"}']
    for event in events:
        if isinstance(event, NavSample):
            pose = [
                event.latitude_deg,
                event.longitude_deg,
                math.degrees(event.heading_rad),
                event.depth_m,
                event.altitude_m,
            ]
            lines.append(json.dumps({"fix": [event.time_s, *pose]}))
        elif isinstance(event, Ping):
            sides = {"port": amplitudes(event.port).tolist(), "starboard": amplitudes(event.starboard).tolist()}
            lines.append(json.dumps({"ping": [event.number, event.time_s, RANGE_M], **sides}))
    path.write_text("\n".join(lines) + "\n")
    return path


def features(contacts: Path) -> list[dict[str, Any]]:
    return [feature["properties"] for feature in json.loads(contacts.read_bytes())["features"]]


def test_a_log_of_its_format_is_replayed_to_contacts(
    flown: list[SourceEvent], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_log(flown, tmp_path / "mission.txt")
    with log.open("a") as file:
        file.write('{"ping": "torn')
    assert main(["replay", str(log), "--out", str(tmp_path / "results")]) == 0
    assert "contacts" in capsys.readouterr().out
    likely = [contact for contact in features(tmp_path / "results" / "contacts.geojson") if contact["p_mine"] > 0.3]
    assert sorted(contact["side"] for contact in likely) == ["port", "starboard"]
    counters = json.loads((tmp_path / "results" / "summary.json").read_bytes())["counters"]
    assert counters["acme_log.damaged_lines"] == 1


def test_its_decoder_finds_every_whole_ping_however_the_bytes_come(flown: list[SourceEvent]) -> None:
    pings = [event for event in flown if isinstance(event, Ping)][:5]
    device = sonar_named("acme_sonar")
    wire = b"".join(wire_of(ping, 0.1 * ping.number) for ping in pings)
    damaged = b"ACME noise" + wire[:2000] + bytes(1) + wire[2001:]
    for n_bytes in (1, 7, 1000, len(damaged)):
        decoder = device.decoder(SonarConfig())
        chunks = (damaged[start : start + n_bytes] for start in range(0, len(damaged), n_bytes))
        frames = [*(frame for chunk in chunks for frame in decoder.feed(chunk, Stamp(0, 0))), *decoder.finish()]
        assert all(isinstance(frame, SonarFrame) for frame in frames)
        assert [frame.number for frame in frames if isinstance(frame, SonarFrame)] == [0, 2, 3, 4]
        assert decoder.counters["acme_sonar.messages"] == 4
        assert decoder.counters["acme_sonar.refused.checksum"] == 1


def test_its_navigation_decoder_finds_every_whole_line_however_the_bytes_come() -> None:
    from acme_survey.navigation import line_of  # type: ignore[import-not-found]  # installed by the test

    lines = [line_of(43.09 + 1e-5 * k, 5.92, 90.0, 1.0, -2.0, 12.5, 4.0, 1.8) for k in range(4)]
    wire = b"noise\n" + lines[0] + lines[1].replace(b"1.8", b"1.9") + b"".join(lines[2:])
    for n_bytes in (1, 7, 1000):
        decoder = text_decoder("acme_ins", "ins")
        chunks = (wire[start : start + n_bytes] for start in range(0, len(wire), n_bytes))
        fixes = [*(fix for chunk in chunks for fix in decoder.feed(chunk, Stamp(0, 0))), *decoder.finish()]
        assert [round(1e5 * (fix.latitude_deg - 43.09)) for fix in fixes] == [0, 2, 3]
        assert {fix.source for fix in fixes} == {"ins"}
        assert fixes[0].heading_rad == pytest.approx(0.5 * math.pi)
        assert decoder.counters == {"acme_ins.messages": 3, "acme_ins.refused.damaged": 2}


def messages_of(events: list[SourceEvent]) -> list[Message]:
    """List when each message is sent, s since the beginning, at which port."""
    from acme_survey.navigation import line_of

    start_s = next(event.time_s for event in events if isinstance(event, Ping))
    messages: list[Message] = []
    for event in events:
        if isinstance(event, NavSample):
            time_s = event.time_s - start_s
            place = event.latitude_deg, event.longitude_deg, math.degrees(event.heading_rad)
            below = event.depth_m, event.altitude_m, event.speed_mps
            messages.append((time_s, "ins", line_of(*place, 0.0, 0.0, *below)))
            degrees = f"{event.latitude_deg} {event.longitude_deg} {math.degrees(event.heading_rad)}"
            messages.append(
                (time_s, "vehicle", f"STATE {degrees} {event.depth_m} {event.altitude_m} {event.speed_mps}\n".encode())
            )
        elif isinstance(event, Ping):
            time_s = event.time_s - start_s
            messages.append((time_s + 2.0 * RANGE_M / 1500.0, "sonar", wire_of(event, time_s)))
    return sorted(messages, key=lambda message: message[0])


def test_its_sonar_inertial_unit_and_vehicle_are_served_live(flown: list[SourceEvent], tmp_path: Path) -> None:
    config = parse_config(CONFIG.format(folder=tmp_path, queue_pings=QUEUE_PINGS), "vehicle.yaml")
    bauds = {"sonar": 4_000_000, "ins": 921_600, "vehicle": 921_600}
    devices = Devices(tmp_path, bauds, messages_of(flown), START_UTC_S)
    live = served(config, devices)

    n_pings = sum(isinstance(event, Ping) for event in flown)
    assert 4 * n_pings < QUEUE_PINGS
    counters = json.loads((live / "summary.json").read_bytes())["counters"]
    assert counters.get("service.work_shed", 0) == 0, "otherwise a replay may find more"
    assert counters["port.sonar.acme_sonar.messages"] == n_pings
    assert counters["port.ins.acme_ins.messages"] == sum(isinstance(event, NavSample) for event in flown)
    assert counters["port.vehicle.acme_vehicle.messages"] > 0
    assert devices.received["sonar"].startswith(b"RANGE020")
    lines = devices.received["vehicle"].decode("ascii").splitlines()
    states = [line.removeprefix("HEALTH 7 ") for line in lines if line.startswith("HEALTH ")]
    assert states[0] == "starting"
    assert set(states) <= {"starting", "normal", "fault", "failure"}, "which of them is for the computer's load to say"
    assert len(states) > 1
    reported = [line.split() for line in lines if line.startswith("CONTACT 7 ")]
    found = [contact for contact in features(live / "contacts.geojson") if contact["p_mine"] >= 0.05]
    assert found
    assert {f"C{int(number):05d}" for _, _, number, *_ in reported} >= {contact["id"] for contact in found}

    assert main(["replay", str(live / RECORDING), "--out", str(tmp_path / "again")]) == 0
    assert (tmp_path / "again" / "contacts.geojson").read_bytes() == (live / "contacts.geojson").read_bytes()
