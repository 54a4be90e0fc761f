"""Simulate the computer of an Iver under Remote Helm 5: it answers polls, and steers by `$OMS` while that is valid."""

from __future__ import annotations

import math
from typing import Final

from auv_mcm.records import NavSample
from drivers.vehicle.dialect import Vertical
from sim_replay.fakes.navigation import or_zero
from sim_replay.fakes.vehicles.text_controller import (
    TextController,
    clock,
    degrees_and_minutes,
    nmea_fields,
    nmea_line,
    report_from_fields,
    steer_of,
)

_KNOT_MPS: Final = 1852.0 / 3600.0  # m/s: a nautical mile in an hour
_FOOT_M: Final = 0.3048  # m, the international foot
_MAX_TIMEOUT_S: Final = 120.0  # s that a command may ask to hold


class FakeIver(TextController):
    """Simulate an Iver as `FakeController[bytes]`. It revokes control by the manual mode, as when a person steers."""

    def __init__(self) -> None:
        self._now_s = 0.0
        super().__init__()

    @property
    def mode(self) -> str:
        """Return the mode: N normal, A steered by the payload, M manual."""
        return "A" if self.in_control else "N" if self._may_grant(self._now_s) else "M"

    def _understood(self, line: str, now_s: float) -> list[bytes]:
        self._now_s = now_s
        name, *fields = nmea_fields(line)
        match name, *fields[:1]:
            case "OSD", *_:
                return [] if self._pose is None else self._polled(self._pose, fields)
            case "OMS", *_:
                return self._steered(fields, now_s)
            case "PMCM", "C":
                self._hear_report(report_from_fields(fields[1:]))
            case "PMCM", "H":
                self._hear_health(fields[1])
            case _:
                raise ValueError(f"not known: {name}")
        return []

    def _steered(self, fields: list[str], now_s: float) -> list[bytes]:
        heading, depth_m, max_pitch_deg, speed_kn, timeout_s = fields
        order = steer_of(heading, Vertical("depth", float(depth_m)), float(speed_kn) * _KNOT_MPS)
        if not (0.0 < float(max_pitch_deg) <= 45.0 and 0.0 <= float(timeout_s) <= _MAX_TIMEOUT_S):
            raise ValueError("pitch or time-out out of range")
        if self._may_grant(now_s):
            self.order_valid_s = float(timeout_s)
            self._obey(order, now_s)
        else:
            self.counters["vehicle.commands_refused"] += 1
        return []

    def _polled(self, pose: NavSample, what: list[str]) -> list[bytes]:
        heading_deg = math.degrees(or_zero(pose.heading_rad)) % 360.0
        speed_kn = or_zero(pose.speed_mps) / _KNOT_MPS
        depth_ft, altitude_ft = or_zero(pose.depth_m) / _FOOT_M, or_zero(pose.altitude_m) / _FOOT_M
        bodies: list[str] = []
        if "G" in what:
            place = (
                degrees_and_minutes(pose.latitude_deg, 2, "NS") + "," + degrees_and_minutes(pose.longitude_deg, 3, "EW")
            )
            bodies.append(f"GPRMC,{clock(pose.time_s)},A,{place},{speed_kn:.2f},{heading_deg:.1f},010120,,")
        if "C" in what:
            pitch_deg, roll_deg = math.degrees(or_zero(pose.pitch_rad)), math.degrees(or_zero(pose.roll_rad))
            bodies.append(f"C{heading_deg:.1f}P{pitch_deg:.2f}R{roll_deg:.2f}T20.3D{depth_ft:.1f}")
        if "S" in what:
            place = f"{pose.latitude_deg:.7f},{pose.longitude_deg:.7f}"
            rest = f"{altitude_ft:.2f},0,0.0,survey,60,{heading_deg:.1f},{depth_ft:.2f},0"
            bodies.append(f"OSI,80808080FF,{self.mode},2,{place},{speed_kn:.2f},100.0,N,{rest}")
        return [nmea_line(body) for body in bodies]

    def _outgoing(self, pose: NavSample, now_s: float) -> list[bytes]:
        self._now_s = now_s
        return []
