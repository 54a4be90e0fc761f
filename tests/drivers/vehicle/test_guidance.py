"""A vehicle that holds a heading is kept on its legs, in current, anywhere on Earth. What is asserted here is what is
claimed.

The simulated vehicle follows its commanded heading with a lag of a second and half as fast again as the guidance turns
it, and runs through water that moves.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.plan.dubins import PlanePose, dubins_path, sample_path
from drivers.navigation.corrections import moved
from drivers.vehicle.guidance import MAX_LEAD_RAD, LineOfSight, WaypointTrack

SPEED_MPS = 1.5
TURN_RADIUS_M = 10.0
STEP_S = 0.1
TURN = 2.0 * math.pi
Places = list[tuple[float, float]]


class Moment(NamedTuple):
    target: int
    to_go_m: float
    cross_m: float
    command_rad: float
    heading_rad: float


def sail(
    places_m: Places,
    current_mps: tuple[float, float] = (0.0, 0.0),
    *,
    heading_rad: float = 0.0,
    start_m: tuple[float, float] = (0.0, 0.0),
    origin_deg: tuple[float, float] = (54.0, 8.0),
    position_every: int = 1,
    speed_error: float = 0.0,
    max_s: float = 2000.0,
) -> tuple[list[Moment], bool]:
    """What happened, and whether all was flown. places_m: east, north."""
    places_deg = tuple(moved(*origin_deg, *place) for place in places_m)
    track = WaypointTrack(places_deg, radius_m=3.0, cut_radius_m=TURN_RADIUS_M)
    line_of_sight = LineOfSight(turn_radius_m=TURN_RADIUS_M, speed_mps=SPEED_MPS)
    position_deg = reported_deg = moved(*origin_deg, *start_m)
    track.join(position_deg, 1)
    line_of_sight.start()
    moments: list[Moment] = []
    reported_s = 0.0
    for step in range(int(max_s / STEP_S)):
        now_s = step * STEP_S
        if step % position_every == 0:
            reported_deg, reported_s = position_deg, now_s
        track.advance(reported_deg)
        if track.finished:
            return moments, True
        command_rad = line_of_sight.heading_rad(track, reported_deg, reported_s, heading_rad, now_s)
        moments.append(Moment(track.index, *track.off_track(position_deg), command_rad, heading_rad))
        fastest_radps = 1.5 * SPEED_MPS / TURN_RADIUS_M
        turn_radps = min(max(math.remainder(command_rad - heading_rad, TURN), -fastest_radps), fastest_radps)
        heading_rad = (heading_rad + STEP_S * turn_radps) % TURN
        speed_mps = SPEED_MPS * (1.0 + speed_error)
        east_m = STEP_S * (speed_mps * math.sin(heading_rad) + current_mps[0])
        north_m = STEP_S * (speed_mps * math.cos(heading_rad) + current_mps[1])
        position_deg = moved(*position_deg, east_m, north_m)
    return moments, False


def current_mps(share: float, towards_deg: float) -> tuple[float, float]:
    return share * SPEED_MPS * math.sin(math.radians(towards_deg)), share * SPEED_MPS * math.cos(
        math.radians(towards_deg)
    )


def worst_m(moments: list[Moment], index: int, from_to_go_m: float, to_to_go_m: float = 0.0) -> float:
    return max(abs(m.cross_m) for m in moments if m.target == index and to_to_go_m <= m.to_go_m <= from_to_go_m)


def reinspection() -> tuple[Places, list[int]]:
    """Three legs as the planner lays them, with its turns, 30 m and a settling radius at both ends; and the indices of
    their exits."""
    places: Places = [(0.0, 0.0)]
    exits = []
    pose = PlanePose(0.0, 0.0, 0.0)
    for entry, way_out in (
        (PlanePose(60.0, 40.0, math.pi / 2), PlanePose(110.0, 40.0, math.pi / 2)),
        (PlanePose(100.0, 80.0, -math.pi / 2), PlanePose(50.0, 80.0, -math.pi / 2)),
        (PlanePose(20.0, 20.0, math.pi), PlanePose(20.0, -30.0, math.pi)),
    ):
        path = sample_path(dubins_path(pose, entry, TURN_RADIUS_M / math.cos(math.radians(7.5))), math.radians(15.0))
        places += [(float(east_m), float(north_m)) for east_m, north_m, *_ in path[1:-1]]
        places += [entry[:2], way_out[:2]]
        exits.append(len(places) - 1)
        pose = way_out
    return places, exits


@pytest.mark.parametrize(("share", "within_m"), [(0.0, 0.3), (0.3, 2.5), (0.5, 5.0)])
@pytest.mark.parametrize("towards_deg", [0.0, 90.0, 225.0, 270.0])
def test_legs_of_a_reinspection_are_flown_past_their_contacts(
    share: float, within_m: float, towards_deg: float
) -> None:
    places_m, exits = reinspection()
    moments, finished = sail(places_m, current_mps(share, towards_deg))
    assert finished
    assert max(worst_m(moments, index, TURN_RADIUS_M + 30.0, TURN_RADIUS_M) for index in exits) < within_m


@pytest.mark.parametrize("share", [0.3, 0.6, 0.8])
@pytest.mark.parametrize("towards_deg", [0.0, 60.0, 90.0, 135.0, 270.0])
def test_a_long_leg_is_held_in_any_current_up_to_eight_tenths_of_the_speed(share: float, towards_deg: float) -> None:
    moments, finished = sail([(0.0, 0.0), (0.0, 300.0)], current_mps(share, towards_deg), position_every=5)
    assert finished
    assert worst_m(moments, 1, 300.0) < 25.0
    assert worst_m(moments, 1, 150.0) < 0.5


def test_a_speed_that_is_not_the_commanded_one_does_not_carry_off_the_leg() -> None:
    moments, finished = sail([(0.0, 0.0), (0.0, 300.0)], current_mps(0.4, 90.0), speed_error=-0.2)
    assert finished
    assert worst_m(moments, 1, 150.0) < 0.5


def test_a_current_stronger_than_the_vehicle_does_not_wind_anything_up() -> None:
    moments, finished = sail([(0.0, 0.0), (0.0, 300.0)], current_mps(1.5, 90.0), max_s=300.0)
    assert not finished
    assert all(math.isfinite(m.command_rad) for m in moments)


def test_commands_turn_no_faster_than_on_the_circle_and_never_far_ahead_of_the_vehicle() -> None:
    places_m, _ = reinspection()
    moments, _ = sail(places_m, current_mps(0.5, 135.0), heading_rad=math.pi)
    turns = [abs(math.remainder(b.command_rad - a.command_rad, TURN)) for a, b in pairwise(moments)]
    assert max(turns) <= SPEED_MPS / TURN_RADIUS_M * STEP_S + 1e-9
    assert max(abs(math.remainder(m.command_rad - m.heading_rad, TURN)) for m in moments) <= MAX_LEAD_RAD
    assert all(0.0 <= m.command_rad < TURN for m in moments)


def test_a_vehicle_that_does_not_turn_is_not_led_round_to_its_other_side() -> None:
    track = WaypointTrack((moved(54.0, 8.0, 0.0, 0.0), moved(54.0, 8.0, 0.0, -500.0)), radius_m=3.0)
    line_of_sight = LineOfSight(turn_radius_m=TURN_RADIUS_M, speed_mps=SPEED_MPS)
    leads = []
    for step in range(600):
        command_rad = line_of_sight.heading_rad(track, (54.0, 8.0), step * STEP_S, 0.3, step * STEP_S)
        leads.append(math.remainder(command_rad - 0.3, TURN))
    assert max(leads) <= MAX_LEAD_RAD
    assert min(leads) >= 0.0


@settings(max_examples=12, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-200.0, 200.0), st.floats(-200.0, 200.0)), min_size=1, max_size=5),
    st.floats(0.0, 0.8),
    st.floats(0.0, 360.0),
    st.floats(0.0, TURN, exclude_max=True),
)
def test_every_way_comes_to_its_end(places_m: Places, share: float, towards_deg: float, heading_rad: float) -> None:
    moments, finished = sail(
        [(0.0, 0.0), *places_m], current_mps(share, towards_deg), heading_rad=heading_rad, max_s=8000.0
    )
    assert finished
    # No excursion is larger than a turn that a current carries along, from wherever the leg began.
    assert all(abs(m.cross_m) < 4.0 * TURN_RADIUS_M / (1.0 - share) for m in moments)


@pytest.mark.parametrize("origin_deg", [(0.0, 180.0), (54.0, -179.9999), (89.99, 20.0), (-89.99, 179.9)])
def test_legs_across_the_antimeridian_and_near_the_poles_are_held(origin_deg: tuple[float, float]) -> None:
    moments, finished = sail([(0.0, 0.0), (60.0, 0.0), (60.0, 150.0)], current_mps(0.2, 0.0), origin_deg=origin_deg)
    assert finished
    assert worst_m(moments, 2, 75.0) < 1.0


def test_a_place_passed_abeam_is_behind_the_vehicle_however_far_off() -> None:
    track = WaypointTrack(tuple(moved(54.0, 8.0, 0.0, north_m) for north_m in (0.0, 100.0, 200.0)), radius_m=3.0)
    track.advance(moved(54.0, 8.0, 40.0, 99.0))
    assert track.index == 1
    track.advance(moved(54.0, 8.0, 40.0, 101.0))
    assert track.index == 2


def test_places_on_top_of_each_other_are_all_reached_at_once() -> None:
    track = WaypointTrack(((54.0, 8.0),) * 4, radius_m=3.0, cut_radius_m=10.0)
    track.advance((54.0, 8.0))
    assert track.finished


def test_the_nearest_leg_is_joined() -> None:
    places_deg = tuple(moved(54.0, 8.0, *place) for place in ((0.0, 0.0), (0.0, 50.0), (50.0, 50.0), (50.0, 0.0)))
    track = WaypointTrack(places_deg, radius_m=3.0)
    assert track.nearest(moved(54.0, 8.0, 5.0, 20.0), 1, 3) == 1
    assert track.nearest(moved(54.0, 8.0, 20.0, 45.0), 1, 3) == 2
    assert track.nearest(moved(54.0, 8.0, 45.0, 10.0), 1, 2) == 2
    track.join(moved(54.0, 8.0, 20.0, 45.0), 2)
    assert track.target_deg == places_deg[2]
    assert track.off_track(moved(54.0, 8.0, 20.0, 45.0)).cross_m == pytest.approx(0.0, abs=1e-6)


def test_without_a_position_nothing_is_passed() -> None:
    track = WaypointTrack(((54.0, 8.0), (54.1, 8.0)), radius_m=3.0)
    track.advance((math.nan, math.nan))
    assert not track.finished
