"""Check the messages to an IMC vehicle, and the interpretation of its answers."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from auv_mcm.settings.vehicle_settings import ImcSettings
from drivers.framing import Framer
from drivers.vehicle import imc_messages as imc
from drivers.vehicle.dialect import (
    Acknowledged,
    Capability,
    Doubted,
    GoTo,
    Granted,
    PayloadHealth,
    PlaceReached,
    Rejected,
    ReportedState,
    Steer,
    VehicleEvent,
    Vertical,
    Withheld,
)
from drivers.vehicle.imc_codec import decode
from drivers.vehicle.imc_contact import imc_contact_of
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
from drivers.vehicle.imc_wire import ANYONE, ImcGrammar, ImcPacket, packed
from drivers.vehicle.talkers.imc_talker import PLAN_ID
from drivers.vehicle.vehicles import talker_of
from tests.make.records import report_of
from tests.sim_replay.conversation import Conversation

US, VEHICLE, OTHER = 0x6000, 0x1E, 0x2F
UTC_S = 1_700_000_000
GOAL = GoTo(41.1851, -8.7062, Vertical("altitude", 5.0), 1.5, 3.0)
LEARNS, KNOWS, INVITED = (
    ImcSettings(),
    ImcSettings(vehicle_id=VEHICLE, acknowledges=True),
    ImcSettings(vehicle_id=VEHICLE, own_plan=False),
)


class Talk:
    """Run a dialect whose wire is open, and collect its messages."""

    def __init__(self, settings: ImcSettings = KNOWS, now_s: float = 100.0) -> None:
        self.dialect = Conversation(settings)
        self.now_s = now_s
        self.dialect.connected(now_s)
        self.sent()

    def packets(self) -> list[ImcPacket]:
        framer = Framer(ImcGrammar())
        return [framed.message for item in self.dialect.take_outgoing(self.now_s) for framed in framer.feed(item)]

    def sent(self) -> list[ImcMessage]:
        return [decode(packet.number, packet.payload) for packet in self.packets()]

    def sent_of(self, kind: type[Any], for_s: float = 0.0) -> list[Any]:
        """All of a kind within the next seconds, nothing being heard."""
        until_s = self.now_s + for_s
        found = [message for message in self.sent() if type(message) is kind]
        while self.now_s < until_s - 1e-6:
            self.now_s += 0.1
            found += [message for message in self.sent() if type(message) is kind]
        return found

    def hear(
        self, *messages: ImcMessage, source: int = VEHICLE, to: int = ANYONE, age_s: float = 0.0
    ) -> list[VehicleEvent]:
        """age_s: of their times, by the sender's clock, which is an hour off."""
        time_s = UTC_S + 3600.0 + self.now_s - age_s
        data = b"".join(packed(message, source, to=to, time_s=time_s) for message in messages)
        return self.dialect.hear(data, stamp_at(self.now_s))

    def take_over(self) -> int:
        """Until the grant; returns the number of the request."""
        self.dialect.request(self.now_s)
        (start,) = self.sent_of(imc.PlanControl)
        assert self.hear(succeeded(start.request_id)) == []
        assert [type(event) for event in self.hear(follow_state())] == [Granted]
        return int(start.request_id)


def stamp_at(now_s: float) -> Stamp:
    return Stamp(round(1e9 * now_s), round(1e9 * (UTC_S + now_s)))


def succeeded(request_id: int) -> imc.PlanControl:
    return imc.PlanControl(PlanType.SUCCESS, PlanOp.START, request_id, PLAN_ID)


def follow_state(
    goal: GoTo | None = None, state: int = RefState.WAIT, near: int = Proximity.FAR, of: int = US
) -> imc.FollowRefState:
    reference = goal and imc.Reference(
        RefFlag.LOCATION, lat=math.radians(goal.latitude_deg), lon=math.radians(goal.longitude_deg)
    )
    return imc.FollowRefState(of, 255, reference, state, near)


