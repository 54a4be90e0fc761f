"""Give the wires of fake devices one interface: pseudo-terminals, CAN adapters, TCP and UDP of this computer."""

from __future__ import annotations

import asyncio
import os
import socket
import termios
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final, Protocol, TypeAlias
from urllib.parse import quote

from drivers.links.can_frame import CanFrame
from sim_replay.fakes.faults import FaultRates, Faults
from sim_replay.fakes.job import Device
from sim_replay.fakes.net import FakeTcpServer, FakeUdpDevice
from sim_replay.fakes.port import FakePort
from sim_replay.fakes.slcan_adapter import FakeSlcanAdapter

Heard: TypeAlias = Callable[[bytes | CanFrame], None]
_LOOK_S: Final = 0.002  # s between looks at the pseudo-terminal's rate
_NETWORK_BYTES_PER_S: Final = 1e6  # bytes per second: a slow Ethernet


class Weather(Faults):
    """Damage messages from one instant to another; without damage, messages pass unchanged."""

    def __init__(self, seed: int) -> None:
        super().__init__(FaultRates(), seed)
        self._clear = True

    def set_rates(self, rates: FaultRates | None) -> None:
        """Set the rates of faults; None for a clear line."""
        self._clear = rates is None
        self._rates = rates or FaultRates()

    def passed(self, message: bytes) -> list[tuple[float, bytes]]:
        return [(0.0, message)] if self._clear else super().passed(message)


class DeviceWire(Protocol):
    """Define a device's end of a wire. Used in a running event loop."""

    @property
    def uri(self) -> str:
        """Return the wire's address in the host's configuration."""
        ...

    @property
    def counters(self) -> Counter[str]: ...

    @property
    def is_open(self) -> bool:
        """Report whether a host has opened the wire. Datagrams give no sign; they are taken for heard."""
        ...

    async def start(self) -> None:
        """Appear, for the host to open."""
        ...

    async def send(self, message: bytes | CanFrame) -> None:
        """Send a message. Returns when the last byte has left."""
        ...

    async def send_garbage(self, data: bytes) -> None:
        """Send bytes that are no message, at the rate of the wire."""
        ...

    async def set_plugged(self, plugged: bool) -> None: ...

    def hang_up(self) -> None:
        """Lose what the host has not read, as where its program ends. No effect where the host's kernel sees to it."""

    def set_stalled(self, stalled: bool) -> None:
        """Stall the line, or let it go on."""

    def set_baud(self, baud: int | None) -> None:
        """Set the device's rate; None: the right one."""
        ...

    async def close(self) -> None:
        """Close for good."""
        ...


class SerialWire:
    """Drive a pseudo-terminal."""

    def __init__(self, device: Device, path: Path, weather: Weather, hear: Heard | None) -> None:
        self.port = FakePort(path, device.baud, weather, hear)
        self.uri = f"serial://{quote(str(path))}?baud={device.host_baud or device.baud}{_silence(device, '&')}"
        self._baud = device.baud

    @property
    def counters(self) -> Counter[str]:
        return self.port.counters

    @property
    def is_open(self) -> bool:
        return self.port.plugged and _is_opened(self.port.path)

    async def start(self) -> None:
        self.port.plug()

    async def send(self, message: bytes | CanFrame) -> None:
        assert isinstance(message, bytes)
        await self.port.send(message)

    async def send_garbage(self, data: bytes) -> None:
        await self.port.send(data)

    async def set_plugged(self, plugged: bool) -> None:
        if plugged:
            self.port.plug()
        else:
            self.port.unplug()

    def hang_up(self) -> None:
        self.port.hang_up()

    def set_stalled(self, stalled: bool) -> None:
        """Stall the line, or let it go on."""
        self.port.stalled = stalled

    def set_baud(self, baud: int | None) -> None:
        self.port.baud = baud or self._baud

    async def close(self) -> None:
        self.port.unplug()


class SlcanWire(SerialWire):
    """Drive a CAN adapter at a pseudo-terminal, and the bus behind it."""

    def __init__(self, device: Device, path: Path, weather: Weather, hear: Heard | None) -> None:
        super().__init__(device, path, weather, None)
        self.uri = (
            f"slcan://{quote(str(path))}?bitrate={device.bus_bitrate}&baud={device.host_baud or device.baud}"
            f"{_silence(device, '&')}"
        )
        self._adapter = FakeSlcanAdapter(self.port, device.bus_bitrate, hear)

    @property
    def counters(self) -> Counter[str]:
        return self.port.counters + self._adapter.counters

    async def send(self, message: bytes | CanFrame) -> None:
        assert isinstance(message, CanFrame)
        await self._adapter.send(message)

    async def set_plugged(self, plugged: bool) -> None:
        if plugged:
            self._adapter.power_cycle()  # it takes its power from the same cable
        await super().set_plugged(plugged)


