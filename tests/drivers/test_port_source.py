"""Check live ports as a source: data, recording, requests and notices, whatever wires do. The wires are in memory."""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest

from auv_mcm.clock import Clock, Stamp, SystemClock
from auv_mcm.errors import HardwareError, UsageError
from auv_mcm.records import NavSample, Notice, Ping, SourceEvent
from auv_mcm.settings.config import Config
from auv_mcm.shell.event_queue import EventQueue
from auv_mcm.shell.sources import parse_source_uri
from auv_mcm.source import LiveSource, QuantityState
from drivers.links.link import Link
from drivers.port_intake import PortIntake
from drivers.port_source import OnBytes, OnState, PortSource, open_source
from drivers.ports import PortSettings, read_ports
from tests.drivers.port_traffic import PORTS, Collected, MemoryWire, config_of, fix, profile, traffic

GENEROUS_S = 10.0
ASKED = (
    "ports: [{name: s, link: 'serial:///dev/ttyS0?baud=115200', device: sportscan, sonar: {range_m: 30, "
    "ping_interval_s: 0.02}}]"
)


class Wire(MemoryWire):
    """Fake a far end in memory."""

    def __init__(self) -> None:
        super().__init__()
        self.written: list[bytes] = []

    def send(self, data: bytes) -> None:
        self.waiting.append(data)

    def write(self, item: bytes) -> bool:
        self.written.append(item)
        return True


class Bench:
    """Run a source on wires in memory, and collect its events."""

    def __init__(self, text: str = PORTS, silent_s: float = 60.0, clock: Clock | None = None) -> None:
        self.config: Config = config_of(text)
        self.wires = {port.name: Wire() for port in read_ports(self.config)}
        self.events: list[SourceEvent] = []
        self.recorded: list[tuple[str, str, Stamp, bytes]] = []
        self.defects: list[Exception] = []
        self._silent_s = silent_s
        self.source = PortSource(self.config, clock or SystemClock(), self._open)
        self.source.record_with(lambda *chunk: self.recorded.append(chunk))

    def _open(self, port: PortSettings, on_bytes: OnBytes, on_state: OnState, clock: Clock) -> Link[bytes]:
        async def open_port(counters: Counter[str]) -> Any:
            if self.defects:
                raise self.defects.pop()
            if not self.wires[port.name].plugged:
                raise HardwareError("there is no wire; plug one in")
            return self.wires[port.name]

        return Link(port.name, open_port, on_bytes, on_state, clock, self._silent_s)

    def run(self, *steps: Callable[[], bool | None]) -> None:
        """Run the source while each step in turn is done or, if it says False, waited for."""

        async def main() -> None:
            reading = asyncio.ensure_future(self._read())
            for step in steps:
                async with asyncio.timeout(GENEROUS_S):
                    while step() is False:
                        await asyncio.sleep(0.005)
            self.source.stop()
            async with asyncio.timeout(GENEROUS_S):
                await reading

        asyncio.run(main())

    async def _read(self) -> None:
        sink = Collected()
        self.events = sink.events
        await self.source.run(sink)

    def state_is(self, name: str, state: str) -> Callable[[], bool]:
        return lambda: (name, state) in self.states()

    def states(self) -> list[tuple[str, str]]:
        return [(port.name, port.state) for port in self.source.health().ports]

    def codes(self) -> list[str]:
        return [event.code for event in self.events if isinstance(event, Notice)]


def test_what_comes_live_is_what_its_recording_comes_to() -> None:
    bench = Bench()

    def send() -> None:
        for chunk in traffic(20):
            bench.wires[chunk.port].send(chunk.data)

    bench.run(
        bench.state_is("sonar", "up"),
        bench.state_is("gnss", "up"),
        send,
        lambda: sum(c[1] == "in" for c in bench.recorded) >= 60,
    )
    intake = PortIntake(bench.config)
    replayed = [
        event for port, way, stamp, data in bench.recorded if way == "in" for event in intake.feed(port, data, stamp)
    ]
    reported = [event for event in bench.events if not isinstance(event, Notice)]
    assert [str(event) for event in reported] == [str(event) for event in replayed + intake.finish()]
    assert sum(isinstance(event, Ping) for event in reported) == 20
    assert any(isinstance(event, NavSample) for event in reported)
    assert isinstance(bench.source, LiveSource)


