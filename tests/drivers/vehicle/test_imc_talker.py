"""Control of an IMC vehicle: how it is requested, granted, kept and lost."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.records import NAN
from auv_mcm.settings.vehicle_settings import ImcSettings
from drivers.vehicle import imc_messages as imc
from drivers.vehicle.decoders.imc_followed import PLAN_ID
from drivers.vehicle.dialect import Considered, Doubted, Granted, PlaceReached, Steer, VehicleEvent, Withheld
from drivers.vehicle.imc_codec import decode
from drivers.vehicle.imc_messages import (
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
from drivers.vehicle.imc_wire import ImcPacket, packed, to_wire
from drivers.vehicle.pilot import Pilot
from drivers.vehicle.vehicles import decoder_of, talker_of
from tests.drivers.vehicle.imc_talk import (
    GOAL,
    INVITED,
    KNOWS,
    LEARNS,
    OTHER,
    SURVEY,
    US,
    UTC_S,
    VEHICLE,
    Talk,
    estimated,
    follow_state,
    stamp_at,
    succeeded,
)
from tests.drivers.vehicle.test_pilot import HOME_DEG, TWO_LEGS, settings
from tests.make.records import report_of


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
    both = (succeeded(talk.ask()), follow_state())
    events = talk.hear(*(both if first == "answer" else both[::-1]))
    assert [type(event) for event in events] == [Granted]


@pytest.mark.parametrize(
    "messages",
    [
        [follow_state()],
        [succeeded(1)],
        [succeeded(2), follow_state()],
        [succeeded(1), follow_state(state=RefState.TIMEOUT)],
        [imc.PlanControl(PlanType.SUCCESS, PlanOp.STOP, 1, PLAN_ID), follow_state()],
        [imc.PlanControl(PlanType.SUCCESS, PlanOp.START, 1, "survey"), follow_state()],
        [imc.PlanControl(PlanType.IN_PROGRESS, PlanOp.START, 1, PLAN_ID), follow_state()],
    ],
)
def test_less_is_no_grant(messages: list[ImcMessage]) -> None:
    talk = Talk()
    assert talk.ask() == 1
    assert Granted not in map(type, talk.hear(*messages))
    talk.dialect.command(GOAL, talk.now_s)
    assert talk.sent_of(imc.Reference, 1.0) == []
    assert talk.dialect.counters["imc.commands_unsaid"] == 1


def test_answers_of_others_and_to_others_do_not_count() -> None:
    talk = Talk()
    talk.ask()
    assert talk.hear(succeeded(1), follow_state(), source=OTHER) == []
    assert talk.hear(succeeded(1), follow_state(), source=US) == []
    assert talk.dialect.counters["imc.other_source"] == 4
    assert talk.hear(succeeded(1), follow_state(), to=OTHER) == []
    assert [type(event) for event in talk.hear(succeeded(1), to=US)] == [Granted]


def test_the_answer_of_dune_with_the_statistics_of_the_plan_counts() -> None:
    talk = Talk()
    request_id = talk.ask()
    name, info = b"\7\0auv_mcm", b"\x0b\0plan loaded"
    statistics = b"\x34\2" + name + b"\0\4" + b"\x09\0Total=120" + 3 * b"\0\0"  # message 564
    payload = b"\1\0" + request_id.to_bytes(2, "little") + name + b"\0\0" + statistics + info
    packet = ImcPacket(559, payload, VEHICLE, destination=US, time_s=UTC_S + 3600.0 + talk.now_s)
    assert talk.dialect.hear(to_wire(packet), stamp_at(talk.now_s)) == []
    assert [type(event) for event in talk.hear(follow_state())] == [Granted]


def test_a_request_is_sent_again_but_not_for_ever() -> None:
    talk = Talk()
    talk.dialect.request(talk.now_s)
    starts = []
    for _ in range(20):
        talk.hear(talk.plans)
        starts += talk.sent_of(imc.PlanControl, 1.0)
    assert len(starts) == 3
    assert {start.request_id for start in starts} == {1}


def test_a_vehicle_that_calibrates_first_is_waited_for() -> None:
    talk = Talk()
    talk.ask()
    assert talk.hear(imc.PlanControl(PlanType.IN_PROGRESS, PlanOp.START, 1, PLAN_ID)) == [Considered()]
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
    talk.ask()
    talk.dialect.release("plan withdrawn", talk.now_s)
    assert talk.sent_of(imc.PlanControl, 5.0) == [], (
        "the vehicle may never have heard of it, and STOP would stop its own"
    )
    assert talk.hear(succeeded(1), follow_state(), talk.plans) == []
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


def test_an_invitation_that_is_waited_for_is_no_request_without_an_answer() -> None:
    pilot = Pilot(talker_of("imc", INVITED, lambda _: 0), settings(), session=7)
    decoder = decoder_of("imc", INVITED, "vehicle")
    pilot.connected(0.0)
    pilot.propose(TWO_LEGS, 0.0)
    for now_s in range(1, 120):
        state = estimated(*HOME_DEG, depth=20.0, alt=8.0 + 0.01 * (now_s % 2))
        said = b"".join(packed(message, VEHICLE, time_s=UTC_S + now_s) for message in (state, SURVEY))
        pilot.hear(decoder.feed(said, stamp_at(now_s)), stamp_at(now_s))
        pilot.take_outgoing(now_s)
    assert pilot.counters["vehicle.requested"] > 6
    assert pilot.take_notices() == []


def test_an_invitation_that_is_over_is_none() -> None:
    talk = Talk(INVITED)
    talk.hear(follow_state())
    talk.now_s += 5.0
    talk.hear(imc.VehicleState(OpMode.MANEUVER, maneuver_type=450))
    talk.dialect.request(talk.now_s)
    assert talk.hear(imc.Heartbeat()) == []


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
    talk.now_s += 3.5  # after which it follows nobody else
    for plan in ("further", "survey"):  # which an Abort, or a plan that it was sent on, may have to wait for
        talk.hear(imc.PlanControlState(PlanState.EXECUTING, plan))
    talk.sent()
    assert [type(event) for event in talk.hear(succeeded(talk.ask()), follow_state())] == [Granted]


@given(chunks=st.lists(st.binary(max_size=80), max_size=8))
def test_any_bytes_are_refused_without_a_word(chunks: list[bytes]) -> None:
    talk = Talk()
    for chunk in chunks:
        assert talk.dialect.hear(chunk, stamp_at(talk.now_s)) == []


def test_a_grant_recorded_earlier_is_not_accepted() -> None:
    talk = Talk()
    talk.hear(estimated(41.18, -8.7))
    answers = succeeded(talk.ask()), follow_state()
    events = talk.hear(*answers, age_s=86_400.0)  # of a run in which the number was the same
    assert [type(event) for event in events] == [Doubted, Doubted]
    assert "the vehicle's other messages" in events[0].reason  # type: ignore[union-attr]  # which is what it is
    assert talk.dialect.counters["imc.refused.stale"] == 2
    talk.dialect.command(GOAL, talk.now_s)
    assert talk.dialect.counters["imc.commands_unsaid"] == 1
    assert [type(event) for event in talk.hear(*answers)] == [Granted], "the vehicle's own is"


def test_an_answer_from_before_the_request_is_not_accepted() -> None:
    talk = Talk()
    talk.hear(estimated(41.18, -8.7))
    (event,) = talk.hear(succeeded(talk.ask()), age_s=0.8)
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
    talk = Talk()
    talk.dialect.talker = talker_of("imc", KNOWS, lambda n: drawn if n == 0xFFFF else n)
    talk.dialect.connected(talk.now_s)
    talk.hear(talk.plans)
    numbers = []
    for _ in range(2):
        numbers.append(talk.ask())
        talk.dialect.release("done", talk.now_s)
    assert numbers == [drawn + 1, (drawn + 1) % 0xFFFF + 1]
