"""A vehicle's controller that speaks plain words, and the little that a host needs to talk to it."""

from __future__ import annotations

from collections import Counter

from auv_mcm.records import NavSample
from drivers.vehicle.dialect import Command, ContactReport, GoTo, Vertical
from tests.make.records import report_of

FORGETS_S = 0.5


class PlainController:
    """Lines: ASK, GOTO LATITUDE LONGITUDE, KEEP, RELEASE, REPORT NUMBER REVISION P_MINE, FINE; it sends its place, yes,
    no, and there."""

    def __init__(self) -> None:
        self.willing = True
        self.forgets_s = FORGETS_S
        self.power_up(0.0)
        self.counters: Counter[str] = Counter()
        self.connections = 0
        self.poses: list[NavSample] = []

    def power_up(self, now_s: float) -> None:
        self.in_control = False
        self.command: Command | None = None
        self._kept_s = now_s
        self._rest = b""
        self._reports: list[ContactReport] = []
        self._reported: set[tuple[int, int]] = set()
        self._health: list[str] = []

    def revoke(self, now_s: float) -> None:
        self.in_control, self.command = False, None

    def connected(self, now_s: float) -> None:
        self.connections += 1

    def take_reports(self) -> list[ContactReport]:
        reports, self._reports = self._reports, []
        return reports

    def take_health(self) -> list[str]:
        health, self._health = self._health, []
        return health

    def tick(self, pose: NavSample, arrived: bool, now_s: float) -> list[bytes]:
        self.poses.append(pose)
        if self.in_control and now_s - self._kept_s > self.forgets_s:
            self.revoke(now_s)
            self.counters["vehicle.commands_expired"] += 1
        return [f"at {pose.latitude_deg:.8f} {pose.longitude_deg:.8f}\n".encode()] + [b"there\n"] * arrived

    def heard(self, data: bytes, now_s: float) -> list[bytes]:
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [answer for line in lines for answer in self._answers(line.decode("ascii", "replace").split(), now_s)]

    def _answers(self, words: list[str], now_s: float) -> list[bytes]:
        self._kept_s = now_s
        match words:
            case ["ASK"]:
                self.in_control = self.willing
                return [b"yes\n" if self.willing else b"no\n"]
            case ["GOTO", latitude_deg, longitude_deg] if self.in_control:
                self.command = GoTo(float(latitude_deg), float(longitude_deg), Vertical("altitude", 5.0), 4.0, 3.0)
                self.counters["vehicle.commands_accepted"] += 1
            case ["GOTO", *_]:
                self.counters["vehicle.commands_refused"] += 1
            case ["RELEASE"]:
                self.revoke(now_s)
            case ["REPORT", number, revision, p_mine]:
                self._report_contact(int(number), int(revision), float(p_mine))
            case ["FINE"]:
                self._health.append("fine")
            case ["KEEP"]:
                pass
            case _:
                self.counters["vehicle.nonsense"] += 1
        return []

    def _report_contact(self, number: int, revision: int, p_mine: float) -> None:
        self.counters["vehicle.reports"] += 1
        if (number, revision) in self._reported:
            self.counters["vehicle.reports_repeated"] += 1
            return
        self._reported.add((number, revision))
        self._reports.append(
            report_of(session=1, number=number, revision=revision, p_mine=p_mine, classification="unknown", belief={})
        )