def test_a_sonar_is_set_to_ping_at_the_start_and_when_it_comes_back() -> None:
    bench = Bench()
    wire, commands = bench.wires["sonar"], list(read_ports(bench.config)[0].commands)

    def plug(there: bool) -> Callable[[], None]:
        return lambda: setattr(wire, "plugged", there)

    bench.run(
        bench.state_is("sonar", "up"),
        plug(False),
        bench.state_is("sonar", "down"),
        plug(True),
        bench.state_is("sonar", "up"),
    )
    assert wire.written == commands * 2
    assert [(port, data) for port, way, _, data in bench.recorded if way == "out"] == [
        ("sonar", command) for command in commands * 2
    ]
    assert bench.wires["gnss"].written == []
    assert bench.source.counters()["port.sonar.commands_sent"] == 4


def test_a_silent_sonar_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.port_source._ASK_AGAIN_S", 0.05)
    bench = Bench(silent_s=0.1)
    bench.run(bench.state_is("sonar", "silent"), lambda: len(bench.wires["sonar"].written) >= 6)


def test_a_sonar_that_pings_when_asked_is_asked_without_end() -> None:
    bench = Bench(ASKED)
    bench.run(lambda: len(bench.wires["s"].written) >= 5)
    assert len(set(bench.wires["s"].written)) == 1


def test_states_are_reported_and_shown() -> None:
    bench = Bench(silent_s=0.1)
    assert bench.states() == [("sonar", "down"), ("gnss", "down")]
    bench.run(
        bench.state_is("sonar", "silent"),
        lambda: bench.wires["sonar"].send(profile(1, 0, 0.0) + profile(1, 1, 0.0)),
        bench.state_is("sonar", "up"),
        lambda: setattr(bench.wires["sonar"], "plugged", False),
        bench.state_is("sonar", "down"),
    )
    reported = [event for event in bench.events if isinstance(event, Notice) and event.place == "sonar"]
    assert [notice.code for notice in reported][:4] == ["port_up", "port_silent", "port_up", "port_down"]
    assert [notice.for_the_record for notice in reported][:4] == [True, False, False, False], (
        "a port that opens asks nothing of anybody"
    )
    assert "the wire was pulled; plug it in again" in reported[3].text
    assert 0.0 <= bench.source.health().ports[0].ping_age_s < GENEROUS_S


def test_health_has_what_each_port_received_and_who_serves_position() -> None:
    bench = Bench()
    before = bench.source.health()
    assert [(port.received_bytes, port.age_s) for port in before.ports] == [(0, math.inf)] * 2
    assert before.quantities == (QuantityState("position", "", math.inf),)
    data = fix(0.0, 43.0, 5.0)

    def position() -> QuantityState:
        return next(quantity for quantity in bench.source.health().quantities if quantity.name == "position")

    bench.run(
        bench.state_is("gnss", "up"),
        lambda: bench.wires["gnss"].send(data),
        lambda: position().served_by == "gnss" and 0.0 <= position().age_s < GENEROUS_S,
    )
    sonar, gnss = bench.source.health().ports
    assert (sonar.received_bytes, gnss.received_bytes, gnss.discarded_bytes) == (0, len(data), 0)
    assert 0.0 <= gnss.age_s < GENEROUS_S
    assert math.isnan(gnss.ping_age_s)
    assert sonar.ping_age_s == math.inf


def test_a_wire_that_comes_and_goes_is_reported_of_so_often_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.port_source._MAX_STATE_NOTICES", 3)
    bench = Bench()
    wire = bench.wires["gnss"]
    flaps = [
        step
        for there in (False, True) * 2
        for step in (
            lambda there=there: setattr(wire, "plugged", there),
            bench.state_is("gnss", "up" if there else "down"),
        )
    ]
    bench.run(bench.state_is("gnss", "up"), *flaps)
    reported = [event.text for event in bench.events if isinstance(event, Notice) and event.place == "gnss"]
    assert len(reported) == 3
    assert reported[-1].endswith("only counted.")
    assert bench.source.counters()["port.gnss.state_changes"] >= 5


def test_a_link_that_fails_by_a_defect_is_reported_and_opened_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.port_source._RESTART_S", 0.01)
    bench = Bench()
    bench.defects = [ZeroDivisionError("a defect")]
    bench.run(bench.state_is("sonar", "up"), bench.state_is("gnss", "up"))
    assert bench.codes().count("port_failed") == 1
    counters = bench.source.counters()
    assert counters["port.sonar.failed"] + counters["port.gnss.failed"] == 1


