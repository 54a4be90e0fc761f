"""A flight goes on until the order is met, cannot be met, or the budget is used up, and never leaves the fence."""

from __future__ import annotations

import numpy as np
import pytest

from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.dubins import PlanePose
from sim_replay.adaptive.decide import by_replanning
from sim_replay.adaptive.flight import AdaptiveFlight, LegDecision, Situation, fly_adaptive, fly_fixed
from sim_replay.adaptive.lawnmower import expected_clearance, shortest_lawnmower
from sim_replay.adaptive.order import limits_of
from sim_replay.adaptive.ordered_ground import clearance_over_order, would_come_to
from sim_replay.simulator.plan import local_frame, planned_legs
from tests.make.looks import EvenLook
from tests.sim_replay.adaptive.small_worlds import SIDE_M, coarse_config, fly_small, small_order, small_scene

GOOD = EvenLook(0.6)


@pytest.fixture(scope="module")
def cleared() -> AdaptiveFlight:
    return fly_small(GOOD, small_order())


def test_a_flight_ends_when_the_ordered_clearance_is_reached(cleared: AdaptiveFlight) -> None:
    assert cleared.verdict.startswith("done")
    assert cleared.ground.p_detected.mean() >= 0.6
    assert cleared.reached_m == pytest.approx(cleared.way_m, abs=1.0)
    # Before the last piece of news it was not reached yet, or the flight would have ended there.
    assert all(reported.p_detected < 0.6 for reported in cleared.reported if reported.way_m < cleared.reached_m)


def test_reported_clearance_only_grows_and_covers_the_ordered_area(cleared: AdaptiveFlight) -> None:
    assert all(np.diff([reported.p_detected for reported in cleared.reported]) >= 0.0)
    cell_m = cleared.ground.cell_m
    assert cleared.ground.exponent.shape == pytest.approx((SIDE_M / cell_m, SIDE_M / cell_m), abs=1)


def test_every_decision_is_explained(cleared: AdaptiveFlight) -> None:
    assert len(cleared.reasons) >= 2
    assert all(cleared.reasons)


def test_the_same_seed_gives_the_same_flight(cleared: AdaptiveFlight) -> None:
    again = fly_small(GOOD, small_order())
    assert again.track.tobytes() == cleared.track.tobytes()
    assert again.ground.exponent.tobytes() == cleared.ground.exponent.tobytes()
    assert (again.verdict, again.reported, again.reasons) == (cleared.verdict, cleared.reported, cleared.reasons)


def test_a_sea_floor_on_which_nothing_is_found_ends_the_flight_at_once_with_words() -> None:
    flight = fly_small(EvenLook(0.0), small_order())
    assert flight.verdict.startswith("cannot, because")
    assert flight.way_m == 0.0
    assert flight.reached_m == np.inf


def test_what_is_wanted_beyond_the_order_by_what_is_known_is_flown_for_as_well(cleared: AdaptiveFlight) -> None:
    scene, order = small_scene(), small_order()
    limits = limits_of(scene, order)
    decide = by_replanning(order, GOOD, limits, local_frame(scene.origin))
    seen: list[float] = []

    def wanted(ground: Clearance) -> float:
        seen.append(float(ground.p_detected.mean()))
        return 0.75

    flight = fly_adaptive(scene, order, decide, limits, GOOD, coarse_config(), wanted)
    assert flight.verdict.startswith("done")
    assert flight.ground.p_detected.mean() >= 0.75
    assert seen[-1] >= 0.75
    assert flight.reached_m < flight.way_m


def test_what_a_lawnmower_would_come_to_is_what_was_expected_where_the_floor_is_as_assumed() -> None:
    scene, order = small_scene(), small_order(required=0.8)
    limits = limits_of(scene, order)
    origin = local_frame(scene.origin)
    first = planned_legs(scene.track.plan)[0]
    lawnmower = shortest_lawnmower(
        SIDE_M, order.required, {"flat": 1.0}, GOOD, limits, PlanePose(first.east_m, first.north_m, 0.0)
    )
    assert lawnmower is not None
    # The ground's plane may lie elsewhere than the scene's.
    plane = LocalFrame(latitude_deg=origin.latitude_deg + 3e-4, longitude_deg=origin.longitude_deg - 2e-4)
    for there in (origin, plane):
        ground = clearance_over_order(None, order, origin, there, 4.0)
        reported = would_come_to(ground, lawnmower.legs, origin, GOOD, limits)
        assert reported == pytest.approx(lawnmower.expected, abs=0.04)
    assert would_come_to(ground, lawnmower.legs[:1], origin, GOOD, limits) < reported


def test_an_order_that_takes_more_track_than_there_is_ends_within_the_budget() -> None:
    flight = fly_small(EvenLook(0.2), small_order(required=0.95, budget_m=230.0))
    assert flight.verdict.startswith("cannot, because")
    assert flight.way_m <= 231.0


def test_the_vehicle_stays_inside_the_fence(cleared: AdaptiveFlight) -> None:
    low, high = small_order().fence.min(axis=0), small_order().fence.max(axis=0)
    assert (cleared.track > low).all()
    assert (cleared.track < high).all()


def test_a_flight_with_nothing_left_to_decide_waits_for_what_it_has_flown_over() -> None:
    """One leg, then no more: it ends only after the sonar's last picture of that leg has been reported."""
    scene, order = small_scene(), small_order()
    limits = limits_of(scene, order)
    leg = planned_legs(scene.track.plan)[0]._replace(length_m=70.0)
    asked: list[Situation] = []

    def one_leg(now: Situation) -> LegDecision:
        asked.append(now)
        return LegDecision((leg,) if len(asked) == 1 else (), "cannot, because the test has one leg", "one leg")

    flight = fly_adaptive(scene, order, one_leg, limits, EvenLook(0.3), coarse_config(), lambda ground: order.required)
    assert not asked[1].complete
    assert asked[-1].complete
    assert flight.verdict == "cannot, because the test has one leg"
    # What the situation after the leg expected is what came of it.
    assert asked[1].ground.exponent.sum() == pytest.approx(flight.ground.exponent.sum(), rel=0.15)


def test_a_lawnmower_flown_gives_about_the_clearance_that_was_expected() -> None:
    scene, order = small_scene(), small_order(required=0.7)
    limits = limits_of(scene, order)
    first = planned_legs(scene.track.plan)[0]
    start = PlanePose(first.east_m, first.north_m, first.direction_rad)
    lawnmower = shortest_lawnmower(SIDE_M, order.required, {"flat": 1.0}, GOOD, limits, start)
    assert lawnmower is not None
    flight = fly_fixed(scene, order, lawnmower.legs, GOOD, coarse_config())
    assert flight.verdict == "flown to the end"
    expected = expected_clearance(lawnmower.legs, SIDE_M, {"flat": 1.0}, GOOD, limits)
    assert flight.ground.p_detected.mean() == pytest.approx(expected, abs=0.05)
    assert flight.way_m == pytest.approx(lawnmower.length_m, rel=0.1)
