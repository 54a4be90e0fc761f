"""Check that the payload commands only while granted, inside the bounds, and releases control on every way out."""

from __future__ import annotations

import logging
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from auv_mcm.records import Contact, Waypoint
from auv_mcm.settings.vehicle_settings import (
    BluefinSettings,
    CanSettings,
    ImcSettings,
    IverSettings,
    ReconSettings,
    VehicleConfig,
)
from drivers.links.can_frame import CanFrame
from drivers.navigation import n2k_messages as n2k
from drivers.navigation.corrections import moved, offset_m
from drivers.vehicle import imc_messages as imc
from drivers.vehicle.dialect import (
    Acknowledged,
    Capability,
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
from drivers.vehicle.imc_wire import packed
from drivers.vehicle.pilot import Pilot
from drivers.vehicle.vehicles import decoder_of, talker_of
from tests.drivers.vehicle.test_report_queue import contact as queued_contact
from tests.drivers.vehicle.vehicle_on_paper import GOES_BY_ITSELF, IS_STEERED, PaperTalker, calls, stamp
from tests.make.records import waypoint_of

HOME_DEG = (54.0, 8.0)
FENCE_DEG = tuple(
    moved(*HOME_DEG, *corner) for corner in ((-200.0, -200.0), (200.0, -200.0), (200.0, 200.0), (-200.0, 200.0))
)
Metres = tuple[float, float]


def settings(**changes: Any) -> VehicleConfig:
    return VehicleConfig(**{"command": True, "fence_deg": FENCE_DEG, "ask_again_s": 20.0, **changes})


def waypoint(leg: int, kind: str, place_m: Metres) -> Waypoint:
    return waypoint_of(kind, *moved(*HOME_DEG, *place_m), leg)


def plan(*legs: tuple[Metres, Metres], start_m: Metres = (0.0, 0.0)) -> tuple[Waypoint, ...]:
    points = [waypoint(1, "start", start_m)]
    for number, (entry, way_out) in enumerate(legs, start=1):
        points += [waypoint(number, "leg_entry", entry), waypoint(number, "leg_exit", way_out)]
    return tuple(points)


TWO_LEGS = plan(((0.0, 40.0), (0.0, 90.0)), ((60.0, 90.0), (60.0, 40.0)))


def contact(number: int, p_mine: float = 0.9) -> Contact:
    return queued_contact(number, p_mine, time_s=1.7e9, covariance_m2=np.eye(2))


class Sea:
    """Run a pilot, a vehicle and the time. The vehicle reports its state ten times a second, grants requests, and
    obeys."""

    def __init__(self, capabilities: Capability = GOES_BY_ITSELF, **changes: Any) -> None:
        self.dialect = PaperTalker(capabilities)
        self.pilot = Pilot(self.dialect, settings(**changes), session=7)
        self.now_s = 100.0
        self.place_m: Metres = (0.0, 0.0)
        self.heading_rad = 0.0
        self.reported: dict[str, float] = {"depth_m": 20.0, "altitude_m": 8.0}
        self.talks = self.answers = True
        self.pilot.connected(self.now_s)

    def hear(self, *events: VehicleEvent) -> None:
        self.pilot.hear([calls(self.now_s, *events)], stamp(self.now_s))

    def state(self) -> ReportedState:
        state = ReportedState(
            stamp(self.now_s), *moved(*HOME_DEG, *self.place_m), heading_rad=self.heading_rad
        )._replace(
            **self.reported  # type: ignore[arg-type]  # settings of one test each
        )
        return state._replace(altitude_m=state.altitude_m + 0.01 * (round(10.0 * self.now_s) % 2))  # it has noise

    def tick(self, seconds: float = 0.1) -> None:
        for _ in range(max(1, round(seconds / 0.1))):
            self.now_s += 0.1
            self._move()
            n_calls = len(self.dialect.calls)
            if self.talks:
                self.hear(self.state())
            self.pilot.take_outgoing(self.now_s)
            if self.answers and "request" in self.dialect.calls[n_calls:]:
                self.hear(Granted("as you like"))

    def until(self, authority: str, within_s: float = 40.0) -> None:
        end_s = self.now_s + within_s
        while self.pilot.authority != authority:
            self.tick()
            assert self.now_s < end_s, f"not {authority} within {within_s} s but {self.pilot.health()}"

    def _move(self) -> None:
        if self.pilot.authority != "granted" or not self.dialect.commands:
            return
        command = self.dialect.commands[-1][1]
        if isinstance(command, GoTo):
            east_m, north_m = offset_m(moved(*HOME_DEG, *self.place_m), (command.latitude_deg, command.longitude_deg))
            self.heading_rad = math.atan2(east_m, north_m) % (2.0 * math.pi)
        else:
            self.heading_rad += min(
                max(math.remainder(command.heading_rad - self.heading_rad, 2.0 * math.pi), -0.03), 0.03
            )
            self.heading_rad %= 2.0 * math.pi
        step_m = 0.1 * command.speed_mps
        self.place_m = (
            self.place_m[0] + step_m * math.sin(self.heading_rad),
            self.place_m[1] + step_m * math.cos(self.heading_rad),
        )

    def released(self) -> list[str]:
        return [line.removeprefix("release ") for line in self.dialect.calls if line.startswith("release")]

    def codes(self) -> list[str]:
        return [notice.code for notice in self.pilot.take_notices()]


def commanding(for_s: float = 0.0) -> Sea:
    """A payload that has had control of two legs for so long."""
    sea = Sea()
    sea.pilot.propose(TWO_LEGS, sea.now_s)
    sea.until("granted")
    if for_s:
        sea.tick(for_s)
    return sea


@pytest.mark.parametrize("capabilities", [GOES_BY_ITSELF, IS_STEERED])
def test_a_plan_is_flown_and_control_returned(capabilities: Capability) -> None:
    sea = Sea(capabilities)
    sea.tick(1.0)
    assert sea.pilot.authority == "listening"
    sea.pilot.propose(TWO_LEGS, sea.now_s)
    track: list[Metres] = []
    for _ in range(3000):
        sea.tick()
        track.append(sea.place_m)
    assert sea.pilot.authority == "listening"
    assert sea.released() == ["the plan is complete"]
    for point in TWO_LEGS[1:]:
        place_m = offset_m(HOME_DEG, (point.latitude_deg, point.longitude_deg))
        assert min(math.dist(place_m, place) for place in track) < 4.0
    kind = GoTo if capabilities == GOES_BY_ITSELF else Steer
    assert all(isinstance(command, kind) for _, command in sea.dialect.commands)
    assert {command.vertical for _, command in sea.dialect.commands} == {Vertical("altitude", 5.0)}
    assert sea.pilot.counters["vehicle.plans_flown"] == 1
    remarks = [(notice.code, notice.for_the_record) for notice in sea.pilot.take_notices()]
    assert remarks == [("vehicle_control_granted", True), ("vehicle_control_returned", True)]


def test_commands_are_repeated_in_time_and_changed_at_once() -> None:
    sea = Sea()
    sea.pilot.propose(TWO_LEGS, sea.now_s)
    sea.tick(60.0)
    times = [time_s for time_s, _ in sea.dialect.commands]
    gaps = [b - a for a, b in pairwise(times)]
    assert max(gaps) <= sea.dialect.command_period_s + 0.11
    targets = [command for _, command in sea.dialect.commands]
    assert len({(target.latitude_deg, target.longitude_deg) for target in targets if isinstance(target, GoTo)}) >= 2


def test_nothing_is_asked_for_without_a_plan_or_without_leave_to_command() -> None:
    sea = Sea()
    sea.tick(30.0)
    assert "request" not in sea.dialect.calls
    mute = Sea(command=False)
    mute.pilot.propose(TWO_LEGS, mute.now_s)
    mute.tick(30.0)
    assert "request" not in mute.dialect.calls
    passive = Sea(Capability.NAVIGATION | Capability.CONTACT)
    passive.pilot.propose(TWO_LEGS, passive.now_s)
    passive.tick(30.0)
    assert "request" not in passive.dialect.calls


def test_a_vehicle_that_answers_no_request_is_not_commanded_and_a_person_is_asked_once() -> None:
    sea = Sea()
    sea.answers = False
    sea.pilot.propose(TWO_LEGS, sea.now_s)
    sea.tick(60.0)
    assert sea.codes() == []
    sea.tick(240.0)
    assert sea.dialect.calls.count("request") > 20
    assert sea.dialect.commands == []
    (notice,) = sea.pilot.take_notices()
    assert (notice.code, notice.for_the_record) == ("vehicle_control_unanswered", False)
    sea.answers = True
    sea.until("granted")
    sea.tick(1.0)
    assert sea.codes() == ["vehicle_control_granted"]
    sea.hear(Withheld("operator"))
    sea.answers = False
    sea.tick(100.0)
    assert sea.codes() == ["vehicle_control_withheld", "vehicle_control_unanswered"]


def test_the_vehicle_takes_control_back_and_the_broken_leg_is_flown_again_later() -> None:
    sea = commanding(45.0)  # on the first leg
    assert "leg=1/2" in sea.pilot.health()
    sea.hear(Withheld("operator"))
    assert sea.pilot.authority == "revoked"
    n_commands = len(sea.dialect.commands)
    sea.tick(15.0)
    assert len(sea.dialect.commands) == n_commands
    assert sea.released() == []  # there is nothing to give back
    assert "revoked (operator)" in sea.pilot.health()
    sea.until("granted")
    sea.tick(0.2)
    command = sea.dialect.commands[n_commands][1]
    assert isinstance(command, GoTo)
    assert (command.latitude_deg, command.longitude_deg) == (TWO_LEGS[1].latitude_deg, TWO_LEGS[1].longitude_deg)


def test_control_is_returned_when_the_position_is_lost() -> None:
    sea = commanding(1.0)
    sea.talks = False
    for _ in range(32):
        sea.hear(Acknowledged(1))  # it still speaks
        sea.tick()
    assert sea.pilot.authority == "listening"
    assert sea.released() == ["the vehicle's position is not known"]
    assert sea.pilot.counters["vehicle.refused.position_unknown"] == 1
    assert "position_unknown" in sea.pilot.health()


@pytest.mark.parametrize(
    ("reported", "code"),
    [({"altitude_m": 1.5}, "too_low"), ({"depth_m": 120.0}, "too_deep"), ({"latitude_deg": 54.01}, "outside_fence")],
)
def test_control_is_returned_when_the_vehicle_is_where_it_must_not_be(reported: dict[str, float], code: str) -> None:
    sea = commanding(1.0)
    sea.reported |= reported
    n_commands = len(sea.dialect.commands)
    sea.tick(5.0)
    assert len(sea.released()) == 1
    assert len(sea.dialect.commands) == n_commands
    assert sea.pilot.counters[f"vehicle.refused.{code}"] == 1


def test_every_refusal_is_logged_with_its_reason(caplog: pytest.LogCaptureFixture) -> None:
    sea = Sea()
    with caplog.at_level(logging.WARNING):
        sea.pilot.propose(plan(((0.0, 40.0), (0.0, 400.0))), sea.now_s)
        sea.tick(1.0)
    assert "way-point 2 of 2, or the way to it, lies outside the fence [plan_outside_fence]" in caplog.text
    assert "vehicle_refused" in sea.codes()
    assert "lies outside the fence" in sea.pilot.health()
    assert "request" not in sea.dialect.calls


def test_silence_ends_control_and_speech_brings_it_back() -> None:
    sea = commanding(1.0)
    sea.talks = False
    sea.until("down", within_s=3.5)
    assert len(sea.released()) == 1
    sea.talks = True
    sea.until("granted", within_s=25.0)


def test_noise_is_no_sign_of_life() -> None:
    sea = Sea()
    sea.tick(1.0)
    sea.talks = False
    for _ in range(40):
        sea.pilot.hear([], stamp(sea.now_s))
        sea.tick()
    assert sea.pilot.authority == "down"


def test_a_payload_that_stalled_gives_control_back_before_anything_else_leaves() -> None:
    sea = commanding(2.0)
    n_commands = len(sea.dialect.commands)
    sea.now_s += 5.5
    sea.tick()
    assert len(sea.dialect.commands) == n_commands
    assert len(sea.released()) == 1
    assert sea.pilot.counters["vehicle.refused.expired"] == 1


def test_an_old_plan_is_dropped_unless_it_is_proposed_again() -> None:
    sea = Sea(plan_valid_s=30.0)
    sea.pilot.propose(TWO_LEGS, sea.now_s)
    sea.tick(20.0)
    sea.pilot.propose(TWO_LEGS, sea.now_s)
    sea.tick(20.0)
    assert sea.released() == []
    sea.tick(15.0)
    assert sea.pilot.authority == "listening"
    assert sea.pilot.counters["vehicle.refused.plan_expired"] == 1
    assert "leg=0/0" in sea.pilot.health()


def test_a_withdrawn_plan_ends_control() -> None:
    sea = commanding()
    sea.pilot.propose((), sea.now_s)
    sea.tick()
    assert sea.pilot.authority == "listening"
    assert len(sea.released()) == 1


def test_a_new_plan_takes_the_place_of_the_one_before_without_letting_go() -> None:
    sea = commanding(10.0)
    sea.pilot.propose(plan(((50.0, 0.0), (100.0, 0.0)), start_m=sea.place_m), sea.now_s)
    sea.tick(0.2)
    command = sea.dialect.commands[-1][1]
    assert isinstance(command, GoTo)
    assert offset_m(HOME_DEG, (command.latitude_deg, command.longitude_deg)) == pytest.approx((50.0, 0.0), abs=0.01)
    assert sea.released() == []


def test_turns_that_are_behind_the_vehicle_are_not_flown() -> None:
    sea = Sea()
    turns = [waypoint(1, "turn", (0.0, north_m)) for north_m in (10.0, 20.0, 30.0)]
    sea.place_m = (1.0, 24.0)
    sea.pilot.propose((waypoint(1, "start", (0.0, 0.0)), *turns, *TWO_LEGS[1:]), sea.now_s)
    sea.until("granted")
    sea.tick(0.2)
    command = sea.dialect.commands[0][1]
    assert isinstance(command, GoTo)
    assert offset_m(HOME_DEG, (command.latitude_deg, command.longitude_deg)) == pytest.approx((0.0, 30.0), abs=0.01)


def test_the_service_stops() -> None:
    sea = commanding()
    sea.pilot.release("the service stops", sea.now_s)
    assert sea.released() == ["the service stops"]
    sea.pilot.propose(TWO_LEGS, sea.now_s)
    n_asked = sea.dialect.calls.count("request")
    sea.tick(60.0)
    assert sea.dialect.calls.count("request") == n_asked
    assert sea.pilot.authority == "listening"


def test_the_wire_breaks_in_control() -> None:
    sea = commanding(1.0)
    sea.pilot.disconnected(sea.now_s)
    assert sea.pilot.authority == "down"
    assert sea.dialect.calls[-2:] == ["release the wire is closed", "disconnected"]
    assert sea.pilot.take_outgoing(sea.now_s) == []
    sea.pilot.connected(sea.now_s)
    sea.until("granted")


def test_the_vehicle_says_that_it_has_arrived() -> None:
    sea = Sea(arrival_radius_m=3.0)
    sea.pilot.propose(TWO_LEGS, sea.now_s)
    sea.until("granted")
    sea.tick()
    sea.hear(PlaceReached())  # 40 m away: of something else
    sea.tick()
    assert len({command for _, command in sea.dialect.commands}) == 1
    sea.place_m = (0.0, 30.0)
    sea.tick()
    sea.hear(PlaceReached())
    sea.hear(PlaceReached())
    sea.tick()
    command = sea.dialect.commands[-1][1]
    assert isinstance(command, GoTo)
    first_on_leg_m = (0.0, 40.0 + 50.0 / 6)  # a run of 50 m in parts of 10 m at most: the leg is a hair longer
    assert offset_m(HOME_DEG, (command.latitude_deg, command.longitude_deg)) == pytest.approx(first_on_leg_m, abs=0.01)


def test_a_vehicle_that_arrives_everywhere_and_takes_control_back_leaves_nothing_half_done() -> None:
    sea = Sea()
    sea.pilot.propose(plan(((0.0, 4.0), (0.0, 9.0))), sea.now_s)
    sea.until("granted")
    for _ in range(3):
        sea.tick()
        sea.hear(PlaceReached(), Withheld("done"))
        assert "leg=" in sea.pilot.health()
    sea.tick(40.0)
    assert sea.pilot.authority == "listening"
    assert sea.pilot.counters["vehicle.plans_flown"] == 1


def test_contacts_are_reported_at_once_and_again_after_the_link_was_lost() -> None:
    sea = Sea()
    sea.tick()
    sea.pilot.report(contact(1))
    sea.pilot.report(contact(2))
    sea.pilot.take_outgoing(sea.now_s)
    (_, _, ticket), _ = sea.dialect.reports
    sea.hear(Acknowledged(ticket))
    assert "reports_waiting=1" in sea.pilot.health()
    sea.talks = False
    sea.until("down")
    sea.talks = True
    sea.tick()
    assert [(report.number, report.revision) for _, report, _ in sea.dialect.reports] == [(1, 1), (2, 1), (2, 1)]


def test_contacts_wait_for_the_vehicle() -> None:
    sea = Sea()
    sea.talks = False
    sea.pilot.report(contact(1))
    sea.tick(1.0)
    assert sea.dialect.reports == []
    sea.talks = True
    sea.tick()
    assert len(sea.dialect.reports) == 1


def test_no_report_waits_for_a_vehicle_that_takes_none() -> None:
    sea = Sea(GOES_BY_ITSELF & ~Capability.CONTACT)
    sea.pilot.report(contact(1))
    sea.tick(1.0)
    assert "reports_waiting=0" in sea.pilot.health()


def test_a_refused_report_is_reported_to_people_once_per_contact() -> None:
    sea = Sea()
    sea.tick()
    for p_mine in (0.5, 0.6):
        sea.pilot.report(contact(1, p_mine))
        sea.tick()
        sea.hear(Rejected(sea.dialect.reports[-1][2], "too small"))
    sea.tick(60.0)
    assert len(sea.dialect.reports) == 2
    assert sea.codes() == ["vehicle_report_rejected"]


def test_health_is_reported_when_it_changes_and_when_the_wire_opens() -> None:
    sea = Sea()
    sea.pilot.report_health(PayloadHealth("normal", ""), sea.now_s)
    sea.pilot.report_health(PayloadHealth("normal", ""), sea.now_s)
    sea.pilot.disconnected(sea.now_s)
    sea.pilot.connected(sea.now_s)
    assert [line for line in sea.dialect.calls if line.startswith("health")] == ["health normal", "health normal"]


def test_a_state_reported_in_pieces_is_one_state() -> None:
    sea = Sea()
    sea.pilot.propose(TWO_LEGS, sea.now_s)
    sea.talks = False
    whole = sea.state()
    for _ in range(20):
        sea.hear(ReportedState(whole.received, whole.latitude_deg, whole.longitude_deg))
        sea.hear(ReportedState(whole.received, heading_rad=0.0, depth_m=20.0))
        sea.hear(ReportedState(whole.received, altitude_m=8.0))
        sea.tick()
    assert sea.pilot.authority == "granted"


@pytest.mark.parametrize(
    ("name", "given"), [("iver", IverSettings()), ("bluefin", BluefinSettings()), ("recon", ReconSettings())]
)
def test_a_wire_that_echoes_is_no_vehicle_that_speaks(name: str, given: Any) -> None:
    decoder = decoder_of(name, given, "vehicle")
    pilot = Pilot(talker_of(name, given, lambda _: 0), settings(), session=7)
    pilot.connected(0.0)
    pilot.report_health(PayloadHealth("normal", ""), 0.0)
    n_echoed = 0
    for second in range(1, 20):
        for item in pilot.take_outgoing(second):
            pilot.hear(decoder.feed(item, stamp(second)), stamp(second))
            n_echoed += 1
    assert n_echoed > 0
    assert pilot.authority == "down"


@pytest.mark.parametrize("name", ["vehicle_can", "imc"])
def test_others_on_its_wire_do_not_stand_for_a_silent_vehicle(name: str) -> None:
    given: Any = CanSettings(nmea2000_addresses=(12,)) if name == "vehicle_can" else ImcSettings(vehicle_id=0x1E)
    pgn, data = n2k.encode(n2k.RapidPosition(*HOME_DEG))
    frame = CanFrame(n2k.can_id_of(n2k.Identifier(2, pgn, n2k.GLOBAL, 12)), data)
    item: Any = frame if name == "vehicle_can" else packed(imc.Heartbeat(), 0x2F)
    pilot = Pilot(talker_of(name, given, lambda _: 0), settings(), session=7)
    pilot.connected(0.0)
    pilot.hear(decoder_of(name, given, "vehicle").feed(item, stamp(1.0)), stamp(1.0))
    assert pilot.authority == "down"
