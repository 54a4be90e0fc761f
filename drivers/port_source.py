"""Listen to every port, request pings, and record both ways, until stopped: the live source.

`PortIntake` decodes the bytes; here is only what needs an event loop.
"""

from __future__ import annotations

import asyncio
import logging
import math
import secrets
import time
from collections import Counter
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, Final

from auv_mcm.clock import Clock, Stamp
from auv_mcm.errors import UsageError
from auv_mcm.records import Notice, SourceEvent
from auv_mcm.settings.config import Config
from auv_mcm.source import EventSink, PortState, Record, SourceHealth, SourceUri
from drivers.backlog import Backlog, Chunk
from drivers.links.can_frame import CanFrame
from drivers.links.link import Link, LinkState
from drivers.links.open_link import byte_link, can_link
from drivers.links.uri import SerialAddress, SlcanAddress
from drivers.port_intake import NO_PORT, PortIntake
from drivers.port_stream import pack_can, slow_decoder
from drivers.ports import PortSettings, open_to_all, read_ports, without_sonar
from drivers.vehicle.dialect import VehicleMessage
from drivers.vehicle.pilot import Pilot
from drivers.vehicle.port_pilot import PortPilot
from drivers.vehicle.vehicles import talker_of

log = logging.getLogger(__name__)

OnBytes = Callable[[bytes, Stamp], None]
OnState = Callable[[LinkState, str], None]
OpenLink = Callable[[PortSettings, OnBytes, OnState, Clock], Link[bytes] | Link[CanFrame]]

_TICK_S: Final = 0.25  # s between looks at silence, settings and notices
_ASK_AGAIN_S: Final = 5.0  # a sonar that is silent, as it may have lost its settings with its supply
_MAX_STATE_NOTICES: Final = 20  # per port; a loose contact has no end of them
_RESTART_S: Final = 1.0  # s before a reader that failed is started again, so that a lasting fault does not fill the log
_SLOW_S: Final = 1.0  # s for one chunk: the worst junk takes 0.02 s, and a vehicle waits for a word each second
_LAST_TURNS: Final = 50  # 0.5 s of decoding at the end


def open_link(port: PortSettings, on_bytes: OnBytes, on_state: OnState, clock: Clock) -> Link[bytes] | Link[CanFrame]:
    """Make the link of a port; frames of a bus arrive packed into bytes."""
    if port.is_bus:
        return can_link(port.address, lambda frame, stamp: on_bytes(pack_can(frame), stamp), on_state, clock)
    return byte_link(port.address, on_bytes, on_state, clock)


def open_source(uri: SourceUri, config: Config, clock: Clock) -> PortSource:
    """Make the source of the configured ports. Raises UsageError for ports that cannot be, or if there are none."""
    if uri.path or uri.options:
        raise UsageError(
            f"service.source '{uri.text}': ports are described in the section 'ports'; write source: ports"
        )
    if not config.ports:
        raise UsageError(
            "service.source is 'ports', but no port is configured: add a section 'ports'; 'auv-mcm run --example' "
            "prints one"
        )
    return PortSource(config, clock)


