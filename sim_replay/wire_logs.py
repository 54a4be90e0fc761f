"""Play a mission to a fake sonar and a navigation unit at two ports, and write what recorders make of their bytes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, NamedTuple

from auv_mcm.clock import Stamp
from auv_mcm.records import NavSample, Ping, SourceEvent
from auv_mcm.settings.config import Config, config_yaml
from drivers.ports import read_ports
from drivers.recording.session_layout import Recorded, SessionDescription
from drivers.recording.session_writer import SessionWriter
from drivers.sonar.jsf_messages import JsfMessage
from drivers.sonar.jsf_messages import to_wire as jsf_wire
from drivers.sonar.ping_messages import NMEA_WRAPPER, JsonWrapper, PingMessage, encode
from drivers.sonar.ping_messages import to_wire as ping_wire
from sim_replay.fakes.device import SONARS
from sim_replay.fakes.navigation import NAVIGATION_UNITS
from sim_replay.fakes.sonar import DeviceTime

_ON_SINCE_S: Final = 77.0  # s that the sonar has been on when a mission begins; chosen


class Run(NamedTuple):
    """Hold what came in at two ports, of a sonar called `sonar` and of a unit, with their configuration.

    first_ping_s: UTC.
    """

    config: Config
    recorded: tuple[Recorded, ...]
    first_ping_s: float


def played(
    events: Sequence[SourceEvent],
    config: Config,
    begin: Stamp,
    delay_s: Callable[[NavSample | Ping], float] = lambda event: 0.0,
) -> Run:
    """Play a mission to the devices of two ports, the sonar's first, from `begin` on.

    All happens at full milliseconds, as sonars' clocks count. delay_s: how much later messages about an event arrive.
    """
    at_sonar, at_unit = read_ports(config)
    sonar, unit = SONARS[at_sonar.device](), NAVIGATION_UNITS[at_unit.device]()
    begin_s = 1e-9 * begin.utc_ns
    for command in at_sonar.commands:
        sonar.heard(command, DeviceTime(0.0, begin_s))
    timed = [event for event in events if isinstance(event, NavSample | Ping)]
    arrivals: list[tuple[float, str, bytes]] = []
    for event in timed:
        at_s = round(event.time_s - timed[0].time_s, 3)
        arrival_s = at_s + delay_s(event)
        if isinstance(event, NavSample):
            data = b"".join(bytes(message) for message in unit.measured(event, begin_s + at_s))  # type: ignore[arg-type]  # no frame of a bus
            arrivals.append((arrival_s, at_unit.name, data))
        else:
            messages = sonar.ping(event, DeviceTime(_ON_SINCE_S + at_s, begin_s + at_s))
            arrivals += [(arrival_s, at_sonar.name, message) for message in messages]
    arrivals.sort(key=lambda arrival: arrival[0])
    recorded = tuple(Recorded(port, "in", later(begin, at_s), data) for at_s, port, data in arrivals)
    first = next(event for event in timed if isinstance(event, Ping))
    return Run(config, recorded, begin_s + first.time_s - timed[0].time_s)


def later(begin: Stamp, by_s: float) -> Stamp:
    """Move a stamp."""
    return Stamp(begin.mono_ns + round(by_s * 1e9), begin.utc_ns + round(by_s * 1e9))


def write_session(run: Run, folder: Path) -> Path:
    """Write the recording of the service."""
    started = run.recorded[0].stamp
    writer = SessionWriter(
        folder, SessionDescription(version="0.1.0", started=started, config_yaml=config_yaml(run.config), ports=())
    )
    for recorded in run.recorded:
        writer.add(recorded)
    writer.close()
    return folder


def write_jsf(run: Run, path: Path) -> Path:
    """Write what EdgeTech's topside records: the sonar's messages, and sentences with the times at which they came."""
    return _written(run, path, jsf_string)


def write_svlog(run: Run, path: Path) -> Path:
    """Write what SonarView records: a head with the time of the first ping, then packets and sentences as they came."""
    return _written(run, path, lambda line, stamp: nmea_packet(line), svlog_head(run.first_ping_s))


def _written(run: Run, path: Path, wrap: Callable[[bytes, Stamp], bytes], head: bytes = b"") -> Path:
    parts = [head]
    for recorded in run.recorded:
        lines: Iterable[bytes] = recorded.data.splitlines(keepends=True) if recorded.port != "sonar" else ()
        parts += [wrap(line, recorded.stamp) for line in lines] if lines else [recorded.data]
    path.write_bytes(b"".join(parts))
    return path


def jsf_string(text: bytes, stamp: Stamp) -> bytes:
    """Wrap a sentence as the topside does, in a message of type 2002."""
    return jsf_wire(JsfMessage(2002, jsf_time(stamp) + text + b"\0", subsystem=101))


def jsf_time(stamp: Stamp) -> bytes:
    """Write the head of a message with the time."""
    seconds, nanoseconds = divmod(stamp.utc_ns, 1_000_000_000)
    return seconds.to_bytes(4, "little") + (nanoseconds // 1_000_000).to_bytes(4, "little") + bytes(4)


def nmea_packet(line: bytes) -> bytes:
    """Wrap a sentence as SonarView does."""
    return ping_wire(PingMessage(NMEA_WRAPPER, line))


def svlog_head(time_s: float) -> bytes:
    """Write the head of a log that begins at a UTC."""
    return encode(JsonWrapper({"session_id": 1, "timestamp": datetime.fromtimestamp(time_s, UTC).isoformat()}))
