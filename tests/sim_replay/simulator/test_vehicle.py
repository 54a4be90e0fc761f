"""The vehicle flies every leg straight and in full, as fast and as unsteadily as the scene requires."""

from __future__ import annotations

import math
from itertools import groupby, islice, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from sim_replay.simulator.gauss_markov import DAMPING
from sim_replay.simulator.plan import Leg, planned_legs
from sim_replay.simulator.scene import STEADY, Lawnmower, Motion, Spiral, Track, Waypoints
from sim_replay.simulator.vehicle import (
    MIN_ALTITUDE_M,
    MIN_DEPTH_M,
    RUN_IN_S,
    SLOWEST,
    STRONGEST_CURRENT,
    WANDER_PERIOD_S,
    SonarPose,
    Vehicle,
)

DEPTH_M = 20.0
LAWNMOWER = Lawnmower(heading_deg=35.0, n_legs=3, leg_m=60.0, spacing_m=20.0, start_east_m=7.0, start_north_m=-3.0)
CORNERS = Waypoints(points_m=((0.0, 0.0), (60.0, 0.0), (10.0, 15.0), (10.0, 60.0), (14.0, 90.0)))
TRACK = Track(plan=LAWNMOWER, start_time_s=0.0, motion=STEADY)


def flat(east_m: float, north_m: float) -> float:
    return DEPTH_M


def vehicle(track: Track, seed: int = 1) -> Vehicle:
    return Vehicle(track, planned_legs(track.plan), seed, flat)


def flown(track: Track, rate_hz: float = 10.0, seed: int = 1) -> list[SonarPose]:
    return list(vehicle(track, seed).poses(rate_hz))


def column(poses: list[SonarPose], name: str) -> NDArray[np.float64]:
    return np.array([getattr(pose, name) for pose in poses], dtype=np.float64)