def estimated(latitude_deg: float, longitude_deg: float, **others: float) -> imc.EstimatedState:
    return imc.EstimatedState(math.radians(latitude_deg), math.radians(longitude_deg), **others)


def test_take_over_flight_and_return() -> None:
    talk = Talk()
    talk.dialect.request(talk.now_s)
    (packet,) = [packet for packet in talk.packets() if packet.number == 559]
    assert (packet.source, packet.destination) == (US, VEHICLE)
    start = decode(packet.number, packet.payload)
    assert isinstance(start, imc.PlanControl)
    assert (start.type, start.op, start.plan_id) == (PlanType.REQUEST, PlanOp.START, PLAN_ID)
    assert isinstance(start.arg, imc.PlanSpecification)
    (maneuver,) = start.arg.maneuvers
    assert maneuver.maneuver_id == start.arg.start_man_id
    assert maneuver.data == imc.FollowReference(US, 255, KNOWS.control_timeout_s)

    assert talk.hear(succeeded(start.request_id)) == []
    assert talk.hear(follow_state()) == [Granted("FollowReference runs for us")]
    talk.dialect.command(GOAL, talk.now_s)
    (reference,) = talk.sent_of(imc.Reference)
    assert reference == imc.Reference(
        RefFlag.LOCATION | RefFlag.SPEED | RefFlag.Z,
        imc.DesiredSpeed(1.5),
        imc.DesiredZ(5.0, ZUnits.ALTITUDE),
        math.radians(GOAL.latitude_deg),
        math.radians(GOAL.longitude_deg),
    )
    assert talk.hear(follow_state(GOAL, RefState.GOTO)) == []
    assert talk.hear(follow_state(GOAL, RefState.LOITER, Proximity.XY_NEAR | Proximity.Z_NEAR)) == [PlaceReached()]
    assert talk.hear(follow_state(GOAL, RefState.LOITER, Proximity.XY_NEAR)) == [], "reported once"

    talk.dialect.command(GOAL, talk.now_s)
    talk.dialect.release("done", talk.now_s)
    assert talk.sent() == [imc.Reference(RefFlag.MANDONE)], "the command not yet sent is dropped"
    assert talk.sent_of(imc.Reference, 3.0) == []


@pytest.mark.parametrize("first", ["answer", "state"])
def test_the_grant_takes_the_answer_and_the_manoeuvre(first: str) -> None:
    talk = Talk()
    talk.dialect.request(talk.now_s)
    (start,) = talk.sent_of(imc.PlanControl)
    both = (succeeded(start.request_id), follow_state())
    events = talk.hear(*(both if first == "answer" else both[::-1]))
    assert [type(event) for event in events] == [Granted]


@pytest.mark.parametrize(
    "messages",
    [
        [follow_state()],
        [succeeded(1)],
        [succeeded(2), follow_state()],
        [succeeded(1), follow_state(of=OTHER)],
        [succeeded(1), follow_state(state=RefState.TIMEOUT)],
        [imc.PlanControl(PlanType.SUCCESS, PlanOp.STOP, 1, PLAN_ID), follow_state()],
        [imc.PlanControl(PlanType.SUCCESS, PlanOp.START, 1, "survey"), follow_state()],
        [imc.PlanControl(PlanType.IN_PROGRESS, PlanOp.START, 1, PLAN_ID), follow_state()],
    ],
)
def test_less_is_no_grant(messages: list[ImcMessage]) -> None:
    talk = Talk()
    talk.dialect.request(talk.now_s)
    assert [start.request_id for start in talk.sent_of(imc.PlanControl)] == [1]
    assert talk.hear(*messages) == []
    talk.dialect.command(GOAL, talk.now_s)
    assert talk.sent_of(imc.Reference, 1.0) == []
    assert talk.dialect.counters["imc.commands_unsaid"] == 1


