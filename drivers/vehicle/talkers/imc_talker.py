"""Talk to a vehicle by IMC, such as one that runs DUNE: contacts and health always, places to go to while granted.

Take-over: PlanControl START with a plan of one FollowReference manoeuvre that obeys our address; the vehicle answers
SUCCESS and, when the manoeuvre runs, FollowRefState. Both together are the grant. Places go as Reference, repeated
within the manoeuvre's time-out; a Reference with MANDONE ends the manoeuvre, and silence does so too. PlanControl STOP
is sent only while the vehicle itself says that our plan runs, since DUNE stops whatever plan there is.

A DUNE vehicle does not go back to the plan that ours took the place of. With `own_plan: false` nothing is started: a
plan that contains a FollowReference for our address invites us, and goes on when we are done.

Contacts go as Target once per revision. A vehicle that supports it is sent MineContact (1700) as well, until it answers
MineContactTaken (1701); `imc_messages` has their layouts.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from auv_mcm.settings.vehicle_settings import ImcSettings
from drivers.navigation.corrections import offset_m
from drivers.vehicle import imc_messages as imc
from drivers.vehicle.decoders.imc_decoder import ImcReceived
from drivers.vehicle.decoders.imc_followed import PLAN_ID, FollowedVehicle
from drivers.vehicle.dialect import (
    Acknowledged,
    Capability,
    Command,
    Considered,
    ContactReport,
    Doubted,
    GoTo,
    Granted,
    PayloadHealth,
    PlaceReached,
    Rejected,
    ReportedState,
    VehicleEvent,
    VehicleMessage,
    WireCommand,
    Withheld,
)
from drivers.vehicle.imc_codec import number_of
from drivers.vehicle.imc_command import command_in
from drivers.vehicle.imc_contact import imc_contact_of, target_of
from drivers.vehicle.imc_messages import (
    EntityStatus,
    ImcMessage,
    OpMode,
    PlanOp,
    PlanState,
    PlanType,
    Proximity,
    RefFlag,
    RefState,
    ZUnits,
)
from drivers.vehicle.imc_wire import ANY_ENTITY, ANYONE, packed
from drivers.vehicle.sender_clock import SenderClock

_MANEUVER_ID: Final = "follow"
_ENTITY: Final = 1  # ours that sends all this
_FOLLOW_REFERENCE: Final = number_of(imc.FollowReference)

_STATUS: Final = {
    "starting": EntityStatus.BOOT,
    "normal": EntityStatus.NORMAL,
    "fault": EntityStatus.FAULT,
    "failure": EntityStatus.FAILURE,
}
_MODES: Final[dict[int, str]] = {
    OpMode.SERVICE: "in service",
    OpMode.CALIBRATION: "calibrating",
    OpMode.ERROR: "in error",
    OpMode.EXTERNAL: "under external control",
    OpMode.BOOT: "booting",
}

_HEARTBEAT_S: Final = 1.0  # s between two, by IMC
_HEALTH_S: Final = 5.0  # s between two reports of health
_START_AGAIN_S: Final = 2.0  # s without an answer, after which a START is repeated
_MAX_STARTS: Final = 3  # of one request, after which it is given up
_SETTLE_S: Final = 2.0  # after a grant, states reported every second may still be those of before
_STOP_AGAIN_S: Final = 2.0  # s without an answer, after which a STOP is repeated
_REPORT_AGAIN_S: Final = 2.0  # s without an answer, after which a contact is reported again; doubled each time
_REPORT_SELDOM_S: Final = 30.0  # s between repetitions, maximum
_SAME_PLACE_RAD: Final = 1e-9  # 6 mm
_PASSED_M: Final = 1.0  # farther than it was already: it will not come nearer


class _Pending(NamedTuple):
    """Hold a report that waits for its answer."""

    ticket: int
    contact: imc.MineContact
    due_s: float
    wait_s: float


class ImcTalker:
    """Talk to an IMC vehicle, as `Talker[bytes]`; one packet per item that goes out, so that each fits a datagram.

    What would let us command is believed only if its packet's time is that of the vehicle's other packets and, with a
    plan of ours, after the request: a grant that was recorded earlier gives nothing.

    counters: imc.refused.stale (such packets), imc.other_messages (kinds without a use here), imc.other_source (not the
    vehicle's), imc.commands_unsaid (without a grant, or of a kind that IMC has not).
    """

    def __init__(self, settings: ImcSettings, first_request_id: int = 1) -> None:
        """first_request_id: 1 to 65535, another in every run, so that no answer of an earlier run fits."""
        self._settings = settings
        self.ends_what_is_left = True  # plans of ours from a release that was lost, or from an earlier run
        self.counters: Counter[str] = Counter()
        self._open = False
        self._vehicle = FollowedVehicle(settings.vehicle_id, settings.source_id if settings.own_plan else None)
        self._utc_ahead_s: float | None = None  # of the monotonic clock
        self._stage: Literal["idle", "requested", "granted"] = "idle"
        self._request_id = first_request_id - 1  # of the last request
        self._requested_s = -math.inf
        self._vehicles_clock = SenderClock()
        self._n_starts = 0
        self._start_due_s = 0.0
        self._succeeded = False  # the vehicle answered SUCCESS to the START
        # when the vehicle last reported that the manoeuvre runs for us; None: it does not
        self._followed_s: float | None = None
        self._granted_s = 0.0
        self._seen_plan = self._seen_maneuver = False  # since the grant
        self._stop_due_s = 0.0
        self._goal: GoTo | None = None
        self._nearest_m = math.inf  # to the goal
        self._arrived = False
        self._reference: imc.Reference | None = None  # to be sent
        self._unanswered_s: float | None = None  # when the first Reference went out that no FollowRefState followed
        self._position_deg = (NAN, NAN)
        self._health: PayloadHealth | None = None
        self._health_due_s = self._heartbeat_due_s = 0.0
        self._pending: dict[tuple[int, int, int], _Pending] = {}  # by session, number and revision
        self._outbox: list[ImcMessage] = []

    @property
    def capabilities(self) -> Capability:
        """Return what is reported and commanded with these settings."""
        basic = Capability.NAVIGATION | Capability.WAYPOINT | Capability.CONTACT | Capability.HEALTH
        answers = Capability.ACKNOWLEDGED if self._settings.acknowledges else Capability(0)
        return basic | answers | (Capability(0) if self._settings.own_plan else Capability.INVITES)

    @property
    def silent_after_s(self) -> float:
        """Return after how long without a message the vehicle counts as silent, s."""
        return 5.0

    @property
    def command_period_s(self) -> float:
        """Return how often a command is repeated, s."""
        return 0.5

    def connected(self, now_s: float) -> None:
        self.disconnected()
        self._open = True
        self._vehicle.restart()
        self._heartbeat_due_s = self._health_due_s = self._stop_due_s = now_s

    def disconnected(self) -> None:
        self._open = False
        self._idle()
        self._followed_s = None
        self._pending.clear()
        self._outbox.clear()
        self._position_deg = (NAN, NAN)

    def hear(self, messages: Sequence[VehicleMessage], stamp: Stamp) -> list[VehicleEvent]:
        now_s = 1e-9 * stamp.mono_ns
        self._utc_ahead_s = 1e-9 * (stamp.utc_ns - stamp.mono_ns)
        events: list[VehicleEvent] = []
        for record, received, state, *_ in messages:
            if record is not None:
                events += self._taken(record, state, 1e-9 * received.mono_ns)
            events += self._granted(1e-9 * received.mono_ns)
        return events + self._granted(now_s) + self._overdue(now_s)

    def request(self, now_s: float) -> None:
        if self._stage != "idle":
            return
        self._stage, self._requested_s = "requested", now_s
        self._request_id = self._request_id % 0xFFFF + 1
        self._n_starts = 0
        self._vehicle.is_left = False
        self._start_due_s = now_s if self._settings.own_plan else math.inf
        self._succeeded = not self._settings.own_plan
        if self._settings.own_plan:
            self._followed_s = None

    def command(self, command: Command, now_s: float) -> None:
        if self._stage != "granted" or not isinstance(command, GoTo):
            self.counters["imc.commands_unsaid"] += 1
            return
        if self._goal is None or command[:2] != self._goal[:2]:
            self._arrived = False
            self._nearest_m = math.inf
        self._goal = command
        self._reference = imc.Reference(
            flags=RefFlag.LOCATION | RefFlag.SPEED | RefFlag.Z,
            speed=imc.DesiredSpeed(command.speed_mps),
            z=imc.DesiredZ(
                command.vertical.value_m, ZUnits.DEPTH if command.vertical.reference == "depth" else ZUnits.ALTITUDE
            ),
            lat=math.radians(command.latitude_deg),
            lon=math.radians(command.longitude_deg),
        )

    def report(self, report: ContactReport, ticket: int, now_s: float) -> None:
        self._outbox.append(target_of(report))
        if not self._settings.acknowledges:
            return
        contact = imc_contact_of(report)
        self._pending = {key: waiting for key, waiting in self._pending.items() if key[1] != contact.number}
        self._pending[contact.session, contact.number, contact.revision] = _Pending(
            ticket, contact, now_s, _REPORT_AGAIN_S
        )

    def report_health(self, health: PayloadHealth, now_s: float) -> None:
        self._health, self._health_due_s = health, now_s

    def release(self, reason: str, now_s: float) -> None:
        if self._stage == "granted":
            self._followed_s, self._vehicle.is_left = None, True
            self._outbox.append(imc.Reference(RefFlag.MANDONE))
            self._stop_due_s = now_s + _STOP_AGAIN_S  # unless MANDONE is lost, there will be nothing to stop
        elif self._stage == "requested" and self._settings.own_plan and self._succeeded:
            self._stop(reason, now_s)
        self._idle()

    def take_outgoing(self, now_s: float) -> list[bytes]:
        if not self._open:
            return []
        messages, self._outbox = self._outbox, []
        if now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = max(self._heartbeat_due_s + _HEARTBEAT_S, now_s)  # in rhythm
            messages.insert(0, imc.Heartbeat())
        if self._start_is_due(now_s):
            self._n_starts += 1
            self._start_due_s = now_s + _START_AGAIN_S
            messages.append(self._start())
        if self._reference is not None:
            messages.append(self._reference)
            self._reference = None
            self._unanswered_s = now_s if self._unanswered_s is None else self._unanswered_s
        messages += self._due_reports(now_s)
        if self._health is not None and now_s >= self._health_due_s:
            self._health_due_s = max(self._health_due_s + _HEALTH_S, now_s)
            messages.append(imc.EntityState(_STATUS[self._health.state], 0, self._health.text))
        to = ANYONE if self._vehicle.number is None else self._vehicle.number
        time_s = 0.0 if self._utc_ahead_s is None else now_s + self._utc_ahead_s
        return [packed(message, self._settings.source_id, entity=_ENTITY, to=to, time_s=time_s) for message in messages]

    def commands_in(self, outgoing: Sequence[bytes]) -> list[WireCommand | None]:
        """Read the commands in packets; see `ReadsBack`."""
        return [command_in(packet, self._settings.control_timeout_s) for packet in outgoing]

    def _start_is_due(self, now_s: float) -> bool:
        wanted = self._stage == "requested" and self._vehicle.may_be_asked(now_s)
        return wanted and self._n_starts < _MAX_STARTS and now_s >= self._start_due_s

    def _start(self) -> imc.PlanControl:
        follow = imc.FollowReference(self._settings.source_id, ANY_ENTITY, self._settings.control_timeout_s)
        plan = imc.PlanSpecification(
            PLAN_ID,
            description="places for a second view",
            start_man_id=_MANEUVER_ID,
            maneuvers=(imc.PlanManeuver(_MANEUVER_ID, follow),),
        )
        return imc.PlanControl(PlanType.REQUEST, PlanOp.START, self._request_id, PLAN_ID, arg=plan)

    def _stop(self, reason: str, now_s: float) -> None:
        self._stop_due_s, self._vehicle.is_left = now_s + _STOP_AGAIN_S, True
        self._request_id = self._request_id % 0xFFFF + 1
        self._outbox.append(imc.PlanControl(PlanType.REQUEST, PlanOp.STOP, self._request_id, PLAN_ID, info=reason))

    def _due_reports(self, now_s: float) -> list[ImcMessage]:
        due: list[ImcMessage] = []
        for key, (ticket, contact, due_s, wait_s) in self._pending.items():
            if now_s >= due_s:
                due.append(contact)
                self._pending[key] = _Pending(ticket, contact, now_s + wait_s, min(2.0 * wait_s, _REPORT_SELDOM_S))
        return due

    def _idle(self) -> None:
        self._stage = "idle"
        self._goal = self._reference = self._unanswered_s = None
        self._arrived = False

    def _withheld(self, reason: str) -> list[VehicleEvent]:
        if self._stage == "idle":
            return []
        self._idle()
        return [Withheld(reason)]

    def _taken(self, received: ImcReceived, state: ReportedState | None, now_s: float) -> list[VehicleEvent]:
        message = received.message
        doubts = self._choose(received, now_s)
        if isinstance(message, imc.Abort):
            self._idle()
            return [Withheld(f"Abort from 0x{received.source:04X}")]  # whoever sends it, and whether or not we command
        if received.source != self._vehicle.number:
            self.counters["imc.other_source"] += 1
            return doubts
        return doubts + self._believed(received, state, now_s)

    def _choose(self, received: ImcReceived, now_s: float) -> list[VehicleEvent]:
        """Choose the vehicle to follow. Another one begins with nothing said, and a clock of its own."""
        before, doubted = self._vehicle.number, self._vehicle.doubt
        self._vehicle.hear(received.source, received.message, now_s, received.destination)
        if before not in (None, self._vehicle.number):
            is_open, self._vehicles_clock = self._open, SenderClock()
            self.disconnected()
            self._open = is_open
        return [Doubted(self._vehicle.doubt)] if self._vehicle.doubt and not doubted else []

    def _believed(self, received: ImcReceived, state: ReportedState | None, now_s: float) -> list[VehicleEvent]:
        """Take a message of the vehicle, unless it would give control and may be an old one."""
        if self._gives_leave(message := received.message):
            if doubt := self._doubt(received.time_s, now_s):
                self.counters["imc.refused.stale"] += 1
                return [Doubted(doubt)]
        else:
            is_recent = self._vehicles_clock.hear(received.time_s, now_s)
            self._vehicle.hear_plan(message, now_s, is_recent=is_recent)
        return self._heard(message, state, now_s, for_us=received.destination in (self._settings.source_id, ANYONE))

    def _gives_leave(self, message: ImcMessage) -> bool:
        """Return whether this message would let us command, or go on. What ends control is believed from anyone."""
        match message:
            case imc.FollowRefState():
                return message.control_src == self._settings.source_id and message.state != RefState.TIMEOUT
            case imc.PlanControl():
                return message.type in (PlanType.SUCCESS, PlanType.IN_PROGRESS)
        return False

    def _doubt(self, time_s: float, now_s: float) -> str:
        """Return why a packet that would let us command is rejected, "" if it is accepted."""
        if not self._vehicles_clock.hear(time_s, now_s):
            why = "is not that of the vehicle's other messages"
        elif (
            self._stage == "requested"
            and self._settings.own_plan
            and not self._vehicles_clock.is_after(time_s, self._requested_s)
        ):
            why = "is before that of the request"
        else:
            return ""
        return (
            f"it would grant control, but its time ({time_s:.1f} s since 1970) {why}. Check that the vehicle's clock "
            "is set and runs, and that nobody sends recorded messages."
        )

    def _heard(
        self, message: ImcMessage, state: ReportedState | None, now_s: float, *, for_us: bool
    ) -> list[VehicleEvent]:
        match message:
            case imc.EstimatedState():
                assert state is not None  # the decoder makes one of each
                self._position_deg = state.latitude_deg, state.longitude_deg
                return [state]
            case imc.FollowRefState():
                return self._followed(message, now_s)
            case imc.PlanControl() if for_us:
                return self._answered(message)
            case imc.PlanControlState():
                return self._heard_plan(message, now_s)
            case imc.VehicleState():
                return self._heard_mode(message, now_s)
            case imc.MineContactTaken() if for_us:
                return self._report_answered(message)
            case imc.Heartbeat() | imc.Announce():
                return []
            case _:
                self.counters["imc.other_messages"] += 1
                return []

    def _answered(self, message: imc.PlanControl) -> list[VehicleEvent]:
        mine = (
            message.op == PlanOp.START and message.request_id == self._request_id and message.plan_id in ("", PLAN_ID)
        )
        if self._stage == "idle" or not self._settings.own_plan or not mine:
            return []
        if message.type == PlanType.FAILURE:
            return self._withheld(f"plan refused: {message.info or 'no reason given'}")
        if self._stage == "granted":
            return []
        if message.type == PlanType.IN_PROGRESS:
            self._start_due_s = math.inf  # a plan may calibrate first
            return [Considered()]
        if message.type == PlanType.SUCCESS:
            self._succeeded = True
        return []

    def _followed(self, message: imc.FollowRefState, now_s: float) -> list[VehicleEvent]:
        ours = message.control_src == self._settings.source_id
        if not ours or message.state == RefState.TIMEOUT:
            self._followed_s = None
            reason = (
                "the vehicle received no reference in time"
                if ours
                else f"the vehicle follows 0x{message.control_src:04X}"
            )
            return self._withheld(reason) if self._stage == "granted" else []
        self._followed_s = now_s
        if self._stage != "granted":
            return []
        self._unanswered_s = None
        return self._arrival(message)

    def _granted(self, now_s: float) -> list[VehicleEvent]:
        if self._stage != "requested" or not self._succeeded or self._followed_s is None or self._vehicle.doubt:
            return []
        self._stage = "granted"
        self._granted_s = now_s
        self._seen_plan = self._seen_maneuver = False
        return [Granted("FollowReference runs for us")]

    def _arrival(self, message: imc.FollowRefState) -> list[VehicleEvent]:
        """Report arrival. DUNE calls a place near within its own tolerance, 15 m by default, before it is reached."""
        goal, reference = self._goal, message.reference
        if (
            goal is None
            or reference is None
            or self._arrived
            or not reference.flags & RefFlag.LOCATION
            or not message.proximity & Proximity.XY_NEAR
        ):
            return []
        offsets_rad = (
            reference.lat - math.radians(goal.latitude_deg),
            reference.lon - math.radians(goal.longitude_deg),
        )
        if not all(abs(offset) < _SAME_PLACE_RAD for offset in offsets_rad):
            return []  # of the place before
        distance_m = math.hypot(*offset_m(self._position_deg, goal[:2]))
        self._nearest_m = min(self._nearest_m, distance_m)
        if message.state == RefState.GOTO and goal.radius_m < distance_m < self._nearest_m + _PASSED_M:
            return []
        self._arrived = True
        return [PlaceReached()]

    def _heard_plan(self, message: imc.PlanControlState, now_s: float) -> list[VehicleEvent]:
        running = message.state in (PlanState.INITIALIZING, PlanState.EXECUTING)
        ours = running and (message.plan_id == PLAN_ID or not self._settings.own_plan)
        unwanted = self._open and self._stage == "idle" and self._settings.own_plan and self.ends_what_is_left
        if ours and unwanted and now_s >= self._stop_due_s:
            self._stop("the payload does not request control", now_s)
        if ours:
            self._seen_plan = True
            return []
        return self._contradicted(
            f"plan {message.plan_id} runs" if running else "the plan has ended", self._seen_plan, now_s
        )

    def _heard_mode(self, message: imc.VehicleState, now_s: float) -> list[VehicleEvent]:
        mode = message.op_mode
        if mode in (OpMode.ERROR, OpMode.EXTERNAL, OpMode.BOOT):
            return self._withheld(f"the vehicle is {_MODES[mode]}{message.last_error and f': {message.last_error}'}")
        if mode == OpMode.MANEUVER and message.maneuver_type == _FOLLOW_REFERENCE:
            self._seen_maneuver = True
            return []
        activity = _MODES.get(mode, f"in manoeuvre {message.maneuver_type}")
        return self._contradicted(f"the vehicle is {activity}", self._seen_maneuver, now_s)

    def _contradicted(self, reason: str, seen_otherwise: bool, now_s: float) -> list[VehicleEvent]:
        """Take a report that contradicts our manoeuvre, perhaps from before it.

        seen_otherwise: our manoeuvre was reported since the grant.
        """
        if self._followed_s is not None and now_s - self._followed_s >= _SETTLE_S:
            self._followed_s = None
        old_news = not seen_otherwise and now_s - self._granted_s < _SETTLE_S
        return [] if self._stage != "granted" or old_news else self._withheld(reason)

    def _report_answered(self, message: imc.MineContactTaken) -> list[VehicleEvent]:
        pending = self._pending.pop((message.session, message.number, message.revision), None)
        if pending is None:
            return []
        return [Acknowledged(pending.ticket) if message.taken else Rejected(pending.ticket, message.reason)]

    def _overdue(self, now_s: float) -> list[VehicleEvent]:
        if self._stage == "requested" and (why_not := self._vehicle.why_not(self._start_due_s, now_s)):
            return self._withheld(why_not)
        if self._unanswered_s is not None and now_s - self._unanswered_s > self._settings.control_timeout_s:
            return self._withheld("the vehicle does not answer our references")
        return []