def turned(angle_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.arctan2(np.sin(angle_rad), np.cos(angle_rad))


def check_flown_in_full(poses: list[SonarPose], legs: tuple[Leg, ...], track: Track, rate_hz: float) -> None:
    """All legs in order, each on its line from end to end."""
    runs = [(index, list(run)) for index, run in groupby(poses, key=lambda pose: pose.on_leg) if index >= 0]
    assert [index for index, _ in runs] == list(range(len(legs)))
    reach = 1.01 * (track.speed_mps + track.motion.current_mps) / rate_hz
    for index, run in runs:
        along, across = np.array([legs[index].along_across(pose.east_m, pose.north_m) for pose in run]).T
        assert np.abs(across).max() < 1e-9
        assert (np.diff(along) > 0.0).all()
        assert -1e-9 < along[0] < reach
        assert legs[index].length_m - reach < along[-1] < legs[index].length_m + 1e-9


points = st.lists(st.tuples(st.integers(-40, 40), st.integers(-40, 40)), min_size=2, max_size=5).filter(
    lambda places: all(a != b for a, b in pairwise(places))
)
plans = st.one_of(
    st.builds(
        Lawnmower,
        heading_deg=st.floats(-360.0, 720.0),
        n_legs=st.integers(1, 4),
        leg_m=st.floats(5.0, 80.0),
        spacing_m=st.floats(1, 90),
    ),
    st.builds(
        Spiral,
        heading_deg=st.floats(0.0, 360.0),
        n_legs=st.integers(2, 5),
        first_leg_m=st.floats(5, 60),
        spacing_m=st.floats(5, 60),
    ),
    st.builds(Waypoints, points_m=points.map(tuple)),
)
steady_tracks = st.builds(
    Track,
    plan=plans,
    speed_mps=st.floats(0.8, 3.0),
    turn_rate_deg_s=st.floats(4.0, 30.0),
    pings_in_turns=st.booleans(),
    start_time_s=st.just(0.0),
    motion=st.builds(
        lambda current, towards: structs.replace(STEADY, current_mps=current, current_towards_deg=towards),
        st.sampled_from([0.0, 0.2, 0.6]),
        st.floats(0.0, 360.0),
    ),
)


@settings(max_examples=60, deadline=None)
@given(steady_tracks)
def test_every_plan_is_completed_with_each_leg_straight_in_full(track: Track) -> None:
    check_flown_in_full(flown(track, 4.0), planned_legs(track.plan), track, 4.0)


@settings(max_examples=24, deadline=None)
@given(steady_tracks)
def test_the_vehicle_moves_as_its_heading_and_the_current_carry_it(track: Track) -> None:
    track = structs.replace(track, pings_in_turns=True)
    poses = flown(track, 20.0)
    towards = math.radians(track.motion.current_towards_deg)
    heading, course, speed = (column(poses, name) for name in ("heading_rad", "course_rad", "speed_mps"))
    east, north = track.speed_mps * np.array([np.sin(heading), np.cos(heading)]) + track.motion.current_mps * np.array(
        [[math.sin(towards)], [math.cos(towards)]]
    )
    np.testing.assert_allclose([speed * np.sin(course), speed * np.cos(course)], [east, north], atol=1e-9)
    for name, expected in (("east_m", east), ("north_m", north)):  # trapezoids are off where turns begin and end
        np.testing.assert_allclose(
            np.diff(column(poses, name)), (expected[1:] + expected[:-1]) / 40.0, atol=0.02 * speed.max() / 20.0
        )
    rate = np.abs(turned(np.diff(heading))) * 20.0
    assert rate.max() <= math.radians(track.turn_rate_deg_s) * (1.0 + 1e-6)


def test_a_steady_vehicle_keeps_direction_and_speed_to_rounding() -> None:
    for plan in (structs.replace(LAWNMOWER, n_legs=2, leg_m=900.0), CORNERS, Spiral(heading_deg=-100.0)):
        track = structs.replace(TRACK, plan=plan, pings_in_turns=False)
        legs = planned_legs(plan)
        for index, run in groupby(flown(track, 7.0), key=lambda pose: pose.on_leg):
            poses = list(run)
            leg, since = legs[index], column(poses, "time_s") - poses[0].time_s
            places = [leg.along_across(pose.east_m, pose.north_m) for pose in poses]
            np.testing.assert_allclose(places, np.column_stack([track.speed_mps * since, 0.0 * since]), atol=1e-9)
            assert {pose.heading_rad for pose in poses} == {leg.direction_rad}
            assert {pose.speed_mps for pose in poses} == {track.speed_mps}
            assert {(pose.pitch_rad, pose.roll_rad, pose.depth_m) for pose in poses} == {
                (0.0, 0.0, DEPTH_M - track.altitude_m)
            }


def test_without_current_turns_are_flown_at_the_turn_rate() -> None:
    heading = column(flown(structs.replace(TRACK, turn_rate_deg_s=6.0), 10.0), "heading_rad")
    rates = np.degrees(np.abs(turned(np.diff(heading)))) * 10.0
    assert np.isclose(rates, 6.0, atol=1e-6).sum() > 300
    assert np.isclose(rates, 0.0, atol=1e-6).sum() > 600
    assert rates.max() < 6.0 + 1e-6


def test_a_turn_ends_ahead_of_the_leg_on_its_line() -> None:
    poses = flown(TRACK, 10.0)
    for before, here in pairwise(poses):
        if before.on_leg < 0 <= here.on_leg:
            run_in = [pose for pose in poses if here.time_s - RUN_IN_S < pose.time_s < here.time_s - 0.1]
            assert len(run_in) >= 28
            assert all(
                abs(planned_legs(LAWNMOWER)[here.on_leg].along_across(p.east_m, p.north_m)[1]) < 1e-9 for p in run_in
            )


def test_legs_that_go_straight_on_are_flown_without_a_loop() -> None:
    plan = Waypoints(points_m=((0.0, 0.0), (0.0, 30.0), (0.0, 60.0), (0.0, 90.0)))
    poses = flown(structs.replace(TRACK, plan=plan, speed_mps=2.0))
    assert {pose.on_leg for pose in poses} == {0, 1, 2}
    assert len(poses) == 450
    gap = Vehicle(TRACK, [Leg(0.0, 0.0, 0.0, 10.0), Leg(0.0, 12.0, 2.0 * math.pi, 10.0)], 1, flat)
    assert [index for index, _ in groupby(gap.poses(10.0), key=lambda pose: pose.on_leg)] == [0, -1, 1]


def test_poses_depend_on_their_time_not_on_the_steps_to_it() -> None:
    track = structs.replace(TRACK, motion=Motion(current_mps=0.4))
    poses, twice_as_many = flown(track, 5.0), flown(track, 10.0)
    assert poses == twice_as_many[::2][: len(poses)]


def test_a_silent_vehicle_begins_each_leg_at_its_start_when_it_would_get_there() -> None:
    motion = Motion(current_mps=0.3, sway_sigma_m=0.0)
    track = structs.replace(TRACK, plan=CORNERS, motion=motion)
    silent = flown(structs.replace(track, pings_in_turns=False), 3.0)
    legs = planned_legs(CORNERS)
    firsts = [next(run) for _, run in groupby(silent, key=lambda pose: pose.on_leg)]
    assert [pose.on_leg for pose in firsts] == [0, 1, 2, 3]
    for pose, leg in zip(firsts, legs, strict=True):
        assert (pose.east_m, pose.north_m) == pytest.approx((leg.east_m, leg.north_m), abs=1e-9)
    heard = flown(track, 100.0)
    for pose in firsts:
        reached = next(other for other in heard if other.on_leg == pose.on_leg)
        assert reached.time_s - 0.01 - 1e-6 <= pose.time_s <= reached.time_s + 1e-6
    assert np.diff(column(silent, "time_s")).min() > 1.0 / 3.0 - 1e-9


def test_attitude_sway_speed_and_altitude_wander_by_their_standard_deviations() -> None:
    motion = Motion(
        roll_sigma_deg=2.0, pitch_sigma_deg=0.5, heading_sigma_deg=1.0, pitch_offset_deg=3.0, altitude_lag_s=0.0
    )
    track = Track(plan=Lawnmower(n_legs=1, leg_m=20_000.0), speed_mps=5.0, start_time_s=0.0, motion=motion)
    poses = flown(track, 4.0, seed=4)
    speed_ahead = column(poses, "speed_mps") * np.cos(column(poses, "course_rad"))
    wanders = {
        "roll": (np.degrees(column(poses, "roll_rad")), 0.0, 2.0, motion.attitude_period_s),
        "pitch": (np.degrees(column(poses, "pitch_rad")), 3.0, 0.5, motion.attitude_period_s),
        "heading": (np.degrees(column(poses, "heading_rad")), 0.0, 1.0, motion.attitude_period_s),
        "sway": (column(poses, "east_m"), 0.0, motion.sway_sigma_m, WANDER_PERIOD_S),
        "speed": (speed_ahead, 5.0, 5.0 * 0.03, WANDER_PERIOD_S),
        "depth": (column(poses, "depth_m"), DEPTH_M - track.altitude_m, motion.altitude_sigma_m, WANDER_PERIOD_S),
    }
    for name, (values, mean, sigma, period_s) in wanders.items():
        n_eff = len(values) / 4.0 / correlated_s(period_s)
        assert np.mean((values - mean) ** 2) == pytest.approx(sigma**2, rel=4.0 * math.sqrt(2.0 / n_eff)), name
        assert abs(np.mean(values) - mean) < 4.0 * sigma / math.sqrt(n_eff), name
    series = np.array([values for values, *_ in wanders.values()])
    slow = len(poses) / 4.0 / correlated_s(WANDER_PERIOD_S)
    assert np.abs(np.corrcoef(series) - np.eye(len(series))).max() < 4.5 / math.sqrt(slow)


def correlated_s(period_s: float) -> float:
    """Time per independent sample of the square: the integral of the squared correlation."""
    omega = 2.0 * math.pi / period_s
    damped = omega * math.sqrt(1.0 - DAMPING**2)
    lag = np.linspace(0.0, 10.0 * period_s, 20_001)
    correlation = np.exp(-DAMPING * omega * lag) * (
        np.cos(damped * lag) + DAMPING * omega / damped * np.sin(damped * lag)
    )
    return float(2.0 * np.sum(correlation**2) * (lag[1] - lag[0]))


@pytest.mark.parametrize("motion", [Motion(), Motion(sway_sigma_m=8.0, speed_sigma_percent=30.0, current_mps=1.0)])
def test_course_and_speed_are_those_of_the_positions(motion: Motion) -> None:
    poses = flown(structs.replace(TRACK, motion=motion), 50.0)
    east, north = column(poses, "east_m"), column(poses, "north_m")
    course, speed = column(poses, "course_rad"), column(poses, "speed_mps")
    error_east = (east[2:] - east[:-2]) * 25.0 - (speed * np.sin(course))[1:-1]
    error_north = (north[2:] - north[:-2]) * 25.0 - (speed * np.cos(course))[1:-1]
    off = np.hypot(error_east, error_north)
    assert np.median(off) < 1e-3
    assert (
        np.quantile(off, 0.98) < 0.01
    )  # curvature jumps where turns begin and end, and speed with it if the vehicle is set off sideways
    assert speed.max() < 4.0 * TRACK.speed_mps


def test_a_vehicle_never_stops_or_drifts_backwards() -> None:
    motion = Motion(speed_sigma_percent=30.0, current_mps=STRONGEST_CURRENT * TRACK.speed_mps, sway_sigma_m=0.0)
    for pose in flown(structs.replace(TRACK, motion=motion, pings_in_turns=False), 2.0, seed=3):
        assert pose.speed_mps > 0.9 * SLOWEST * TRACK.speed_mps
        assert math.cos(pose.course_rad - planned_legs(LAWNMOWER)[pose.on_leg].direction_rad) > 0.999


def test_without_lag_the_depth_follows_the_floor_exactly() -> None:
    def wavy(east_m: float, north_m: float) -> float:
        return 15.0 + 2.0 * math.sin(0.3 * east_m) * math.cos(0.2 * north_m)

    for pose in Vehicle(TRACK, planned_legs(LAWNMOWER), 1, wavy).poses(5.0):
        assert wavy(pose.east_m, pose.north_m) - pose.depth_m == pytest.approx(TRACK.altitude_m, abs=1e-12)


def test_with_lag_the_depth_answers_a_step_of_the_floor_as_a_first_order_system() -> None:
    plan = Lawnmower(n_legs=1, leg_m=100.0)
    track = structs.replace(TRACK, plan=plan, speed_mps=2.0, motion=structs.replace(STEADY, altitude_lag_s=4.0))
    step = Vehicle(track, planned_legs(plan), 1, lambda east_m, north_m: 20.0 if north_m < 20.0 else 17.0)
    for pose in step.poses(7.0):
        since = pose.time_s - 10.0
        expected = 14.0 if since < 0.0 else 11.0 + 3.0 * math.exp(-since / 4.0)
        assert pose.depth_m == pytest.approx(expected, abs=3.0 * 0.05 / 4.0)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.7, 12.0), st.integers(0, 100))