def test_answers_of_others_and_to_others_do_not_count() -> None:
    talk = Talk()
    talk.dialect.request(talk.now_s)
    talk.sent()
    assert talk.hear(succeeded(1), follow_state(), source=OTHER) == []
    assert talk.hear(succeeded(1), follow_state(), source=US) == []
    assert talk.dialect.counters["imc.other_source"] == 4
    assert talk.hear(succeeded(1), follow_state(), to=OTHER) == []
    assert [type(event) for event in talk.hear(succeeded(1), to=US)] == [Granted]


def test_a_request_is_sent_again_but_not_for_ever() -> None:
    talk = Talk()
    talk.dialect.request(talk.now_s)
    starts = talk.sent_of(imc.PlanControl, 20.0)
    assert len(starts) == 3
    assert {start.request_id for start in starts} == {1}


def test_a_vehicle_that_calibrates_first_is_waited_for() -> None:
    talk = Talk()
    talk.dialect.request(talk.now_s)
    talk.sent()
    talk.hear(imc.PlanControl(PlanType.IN_PROGRESS, PlanOp.START, 1, PLAN_ID))
    assert talk.sent_of(imc.PlanControl, 8.0) == []
    assert [type(event) for event in talk.hear(succeeded(1), follow_state())] == [Granted]


RUNNING = imc.PlanControlState(PlanState.EXECUTING, PLAN_ID)
FLYING = imc.VehicleState(OpMode.MANEUVER, maneuver_type=478)


@pytest.mark.parametrize(
    ("last", "reason"),
    [
        (imc.PlanControl(PlanType.FAILURE, PlanOp.START, 1, PLAN_ID, info="low battery"), "low battery"),
        (follow_state(state=RefState.TIMEOUT), "no reference in time"),
        (follow_state(of=OTHER), "0x002F"),
        (imc.PlanControlState(PlanState.EXECUTING, "go_home"), "go_home"),
        (imc.PlanControlState(PlanState.READY, PLAN_ID), "ended"),
        (imc.PlanControlState(PlanState.BLOCKED), "ended"),
        (imc.VehicleState(OpMode.ERROR, last_error="leak"), "leak"),
        (imc.VehicleState(OpMode.EXTERNAL), "external"),
        (imc.VehicleState(OpMode.BOOT), "booting"),
        (imc.VehicleState(OpMode.SERVICE), "service"),
        (imc.VehicleState(OpMode.CALIBRATION), "calibrating"),
        (imc.VehicleState(OpMode.MANEUVER, maneuver_type=450), "450"),
        (imc.Abort(), "Abort"),
    ],
)
def test_control_that_is_taken_back(last: ImcMessage, reason: str) -> None:
    talk = Talk()
    talk.take_over()
    assert talk.hear(RUNNING, FLYING) == []
    talk.dialect.command(GOAL, talk.now_s)
    (event,) = talk.hear(last)
    assert isinstance(event, Withheld)
    assert reason in event.reason
    assert talk.sent_of(imc.Reference, 3.0) == [], "what was not sent yet is dropped"
    talk.dialect.release("too late", talk.now_s)
    assert talk.sent_of(imc.PlanControl, 3.0) == talk.sent_of(imc.Reference) == []


def test_an_abort_counts_whoever_says_it() -> None:
    talk = Talk()
    talk.take_over()
    withheld = [Withheld("Abort from 0x002F")]
    assert talk.hear(imc.Abort(), source=OTHER, to=VEHICLE) == withheld
    assert talk.hear(imc.Abort(), source=OTHER, to=VEHICLE) == withheld, "it is not to be asked for now either"


def test_states_reported_before_the_take_over_do_not_end_it() -> None:
    talk = Talk()
    talk.take_over()
    old = (imc.PlanControlState(PlanState.EXECUTING, "survey"), imc.VehicleState(OpMode.MANEUVER, maneuver_type=450))
    assert talk.hear(*old) == []
    talk.now_s += 2.5
    assert [type(event) for event in talk.hear(*old)] == [Withheld]


