"""Simulate the controller of a vehicle on a CAN bus by deploy/auv_mcm.dbc."""

from __future__ import annotations

import math
from collections import Counter
from typing import Final, Literal

import msgspec

from auv_mcm.records import NAN, NavSample
from auv_mcm.settings.vehicle_settings import CanSettings
from drivers.links.can_frame import CanFrame
from drivers.vehicle.can_messages import (
    ANSWERS,
    COMMAND_STATES,
    DEMANDS,
    FIRST_COMMAND_S,
    GRANTS,
    HEALTH_STATES,
    N_NUMBERS,
    PAYLOAD_SILENT_S,
    REASONS,
    VEHICLE_STATUS_PERIOD_S,
    GoToMessage,
    HealthText,
    PayloadStatus,
    ReportAnswer,
    ReportMessage,
    StateMessage,
    SteerMessage,
    VehicleStatus,
    encode,
    goes_on,
)
from drivers.vehicle.can_receiver import CanReceiver
from drivers.vehicle.can_translation import command_of, report_from_can, text_of
from drivers.vehicle.dialect import Command, ContactReport

_ANSWER_CRC: Final = 0xFFFF  # the low half of a report's checksum, which the answer repeats
_TURN: Final = 2.0 * math.pi

_CommandState = Literal["none", "under way", "arrived", "refused"]
_Grant = Literal["withheld", "granted"]


class _Memory(msgspec.Struct):
    """Hold the state that a controller loses with its power. request_number: None before the payload was heard."""

    receiver: CanReceiver
    grant: _Grant = "withheld"
    reason: str = "none"
    request_number: int | None = None
    granted_s: float = -math.inf
    command: Command | None = None
    command_state: _CommandState = "none"
    command_number: int = 0
    command_sequence: int | None = None
    valid_until_s: float = -math.inf
    payload_counter: int | None = None
    payload_heard_s: float = -math.inf
    counter: int = 0
    sequence: int = 0
    status_due_s: float = -math.inf
    has_news: bool = True
    health: str = HEALTH_STATES[0]
    reported: list[str] = []
    reports: list[ContactReport] = []
    known: set[tuple[int, int, int]] = set()