def test_the_vehicle_stays_off_the_floor_and_under_water(floor_m: float, seed: int) -> None:
    track = structs.replace(TRACK, motion=Motion(altitude_sigma_m=5.0))
    rough = Vehicle(track, planned_legs(LAWNMOWER), seed, lambda east_m, north_m: floor_m + max(0.0, math.sin(east_m)))
    for pose in rough.poses(1.0):
        floor = floor_m + max(0.0, math.sin(pose.east_m))
        assert MIN_DEPTH_M - 1e-12 <= pose.depth_m <= floor - MIN_ALTITUDE_M + 1e-12


NEW = (Leg(30.0, 80.0, math.radians(200.0), 40.0), Leg(-20.0, 40.0, math.radians(10.0), 30.0))


def redirected(track: Track, after: int, rate_hz: float = 10.0) -> list[SonarPose]:
    flying = vehicle(track)
    poses = []
    for number, pose in enumerate(flying.poses(rate_hz)):
        poses.append(pose)
        if number == after:
            flying.follow(NEW)
    assert flying.done
    return poses


@pytest.mark.parametrize("after", [0, 123, 340, 500])  # at the start, on a leg, where a turn begins, in a turn
@pytest.mark.parametrize("motion", [STEADY, Motion(current_mps=0.3)])
def test_a_new_plan_changes_the_course_from_now_on_and_not_before(after: int, motion: Motion) -> None:
    track = structs.replace(TRACK, motion=motion)
    poses, unchanged = redirected(track, after), flown(track)
    assert poses[: after + 1] == unchanged[: after + 1]
    assert poses[after + 150] != unchanged[after + 150]
    assert poses == redirected(track, after)
    east, north, heading = (column(poses, name) for name in ("east_m", "north_m", "heading_rad"))
    assert np.hypot(np.diff(east), np.diff(north)).max() < 0.1 * 1.3 * (TRACK.speed_mps + motion.current_mps)
    assert np.abs(turned(np.diff(heading))).max() < math.radians(0.801 + 2.5 * motion.heading_sigma_deg)


