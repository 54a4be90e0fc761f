"""Talk to an Iver by Remote Helm of OceanServer/L3Harris: NMEA 0183 sentences on a serial line, 19200 baud.

The vehicle is polled by `$OSD`; `$OSI` reports its state and `$C` its compass, `$OMS` steers it. There is no handshake:
the vehicle's mode says whether it obeys, and a command is void after the time that it carries, so control is given back
by saying nothing. Only depths can be commanded.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

from auv_mcm.clock import Stamp
from auv_mcm.settings.vehicle_settings import IverSettings
from drivers.navigation.sentences import KNOT_MPS
from drivers.vehicle.ascii_fields import FOOT_M
from drivers.vehicle.dialect import Capability, ContactReport, ReportedState, Steer, VehicleEvent, Vertical, WireCommand
from drivers.vehicle.iver_sentences import (
    METRES_SINCE,
    IverContact,
    IverHealth,
    IverPoll,
    IverState,
    IverSteer,
    line_of,
    table_of,
)
from drivers.vehicle.talkers.ascii_talker import AsciiTalker, PacedReports
from drivers.vehicle.wire_steps import shallower, slower

_HEALTH_EVERY_S: Final = 1.0  # s between two reports of health
_MODES: Final = {
    "N": "normal",
    "S": "stopped",
    "P": "parking",
    "M": "manual override",
    "m": "manual parking",
    "A": "servo",
    "W": "mission",
}
_OBEYING: Final = frozenset("NAW")
_STEPS: Final = 10  # of the wire in a metre or foot of depth, and in a knot


class IverTalker(AsciiTalker):
    """Talk to an Iver under Remote Helm.

    Counts also iver.command_without_floor: altitudes, which it cannot be commanded (not sent).
    """

    commanding = frozenset({IverSteer})
    harmless = frozenset({IverPoll, IverHealth, IverContact})

    def __init__(self, settings: IverSettings) -> None:
        optional = Capability.CONTACT | Capability.HEALTH if settings.contact_sentence else Capability(0)
        always = Capability.NAVIGATION | Capability.STEERING | Capability.DEPTHS_ALONE
        super().__init__("iver", table_of(settings), always | optional)
        self.command_period_s = min(1.0, settings.command_timeout_s / 4)
        self._settings = settings
        self._reports = PacedReports()
        self._depth_step_m = (1.0 if settings.remote_helm_version >= METRES_SINCE else FOOT_M) / _STEPS
        self._mode = ""
        self._order: IverSteer | None = None
        self._poll_s = 0.0

    def report(self, report: ContactReport, ticket: int, now_s: float) -> None:
        if self._open and self._settings.contact_sentence:
            self._reports.add(report)

    def _greet(self, now_s: float) -> None:
        self._poll_s = self._health_s = now_s

    def _forget(self) -> None:
        self._reports.clear()
        self._order = None
        self._mode = ""

    def _heard(self, record: Any, state: ReportedState | None, received: Stamp) -> Iterable[VehicleEvent]:
        if isinstance(record, IverState):
            yield from self._judge(record.mode[0])
        if state is not None:
            yield state

    def _judge(self, mode: str) -> list[VehicleEvent]:
        self._mode = mode
        reason = f"the vehicle is in mode {mode} ({_MODES.get(mode, 'not known')})"
        return self._grant(reason) if mode in _OBEYING else self._withhold(reason)

    def _ask(self, now_s: float) -> None:
        self._poll_s = now_s

    def _steer(self, steer: Steer, now_s: float) -> None:
        if steer.vertical.reference != "depth":
            self._own["iver.command_without_floor"] += 1
            return
        settings = self._settings
        self._order = IverSteer(
            steer.heading_rad,
            max(shallower(steer.vertical, self._depth_step_m).value_m, 0.0),
            settings.max_pitch_deg,
            slower(steer.speed_mps, KNOT_MPS / _STEPS),
            settings.command_timeout_s,
        )

    def _numbers(self, record: IverSteer) -> WireCommand:
        return WireCommand(
            heading_rad=record.heading_rad,
            vertical=Vertical("depth", record.depth_m),
            speed_mps=record.speed_mps,
            holds_s=record.timeout_s,
        )

    def _stop_commanding(self) -> None:
        self._order = None

    def _let_go(self, wanted: bool, now_s: float) -> None:
        self._order = None

    def _outgoing(self, now_s: float) -> list[bytes]:
        records: list[Any] = []
        if self._order is not None:
            records.append(self._order)
            self._order = None
        if now_s >= self._poll_s:
            self._poll_s = now_s + self._settings.poll_s
            records.append(IverPoll())
        if self._settings.contact_sentence and now_s >= self._health_s:
            self._health_s = now_s + _HEALTH_EVERY_S
            records.append(IverHealth(self._health_text()))
        report = self._reports.take(now_s)
        if report is not None:
            records.append(IverContact(report))
        return [line_of(self._table, record) for record in records]
