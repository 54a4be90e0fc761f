"""The fake IMC vehicle does what DUNE does, and gets on with the driver."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NavSample
from auv_mcm.settings.vehicle_settings import ImcSettings
from drivers.framing import Framer
from drivers.vehicle import imc_messages as imc
from drivers.vehicle.dialect import Acknowledged, GoTo, PayloadHealth, Vertical
from drivers.vehicle.imc_codec import LAYOUTS, decode
from drivers.vehicle.imc_contact import imc_contact_of
from drivers.vehicle.imc_messages import ImcMessage, OpMode, PlanOp, PlanState, PlanType, Proximity, RefFlag, RefState
from drivers.vehicle.imc_wire import ImcGrammar, packed
from sim_replay.fakes.vehicles.imc import ADDRESS, PLACE_RADIUS_M, PLAN_ID, FakeImc
from tests.drivers.vehicle.vehicle_loop import Loop
from tests.make.records import nav_of, report_of
from tests.sim_replay.conversation import Conversation

US, OTHER = 0x6000, 0x2F
UTC_S = 1_700_000_000.0
FRAME = LocalFrame(latitude_deg=41.185, longitude_deg=-8.706)


def pose_at(east_m: float, north_m: float, now_s: float) -> NavSample:
    latitude_deg, longitude_deg, _ = (float(value) for value in FRAME.to_geodetic((east_m, north_m, 0.0)))
    place = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "depth_m": 15.0}
    return nav_of(UTC_S + now_s, **place, heading_rad=1.0, pitch_rad=0.01, roll_rad=-0.02)


def test_a_plan_left_from_an_earlier_run_is_stopped() -> None:
    loop = Loop("imc")
    loop.dialect.request(loop.now_s)
    loop.run(1.0)
    loop.dialect = Conversation(ImcSettings())
    loop.dialect.connected(loop.now_s)
    loop.run(2.0)
    assert not loop.vehicle.in_control
    assert loop.vehicle.counters["vehicle.commands_expired"] == 0


def test_contacts_and_health_arrive_once() -> None:
    loop = Loop("imc")
    loop.dialect.report_health(PayloadHealth("fault", "port bow is silent"), loop.now_s)
    loop.dialect.report(report_of(), 4, loop.now_s)
    assert loop.run(1.0).of(Acknowledged) == [Acknowledged(4)]
    assert loop.vehicle.take_health() == ["fault: port bow is silent"]
    (report,) = loop.vehicle.take_reports()
    assert (report.session, report.number, report.revision, report.classification) == (77, 3, 1, "sphere")
    assert report.belief["sphere"] == 0.75
    loop.dialect.report(report_of(), 5, loop.now_s)
    loop.run(1.0)
    loop.dialect.report(report_of(revision=2), 6, loop.now_s)
    assert loop.run(1.0).of(Acknowledged)[1:] == [Acknowledged(5), Acknowledged(6)]
    assert [report.revision for report in loop.vehicle.take_reports()] == [2]
    counters = loop.vehicle.counters
    assert (counters["vehicle.reports"], counters["vehicle.reports_repeated"], counters["vehicle.targets"]) == (2, 1, 3)


class Wire:
    """Send messages to the fake alone, and return its answers."""

    def __init__(self) -> None:
        self.fake = FakeImc()
        self.fake.connected(0.0)
        self.tick(0.0)

    def tick(self, now_s: float) -> list[ImcMessage]:
        return _messages(b"".join(self.fake.tick(pose_at(0.0, 0.0, now_s), False, now_s)))

    def exchange(self, *messages: ImcMessage, source: int = US, now_s: float = 1.0) -> list[ImcMessage]:
        return _messages(
            b"".join(self.fake.heard(b"".join(packed(message, source, to=ADDRESS) for message in messages), now_s))
        )

    def start(self, timeout_s: float = 5.0) -> list[ImcMessage]:
        maneuver = imc.PlanManeuver("m", imc.FollowReference(US, 255, timeout_s))
        plan = imc.PlanSpecification("theirs", start_man_id="m", maneuvers=(maneuver,))
        return self.exchange(imc.PlanControl(PlanType.REQUEST, PlanOp.START, 3, "theirs", arg=plan))


def _messages(data: bytes) -> list[ImcMessage]:
    packets = [framed.message for framed in Framer(ImcGrammar()).feed(data)]
    return [decode(packet.number, packet.payload) for packet in packets if packet.number in LAYOUTS]


def a_reference(flags: int = 7, **changes: Any) -> imc.Reference:
    values: dict[str, Any] = {"speed": imc.DesiredSpeed(1.5), "z": imc.DesiredZ(3.0, 1), "lat": 0.7188, "lon": -0.152}
    return imc.Reference(flags, **(values | changes))


def test_it_answers_a_start_as_a_plan_engine_does() -> None:
    loaded, running, plan, follow = Wire().start()
    for reply in (loaded, running):
        assert isinstance(reply, imc.PlanControl)
        assert (reply.type, reply.op, reply.request_id, reply.plan_id) == (PlanType.SUCCESS, PlanOp.START, 3, "theirs")
    assert isinstance(plan, imc.PlanControlState)
    assert (plan.state, plan.plan_id, plan.man_type) == (PlanState.EXECUTING, "theirs", 478)
    assert follow == imc.FollowRefState(US, 255, None, RefState.WAIT, Proximity.FAR)


def test_references_of_others_are_ignored_without_a_word() -> None:
    wire = Wire()
    assert wire.exchange(a_reference()) == []
    wire.start()
    assert wire.exchange(a_reference(), source=OTHER) == []
    assert wire.fake.command is None
    (answer,) = wire.exchange(a_reference())
    assert isinstance(answer, imc.FollowRefState)
    assert answer.reference == a_reference()
    assert wire.fake.command == GoTo(
        math.degrees(0.7188), math.degrees(-0.152), Vertical("depth", 3.0), 1.5, PLACE_RADIUS_M
    )
    assert wire.exchange(imc.Reference(RefFlag.MANDONE), source=OTHER) == []
    assert wire.fake.in_control
    assert wire.fake.counters["vehicle.commands_refused"] == 3


def test_fields_missing_from_a_reference_stay_as_they_were() -> None:
    wire = Wire()
    wire.start()
    wire.exchange(a_reference())
    wire.exchange(imc.Reference(RefFlag.SPEED, imc.DesiredSpeed(2.0)))
    assert wire.fake.command == GoTo(
        math.degrees(0.7188), math.degrees(-0.152), Vertical("depth", 3.0), 2.0, PLACE_RADIUS_M
    )


@pytest.mark.parametrize(
    "reference",
    [
        imc.Reference(RefFlag.SPEED, imc.DesiredSpeed(2.0)),
        a_reference(lat=math.nan),
        a_reference(lat=2.0),
        a_reference(speed=imc.DesiredSpeed(50.0, 2)),
        a_reference(speed=imc.DesiredSpeed(-1.0)),
        a_reference(z=imc.DesiredZ(math.inf, 1)),
        a_reference(z=imc.DesiredZ(3.0, 3)),
        a_reference(flags=RefFlag.LOCATION | RefFlag.SPEED),
    ],
)
def test_what_cannot_be_flown_is_refused(reference: imc.Reference) -> None:
    wire = Wire()
    wire.start()
    assert wire.exchange(reference) == []
    assert wire.fake.command is None
    assert wire.fake.counters["vehicle.commands_refused"] == 1


def test_the_time_out_is_reported_and_ends_the_plan() -> None:
    wire = Wire()
    wire.start(timeout_s=4.0)
    wire.exchange(a_reference(), now_s=2.0)
    assert not any(isinstance(message, imc.FollowRefState) for message in wire.tick(5.9))
    reported = wire.tick(6.1)
    (state,) = [message for message in reported if isinstance(message, imc.FollowRefState)]
    assert state.state == RefState.TIMEOUT
    assert [message.plan_id for message in reported if isinstance(message, imc.PlanControlState)] == [PLAN_ID]
    assert not any(isinstance(message, imc.FollowRefState) for message in wire.tick(9.0))


def test_a_stop_while_its_own_plan_runs_is_refused_and_counted() -> None:
    wire = Wire()
    (reply,) = wire.exchange(imc.PlanControl(PlanType.REQUEST, PlanOp.STOP, 5, "theirs"))
    assert isinstance(reply, imc.PlanControl)
    assert reply.type == PlanType.FAILURE
    assert wire.fake.counters["vehicle.commands_refused"] == 1


def test_it_boots() -> None:
    fake = FakeImc()
    fake.power_up(0.0)
    reported = _messages(b"".join(fake.tick(pose_at(0.0, 0.0, 0.0), False, 0.0)))
    assert [message.op_mode for message in reported if isinstance(message, imc.VehicleState)] == [OpMode.BOOT]
    reported = _messages(b"".join(fake.tick(pose_at(0.0, 0.0, 1.0), False, 1.0)))
    assert [message.op_mode for message in reported if isinstance(message, imc.VehicleState)] == [OpMode.MANEUVER]


def test_nonsense_is_counted() -> None:
    wire = Wire()
    contact = imc_contact_of(report_of())
    bad_class = imc.MineContact(
        *(getattr(contact, name) if name != "classification" else 9 for name in contact.__struct_fields__)
    )
    (answer,) = wire.exchange(bad_class)
    assert isinstance(answer, imc.MineContactTaken)
    assert not answer.taken
    assert wire.exchange(imc.EntityState(77)) == []
    flipped = bytearray(packed(a_reference(), US))
    flipped[30] ^= 1
    wire.fake.heard(bytes(flipped), 1.0)
    assert wire.fake.counters["vehicle.nonsense"] == 3
    wire.fake.power_up(2.0)
    assert wire.fake.counters["vehicle.nonsense"] == 3


@given(
    chunks=st.lists(
        st.binary(max_size=80) | st.sampled_from([packed(a_reference(lat=math.nan), US), packed(imc.Abort(), OTHER)]),
        max_size=6,
    )
)
def test_whatever_it_hears_it_never_raises_and_obeys_none_of_it(chunks: list[bytes]) -> None:
    wire = Wire()
    for chunk in chunks:
        wire.fake.heard(chunk, 1.0)
    assert wire.fake.command is None
    assert wire.tick(2.0)


def states_of(messages: list[ImcMessage]) -> list[tuple[int, str, int]]:
    return [
        (each.state, each.plan_id, each.last_outcome) for each in messages if isinstance(each, imc.PlanControlState)
    ]


@pytest.mark.parametrize("how", ["abort of a person", "abort heard", "stop on board"])
def test_after_a_stop_it_idles_until_a_person_starts_its_plan(how: str) -> None:
    wire = Wire()
    wire.start()
    wire.exchange(a_reference())
    if how == "abort heard":
        wire.exchange(imc.Abort(), source=OTHER)
    else:
        (wire.fake.abort if how == "abort of a person" else wire.fake.stop_plan)(1.0)
    reported = wire.tick(2.0)
    assert (imc.Abort() in reported) is (how == "abort of a person")
    assert wire.fake.is_idle
    assert not wire.fake.in_control
    for now_s in (3.0, 60.0):
        assert states_of(wire.tick(now_s)) == [(PlanState.READY, "theirs", 2)]
    wire.fake.start_plan(61.0)
    assert not wire.fake.is_idle
    assert set(states_of(wire.tick(62.0))) == {(PlanState.EXECUTING, PLAN_ID, 0)}


def test_while_it_idles_it_obeys_whoever_starts_a_plan_and_idles_again_afterwards() -> None:
    wire = Wire()
    wire.fake.stop_plan(1.0)
    wire.start()
    assert wire.fake.in_control
    wire.exchange(imc.Reference(RefFlag.MANDONE))
    assert wire.fake.is_idle
    assert states_of(wire.tick(5.0))[-1][0] == PlanState.READY