class FakeCan:
    """Simulate the vehicle's end, a FakeController[CanFrame], with the default addresses.

    It refuses a request once and for all: a payload that was refused, or lost control, has to request anew with a new
    number. Reported health is a state, or a state and its text. counters: those of every FakeController; nonsense:
    frames of these messages that made no sense.
    """

    def __init__(self) -> None:
        settings = CanSettings()
        self.willing = True
        self._payload_address = settings.payload_address
        self._address = settings.vehicle_address
        self._own: Counter[str] = Counter()
        self._n_nonsense_before = 0
        self._now = _Memory(self._new_receiver())

    @property
    def counters(self) -> Counter[str]:
        return self._own + Counter({"vehicle.nonsense": self._n_nonsense_before + self._n_nonsense()})

    @property
    def in_control(self) -> bool:
        return self._now.grant == "granted"

    @property
    def command(self) -> Command | None:
        return self._now.command

    def take_reports(self) -> list[ContactReport]:
        reports, self._now.reports = self._now.reports, []
        return reports

    def take_health(self) -> list[str]:
        reported, self._now.reported = self._now.reported, []
        return reported

    def power_up(self, now_s: float) -> None:
        self._n_nonsense_before += self._n_nonsense()
        self._now = _Memory(self._new_receiver())

    def revoke(self, now_s: float) -> None:
        if self.in_control:
            self._withhold("taken back")

    def connected(self, now_s: float) -> None:
        """Do nothing: a bus does not show who connects."""

    def tick(self, pose: NavSample, arrived: bool, now_s: float) -> list[CanFrame]:
        self._expire(now_s)
        if self._now.command is not None and self._now.command_state != ("arrived" if arrived else "under way"):
            self._now.command_state = "arrived" if arrived else "under way"
            self._now.has_news = True
        state = StateMessage(
            latitude_deg=pose.latitude_deg,
            heading_rad=pose.heading_rad % _TURN,
            longitude_deg=pose.longitude_deg,
            speed_mps=max(pose.speed_mps, 0.0),
            depth_m=_non_negative(pose.depth_m),
            pitch_rad=pose.pitch_rad,
            altitude_m=_non_negative(pose.altitude_m),
            roll_rad=pose.roll_rad,
        )
        self._now.sequence = (self._now.sequence + 1) % N_NUMBERS
        return self._status(now_s) + encode(state, self._address, self._now.sequence)

    def heard(self, data: CanFrame, now_s: float) -> list[CanFrame]:
        self._expire(now_s)
        received = self._now.receiver.add(data, now_s)
        if received is None:
            return []
        answers: list[CanFrame] = []
        match received.record:
            case PayloadStatus() as status:
                self._payload_status(status, now_s)
            case GoToMessage() | SteerMessage() as message:
                self._take_command(message, received.sequence, now_s)
            case ReportMessage() as message:
                self._take_report(message)
                answer = ReportAnswer(message.ticket, received.crc & _ANSWER_CRC, ANSWERS.index("taken"))
                answers = encode(answer, self._address)
            case HealthText() as message:
                self._now.reported.append(f"{self._now.health}: {text_of(message)}")
        return answers + (self._status(now_s) if self._now.has_news else [])

    def _new_receiver(self) -> CanReceiver:
        return CanReceiver("receiver", "payload", self._payload_address, Counter())

    def _n_nonsense(self) -> int:
        return sum(n for name, n in self._now.receiver.counters.items() if ".refused." in name)

    def _withhold(self, reason: str) -> None:
        self._now.grant = "withheld"
        self._now.reason = reason
        self._now.command = None
        self._now.command_state = "none"
        self._now.has_news = True

    def _expire(self, now_s: float) -> None:
        if not self.in_control:
            return
        if now_s - self._now.payload_heard_s > PAYLOAD_SILENT_S:
            self._own["vehicle.commands_expired"] += 1
            self._withhold("payload silent")
        elif now_s > (self._now.granted_s + FIRST_COMMAND_S if self._now.command is None else self._now.valid_until_s):
            self._own["vehicle.commands_expired"] += 1
            self._withhold("command not repeated in time")

    def _payload_status(self, status: PayloadStatus, now_s: float) -> None:
        counter = self._now.payload_counter
        is_release = status.demand == DEMANDS.index("release")
        is_silent = now_s - self._now.payload_heard_s > PAYLOAD_SILENT_S
        is_new = is_silent or counter is None or goes_on(status.counter, counter)
        if not is_new and not (is_release and status.request_number in (0, self._now.request_number)):
            return
        self._now.payload_counter = status.counter
        self._now.payload_heard_s = now_s
        if self._now.health != HEALTH_STATES[status.health]:
            self._now.health = HEALTH_STATES[status.health]
            self._now.reported.append(self._now.health)
        if is_release:
            if self.in_control:
                self._withhold("released by the payload")
            self._now.request_number = status.request_number
        elif status.request_number != self._now.request_number:
            is_of_before = self._now.request_number is None
            self._now.request_number = status.request_number
            self._withhold("vehicle restarted" if is_of_before else "not willing")
            if self.willing and not is_of_before:
                self._now.grant, self._now.reason = "granted", "none"
                self._now.granted_s = now_s
                self._now.command_sequence = None

    def _take_command(self, message: GoToMessage | SteerMessage, sequence: int, now_s: float) -> None:
        if not self.in_control or message.request_number != self._now.request_number:
            self._own["vehicle.commands_refused"] += 1
            return
        if self._now.command_sequence is not None and not goes_on(sequence, self._now.command_sequence):
            return
        self._now.command_sequence = sequence
        self._now.command_number = message.command_number
        try:
            command = command_of(message)
        except ValueError:
            self._own["vehicle.commands_refused"] += 1
            self._now.command_state = "refused"
            self._now.has_news = True
            return
        self._own["vehicle.commands_accepted"] += 1
        self._now.valid_until_s = now_s + message.valid_s
        if command != self._now.command:
            self._now.command = command
            self._now.command_state = "under way"
            self._now.has_news = True

    def _take_report(self, message: ReportMessage) -> None:
        key = message.session, message.number, message.revision
        if key in self._now.known:
            self._own["vehicle.reports_repeated"] += 1
            return
        self._now.known.add(key)
        self._own["vehicle.reports"] += 1
        self._now.reports.append(report_from_can(message))

    def _status(self, now_s: float) -> list[CanFrame]:
        if not self._now.has_news and now_s < self._now.status_due_s:
            return []
        self._now.has_news = False
        self._now.status_due_s = now_s + VEHICLE_STATUS_PERIOD_S
        self._now.counter = (self._now.counter + 1) % N_NUMBERS
        status = VehicleStatus(
            grant=GRANTS.index(self._now.grant),
            reason=REASONS.index(self._now.reason),
            request_number=self._now.request_number or 0,
            command_state=COMMAND_STATES.index(self._now.command_state),
            command_number=self._now.command_number,
            counter=self._now.counter,
        )
        return encode(status, self._address)


def _non_negative(value: float) -> float:
    return NAN if math.isnan(value) else max(value, 0.0)
