"""Talk to a REMUS by RECON: text frames by UDP port 23456 both ways, or a serial line.

`#S` reports the state, with a time of day in UTC. `#E,1` engages an override and `#E,0` ends it; `#C` sets its goals
and `#V`, whose text is free and reports health here, keeps the connection alive while there are none. Only depths are
commanded.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, Final

from auv_mcm.clock import Stamp
from auv_mcm.settings.vehicle_settings import ReconSettings
from drivers.vehicle.dialect import Capability, ContactReport, ReportedState, Steer, VehicleEvent, Vertical, WireCommand
from drivers.vehicle.recon_sentences import (
    ReconAlive,
    ReconContact,
    ReconDepth,
    ReconEngage,
    ReconHeading,
    ReconQuery,
    ReconShutdown,
    ReconSpeed,
    ReconState,
    frame,
    table_of,
)
from drivers.vehicle.talkers.ascii_talker import AsciiTalker, PacedReports
from drivers.vehicle.wire_steps import shallower, slower

_IN_MISSION: Final = 0x01  # bits of the vehicle's mode (RECON interface)
_SUSPENDED: Final = 0x02  # see _IN_MISSION
_ENABLED: Final = 0x04  # see _IN_MISSION
_ACTIVE: Final = 0x08  # see _IN_MISSION: the override is on
_SHORE_POWER: Final = 0x10  # see _IN_MISSION
_DEPTH_ONLY: Final = 0x40  # see _IN_MISSION: the mission allows an override of depth only
_NOT_ALLOWED: Final = 0x80  # see _IN_MISSION

_KEEP_ALIVE_S: Final = 1.0  # s between two messages, minimum, that keep the connection alive
_ENGAGE_EVERY_S: Final = 1.0  # s between two requests for the override
_STEP: Final = 0.01  # m of depth, and m/s, of the wire


class ReconTalker(AsciiTalker):
    """Talk to a REMUS by RECON. Counts also recon.command_without_floor: altitudes, which it cannot be commanded.

    An override that is active while it was not requested, as one left by a payload that died or whose end was lost, is
    ended, unless ends_what_is_left is False.
    """

    ends_what_is_left = True

    one_sentence = re.compile(rb"#([\x20-\x22\x24-\x29\x2b-\x7e]*),\*[0-9A-F]{2}\n")
    commanding = frozenset({ReconHeading, ReconDepth, ReconSpeed})
    harmless = frozenset({ReconAlive, ReconContact, ReconEngage, ReconQuery})

    def __init__(self, settings: ReconSettings) -> None:
        optional = Capability.CONTACT if settings.contact_type else Capability(0)
        always = Capability.NAVIGATION | Capability.STEERING | Capability.DEPTHS_ALONE | Capability.HEALTH
        super().__init__("recon", table_of(settings), always | optional)
        self._reports_wanted = bool(settings.contact_type)
        self._reports = PacedReports()
        self._orders: list[Any] = []  # to be sent next, in this order
        self._engage_s = self._disengage_s = 0.0

    def report(self, report: ContactReport, ticket: int, now_s: float) -> None:
        if self._open and self._reports_wanted:
            self._reports.add(report)

    def _greet(self, now_s: float) -> None:
        self._health_s = self._disengage_s = now_s

    def _forget(self) -> None:
        self._reports.clear()
        self._orders.clear()

    def _heard(self, record: Any, state: ReportedState | None, received: Stamp) -> Iterable[VehicleEvent]:
        now_s = 1e-9 * received.mono_ns
        if isinstance(record, ReconShutdown):
            yield from self._end_of_control("the vehicle shuts down its payloads", now_s)
        elif isinstance(record, ReconState):
            yield from self._judge(record.mode, now_s)
        if state is not None:
            yield state

    def _judge(self, mode: int, now_s: float) -> list[VehicleEvent]:
        why_not = _why_not(mode)
        active = mode & _ACTIVE != 0
        is_left = active and not self._wanted and self._open and self.ends_what_is_left
        if is_left and now_s >= self._disengage_s:
            self._disengage(now_s)
        if why_not:
            return self._end_of_control(f"{why_not} (mode {mode:02X})", now_s)
        if active and mode & _ENABLED:
            return self._grant(f"override is active (mode {mode:02X})")
        if self._granted:
            return self._end_of_control(f"override has ended (mode {mode:02X})", now_s)
        return []

    def _end_of_control(self, reason: str, now_s: float) -> list[VehicleEvent]:
        events = self._withhold(reason)
        if events:
            self._disengage(now_s)
        return events

    def _disengage(self, now_s: float) -> None:
        self._disengage_s = now_s + _ENGAGE_EVERY_S
        self._orders = [ReconEngage("0")]

    def _ask(self, now_s: float) -> None:
        if not self._granted:
            self._engage_s = now_s

    def _steer(self, steer: Steer, now_s: float) -> None:
        if steer.vertical.reference != "depth":
            self._own["recon.command_without_floor"] += 1
            return
        self._health_s = now_s + 2.0 * _KEEP_ALIVE_S  # until then the command keeps the connection alive
        depth_m = max(shallower(steer.vertical, _STEP).value_m, 0.0)
        speed_mps = slower(steer.speed_mps, _STEP)
        self._orders = [ReconHeading(steer.heading_rad), ReconDepth(depth_m), ReconSpeed(speed_mps)]

    def _numbers(self, record: ReconHeading | ReconDepth | ReconSpeed) -> WireCommand:
        match record:
            case ReconHeading(heading_rad):
                return WireCommand(heading_rad=heading_rad)
            case ReconDepth(depth_m):
                return WireCommand(vertical=Vertical("depth", depth_m))
            case ReconSpeed(speed_mps):
                return WireCommand(speed_mps=speed_mps)

    def _stop_commanding(self) -> None:
        self._orders.clear()

    def _let_go(self, wanted: bool, now_s: float) -> None:
        self._orders.clear()
        if wanted:
            self._disengage(now_s)

    def _outgoing(self, now_s: float) -> list[bytes]:
        records, self._orders = self._orders, []
        if self._wanted and not self._granted and now_s >= self._engage_s:
            self._engage_s = now_s + _ENGAGE_EVERY_S
            # a REMUS has been seen to heed nothing before it was asked something
            records += [ReconQuery("Depth"), ReconEngage("1")]
        if now_s >= self._health_s:
            self._health_s = now_s + _KEEP_ALIVE_S
            records.append(ReconAlive(self._health_text()))
        report = self._reports.take(now_s)
        if report is not None:
            records.append(ReconContact(report))
        return [frame(self._table.body_of(record)) for record in records]


def _why_not(mode: int) -> str:
    """Return why this mode allows no override; empty if it does."""
    if mode & _SHORE_POWER:
        return "the vehicle is on shore power"
    if mode & _NOT_ALLOWED:
        return "the vehicle does not allow an override"
    if mode & _DEPTH_ONLY:
        return "the vehicle allows an override of depth only"
    if not mode & _IN_MISSION or mode & _SUSPENDED:
        return "no mission is running"
    return ""
