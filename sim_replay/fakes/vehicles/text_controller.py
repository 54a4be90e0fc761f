"""Share what controllers with lines of text have in common: lines, reports, health, and who has been in control since
when.

Lines are taken apart here without the driver's tables, so that both ends of a wire do not err alike.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter
from typing import Final, get_args

from auv_mcm.records import ContactClass, NavSample
from drivers.vehicle.dialect import ContactReport, Steer, Vertical

REGRANT_S: Final = 10.0  # after control was taken back
_MAX_LINE_BYTES: Final = 4096  # bounds memory
_CLASSES: Final[tuple[ContactClass, ...]] = get_args(ContactClass)


class TextController(ABC):
    """Build a `FakeController[bytes]` on a text language. `_order` is the payload's command, given at `_order_s`."""

    order_valid_s = 5.0

    def __init__(self) -> None:
        self.willing = True
        self.counters: Counter[str] = Counter()
        self._reported: list[ContactReport] = []
        self._health: list[str] = []
        self._forget()

    def _forget(self) -> None:
        self._buffer = b""
        self._known: set[tuple[int, int, int]] = set()
        self._last_health = ""
        self._pose: NavSample | None = None
        self._order: Steer | None = None
        self._order_s = self._not_before_s = -math.inf

    @property
    def in_control(self) -> bool:
        return self._order is not None

    @property
    def command(self) -> Steer | None:
        return self._order

    def take_reports(self) -> list[ContactReport]:
        reported, self._reported = self._reported, []
        return reported

    def take_health(self) -> list[str]:
        health, self._health = self._health, []
        return health

    def power_up(self, now_s: float) -> None:
        self._forget()

    def revoke(self, now_s: float) -> None:
        self._order = None
        self._not_before_s = now_s + REGRANT_S

    def connected(self, now_s: float) -> None:
        self._buffer = b""

    def tick(self, pose: NavSample, arrived: bool, now_s: float) -> list[bytes]:
        self._pose = pose
        self._expire(now_s)
        return self._outgoing(pose, now_s)

    def heard(self, data: bytes, now_s: float) -> list[bytes]:
        self._expire(now_s)
        *lines, rest = (self._buffer + data).split(b"\n")
        self._buffer = rest[-_MAX_LINE_BYTES:]
        answers: list[bytes] = []
        for line in lines:
            try:
                answers += self._understood(line.rstrip(b"\r").decode("ascii"), now_s)
            except (ValueError, IndexError, OverflowError):
                self.counters["vehicle.nonsense"] += 1
        return answers

    def _may_grant(self, now_s: float) -> bool:
        return self.willing and now_s >= self._not_before_s

    def _expire(self, now_s: float) -> None:
        if self._order is not None and now_s - self._order_s > self.order_valid_s:
            self.counters["vehicle.commands_expired"] += 1
            self._order = None

    def _obey(self, order: Steer, now_s: float) -> None:
        self.counters["vehicle.commands_accepted"] += 1
        self._order, self._order_s = order, now_s

    def _hear_health(self, text: str) -> None:
        if text != self._last_health:
            self._last_health = text
            self._health.append(text)

    def _hear_report(self, report: ContactReport) -> None:
        identity = report.session, report.number, report.revision
        if identity in self._known:
            self.counters["vehicle.reports_repeated"] += 1
            return
        self._known.add(identity)
        self.counters["vehicle.reports"] += 1
        self._reported.append(report)

    @abstractmethod
    def _understood(self, line: str, now_s: float) -> list[bytes]:
        """Answer a line without its end. Raises ValueError or IndexError for nonsense."""

    @abstractmethod
    def _outgoing(self, pose: NavSample, now_s: float) -> list[bytes]:
        """Return the messages that are due."""


def report_from_fields(fields: list[str]) -> ContactReport:
    """Decode a contact from its 25 fields. Raises ValueError or IndexError for anything else."""
    if len(fields) != 25:
        raise ValueError(f"{len(fields)} fields instead of 25")
    belief: dict[str, float] = dict(zip(_CLASSES, map(float, fields[12:18]), strict=True))
    sizes = [_number(text) for text in fields[19:25]]
    return ContactReport(
        session=int(fields[0]),
        number=int(fields[1]),
        revision=int(fields[2]),
        time_s=float(fields[3]),
        latitude_deg=_degrees(fields[4], fields[5] == "S"),
        longitude_deg=_degrees(fields[6], fields[7] == "W"),
        sigma_m=_number(fields[8]),
        depth_m=_number(fields[9]),
        classification=_CLASSES[_CLASSES.index(fields[10])],
        p_mine=float(fields[11]),
        belief=belief,
        n_views=int(fields[18]),
        length_m=sizes[0],
        length_sigma_m=sizes[1],
        width_m=sizes[2],
        width_sigma_m=sizes[3],
        height_m=sizes[4],
        height_sigma_m=sizes[5],
    )


def steer_of(heading: str, vertical: Vertical, speed_mps: float) -> Steer:
    """Decode an order to hold a heading in degrees. Raises ValueError for an impossible one."""
    heading_deg = float(heading)
    if not (0.0 <= heading_deg < 360.0 and 0.0 <= speed_mps < 10.0 and 0.0 <= vertical.value_m < 6000.0):
        raise ValueError("no course that can be steered")
    return Steer(math.radians(heading_deg), vertical, speed_mps)


def nmea_fields(line: str) -> list[str]:
    """Split a sentence into fields. Raises ValueError if its checksum is wrong."""
    body, mark, checksum = line.rpartition("*")
    if not mark or not body.startswith("$") or f"{_xor(body[1:]):02X}" != checksum.upper():
        raise ValueError("no sentence")
    return body[1:].split(",")


def nmea_line(body: str) -> bytes:
    """Write a sentence with its checksum."""
    return f"${body}*{_xor(body):02X}\r\n".encode("ascii")


def degrees_and_minutes(degrees: float, n_digits: int, hemispheres: str) -> str:
    """Format ddmm.mmmmm and the hemisphere, with a comma between."""
    total = round(abs(degrees) * 60.0, 5)
    return f"{int(total // 60.0):0{n_digits}d}{total % 60.0:08.5f},{hemispheres[degrees < 0.0]}"


def clock(utc_s: float) -> str:
    """Format hhmmss.sss."""
    milliseconds = round(utc_s * 1000.0) % 86_400_000
    seconds, fraction = divmod(milliseconds, 1000)
    return f"{seconds // 3600:02d}{seconds // 60 % 60:02d}{seconds % 60:02d}.{fraction:03d}"


def _xor(text: str) -> int:
    value = 0
    for character in text.encode("ascii"):
        value ^= character
    return value


def _degrees(text: str, negative: bool) -> float:
    point = text.index(".")
    degrees = int(text[: point - 2]) + float(text[point - 2 :]) / 60.0
    return -degrees if negative else degrees


def _number(text: str) -> float:
    return float(text) if text else math.nan
