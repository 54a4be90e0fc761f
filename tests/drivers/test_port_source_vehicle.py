"""Check a vehicle at a port: navigation, contact reports, commands while granted, and release. The wires are in
memory."""

from __future__ import annotations

import asyncio
import itertools
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Literal

import pytest

from auv_mcm.clock import Clock, Stamp, SystemClock
from auv_mcm.errors import HardwareError, UsageError
from auv_mcm.records import Contact, NavSample, Notice, SourceEvent, Waypoint
from auv_mcm.settings.config import Config
from auv_mcm.settings.port_settings import PortConfig
from auv_mcm.settings.vehicle_settings import VEHICLE_NAMES
from auv_mcm.source import LiveSource
from drivers.framing import StampedFramer
from drivers.links.can_frame import CanFrame
from drivers.links.link import Link
from drivers.port_source import OnBytes, OnState, PortSource
from drivers.port_stream import pack_can
from drivers.ports import PortSettings, read_ports
from drivers.recording.session_layout import Recorded
from drivers.vehicle.can_receiver import CanReceiver
from drivers.vehicle.imc_crc import crc16_arc
from drivers.vehicle.pilot import Pilot
from drivers.vehicle.vehicles import VEHICLES
from sim_replay.fakes.vehicles.bluefin import FakeBluefin
from sim_replay.fakes.vehicles.can import FakeCan
from sim_replay.fakes.vehicles.fake_vehicle import FakeController
from sim_replay.fakes.vehicles.imc import FakeImc
from sim_replay.fakes.vehicles.iver import FakeIver
from sim_replay.fakes.vehicles.recon import FakeRecon
from sim_replay.logs.recorded import open_mission
from sim_replay.wire_logs import Run, write_session
from tests.auv_mcm.classify import drawn_looks
from tests.drivers.port_traffic import Collected, MemoryWire, config_of
from tests.make.records import nav_of, waypoint_of

GENEROUS_S = 15.0
VEHICLE = "vehicle: {command: true, fence_deg: [[42.99, 4.99], [42.99, 5.01], [43.01, 5.01], [43.01, 4.99]]}\n"
IMC = "ports: [{name: v, link: 'tcp://10.0.0.2:6002', device: imc, imc: {acknowledges: true}}]"
CAN = "ports: [{name: v, link: 'slcan:///dev/ttyUSB0?bitrate=250000', device: vehicle_can}]"
WITH_NAVIGATION = ", navigation: {priority: 2}}]"
BLUEFIN = "ports: [{name: v, link: 'tcp://10.0.0.2:29500', device: bluefin}]"
IVER = "ports: [{name: v, link: 'serial:///dev/ttyS0?baud=19200', device: iver, iver: {command_timeout_s: 2}}]"
RECON = "ports: [{name: v, link: 'udp://10.0.0.2:23456', device: recon}]"
DIALECTS: list[tuple[str, Callable[[], FakeController[Any]]]] = [
    (IMC, FakeImc),
    (BLUEFIN, FakeBluefin),
    (IVER, FakeIver),
    (RECON, FakeRecon),
    (CAN, FakeCan),
]
each_dialect = pytest.mark.parametrize(("text", "make"), DIALECTS, ids=[make.__name__ for _, make in DIALECTS])


class Wire(MemoryWire):
    """Fake the vehicle's computer at the other end of a wire in memory."""

    def __init__(self, controller: FakeController[Any]) -> None:
        super().__init__()
        self.controller = controller

    def tick(self, now_s: float) -> None:
        if self.plugged:
            pose = nav_of(1.7e9 + now_s, heading_rad=1.0, altitude_m=6.0)
            self.waiting += self.controller.tick(pose, False, now_s)

    def write(self, item: Any) -> bool:
        self.waiting += self.controller.heard(item, SystemClock().monotonic_s())
        return True