class PortSource:
    """Serve the ports as the live source, which cannot make devices wait. It goes on whatever a wire or device does.

    What comes is recorded at once and decoded in the order in which it came, a bounded part in each turn of the event
    loop (`Backlog`). Its events go straight into the service's queue; nothing waits here.

    counters: those of `PortIntake`, of each link behind `port.NAME.`, port.NAME.commands_sent,
    port.NAME.commands_refused (by the wire), port.NAME.state_changes, port.NAME.failed (a link that ended, which is a
    defect), port.NAME.bytes_undecoded (that found no room in a flood). Of the vehicle's port, port.NAME.messages_sent
    and .messages_refused, and those of `PortPilot` and of the vehicle's decoder.
    """

    lossless = False

    def __init__(
        self,
        config: Config,
        clock: Clock,
        open_link: OpenLink = open_link,
        cpu_s: Callable[[], float] = time.thread_time,
    ) -> None:
        """cpu_s: processor time of this thread, in seconds. Raises UsageError for ports that cannot be."""
        self._clock = clock
        self._intake = PortIntake(config)
        self._record: Record | None = None
        self._own: Counter[str] = Counter()
        self._backlog = Backlog(cpu_s)
        self._turn_ends = False  # the end of this turn of the event loop is awaited
        self._stopped = asyncio.Event()
        self._ended = False
        ports = read_ports(config)
        self._unsuspected = {port.name: port.device for port in ports}  # of holding up everything else
        self._ports = [_ServedPort(port, self, open_link, clock, config) for port in ports]
        self._vehicle_port = next((port for port in self._ports if port.vehicle is not None), None)
        # from before `run`: its vehicle may be served first
        self._early: list[SourceEvent] = [*open_to_all(ports), *without_sonar(ports)]
        self._push: Callable[[SourceEvent], None] = self._early.append

    def record_with(self, record: Record) -> None:
        """Hand every byte to `record`, both ways, from here on."""
        self._record = record

    def stop(self) -> None:
        """Close all ports; `run` then delivers what was still held back, and returns."""
        self._stopped.set()

    @property
    def vehicle(self) -> PortPilot | None:
        """Return the vehicle's port, if there is one."""
        return None if self._vehicle_port is None else self._vehicle_port.vehicle

    async def serve_vehicle(self) -> None:
        """Talk to the vehicle until cancelled, whether or not `run` has begun or returned."""
        if self._vehicle_port is not None:
            await _together(self._vehicle_port.jobs())

    @property
    def is_stopping(self) -> bool:
        """Find whether a stop was requested."""
        return self._stopped.is_set()

    def health(self) -> SourceHealth:
        now_ns = self._now().mono_ns
        ports = tuple(
            PortState(
                name=port.name,
                state=port.state,
                received_bytes=port.received_bytes,
                discarded_bytes=self._backlog.n_refused[port.name],
                age_s=(now_ns - port.received_ns) * 1e-9 if port.received_bytes else math.inf,
                ping_age_s=(now_ns - self._intake.pinged_ns.get(port.name, -math.inf)) * 1e-9
                if port.gives_pings
                else math.nan,
            )
            for port in self._ports
        )
        return SourceHealth(ports, self._intake.quantities())

    def faults(self) -> list[str]:
        return [f"port {port.name} is {port.state}" for port in self._ports if port.state != "up"]

    def counters(self) -> Counter[str]:
        counters = self._intake.counters + self._own
        counters += Counter({f"port.{port}.bytes_undecoded": count for port, count in self._backlog.n_refused.items()})
        for port in self._ports:
            counters += port.counters
        if self._vehicle_port is None or self.vehicle is None:
            return counters
        return counters + self.vehicle.counters + self._intake.vehicle_counters(self._vehicle_port.name)

    async def run(self, sink: EventSink) -> None:
        """Push the events of all ports into `sink` until `stop` is called, then what was held back."""
        self._push = sink.push
        self._put(self._early)
        jobs = [job for port in self._ports if port is not self._vehicle_port for job in port.jobs()]
        serving = asyncio.ensure_future(_together([*jobs, self._tick()]))
        try:
            try:
                await asyncio.sleep(0)  # the jobs begin, whenever the source is stopped, and so can be cancelled
                await self._stopped.wait()
            finally:
                self._stopped.set()
                serving.cancel()
                await asyncio.wait({serving})
            self._decode_rest()
            self._put(self._intake.finish())
        finally:
            self._ended = True
            if self._vehicle_port is not None:  # it is heard on
                self.sent(NO_PORT, b"")

    def take(self, port: str, data: bytes, stamp: Stamp) -> None:
        """Take bytes of a port, or none: a tick."""
        if self._record is not None:
            self._record(port, "in", stamp, data)
        if not self._backlog.add(Chunk(port, data, stamp)) and self._backlog.n_refused[port] == len(data):
            text = (
                f"port '{port}' receives more than this computer can decode. The excess is recorded, counted as "
                f"port.{port}.bytes_undecoded, and not decoded. Check that only the configured device sends there."
            )
            self.raise_notice(Notice(code="port_flooded", text=text, place=port))
        self._work()

    def _work(self) -> None:
        """Decode what waits, within the allowance of this turn of the event loop."""
        self._backlog.work(self._decode)
        if not self._turn_ends:
            self._turn_ends = True
            asyncio.get_running_loop().call_soon(self._next_turn)

    def _next_turn(self) -> None:
        self._turn_ends = False
        self._backlog.begin_turn()
        if self._backlog:
            self._work()

    def _decode(self, chunk: Chunk) -> None:
        served = (
            self._vehicle_port if self._vehicle_port is not None and chunk.port == self._vehicle_port.name else None
        )
        began_s = self._clock.monotonic_s()
        if not self._ended:
            self._put(self._intake.feed(*chunk))
        elif served is not None:
            self._intake.decode(*chunk)
        took_s = self._clock.monotonic_s() - began_s
        if took_s >= _SLOW_S and (device := self._unsuspected.pop(chunk.port, "")):
            self.raise_notice(slow_decoder(chunk.port, device, len(chunk.data), took_s))
        if served is not None:
            served.hear(self._intake.heard(chunk.port), chunk.stamp)

    def _decode_rest(self) -> None:
        """Decode what waits at the end, as far as there is time for it; count the rest."""
        for _ in range(_LAST_TURNS):
            self._backlog.begin_turn()
            if not self._backlog.work(self._decode):
                return
        self._backlog.give_up()

    def sent(self, port: str, data: bytes) -> None:
        """Record bytes that went out to a port; none to no port: the end of all events."""
        if self._record is not None:
            self._record(port, "out", self._now(), data)

    def raise_notice(self, notice: Notice) -> None:
        """Raise a notice."""
        self._put([notice])

    async def _tick(self) -> None:
        """Feed a tick of the clock, since only the clock shows that a unit went silent."""
        while True:
            await asyncio.sleep(_TICK_S)
            self.take(NO_PORT, b"", self._now())

    def _now(self) -> Stamp:
        return Stamp(mono_ns=round(self._clock.monotonic_s() * 1e9), utc_ns=round(self._clock.utc_s() * 1e9))

    def _put(self, events: list[SourceEvent]) -> None:
        """Push events on; after the end only the vehicle is served, and nobody takes them."""
        if not self._ended:
            for event in events:
                self._push(event)


