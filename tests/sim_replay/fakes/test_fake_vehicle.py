"""A fake vehicle flies what a host on its wires commands, sounds what it passes there, and reports its events."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from auv_mcm.clock import Stamp, SystemClock
from auv_mcm.errors import UsageError
from auv_mcm.records import NavSample, Ping
from auv_mcm.settings.config import SonarConfig
from drivers.links.link import Link
from drivers.links.open_link import byte_link
from drivers.links.uri import parse_link_uri
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nav_protocols import text_decoder
from drivers.sonar.sonar_decoder import SonarFrame, SonarSettings
from drivers.sonar.sonars import sonar_named
from sim_replay.fakes.job import (
    Device,
    Fault,
    Misreport,
    Nonsense,
    Offset,
    PowerOff,
    Revoke,
    Stall,
    Unplug,
    VehicleJob,
    read_job,
)
from sim_replay.fakes.vehicle_device import FakeVehicle, passes
from sim_replay.simulator.objects import place_objects
from sim_replay.simulator.plan import local_frame
from sim_replay.simulator.scene_file import parse_scene
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.vehicle import SonarPose
from tests.sim_replay.fakes.plain_vehicle import PlainController

SCENE = """
name: a short leg
world: {depth_m: 15, relief_rms_m: 0, seabeds: [{type: sand}]}
sonar: {range_m: 20, n_samples: 200, ping_rate_hz: 20}
track:
  altitude_m: 5
  speed_mps: 4
  turn_rate_deg_s: 40
  plan: {pattern: lawnmower, heading_deg: 0, n_legs: 1, leg_m: 6}