def test_a_decoder_that_takes_seconds_is_named_once(monkeypatch: pytest.MonkeyPatch) -> None:
    class LateClock(SystemClock):
        late_s = 0.0

        def monotonic_s(self) -> float:
            return super().monotonic_s() + self.late_s

    def feed(self: PortIntake, port: str, data: bytes, stamp: Stamp) -> list[SourceEvent]:
        clock.late_s += 3.0 * (port == "gnss")
        return as_it_is(self, port, data, stamp)

    clock, as_it_is = LateClock(), PortIntake.feed
    monkeypatch.setattr(PortIntake, "feed", feed)
    bench = Bench(clock=clock)

    def send() -> None:
        bench.wires["gnss"].send(b"word")

    def is_read(n_words: int) -> Callable[[], bool]:
        return lambda: sum(data == b"word" for *_, data in bench.recorded) >= n_words

    bench.run(bench.state_is("gnss", "up"), send, is_read(1), send, is_read(2))
    (notice,) = [event for event in bench.events if isinstance(event, Notice) and event.code == "decoder_slow"]
    assert notice.text.startswith("decoding 4 bytes of port 'gnss' took 3.0 s")


def test_units_that_fall_silent_are_missed_by_the_clock() -> None:
    bench = Bench(PORTS.replace("nmea0183", "nmea0183, navigation: {valid_s: 0.2}"))
    bench.run(
        bench.state_is("gnss", "up"),
        lambda: bench.wires["gnss"].send(fix(0.0, 43.0, 5.0)),
        lambda: "nav_quantity_lost" in bench.codes(),
    )


def test_at_the_end_what_was_held_back_is_given() -> None:
    bench = Bench()
    bench.run(
        bench.state_is("gnss", "up"),
        lambda: bench.wires["gnss"].send(fix(0.0, 43.0, 5.0)),
        lambda: any(port == "gnss" for port, *_ in bench.recorded),
    )
    assert any(isinstance(event, NavSample) for event in bench.events)
    assert bench.codes()[-1] != "port_down"


def test_what_nobody_takes_waits_in_the_queue_of_the_service_alone() -> None:
    """One queue: the oldest pings are dropped there, and counted once."""
    counters: Counter[str] = Counter()

    async def main() -> list[SourceEvent]:
        source = PortSource(config_of(), SystemClock(), cpu_s=lambda: 0.0)
        queue = EventQueue(4, counters)
        running = asyncio.ensure_future(source.run(queue))
        await asyncio.sleep(0)
        for chunk in traffic(20):
            source.take(*chunk)
        source.stop()
        await running
        queue.close()
        events = []
        while (queued := await queue.get()) is not None:
            events.append(queued.event)
        assert not any("dropped" in name for name in source.counters())
        return events

    events = asyncio.run(main())
    pings = [event.number for event in events if isinstance(event, Ping)]
    assert len(pings) == 4
    assert pings == sorted(pings)
    assert counters["service.ping_dropped"] == 20 - 4


def test_what_is_known_before_the_source_runs_is_given_first() -> None:
    open_port = "ports: [{name: n, link: 'udp://0.0.0.0:6001', device: nmea0183}]"
    sink = Collected()

    async def main() -> None:
        source = PortSource(config_of(open_port), SystemClock())
        source.raise_notice(Notice(code="early", text="before the source runs"))
        source.stop()
        await source.run(sink)
        source.raise_notice(Notice(code="late", text="after its end"))

    asyncio.run(main())
    assert [event.code for event in sink.events if isinstance(event, Notice)] == [
        *("port_open_to_all", "no_sonar", "early")
    ]


@pytest.mark.parametrize(
    ("uri", "text", "message"),
    [
        ("ports", "", "'auv-mcm run --example'"),
        ("ports:?speed=1", PORTS, "described in the section 'ports'"),
        ("ports:/dev/ttyS0", PORTS, "described in the section 'ports'"),
    ],
)
def test_ports_that_are_not_configured_are_asked_for(uri: str, text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        open_source(parse_source_uri(uri), config_of(text), SystemClock())


@pytest.mark.parametrize("uri", ["ports", "ports:"])
def test_ports_are_a_source(uri: str) -> None:
    assert open_source(parse_source_uri(uri), config_of(), SystemClock()).lossless is False