def test_references_that_nobody_answers_end_it() -> None:
    talk = Talk()
    talk.take_over()
    talk.now_s += 60.0
    assert talk.hear(imc.Heartbeat()) == [], "nothing was said that could be answered"
    events = []
    for _ in range(12):
        talk.dialect.command(GOAL, talk.now_s)
        talk.sent()
        talk.now_s += 0.5
        events += talk.hear(imc.Heartbeat())
    assert events == [Withheld("the vehicle does not answer our references")]


def test_a_plan_of_ours_that_nobody_wants_is_stopped_and_no_other() -> None:
    talk = Talk()
    talk.hear(imc.PlanControlState(PlanState.EXECUTING, "survey"))
    talk.hear(imc.PlanControlState(PlanState.READY, PLAN_ID))
    assert talk.sent_of(imc.PlanControl, 3.0) == []
    talk.hear(RUNNING, RUNNING)
    (stop,) = talk.sent_of(imc.PlanControl, 1.0)
    assert (stop.op, stop.plan_id) == (PlanOp.STOP, PLAN_ID)


def test_after_a_release_the_plan_is_stopped_only_if_it_goes_on() -> None:
    talk = Talk()
    talk.take_over()
    talk.dialect.release("done", talk.now_s)
    talk.hear(RUNNING)
    assert talk.sent_of(imc.PlanControl, 2.5) == []
    talk.hear(RUNNING)
    assert [stop.op for stop in talk.sent_of(imc.PlanControl)] == [PlanOp.STOP]


def test_a_request_can_be_withdrawn() -> None:
    talk = Talk()
    talk.dialect.request(talk.now_s)
    talk.sent()
    talk.dialect.release("plan withdrawn", talk.now_s)
    assert talk.sent_of(imc.PlanControl, 5.0) == [], (
        "the vehicle may never have heard of it, and STOP would stop its own"
    )
    assert talk.hear(succeeded(1), follow_state()) == []
    talk.dialect.request(talk.now_s)
    talk.hear(succeeded(2))
    assert [control.op for control in talk.sent_of(imc.PlanControl)] == [PlanOp.START]
    talk.dialect.release("plan withdrawn", talk.now_s)
    (stop,) = talk.sent_of(imc.PlanControl)
    assert (stop.op, stop.info) == (PlanOp.STOP, "plan withdrawn")


def test_invited_by_the_vehicles_own_plan() -> None:
    talk = Talk(INVITED)
    assert talk.hear(follow_state()) == []
    talk.dialect.request(talk.now_s)
    assert talk.sent_of(imc.PlanControl, 3.0) == []
    assert [type(event) for event in talk.hear(imc.Heartbeat())] == [Granted]
    assert talk.hear(imc.PlanControlState(PlanState.EXECUTING, "survey"), FLYING) == []
    talk.dialect.release("done", talk.now_s)
    assert talk.sent_of(imc.Reference) == [imc.Reference(RefFlag.MANDONE)]
    talk.dialect.request(talk.now_s)
    assert talk.hear(imc.PlanControlState(PlanState.EXECUTING, "survey")) == [], "that invitation was used"
    assert talk.sent_of(imc.PlanControl, 3.0) == []


def test_an_invitation_that_is_over_is_none() -> None:
    talk = Talk(INVITED)
    talk.hear(follow_state())
    talk.now_s += 5.0
    talk.hear(imc.VehicleState(OpMode.MANEUVER, maneuver_type=450))
    talk.dialect.request(talk.now_s)
    assert talk.hear(imc.Heartbeat()) == []


