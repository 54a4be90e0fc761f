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
from auv_mcm.settings.config import USUAL_BEAM_DEG, Config, SonarConfig
from auv_mcm.settings.port_settings import SONAR_NAMES, NavUnitSettings
from auv_mcm.shell.check.finding import Finding, Verdict
from drivers.clocks import UtcAnchor, host_offset_ns
from drivers.heard import Heard
from drivers.links.can_bus import TO_CHECK
from drivers.links.link import LinkState
from drivers.links.tcp import CONNECT_S
from drivers.links.uri import TcpAddress
from drivers.navigation.nav_protocols import TEXT_PROTOCOLS
from drivers.port_source import open_link
from drivers.port_stream import PortStream
from drivers.ports import PULSE, PortSettings, open_to_all, read_ports, without_sonar
from drivers.vehicle.vehicles import VEHICLES

LISTEN_S: Final = 4.0  # units send once a second and more, sonars ping every 2 s and more
_OPEN_S: Final = CONNECT_S + 1.0
_ENOUGH_MESSAGES: Final = 3  # of a port, after which it counts as heard
_KEPT_BYTES: Final = 1 << 16  # of what does not decode, to find out what it is
_LONG_ARM_M: Final = 10.0  # chosen: longer than all but a few vehicles
_PATIENCE_S: Final = 0.05  # s between looks at what came
_ESTABLISHED: Final = "01"  # state of a connection in /proc/net/tcp
_TCP_TABLES: Final = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))


def port_findings(config: Config, listen_s: float = LISTEN_S) -> Iterator[Finding]:
    """Open the ports of a configuration, all at once, and listen to each for `listen_s` seconds at most.

    Raises UsageError for ports that cannot be.
    """
    ports = read_ports(config)
    yield from (Finding(f"port {notice.place}", "warning", notice.text) for notice in open_to_all(ports))
    yield from (Finding("sonar", "warning", notice.text) for notice in without_sonar(ports))
    yield from _beam_findings(ports, config.sonar)
    yield from _arm_findings(ports, config.sonar)

    listeners = [_Listener(port, config.sonar, SystemClock()) for port in ports]

    async def check() -> list[Finding]:
        return await asyncio.gather(*(listener.finding(listen_s) for listener in listeners))

    found = asyncio.run(check())
    yield from found
    yield from _position_findings(list(zip(listeners, found, ports, strict=True)))


def _beam_findings(ports: Sequence[PortSettings], sonar: SonarConfig) -> Iterator[Finding]:
    """Report a beam that is not stated: taken for narrower than it is, mines are missed that clearance promises."""
    if sonar.kind == "side_scan" and sonar.beam_width_deg is None and any(port.is_sonar for port in ports):
        yield Finding(
            "beam width",
            "warning",
            f"sonar.beam_width_deg is empty, and {USUAL_BEAM_DEG:g} degrees are used: where the beam is wider, mines "
            "are missed and clearance promises too much. Set the two-way width, 0.7 of the data sheet's one-way width",
        )


def _arm_findings(ports: Sequence[PortSettings], sonar: SonarConfig) -> Iterator[Finding]:
    """Report lever arms longer than most vehicles: in centimetres, they shift every contact without a word."""
    arms_m = {"sonar": sonar.lever_arm_m}
    arms_m |= {f"port {port.name}": port.unit.lever_arm_m for port in ports if port.unit is not None}
    for place, arm_m in arms_m.items():
        if (longest_m := max(map(abs, arm_m))) > _LONG_ARM_M:
            yield Finding(place, "warning", f"lever_arm_m reaches {longest_m:g} m: is it in metres, as it has to be?")


def _position_findings(judged: Sequence[tuple[_Listener, Finding, PortSettings]]) -> Iterator[Finding]:
    """Report that units speak and none of them gives a position, without which no contact has a place."""
    units = [item for item in judged if item[2].unit is not None and item[2].device != PULSE]
    spoken = [port.name for _, finding, port in units if finding.verdict == "ok"]
    if not spoken or any(listener.heard.quantities["position"] for listener, *_ in units):
        return
    unheard = [port.name for _, finding, port in units if finding.verdict == "warning"]
    text = f"no unit that was heard ({', '.join(spoken)}) gave a position: pings and contacts would have no place"
    if unheard:
        yield Finding("position", "warning", f"{text}, unless {' or '.join(unheard)} does, which could not be judged")
        return
    yield Finding(
        "position",
        "FAILED",
        f"{text}. Check that a receiver has a fix and sends GGA, RMC or GLL (or the position of its protocol), and "
        "ports[].navigation.delivers",
    )