objects: [{kind: cylinder, east_m: 8, north_m: 4}]
"""
PATIENCE_S = 300.0  # on a computer that has much else to do
FRAME = local_frame(parse_scene(SCENE, "here").origin)


class Host:
    """Listens on all wires of a vehicle, and writes to its controller."""

    def __init__(self, folder: Path, *faults: Fault, link: Any = "tcp") -> None:
        scene = folder / "scene.yaml"
        scene.write_text(SCENE, "utf-8")
        self.controller = PlainController()
        self.reports: list[tuple[str, str, dict[str, Any]]] = []
        self.lines: list[str] = []
        self.frames: list[SonarFrame] = []
        self.fixes: list[NavFix] = []
        devices = {
            "sonar": Device(device="ping_protocol", link="udp"),
            "nav": Device(device="nmea0183"),
            "vehicle": Device(device="bluefin", link=link, faults=faults),
        }
        job = VehicleJob(devices=devices, folder=str(folder), scene=str(scene))
        self.vehicle = FakeVehicle(
            job, lambda device, what, details: self.reports.append((device, what, details)), lambda: self.controller
        )
        self._sonar = sonar_named("ping_protocol").decoder(SonarConfig())
        self._nav = text_decoder("nmea0183", "nav")
        self._links: dict[str, Link[bytes]] = {}

    def write(self, words: str) -> bool:
        """Return whether the link took it: one that is being opened takes nothing."""
        return self._links["vehicle"].write(words.encode() + b"\n")

    def reported(self, what: str) -> list[dict[str, Any]]:
        """Details of what was reported of the controller."""
        return [details for device, reported, details in self.reports if (device, reported) == ("vehicle", what)]

    async def run(self, script: Callable[[Host], Awaitable[None]]) -> None:
        start: asyncio.Future[float] = asyncio.get_running_loop().create_future()
        flying = asyncio.ensure_future(self.vehicle.run(start))
        while sum(what == "ready" for _, what, _ in self.reports) < len(self.vehicle.devices):
            await asyncio.sleep(0.005)
        for name, device in self.vehicle.devices.items():
            self._links[name] = self._open(name, device.wire.uri)
        listening = [asyncio.ensure_future(link.run()) for link in self._links.values()]
        while any(link.state != "up" for link in self._links.values()):
            await asyncio.sleep(0.005)
        start.set_result(time.monotonic() + 0.05)
        try:
            await script(self)
        finally:
            for task in (flying, *listening):
                task.cancel()
            await asyncio.gather(flying, *listening, return_exceptions=True)
            await self.vehicle.end()

    def _open(self, name: str, uri: str) -> Link[bytes]:
        def hear(data: bytes, stamp: Stamp) -> None:
            if name == "sonar":
                self.frames += [item for item in self._sonar.feed(data, stamp) if isinstance(item, SonarFrame)]
            elif name == "nav":
                self.fixes += [item for item in self._nav.feed(data, stamp) if isinstance(item, NavFix)]
            else:
                self.lines += data.decode("ascii", "replace").splitlines()

        def on_state(state: str, reason: str) -> None:
            if name == "sonar" and state == "up":
                for command in sonar_named("ping_protocol").commands(SonarSettings(range_m=20.0, n_samples=200)):
                    self._links["sonar"].write(command)

        return byte_link(parse_link_uri(uri, "link"), hear, on_state, SystemClock())


def flown(folder: Path, script: Callable[[Host], Awaitable[None]], *faults: Fault, link: Any = "tcp") -> Host:
    async def main() -> Host:
        host = Host(folder, *faults, link=link)
        await host.run(script)
        return host

    return asyncio.run(main())


async def until(condition: Callable[[], object], host: Host, *keep: str) -> None:
    """Wait, saying what keeps the vehicle patient."""
    until_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < until_s, host.reports[-5:]
        for words in keep:
            host.write(words)
        await asyncio.sleep(0.05)


def goto(east_m: float, north_m: float) -> str:
    latitude_deg, longitude_deg, _ = FRAME.to_geodetic((east_m, north_m, 0.0))
    return f"GOTO {latitude_deg:.8f} {longitude_deg:.8f}"


@pytest.mark.parametrize("link", ["tcp", "serial", "udp"])
def test_it_flies_to_commanded_places_past_targets_and_then_its_own_plan(tmp_path: Path, link: Any) -> None:
    async def script(host: Host) -> None:
        host.controller.forgets_s = PATIENCE_S
        host.write("REPORT 7 1 0.5")
        host.write("REPORT 7 1 0.5")
        host.write("FINE")
        host.write("ASK")
        await until(lambda: "yes" in host.lines, host)
        await until(lambda: "there" in host.lines, host, goto(0.0, 14.0))
        host.write("RELEASE")
        await until(lambda: host.reported("released"), host)

    host = flown(tmp_path, script, link=link)
    whats = [what for device, what, _ in host.reports if device == "vehicle"]
    assert {"contact", "health"} <= set(whats)
    order = ["ready", "granted", "command", "released", "counters"]
    assert [what for what in whats if what in order] == order
    assert host.reported("released") == [{"by": "payload"}]
    assert host.reported("contact")[0]["number"] == 7
    (passed,) = [reported for reported in host.reported("passed") if reported["in_control"]]
    assert passed["ground_range_m"] == pytest.approx(8.0, abs=1.0)
    assert passed["look_deg"] == pytest.approx(90.0, abs=10.0)
    assert host.reported("counters")[0]["vehicle.reports_repeated"] == 1
    assert host.frames
    assert [frame.number for frame in host.frames] == sorted(frame.number for frame in host.frames)
    assert host.fixes


def test_a_payload_that_falls_silent_is_out_of_command(tmp_path: Path) -> None:
    async def script(host: Host) -> None:
        host.write("ASK")
        host.write(goto(60.0, 0.0))
        await until(lambda: host.reported("released"), host)

    assert flown(tmp_path, script).reported("released") == [{"by": "time-out"}]


def test_control_is_taken_back_and_not_given_while_it_is_unwilling(tmp_path: Path) -> None:
    async def script(host: Host) -> None:
        host.controller.forgets_s = PATIENCE_S
        host.write("ASK")
        await until(lambda: host.reported("released"), host, "KEEP")
        host.write("ASK")
        host.write(goto(60.0, 0.0))
        await until(lambda: host.reported("refused"), host)

    host = flown(tmp_path, script, Revoke(at_s=0.2, after="grant"))
    assert host.reported("released") == [{"by": "vehicle"}]
    assert host.reported("refused") == [{"n_commands": 1}]
    assert "no" in host.lines
    assert not host.reported("command")


def test_a_vehicle_without_power_has_forgotten_everything_and_greets_again(tmp_path: Path) -> None:
    async def script(host: Host) -> None:
        host.write("REPORT 7 1 0.5")
        host.write("ASK")
        await until(lambda: any(details["do"] == "power_off" for details in host.reported("mended")), host)
        await until(lambda: host.controller.connections == 2 and host.write("REPORT 7 1 0.5"), host)
        await until(lambda: len(host.reported("contact")) == 2, host)

    host = flown(tmp_path, script, PowerOff(at_s=0.3, for_s=0.3), link="serial")
    assert len(host.reported("released")) == 1
    assert "reopened" in [what for device, what, _ in host.reports if device == "vehicle"]


def test_without_its_cable_it_flies_on_and_so_do_its_other_wires(tmp_path: Path) -> None:
    async def script(host: Host) -> None:
        await until(lambda: host.reported("mended") and host.reported("leg"), host)

    host = flown(tmp_path, script, Unplug(at_s=0.1, for_s=0.5))
    assert len(host.frames) >= 10


def test_nonsense_comes_beside_its_messages(tmp_path: Path) -> None:
    async def script(host: Host) -> None:
        await until(lambda: len(host.lines) > 20, host)

    host = flown(tmp_path, script, Nonsense(at_s=0.0), link="udp")
    assert host.reported("counters")[0]["vehicle.nonsense_sent"] >= 5
    sound = [words for words in host.lines if words.startswith("at ") and len(words.split()) == 3 and len(words) >= 20]
    assert len(sound) >= 5


def test_it_reports_a_wrong_depth_and_no_altitude_from_when_it_is_to(tmp_path: Path) -> None:
    async def script(host: Host) -> None:
        await until(lambda: any(is_wrong(host, pose) for pose in host.controller.poses), host)

    def is_wrong(host: Host, pose: NavSample) -> bool:
        return pose.depth_m > host.controller.poses[0].depth_m + 70.0 and math.isnan(pose.altitude_m)

    faults = Misreport(at_s=0.2, depth_by_m=80.0), Misreport(at_s=0.2, no_altitude=True)
    host = flown(tmp_path, script, *faults, link="udp")
    assert math.isfinite(host.controller.poses[0].altitude_m)
    assert host.controller.poses[0].depth_m < 70.0


def test_it_reports_a_place_that_is_off_from_when_it_is_to(tmp_path: Path) -> None:
    async def script(host: Host) -> None:
        away_deg = host.controller.poses[0].latitude_deg + 0.003
        await until(lambda: host.controller.poses[-1].latitude_deg > away_deg, host)

    flown(tmp_path, script, Offset(at_s=0.2, north_m=400.0), link="udp")


def pose(east_m: float, north_m: float, heading_rad: float = 0.0, time_s: float = 0.0) -> SonarPose:
    return SonarPose(time_s, east_m, north_m, 10.0, heading_rad, 0.0, 0.0, heading_rad, 4.0, -1)


def test_a_target_is_passed_where_it_comes_abeam_on_a_straight_run() -> None:
    targets = place_objects(parse_scene(SCENE, "here"))
    (passed,) = passes(pose(0.0, 3.9), pose(0.0, 4.1, time_s=0.05), targets, 20.0)
    assert passed.number == 0
    assert passed.ground_range_m == pytest.approx(8.0, abs=0.01)
    assert passed.look_rad == pytest.approx(math.pi / 2.0, abs=0.02)
    assert not passes(pose(0.0, 3.9), pose(0.0, 4.1, time_s=0.05), targets, 7.0)
    assert not passes(pose(0.0, 3.9), pose(0.0, 4.1, 0.05, time_s=0.05), targets, 20.0)
    assert not passes(pose(0.0, 4.1), pose(0.0, 4.3, time_s=0.05), targets, 20.0)


@pytest.mark.parametrize(
    ("devices", "named"),
    [
        ("{nav: {device: pd6}}", "0 controllers"),
        ("{a: {device: imc, link: udp}, b: {device: iver}}", "2 controllers"),
        ("{a: {device: imc, link: slcan}}", "does not go with a link"),
        ("{a: {device: vehicle_can, link: slcan, beside: pd6}}", "cannot share"),
        ("{a: {device: imc}, nav: {device: pd6, faults: [{do: revoke, at_s: 1}]}}", "not a vehicle"),
        ("{a: {device: bluefin, faults: [{do: abort, at_s: 1}]}}", "cannot be aborted"),
        ("{a: {device: imc}, nav: {device: pd6, faults: [{do: stall, at_s: 1, after: grant}]}}", "not a vehicle"),
        ("{a: {device: imc, faults: [{do: freeze, at_s: 1}]}}", "not a navigation unit"),
        (
            "{a: {device: imc}, nav: {device: pd6, faults: [{do: misreport, at_s: 1, no_altitude: true}]}}",
            "not a vehicle",
        ),
        ("{a: {device: imc}, s: {device: jsf, faults: [{do: offset, at_s: 1, east_m: 5}]}}", "not a navigation unit"),
    ],
)
def test_a_vehicle_that_cannot_be_is_refused(devices: str, named: str, tmp_path: Path) -> None:
    path = tmp_path / "job.yaml"
    path.write_text(f"{{folder: here, scene: demo, devices: {devices}}}", "utf-8")
    with pytest.raises(UsageError, match=named):
        read_job(path)


def test_the_mission_waits_for_a_computer_that_is_too_slow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Echoes take twice as long as the pings last; not one is left out, and faults come when they are due by mission
    time."""
    sound = Sea.sound

    def slowly(sea: Sea, *arguments: Any) -> list[Ping]:
        time.sleep(0.4)
        return sound(sea, *arguments)

    monkeypatch.setattr(Sea, "sound", slowly)

    async def script(host: Host) -> None:
        await until(lambda: host.reported("mended") and len(host.frames) >= 24, host)

    host = flown(tmp_path, script, Stall(at_s=0.5, for_s=0.3))
    numbers = sorted({frame.number for frame in host.frames})
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    whats = [what for device, what, _ in host.reports if device == "vehicle"]
    assert whats[: whats.index("fault")].count("held") >= 2
    assert host.reported("counters")[0]["world.held_ms"] >= 1e3 * sum(
        details["for_s"] for details in host.reported("held")
    )