class Bench:
    """Run a source with a vehicle at its port, and collect its events."""

    def __init__(self, text: str, controller: FakeController[Any]) -> None:
        self.config: Config = config_of(VEHICLE + text)
        self.wire = Wire(controller)
        self.controller = controller
        self.events: list[SourceEvent] = []
        self.recorded: list[tuple[str, Literal["in", "out"], Stamp, bytes]] = []
        self.source = PortSource(self.config, SystemClock(), self._open)
        self.source.record_with(lambda *chunk: self.recorded.append(chunk))
        assert self.source.vehicle is not None
        self.vehicle = self.source.vehicle

    def _open(self, port: PortSettings, on_bytes: OnBytes, on_state: OnState, clock: Clock) -> Link[Any]:
        async def open_port(counters: Counter[str]) -> Any:
            if not self.wire.plugged:
                raise HardwareError("there is no wire; plug one in")
            self.controller.connected(clock.monotonic_s())
            return self.wire

        on_item = (lambda frame, stamp: on_bytes(pack_can(frame), stamp)) if port.is_bus else on_bytes
        return Link(port.name, open_port, on_item, on_state, clock, 60.0)

    def run(self, *steps: Callable[[], bool | None], after_events: tuple[Callable[[], bool | None], ...] = ()) -> None:
        """Serve while each step in turn is done or, if it says False, waited for; then some more after `events` have
        ended."""

        async def main() -> None:
            serving = [asyncio.ensure_future(job) for job in (self.source.serve_vehicle(), self._tick())]
            reading = asyncio.ensure_future(self._read())
            await self._all(steps)
            self.source.stop()
            await asyncio.wait_for(reading, GENEROUS_S)
            await self._all(after_events)
            for task in serving:
                task.cancel()
            await asyncio.wait(serving)

        asyncio.run(main())

    async def _all(self, steps: tuple[Callable[[], bool | None], ...]) -> None:
        for step in steps:
            async with asyncio.timeout(GENEROUS_S):
                while step() is False:
                    await asyncio.sleep(0.005)

    async def _tick(self) -> None:
        while True:
            self.wire.tick(SystemClock().monotonic_s())
            await asyncio.sleep(0.05)

    async def _read(self) -> None:
        sink = Collected()
        self.events = sink.events
        await self.source.run(sink)

    def is_heard(self) -> bool:
        return self.vehicle.authority != "down"

    def has_reported(self, n_reports: int) -> Callable[[], bool]:
        return lambda: self.controller.counters["vehicle.reports"] >= n_reports


def contact(number: int, p_mine: float = 0.9) -> Contact:
    return drawn_looks.contact(
        id=f"C{number:05d}",
        time_s=1.7e9,
        latitude_deg=43.001,
        longitude_deg=5.001,
        p_mine=p_mine,
        classification="cylinder",
        belief={"cylinder": 0.8, "unknown": 0.2},
        length_m=2.0,
    )


def plan() -> tuple[Waypoint, ...]:
    places = [("start", 43.0), ("leg_entry", 43.0005), ("leg_exit", 43.001)]
    return tuple(waypoint_of(kind, latitude_deg, 5.0) for kind, latitude_deg in places)


def test_every_vehicle_that_a_configuration_may_name_has_its_dialect_and_a_section_called_like_it() -> None:
    assert set(VEHICLES) == set(VEHICLE_NAMES) <= set(PortConfig.__struct_fields__)


@each_dialect
def test_the_vehicle_is_heard_and_informed_and_every_word_is_recorded(
    text: str, make: Callable[[], FakeController[Any]]
) -> None:
    bench = Bench(text, make())
    assert isinstance(bench.source, LiveSource)

    def hears_of_it() -> bool:
        return any("the sonar is silent" in text for text in bench.controller.take_health())

    bench.run(
        bench.is_heard,
        lambda: bench.vehicle.report(contact(1)),
        bench.has_reported(1),
        lambda: bench.vehicle.report_health("fault", "the sonar is silent"),
        hears_of_it,
    )
    (report,) = bench.controller.take_reports()
    assert (report.number, report.revision) == (1, 1)
    assert abs(report.session - SystemClock().utc_s()) < 60.0
    ways = Counter(way for port, way, _, _ in bench.recorded if port)
    assert ways["in"] > 0
    assert ways["out"] == bench.source.counters()["port.v.messages_sent"] > 0
    assert not [event for event in bench.events if isinstance(event, NavSample)]