class _Listener:
    """Listen to one port and judge it."""

    def __init__(self, port: PortSettings, sonar: SonarConfig, clock: Clock) -> None:
        self._port = port
        self._sonar = sonar
        self._clock = clock
        self._utc = UtcAnchor("this computer")
        self._stream = None if port.device == PULSE else PortStream(port, sonar, self._utc)
        self.heard = Heard(() if port.unit is None else port.unit.delivers)
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
            if self._is_open and not self._port.is_for_commands:
                await self._wait(lambda: self._has_enough() or bool(self._failure), listen_s)
        finally:
            failure = self._failure
            serving.cancel()
            await asyncio.wait({serving})
        return self._verdict(failure, listen_s)

    async def _wait(self, condition: Callable[[], bool], longest_s: float) -> None:
        ends_s = self._clock.monotonic_s() + longest_s
        while not condition() and self._clock.monotonic_s() < ends_s:
            await asyncio.sleep(_PATIENCE_S)

    def _hear(self, data: bytes, stamp: Stamp) -> None:
        self._n_bytes += len(data)
        self._n_chunks += 1
        if sum(len(kept) for kept, _ in self._kept) < _KEPT_BYTES:
            self._kept.append((data, stamp))
        if self._stream is not None:
            self._utc.follow(host_offset_ns(stamp), stamp.mono_ns)
            self.heard.add(self._stream.feed(data, stamp))

    def _has_enough(self) -> bool:
        """Return whether enough was heard to judge: messages, and what the service would take from them."""
        if self._n_messages() < _ENOUGH_MESSAGES or (self._port.is_sonar and self.heard.n_pings < _ENOUGH_MESSAGES):
            return False
        unit = self._port.unit
        return unit is None or "position" not in unit.delivers or self.heard.quantities["position"] > 0

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
        if self._port.is_for_commands:
            return self._judged("ok", "accepts a connection; nothing was sent")
        if n_messages := self._n_messages():
            return self._heard_verdict(n_messages)
        if self._n_bytes:
            return self._judged("FAILED", self._unread())
        return self._silent(listen_s)

    def _heard_verdict(self, n_messages: int) -> Finding:
        if self._stream is None:
            return self._judged("ok", f"{n_messages} pulses in {self._n_bytes} bytes")
        text = f"{n_messages} messages of '{self._port.device}' in {self._n_bytes} bytes"
        if words := self.heard.words():
            text += f": {words}"
        asking = [notice for notice in self.heard.notices if not notice.for_the_record]
        if asking:
            is_defect = any(notice.code == "decoder_failed" for notice in asking)
            reasons = ". ".join(notice.text.rstrip(".") for notice in asking)
            return self._judged("FAILED" if is_defect else "warning", f"{text}. {reasons}")
        if self._port.is_sonar and not self.heard.n_pings:
            refused = ", ".join(
                f"{name} {count}" for name, count in sorted(self._stream.counters.items()) if ".refused." in name
            )
            reason = f" ({refused})" if refused else ", as it may wait for the commands that the service sends"
            return self._judged("warning", f"{text}, but no ping{reason}")
        return self._judged("ok", text)

    def _silent(self, listen_s: float) -> Finding:
        waits = ""
        if self._port.vehicle is not None:
            waits = "a vehicle may answer only when it is asked"
        elif self._port.commands:
            waits = "the sonar may wait for the commands that the service sends"
        text = f"open, but nothing was received for {listen_s:g} s"
        baud = "" if self._port.baud is None else f", and that it sends at {self._port.baud} baud"
        what = TO_CHECK if self._port.is_bus else f"the device's power and its cable{baud}"
        if waits:
            return self._judged(
                "warning", f"{text}: {waits}, and nothing was sent. If it should send by itself, check {what}"
            )
        return self._judged("FAILED", f"{text}. Check {what}")

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
        utc = UtcAnchor("this computer")
        stream = PortStream(other, self._sonar, utc)
        for data, stamp in self._kept:
            utc.follow(host_offset_ns(stamp), stamp.mono_ns)
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
    except (OSError, UnicodeError):
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