async def _together(jobs: list[Coroutine[Any, Any, None]]) -> None:
    """Run jobs that do not end until cancelled."""
    tasks = [asyncio.ensure_future(job) for job in jobs]
    try:
        await asyncio.wait(tasks)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


class _ServedPort:
    """Serve one port: keep its link up, set its sonar, talk to its vehicle, and report its states to a person."""

    def __init__(
        self, port: PortSettings, source: PortSource, open_link: OpenLink, clock: Clock, config: Config
    ) -> None:
        self.name = port.name
        self._port = port
        self._source = source
        self._clock = clock
        self._make_link = partial(open_link, port, self._on_bytes, self._on_state, clock)
        self._link = self._make_link()
        self._own: Counter[str] = Counter()
        self._links_before: Counter[str] = Counter()  # of links that failed
        self.received_bytes = 0
        self.received_ns = 0  # monotonic, of the newest
        self._is_open = False
        self._changed_ns = 0  # when the wire was opened or lost last
        self.vehicle: PortPilot | None = None
        if port.vehicle is not None:
            session = int(clock.utc_s()) & 0xFFFFFFFF
            may_command = config.vehicle.command
            talker = talker_of(port.device, port.vehicle, secrets.randbelow, may_command=may_command)
            baud = port.address.baud if isinstance(port.address, SerialAddress | SlcanAddress) else 0
            radius_m = config.plan.turn_radius_m
            pilot = Pilot(talker, config.vehicle, session=session, turn_radius_m=radius_m, baud=baud)
            self.vehicle = PortPilot(port.name, pilot, self._send_to_vehicle, clock)

    @property
    def state(self) -> LinkState:
        return self._link.state

    @property
    def gives_pings(self) -> bool:
        return self._port.is_sonar and not self._port.is_for_commands

    @property
    def counters(self) -> Counter[str]:
        counted = self._links_before + self._link.counters + self._own
        return Counter({f"port.{self.name}.{key}": count for key, count in counted.items()})

    def jobs(self) -> list[Coroutine[Any, Any, None]]:
        """Return the jobs of this port."""
        if self.vehicle is not None:
            return [self._keep_link(), self.vehicle.keep_talking()]
        if not self._port.commands:
            return [self._keep_link()]
        return [self._keep_link(), self._wake() if self._port.ask_every_s is None else self._ask()]

    def hear(self, messages: list[VehicleMessage], stamp: Stamp) -> None:
        """Hand on the vehicle's messages, unless their wire has been lost since: a grant ends with its connection."""
        if self.vehicle is not None and stamp.mono_ns >= self._changed_ns:
            self.vehicle.hear(messages, stamp)

    async def _keep_link(self) -> None:
        """Run the link; it ends only by a defect, and is then replaced."""
        while True:
            try:
                await self._link.run()
            except Exception as error:
                self._own["failed"] += 1
                log.exception("the link of port '%s' failed", self.name)
                text = (
                    f"the link of port '{self.name}' failed ({error!r}) and is opened anew. This is a defect: report "
                    "it with the log."
                )
                if self._own["failed"] == 1:
                    self._source.raise_notice(Notice(code="port_failed", text=text, place=self.name))
            self._links_before += self._link.counters
            self._link = self._make_link()
            await asyncio.sleep(_RESTART_S)

    async def _ask(self) -> None:
        """Request ping after ping of a sonar that needs a request for each."""
        assert self._port.ask_every_s is not None
        due_s = self._clock.monotonic_s()
        while True:
            if self.state != "down":
                self._send_commands()
            due_s = max(due_s + self._port.ask_every_s, self._clock.monotonic_s())
            await asyncio.sleep(due_s - self._clock.monotonic_s())

    async def _wake(self) -> None:
        while True:
            await asyncio.sleep(_ASK_AGAIN_S)
            if self.state == "silent":
                self._send_commands()

    def _on_bytes(self, data: bytes, stamp: Stamp) -> None:
        self.received_bytes += len(data)
        self.received_ns = stamp.mono_ns
        self._source.take(self.name, data, stamp)

    def _on_state(self, state: LinkState, reason: str) -> None:
        if (
            self.vehicle is not None and (state != "down") != self._is_open
        ):  # a wire that was silent for a while was open all the time
            self._is_open = state != "down"
            self._changed_ns = round(self._clock.monotonic_s() * 1e9)
            (self.vehicle.connected if self._is_open else self.vehicle.disconnected)()
        if self._source.is_stopping:
            return
        self._own["state_changes"] += 1
        if state == "up" and self._port.ask_every_s is None:
            self._send_commands()  # also when it sends data again: it may have started anew, with settings of its own
        if self._own["state_changes"] <= _MAX_STATE_NOTICES:
            last = (
                " Further changes of this port are only counted."
                if self._own["state_changes"] == _MAX_STATE_NOTICES
                else ""
            )
            text = f"port '{self.name}' is {state}: {reason}{last}"
            opens_well = self._own["state_changes"] == 1 and reason == f"{self._link.place} is open"
            self._source.raise_notice(
                Notice(code=f"port_{state}", text=text, place=self.name, for_the_record=opens_well)
            )
        else:
            log.info("port '%s' is %s: %s", self.name, state, reason)

    def _send_commands(self) -> None:
        for command in self._port.commands:
            if self._link.write(command):  # type: ignore[arg-type]  # no sonar is on a bus
                self._own["commands_sent"] += 1
                self._source.sent(self.name, command)
            else:
                self._own["commands_refused"] += 1

    def _send_to_vehicle(self, item: bytes | CanFrame) -> None:
        if self._link.write(item):  # type: ignore[arg-type]  # a dialect's items are those of the link its device needs
            self._own["messages_sent"] += 1
            self._source.sent(self.name, pack_can(item) if isinstance(item, CanFrame) else item)
        else:
            self._own["messages_refused"] += 1
