"""Requests for second views: as soon as a contact needs one, unchanged while a leg is run, and not for ever."""

from __future__ import annotations

import tracemalloc
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.look_again import WAIT_FOR_VIEW_S, LookAgain, LooksSoFar, PlanRequest
from auv_mcm.plan.propose import propose
from auv_mcm.records import Contact, Waypoint, contact_id
from auv_mcm.settings.config import Config
from tests.auv_mcm.plan.test_propose import FRAME, SQUARE, contact, fenced, geodetic

CONFIG = Config(vehicle=fenced(SQUARE))
HERE = (43.0, 5.0, 0.0)


class Mission:
    """A vehicle that is where it is put, and contacts that are seen when they are."""

    def __init__(self, contacts: list[Contact]) -> None:
        self.now_s = 1000.0
        self.here_deg = HERE[:2]
        self.look_again = LookAgain(CONFIG)
        self.contacts = {contact.id: contact for contact in contacts}
        self.proposed: list[tuple[Waypoint, ...]] = []
        for known in contacts:
            self.look_again.learn(known)

    def ask(self, wait_s: float = 0.0) -> PlanRequest | None:
        self.now_s += wait_s
        return self.look_again.request((*self.here_deg, 0.0), self.now_s, self.now_s)

    def plan(self, wait_s: float = 0.0) -> tuple[Waypoint, ...] | None:
        """What is proposed now, None for nothing new."""
        request = self.ask(wait_s)
        if request is None:
            return None
        plan = self.look_again.take(propose(self.contacts.values(), request, CONFIG.plan, CONFIG.vehicle), self.now_s)
        if plan is not None:
            self.proposed.append(plan)
        return plan

    def be_at(self, east_m: float, north_m: float, commanding: bool = True) -> None:
        self.look_again.move(*geodetic(east_m, north_m), commanding, self.now_s)

    def fly(self, entry: Waypoint, leaving: Waypoint, upto: float = 1.0) -> None:
        """Along a leg, or a part of it, at 2 m/s."""
        ends = [FRAME.to_enu(point.latitude_deg, point.longitude_deg, 0.0)[:2] for point in (entry, leaving)]
        length_m = float(np.linalg.norm(ends[1] - ends[0]))
        for along_m in np.arange(0.0, upto * length_m + 1e-6, 1.0):
            self.now_s += 0.5
            self.be_at(*(ends[0] + along_m / length_m * (ends[1] - ends[0])).tolist())

    def see_again(self, contact_id: str) -> None:
        known = self.contacts[contact_id]
        self.contacts[contact_id] = msgspec.structs.replace(known, views=(*known.views, known))  # counted only
        self.look_again.learn(self.contacts[contact_id])


def legs(plan: tuple[Waypoint, ...] | None) -> list[tuple[Waypoint, Waypoint]]:
    points = plan or ()
    return [(a, b) for a, b in pairwise(points) if b.kind == "leg_exit"]


def test_a_view_of_a_contact_worth_it_is_requested_at_once_and_of_others_never() -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    assert len(legs(mission.plan())) == 1
    decided = msgspec.structs.replace(contact(2, 40.0, 40.0), next_look_deg=())
    assert Mission([decided]).plan() is None


def test_contacts_that_request_no_look_cost_no_memory() -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    decided = msgspec.structs.replace(mission.contacts["C00001"], next_look_deg=())
    ids = [contact_id(number) for number in range(2, 3000)]
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    for name in ids:
        mission.look_again.learn(msgspec.structs.replace(decided, id=name))
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 10 * len(ids)


def test_a_plan_that_waits_for_permission_begins_anew_where_the_vehicle_is_and_one_that_is_flown_does_not() -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    mission.plan()
    assert mission.plan(10.0) is None
    assert mission.plan(25.0) is not None
    mission.be_at(0.0, 0.0)
    assert mission.plan() is not None  # as soon as it commands
    assert mission.plan(60.0) is None
    assert mission.plan(400.0) is not None  # before it grows too old