def test_near_in_the_vehicles_eyes_is_not_yet_there() -> None:
    talk = Talk()
    talk.take_over()
    talk.dialect.command(GOAL, talk.now_s)
    near = follow_state(GOAL, RefState.GOTO, Proximity.XY_NEAR)
    metre_deg = 1.0 / 111_000.0

    def at(distance_m: float) -> list[VehicleEvent]:
        talk.hear(estimated(GOAL.latitude_deg - distance_m * metre_deg, GOAL.longitude_deg))
        return talk.hear(near)

    assert at(14.0) == at(9.0) == at(4.0) == []
    assert at(2.5) == [PlaceReached()]
    elsewhere = GOAL._replace(latitude_deg=GOAL.latitude_deg + 0.001)
    talk.dialect.command(elsewhere, talk.now_s)
    assert talk.hear(follow_state(GOAL, RefState.LOITER, Proximity.XY_NEAR)) == [], "that is the place before"
    talk.dialect.command(GOAL, talk.now_s)
    assert at(9.0) == at(6.0) == at(6.5) == []
    assert at(7.5) == [PlaceReached()], "it has gone by, and nearer than that it does not come"


def test_position_is_displaced_by_the_offsets() -> None:
    talk = Talk()
    latitude_deg, north_m, east_m = 41.0, 1200.0, -3400.0
    message = estimated(
        latitude_deg,
        -8.5,
        x=north_m,
        y=east_m,
        z=20.0,
        phi=0.1,
        theta=-0.2,
        psi=-0.5,
        vx=0.6,
        vy=0.8,
        vz=9.0,
        depth=20.0,
        alt=-1.0,
    )
    (state,) = talk.hear(message)
    assert isinstance(state, ReportedState)
    # Radii of curvature of the ellipsoid, good to centimetres here.
    a_m, e2 = 6_378_137.0, 0.00669437999014
    w = math.sqrt(1.0 - e2 * math.sin(math.radians(latitude_deg)) ** 2)
    meridian_m, prime_vertical_m = a_m * (1.0 - e2) / w**3, a_m / w
    assert math.radians(state.latitude_deg - latitude_deg) * meridian_m == pytest.approx(north_m, abs=1.0)
    longitude_m = (
        math.radians(state.longitude_deg + 8.5) * prime_vertical_m * math.cos(math.radians(state.latitude_deg))
    )
    assert longitude_m == pytest.approx(east_m, abs=1.0)
    assert state.heading_rad == pytest.approx(math.tau - 0.5)
    assert (state.roll_rad, state.pitch_rad, state.speed_mps) == pytest.approx((0.1, -0.2, 1.0))
    assert state.depth_m == 20.0
    assert math.isnan(state.altitude_m)
    assert state.received == stamp_at(talk.now_s)


@pytest.mark.parametrize("others", [{"x": 1e6}, {"y": math.nan}, {"height": math.inf}])
def test_a_position_that_cannot_be_is_none(others: dict[str, float]) -> None:
    (state,) = Talk().hear(estimated(41.0, -8.5, depth=3.0, **others))
    assert isinstance(state, ReportedState)
    assert math.isnan(state.latitude_deg)
    assert math.isnan(state.longitude_deg)
    assert state.depth_m == 3.0
    (lost,) = Talk().hear(estimated(91.0, -8.5))
    assert isinstance(lost, ReportedState)
    assert math.isnan(lost.latitude_deg)


@pytest.mark.parametrize("first", [imc.Announce("lauv-xplore-1", 2), estimated(41.0, -8.5)])
def test_the_first_vehicle_is_the_vehicle(first: ImcMessage) -> None:
    talk = Talk(LEARNS)
    talk.dialect.request(talk.now_s)
    assert talk.sent_of(imc.PlanControl, 3.0) == [], "nobody knows yet whom to ask"
    talk.hear(imc.Announce("console", 0), source=OTHER)
    talk.hear(first)
    assert talk.hear(imc.Announce("another", 2), estimated(42.0, -8.0), source=OTHER) == []
    assert {packet.destination for packet in talk.packets()} == {VEHICLE}
    talk.dialect.connected(talk.now_s)
    assert {packet.destination for packet in talk.packets()} == {ANYONE}


