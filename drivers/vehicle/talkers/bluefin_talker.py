"""Talk to a Bluefin's vehicle computer (Huxley) by its standard payload interface: NMEA 0183 on TCP port 29500.

The vehicle is the server. A payload requests sentences by `$BPLOG`, signals once a second that it lives by `$BPSTS`,
steers by `$BPRMB` while it may, and ends that by `$BPRCE`. The vehicle answers each sentence by `$BFACK`; until then no
other follows, and after 5 s the same one is sent again, three times in all. Times are those of the vehicle's own clock
as its last sentence had it, or this computer's until it sent one. Source: Goby3, frontseat/bluefin (LGPL).
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from typing import Any, Final

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from auv_mcm.settings.vehicle_settings import BluefinSettings
from drivers.navigation.device_date import DAY_S
from drivers.navigation.nmea0183 import sentence
from drivers.vehicle.bluefin_sentences import (
    BluefinAnswer,
    BluefinCancel,
    BluefinCommand,
    BluefinContact,
    BluefinControl,
    BluefinEnd,
    BluefinLog,
    BluefinMission,
    BluefinShutdown,
    BluefinStatus,
    BluefinSteer,
    table_of,
)
from drivers.vehicle.dialect import (
    Acknowledged,
    Capability,
    ContactReport,
    Rejected,
    ReportedState,
    Steer,
    VehicleEvent,
    Vertical,
    WireCommand,
)
from drivers.vehicle.talkers.ascii_talker import AsciiTalker
from drivers.vehicle.wire_steps import shallower, slower

RESEND_S: Final = 5.0  # s without an answer, after which a sentence is sent again
ATTEMPTS: Final = 3  # of one sentence, after which it is given up
_HEARTBEAT_S: Final = 1.0  # s between two
_STEP: Final = 0.01  # m of depth or altitude, and m/s, of the wire
_COMMAND_VALID_S: Final = 2.0  # one that could not be sent by then is old
_PENDING_FOR_S: Final = 60.0  # s that a sentence may stay pending with the vehicle before it is given up
_TIME_STEP_S: Final = (
    0.01  # between the times of two sentences, so that an answer in hundredths still identifies its sentence
)
# ACK first, for the others to be answered
_ASKED_FOR: Final = ("ACK", "NVG", "NVR", "CTL", "MIS", "MSC", "SHT", "MBS", "MBE")
_WORDS_ON_CONTROL: Final = ("ACK", "CTL", "MIS")  # which may have been lost
_INVALID, _, _DONE, _PENDING = "0123"
_RUNNING: Final = "running"


@dataclass(slots=True, eq=False)
class _Item:
    """Hold a sentence on its way: waiting, or sent and awaiting its answer.

    ticket: of a contact. expires_s: not sent after it.
    """

    key: Hashable
    record: Any
    ticket: int | None = None
    expires_s: float = math.inf
    line: bytes = b""
    n_sent: int = 0
    sent_s: float = 0.0
    pending: bool = False


class BluefinTalker(AsciiTalker):
    """Talk to a Bluefin by its standard payload interface.

    Counts also bluefin.resent, .unanswered (given up after three times), .unexpected_answer, .refused_NAME (what the
    vehicle did not take).
    """

    commanding = frozenset({BluefinSteer})
    harmless = frozenset({BluefinCancel, BluefinContact, BluefinLog, BluefinStatus})

    def __init__(self, settings: BluefinSettings) -> None:
        optional = Capability.CONTACT if settings.contact_sentence else Capability(0)
        always = Capability.NAVIGATION | Capability.STEERING | Capability.HEALTH | Capability.ACKNOWLEDGED
        super().__init__("bluefin", table_of(settings), always | optional)
        self._settings = settings
        self._waiting: dict[Hashable, _Item] = {}
        self._sent: list[_Item] = []
        self._clock: tuple[float, float] | None = None  # monotonic time, and time of day then
        self._last_time_s = -DAY_S
        self._permitted = False
        self._refuses = False  # by its last word on control, whatever its mission does
        self._commanded = False  # it took a command, or may have, since control was given back last
        self._takes_contacts: bool | None = None  # None: not known yet
        self._heard_s = 0.0
        self._placed_s = 0.0  # when it reported its position last, or was asked to

    def report(self, report: ContactReport, ticket: int, now_s: float) -> None:
        if self._takes_contacts is False:
            self._later.append(Rejected(ticket, self._no_contacts()))
        elif self._open and self._settings.contact_sentence:
            self._put(_Item(("MCM", report.number), BluefinContact(NAN, report), ticket))

    def _greet(self, now_s: float) -> None:
        self._health_s = self._heard_s = self._placed_s = now_s
        self._ask_for(*_ASKED_FOR)

    def _ask_for(self, *names: str) -> None:
        """Greet before anything else, since a vehicle that started anew sends and answers nothing."""
        first = [_Item(("LOG", name), BluefinLog(name)) for name in names]
        self._waiting = {**{item.key: item for item in first}, **self._waiting}

    def _forget(self) -> None:
        self._waiting.clear()
        self._sent.clear()
        self._permitted = self._refuses = self._commanded = False
        self._takes_contacts = None

    def _heard(self, record: Any, state: ReportedState | None, received: Stamp) -> Iterable[VehicleEvent]:
        now_s = self._heard_s = 1e-9 * received.mono_ns
        time_of_day_s = getattr(record, "time_of_day_s", NAN)
        if math.isfinite(time_of_day_s):
            self._clock = now_s, time_of_day_s
        elif self._clock is None:
            self._clock = now_s, 1e-9 * received.utc_ns % DAY_S
        if state is not None:
            self._placed_s = now_s
            yield state
        match record:
            case BluefinAnswer():
                yield from self._answered(record, now_s)
            case BluefinShutdown():
                yield from self._permit(False, "the vehicle shuts down its payloads")
            case BluefinControl(control="0"):
                self._refuses = True
                yield from self._permit(False, "the vehicle does not grant control (BFCTL 0)")
            case BluefinControl():
                self._refuses = False
                if self._settings.granted_by == "BFCTL":
                    yield from self._permit(True, "the vehicle lets the payload command (BFCTL 1)")
            case BluefinMission() if _RUNNING not in record.status.lower():
                yield from self._permit(False, f"no mission is running (BFMIS {record.status})")
            case BluefinMission() | BluefinCommand() if self._refuses:
                pass
            case BluefinMission() if self._settings.granted_by == "BFMIS":
                yield from self._permit(True, "a mission is running (BFMIS)")
            case BluefinCommand() if self._settings.granted_by == "BFMSC":
                yield from self._permit(True, f"the mission calls the payload (BFMSC {record.text})")
            case BluefinEnd() if self._settings.granted_by == "BFMSC":
                yield from self._permit(False, f"the behaviour has ended (BFMBE {record.behaviour})")

    def _permit(self, permitted: bool, reason: str) -> list[VehicleEvent]:
        self._permitted = permitted
        if permitted:
            return self._grant(reason)
        self._waiting.pop("RCE", None)  # what it does now is its own, and not to be ended
        self._sent = [item for item in self._sent if item.key != "RCE"]
        return self._withhold(reason) if self._granted else []  # what was not granted yet may still be

    def _ask(self, now_s: float) -> None:
        if self._permitted:
            self._later += self._grant("the vehicle lets the payload command")
        else:
            self._ask_for(*_WORDS_ON_CONTROL)

    def _steer(self, steer: Steer, now_s: float) -> None:
        mode = "1" if steer.vertical.reference == "altitude" else "0"
        vertical_m = shallower(steer.vertical, _STEP).value_m
        order = BluefinSteer(NAN, steer.heading_rad, vertical_m, mode, slower(steer.speed_mps, _STEP))
        self._put(_Item("RMB", order, expires_s=now_s + _COMMAND_VALID_S))

    def _numbers(self, record: BluefinSteer) -> WireCommand:
        vertical = Vertical("altitude" if record.vertical_mode == "1" else "depth", record.vertical_m)
        return WireCommand(heading_rad=record.heading_rad, vertical=vertical, speed_mps=record.speed_mps)

    def _stop_commanding(self) -> None:
        """Stop the last command, which the vehicle may still hold, unless it took control back itself."""
        self._waiting.pop("RMB", None)
        commanded = self._commanded or any(item.key == "RMB" for item in self._sent)
        self._sent = [item for item in self._sent if item.key != "RMB"]
        self._commanded = False
        if commanded and self._permitted:
            self._put(_Item("RCE", BluefinCancel(NAN)))

    def _let_go(self, wanted: bool, now_s: float) -> None:
        self._stop_commanding()

    def _put(self, item: _Item) -> None:
        """Queue a sentence, in place of one that waits under its key."""
        self._waiting[item.key] = item

    def _outgoing(self, now_s: float) -> list[bytes]:
        if now_s >= self._health_s:
            self._health_s = now_s + _HEARTBEAT_S
            self._put(
                _Item("STS", BluefinStatus(NAN, "0" if self._health.state == "failure" else "1", self._health_text()))
            )
        if now_s - self._heard_s >= self.silent_after_s:
            self._later += self._withhold(f"the vehicle is silent for {self.silent_after_s:.0f} s")
            end_of_control = self._waiting.get("RCE")
            self._forget()
            self._greet(now_s)
            if end_of_control is not None:
                self._put(end_of_control)
        elif now_s - self._placed_s >= self.silent_after_s:  # it started anew, and sends what it was asked for since
            self._placed_s = now_s
            self._ask_for(*_ASKED_FOR)
        lines = self._resend(now_s)
        while (item := self._next(now_s)) is not None:
            del self._waiting[item.key]
            lines.append(self._send(item, now_s))
        return lines

    def _next(self, now_s: float) -> _Item | None:
        """Return what may be sent now: one at a time, contacts last, but the end of control at once."""
        urgent = self._waiting.get("RCE")
        if urgent is not None and self._clock is not None:
            return urgent
        if any(not item.pending for item in self._sent):
            return None
        for key in [key for key, item in self._waiting.items() if now_s >= item.expires_s]:
            del self._waiting[key]
        ready = (i for i in self._waiting.values() if self._clock is not None or isinstance(i.record, BluefinLog))
        return min(ready, key=lambda item: item.ticket is not None, default=None)

    def _send(self, item: _Item, now_s: float) -> bytes:
        if not isinstance(item.record, BluefinLog):
            item.record = item.record._replace(time_of_day_s=self._time_of_day_s(now_s))
        item.line = sentence(self._table.body_of(item.record))
        item.n_sent, item.sent_s, item.pending = 1, now_s, False
        self._sent.append(item)
        return item.line

    def _resend(self, now_s: float) -> list[bytes]:
        lines = []
        for item in list(self._sent):
            if item.pending:
                if now_s - item.sent_s >= _PENDING_FOR_S:
                    self._sent.remove(item)
                    self._own["bluefin.unanswered"] += 1
                continue
            if now_s - item.sent_s < RESEND_S:
                continue
            again = (
                self._waiting.pop("RMB", None) if item.key == "RMB" else item
            )  # an old command is not sent again, a new one is
            if again is None or now_s >= again.expires_s or item.n_sent >= ATTEMPTS:
                self._give_up(item)
                continue
            self._own["bluefin.resent"] += 1
            n_sent = item.n_sent + 1
            if again is item:
                item.sent_s = now_s
                lines.append(item.line)
            else:
                self._commanded = True  # it may have taken the one before
                self._sent.remove(item)
                lines.append(self._send(again, now_s))
            again.n_sent = n_sent
        return lines

    def _give_up(self, item: _Item) -> None:
        if item not in self._sent:
            return
        name = self._table.body_of(item.record)[:5]
        self._own["bluefin.unanswered"] += 1
        self._later += self._withhold(
            f"the vehicle did not answer {name}, sent {item.n_sent} times; if this continues, reconnect"
        )
        self._sent = [other for other in self._sent if other is not item]
        if not isinstance(item.record, BluefinLog):
            self._ask_for(*_ASKED_FOR)
        elif item.record.name == _ASKED_FOR[0]:
            self._ask_for(_ASKED_FOR[0])
        if item.ticket is not None and self._takes_contacts is None:
            self._takes_contacts = False
            refused = [item, *(other for other in self._waiting.values() if other.ticket is not None)]
            self._waiting = {key: other for key, other in self._waiting.items() if other.ticket is None}
            self._later += [
                Rejected(other.ticket, self._no_contacts()) for other in refused if other.ticket is not None
            ]

    def _no_contacts(self) -> str:
        return (
            f"the vehicle never answered {self._settings.contact_sentence}, so contacts are not reported on this "
            "connection"
        )

    def _answered(self, answer: BluefinAnswer, now_s: float) -> Iterable[VehicleEvent]:
        item = next(
            (item for item in self._sent if _is_for(answer, self._table.body_of(item.record)[:5], item.record)), None
        )
        if item is None:
            self._own["bluefin.unexpected_answer"] += 1
            return
        if item.ticket is not None:
            self._takes_contacts = True
        if answer.status in (_PENDING, _DONE):
            self._commanded |= item.key == "RMB"
        if answer.status == _PENDING:
            if not item.pending:
                item.pending, item.sent_s = True, now_s
            return
        self._sent.remove(item)
        if answer.status == _DONE:
            if item.ticket is not None:
                yield Acknowledged(item.ticket)
            return
        name = self._table.body_of(item.record)[:5]
        self._own[f"bluefin.refused_{name}"] += 1
        reason = (
            f"the vehicle {'rejects this as invalid' if answer.status == _INVALID else 'failed to do this'}: {name} "
            f"{answer.text}"
        ).rstrip()
        if item.key == "RMB":
            yield from self._withhold(reason)
        elif item.ticket is not None and answer.status == _INVALID:
            yield Rejected(item.ticket, reason)

    def _time_of_day_s(self, now_s: float) -> float:
        """Return the time of day by the vehicle's clock, never that of the sentence before."""
        assert self._clock is not None
        heard_s, then_s = self._clock
        time_s = round((then_s + now_s - heard_s) % DAY_S, 3)
        if (self._last_time_s + _TIME_STEP_S - time_s) % DAY_S < 1.0:
            time_s = round((self._last_time_s + _TIME_STEP_S) % DAY_S, 3)
        self._last_time_s = time_s
        return time_s


def _is_for(answer: BluefinAnswer, name: str, record: Any) -> bool:
    """Return whether this sentence is answered.

    Vehicles name it with or without `BP`; what has no time is known by its name alone.
    """
    answered_name = answer.name.upper()
    if answered_name not in (name, name[2:]):
        return False
    if isinstance(record, BluefinLog) or not math.isfinite(answer.of_s):
        return True
    return abs(math.remainder(answer.of_s - record.time_of_day_s, DAY_S)) < 0.95 * _TIME_STEP_S
