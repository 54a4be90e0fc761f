"""An IMC vehicle that was aborted, stopped or left idle is started again only once it flies a plan of its own."""

from __future__ import annotations

import pytest

from drivers.vehicle import imc_messages as imc
from drivers.vehicle.decoders.imc_followed import PLAN_ID
from drivers.vehicle.dialect import Withheld
from drivers.vehicle.imc_messages import OpMode, PlanOp, PlanState, PlanType, RefState
from drivers.vehicle.imc_wire import ANYONE
from tests.drivers.vehicle.imc_talk import GOAL, OTHER, SURVEY, US, VEHICLE, Talk, follow_state

OURS = imc.PlanControlState(PlanState.EXECUTING, PLAN_ID)


def assert_not_asked(talk: Talk, why: str, *heard: imc.ImcMessage) -> None:
    """A request comes to nothing, and says why, while the vehicle reports this."""
    talk.dialect.request(talk.now_s)
    (event,) = talk.hear(*heard)
    assert isinstance(event, Withheld)
    assert why in event.reason
    assert talk.sent_of(imc.PlanControl, 3.0) == []


@pytest.mark.parametrize("to", [VEHICLE, ANYONE])
def test_after_an_abort_nothing_is_started_until_the_vehicle_flies_a_plan_of_its_own(to: int) -> None:
    talk = Talk()
    talk.hear(imc.Abort(), source=OTHER, to=to)
    assert talk.hear(SURVEY) == [], "of before"
    for _ in range(2):
        talk.now_s += 61.0
        idle = imc.PlanControlState(PlanState.READY), imc.VehicleState(OpMode.SERVICE)
        assert_not_asked(talk, "an Abort came", *idle)
    talk.hear(SURVEY)
    talk.take_over()


def test_a_plan_stopped_on_board_is_started_again_only_after_a_plan_of_the_vehicles_own() -> None:
    talk = Talk()
    talk.take_over()
    talk.hear(OURS)
    talk.now_s += 3.0
    stopped = imc.PlanControlState(PlanState.READY, PLAN_ID, last_outcome=2)
    assert [type(event) for event in talk.hear(imc.VehicleState(OpMode.SERVICE), stopped)] == [Withheld]
    talk.now_s += 61.0
    assert_not_asked(talk, "was stopped on board", stopped)
    talk.hear(SURVEY)
    talk.take_over()


@pytest.mark.parametrize(
    "stopped",
    [
        imc.PlanControlState(PlanState.READY, "survey", last_outcome=2),
        imc.PlanControlState(PlanState.READY, "survey"),  # older DUNE states no outcome of what was stopped
        imc.PlanControlState(PlanState.BLOCKED, "survey", last_outcome=1),  # of the plan before
        imc.PlanControlState(4, "survey", last_outcome=1),  # paused
    ],
)
def test_a_plan_of_the_vehicles_own_stopped_on_board_is_not_followed_by_the_payloads(
    stopped: imc.PlanControlState,
) -> None:
    talk = Talk()
    talk.hear(imc.VehicleState(OpMode.SERVICE), stopped)
    for _ in range(2):
        talk.now_s += 61.0
        assert_not_asked(talk, "was stopped on board", stopped)
    talk.hear(SURVEY)
    talk.take_over()


@pytest.mark.parametrize(("mode", "why"), [(OpMode.EXTERNAL, "external control"), (OpMode.BOOT, "flies no plan")])
def test_a_vehicle_that_idles_since_the_payloads_plan_is_not_started_once_it_was_steered_or_restarted(
    mode: OpMode, why: str
) -> None:
    done = imc.PlanControlState(PlanState.READY, PLAN_ID, last_outcome=1)
    talk = Talk()
    talk.take_over()
    talk.hear(OURS)
    talk.dialect.release("done", talk.now_s)
    talk.sent()
    talk.hear(done)
    talk.hear(imc.VehicleState(mode))
    talk.now_s += 61.0
    assert_not_asked(talk, why, imc.VehicleState(OpMode.SERVICE), done)
    talk.hear(SURVEY)
    talk.take_over()


def test_a_plan_of_the_vehicles_own_that_is_done_may_be_followed_by_the_payloads() -> None:
    talk = Talk()
    talk.hear(imc.PlanControlState(PlanState.READY, "survey", last_outcome=1))
    talk.take_over()


