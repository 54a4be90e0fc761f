"""What an IMC vehicle reports of itself, and what is reported to it."""

from __future__ import annotations

import math

import pytest

from drivers.vehicle import imc_messages as imc
from drivers.vehicle.decoders.imc_followed import FollowedVehicle
from drivers.vehicle.dialect import (
    Acknowledged,
    Capability,
    Doubted,
    PayloadHealth,
    PlaceReached,
    Rejected,
    ReportedState,
    Steer,
    VehicleEvent,
    Withheld,
)
from drivers.vehicle.imc_contact import imc_contact_of
from drivers.vehicle.imc_messages import EntityStatus, ImcMessage, Proximity, RefState, ZUnits
from drivers.vehicle.imc_wire import ANYONE, packed
from tests.drivers.vehicle.imc_talk import GOAL, LEARNS, OTHER, UTC_S, VEHICLE, Talk, estimated, follow_state, stamp_at
from tests.make.records import report_of
from tests.sim_replay.conversation import Conversation


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
    assert talk.sent_of(imc.PlanControl, 1.0) == [], "nobody knows yet whom to ask"
    talk.hear(imc.Announce("console", 0), source=OTHER)
    talk.hear(first)
    talk.now_s += 1.0
    assert {packet.destination for packet in talk.packets()} == {VEHICLE}
    (doubted, refused) = talk.hear(imc.Announce("another", 2), estimated(42.0, -8.0), source=OTHER)
    assert isinstance(doubted, Doubted)
    assert isinstance(refused, Withheld)
    assert "0x001E (30) and 0x002F (47)" in doubted.reason
    talk.now_s += 1.0
    assert {packet.destination for packet in talk.packets()} == {VEHICLE}
    talk.dialect.connected(talk.now_s)
    assert {packet.destination for packet in talk.packets()} == {ANYONE}


def test_a_doubt_names_a_few_vehicles_however_many_announce_themselves() -> None:
    followed = FollowedVehicle(0)
    for source in range(1, 5000):
        followed.hear(source, imc.Announce("any", 2), 0.0)
    assert not followed.may_be_asked(0.0)
    assert len(followed.doubt) < 300


def positions(talk: Talk, *latitudes_deg: tuple[int, float]) -> list[float]:
    """Those that are believed, of positions reported by their sources."""
    events = [event for source, at in latitudes_deg for event in talk.hear(estimated(at, -8.5), source=source)]
    return [round(event.latitude_deg, 6) for event in events if isinstance(event, ReportedState)]


def test_another_vehicle_that_was_heard_first_does_not_take_the_place_of_ours_for_ever() -> None:
    talk = Talk(LEARNS)
    assert positions(talk, (OTHER, 42.0), (VEHICLE, 41.0)) == [42.0]
    for _ in range(59):
        talk.now_s += 1.0
        assert positions(talk, (VEHICLE, 41.0)) == []
    talk.now_s += 2.0
    assert positions(talk, (VEHICLE, 41.0), (OTHER, 42.0)) == [41.0]
    (message,) = talk.dialect.decoder.feed(packed(estimated(41.0, -8.5), VEHICLE), stamp_at(talk.now_s))
    assert (message.of_vehicle, len(message.fixes)) == (True, 1)
    assert {packet.destination for packet in talk.packets()} == {VEHICLE}


def test_of_several_vehicles_none_is_asked_for_control_before_one_is_named() -> None:
    talk = Talk(LEARNS)
    positions(talk, (OTHER, 42.0), (VEHICLE, 41.0))
    talk.dialect.connected(talk.now_s)
    positions(talk, (VEHICLE, 41.0))
    talk.dialect.request(talk.now_s)
    assert talk.sent_of(imc.PlanControl, 3.0) == []
    (refused,) = talk.hear(imc.Heartbeat())
    assert isinstance(refused, Withheld)
    assert "Set vehicle_id" in refused.reason
    named = Talk()
    positions(named, (OTHER, 42.0), (VEHICLE, 41.0))
    named.take_over()


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
    talk.dialect.report(report_of(number=4, revision=2), 11, talk.now_s)
    assert {message.revision for message in talk.sent_of(imc.MineContact, 60.0)} == {2}, "the one before is superseded"
    assert talk.hear(imc.MineContactTaken(77, 4, 2, 0, "too far")) == [Rejected(11, "too far")]
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