def test_heartbeat_every_second_and_health_when_it_changes() -> None:
    talk = Talk()
    assert 9 <= len(talk.sent_of(imc.Heartbeat, 10.0)) <= 11  # steps of 0.1 s are not exact
    talk.dialect.report_health(PayloadHealth("fault", "port bow: silent"), talk.now_s)
    reported = imc.EntityState(EntityStatus.FAULT, 0, "port bow: silent")
    assert talk.sent_of(imc.EntityState) == [reported]
    assert talk.sent_of(imc.EntityState, 21.0) == 4 * [reported]


def test_packets_are_stamped_with_the_time_that_was_heard() -> None:
    talk = Talk()
    talk.hear(imc.Heartbeat())
    talk.now_s += 5.0
    assert [packet.time_s for packet in talk.packets()] == pytest.approx([UTC_S + talk.now_s], abs=1e-6)


def test_contacts_go_as_targets_where_the_vehicle_knows_no_more() -> None:
    talk = Talk(LEARNS)
    assert Capability.ACKNOWLEDGED not in talk.dialect.capabilities
    talk.dialect.report(report_of(), 1, talk.now_s)
    (target,) = [message for message in talk.sent() if not isinstance(message, imc.Heartbeat)]
    assert isinstance(target, imc.Target)
    assert (target.label, target.z_units) == ("MLC-00003", ZUnits.NONE)
    assert talk.sent_of(imc.Target, 10.0) == talk.sent_of(imc.MineContact, 10.0) == []


def test_contacts_are_reported_in_full_until_they_are_acknowledged() -> None:
    talk = Talk()
    assert Capability.ACKNOWLEDGED in talk.dialect.capabilities
    report = report_of()
    talk.dialect.report(report, 9, talk.now_s)
    talk.dialect.report(report_of(number=4), 10, talk.now_s)
    first = [message for message in talk.sent() if isinstance(message, imc.Target | imc.MineContact)]
    assert [type(message) for message in first] == [imc.Target, imc.Target, imc.MineContact, imc.MineContact]
    taken = imc.MineContactTaken(77, 3, 1, 1)
    assert talk.hear(taken, source=OTHER) == talk.hear(imc.MineContactTaken(77, 3, 2, 1)) == []
    assert talk.hear(taken) == [Acknowledged(9)]
    assert talk.hear(taken) == []
    again = talk.sent_of(imc.MineContact, 60.0)
    assert {message.number for message in again} == {4}
    assert 4 <= len(again) <= 6, "less and less often"
    assert talk.hear(imc.MineContactTaken(77, 4, 1, 0, "too far")) == [Rejected(10, "too far")]
    assert talk.sent_of(imc.MineContact, 60.0) == []


def test_a_report_that_is_sent_anew_is_answered_under_its_new_ticket() -> None:
    talk = Talk()
    talk.dialect.report(report_of(), 9, talk.now_s)
    talk.dialect.report(report_of(), 10, talk.now_s)
    assert len(talk.sent_of(imc.MineContact)) == 1
    assert talk.hear(imc.MineContactTaken(77, 3, 1, 1)) == [Acknowledged(10)]


def test_a_new_connection_forgets_what_was_half_sent() -> None:
    talk = Talk()
    talk.take_over()
    talk.dialect.command(GOAL, talk.now_s)
    talk.dialect.report(report_of(), 9, talk.now_s)
    talk.dialect.disconnected()
    assert talk.sent() == []
    talk.dialect.connected(talk.now_s)
    assert [type(message) for message in talk.sent()] == [imc.Heartbeat]
    assert talk.sent_of(imc.MineContact, 5.0) == []


def test_steering_is_not_sent() -> None:
    talk = Talk()
    talk.take_over()
    talk.dialect.command(Steer(1.0, GOAL.vertical, 1.5), talk.now_s)
    assert talk.sent() == []
    assert talk.dialect.counters["imc.commands_unsaid"] == 1


def test_messages_of_no_use_are_counted() -> None:
    talk = Talk()
    data = packed(imc.EntityState(1), VEHICLE) + packed(imc_contact_of(report_of()), VEHICLE)
    assert talk.dialect.hear(data, stamp_at(1.0)) == []
    assert talk.dialect.counters["imc.other_messages"] == 2