@each_dialect
def test_where_the_vehicle_says_it_is_serves_as_navigation_if_that_is_wanted(
    text: str, make: Callable[[], FakeController[Any]]
) -> None:
    bench = Bench(text.replace("}]", WITH_NAVIGATION), make())
    bench.run(
        lambda: any(isinstance(event, NavSample) and event.latitude_deg == event.latitude_deg for event in bench.events)
    )
    sample = next(
        event for event in bench.events if isinstance(event, NavSample) and event.latitude_deg == event.latitude_deg
    )
    assert abs(sample.latitude_deg - 43.0) < 1e-6
    assert abs(sample.longitude_deg - 5.0) < 1e-6


@each_dialect
def test_a_plan_is_flown_when_it_is_granted_and_control_goes_back_even_after_the_source_has_ended(
    text: str, make: Callable[[], FakeController[Any]]
) -> None:
    bench = Bench(text, make())
    bench.run(
        bench.is_heard,
        lambda: bench.vehicle.propose(plan()),
        lambda: bench.vehicle.authority == "granted" and bench.controller.command is not None,
        after_events=(
            lambda: bench.vehicle.release("the service ends"),
            lambda: not bench.controller.in_control,
            lambda: bench.vehicle.propose(plan()),
        ),
    )
    assert not bench.controller.in_control
    assert bench.source.counters()["vehicle.granted"] == 1


@each_dialect
def test_what_the_vehicle_says_after_the_source_has_ended_is_no_navigation_of_a_replay(
    text: str, make: Callable[[], FakeController[Any]], tmp_path: Path
) -> None:
    bench = Bench(text.replace("}]", WITH_NAVIGATION), make())
    n_heard: list[int] = []  # chunks, from the end of the source on

    def is_heard_on() -> bool:
        n_heard.append(sum(way == "in" for _, way, _, _ in bench.recorded))
        return n_heard[-1] >= n_heard[0] + 10

    bench.run(lambda: sum(isinstance(event, NavSample) for event in bench.events) > 3, after_events=(is_heard_on,))
    chunks = tuple(Recorded(port, way, stamp, data) for port, way, stamp, data in bench.recorded)
    session = write_session(Run(bench.config, chunks, 0.0), tmp_path / "recording")
    replayed = [str(event) for event in open_mission([session], bench.config).events()]
    assert replayed == [str(event) for event in bench.events if not isinstance(event, Notice)]


def test_after_the_wire_was_pulled_what_was_not_acknowledged_is_reported_and_once_only() -> None:
    bench = Bench(CAN, FakeCan())

    def plug(there: bool) -> Callable[[], None]:
        return lambda: setattr(bench.wire, "plugged", there)

    bench.run(
        bench.is_heard,
        lambda: bench.vehicle.report(contact(1)),
        bench.has_reported(1),
        plug(False),
        lambda: bench.vehicle.authority == "down",
        lambda: bench.vehicle.report(contact(2)),
        plug(True),
        bench.has_reported(2),
    )
    assert [report.number for report in bench.controller.take_reports()] == [1, 2]
    assert "port v is up" not in bench.source.faults()