def test_a_contact_refused_where_the_vehicle_was_is_requested_again_where_it_is_now() -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    mission.here_deg = geodetic(260.0, 0.0)
    assert mission.plan() is None
    mission.here_deg = geodetic(0.0, 0.0)
    assert mission.ask(20.0) is None
    assert len(legs(mission.plan(15.0))) == 1
    assert [notice.code for notice in mission.look_again.take_notices()] == ["look_refused"]


def outside(mission: Mission, *places_m: tuple[float, float]) -> list[tuple[str, bool]]:
    """What is raised by a vehicle at these places, a minute apart."""
    for place_m in places_m:
        mission.here_deg = geodetic(*place_m)
        mission.plan(60.0)
    return [(notice.code, notice.for_the_record) for notice in mission.look_again.take_notices()]


def test_a_vehicle_that_stays_outside_its_fence_while_legs_are_wanted_is_reported_once() -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    assert outside(mission, *[(260.0, 20.0 * n) for n in range(5)]) == [("look_refused", True)]
    drifts = [(259.0 - n, 0.0) for n in range(20)]  # nearer, but by less than a vehicle on its way
    assert outside(mission, *drifts) == [("vehicle_outside_fence", False)]


@pytest.mark.parametrize(
    "places_m",
    [
        [(260.0, 0.0), (260.0, 0.0), (100.0, 0.0)] * 5,  # it turns outside
        [(2000.0 - 60.0 * n, 0.0) for n in range(30)],  # it is on its way
    ],
)
def test_a_vehicle_that_turns_outside_its_fence_or_comes_to_it_is_not_reported(
    places_m: list[tuple[float, float]],
) -> None:
    assert outside(Mission([contact(1, 40.0, 40.0)]), *places_m) == [("look_refused", True)]


def test_a_vehicle_outside_its_fence_is_not_reported_where_no_leg_is_wanted() -> None:
    assert outside(Mission([]), *[(260.0, 0.0)] * 20) == []


@pytest.mark.parametrize(("east_m", "is_far"), [(0.0, False), (16_000.0, False), (18_000.0, True)])
def test_a_fence_is_far_by_the_way_to_its_nearest_edge(east_m: float, is_far: bool) -> None:
    corners = tuple((60.0 * east, 60.0 * north) for east, north in SQUARE)
    look_again = LookAgain(Config(vehicle=fenced(corners)))
    look_again.request((*geodetic(east_m, 0.0), 0.0), 0.0, 0.0)
    assert [notice.code for notice in look_again.take_notices()] == ["bounds_far_away"] * is_far


def test_only_the_way_under_command_counts_and_no_jump_of_the_position() -> None:
    mission = Mission([])
    for north_m in (0.0, 40.0):
        mission.be_at(0.0, north_m)
    mission.be_at(0.0, 80.0, commanding=False)
    for north_m in (90.0, 120.0, 1120.0, 1130.0):
        mission.be_at(0.0, north_m)
    assert mission.look_again.so_far().sailed_m == pytest.approx(40.0 + 30.0 + 10.0, abs=0.01)


def test_a_leg_under_way_is_not_disturbed_and_a_new_contact_comes_after_it() -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    mission.be_at(0.0, 0.0)
    ((entry, leaving),) = legs(mission.plan())
    mission.fly(entry, leaving, upto=0.5)
    mission.contacts["C00002"] = contact(2, -40.0, 40.0)
    mission.look_again.learn(mission.contacts["C00002"])
    assert mission.plan(20.0) is None
    mission.fly(entry, leaving)
    assert [entry.contact_id for entry, _ in legs(mission.plan(20.0))] == ["C00002"]


def test_the_same_contacts_are_no_reason_to_change_a_plan_under_way() -> None:
    mission = Mission([contact(1, 40.0, 40.0), contact(2, -40.0, 40.0)])
    mission.be_at(0.0, 0.0)
    mission.plan()
    mission.see_again("C00001")  # and it still needs a look
    assert mission.ask(10.0) is not None
    assert (
        mission.look_again.take(
            propose(mission.contacts.values(), PlanRequest(*HERE, frozenset()), CONFIG.plan, CONFIG.vehicle),
            mission.now_s,
        )
        is None
    )


