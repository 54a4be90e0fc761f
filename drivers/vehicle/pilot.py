"""Communicate with a vehicle: contacts and health always, commands only while the vehicle grants control.

No ports and no clocks: what is heard is handed in, what is to be sent is fetched. The guard stands last: it judges the
bytes that a talker made of a command, by the numbers in them, and what it refuses is not sent. Control is wanted only
while there is a plan ahead that may be flown, and goes back as soon as that ends, for whatever reason. Where the
payload died or the wire broke, the vehicle takes control back by itself once commands stay away; that is why every
dialect repeats them.
"""

from __future__ import annotations

import logging
import math
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final, Generic, TypeVar

from auv_mcm.clock import Stamp
from auv_mcm.records import Contact, Notice, Waypoint
from auv_mcm.settings.vehicle_settings import VehicleConfig
from auv_mcm.source import AnnouncedContact
from drivers.plugin_records import clean_counters
from drivers.vehicle.authority import DECIDE_WITHIN_S, Action, Ask, Authority, AuthorityState, GiveBack
from drivers.vehicle.dialect import (
    Acknowledged,
    Capability,
    Command,
    Considered,
    Doubted,
    GoTo,
    Granted,
    PayloadHealth,
    PlaceReached,
    ReadsBack,
    Rejected,
    ReportedState,
    Steer,
    Talker,
    VehicleMessage,
    Vertical,
    WireCommand,
    Withheld,
    numbers_of,
)
from drivers.vehicle.guard import Guard, Refusal
from drivers.vehicle.guidance import LineOfSight, WaypointTrack
from drivers.vehicle.report_queue import ReportQueue
from drivers.vehicle.runs import FlownPlan, with_points_on_legs
from drivers.vehicle.sea_floor import FloorBelow
from drivers.vehicle.whereabouts import Whereabouts

log = logging.getLogger(__name__)

W = TypeVar("W")

_MAX_NOTICES: Final = 256  # that wait to be taken; bounds memory
_ARRIVED_WITHIN_RADII: Final = 5.0  # of arrival, from the goal, for a vehicle's own report of arrival to count
# s: not sooner with another heading, so that a slow wire is not asked for more than it carries
_STEER_AGAIN_S: Final = 0.2
_STEER_STEP_RAD: Final = math.radians(1.0)  # a heading that differs less waits for the next repetition
_NOT_GRANTED: Final = Refusal("not_granted", "a command was to be sent without a grant")
# refusals after which a vehicle that is commanded depths is led up: it would hold the last one until it times out
_LEADING_UP: Final = frozenset(
    {"altitude_unknown", "depth_unknown", "floor_unknown", "too_low", "too_deep", "commands_too_low"}
    | {"commands_too_deep"}
)
_MAX_UNANSWERED: Final = 6  # requests in a row, about a minute, after which a person is asked; chosen