class TcpWire:
    """Drive a TCP server; without power it refuses connections."""

    def __init__(self, device: Device, weather: Weather, hear: Heard | None) -> None:
        self._server = FakeTcpServer(weather, hear)
        self._silence = _silence(device, "?")

    @property
    def uri(self) -> str:
        return f"tcp://127.0.0.1:{self._server.port}{self._silence}"

    @property
    def counters(self) -> Counter[str]:
        return self._server.counters

    @property
    def is_open(self) -> bool:
        return self._server.n_clients > 0

    async def start(self) -> None:
        await self._server.start()

    async def send(self, message: bytes | CanFrame) -> None:
        assert isinstance(message, bytes)
        await self._server.send(message)

    async def send_garbage(self, data: bytes) -> None:
        await self._server.send(data)
        await asyncio.sleep(len(data) / _NETWORK_BYTES_PER_S)

    async def set_plugged(self, plugged: bool) -> None:
        if plugged:
            await self._server.start()
        else:
            await self._server.stop(reset=True)

    def hang_up(self) -> None:
        """Do nothing: the connection ends with the host's program."""

    def set_stalled(self, stalled: bool) -> None:
        """Stall the line, or let it go on."""
        self._server.stalled = stalled

    def set_baud(self, baud: int | None) -> None:
        raise AssertionError("a network has no baud rate; jobs that set one are rejected")

    async def close(self) -> None:
        await self._server.stop()


class UdpWire:
    """Send datagrams to a port of this computer that was free when the wire was made."""

    def __init__(self, device: Device, weather: Weather, hear: Heard | None) -> None:
        self._device = FakeUdpDevice(weather, hear)
        self._host_port = _free_udp_port()
        self.uri = f"udp://127.0.0.1:{self._host_port}?peer=127.0.0.1:{self._device.port}{_silence(device, '&')}"

    @property
    def counters(self) -> Counter[str]:
        return self._device.counters

    @property
    def is_open(self) -> bool:
        return True

    async def start(self) -> None:
        """Start nothing: a sender of datagrams exists from the beginning."""

    async def send(self, message: bytes | CanFrame) -> None:
        assert isinstance(message, bytes)
        self._device.send(message, "127.0.0.1", self._host_port)

    async def send_garbage(self, data: bytes) -> None:
        self._device.send(data, "127.0.0.1", self._host_port)
        await asyncio.sleep(len(data) / _NETWORK_BYTES_PER_S)

    async def set_plugged(self, plugged: bool) -> None:
        """Plug or unplug; an unplugged cable looks like one through which nothing comes."""
        self._device.stalled = not plugged

    def hang_up(self) -> None:
        """Do nothing: a datagram that nobody waits for is lost."""

    def set_stalled(self, stalled: bool) -> None:
        """Stall the line, or let it go on."""
        self._device.stalled = stalled

    def set_baud(self, baud: int | None) -> None:
        raise AssertionError("a network has no baud rate; jobs that set one are rejected")

    async def close(self) -> None:
        self._device.close()


async def opened(wire: DeviceWire) -> None:
    """Return as soon as a host has opened the wire."""
    while not wire.is_open:
        await asyncio.sleep(_LOOK_S)


def make_wire(device: Device, path: Path, weather: Weather, hear: Heard | None) -> DeviceWire:
    """Make the wire of a device.

    Parameters
    ----------
    path
        Where a serial port appears.
    hear
        Receives the host's bytes.
    """
    match device.link:
        case "serial":
            return SerialWire(device, path, weather, hear)
        case "slcan":
            return SlcanWire(device, path, weather, hear)
        case "tcp":
            return TcpWire(device, weather, hear)
        case "udp":
            return UdpWire(device, weather, hear)


def _is_opened(path: Path) -> bool:
    """Report whether a program has set up the serial port.

    It then ignores modem lines, which a new pseudo-terminal does not.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        return bool(termios.tcgetattr(descriptor)[2] & termios.CLOCAL)
    finally:
        os.close(descriptor)


def _silence(device: Device, joint: str) -> str:
    return "" if device.silent_s is None else f"{joint}silent_s={device.silent_s:g}"


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