def test_a_vehicle_sent_on_another_plan_is_left_alone_until_it_flies_a_further_one() -> None:
    home = imc.PlanControlState(PlanState.EXECUTING, "home")
    talk = Talk()
    talk.take_over()
    talk.hear(OURS)
    talk.now_s += 3.0
    assert [type(event) for event in talk.hear(home)] == [Withheld]
    for state in (home, imc.PlanControlState(PlanState.READY, "home", last_outcome=1)):
        talk.now_s += 61.0
        assert_not_asked(talk, "was sent on plan home instead", state)
    talk.hear(SURVEY)
    talk.take_over()
    talk.hear(OURS)
    talk.now_s += 3.0
    assert [type(event) for event in talk.hear(SURVEY)] == [Withheld], "but it goes on with the plan of before"
    talk.now_s += 61.0
    talk.take_over()


@pytest.mark.parametrize("how", ["released", "too late"])
def test_a_plan_that_the_payload_ended_may_be_followed_by_another(how: str) -> None:
    talk = Talk()
    talk.take_over()
    talk.hear(OURS)
    if how == "released":
        talk.dialect.release("done", talk.now_s)
        talk.sent()
    else:
        talk.hear(follow_state(state=RefState.TIMEOUT))
    talk.now_s += 3.0
    talk.hear(imc.PlanControlState(PlanState.READY, PLAN_ID, last_outcome=2), imc.VehicleState(OpMode.SERVICE))
    talk.take_over()


def test_a_vehicle_that_has_flown_no_plan_yet_is_not_started() -> None:
    idle = imc.PlanControlState(PlanState.READY)
    talk = Talk(plans=idle)
    assert_not_asked(talk, "flies no plan", idle)
    talk.hear(OURS)  # of an earlier run of the payload
    talk.sent()  # which stops it
    talk.now_s += 61.0
    talk.hear(imc.PlanControlState(PlanState.READY, PLAN_ID, last_outcome=2))
    talk.take_over()


def test_an_abort_of_another_vehicle_leaves_ours_to_be_asked() -> None:
    talk = Talk()
    talk.hear(imc.Abort(), source=US + 1, to=OTHER)
    talk.now_s += 61.0
    talk.take_over()


def test_a_report_of_a_plan_that_is_late_or_recorded_does_not_end_what_an_abort_began() -> None:
    talk = Talk()
    talk.hear(imc.Abort(), source=OTHER)
    for age_s in (5.0, 500.0):
        talk.now_s += 61.0
        talk.hear(imc.PlanControlState(PlanState.READY))
        talk.hear(SURVEY, age_s=age_s)
        assert_not_asked(talk, "an Abort came")


@pytest.mark.parametrize("lost", ["wire", "messages"])
def test_after_a_gap_nothing_is_started_until_the_vehicle_says_what_it_flies_now(lost: str) -> None:
    talk = Talk()
    if lost == "wire":
        talk.dialect.disconnected()
        talk.dialect.connected(talk.now_s)
    talk.now_s += 0.5 if lost == "wire" else 6.0
    talk.hear(imc.Announce("auv", 2))
    talk.dialect.request(talk.now_s)
    assert talk.sent_of(imc.PlanControl, 1.0) == [], "a person may have stopped it meanwhile"
    talk.hear(SURVEY)
    assert len(talk.sent_of(imc.PlanControl)) == 1


def test_a_vehicle_that_does_not_report_its_plans_is_not_started_and_the_request_says_so() -> None:
    talk = Talk()
    talk.now_s += 6.0
    talk.dialect.request(talk.now_s)
    assert talk.sent_of(imc.PlanControl, 3.5) == []
    (event,) = talk.hear(imc.Announce("auv", 2))
    assert isinstance(event, Withheld)
    assert "PlanControlState" in event.reason


def test_a_vehicle_that_follows_another_payload_is_not_started_until_that_one_is_done() -> None:
    talk = Talk()
    theirs = imc.PlanControlState(PlanState.EXECUTING, "theirs"), follow_state(of=OTHER)
    talk.hear(*theirs)
    assert_not_asked(talk, f"follows 0x{OTHER:04X}", *theirs)
    talk.now_s += 1.0
    talk.take_over()


def test_a_vehicle_that_another_payload_takes_while_it_is_asked_is_left_to_it() -> None:
    talk = Talk()
    talk.ask()
    (event,) = talk.hear(imc.PlanControl(PlanType.SUCCESS, PlanOp.START, 1, PLAN_ID), follow_state(of=OTHER))
    assert isinstance(event, Withheld)
    talk.dialect.command(GOAL, talk.now_s)
    assert talk.sent_of(imc.Reference, 1.0) == []