class Pilot(Generic[W]):
    """Pilot one vehicle. W: bytes, or CanFrame on a bus.

    session: of the run that numbers its contacts. turn_radius_m: of vehicles that are steered by heading, through the
    water. baud: of a serial line, 0 for another.

    counters: those of the talker; vehicle.refused.REASON (what was not to be sent, once per plan and reason),
    vehicle.requested, .granted, .withheld, .returned, .commands, .led_up (a safe depth before control goes back),
    .plans, .plans_flown, .doubted, and those of `FloorBelow` and `ReportQueue`.

    Raises UsageError for a fence that encloses no area.
    """

    def __init__(
        self, talker: Talker[W], config: VehicleConfig, *, session: int, turn_radius_m: float = 10.0, baud: int = 0
    ) -> None:
        self._talker = talker
        self._config = config
        self._turn_radius_m = turn_radius_m
        self._may_steer = Capability.WAYPOINT not in talker.capabilities
        self._may_command = config.command and bool(talker.capabilities & (Capability.WAYPOINT | Capability.STEERING))
        self._authority = Authority(
            silent_after_s=talker.silent_after_s, ask_again_s=config.ask_again_s, max_control_s=config.max_control_s
        )
        self._guard = Guard(config)
        self._floor = FloorBelow(speed_mps=config.speed_mps, valid_s=config.state_valid_s)
        self._read_back = talker.commands_in if isinstance(talker, ReadsBack) else None
        self._holds_s = config.command_valid_s  # for which the vehicle may obey the last command
        self._last_words: list[W] = []  # to be sent before control goes back
        acknowledges = Capability.ACKNOWLEDGED in talker.capabilities
        self._report_queue = ReportQueue(
            session=session, min_p_mine=config.report_min_p_mine, acknowledges=acknowledges, baud=baud
        )
        self._line_of_sight = LineOfSight(turn_radius_m=turn_radius_m, speed_mps=config.speed_mps)
        self._whereabouts = Whereabouts(config.state_valid_s)
        self._plan: FlownPlan | None = None
        self._released = False
        self._joined = False  # under way on the plan
        self._command: Command | None = None  # given last, while it holds
        self._commanded_s = -math.inf
        self._asked_s = -math.inf  # when what is to be sent was fetched last
        self._health: PayloadHealth | None = None
        self._refusal: Refusal | None = None  # the last, for people
        self._counted: set[str] = set()  # reasons of refusals of this plan
        self._wire_open = False
        self._announced_state: AuthorityState = "down"
        self._rejected: set[int] = set()  # contacts
        self._notices: deque[Notice] = deque(maxlen=_MAX_NOTICES)
        self._own: Counter[str] = Counter()

    @property
    def authority(self) -> AuthorityState:
        return self._authority.state

    @property
    def counters(self) -> Counter[str]:
        return self._own + self._floor.counters + self._report_queue.counters + clean_counters(self._talker.counters)

    def health(self) -> str:
        """Return one line for people and for the health line."""
        leg, n_legs = (self._plan.leg, self._plan.waypoints[-1].leg) if self._plan else (0, 0)
        refused = f"{self._refusal.code} ({self._refusal.text})" if self._refusal else "nothing"
        reports = f"reports_waiting={self._report_queue.n_pending} refused={refused}"
        return f"vehicle={self.authority} ({self._authority.reason}) leg={leg}/{n_legs} {reports}"

    def take_notices(self) -> list[Notice]:
        """Return the notices since the last call."""
        notices = list(self._notices)
        self._notices.clear()
        return notices

    def connected(self, now_s: float) -> None:
        """Note that the wire is open, perhaps again."""
        self._do(self._authority.connected(now_s), now_s)
        self._report_queue.link_lost()
        self._wire_open = True
        self._talker.connected(now_s)
        if self._health is not None:
            self._talker.report_health(self._health, now_s)
        self._notice_authority()

    def disconnected(self, now_s: float) -> None:
        """Note that the wire is lost."""
        self._do(self._authority.disconnected(now_s), now_s)
        self._report_queue.link_lost()
        self._wire_open = False
        self._talker.disconnected()
        self._notice_authority()

    def hear(self, messages: Sequence[VehicleMessage], stamp: Stamp) -> None:
        """Take the messages in a chunk of bytes, or in a frame, if any. stamp: when it was read."""
        now_s = stamp.mono_ns * 1e-9
        events = self._talker.hear(messages, stamp)
        if any(message.of_vehicle for message in messages):
            self._authority.heard(now_s)
        for event in events:
            match event:
                case ReportedState():
                    self._whereabouts.hear(event, now_s)
                    in_control = self._authority.state == "granted"
                    self._floor.hear(event.depth_m, event.altitude_m, now_s, is_commanded=in_control)
                case Granted():
                    self._authority.granted(event.reason, now_s)
                case Withheld():
                    self._authority.withheld(event.reason, now_s)
                case Considered():
                    self._authority.considered()
                case PlaceReached():
                    self._arrived()
                case Acknowledged():
                    self._report_queue.acknowledge(event.ticket)
                case Rejected():
                    self._report_rejected(event)
                case Doubted(reason):
                    self._doubted(reason)
            self._notice_authority()

    def take_outgoing(self, now_s: float) -> list[W]:
        """Return what is to be sent now.

        Call it at least ten times a second and after every call: it drives everything that waits for time.
        """
        age_s, self._asked_s = now_s - self._asked_s, now_s
        was_up = self._authority.state != "down"
        self._end_plan(now_s)
        state = self._whereabouts.at(now_s)
        refusal = self._why_not(state, age_s, now_s)
        if refusal is not None:
            if refusal.code != "floor_unknown" or not self._floor.settles(now_s):
                self._refused(refusal)
            self._give_back(refusal, now_s, pause=True)
        self._do(self._authority.step(self._plan is not None and refusal is None, now_s), now_s)
        if self._authority.state != "granted":
            self._joined = False
        elif state is not None and self._plan is not None:
            self._fly(self._plan, state, now_s)
        if self._authority.state != "down":
            for report, ticket in self._report_queue.take_due(now_s):
                self._talker.report(report, ticket, now_s)
        elif was_up:
            self._report_queue.link_lost()
        outgoing = self._fetched(partial(self._why_not_sent, state, now_s), now_s)
        self._notice_authority()
        last_words, self._last_words = self._last_words, []
        return [*last_words, *outgoing]

    def go_on(self, session: int, n_starts: int, announced: Mapping[int, AnnouncedContact]) -> None:
        """Report contacts under the numbers of a session; see `ReportQueue.go_on`."""
        self._report_queue.go_on(session, n_starts, announced)

    def report(self, contact: Contact) -> None:
        """Queue the report of a contact that is new or has changed, if the vehicle takes any.

        Raises ValueError for an id that is not C and a number.
        """
        if Capability.CONTACT in self._talker.capabilities:
            self._report_queue.add(contact)

    def report_health(self, health: PayloadHealth, now_s: float) -> None:
        """Report how the payload is, at once if it changed."""
        if health != self._health:
            self._health = health
            self._talker.report_health(health, now_s)

    def propose(self, plan: tuple[Waypoint, ...], now_s: float) -> None:
        """Propose a plan in place of the one before; () withdraws it. What of it is behind the vehicle is not flown.

        A plan that leaves the fence somewhere is refused as a whole, and takes the place of the one before all the
        same.
        """
        if self._plan is not None and plan == self._plan.proposed:
            self._plan = self._plan._replace(approved_s=now_s)
            return
        self._plan, self._joined = None, False
        self._counted.clear()
        if len(plan) < 2 or not self._may_command or self._released:
            return
        self._own["vehicle.plans"] += 1
        places_deg = tuple((waypoint.latitude_deg, waypoint.longitude_deg) for waypoint in plan)
        slack_m = self._config.arrival_radius_m if self._may_steer else 0.0
        if (refusal := self._guard.plan(places_deg[1:], slack_m)) is not None:
            self._refused(refusal)
            return
        radius_m, cut_radius_m = self._config.arrival_radius_m, self._turn_radius_m if self._may_steer else 0.0
        flown = plan if self._may_steer else with_points_on_legs(plan, max(self._turn_radius_m, 2.0 * radius_m))
        places_deg = tuple((waypoint.latitude_deg, waypoint.longitude_deg) for waypoint in flown)
        self._plan = FlownPlan(
            plan, flown, WaypointTrack(places_deg, radius_m=radius_m, cut_radius_m=cut_radius_m), now_s
        )

    def release(self, reason: str, now_s: float) -> None:
        """Release control, drop the plan and stop requesting: the service stops.

        The messages to be sent have still to be fetched.
        """
        self._released = True
        self._plan = None
        self._do(self._authority.give_back(reason, now_s, pause=False), now_s)
        self._notice_authority()

    def _end_plan(self, now_s: float) -> None:
        """Drop a plan that is complete or too old."""
        if self._plan is None:
            return
        if self._plan.track.finished:
            self._plan = None
            self._own["vehicle.plans_flown"] += 1
            self._do(self._authority.give_back("the plan is complete", now_s, pause=False), now_s)
        elif (refusal := self._guard.plan_age(now_s - self._plan.approved_s)) is not None:
            self._drop_plan(refusal, now_s)

    def _fetched(self, why_not: Callable[[WireCommand], Refusal | None], now_s: float) -> list[W]:
        """Fetch what is to be sent, without commands that must not be: then control goes back, too.

        why_not: returns why a command with these numbers must not be sent.
        """
        if not self._wire_open:
            return []
        outgoing = self._talker.take_outgoing(now_s)
        if self._read_back is None:
            return outgoing
        commands = self._read_back(outgoing)
        refusals = [refusal for command in commands if command is not None and (refusal := why_not(command))]
        if not refusals:
            holds_s = [command.holds_s or 0.0 for command in commands if command is not None]
            self._holds_s = max(self._config.command_valid_s, *holds_s) if holds_s else self._holds_s
            return outgoing
        rest = [item for item, command in zip(outgoing, commands, strict=True) if command is None]
        self._drop_plan(refusals[0], now_s)
        after = self._talker.take_outgoing(now_s)
        return rest + [item for item, command in zip(after, self._read_back(after), strict=True) if command is None]

    def _why_not_sent(self, state: ReportedState | None, now_s: float, command: WireCommand) -> Refusal | None:
        if self._authority.state != "granted":
            return _NOT_GRANTED
        return self._guard.command(command, state, self._floor.at(now_s))

    def _give_back(self, refusal: Refusal, now_s: float, *, pause: bool) -> None:
        """Release control, and lead a vehicle up before that is commanded depths and whose floor is not known."""
        if refusal.code in _LEADING_UP and self._authority.state == "granted":
            self._lead_up(now_s)
        self._do(self._authority.give_back(refusal.text, now_s, pause=pause), now_s)

    def _lead_up(self, now_s: float) -> None:
        last = self._command
        if Capability.DEPTHS_ALONE not in self._talker.capabilities or not isinstance(last, Steer):
            return
        self._command = None
        safe_depth_m = self._floor.safe_depth_m(self._config.altitude_m, now_s, self._holds_s)
        safe_depth_m = min(last.vertical.value_m, safe_depth_m)
        self._talker.command(last._replace(vertical=Vertical("depth", safe_depth_m)), now_s)
        self._own["vehicle.led_up"] += 1
        state = self._whereabouts.at(now_s)
        self._last_words += self._fetched(lambda command: self._guard.ascent(command, state, safe_depth_m), now_s)

    def _why_not(self, state: ReportedState | None, age_s: float, now_s: float) -> Refusal | None:
        """Return why no command may be sent now; before a grant, also why the first would be refused."""
        if self._plan is None or self._authority.state == "down":
            return None
        in_control = self._authority.state == "granted"
        refusal = (self._guard.age(age_s) if in_control else None) or self._guard.state(state)
        if refusal is not None or state is None:
            return refusal
        if self._may_steer and not math.isfinite(state.heading_rad):
            return Refusal("heading_unknown", "the vehicle's heading is not known")
        if in_control:  # where the floor is lost the plan is kept
            refusal = self._guard.vertical(self._vertical(now_s), self._floor.at(now_s))
            return refusal if refusal is not None and refusal.code == "floor_unknown" else None
        first = self._plan.waypoints[self._plan.entry((state.latitude_deg, state.longitude_deg))]
        go_to = self._go_to(first.latitude_deg, first.longitude_deg, self._vertical(now_s))
        return self._guard.command(numbers_of(go_to), state, self._floor.at(now_s))

    def _fly(self, plan: FlownPlan, state: ReportedState, now_s: float) -> None:
        """Return the next command, if it may be given."""
        position_deg = state.latitude_deg, state.longitude_deg
        if not self._joined:
            plan.track.join(position_deg, plan.entry(position_deg))
            self._line_of_sight.start()
            self._joined, self._command = True, None
        plan.track.advance(position_deg)
        if plan.track.finished:
            self._end_plan(now_s)
            return
        command: Command
        if self._may_steer:
            heading_rad = self._line_of_sight.heading_rad(
                plan.track, position_deg, self._whereabouts.position_s, state.heading_rad, now_s
            )
            command = Steer(heading_rad, self._vertical(now_s), self._config.speed_mps)
        else:
            command = self._go_to(*plan.track.target_deg, self._vertical(now_s))
        if (refusal := self._guard.command(numbers_of(command), state, self._floor.at(now_s))) is not None:
            self._drop_plan(refusal, now_s)
        elif self._due(command, now_s):
            self._command, self._commanded_s = command, now_s
            self._own["vehicle.commands"] += 1
            self._talker.command(command, now_s)

    def _vertical(self, now_s: float) -> Vertical:
        """Return the altitude to command, or, to a vehicle that holds depths alone, the depth over the floor below."""
        altitude_m = self._floor.altitude_to_keep_m(self._config.altitude_m)
        if Capability.DEPTHS_ALONE not in self._talker.capabilities:
            return Vertical("altitude", altitude_m + self._floor.doubt_m)
        return Vertical("depth", max(self._floor.at(now_s).shallowest_m - altitude_m, 0.0))

    def _go_to(self, latitude_deg: float, longitude_deg: float, vertical: Vertical) -> GoTo:
        return GoTo(latitude_deg, longitude_deg, vertical, self._config.speed_mps, self._config.arrival_radius_m)

    def _due(self, command: Command, now_s: float) -> bool:
        """Return whether the command differs enough, or the last one is old enough to be repeated."""
        since_s = now_s - self._commanded_s
        if self._command is None or since_s >= self._talker.command_period_s:
            return True
        if isinstance(command, Steer) and isinstance(self._command, Steer):
            turned_rad = math.remainder(command.heading_rad - self._command.heading_rad, 2.0 * math.pi)
            return since_s >= _STEER_AGAIN_S and abs(turned_rad) >= _STEER_STEP_RAD
        return command != self._command

    def _arrived(self) -> None:
        """Take the vehicle's report of arrival where it is plausible; it may still refer to the way-point before."""
        plan = self._plan
        if (
            plan is None
            or self._authority.state != "granted"
            or not isinstance(self._command, GoTo)
            or plan.track.finished
            or (self._command.latitude_deg, self._command.longitude_deg) != plan.track.target_deg
        ):
            return
        away_m = math.hypot(*plan.track.off_track(self._whereabouts.position_deg))
        if not away_m > _ARRIVED_WITHIN_RADII * self._config.arrival_radius_m:
            plan.track.arrive()

    def _drop_plan(self, refusal: Refusal, now_s: float) -> None:
        self._plan = None
        self._refused(refusal)
        self._give_back(refusal, now_s, pause=False)

    def _refused(self, refusal: Refusal) -> None:
        """Report a refusal once per plan and reason, since commands are checked ten times a second."""
        self._refusal = refusal
        if refusal.code in self._counted:
            return
        self._counted.add(refusal.code)
        self._own[f"vehicle.refused.{refusal.code}"] += 1
        self._raise_notice(
            "vehicle_refused", f"no command goes to the vehicle: {refusal.text} [{refusal.code}]", logging.WARNING
        )

    def _do(self, action: Action | None, now_s: float) -> None:
        match action:
            case Ask():
                self._own["vehicle.requested"] += 1
                self._talker.request(now_s)
            case GiveBack(reason, n_unanswered, n_undecided):
                self._command, self._joined = None, False
                self._own["vehicle.returned"] += 1
                self._talker.release(reason, now_s)
                if self._announced_state == "granted":
                    self._raise_notice(
                        "vehicle_control_returned", f"control of the vehicle is released: {reason}", logging.INFO
                    )
                if n_unanswered == _MAX_UNANSWERED and Capability.INVITES not in self._talker.capabilities:
                    text = (
                        f"the vehicle answered none of {n_unanswered} requests for control, and no leg is flown until "
                        "it does. Does its mission let this payload command, and is its port set up so?"
                    )
                    self._raise_notice("vehicle_control_unanswered", text, logging.WARNING)
                elif n_undecided == 1:
                    text = (
                        f"the vehicle considered a request for control for {DECIDE_WITHIN_S:g} s without a decision, "
                        "and no leg is flown until it grants one. Has a person to agree on its side?"
                    )
                    self._raise_notice("vehicle_control_unanswered", text, logging.WARNING)

    def _notice_authority(self) -> None:
        """Raise a notice of a new state, once."""
        state, reason = self._authority.state, self._authority.reason
        if state == self._announced_state:
            return
        self._announced_state = state
        if state == "granted":
            self._own["vehicle.granted"] += 1
            self._raise_notice("vehicle_control_granted", f"the vehicle grants control: {reason}", logging.INFO)
        elif state == "revoked":
            self._own["vehicle.withheld"] += 1
            self._command, self._joined = None, False
            self._raise_notice("vehicle_control_withheld", f"the vehicle keeps control: {reason}", logging.WARNING)
        else:
            log.info("vehicle: %s: %s", state, reason)

    def _report_rejected(self, rejected: Rejected) -> None:
        report = self._report_queue.reject(rejected.ticket)
        if report is not None and report.number not in self._rejected:
            self._rejected.add(report.number)
            self._raise_notice(
                "vehicle_report_rejected", f"the vehicle rejects {report.label}: {rejected.reason}", logging.WARNING
            )

    def _doubted(self, reason: str) -> None:
        """Report the first rejected message, and count the others: an attacker may send many."""
        self._own["vehicle.doubted"] += 1
        if self._own["vehicle.doubted"] == 1:
            self._raise_notice(
                "vehicle_doubted",
                f"a message of the vehicle is rejected: {reason} Further ones are only counted.",
                logging.WARNING,
            )

    def _raise_notice(self, code: str, text: str, level: int) -> None:
        log.log(level, "%s", text)
        self._notices.append(Notice(code=code, text=text, for_the_record=level < logging.WARNING))
