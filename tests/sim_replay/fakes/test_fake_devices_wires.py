"""Fake devices at their wires: what a host that listens with the real links gets, with faults and without."""

from __future__ import annotations

import asyncio
import json
import math
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml

from auv_mcm.clock import Stamp, SystemClock
from auv_mcm.records import EchoTrace, NavSample, Ping
from auv_mcm.settings.config import SonarConfig
from drivers.links.link import Link
from drivers.links.open_link import byte_link, can_link
from drivers.links.uri import parse_link_uri
from drivers.navigation.n2k_bus import N2kBus
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nav_protocols import text_decoder
from drivers.sonar.sonar_decoder import SonarFrame, SonarSettings
from drivers.sonar.sonars import sonar_named
from sim_replay.fakes.device import FakeDevice
from sim_replay.fakes.faults import FaultRates
from sim_replay.fakes.feed import TimedEvent, read_ahead
from sim_replay.fakes.job import (
    ClockStep,
    Damage,
    Device,
    Fault,
    Flood,
    Freeze,
    Garbage,
    Job,
    Offset,
    PowerOff,
    Stall,
    Unplug,
    WrongBaud,
)
from tests.sim_replay.logs.xtf_logs import written

N_PINGS = 20
PERIOD_S = 0.04


def mission(n_pings: int = N_PINGS) -> Iterator[TimedEvent]:
    """A vehicle that sails north at 2 m/s, with short traces."""
    trace = EchoTrace(samples=np.full(200, 1000, np.uint16), first_range_m=0.025, spacing_m=0.05)
    for number in range(n_pings):
        at_s = number * PERIOD_S
        place = NavSample(
            time_s=at_s,
            latitude_deg=43.0 + at_s * 1.8e-5,
            longitude_deg=5.0,
            depth_m=9.0,
            altitude_m=5.0,
            speed_mps=2.0,
        )
        yield TimedEvent(at_s, msgspec.structs.replace(place, heading_rad=0.5, pitch_rad=0.1, roll_rad=-0.1))
        yield TimedEvent(at_s, Ping(number=number, time_s=at_s, port=trace, starboard=trace))


class Bench:
    """A device, and a host that opens its wire."""

    def __init__(self, folder: Path, device: Device, n_pings: int = N_PINGS) -> None:
        self.reports: list[tuple[str, dict[str, Any]]] = []
        self.reported: list[Any] = []
        job = Job(name="unit", device=device, folder=str(folder), seed=5)
        self.n_frames_at: dict[str, int] = {}
        """Frames that had come when something was reported for the last time."""
        self.device = FakeDevice(job, read_ahead(mission(n_pings)), self._hear_report)
        self._kind = device
        self._bus = N2kBus("unit")
        self._decoder: Any = None
        if device.is_sonar:
            self._decoder = sonar_named(device.device).decoder(SonarConfig())
        elif device.link != "slcan":
            self._decoder = text_decoder({"pixse": "nmea0183"}.get(device.device, device.device), "unit")

    def _hear_report(self, what: str, details: dict[str, Any]) -> None:
        self.reports.append((what, details))
        self.n_frames_at[what] = len(self.frames)

    @property
    def counters(self) -> Any:
        return (self._decoder or self._bus).counters

    @property
    def frames(self) -> list[SonarFrame]:
        return [item for item in self.reported if isinstance(item, SonarFrame)]

    async def run(self, extra: Callable[[Link[Any]], Awaitable[None]] | None = None) -> None:
        """Until the mission is over and everything has arrived."""
        start: asyncio.Future[float] = asyncio.get_running_loop().create_future()
        playing = asyncio.ensure_future(self.device.run(start))
        await asyncio.sleep(0.01)
        link = self._link()
        listening = asyncio.ensure_future(link.run())
        while link.state != "up":
            await asyncio.sleep(0.005)
        start.set_result(time.monotonic() + 0.05)
        if extra is not None:
            await extra(link)
        await playing
        await asyncio.sleep(0.1)
        listening.cancel()
        await asyncio.gather(listening, return_exceptions=True)
        await self.device.wire.close()

    def _link(self) -> Link[Any]:
        address = parse_link_uri(self.device.wire.uri, "link")
        if self._kind.link == "slcan":
            return can_link(
                address,
                lambda frame, stamp: self._take(self._bus.feed(*frame[:2], stamp)),
                self._on_state,
                SystemClock(),
            )
        self._opened = byte_link(address, self._on_bytes, self._on_state, SystemClock())
        return self._opened

    def _on_bytes(self, data: bytes, stamp: Stamp) -> None:
        self._take(self._decoder.feed(data, stamp))

    def _take(self, items: list[Any]) -> None:
        self.reported += items

    def _on_state(self, state: str, reason: str) -> None:
        if state == "up" and self._kind.is_sonar:
            settings = SonarSettings(range_m=15.0 if self._kind.device == "sportscan" else 10.0, n_samples=200)
            for command in sonar_named(self._kind.device).commands(settings):
                self._opened.write(command)


