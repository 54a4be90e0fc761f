"""A steered vehicle keeps within its limits whatever the command, and goes on with its own plan afterwards."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from auv_mcm.errors import UsageError
from drivers.vehicle.dialect import Command, GoTo, Steer, Vertical
from sim_replay.simulator.plan import local_frame, planned_legs
from sim_replay.simulator.scene import STEADY, Lawnmower, Motion, Origin, Track
from sim_replay.simulator.steered import FASTEST, SAFE_ALTITUDE_M, STEEPEST_RAD, SteeredVehicle
from sim_replay.simulator.vehicle import MIN_ALTITUDE_M, MIN_DEPTH_M, SonarPose

RATE_HZ = 20.0
FRAME = local_frame(Origin())
CURRENT = structs.replace(STEADY, current_mps=0.8, current_towards_deg=80.0)
TRACK = Track(
    plan=Lawnmower(heading_deg=35.0, n_legs=3, leg_m=50.0, spacing_m=20.0),
    speed_mps=4.0,
    turn_rate_deg_s=30.0,
    start_time_s=0.0,
    motion=CURRENT,
)


def floor(east_m: float, north_m: float) -> float:
    return 20.0 + 3.0 * math.sin(0.2 * east_m) * math.cos(0.15 * north_m)


def vehicle(track: Track = TRACK, seed: int = 1) -> SteeredVehicle:
    return SteeredVehicle(track, planned_legs(track.plan), seed, FRAME, floor)


def place(east_m: float, north_m: float, radius_m: float = 3.0, speed_mps: float = 4.0) -> GoTo:
    latitude_deg, longitude_deg, _ = FRAME.to_geodetic((east_m, north_m, 0.0))
    return GoTo(float(latitude_deg), float(longitude_deg), Vertical("altitude", 5.0), speed_mps, radius_m)


speeds_mps = st.floats(0.0, 50.0)
verticals = st.builds(Vertical, st.sampled_from(["depth", "altitude"]), st.floats(0.0, 40.0))
commands = st.one_of(
    st.none(),
    st.builds(Steer, st.floats(-10.0, 10.0), verticals, speeds_mps),
    st.builds(
        lambda east_m, north_m, vertical, speed_mps: place(east_m, north_m, 3.0, speed_mps)._replace(vertical=vertical),
        st.floats(-80.0, 80.0),
        st.floats(-80.0, 80.0),
        verticals,
        speeds_mps,
    ),
)
histories = st.lists(st.tuples(commands, st.integers(1, 120)), min_size=1, max_size=6)
currents = st.builds(
    lambda current_mps, towards_deg: structs.replace(STEADY, current_mps=current_mps, current_towards_deg=towards_deg),
    st.sampled_from([0.0, 0.4, 1.2]),
    st.floats(0.0, 360.0),
)


def flown(history: list[tuple[Command | None, int]], track: Track = TRACK, at_once: int = 1000) -> list[SonarPose]:
    """Each command is held for a number of poses."""
    steered = vehicle(track)
    poses: list[SonarPose] = []
    for command, n_poses in history:
        steered.steer(command)
        left = n_poses
        while left > 0:
            poses += steered.fly(min(at_once, left), RATE_HZ)
            left -= at_once
    return poses


def fly_until_done(steered: SteeredVehicle) -> list[SonarPose]:
    poses: list[SonarPose] = []
    while not steered.done:
        poses += steered.fly(1, RATE_HZ)
        assert len(poses) < 200 * RATE_HZ, "it never gets through its plan"
    return poses


@settings(max_examples=25, deadline=None)
@given(histories, currents)
def test_no_command_makes_it_do_what_it_cannot_or_brings_it_near_the_floor(
    history: list[tuple[Command | None, int]], motion: Motion
) -> None:
    poses = flown(history, structs.replace(TRACK, motion=motion))
    east, north, depth, heading, speed = np.array(
        [(p.east_m, p.north_m, p.depth_m, p.heading_rad, p.speed_mps) for p in poses]
    ).T
    assert np.abs(np.diff(heading)).max(initial=0.0) * RATE_HZ <= math.radians(TRACK.turn_rate_deg_s) * (1.0 + 1e-9)
    assert speed.max() <= FASTEST * TRACK.speed_mps + motion.current_mps + 1e-9
    rise = np.abs(np.diff(depth)).max(initial=0.0) * RATE_HZ
    floors = np.array([floor(*place_m) for place_m in zip(east, north, strict=True)])
    assert (floors - depth >= MIN_ALTITUDE_M - 1e-9).all()
    assert (depth >= MIN_DEPTH_M).all()
    if (floors - depth > MIN_ALTITUDE_M + 1e-9).all():  # nothing makes it rise faster than a floor that would hit it
        assert rise <= FASTEST * TRACK.speed_mps * math.sin(STEEPEST_RAD) + 1e-9
    steps = np.hypot(np.diff(east), np.diff(north)) * RATE_HZ
    np.testing.assert_allclose(steps, 0.5 * (speed[1:] + speed[:-1]), atol=0.15)


@settings(max_examples=20, deadline=None)
@given(histories, st.integers(1, 50))
def test_where_it_is_depends_on_the_commands_and_not_on_how_many_poses_are_asked_for_at_once(
    history: list[tuple[Command | None, int]], at_once: int
) -> None:
    motion = structs.replace(Motion(), current_mps=0.5)
    track = structs.replace(TRACK, motion=motion)
    assert flown(history, track) == flown(history, track, at_once)


@settings(max_examples=20, deadline=None)
@given(histories, st.floats(-80.0, 80.0), st.floats(-80.0, 80.0), currents)
def test_every_place_is_reached_in_any_current(
    history: list[tuple[Command | None, int]], east_m: float, north_m: float, motion: Motion
) -> None:
    steered = vehicle(structs.replace(TRACK, motion=motion))
    for command, n_poses in history:
        steered.steer(command)
        steered.fly(n_poses, RATE_HZ)
    steered.steer(place(east_m, north_m))
    poses = steered.fly(round(150 * RATE_HZ), RATE_HZ)
    assert min(math.hypot(pose.east_m - east_m, pose.north_m - north_m) for pose in poses) <= 3.0


@settings(max_examples=20, deadline=None)
@given(histories, currents)
def test_its_own_plan_is_flown_in_full_whatever_came_between(
    history: list[tuple[Command | None, int]], motion: Motion
) -> None:
    steered = vehicle(structs.replace(TRACK, motion=motion))
    poses = []
    for command, n_poses in history:
        steered.steer(command)
        own = steered.fly(n_poses, RATE_HZ)
        poses += own if command is None else []
    steered.steer(None)
    poses += fly_until_done(steered)
    assert steered.legs_flown == len(steered.legs)
    for number, leg in enumerate(steered.legs):
        along, across = np.array(
            [leg.along_across(pose.east_m, pose.north_m) for pose in poses if pose.on_leg == number]
        ).T
        near = np.sort(along[np.abs(across) < 1.0])
        gaps_m = np.diff(np.concatenate([[0.0], near, [leg.length_m]]))
        assert gaps_m.max() < 1.0


def test_left_alone_it_keeps_to_its_legs_against_the_current() -> None:
    steered = vehicle()
    across = [
        abs(steered.legs[p.on_leg].along_across(p.east_m, p.north_m)[1])
        for p in fly_until_done(steered)
        if p.on_leg >= 0
    ]
    assert max(across) < 0.7
    assert np.median(across) < 0.05


def test_a_held_heading_drifts_with_the_current() -> None:
    steered = vehicle()
    steered.steer(Steer(math.radians(170.0), Vertical("depth", 10.0), 3.0))
    steered.fly(400, RATE_HZ)
    first, *_, last = steered.fly(201, RATE_HZ)
    towards = math.radians(CURRENT.current_towards_deg)
    east_mps = 3.0 * math.sin(math.radians(170.0)) + 0.8 * math.sin(towards)
    north_mps = 3.0 * math.cos(math.radians(170.0)) + 0.8 * math.cos(towards)
    assert (last.east_m - first.east_m) / 10.0 == pytest.approx(east_mps, abs=0.01)
    assert (last.north_m - first.north_m) / 10.0 == pytest.approx(north_mps, abs=0.01)
    assert last.heading_rad % (2.0 * math.pi) == pytest.approx(math.radians(170.0), abs=1e-3)
    assert last.depth_m == pytest.approx(10.0, abs=0.01)


def test_too_deep_a_depth_ends_at_the_safe_altitude() -> None:
    steered = SteeredVehicle(TRACK, planned_legs(TRACK.plan), 1, FRAME, lambda east_m, north_m: 20.0)
    steered.steer(Steer(0.0, Vertical("depth", 500.0), 4.0))
    assert steered.fly(400, RATE_HZ)[-1].depth_m == pytest.approx(20.0 - SAFE_ALTITUDE_M, abs=0.01)


def test_at_its_place_it_holds_its_course() -> None:
    steered = vehicle()
    steered.steer(place(40.0, 60.0))
    *_, before, last = steered.fly(900, RATE_HZ)
    assert last.course_rad == pytest.approx(before.course_rad, abs=1e-6)
    assert math.hypot(last.east_m - 40.0, last.north_m - 60.0) > 20.0


def test_what_cannot_be_flown_is_refused() -> None:
    with pytest.raises(UsageError, match="no leg"):
        SteeredVehicle(TRACK, (), 1, FRAME, floor)
    with pytest.raises(UsageError, match="current_mps"):
        vehicle(structs.replace(TRACK, motion=structs.replace(STEADY, current_mps=3.3)))