def test_a_decoder_of_navigation_alone_needs_no_connection() -> None:
    dialect = Conversation(LEARNS)
    (state,) = dialect.hear(packed(estimated(41.0, -8.5), VEHICLE), stamp_at(1.0))
    assert isinstance(state, ReportedState)
    assert dialect.take_outgoing(1.0) == []


IDS = st.sampled_from([1, 2, 3])
HEARD = st.one_of(
    st.builds(
        imc.PlanControl,
        st.sampled_from(PlanType),
        st.sampled_from(PlanOp),
        IDS,
        st.sampled_from([PLAN_ID, "survey", ""]),
        info=st.just("x"),
    ),
    st.builds(
        follow_state,
        st.sampled_from([None, GOAL]),
        st.sampled_from(RefState),
        st.sampled_from(Proximity),
        st.sampled_from([US, US, OTHER]),
    ),
    st.builds(imc.PlanControlState, st.sampled_from(PlanState), st.sampled_from([PLAN_ID, "survey"])),
    st.builds(imc.VehicleState, st.sampled_from(OpMode), maneuver_type=st.sampled_from([478, 450, 0xFFFF])),
    st.builds(imc.MineContactTaken, st.just(77), IDS, IDS, st.integers(0, 1)),
    st.sampled_from([imc.Abort(), imc.Heartbeat(), estimated(41.185, -8.706), imc.Announce("a", 2)]),
)
STEPS = st.one_of(
    st.tuples(st.just("hear"), HEARD, st.sampled_from([VEHICLE, VEHICLE, VEHICLE, OTHER, US])),
    st.tuples(st.just("bytes"), st.binary(max_size=60)),
    st.tuples(
        st.sampled_from(["request", "command", "release", "take", "disconnect", "connect", "report", "steer", "grant"])
    ),
)


@given(
    settings=st.sampled_from([LEARNS, KNOWS, INVITED]),
    steps=st.lists(st.tuples(st.floats(0.0, 3.0), STEPS), max_size=40),
)
def test_no_reference_leaves_without_a_grant(settings: ImcSettings, steps: list[tuple[float, tuple[Any, ...]]]) -> None:
    talk = Talk(settings)
    dialect = talk.dialect
    granted = released = False
    for pause_s, (what, *rest) in steps:
        talk.now_s += pause_s
        events: list[VehicleEvent] = []
        if what == "hear":
            events = talk.hear(rest[0], source=rest[1])
        elif what == "bytes":
            events = dialect.hear(rest[0], stamp_at(talk.now_s))
        elif what == "grant":  # by chance it would come too seldom
            dialect.request(talk.now_s)
            events = talk.hear(*(succeeded(number) for number in range(1, 8)), follow_state())
        elif what == "disconnect":
            granted = released = False
            dialect.disconnected()
        elif what == "connect":
            granted = released = False
            dialect.connected(talk.now_s)
        elif what == "release":
            released = released or granted
            granted = False
            dialect.release("done", talk.now_s)
        elif what == "request":
            dialect.request(talk.now_s)
        elif what == "report":
            dialect.report(report_of(), 1, talk.now_s)
        elif what != "take":
            dialect.command(GOAL if what == "command" else Steer(NAN, GOAL.vertical, 1.0), talk.now_s)
        for event in events:
            assert not (isinstance(event, Granted) and granted)
            assert not (isinstance(event, PlaceReached) and not granted)
            granted = isinstance(event, Granted) or (granted and not isinstance(event, Withheld))
        for message in talk.sent():
            if isinstance(message, imc.Reference):
                assert granted if message.flags & RefFlag.LOCATION else released
                released = released and bool(message.flags & RefFlag.LOCATION)