def played(
    folder: Path, device: Device, n_pings: int = N_PINGS, extra: Callable[[Link[Any]], Awaitable[None]] | None = None
) -> Bench:
    async def main() -> Bench:
        bench = Bench(folder, device, n_pings)
        await bench.run(extra)
        return bench

    return asyncio.run(main())


def sonar(*faults: Fault, **changes: Any) -> Device:
    return msgspec.structs.replace(Device(device="ping_protocol", baud=921600, faults=faults), **changes)


@pytest.mark.parametrize("link", ["serial", "udp", "tcp"])
def test_a_sonar_pings_on_every_wire_at_its_own_times(tmp_path: Path, link: Any) -> None:
    bench = played(tmp_path, sonar(link=link))
    assert [frame.number for frame in bench.frames] == list(range(N_PINGS))
    times_s = np.array([frame.device_time_s for frame in bench.frames], dtype=np.float64)
    np.testing.assert_allclose(np.diff(times_s), PERIOD_S, atol=1.01e-3)  # whole milliseconds
    assert bench.reports[-1][0] == "done"
    assert ("settings", {"applied": "on, 10 m, automatic gain, 200 results"}) in bench.reports


def test_jsf_on_tcp_and_sport_scan_on_serial_serve_as_well(tmp_path: Path) -> None:
    assert len(played(tmp_path, Device(device="jsf", link="tcp")).frames) == N_PINGS

    async def ask(link: Link[Any]) -> None:
        for _ in range(4):
            await asyncio.sleep(0.15)
            for command in sonar_named("sportscan").commands(SonarSettings(range_m=15.0)):
                link.write(command)

    assert 3 <= len(played(tmp_path, Device(device="sportscan"), extra=ask).frames) <= 5


@pytest.mark.parametrize("name", ["nmea0183", "pixse", "pd6", "water_linked", "nmea2000"])
def test_navigation_units_report_every_sample(tmp_path: Path, name: Any) -> None:
    bench = played(tmp_path, Device(device=name, link="slcan" if name == "nmea2000" else "serial"))
    fixes = [item for item in bench.reported if isinstance(item, NavFix)]
    headings = sum(fix.heading_rad == pytest.approx(0.5, abs=1e-3) for fix in fixes)
    attitudes = sum(math.isfinite(fix.pitch_rad) for fix in fixes)
    assert (attitudes if name == "water_linked" else headings) >= N_PINGS - 1  # a burst ends with the next one
    assert not any("refused" in counter for counter in bench.counters)


@pytest.mark.parametrize("link", ["serial", "slcan"])
def test_a_port_opens_in_a_folder_with_blanks_and_umlauts_in_its_name(tmp_path: Path, link: Any) -> None:
    (folder := tmp_path / "büro 50% #1?").mkdir()
    bench = played(folder, Device(device="nmea0183" if link == "serial" else "nmea2000", link=link), n_pings=3)
    assert any(isinstance(item, NavFix) for item in bench.reported)


def test_a_cable_that_is_pulled_comes_back_with_the_same_counter_and_one_without_power_with_a_new_one(
    tmp_path: Path,
) -> None:
    out = played(tmp_path, sonar(Unplug(at_s=0.3, for_s=0.3)), 40)
    assert [what for what, _ in out.reports] == ["ready", "settings", "fault", "mended", "reopened", "done"]
    numbers = [frame.number for frame in out.frames]
    assert numbers == sorted(set(numbers))
    assert 0 < len(numbers) < 40
    assert numbers[-1] == 39
    off = played(tmp_path, sonar(PowerOff(at_s=0.3, for_s=0.3)), 40)
    assert [what for what, _ in off.reports].count("settings") == 2
    restarted = [frame.number for frame in off.frames]
    assert restarted.count(0) == 2
    times_s = [frame.device_time_s or 0.0 for frame in off.frames]
    assert times_s[restarted.index(0, 1)] < times_s[restarted.index(0, 1) - 1]


def test_a_stalled_line_is_silent_and_goes_on(tmp_path: Path) -> None:
    bench = played(tmp_path, sonar(Stall(at_s=0.2, for_s=0.3)))
    numbers = [frame.number for frame in bench.frames]
    assert (numbers[0], numbers[-1]) == (0, N_PINGS - 1)
    assert bench.device.counters["port.cut"] > 0
    assert [what for what, _ in bench.reports] == ["ready", "settings", "fault", "mended", "done"]


def test_garbage_fills_the_line_and_costs_no_message(tmp_path: Path) -> None:
    bench = played(tmp_path, sonar(Garbage(at_s=0.1, for_s=0.5)))
    assert bench.device.counters["port.overrun"] == 0
    assert len(bench.frames) == N_PINGS
    assert bench.counters["ping_protocol.bytes_skipped"] > 1000


