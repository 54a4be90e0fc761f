"""Talk to an ACME vehicle: lines of text, both ways.

`STATE latitude longitude heading depth altitude speed`, in degrees, m and m/s, comes from the vehicle. `CONTACT station
number revision latitude longitude p_mine class` and `HEALTH station state` go to it. The vehicle acknowledges nothing
and takes no commands.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from typing import Annotated, Any, Final

import msgspec
from msgspec import Meta

from auv_mcm.clock import Stamp
from drivers.vehicle.dialect import (
    Capability,
    Command,
    ContactReport,
    PayloadHealth,
    ReportedState,
    VehicleEvent,
    VehicleMessage,
    fix_of,
)
from drivers.vehicle.vehicles import VehicleKind

_MAX_LINE_BYTES: Final = 256


class AcmeSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Set up an ACME vehicle, in the section `options` of its port."""

    station: Annotated[int, Meta(ge=0, le=99, description="number of the payload on the vehicle")] = 1


class AcmeDecoder:
    """Decode the lines of one vehicle."""

    def __init__(self, settings: AcmeSettings, port: str) -> None:
        self.counters: Counter[str] = Counter()
        self.bus_counters: Counter[str] = Counter()
        self._port = port
        self._rest = b""

    def feed(self, data: bytes, stamp: Stamp) -> list[VehicleMessage]:
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-_MAX_LINE_BYTES:]
        return [self._message(line, stamp) for line in lines]

    def _message(self, line: bytes, stamp: Stamp) -> VehicleMessage:
        word, *values = line.split()[:7] or [b""]
        try:
            latitude, longitude, heading, depth, altitude, speed = map(float, values)
        except ValueError:
            self.counters["acme_vehicle.refused.malformed"] += 1
            return VehicleMessage(None, stamp)
        if word != b"STATE" or not math.isfinite(latitude + longitude + heading + depth + altitude + speed):
            self.counters["acme_vehicle.refused.malformed"] += 1
            return VehicleMessage(None, stamp)
        self.counters["acme_vehicle.messages"] += 1
        state = ReportedState(
            received=stamp,
            latitude_deg=latitude,
            longitude_deg=longitude,
            heading_rad=math.radians(heading),
            depth_m=depth,
            altitude_m=altitude,
            speed_mps=speed,
        )
        return VehicleMessage(state, stamp, state, (fix_of(self._port, state),))


class AcmeTalker:
    """Report contacts and health; the vehicle takes no commands, so that control is never requested of it."""

    capabilities = Capability.NAVIGATION | Capability.CONTACT | Capability.HEALTH
    silent_after_s = 5.0
    command_period_s = 1.0

    def __init__(self, settings: AcmeSettings) -> None:
        self.counters: Counter[str] = Counter()
        self._station = settings.station
        self._outgoing: deque[bytes] = deque()

    def connected(self, now_s: float) -> None:
        self._outgoing.clear()

    def disconnected(self) -> None:
        self._outgoing.clear()

    def hear(self, messages: Sequence[VehicleMessage], stamp: Stamp) -> list[VehicleEvent]:
        return [message.state for message in messages if message.state is not None]

    def request(self, now_s: float) -> None: ...

    def command(self, command: Command, now_s: float) -> None: ...

    def report(self, report: ContactReport, ticket: int, now_s: float) -> None:
        place = f"{report.latitude_deg:.7f} {report.longitude_deg:.7f}"
        contact = f"{report.number} {report.revision} {place} {report.p_mine:.3f} {report.classification}"
        self._outgoing.append(f"CONTACT {self._station} {contact}\n".encode("ascii"))

    def report_health(self, health: PayloadHealth, now_s: float) -> None:
        self._outgoing.append(f"HEALTH {self._station} {health.state}\n".encode("ascii"))

    def release(self, reason: str, now_s: float) -> None: ...

    def take_outgoing(self, now_s: float) -> list[bytes]:
        outgoing = list(self._outgoing)
        self._outgoing.clear()
        return outgoing


def _make_talker(settings: AcmeSettings, drawn: int) -> Any:
    return AcmeTalker(settings)


VEHICLE: Final = VehicleKind(AcmeDecoder, _make_talker, AcmeSettings)
