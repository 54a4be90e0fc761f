"""Simulate the computer of a Bluefin by its standard payload interface.

It sends the messages requested by `$BPLOG`, and answers every sentence by `$BFACK` once that is requested; times must
have three decimals. It grants control, by `$BFCTL`, while it hears `$BPSTS`. How long `$BPRMB` holds is not public;
here 5 s.
"""

from __future__ import annotations

import math
import re
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

_HEARTBEAT_VALID_S: Final = 20.0  # longer than a sentence's period, while which no other may come
_STATUS_EVERY_S: Final = 1.0  # s between status sentences
_TIME: Final = re.compile(r"\d{6}\.\d{3}")
_INVALID, _FAILED, _DONE = 0, 1, 2


class FakeBluefin(TextController):
    """Simulate a Bluefin as `FakeController[bytes]`.

    counters, besides those of the protocol: vehicle.elements_cancelled, `$BPRCE` that ended an element of its own plan,
    because the payload did not command.
    """

    def _forget(self) -> None:
        super()._forget()
        self._asked_for: set[str] = set()
        self._lets = False
        self._reported_lets: bool | None = None
        self._heartbeat_s = self._status_s = -math.inf

    def revoke(self, now_s: float) -> None:
        super().revoke(now_s)
        self._lets = False

    def _understood(self, line: str, now_s: float) -> list[bytes]:
        name, *fields = nmea_fields(line)
        if not name.startswith("BP"):
            raise ValueError(f"not for a vehicle: {name}")
        if name == "BPLOG":
            (self._asked_for.add if fields[1] == "ON" else self._asked_for.discard)(fields[0])
            if fields[0] == "CTL":
                self._reported_lets = None
            return self._answer(name, "", _DONE, "")
        try:
            status, text = self._done(name, fields, now_s)
        except (ValueError, IndexError) as error:
            status, text = _INVALID, str(error).replace(",", " ").replace("*", " ")
        return self._answer(name, fields[0], status, text)

    def _done(self, name: str, fields: list[str], now_s: float) -> tuple[int, str]:
        """Execute a sentence and return status and text of the answer. Raises ValueError or IndexError for invalid
        ones.
        """
        if _TIME.fullmatch(fields[0]) is None:
            raise ValueError("a time must have three decimals")
        match name:
            case "BPSTS":
                self._heartbeat_s = now_s
                self._hear_health(f"{'ok' if fields[1] == '1' else 'failed'}: {fields[2]}")
            case "BPRMB":
                if fields[3] not in ("0", "1") or fields[5:7] != ["1", "0"]:
                    raise ValueError("only heading, depth or altitude, and speed are flown")
                vertical = Vertical("altitude" if fields[3] == "1" else "depth", float(fields[2]))
                order = steer_of(fields[1], vertical, float(fields[4]))
                if not self._lets:
                    self.counters["vehicle.commands_refused"] += 1
                    return _FAILED, "the payload does not have control"
                self._obey(order, now_s)
            case "BPRCE":
                self.counters["vehicle.elements_cancelled"] += self._order is None
                self._order = None
            case "BPMCM":
                self._hear_report(report_from_fields(fields[1:]))
            case _:
                raise ValueError("not known")
        return _DONE, ""

    def _answer(self, name: str, of: str, status: int, text: str) -> list[bytes]:
        if "ACK" not in self._asked_for or self._pose is None:
            return []
        return [nmea_line(f"BFACK,{clock(self._pose.time_s)},{name[2:]},{of},0,{status},,{text}")]

    def _outgoing(self, pose: NavSample, now_s: float) -> list[bytes]:
        self._lets = self._may_grant(now_s) and now_s - self._heartbeat_s < _HEARTBEAT_VALID_S
        now = clock(pose.time_s)
        bodies: list[str] = []
        if "NVG" in self._asked_for:
            heading_deg, roll_deg, pitch_deg = (
                math.degrees(or_zero(angle)) for angle in (pose.heading_rad, pose.roll_rad, pose.pitch_rad)
            )
            place = (
                degrees_and_minutes(pose.latitude_deg, 2, "NS") + "," + degrees_and_minutes(pose.longitude_deg, 3, "EW")
            )
            vertical = f"{or_zero(pose.altitude_m):.2f},{or_zero(pose.depth_m):.2f}"
            how = f"{vertical},{heading_deg % 360.0:.1f},{roll_deg:.1f},{pitch_deg:.1f}"
            bodies.append(f"BFNVG,{now},{place},1,{how},{now}")
        if "NVR" in self._asked_for:
            east_mps = or_zero(pose.speed_mps) * math.sin(or_zero(pose.heading_rad))
            north_mps = or_zero(pose.speed_mps) * math.cos(or_zero(pose.heading_rad))
            bodies.append(f"BFNVR,{now},{east_mps:.3f},{north_mps:.3f},0.000,0.0,0.0,0.0")
        if "MIS" in self._asked_for and now_s - self._status_s >= _STATUS_EVERY_S:
            self._status_s = now_s
            bodies.append(f"BFMIS,{now},survey.txt,Running")
        if "CTL" in self._asked_for and self._lets != self._reported_lets:
            self._reported_lets = self._lets
            bodies.append(f"BFCTL,{now},{self._lets:d}")
        return [nmea_line(body) for body in bodies]