def test_at_the_wrong_rate_nothing_is_read_until_it_is_right(tmp_path: Path) -> None:
    bench = played(tmp_path, sonar(WrongBaud(at_s=0.0, for_s=0.4, baud=460800)))
    assert bench.n_frames_at["mended"] == 0
    assert bench.frames[-1].number == N_PINGS - 1


def test_damage_is_refused_and_the_same_every_time(tmp_path: Path) -> None:
    damage = Damage(at_s=0.0, rates=FaultRates(lose=0.2, double=0.2))
    runs = [played(tmp_path, sonar(damage)) for _ in range(2)]
    reported = [[(frame.number, frame.port is None, frame.starboard is None) for frame in run.frames] for run in runs]
    assert reported[0] == reported[1]
    assert runs[0].device.counters["fault.lost"] > 0


def test_a_devices_clock_steps_there_and_back(tmp_path: Path) -> None:
    bench = played(tmp_path, sonar(ClockStep(at_s=0.2, for_s=0.3, by_s=100.0)))
    steps_s = np.diff([frame.device_time_s or 0.0 for frame in bench.frames])
    assert np.count_nonzero(steps_s > 99.0) == 1
    assert np.count_nonzero(steps_s < -99.0) == 1


def test_a_frozen_unit_repeats_itself_and_a_wrong_one_deviates(tmp_path: Path) -> None:
    frozen = played(tmp_path, Device(device="nmea0183", faults=(Freeze(at_s=0.2),)))
    places = [fix.latitude_deg for fix in frozen.reported if fix.latitude_deg == fix.latitude_deg]
    assert len(places) == N_PINGS
    assert len(set(places)) < N_PINGS // 2
    wrong = played(tmp_path, Device(device="nmea0183", faults=(Offset(at_s=0.0, north_m=1111.0, heading_deg=10.0),)))
    last = [fix for fix in wrong.reported if fix.latitude_deg == fix.latitude_deg][-1]
    assert last.latitude_deg == pytest.approx(43.01, abs=1e-4)
    assert {round(fix.heading_rad, 2) for fix in wrong.reported[-5:] if fix.heading_rad == fix.heading_rad} == {0.67}


def test_a_device_of_its_own_ends_with_its_standard_input_and_takes_its_port_along(tmp_path: Path) -> None:
    job = tmp_path / "job.yaml"
    reported = {"name": "unit", "folder": str(tmp_path), "scene": "demo", "device": {"device": "nmea0183"}}
    job.write_text(yaml.safe_dump(reported), "utf-8")
    arguments = [sys.executable, "-m", "sim_replay.fakes", str(job)]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        assert (ready["what"], ready["uri"]) == ("ready", f"serial://{tmp_path}/unit?baud=115200")
        assert (tmp_path / "unit").is_symlink()
        process.stdin.close()
        lines = [json.loads(line) for line in process.stdout]
        assert process.wait(30) == 0
    assert lines[-1]["what"] == "counters"
    assert not (tmp_path / "unit").is_symlink()


def test_a_device_may_begin_at_once_and_ends_with_its_mission(tmp_path: Path) -> None:
    log = written(tmp_path / "mission.xtf")
    job = tmp_path / "job.yaml"
    job.write_text(
        yaml.safe_dump({"name": "unit", "folder": str(tmp_path), "log": str(log), "device": {"device": "pd6"}}), "utf-8"
    )
    arguments = [sys.executable, "-m", "sim_replay.fakes", str(job), "--now"]
    done = subprocess.run(arguments, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60, check=True)
    reports = [json.loads(line) for line in done.stdout.splitlines()]
    assert [report["what"] for report in reports] == ["ready", "done", "counters"]
    assert reports[-1]["device.messages"] == 8
    assert not (tmp_path / "unit").is_symlink()


def test_an_impossible_device_is_rejected_with_the_reason_in_one_line(tmp_path: Path) -> None:
    job = tmp_path / "job.yaml"
    job.write_text("{name: unit, folder: here, log: nowhere.xtf, device: {device: pd6}}", "utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "sim_replay.fakes", str(job)], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith("fake device: nowhere.xtf does not exist")


@pytest.mark.parametrize("link", ["udp", "tcp"])
def test_a_flood_of_maximum_cost_costs_no_message(tmp_path: Path, link: Any) -> None:
    bench = played(tmp_path, sonar(Flood(at_s=0.1, for_s=0.5, bytes_per_s=50_000.0), link=link))
    assert len(bench.frames) == N_PINGS
    assert bench.device.counters["device.flood_bytes"] >= 10_000
    assert bench.counters["ping_protocol.bytes_skipped"] > 5_000
