"""Turn the bytes of all ports into one stream of events: decode, time, pair heads, merge navigation. It reads no
clock."""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final, TypeVarTuple

from auv_mcm.clock import Stamp
from auv_mcm.records import Notice, Ping, SourceEvent
from auv_mcm.settings.config import Config
from auv_mcm.source import QuantityState
from drivers.heads import HeadPairer
from drivers.navigation.merge import NavMerge
from drivers.navigation.nav_decoder import NavFix
from drivers.port_stream import Decoded, PortStream
from drivers.ports import PULSE, merge_settings, read_ports
from drivers.utc import UtcReference
from drivers.vehicle.dialect import VehicleMessage

log = logging.getLogger(__name__)
Ts = TypeVarTuple("Ts")

NO_PORT: Final = ""
"""The name under which ticks of the clock are fed and recorded."""


class PortIntake:
    """Decode and merge all ports. The result depends on the configuration and on what is fed alone.

    Navigation comes out in order of time, a fraction of a second after it was measured; each sonar's pings in order of
    theirs. Both are in the UTC of this computer, or of the unit that gives UTC, at the arrival of the bytes; slewed for
    small corrections, with a notice for a step.

    pinged_ns: by a sonar's port, monotonic time of the bytes that its newest ping came with.
    """

    def __init__(self, config: Config) -> None:
        """Raises UsageError for ports that cannot be."""
        ports = read_ports(config, sends=False)
        self._utc = UtcReference(next((port for port in ports if port.unit is not None and port.unit.gives_utc), None))
        self._streams = {
            port.name: PortStream(port, config.sonar, self._utc.anchor) for port in ports if port.device != PULSE
        }
        self._pulses = {port.name for port in ports if port.device == PULSE}
        self._heads = HeadPairer() if {"port", "starboard"} <= {port.sides for port in ports} else None
        self._merge = NavMerge(merge_settings(config, ports))
        self._own: Counter[str] = Counter()
        self.pinged_ns: dict[str, int] = {}

    @property
    def counters(self) -> Counter[str]:
        """Return counters by dotted name.

        Those of each port behind `port.NAME.`, and nav.*, heads.*, utc.*, intake.failed, intake.unknown_port.
        """
        counters = self._own + self._merge.counters + self._utc.counters
        if self._heads is not None:
            counters += self._heads.counters
        for name, stream in self._streams.items():
            counters += Counter({f"port.{name}.{key}": count for key, count in stream.counters.items()})
        return counters

    def feed(self, port: str, data: bytes, stamp: Stamp) -> list[SourceEvent]:
        """Take bytes of one port, in the order in which they were read. Empty ones only pass the time."""
        events: list[SourceEvent] = [*self._utc.passed(stamp)]
        stamp = Stamp(stamp.mono_ns, self._utc.anchor.utc_ns(stamp.mono_ns))
        if port in self._pulses:
            self._utc.pulse(data)
        elif data:
            stream = self._streams.get(port)
            if stream is None:
                self._own["intake.unknown_port"] += 1
            else:
                decoded = stream.feed(data, stamp)
                if any(isinstance(item, Ping) for item in decoded):
                    self.pinged_ns[port] = stamp.mono_ns
                events += self._merged(decoded)
        return events + self._survived(self._merge.advance, stamp)

    def heard(self, port: str) -> list[VehicleMessage]:
        """Return the vehicle's messages in the bytes that were fed to this port last."""
        return self._streams[port].heard

    def vehicle_counters(self, port: str) -> Counter[str]:
        """Return the counters of the vehicle's decoder."""
        return self._streams[port].vehicle_counters

    def decode(self, port: str, data: bytes, stamp: Stamp) -> None:
        """Take bytes of a vehicle after `finish`, for `heard` alone."""
        self._streams[port].feed(data, stamp)

    def quantities(self) -> tuple[QuantityState, ...]:
        """Describe position, and every other quantity of navigation that was ever given, as of the newest bytes."""
        return tuple(
            QuantityState(quantity, health.serving or "", min(health.age_s.values(), default=math.inf))
            for quantity, health in self._merge.health().items()
            if health.age_s or quantity == "position"
        )

    def finish(self) -> list[SourceEvent]:
        """End the stream: no bytes that count follow."""
        events: list[SourceEvent] = []
        for stream in self._streams.values():
            events += self._merged(stream.finish())
        if self._heads is not None:
            events += self._heads.finish()
        return events + self._survived(self._merge.finish)

    def _merged(self, decoded: list[Decoded]) -> list[SourceEvent]:
        events: list[SourceEvent] = []
        for item in decoded:
            if isinstance(item, NavFix):
                events += self._utc.take_fix(item)
                events += self._survived(self._merge.feed, item)
            elif isinstance(item, Ping) and self._heads is not None:
                events += self._heads.add(item)
            else:
                events.append(item)
        return events

    def _survived(self, work: Callable[[*Ts], Sequence[SourceEvent]], *given: *Ts) -> list[SourceEvent]:
        """Return the events of merging; if it fails, which is a defect, count and report the loss of its input."""
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
