"""Play a mission's messages at serial ports in a folder while a service reads them."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from auv_mcm.settings.config import Config
from auv_mcm.shell.service import Service
from drivers.port_source import PortSource
from sim_replay.fakes.port import FakePort
from tests.manual_clock import ManualClock

Message = tuple[float, str, bytes]  # when it is due, s since the beginning, at which port, and its bytes


class Devices(threading.Thread):
    """Start devices at ports in a folder; on request they send one message after the other, each once the service has
    read the one before.

    `clock` is the mission's: it goes on when a message has been read, so that the computer's load changes no stamp.
    """

    def __init__(self, folder: Path, bauds: Mapping[str, int], messages: Sequence[Message], start_utc_s: float) -> None:
        super().__init__(name="devices", daemon=True)
        self.clock = ManualClock(start_utc_s)
        self.read: Callable[[str], int] = lambda _: 0  # how many bytes of a port the service has read
        self.plugged, self.begin, self.done, self.end = (threading.Event() for _ in range(4))
        self.received = dict.fromkeys(bauds, b"")
        self._folder, self._bauds, self._messages, self._start_utc_s = folder, bauds, messages, start_utc_s

    def run(self) -> None:
        asyncio.run(self._run())

    def _hear(self, name: str, data: bytes) -> None:
        self.received[name] += data

    async def _run(self) -> None:
        ports = {
            name: FakePort(self._folder / name, baud, on_bytes=lambda data, name=name: self._hear(name, data))  # type: ignore[misc]
            for name, baud in self._bauds.items()
        }
        for port in ports.values():
            port.plug()
        self.plugged.set()
        while not self.begin.is_set():
            await asyncio.sleep(0.01)
        sent = dict.fromkeys(ports, 0)
        for due_s, at, data in self._messages:
            self.clock.advance_to(self._start_utc_s + due_s)
            await ports[at].send(data)
            sent[at] += len(data)
            while self.read(at) < sent[at] and not self.end.is_set():
                await asyncio.sleep(5e-4)
        self.done.set()
        while not self.end.is_set():
            await asyncio.sleep(0.01)
        for port in ports.values():
            port.unplug()


def served(config: Config, devices: Devices) -> Path:
    """Start devices, serve them until all messages have been read, and return the folder of results."""
    devices.start()
    assert devices.plugged.wait(10.0)
    live = asyncio.run(_served(config, devices))
    devices.join(10.0)
    return live


async def _served(config: Config, devices: Devices) -> Path:
    source = PortSource(config, devices.clock)
    devices.read = lambda name: {port.name: port.received_bytes for port in source.health().ports}[name]
    service = Service(config, source, console=lambda line: None)
    serving = asyncio.ensure_future(service.run())
    try:
        while not (all(port.state == "up" for port in source.health().ports) or serving.done()):
            await asyncio.sleep(0.01)
        devices.begin.set()
        while not (devices.done.is_set() or serving.done()):
            await asyncio.sleep(0.05)
    finally:
        service.stop()
    try:
        return await serving
    finally:
        devices.end.set()