def test_a_new_plan_is_flown_in_full_under_new_numbers() -> None:
    flying = vehicle(TRACK)
    before = list(islice(flying.poses(10.0), 100))
    flying.follow(NEW)
    after = list(flying.poses(10.0))
    assert flying.legs == (*planned_legs(LAWNMOWER), *NEW)
    assert {pose.on_leg for pose in before} == {0}
    assert {pose.on_leg for pose in after} == {-1, 3, 4}
    renumbered = [pose._replace(on_leg=pose.on_leg - 3 if pose.on_leg >= 0 else -1) for pose in after]
    check_flown_in_full(renumbered, NEW, TRACK, 10.0)


def test_a_new_plan_also_works_for_a_silent_vehicle() -> None:
    silent = redirected(structs.replace(TRACK, pings_in_turns=False), 123)
    assert [index for index, _ in groupby(silent, key=lambda pose: pose.on_leg)] == [0, 3, 4]
    assert [silent[124].east_m, silent[124].north_m] == pytest.approx([30.0, 80.0], abs=1e-9)


def test_after_its_plan_the_vehicle_is_ready_for_another() -> None:
    flying = vehicle(TRACK)
    assert list(flying.poses(10.0))
    assert flying.done
    flying.follow(NEW)
    assert not flying.done
    assert {pose.on_leg for pose in flying.poses(10.0)} == {-1, 3, 4}
    flying.follow(NEW[:1])
    assert next(flying.poses(10.0)).on_leg == -1
    flying.follow(())
    assert flying.done
    assert list(flying.poses(10.0)) == []


def test_what_cannot_be_flown_is_refused() -> None:
    with pytest.raises(UsageError, match="no leg"):
        Vehicle(TRACK, (), 1, flat)
    strong = structs.replace(TRACK, motion=structs.replace(STEADY, current_mps=1.5))
    with pytest.raises(UsageError, match=r"`track\.motion\.current_mps` is 1\.5.*at most 1\.44"):
        vehicle(strong)
