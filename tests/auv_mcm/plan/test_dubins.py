"""Shortest paths: the end pose is met, nothing shorter exists, singular geometries add no circles."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.plan.dubins import Array, DubinsPath, PlanePose, Turn, dubins_lengths, dubins_path, sample_path

SIGN = {"left": -1.0, "straight": 0.0, "right": 1.0}
ANGLE = st.floats(-10.0, 10.0)
PLACE = st.floats(-500.0, 500.0)
# the search is no judge of displacements near rounding
NEAR = st.integers(-4000, 4000).map(lambda thousandth: thousandth / 1000.0)
COARSE_ANGLE = st.integers(-3142, 3142).map(lambda thousandth: thousandth / 1000.0)
RIGHT_ANGLES = st.integers(-4, 4).map(lambda quarter: quarter * math.pi / 2.0)


def drive(pose: PlanePose, turn: Turn, length_m: float, radius_m: float) -> PlanePose:
    """Exact motion along one segment, through the turn's centre."""
    east, north, heading = pose
    sign = SIGN[turn]
    if sign == 0.0:
        return PlanePose(east + length_m * math.sin(heading), north + length_m * math.cos(heading), heading)
    centre = (east + sign * radius_m * math.cos(heading), north - sign * radius_m * math.sin(heading))
    turned = heading + sign * length_m / radius_m
    return PlanePose(
        centre[0] - sign * radius_m * math.cos(turned), centre[1] + sign * radius_m * math.sin(turned), turned
    )


def arrive(path: DubinsPath) -> PlanePose:
    pose = path.start
    for turn, length in path.segments:
        pose = drive(pose, turn, length, path.turn_radius_m)
    return pose


def assert_meets(path: DubinsPath, end: PlanePose) -> None:
    reached = arrive(path)
    assert math.hypot(reached.east_m - end.east_m, reached.north_m - end.north_m) < 1e-9
    assert abs(math.remainder(reached.heading_rad - end.heading_rad, 2.0 * math.pi)) < 1e-9
    assert path.length_m == pytest.approx(sum(segment.length_m for segment in path.segments))
    assert all(segment.length_m >= 0.0 for segment in path.segments)


@given(PLACE, PLACE, ANGLE, PLACE, PLACE, ANGLE, st.floats(1.0, 100.0))
def test_the_end_pose_is_met(
    east0: float, north0: float, heading0: float, east1: float, north1: float, heading1: float, radius: float
) -> None:
    start, end = PlanePose(east0, north0, heading0), PlanePose(east1, north1, heading1)
    path = dubins_path(start, end, radius)
    assert_meets(path, end)
    assert path.length_m >= math.hypot(east1 - east0, north1 - north0) - 1e-9
    sampled = sample_path(path, 0.2)
    np.testing.assert_allclose(sampled[-1, :2], [east1, north1], atol=1e-9)


@given(st.integers(-6, 6), st.integers(-6, 6), RIGHT_ANGLES, RIGHT_ANGLES)
def test_touching_circles_and_tangent_straights_are_met_too(
    east: int, north: int, heading0: float, heading1: float
) -> None:
    """Whole multiples of the radius and right angles are where circles touch and angles are a hair from zero."""
    start, end = PlanePose(0.0, 0.0, heading0), PlanePose(10.0 * east, 10.0 * north, heading1)
    path = dubins_path(start, end, 10.0)
    assert_meets(path, end)
    assert path.length_m <= brute_force(start, end, 10.0) + 1e-6


@given(NEAR, NEAR, COARSE_ANGLE, COARSE_ANGLE)
def test_nothing_found_by_search_is_shorter(east: float, north: float, heading0: float, heading1: float) -> None:
    start, end = PlanePose(0.0, 0.0, heading0), PlanePose(east, north, heading1)
    length = dubins_path(start, end, 1.0).length_m
    found = brute_force(start, end, 1.0)
    assert length <= found + 1e-6
    assert found <= length + 1e-6, "the search must be as good, or it proves nothing"


def brute_force(start: PlanePose, end: PlanePose, radius: float) -> float:
    """Shortest of all two-arc-and-straight and three-arc paths by scanning the first arc and finding sign changes.

    For each first arc of either turn the second and third part are over-determined by one equation, whose roots along
    the first arc are bracketed on a grid and refined by bisection. No tangent formula is used here, nor which arcs are
    long.
    """
    best = math.inf
    for first in (-1.0, 1.0):
        for last in (-1.0, 1.0):
            centre = (
                end.east_m + last * radius * math.cos(end.heading_rad),
                end.north_m - last * radius * math.sin(end.heading_rad),
            )
            for middle in {0.0, -first} if first == last else {0.0}:
                best = min(best, scan(Ways(start, radius, first, middle, last, centre), end))
    return best


