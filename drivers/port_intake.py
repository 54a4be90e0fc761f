"""From the bytes of all ports to one stream of events: decoding, times, pairing of heads, merging of navigation. It reads no clock."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final, TypeVarTuple

from auv_mcm.clock import Stamp
from auv_mcm.records import Notice, Ping, SourceEvent
from auv_mcm.settings.config import Config
from drivers.heads import HeadPairer
from drivers.navigation.merge import NavMerge
from drivers.navigation.nav_decoder import NavFix
from drivers.port_stream import PortStream, Told
from drivers.ports import PULSE, merge_settings, read_ports
from drivers.utc import UtcReference
from drivers.vehicle.dialect import Said

log = logging.getLogger(__name__)
Ts = TypeVarTuple("Ts")

NO_PORT: Final = ""
"""The name under which ticks of the clock are fed and recorded."""


class PortIntake:
    """Decoders and merging of all ports. What comes out depends on the configuration and on what is fed alone.

    Navigation comes out in order of time, a fraction of a second after it was measured; each sonar's pings in order of theirs. Both are
    in the UTC that this computer, or the unit that gives UTC, had when the bytes came; slewed where it was set by little, with a notice
    where it stepped.
    """

    def __init__(self, config: Config) -> None:
        """Raises UsageError for ports that cannot be."""
        ports = read_ports(config)
        self._utc = UtcReference(next((port for port in ports if port.unit is not None and port.unit.gives_utc), None))
        self._streams = {port.name: PortStream(port, config.sonar, self._utc.anchor) for port in ports if port.device != PULSE}
        self._pulses = {port.name for port in ports if port.device == PULSE}
        self._heads = HeadPairer() if {"port", "starboard"} <= {port.sides for port in ports} else None
        self._merge = NavMerge(merge_settings(config, ports))
        self._own: Counter[str] = Counter()

    @property
    def counters(self) -> Counter[str]:
        """By dotted name: those of each port behind `port.NAME.`, and nav.*, heads.*, utc.*, intake.failed, intake.unknown_port."""
        counters = self._own + self._merge.counters + self._utc.counters
        if self._heads is not None:
            counters += self._heads.counters
        for name, stream in self._streams.items():
            counters += Counter({f"port.{name}.{key}": count for key, count in stream.counters.items()})
        return counters

    def feed(self, port: str, data: bytes, stamp: Stamp) -> list[SourceEvent]:
        """Bytes of one port, in the order in which they were read. Empty ones only say how late it is."""
        events: list[SourceEvent] = [*self._utc.passed(stamp)]
        stamp = Stamp(stamp.mono_ns, self._utc.anchor.utc_ns(stamp.mono_ns))
        if port in self._pulses:
            self._utc.pulse(data)
        elif data:
            stream = self._streams.get(port)
            if stream is None:
                self._own["intake.unknown_port"] += 1
            else:
                events += self._merged(stream.feed(data, stamp))
        return events + self._survived(self._merge.advance, stamp)

    def heard(self, port: str) -> list[Said]:
        """What the vehicle at this port said in the bytes that were fed to it last."""
        return self._streams[port].heard

    def vehicle_counters(self, port: str) -> Counter[str]:
        """Those of the vehicle's decoder."""
        return self._streams[port].vehicle_counters

    def decode(self, port: str, data: bytes, stamp: Stamp) -> None:
        """Bytes of a vehicle after `finish`, for `heard` alone."""
        self._streams[port].feed(data, stamp)

    def finish(self) -> list[SourceEvent]:
        """No bytes follow that count."""
        events: list[SourceEvent] = []
        for stream in self._streams.values():
            events += self._merged(stream.finish())
        if self._heads is not None:
            events += self._heads.finish()
        return events + self._survived(self._merge.finish)

    def _merged(self, told: list[Told]) -> list[SourceEvent]:
        events: list[SourceEvent] = []
        for item in told:
            if isinstance(item, NavFix):
                events += self._utc.told(item)
                events += self._survived(self._merge.feed, item)
            elif isinstance(item, Ping) and self._heads is not None:
                events += self._heads.add(item)
            else:
                events.append(item)
        return events

    def _survived(self, work: Callable[[*Ts], Sequence[SourceEvent]], *given: *Ts) -> list[SourceEvent]:
        """What merging says; if it fails, which is a defect, what it was given is lost, and that is counted and told."""
        try:
            return [*work(*given)]
        except Exception as error:
            self._own["intake.failed"] += 1
            if self._own["intake.failed"] > 1:
                return []
            log.exception("merging navigation failed")
            text = f"merging navigation failed ({error!r}); what it was given is lost. "
            text += "This is a defect: report it with the log and the recording."
            return [Notice(code="intake_failed", text=text)]
