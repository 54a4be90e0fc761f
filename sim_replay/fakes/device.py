"""Run a fake device: it plays a mission on a wire, answers its host, and fails as its job requests."""

from __future__ import annotations

import asyncio
import itertools
import math
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from msgspec import structs

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NavSample, Ping
from drivers.links.can_frame import CanFrame
from sim_replay.fakes.controller import Report, ReportingController
from sim_replay.fakes.feed import TimedEvent
from sim_replay.fakes.job import (
    Abort,
    ClockStep,
    Damage,
    Fault,
    Flood,
    Freeze,
    Garbage,
    Job,
    Misreport,
    Nonsense,
    Offset,
    PowerOff,
    Revoke,
    Stall,
    StopPlan,
    Unplug,
    WrongBaud,
)
from sim_replay.fakes.navigation import NAVIGATION_UNITS, FakeNavigation, Message
from sim_replay.fakes.sonar import DeviceTime, FakeSonar, JsfSonar, PingProtocolSonar, SportScanSonar
from sim_replay.fakes.wires import DeviceWire, Weather, make_wire, opened
from sim_replay.fakes.worst_bytes import WORST_BYTES

SONARS: Final[dict[str, Callable[[], FakeSonar]]] = {
    "ping_protocol": PingProtocolSonar,
    "jsf": JsfSonar,
    "sportscan": SportScanSonar,
}

HELD_S: Final = 0.02
"""s; 0.12 m at 6 m/s: a vehicle waits for a later device."""
_LATE_S: Final = 0.25  # a device that cannot get rid of its data by then leaves something out
_TICK_S: Final = 0.1  # of a controller
_LOOK_S: Final = 0.02  # whether a host has opened the wire of a vehicle
_GARBAGE_BYTES: Final = 256  # bytes of one burst of junk
_WIRES: Final = {"nmea2000": "fast_packet"}  # devices whose wire is called otherwise in WORST_BYTES
_FLOOD_BYTES: Final = 1400  # a datagram that fits an Ethernet frame


