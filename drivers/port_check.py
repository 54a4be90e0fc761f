"""Check every configured port for the self-check: is it there, may it be opened, and does what is heard decode?

Nothing is sent: a sonar is not made to ping and a vehicle is not spoken to. A port that another program uses is left to
it.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

from auv_mcm.clock import Clock, Stamp, SystemClock
from auv_mcm.settings.config import Config, SonarConfig
from auv_mcm.settings.port_settings import SONAR_NAMES, NavUnitSettings
from auv_mcm.shell.check.finding import Finding, Verdict
from drivers.clocks import UtcAnchor
from drivers.links.link import LinkState
from drivers.links.tcp import CONNECT_S
from drivers.links.uri import TcpAddress
from drivers.navigation.nav_protocols import TEXT_PROTOCOLS
from drivers.port_source import open_link
from drivers.port_stream import PortStream
from drivers.ports import PULSE, PortSettings, open_to_all, read_ports
from drivers.vehicle.vehicles import VEHICLES

LISTEN_S: Final = 4.0  # units send once a second and more, sonars ping every 2 s and more
_OPEN_S: Final = CONNECT_S + 1.0
_ENOUGH_MESSAGES: Final = 3  # of a port, after which it counts as heard
_KEPT_BYTES: Final = 1 << 16  # of what does not decode, to find out what it is
_PATIENCE_S: Final = 0.05  # s between looks at what came
_ESTABLISHED: Final = "01"  # state of a connection in /proc/net/tcp
_TCP_TABLES: Final = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))


def port_findings(config: Config, listen_s: float = LISTEN_S) -> Iterator[Finding]:
    """Open the ports of a configuration, all at once, and listen to each for `listen_s` seconds at most.

    Raises UsageError for ports that cannot be.
    """
    ports = read_ports(config)
    yield from (Finding(f"port {notice.place}", "warning", notice.text) for notice in open_to_all(ports))

    async def check() -> list[Finding]:
        return await asyncio.gather(*(_Listener(port, config.sonar, SystemClock()).finding(listen_s) for port in ports))

    yield from asyncio.run(check())


class _Listener:
    """Listen to one port and judge it."""

    def __init__(self, port: PortSettings, sonar: SonarConfig, clock: Clock) -> None:
        self._port = port
        self._sonar = sonar
        self._clock = clock
        self._stream = None if port.device == PULSE else PortStream(port, sonar, UtcAnchor("this computer"))
        self._kept: list[tuple[bytes, Stamp]] = []
        self._n_bytes = self._n_chunks = 0
        self._is_open = False
        self._failure = ""

    async def finding(self, listen_s: float) -> Finding:
        if isinstance(self._port.address, TcpAddress) and await _is_connected(self._port.address):
            # A device that serves one connection at a time may drop the one that a running service has.
            return self._judged(
                "warning", "another program on this computer is connected to it, so it was not opened. " + _STOP_IT
            )
        link = open_link(self._port, self._hear, self._follow, self._clock)
        serving = asyncio.ensure_future(link.run())
        try:
            await self._wait(lambda: self._is_open or bool(self._failure), _OPEN_S)
            if self._is_open and not self._is_for_commands:
                await self._wait(lambda: self._n_messages() >= _ENOUGH_MESSAGES or bool(self._failure), listen_s)
        finally:
            failure = self._failure
            serving.cancel()
            await asyncio.wait({serving})
        return self._verdict(failure, listen_s)

    async def _wait(self, condition: Callable[[], bool], longest_s: float) -> None:
        ends_s = self._clock.monotonic_s() + longest_s
        while not condition() and self._clock.monotonic_s() < ends_s:
            await asyncio.sleep(_PATIENCE_S)

    @property
    def _is_for_commands(self) -> bool:
        """Return whether a sonar takes commands here and sends its pings elsewhere."""
        return self._port.is_sonar and self._port.unit is None and self._port.name.endswith(".commands")

    def _hear(self, data: bytes, stamp: Stamp) -> None:
        self._n_bytes += len(data)
        self._n_chunks += 1
        if sum(len(kept) for kept, _ in self._kept) < _KEPT_BYTES:
            self._kept.append((data, stamp))
        if self._stream is not None:
            self._stream.feed(data, stamp)

    def _follow(self, state: LinkState, reason: str) -> None:
        if state == "down":
            self._failure = reason
        else:
            self._is_open = True

    def _n_messages(self) -> int:
        return self._n_chunks if self._stream is None else _messages(self._stream)

    def _verdict(self, failure: str, listen_s: float) -> Finding:
        if failure and "in use by another program" in failure:
            return self._judged("warning", f"{failure} Nothing was read from it. {_STOP_IT}")
        if failure:
            return self._judged("FAILED", failure)
        if not self._is_open:
            return self._judged(
                "FAILED", f"did not open within {_OPEN_S:g} s. Check the device's power, its cable and its address"
            )
        if self._is_for_commands:
            return self._judged("ok", "accepts a connection; nothing was sent")
        if n_messages := self._n_messages():
            what = "pulses" if self._stream is None else f"messages of '{self._port.device}'"
            return self._judged("ok", f"{n_messages} {what} in {self._n_bytes} bytes")
        if self._n_bytes:
            return self._judged("FAILED", self._unread())
        return self._silent(listen_s)

    def _silent(self, listen_s: float) -> Finding:
        waits = ""
        if self._port.vehicle is not None:
            waits = "a vehicle may answer only when it is asked"
        elif self._port.commands:
            waits = "the sonar may wait for the commands that the service sends"
        text = f"open, but nothing was received for {listen_s:g} s"
        if waits:
            return self._judged(
                "warning", f"{text}: {waits}, and nothing was sent. If it should send by itself, check power and cable"
            )
        baud = "" if self._port.baud is None else f", and that it sends at {self._port.baud} baud"
        return self._judged("FAILED", f"{text}. Check the device's power and its cable{baud}")

    def _unread(self) -> str:
        text = f"{self._n_bytes} bytes, but no message of '{self._port.device}'"
        others = [name for name in _others(self._port) if self._reads_as(name)]
        if others:
            return f"{text}: they are messages of '{others[0]}'. Set device: {others[0]}, or change the cables"
        rate = "" if self._port.baud is None else f" that both ends are set to {self._port.baud} baud, and"
        return f"{text} or of another device known. Check{rate} which device is there"

    def _reads_as(self, device: str) -> bool:
        """Return whether what was heard decodes as messages of another device."""
        is_sonar, is_vehicle = device in SONAR_NAMES, device in VEHICLES
        other = self._port._replace(
            device=device,
            is_sonar=is_sonar,
            unit=NavUnitSettings(),
            vehicle=VEHICLES[device].settings() if is_vehicle else None,
        )
        stream = PortStream(other, self._sonar, UtcAnchor("this computer"))
        for data, stamp in self._kept:
            stream.feed(data, stamp)
        return _messages(stream) > 0

    def _judged(self, verdict: Verdict, text: str) -> Finding:
        place = self._port.address.place
        is_named = getattr(self._port.address, "path", place) in text
        return Finding(f"port {self._port.name}", verdict, text if is_named else f"{place}: {text}")


_STOP_IT: Final = "If that is the service, all is well; else stop it, and check again"


def _messages(stream: PortStream) -> int:
    return sum(count for name, count in stream.counters.items() if name.endswith(".messages"))


def _others(port: PortSettings) -> Iterable[str]:
    """Return the other devices that could be at such a link."""
    if port.is_bus:
        return [name for name, kind in VEHICLES.items() if kind.is_bus and name != port.device]
    vehicles = [name for name, kind in VEHICLES.items() if not kind.is_bus]
    return [name for name in (*SONAR_NAMES, *TEXT_PROTOCOLS, *vehicles) if name != port.device]


async def _is_connected(address: TcpAddress) -> bool:
    """Return whether a program on this computer has a connection to a TCP address."""
    try:
        found = await asyncio.get_running_loop().getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM)
    except OSError:
        return False  # opening it reports what is wrong
    wanted = {(ipaddress.ip_address(str(place[0]).partition("%")[0]), address.port) for *_, place in found}
    return any(remote in wanted for table in _TCP_TABLES for remote in _remotes(table))


def _remotes(table: Path) -> Sequence[tuple[ipaddress.IPv4Address | ipaddress.IPv6Address, int]]:
    """Return the far ends of the connections in a table such as /proc/net/tcp."""
    try:
        lines = table.read_text("ascii").splitlines()[1:]
    except OSError:
        return []
    remotes = []
    for line in lines:
        _, _, remote, state, *_ = line.split()
        host, _, port = remote.partition(":")
        if state == _ESTABLISHED:
            words = [
                bytes.fromhex(host[start : start + 8])[::-1] for start in range(0, len(host), 8)
            ]  # 32 bits each, little-endian
            address = ipaddress.ip_address(b"".join(words))
            mapped = getattr(address, "ipv4_mapped", None)
            remotes.append((mapped or address, int(port, 16)))
    return remotes