def test_a_decided_contact_is_withdrawn() -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    mission.be_at(0.0, 0.0)
    mission.plan()
    mission.contacts["C00001"] = msgspec.structs.replace(mission.contacts["C00001"], next_look_deg=())
    mission.look_again.learn(mission.contacts["C00001"])
    assert mission.plan(10.0) == ()
    assert mission.plan(60.0) is None


def test_a_contact_that_two_legs_show_nothing_new_of_is_given_up() -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    mission.be_at(0.0, 0.0)
    for n_flown in (1, 2):
        plan = mission.plan(10.0)
        ((entry, leaving),) = legs(plan)
        mission.fly(entry, leaving)
        assert mission.plan(10.0) == ()  # what was seen may still be on its way
        mission.now_s += WAIT_FOR_VIEW_S
        assert len(mission.proposed) == 2 * n_flown
    assert not any(mission.plan(100.0) for _ in range(20))
    (notice,) = mission.look_again.take_notices()
    assert (notice.code, notice.for_the_record) == ("look_given_up", True)


def test_what_was_given_up_before_a_restart_is_not_requested_after_it() -> None:
    before, after = Mission([contact(1, 40.0, 40.0)]), Mission([])
    before.be_at(0.0, 0.0)
    for _ in range(2):
        ((entry, leaving),) = legs(before.plan(10.0))
        before.fly(entry, leaving)
        before.plan(10.0)
        before.now_s += WAIT_FOR_VIEW_S
    so_far = msgspec.json.decode(msgspec.json.encode(before.look_again.so_far()), type=LooksSoFar)
    assert so_far == before.look_again.so_far()
    assert so_far.sailed_m > 50.0
    after.look_again.go_on(so_far)
    after.contacts = before.contacts
    after.look_again.learn(before.contacts["C00001"])
    assert not any(after.plan(100.0) for _ in range(5))
    after.see_again("C00001")
    assert after.plan(100.0)


def test_a_leg_right_before_a_restart_is_waited_for_after_it() -> None:
    before, after = Mission([contact(1, 40.0, 40.0)]), Mission([])
    before.be_at(0.0, 0.0)
    ((entry, leaving),) = legs(before.plan())
    before.fly(entry, leaving)
    after.look_again.go_on(before.look_again.so_far(), after.now_s)
    after.contacts = before.contacts
    after.look_again.learn(before.contacts["C00001"])
    assert not legs(after.plan(10.0))
    assert legs(after.plan(WAIT_FOR_VIEW_S))


@pytest.mark.parametrize(("upto", "counts"), [(0.4, False), (0.7, True)])
def test_a_leg_that_ends_early_counts_if_the_contact_was_passed(upto: float, counts: bool) -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    mission.be_at(0.0, 0.0)
    ((entry, leaving),) = legs(mission.plan())
    mission.fly(entry, leaving, upto)
    mission.be_at(0.0, 0.0, commanding=False)  # the vehicle has taken control back
    assert bool(legs(mission.plan(40.0))) is not counts


def test_legs_are_long_enough_for_a_vehicle_that_leaves_them_far_before_their_end() -> None:
    radius_m = 25.0  # of arrival, where it turns to the next way-point: half of a leg of the usual length
    config = msgspec.structs.replace(CONFIG, vehicle=msgspec.structs.replace(CONFIG.vehicle, arrival_radius_m=radius_m))
    mission = Mission([contact(1, 40.0, 40.0)])
    mission.look_again = LookAgain(config)
    mission.be_at(0.0, 0.0)
    request = PlanRequest(*HERE, frozenset())
    plan = mission.look_again.take(propose([contact(1, 40.0, 40.0)], request, config.plan, config.vehicle), 1000.0)
    ((entry, leaving),) = legs(plan)
    frame = LocalFrame(latitude_deg=entry.latitude_deg, longitude_deg=entry.longitude_deg)
    length_m = float(np.linalg.norm(frame.to_enu(leaving.latitude_deg, leaving.longitude_deg, 0.0)))
    mission.fly(entry, leaving, upto=1.0 - radius_m / length_m)
    assert [n_flown for *_, n_flown, _ in mission.look_again.so_far().looks] == [1]


