"""Simulate the computer of a REMUS by RECON: an override is engaged, given goals, and ends when nothing keeps it alive.

How long goals hold is not public; here 5 s. It heeds nothing until it was asked something, as has been seen.
"""

from __future__ import annotations

import math
from typing import Final

from auv_mcm.records import NavSample
from drivers.vehicle.dialect import Steer, Vertical
from sim_replay.fakes.navigation import or_zero
from sim_replay.fakes.vehicles.text_controller import TextController, clock, report_from_fields, steer_of

_STATE_EVERY_S: Final = 0.5  # s between states
_IN_MISSION, _OVERRIDE, _NOT_ALLOWED = 0x01, 0x0C, 0x80
_GOALS: Final = ("Heading", "Depth", "Speed")


class FakeRecon(TextController):
    """Simulate RECON as `FakeController[bytes]`."""

    def _forget(self) -> None:
        super()._forget()
        self._override = self._asked = False
        self._goals: dict[str, float] = {}
        self._alive_s = self._state_s = -math.inf

    @property
    def in_control(self) -> bool:
        return self._override

    def revoke(self, now_s: float) -> None:
        super().revoke(now_s)
        self._end()

    def _end(self) -> None:
        self._override, self._order = False, None
        self._goals.clear()

    def _expire(self, now_s: float) -> None:
        was_ordered = self._order is not None
        super()._expire(now_s)
        if was_ordered and self._order is None:
            self._end()
        elif self._override and now_s - self._alive_s > self.order_valid_s:
            self.counters["vehicle.commands_expired"] += 1
            self._end()

    def _understood(self, line: str, now_s: float) -> list[bytes]:
        body, mark, checksum = line.rpartition("*")
        if not mark or not body.startswith("#") or f"{sum((body + mark).encode('ascii')) % 256:02X}" != checksum:
            raise ValueError("no frame")
        kind, *fields = body[1:].rstrip(",").split(",")
        self._alive_s = now_s
        match kind, *fields:
            case "Q", _:
                self._asked = True
            case "V", *_:
                self._hear_health(",".join(fields))
            case "E", "1":
                self._override = self._asked and self._may_grant(now_s)
            case "E", "0":
                self._end()
            case "C", goal, *rest:
                self._set_goal(goal, rest, now_s)
            case "K", *_:
                self._hear_report(report_from_fields(fields + [""] * (25 - len(fields))))
            case _:
                raise ValueError(f"not known: {kind}")
        return []

    def _set_goal(self, goal: str, rest: list[str], now_s: float) -> None:
        if (goal, *rest[:-1]) not in (("Heading", "Goal"), ("Depth", "Depth"), ("Speed",)):
            raise ValueError(f"not known: {goal}")
        value, _, unit = rest[-1].partition(" ")
        if unit != ("meters/sec" if goal == "Speed" else ""):
            raise ValueError(f"no unit of {goal}: {unit}")
        if not self._override:
            self.counters["vehicle.commands_refused"] += 1
            return
        goals = {**self._goals, goal: float(value)}
        if len(goals) == len(_GOALS):
            self._obey(_steer(goals), now_s)
        self._goals = goals

    def _outgoing(self, pose: NavSample, now_s: float) -> list[bytes]:
        if now_s - self._state_s < _STATE_EVERY_S:
            return []
        self._state_s = now_s
        mode = _IN_MISSION | (_OVERRIDE if self._override else 0 if self._may_grant(now_s) else _NOT_ALLOWED)
        time = clock(pose.time_s)
        pitch_deg, roll_deg = math.degrees(or_zero(pose.pitch_rad)), math.degrees(or_zero(pose.roll_rad))
        fields = (
            f"T{time[:2]}:{time[2:4]}:{time[4:]}",
            f"LAT{_place(pose.latitude_deg, 'NS')}",
            f"LON{_place(pose.longitude_deg, 'EW')}",
            f"D{or_zero(pose.depth_m):.2f}",
            "DG0.00",
            f"A{or_zero(pose.altitude_m):.2f}",
            f"P{pitch_deg:.1f}",
            f"R{roll_deg:.1f}",
            "TR1500",
            "TRG1500",
            f"V{or_zero(pose.speed_mps):.2f}",
            f"H{round(math.degrees(or_zero(pose.heading_rad)), 1) % 360.0:.1f}",
            "HR0.0",
            "HG0.0",
            f"M{mode:X}",
            "l1",
        )
        data = f"#S,{','.join(fields)},*".encode("ascii")
        return [data + b"%02X\n" % (sum(data) % 256)]


def _steer(goals: dict[str, float]) -> Steer:
    return steer_of(str(goals["Heading"]), Vertical("depth", goals["Depth"]), goals["Speed"])


def _place(degrees: float, hemispheres: str) -> str:
    """Format a place as 39N30.5553."""
    total = round(abs(degrees) * 60.0, 4)
    return f"{int(total // 60.0)}{hemispheres[degrees < 0.0]}{total % 60.0:07.4f}"