@given(steps=st.lists(st.tuples(st.floats(0.0, 3.0), HEARD), max_size=20))
def test_whatever_was_heard_the_next_request_can_be_granted(steps: list[tuple[float, ImcMessage]]) -> None:
    talk = Talk()
    talk.dialect.request(talk.now_s)
    for pause_s, message in steps:
        talk.now_s += pause_s
        talk.hear(message)
        talk.sent()
    talk.dialect.release("done", talk.now_s)
    talk.sent()
    talk.dialect.request(talk.now_s)
    (start,) = [message for message in talk.sent_of(imc.PlanControl) if message.op == PlanOp.START]
    assert [type(event) for event in talk.hear(succeeded(start.request_id), follow_state())] == [Granted]


@given(chunks=st.lists(st.binary(max_size=80), max_size=8))
def test_any_bytes_are_refused_without_a_word(chunks: list[bytes]) -> None:
    talk = Talk()
    for chunk in chunks:
        assert talk.dialect.hear(chunk, stamp_at(talk.now_s)) == []


def test_a_grant_recorded_earlier_is_not_accepted() -> None:
    talk = Talk()
    talk.hear(estimated(41.18, -8.7))
    talk.dialect.request(talk.now_s)
    (start,) = talk.sent_of(imc.PlanControl)
    events = talk.hear(
        succeeded(start.request_id), follow_state(), age_s=86_400.0
    )  # of a run in which the number was the same
    assert [type(event) for event in events] == [Doubted, Doubted]
    assert "the vehicle's other messages" in events[0].reason  # type: ignore[union-attr]  # which is what it is
    assert talk.dialect.counters["imc.refused.stale"] == 2
    talk.dialect.command(GOAL, talk.now_s)
    assert talk.dialect.counters["imc.commands_unsaid"] == 1
    assert [type(event) for event in talk.hear(succeeded(start.request_id), follow_state())] == [Granted], (
        "the vehicle's own is"
    )


def test_an_answer_from_before_the_request_is_not_accepted() -> None:
    talk = Talk()
    talk.hear(estimated(41.18, -8.7))
    talk.dialect.request(talk.now_s)
    (start,) = talk.sent_of(imc.PlanControl)
    (event,) = talk.hear(succeeded(start.request_id), age_s=0.8)
    assert isinstance(event, Doubted)
    assert "before that of the request" in event.reason


def test_recorded_answers_do_not_keep_a_command_alive() -> None:
    talk = Talk()
    talk.take_over()
    talk.dialect.command(GOAL, talk.now_s)
    talk.sent()
    ended: list[VehicleEvent] = []
    for _ in range(200):
        talk.now_s += 0.1
        events = [*talk.hear(estimated(41.18, -8.7)), *talk.hear(follow_state(GOAL), age_s=500.0)]
        ended += [event for event in events if isinstance(event, Withheld)]
        talk.dialect.command(GOAL, talk.now_s)
        talk.sent()
        if ended:
            break
    assert ended == [Withheld("the vehicle does not answer our references")]


def test_what_ends_control_is_believed_however_old_it_is() -> None:
    talk = Talk()
    talk.take_over()
    assert talk.hear(imc.Abort(), age_s=500.0) == [Withheld(f"Abort from 0x{VEHICLE:04X}")]


@pytest.mark.parametrize("drawn", [0, 41, 0xFFFE])
def test_the_first_request_of_a_run_has_a_number_that_nobody_can_foresee(drawn: int) -> None:
    talker = talker_of("imc", KNOWS, lambda n: drawn if n == 0xFFFF else n)
    talker.connected(0.0)
    numbers = []
    for now_s in (0.0, 10.0):
        talker.request(now_s)
        framer = Framer(ImcGrammar())
        packets = [framed.message for item in talker.take_outgoing(now_s) for framed in framer.feed(item)]
        starts = [decode(packet.number, packet.payload) for packet in packets]
        numbers += [start.request_id for start in starts if isinstance(start, imc.PlanControl)]
        talker.release("done", now_s)
    assert numbers == [drawn + 1, (drawn + 1) % 0xFFFF + 1]
