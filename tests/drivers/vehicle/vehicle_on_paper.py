"""Record the calls of a dialect, for tests of what decides whether anything may be sent at all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from auv_mcm.clock import Stamp
from drivers.vehicle.dialect import Capability, Command, ContactReport, PayloadHealth, VehicleEvent, VehicleMessage

GOES_BY_ITSELF = (
    Capability.NAVIGATION | Capability.WAYPOINT | Capability.CONTACT | Capability.ACKNOWLEDGED | Capability.HEALTH
)
IS_STEERED = Capability.NAVIGATION | Capability.STEERING | Capability.CONTACT | Capability.HEALTH


def stamp(now_s: float) -> Stamp:
    return Stamp(round(now_s * 1e9), 0)


def calls(now_s: float, *events: VehicleEvent) -> VehicleMessage:
    """Make one message of the vehicle with this content."""
    return VehicleMessage(events, stamp(now_s))


class PaperTalker:
    """W is a line of text; what the vehicle says are the events themselves. Lines that wait when the wire opens anew
    are forgotten."""

    silent_after_s = 3.0
    command_period_s = 1.0

    def __init__(self, capabilities: Capability = GOES_BY_ITSELF) -> None:
        self.capabilities = capabilities
        self.counters: Counter[str] = Counter()
        self.calls: list[
            str
        ] = []  # connected, disconnected, request, release REASON, command, report N.R, health STATE
        self.commands: list[tuple[float, Command]] = []
        self.reports: list[tuple[float, ContactReport, int]] = []
        self._lines: list[str] = []

    def connected(self, now_s: float) -> None:
        self._lines.clear()
        self._note("connected")

    def disconnected(self) -> None:
        self._note("disconnected")

    def hear(self, calls: Sequence[VehicleMessage], stamp: Stamp) -> list[VehicleEvent]:
        return [event for message in calls for event in message.record]

    def request(self, now_s: float) -> None:
        self._note("request")

    def command(self, command: Command, now_s: float) -> None:
        self.commands.append((now_s, command))
        self._note("command")

    def report(self, report: ContactReport, ticket: int, now_s: float) -> None:
        self.reports.append((now_s, report, ticket))
        self._note(f"report {report.number}.{report.revision}")

    def report_health(self, health: PayloadHealth, now_s: float) -> None:
        self._note(f"health {health.state}")

    def release(self, reason: str, now_s: float) -> None:
        self._lines = [line for line in self._lines if line != "command"]
        self._note(f"release {reason}")

    def take_outgoing(self, now_s: float) -> list[str]:
        self._lines.clear()
        return []

    def _note(self, line: str) -> None:
        self.calls.append(line)
        self._lines.append(line)