@given(st.lists(st.sampled_from(["fly", "wait", "see", "lose", "command"]), max_size=25))
@example(["wait", *["fly", "see"] * 4])
@settings(deadline=None, max_examples=20)
def test_whatever_happens_a_contact_is_looked_at_so_often_and_no_more(events: list[str]) -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    n_flown = 0
    for event in events:
        if event == "fly" and (ways := legs(mission.look_again.plan)):
            mission.be_at(0.0, 0.0)
            mission.fly(*ways[0])
            n_flown += 1
        elif event == "see":
            mission.see_again("C00001")
        elif event in ("lose", "command"):
            mission.be_at(0.0, 0.0, commanding=event == "command")
        plan = mission.plan(100.0)
        if n_flown >= 4:
            assert not plan


@pytest.mark.parametrize(("place", "angle_deg"), [(0.2, 90.0), (0.5, 45.0), (0.5, 60.0), (0.5, 120.0)])
def test_crossing_a_leg_is_not_flying_it(place: float, angle_deg: float) -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    mission.be_at(0.0, 0.0)
    entry, leaving = (FRAME.to_enu(p.latitude_deg, p.longitude_deg, 0.0)[:2] for p in legs(mission.plan())[0])
    course = np.arctan2(*(leaving - entry)) + np.radians(angle_deg)
    for way_m in np.linspace(-30.0, 30.0, 41):
        mission.be_at(*(entry + place * (leaving - entry) + way_m * np.array([np.sin(course), np.cos(course)])))
    assert mission.plan(10.0) is None
    request = mission.look_again.request(HERE, mission.now_s, mission.now_s + 500.0)
    assert request is not None
    assert not request.left_out  # nothing was flown
    assert request.sailed_m > 60.0


def test_a_leg_that_takes_longer_than_a_plan_lasts_is_requested_once_more_without_planning() -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    mission.be_at(0.0, 0.0)
    plan = mission.plan()
    mission.fly(*legs(plan)[0], upto=0.4)
    assert mission.look_again.insist(mission.now_s) is None
    mission.now_s += 0.6 * CONFIG.vehicle.plan_valid_s
    assert mission.ask() is None
    assert mission.look_again.insist(mission.now_s) == plan
    assert mission.look_again.insist(mission.now_s) is None


@pytest.mark.parametrize("is_reported", [True, False])  # it is not below contacts.min_p_mine
def test_a_leg_counts_where_all_track_is_sailed_behind_its_middle(is_reported: bool) -> None:
    mission = Mission([contact(1, 40.0, 40.0)] * is_reported)
    request = PlanRequest(*HERE, frozenset())
    mission.look_again.take(propose([contact(1, 40.0, 40.0)], request, CONFIG.plan, CONFIG.vehicle), mission.now_s)
    mission.fly(*legs(mission.look_again.plan)[0], upto=0.7)
    mission.look_again.go_on(mission.look_again.so_far()._replace(sailed_m=CONFIG.plan.max_track_m))
    assert mission.look_again.insist(mission.now_s) == ()
    mission.be_at(0.0, 0.0, commanding=False)
    assert [n_flown for *_, n_flown, _ in mission.look_again.so_far().looks] == [1]


def test_when_all_track_is_sailed_the_plan_is_withdrawn_which_is_reported_once() -> None:
    mission = Mission([contact(1, 40.0, 40.0)])
    short = msgspec.structs.replace(CONFIG, plan=msgspec.structs.replace(CONFIG.plan, max_track_m=100.0))
    mission.look_again = LookAgain(short)
    mission.look_again.learn(mission.contacts["C00001"])
    mission.be_at(0.0, 0.0)
    assert mission.plan()
    for north_m in np.arange(0.0, 120.0, 2.0):
        mission.be_at(0.0, float(north_m))
    assert mission.look_again.insist(mission.now_s) == ()
    assert mission.look_again.insist(mission.now_s) is None
    request = mission.ask(60.0)
    assert request is None or propose(mission.contacts.values(), request, short.plan, short.vehicle).waypoints == ()
    assert [notice.code for notice in mission.look_again.take_notices()] == ["track_spent"]
