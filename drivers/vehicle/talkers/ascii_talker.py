"""Share what the talkers of sentences have in common: the state of control, reading back, and paced reports."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, Final

from auv_mcm.clock import Stamp
from drivers.vehicle.ascii_fields import Table, plain_text
from drivers.vehicle.dialect import (
    Capability,
    Command,
    ContactReport,
    Granted,
    PayloadHealth,
    ReportedState,
    Steer,
    VehicleEvent,
    VehicleMessage,
    WireCommand,
    Withheld,
)

_REPORT_EVERY_S: Final = 0.2  # 250 bytes take 0.13 s at 19200 baud, and commands go between them
_HEALTH_TEXT: Final = 60  # characters


class AsciiTalker(ABC):
    """Talk to one vehicle by sentences; a subclass interprets them. `Talker[bytes]` once it has the missing methods.

    Control is reported only as it changes, and granted only when it was requested. counters: NAME.command_without_grant
    and .command_unfit (not sent).
    """

    silent_after_s: float = 5.0
    command_period_s: float = 1.0
    one_sentence: re.Pattern[bytes] = re.compile(
        rb"\$([\x20-\x23\x25-\x29\x2b-\x7e]*)\*[0-9A-F]{2}\r\n"
    )  # its group: the body
    commanding: frozenset[type] = frozenset()  # records of the table that command
    harmless: frozenset[type] = frozenset()  # records of the table that this talker sends besides

    def __init__(self, name: str, table: Table, capabilities: Capability) -> None:
        self.capabilities = capabilities
        self._name = name
        self._table = table
        self._own: Counter[str] = Counter()
        self._open = False
        self._wanted = False
        self._granted = False
        self._later: list[VehicleEvent] = []  # what was found out while nobody was listening
        self._health = PayloadHealth("starting", "")
        self._health_s = 0.0  # when it is due

    @property
    def counters(self) -> Counter[str]:
        return self._own

    def connected(self, now_s: float) -> None:
        self.disconnected()
        self._open = True
        self._greet(now_s)

    def disconnected(self) -> None:
        self._open = self._wanted = self._granted = False
        self._later.clear()
        self._forget()

    def hear(self, messages: Sequence[VehicleMessage], stamp: Stamp) -> list[VehicleEvent]:
        events, self._later = self._later, []
        for record, received, state, *_ in messages:
            if record is not None:
                # By this computer's clock, as commands are, and not by that of a unit which gives UTC.
                utc_ns = received.mono_ns + stamp.utc_ns - stamp.mono_ns
                events += self._heard(record, state, Stamp(received.mono_ns, utc_ns))
        return events

    def request(self, now_s: float) -> None:
        if self._open:
            self._wanted = True
            self._ask(now_s)

    def command(self, command: Command, now_s: float) -> None:
        if not (self._open and self._granted):
            self._own[f"{self._name}.command_without_grant"] += 1
        elif not isinstance(command, Steer) or not math.isfinite(
            command.heading_rad + command.vertical.value_m + command.speed_mps
        ):
            self._own[f"{self._name}.command_unfit"] += 1
        else:
            self._steer(command, now_s)

    def release(self, reason: str, now_s: float) -> None:
        wanted, self._wanted, self._granted = self._wanted, False, False
        self._later = [event for event in self._later if not isinstance(event, Granted | Withheld)]
        if self._open:
            self._let_go(wanted, now_s)

    def report_health(self, health: PayloadHealth, now_s: float) -> None:
        self._health, self._health_s = health, now_s

    def take_outgoing(self, now_s: float) -> list[bytes]:
        return self._outgoing(now_s) if self._open else []

    def commands_in(self, outgoing: Sequence[bytes]) -> list[WireCommand | None]:
        """Read the commands in sentences; see `ReadsBack`."""
        return [self._command_in(line) for line in outgoing]

    def _command_in(self, line: bytes) -> WireCommand | None:
        match = self.one_sentence.fullmatch(line)
        body = "" if match is None else match[1].decode("ascii")
        kind = self._table.kind_of(body.split(","))
        if kind is not None and kind.make in self.harmless:
            return None
        if kind is None or kind.make not in self.commanding:
            return WireCommand()
        try:
            return self._numbers(self._table.parse(body))
        except (ValueError, OverflowError):
            return WireCommand()

    def _grant(self, reason: str) -> list[VehicleEvent]:
        if not self._wanted or self._granted:
            return []
        self._granted = True
        return [Granted(reason)]

    def _withhold(self, reason: str) -> list[VehicleEvent]:
        """Note that control is refused or over; it has to be requested again."""
        if not self._wanted:
            return []
        self._wanted = self._granted = False
        self._stop_commanding()
        return [Withheld(reason)]

    def _health_text(self) -> str:
        return plain_text(f"{self._health.state} {self._health.text}".rstrip(), _HEALTH_TEXT)

    @abstractmethod
    def report(self, report: ContactReport, ticket: int, now_s: float) -> None: ...

    @abstractmethod
    def _greet(self, now_s: float) -> None:
        """Note that the wire has been opened."""

    @abstractmethod
    def _forget(self) -> None:
        """Note that the wire is lost, with everything that waited for it."""

    @abstractmethod
    def _heard(self, record: Any, state: ReportedState | None, received: Stamp) -> Iterable[VehicleEvent]:
        """Interpret a record of the table. state: where the vehicle is, if the record says so."""

    @abstractmethod
    def _ask(self, now_s: float) -> None:
        """Request control."""

    @abstractmethod
    def _steer(self, steer: Steer, now_s: float) -> None:
        """Send a command of finite numbers, while granted."""

    @abstractmethod
    def _numbers(self, record: Any) -> WireCommand:
        """Return the numbers of a record that commands."""

    @abstractmethod
    def _stop_commanding(self) -> None:
        """Drop the command that was not sent yet."""

    @abstractmethod
    def _let_go(self, wanted: bool, now_s: float) -> None:
        """Release control. wanted: it was requested until now."""

    @abstractmethod
    def _outgoing(self, now_s: float) -> list[bytes]: ...


class PacedReports:
    """Pace reports for a vehicle that acknowledges none, so that a slow line stays free for commands.

    What was not sent before goes first.
    """

    def __init__(self) -> None:
        self._new: dict[int, ContactReport] = {}  # by the number of the contact
        self._again: dict[int, ContactReport] = {}
        self._sent: dict[int, int] = {}  # revision sent last
        self._next_s = -math.inf

    def add(self, report: ContactReport) -> None:
        """Queue a report; it replaces one of the same contact."""
        if self._sent.get(report.number) == report.revision:
            self._again[report.number] = report
            return
        self._again.pop(report.number, None)
        self._new[report.number] = report

    def clear(self) -> None:
        """Drop all reports that wait."""
        self._new.clear()
        self._again.clear()

    def take(self, now_s: float) -> ContactReport | None:
        """Return the report that waits longest, if one is due."""
        waiting = self._new or self._again
        if not waiting or now_s < self._next_s:
            return None
        self._next_s = now_s + _REPORT_EVERY_S
        report = waiting.pop(next(iter(waiting)))
        self._sent[report.number] = report.revision
        return report