class Ways(NamedTuple):
    """Ways from a turn to a circle about `centre`: by a straight, or, with `middle`, by a third circle between them."""

    start: PlanePose
    radius: float
    first: float
    middle: float
    last: float
    centre: tuple[float, float]

    def leave(self, angle: Array) -> tuple[Array, Array, Array]:
        start, radius = self.start, self.radius
        heading = start.heading_rad + self.first * angle
        east = start.east_m + self.first * radius * (math.cos(start.heading_rad) - np.cos(heading))
        north = start.north_m - self.first * radius * (math.sin(start.heading_rad) - np.sin(heading))
        return east, north, heading

    def mismatch(self, angle: Array) -> Array:
        east, north, heading = self.leave(angle)
        if self.middle:  # the middle circle must touch the last one from outside
            middle_east = east + self.middle * self.radius * np.cos(heading)
            middle_north = north - self.middle * self.radius * np.sin(heading)
            apart = np.hypot(middle_east - self.centre[0], middle_north - self.centre[1])
            return np.asarray(apart - 2.0 * self.radius, dtype=np.float64)
        # the straight must pass the last centre at one radius, on the turn's side
        aside = (self.centre[0] - east) * np.cos(heading) - (self.centre[1] - north) * np.sin(heading)
        return np.asarray(aside - self.last * self.radius, dtype=np.float64)

    def between(self, angle: float) -> tuple[float, float]:
        """Length of what lies between both turns, and the heading at its end."""
        east, north, heading = (float(part) for part in self.leave(np.array(angle)))
        if not self.middle:
            along = (self.centre[0] - east) * math.sin(heading) + (self.centre[1] - north) * math.cos(heading)
            return along, heading
        middle_east = east + self.middle * self.radius * math.cos(heading)
        middle_north = north - self.middle * self.radius * math.sin(heading)
        contact = (middle_east + self.centre[0]) / 2.0, (middle_north + self.centre[1]) / 2.0
        # at the touching point the heading is square to the line from the middle centre
        outward = math.atan2(contact[0] - middle_east, contact[1] - middle_north)
        arrival = outward + self.middle * math.pi / 2.0
        return smallest_turn(self.middle * (arrival - heading)) * self.radius, arrival


def scan(ways: Ways, end: PlanePose) -> float:
    grid = np.linspace(0.0, 2.0 * np.pi, 2881)
    value, radius = ways.mismatch(grid), ways.radius
    low, high = grid[:-1], grid[1:]
    crossing = np.signbit(value[:-1]) != np.signbit(value[1:])
    low, high = low[crossing], high[crossing]
    sign = np.signbit(ways.mismatch(low))
    for _ in range(50):
        half = (low + high) / 2.0
        same = np.signbit(ways.mismatch(half)) == sign
        low, high = np.where(same, half, low), np.where(same, high, half)
    touching = grid[np.abs(value) < 1e-9 * radius]  # roots without a sign change
    best = math.inf
    for angle in [*low.tolist(), *touching.tolist()]:
        along, arrival = ways.between(angle)
        if along < -1e-6 * radius:
            continue
        best = min(
            best, angle * radius + max(along, 0.0) + smallest_turn(ways.last * (end.heading_rad - arrival)) * radius
        )
    return best


def smallest_turn(angle: float) -> float:
    turned = math.fmod(angle, 2.0 * math.pi)
    turned += 2.0 * math.pi if turned < 0.0 else 0.0
    return 0.0 if turned > 2.0 * math.pi - 1e-7 else turned


@given(
    st.lists(st.tuples(st.sampled_from(["left", "straight", "right"]), st.floats(0.0, 5.0)), min_size=1, max_size=5),
    ANGLE,
)
def test_no_drivable_path_is_shorter(moves: list[tuple[Turn, float]], heading: float) -> None:
    start = pose = PlanePose(3.0, -2.0, heading)
    for turn, length in moves:
        pose = drive(pose, turn, length, 1.0)
    path = dubins_path(start, pose, 1.0)
    assert path.length_m <= sum(length for _, length in moves) + 1e-8
    assert_meets(path, pose)


def test_known_lengths() -> None:
    ahead = dubins_path(PlanePose(0.0, 0.0, 0.0), PlanePose(0.0, 40.0, 0.0), 10.0)
    assert ahead.length_m == pytest.approx(40.0)
    u_turn = dubins_path(PlanePose(0.0, 0.0, 0.0), PlanePose(20.0, 0.0, math.pi), 10.0)
    assert [segment.turn for segment in u_turn.segments if segment.length_m > 1e-9] == ["right"]
    assert u_turn.length_m == pytest.approx(10.0 * math.pi)
    on_the_spot = dubins_path(PlanePose(0.0, 0.0, 0.0), PlanePose(0.0, 0.0, math.pi), 10.0)
    assert on_the_spot.length_m == pytest.approx(10.0 * 7.0 * math.pi / 3.0)  # three arcs: 60, 300, 60 degrees


def test_lengths_of_many_pairs_are_those_of_single_paths() -> None:
    poses = np.random.default_rng(4).uniform(-60.0, 60.0, (12, 3))
    table = dubins_lengths(poses[:, np.newaxis], poses[np.newaxis], 10.0)
    single = [[dubins_path(PlanePose(*start), PlanePose(*end), 10.0).length_m for end in poses] for start in poses]
    np.testing.assert_allclose(table, single, atol=1e-9)


def test_samples_stay_on_the_path() -> None:
    path = dubins_path(PlanePose(0.0, 0.0, 0.3), PlanePose(-35.0, 12.0, 2.0), 10.0)
    poses = sample_path(path, math.radians(15.0))
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    assert steps.sum() == pytest.approx(path.length_m, rel=0.004)  # chords of 15 degrees
    assert (np.abs(np.diff(poses[:, 2])) <= math.radians(15.0) + 1e-12).all()


@pytest.mark.parametrize(
    ("end", "radius"),
    [(PlanePose(math.nan, 0.0, 0.0), 1.0), (PlanePose(1.0, 0.0, math.inf), 1.0), (PlanePose(1.0, 0.0, 0.0), 0.0)],
)
def test_poses_that_are_no_poses_are_refused(end: PlanePose, radius: float) -> None:
    with pytest.raises(ValueError, match="no path from"):
        dubins_path(PlanePose(0.0, 0.0, 0.0), end, radius)