def test_a_pilot_that_fails_gives_control_back_for_good_and_the_mission_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def failing(self: Pilot[Any], contact: Contact) -> None:
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(Pilot, "report", failing)
    bench = Bench(IMC, FakeImc())
    bench.run(
        bench.is_heard,
        lambda: bench.vehicle.propose(plan()),
        lambda: bench.controller.in_control and bench.vehicle.authority == "granted",
        lambda: bench.vehicle.report(contact(1)),
        lambda: not bench.controller.in_control and bench.vehicle.authority == "listening",
        lambda: bench.vehicle.propose(plan()),
    )
    assert [notice.code for notice in bench.vehicle.take_notices()].count("vehicle_failed") == 1
    assert bench.source.counters()["vehicle.failed"] == 1
    assert not bench.controller.in_control


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            IMC.replace("tcp://10.0.0.2:6002", "slcan:///dev/ttyUSB0?bitrate=250000"),
            "ports[0].link 'slcan:///dev/ttyUSB0?bitrate=250000': a device 'imc' needs a serial:",
        ),
        (
            CAN.replace("slcan:///dev/ttyUSB0?bitrate=250000", "udp://h:1"),
            "a device 'vehicle_can' needs a slcan:// or socketcan:// link",
        ),
        (
            IMC.replace("imc: {acknowledges: true}", "bluefin: {}"),
            "a section 'bluefin' is for a device 'bluefin', and this one is a 'imc'",
        ),
        (IMC.replace("acknowledges: true", "source_id: 1"), ">= 24576 - at `ports[0].imc.source_id`"),
        (IMC.replace("imc: {acknowledges: true}", "sonar: {}"), "'imc' is not a sonar"),
        (
            "vehicle: {fence_deg: [[43, 5], [43.01, 5.01], [43.01, 5], [43, 5.01]]}\n" + IMC,
            "fence_deg encloses no area; give its corners in order",
        ),
    ],
)
def test_ports_of_vehicles_that_cannot_be_are_refused_with_the_key(text: str, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        read_ports(config_of(text))
    assert message in str(caught.value)


@each_dialect
def test_each_byte_of_the_vehicle_is_decoded_once(
    text: str, make: Callable[[], FakeController[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded: list[Any] = []
    bytes_of = StampedFramer.feed
    frames_of = CanReceiver.add

    def feed(framer: StampedFramer[Any], data: bytes, stamp: Stamp) -> Any:
        decoded.append(data)
        return bytes_of(framer, data, stamp)

    def add(receiver: CanReceiver, frame: CanFrame, now_s: float) -> Any:
        if receiver._sender == "vehicle":  # not the fake's
            decoded.append(pack_can(frame))
        return frames_of(receiver, frame, now_s)

    monkeypatch.setattr(StampedFramer, "feed", feed)
    monkeypatch.setattr(CanReceiver, "add", add)
    bench = Bench(text.replace("}]", WITH_NAVIGATION), make())
    bench.run(bench.is_heard, lambda: len(bench.recorded) > 20)
    assert decoded == [data for port, way, _, data in bench.recorded if port == "v" and way == "in"]


def test_what_waited_when_the_wire_was_lost_grants_nothing_on_the_next_connection() -> None:
    readings = itertools.count(1)
    heard: list[bytes] = []

    class Ears:
        """In the place of the vehicle's end: what is handed on to it."""

        counters: ClassVar = Counter[str]()

        def hear(self, said: Any, stamp: Stamp) -> None:
            heard.extend(b"" for _ in said)

        def connected(self) -> None:
            heard.append(b"connected")

        disconnected = connected

    states: list[OnState] = []

    def open_link(port: PortSettings, on_bytes: OnBytes, on_state: OnState, clock: Clock) -> Link[Any]:
        states.append(on_state)
        return Link(port.name, lambda counters: asyncio.Future(), on_bytes, on_state, clock, 60.0)

    # Each chunk takes more than a turn, so that the second waits.
    source = PortSource(config_of(VEHICLE + IMC), SystemClock(), open_link, cpu_s=lambda: next(readings) // 2 * 1.0)
    (served,) = source._ports
    served.vehicle = Ears()  # type: ignore[assignment]  # hears alone
    heartbeat = bytes.fromhex("54fe9600000000001040fc54d9411e00ffff00ff")
    heartbeat += crc16_arc(heartbeat).to_bytes(2, "little")
    stamp = Stamp(SystemClock().monotonic_s().__trunc__() * 10**9, 0)

    async def main() -> None:
        source.take("v", heartbeat, stamp)
        source.take("v", heartbeat, stamp)
        states[0]("up", "opened anew")
        async with asyncio.timeout(GENEROUS_S):
            while source.counters()["imc.messages"] < 2:
                await asyncio.sleep(0)

    asyncio.run(main())
    assert heard == [b"", b"connected"], "the second message came over a wire that is gone"