class FakeDevice:
    """Play one device of one run.

    events: its mission; a sonar plays its pings, every other device its navigation samples. controller: of a vehicle,
    to which each sample is a tick; standing: where that is before the start. report(what, details): what happens, as it
    happens. wait(late_s): lets the whole mission wait for a device that is late, by waits_after_s or more; None: the
    device leaves out what is too late.

    Reports: `ready` (uri, of its wire), `settings` (applied: what the host set a sonar to, when it changed), `fault`
    and `mended` (do), `reopened` (after_s: from the cable's return until the host had opened the wire), `done`.
    counters: device.events (played), .messages, .skipped (events left out, since wire or computer were busy),
    .flood_bytes, .latest_ms (the latest that an event was through, after it was due), and those of the wire, its damage
    and the controller.
    """

    def __init__(
        self,
        job: Job,
        events: AsyncIterator[TimedEvent],
        report: Report,
        controller: ReportingController | None = None,
        standing: NavSample | None = None,
        wait: Callable[[float], None] | None = None,
        waits_after_s: float = HELD_S,
    ) -> None:
        self._job = job
        self._wait = wait
        self._waits_after_s = waits_after_s
        self._events = events
        self._report = report
        self._own: Counter[str] = Counter()
        self._weather = Weather(job.seed)
        self._random = np.random.Generator(np.random.PCG64(job.seed))
        kind, unit = job.device.device, job.device.beside or job.device.device
        self._sonar: FakeSonar | None = SONARS[kind]() if kind in SONARS else None
        self._navigation: FakeNavigation | None = NAVIGATION_UNITS[unit]() if unit in NAVIGATION_UNITS else None
        self._controller = controller
        self._standing = standing
        hear: Callable[[Message], None] | None = None if self._sonar is None and controller is None else self._hear
        self.wire: DeviceWire = make_wire(job.device, Path(job.folder) / job.name, self._weather, hear)
        self._power_up_s = self._start_s = time.monotonic()
        self._given_until_s = math.inf
        self._stepped_s = 0.0
        self._has_power = True
        self._freeze = False
        self._offset = Offset(at_s=0.0)
        self._misreports: list[Misreport] = []
        self._reported: NavSample | None = None
        self._tasks: asyncio.TaskGroup | None = None

    @property
    def counters(self) -> Counter[str]:
        controller = Counter[str]() if self._controller is None else self._controller.counters
        return self._own + self.wire.counters + self._weather.counters + controller

    async def end(self) -> None:
        """Close for good, and report the counters."""
        await self.wire.close()
        self._report("counters", dict(self.counters))

    async def run(self, start: Awaitable[float]) -> None:
        """Serve the host, and play the mission from the instant of the monotonic clock that `start` gives.

        Ends with the mission, and with the last fault that ends.
        """
        async with asyncio.TaskGroup() as tasks:
            self._tasks = tasks
            await self.wire.start()
            self._report("ready", {"uri": self.wire.uri})
            welcoming, standing = tasks.create_task(self._welcome()), tasks.create_task(self._stand())
            self._start_s = await start
            standing.cancel()
            for fault in self._job.device.faults:
                tasks.create_task(self._fail(fault, tasks))
            async for fed in self._events:
                await self._play(fed)
            welcoming.cancel()
            self._report("done", {})

    def hold(self, for_s: float) -> None:
        """Delay every event and fault still due by so much."""
        self._start_s += for_s

    def give_until(self, at_s: float) -> None:
        """Hold faults due later than this, in mission time: their events are not made yet."""
        self._given_until_s = at_s

    async def _welcome(self) -> None:
        """Notify the controller of every host that opens the wire."""
        while self._controller is not None:
            await opened(self.wire)
            self._controller.connected(time.monotonic())
            while self.wire.is_open:
                await asyncio.sleep(_LOOK_S)

    async def _stand(self) -> None:
        """Run the controller before the mission starts."""
        while self._controller is not None and self._standing is not None:
            now_s = time.monotonic()
            for message in self._controller.tick(
                structs.replace(self._standing, time_s=self._time(now_s).utc_s), now_s
            ):
                await self.wire.send(message)
            await asyncio.sleep(_TICK_S)

    async def _play(self, fed: TimedEvent) -> None:
        event = fed.event
        is_ping = isinstance(event, Ping)
        if is_ping != (self._sonar is not None):
            return
        due_s = fed.at_s + (_travel_s(event) if isinstance(event, Ping) else 0.0)
        await self._sleep_until(due_s)
        if not self._has_power:
            return
        late_s = self._elapsed_s() - due_s
        if late_s > (_LATE_S if self._wait is None else self._waits_after_s):
            if self._wait is None:
                self._own["device.skipped"] += 1
                return
            self._wait(late_s)
        for message in self._messages(event, fed.at_s):
            await self.wire.send(message)
            self._own["device.messages"] += 1
        self._own["device.events"] += 1
        self._own["device.latest_ms"] = max(self._own["device.latest_ms"], round(1e3 * (self._elapsed_s() - due_s)))

    def _messages(self, event: Ping | NavSample, at_s: float) -> Sequence[Message]:
        if isinstance(event, Ping):
            assert self._sonar is not None
            return self._sonar.ping(event, self._time(self._start_s + at_s))
        if not self._freeze or self._reported is None:
            self._reported = _misreported(_wrong_by(event, self._offset), self._misreports)
        messages: list[Message] = []
        utc_s = self._time(self._start_s + self._reported.time_s).utc_s
        if self._navigation is not None:
            messages += self._navigation.measured(self._reported, utc_s)
        if self._controller is not None:
            messages += self._controller.tick(structs.replace(self._reported, time_s=utc_s), time.monotonic())
        return messages

    def _hear(self, data: Message) -> None:
        """Answer what the host writes; answers go out as soon as the wire is free."""
        if self._tasks is None or not self._has_power:
            return
        for answer in self._answers(data):
            self._tasks.create_task(self.wire.send(answer))

    def _answers(self, data: Message) -> Sequence[Message]:
        if self._controller is not None:
            return self._controller.heard(data, time.monotonic())
        assert self._sonar is not None
        assert not isinstance(data, CanFrame)
        before = self._sonar.settings
        answers = self._sonar.heard(data, self._time(time.monotonic()))
        if self._sonar.settings != before:
            self._report("settings", {"applied": self._sonar.settings})
        return answers

    async def _fail(self, fault: Fault, tasks: asyncio.TaskGroup) -> None:
        do = str(fault.__struct_config__.tag)
        at_s = fault.at_s
        if fault.after == "grant":
            assert self._controller is not None
            await self._controller.granted_once.wait()
            at_s += self._elapsed_s()
        await self._fault_due(at_s)
        self._report("fault", {"do": do})
        garbage = None
        if isinstance(fault, Garbage):
            garbage = tasks.create_task(self._send_garbage())
        elif isinstance(fault, Flood):
            garbage = tasks.create_task(self._send_worst(fault.bytes_per_s))
        await self._set(fault, on=True)
        if fault.for_s is None:
            return
        await self._fault_due(at_s + fault.for_s)
        if garbage is not None:
            garbage.cancel()
        await self._set(fault, on=False)
        mended_s = time.monotonic()
        self._report("mended", {"do": do})
        if isinstance(fault, Unplug | PowerOff):
            await opened(self.wire)
            self._report("reopened", {"after_s": round(time.monotonic() - mended_s, 4)})

    async def _set(self, fault: Fault, *, on: bool) -> None:
        match fault:
            case Unplug():
                await self.wire.set_plugged(not on)
            case PowerOff():
                self._has_power = not on
                if not on:
                    self._power_up_s = time.monotonic()
                    if self._sonar is not None:
                        self._sonar.power_up()
                    if self._controller is not None:
                        self._controller.power_up(time.monotonic())
                await self.wire.set_plugged(not on)
            case Stall():
                self.wire.set_stalled(on)
            case Damage():
                self._weather.set_rates(fault.rates if on else None)
            case WrongBaud():
                self.wire.set_baud(fault.baud if on else None)
            case ClockStep():
                self._stepped_s += fault.by_s if on else -fault.by_s
            case Freeze():
                self._freeze = on
            case Offset():
                self._offset = fault if on else Offset(at_s=0.0)
            case Revoke():
                assert self._controller is not None
                self._controller.set_willing(not on, time.monotonic())
            case Abort() | StopPlan():
                assert self._controller is not None
                if on:
                    self._controller.stop(time.monotonic(), by_abort=isinstance(fault, Abort))
                else:
                    self._controller.start_plan(time.monotonic())
            case Nonsense():
                assert self._controller is not None
                self._controller.is_talking_nonsense = on
            case Misreport():
                self._misreports = [other for other in self._misreports if other is not fault] + [fault] * on

    async def _send_garbage(self) -> None:
        while True:
            await self.wire.send_garbage(self._random.bytes(_GARBAGE_BYTES))

    async def _send_worst(self, bytes_per_s: float) -> None:
        """Send the input that costs this kind of device's decoder the maximum, one kind after the other, at a rate."""
        kind = self._job.device.device
        worst = WORST_BYTES[_WIRES.get(kind, kind)].values()
        pieces = [piece * (_FLOOD_BYTES // len(piece) + 1) for piece in worst]
        began_s, n_sent = time.monotonic(), 0
        for piece in itertools.cycle(pieces):
            await self.wire.send_garbage(piece[:_FLOOD_BYTES])
            self._own["device.flood_bytes"] += _FLOOD_BYTES
            n_sent += _FLOOD_BYTES
            await asyncio.sleep(max(began_s + n_sent / bytes_per_s - time.monotonic(), 0.0))

    def _time(self, mono_s: float) -> DeviceTime:
        """Return the device's clocks at an instant of the monotonic clock."""
        utc_s = time.time() + mono_s - time.monotonic() + self._stepped_s
        return DeviceTime(max(mono_s - self._power_up_s + self._stepped_s, 0.0), utc_s)

    def _elapsed_s(self) -> float:
        return time.monotonic() - self._start_s

    async def _fault_due(self, at_s: float) -> None:
        await self._sleep_until(at_s)
        while at_s > self._given_until_s:  # the computer is late: mission time will be held
            await asyncio.sleep(_LOOK_S)
            await self._sleep_until(at_s)

    async def _sleep_until(self, at_s: float) -> None:
        while (wait_s := at_s - self._elapsed_s()) > 0.0:  # held meanwhile, it waits on
            await asyncio.sleep(wait_s)


def _travel_s(ping: Ping) -> float:
    """Return the travel time of sound to the end of the trace and back; nothing can be sent before."""
    ends_m = [
        trace.first_range_m + trace.spacing_m * trace.samples.shape[0]
        for trace in (ping.port, ping.starboard)
        if trace is not None
    ]
    return 2.0 * max(ends_m, default=0.0) / ping.sound_speed_mps


def _wrong_by(sample: NavSample, offset: Offset) -> NavSample:
    if offset.heading_deg:
        sample = structs.replace(sample, heading_rad=sample.heading_rad + math.radians(offset.heading_deg))
    if offset.east_m or offset.north_m:
        frame = LocalFrame(latitude_deg=sample.latitude_deg, longitude_deg=sample.longitude_deg)
        latitude_deg, longitude_deg, _ = frame.to_geodetic((offset.east_m, offset.north_m, 0.0))
        sample = structs.replace(sample, latitude_deg=float(latitude_deg), longitude_deg=float(longitude_deg))
    return sample


def _misreported(sample: NavSample, faults: Sequence[Misreport]) -> NavSample:
    for fault in faults:
        sample = structs.replace(
            sample,
            depth_m=sample.depth_m + fault.depth_by_m,
            altitude_m=math.nan if fault.no_altitude else sample.altitude_m + fault.altitude_by_m,
        )
    return sample
