"""Talk to a vehicle's controller on a CAN bus, with the messages of `can_messages`."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Final

import msgspec

from auv_mcm.clock import Stamp
from auv_mcm.settings.vehicle_settings import CanSettings
from drivers.links.can_frame import CanFrame
from drivers.vehicle.can_messages import (
    ANSWERS,
    AUTHORITY_STATES,
    BY_RECORD,
    COMMAND_PERIOD_S,
    COMMAND_STATES,
    COMMAND_VALID_S,
    DEMANDS,
    GRANTS,
    HEALTH_STATES,
    N_NUMBERS,
    REASONS,
    REFERENCES,
    STATUS_PERIOD_S,
    VEHICLE_SILENT_S,
    GoToMessage,
    HealthText,
    PayloadStatus,
    ReportAnswer,
    ReportMessage,
    SteerMessage,
    VehicleStatus,
    encode,
    goes_on,
    number_and_address,
)
from drivers.vehicle.can_receiver import CanReceiver
from drivers.vehicle.can_translation import command_message, report_message, text_message
from drivers.vehicle.dialect import (
    Acknowledged,
    Capability,
    Command,
    Considered,
    ContactReport,
    Granted,
    PayloadHealth,
    PlaceReached,
    Rejected,
    VehicleEvent,
    VehicleMessage,
    Vertical,
    WireCommand,
    Withheld,
)

_NAME: Final = "vehicle_can"
_SILENT_S: Final = 2.0  # s without a message, after which the vehicle counts as silent
_N_RELEASES: Final = 3  # a release is sent so often, so that two lost frames do not matter
_TEXT_PERIOD_S: Final = 10.0  # s between two texts of health
_REPEATS_S: Final = (1.0, 2.0, 4.0, 8.0)  # after the first time a report was sent, the second, ...
_BETWEEN_REPORTS_S: Final = 0.05  # 13 % of a bus of 250 kbit/s, however many wait
_CRC_PART: Final = 0xFFFF  # the low half of the checksum, by which an answer names the report
_S_PER_NS: Final = 1e-9  # seconds per nanosecond
_HARMLESS: Final = frozenset(BY_RECORD[kind].number for kind in (PayloadStatus, ReportMessage, HealthText))


class _Report(msgspec.Struct):
    """Hold a report that is not answered yet.

    contact: its number. frames: without their sequence number. n_sent: how often; due_s: when it goes out again.
    """

    contact: int
    message_crc: int
    frames: list[CanFrame]
    n_sent: int
    due_s: float


class _Link(msgspec.Struct):
    """Hold the state of one connection, and what is to be sent on it.

    n_at_once: so many statuses go out next, whenever the next is due. waiting: events for the next call of `hear`.
    """

    wants: bool = False
    is_granted: bool = False
    was_revoked: bool = False
    command: Command | None = None
    command_frames: list[CanFrame] = []
    has_arrived: bool = False
    n_at_once: int = _N_RELEASES
    status_due_s: float = -math.inf
    text_due_s: float = -math.inf
    report_due_s: float = -math.inf
    reports: dict[int, _Report] = {}
    waiting: list[VehicleEvent] = []
    vehicle_number: int = 0
    vehicle_counter: int = 0
    status_heard_s: float = -math.inf


class CanTalker:
    """Talk to a controller on a CAN bus, as `Talker[CanFrame]`.

    A grant counts only while the vehicle's status comes, with a counter that goes on, and names the request that is
    made. A command that the vehicle refuses is taken for the end of the grant.

    counters: vehicle_can.refused.stale (a status that is not newer than the last), .commands, .commands_without_grant
    and .commands_unsayable (dropped), .reports, .reports_repeated, .reports_unsayable, .answers_unknown (to no report
    that waits).
    """

    capabilities: Final = (
        Capability.NAVIGATION
        | Capability.WAYPOINT
        | Capability.STEERING
        | Capability.CONTACT
        | Capability.ACKNOWLEDGED
        | Capability.HEALTH
    )
    silent_after_s: Final = _SILENT_S
    command_period_s: Final = COMMAND_PERIOD_S

    def __init__(self, settings: CanSettings) -> None:
        self._address = settings.payload_address
        self._own: Counter[str] = Counter()
        self._health = PayloadHealth("starting", "")
        self._request_number = 0
        self._counter = 0
        self._report_sequence = 0
        self._command_sequence = 0
        self._command_number = 0
        self._link = _Link()
        self._is_connected = False

    @property
    def counters(self) -> Counter[str]:
        return self._own

    def connected(self, now_s: float) -> None:
        self._link = _Link()
        self._is_connected = True

    def disconnected(self) -> None:
        self._link = _Link()
        self._is_connected = False

    def hear(self, messages: Sequence[VehicleMessage], stamp: Stamp) -> list[VehicleEvent]:
        now_s = stamp.mono_ns * _S_PER_NS
        self._notice_silence(now_s)
        events, self._link.waiting = self._link.waiting, []
        for record, _, state, *_ in messages:
            if isinstance(record, VehicleStatus):
                events += self._status(record, now_s)
            elif isinstance(record, ReportAnswer):
                events += self._answer(record)
            elif state is not None:
                events.append(state)
        return events

    def request(self, now_s: float) -> None:
        link = self._link
        if link.wants:
            return
        taken = 0, self._request_number, link.vehicle_number
        while self._request_number in taken:
            self._request_number = (self._request_number + 1) % N_NUMBERS
        link.wants = True
        link.was_revoked = False
        link.n_at_once = max(link.n_at_once, 1)

    def command(self, command: Command, now_s: float) -> None:
        if not self._link.is_granted:
            self._own[f"{_NAME}.commands_without_grant"] += 1
            return
        if command != self._link.command:
            self._command_number = (self._command_number + 1) % N_NUMBERS
            self._link.command = command
            self._link.has_arrived = False
        self._command_sequence = (self._command_sequence + 1) % N_NUMBERS
        try:
            message = command_message(command, COMMAND_VALID_S, self._command_number, self._request_number)
            self._link.command_frames = encode(message, self._address, self._command_sequence)
        except ValueError:
            self._link.command_frames = []
            self._own[f"{_NAME}.commands_unsayable"] += 1

    def report(self, report: ContactReport, ticket: int, now_s: float) -> None:
        superseded = [other for other, waiting in self._link.reports.items() if waiting.contact == report.number]
        for other in superseded:
            del self._link.reports[other]
        try:
            frames = encode(report_message(report, ticket), self._address)
        except ValueError as error:
            self._own[f"{_NAME}.reports_unsayable"] += 1
            self._link.reports.pop(ticket, None)
            self._link.waiting.append(Rejected(ticket, f"cannot be encoded on a CAN bus: {error}"))
            return
        crc = int.from_bytes(frames[-1].data[-4:], "little") & _CRC_PART
        self._link.reports[ticket] = _Report(report.number, crc, frames, 0, now_s)

    def report_health(self, health: PayloadHealth, now_s: float) -> None:
        if health.state != self._health.state:
            self._link.n_at_once = max(self._link.n_at_once, 1)
        if health.text != self._health.text:
            self._link.text_due_s = -math.inf
        self._health = health

    def release(self, reason: str, now_s: float) -> None:
        self._drop_control()
        self._link.wants = False
        self._link.n_at_once = _N_RELEASES

    def take_outgoing(self, now_s: float) -> list[CanFrame]:
        if not self._is_connected:
            return []
        self._notice_silence(now_s)
        frames = self._status_frames(now_s)
        if self._link.command_frames:  # there are none without a grant
            frames += self._link.command_frames
            self._own[f"{_NAME}.commands"] += 1
        self._link.command_frames = []
        frames += self._report_frames(now_s)
        if now_s >= self._link.text_due_s:
            self._link.text_due_s = now_s + _TEXT_PERIOD_S
            frames += encode(text_message(self._health.text), self._address, self._next_report_sequence())
        return frames

    def commands_in(self, outgoing: Sequence[CanFrame]) -> list[WireCommand | None]:
        """Read the commands in frames; see `ReadsBack`."""
        receiver = CanReceiver(_NAME, "payload", self._address, Counter())
        commands: list[WireCommand | None] = [None] * len(outgoing)
        begun: list[int] = []  # frames of a command whose last one has not come
        for index, frame in enumerate(outgoing):
            number, _ = number_and_address(frame.can_id) or (None, None)
            if number in _HARMLESS:
                continue
            commands[index] = WireCommand()
            begun.append(index)
            received = receiver.add(frame, 0.0)
            if received is not None and isinstance(received.record, GoToMessage | SteerMessage):
                for part in begun:
                    commands[part] = _numbers(received.record)
                begun.clear()
        return commands

    def _drop_control(self) -> None:
        link = self._link
        link.is_granted = link.has_arrived = False
        link.command = None
        link.command_frames = []

    def _withhold(self, reason: str) -> Withheld:
        self._link.was_revoked = self._link.is_granted
        self._drop_control()
        self._link.wants = False
        self._link.n_at_once = _N_RELEASES
        return Withheld(reason)

    def _notice_silence(self, now_s: float) -> None:
        if self._link.is_granted and now_s - self._link.status_heard_s > VEHICLE_SILENT_S:
            self._link.waiting.append(self._withhold(f"no status of the vehicle for {VEHICLE_SILENT_S:g} s"))

    def _status(self, status: VehicleStatus, now_s: float) -> list[VehicleEvent]:
        is_silent = not 0.0 <= now_s - self._link.status_heard_s <= VEHICLE_SILENT_S
        if not is_silent and not goes_on(status.counter, self._link.vehicle_counter):
            self._own[f"{_NAME}.refused.stale"] += 1
            return []
        self._link.status_heard_s = now_s
        self._link.vehicle_counter = status.counter
        self._link.vehicle_number = status.request_number
        if not self._link.wants:
            return []
        is_ours = status.request_number == self._request_number
        grant = GRANTS[status.grant]
        if self._link.is_granted:
            if not is_ours or grant != "granted":
                return [self._withhold(_reason(status.reason))]
            return self._command_state(status)
        if is_ours and grant == "granted":
            self._link.is_granted = True
            self._link.n_at_once = max(self._link.n_at_once, 1)
            return [Granted(f"request {self._request_number}")]
        if not is_ours:
            return []
        return [self._withhold(_reason(status.reason)) if grant == "withheld" else Considered()]

    def _command_state(self, status: VehicleStatus) -> list[VehicleEvent]:
        if self._link.command is None or status.command_number != self._command_number:
            return []
        state = COMMAND_STATES[status.command_state]
        if state == "refused":
            return [self._withhold("command refused")]
        if state == "arrived" and not self._link.has_arrived:
            self._link.has_arrived = True
            return [PlaceReached()]
        return []

    def _answer(self, answer: ReportAnswer) -> list[VehicleEvent]:
        report = self._link.reports.get(answer.ticket)
        if report is None or report.message_crc != answer.report_crc:
            self._own[f"{_NAME}.answers_unknown"] += 1
            return []
        del self._link.reports[answer.ticket]
        if answer.answer == ANSWERS.index("taken"):
            return [Acknowledged(answer.ticket)]
        known = answer.answer < len(ANSWERS)
        return [Rejected(answer.ticket, ANSWERS[answer.answer] if known else f"answer {answer.answer}")]

    def _status_frames(self, now_s: float) -> list[CanFrame]:
        link = self._link
        if not link.n_at_once and now_s < link.status_due_s:
            return []
        n_statuses, link.n_at_once = max(link.n_at_once, 1), 0
        link.status_due_s = now_s + STATUS_PERIOD_S
        frames = []
        for _ in range(n_statuses):
            self._counter = (self._counter + 1) % N_NUMBERS
            status = PayloadStatus(
                health=HEALTH_STATES.index(self._health.state),
                authority=AUTHORITY_STATES.index(self._authority),
                demand=DEMANDS.index("request" if link.wants else "release"),
                request_number=self._request_number,
                counter=self._counter,
            )
            frames += encode(status, self._address)
        return frames

    @property
    def _authority(self) -> str:
        if self._link.wants:
            return "granted" if self._link.is_granted else "requested"
        return "revoked" if self._link.was_revoked else "listening"

    def _report_frames(self, now_s: float) -> list[CanFrame]:
        """Return at most one report: new ones first, then those with the fewest repetitions."""
        due = [report for report in self._link.reports.values() if now_s >= report.due_s]
        if not due or now_s < self._link.report_due_s:
            return []
        report = min(due, key=lambda report: report.n_sent)
        self._own[f"{_NAME}.reports_repeated" if report.n_sent else f"{_NAME}.reports"] += 1
        report.due_s = now_s + _REPEATS_S[min(report.n_sent, len(_REPEATS_S) - 1)]
        report.n_sent += 1
        self._link.report_due_s = now_s + _BETWEEN_REPORTS_S
        sequence = self._next_report_sequence()
        return [frame._replace(data=bytes((frame.data[0], sequence)) + frame.data[2:]) for frame in report.frames]

    def _next_report_sequence(self) -> int:
        self._report_sequence = (self._report_sequence + 1) % N_NUMBERS
        return self._report_sequence


def _reason(code: int) -> str:
    return REASONS[code] if code < len(REASONS) else f"reason {code}"


def _numbers(message: GoToMessage | SteerMessage) -> WireCommand:
    vertical = Vertical(REFERENCES[message.vertical_reference], message.vertical_m)
    numbers = WireCommand(vertical=vertical, speed_mps=message.speed_mps, holds_s=message.valid_s)
    if isinstance(message, SteerMessage):
        return numbers._replace(heading_rad=message.heading_rad % math.tau)
    return numbers._replace(place_deg=(message.latitude_deg, message.longitude_deg), radius_m=message.radius_m)
