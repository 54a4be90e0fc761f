"""The inside of a fence, against looking at many points one by one."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.geometry.fence import circles_inside, runs_inside
from auv_mcm.plan.dubins import PlanePose, dubins_lengths, dubins_paths, sample_path
from auv_mcm.plan.limits import turns_inside
from tests.auv_mcm.plan.survey_worlds import LIMITS

Points = NDArray[np.float64]
PLACE = st.floats(-100.0, 100.0)
RADII = st.lists(st.floats(20.0, 100.0), min_size=3, max_size=8)


def star(radii: list[float]) -> Points:
    angle = np.linspace(0.0, 2.0 * math.pi, len(radii), endpoint=False)
    return np.asarray(np.column_stack([np.sin(angle), np.cos(angle)]) * np.array(radii)[:, np.newaxis])


def depth_m(point: Points, fence: Points) -> float:
    """Distance to the nearest edge, negative outside: by how often the fence winds around the point."""
    angles, nearest = 0.0, math.inf
    for a, b in zip(fence, np.roll(fence, -1, axis=0), strict=True):
        share = min(max(float((point - a) @ (b - a) / ((b - a) @ (b - a))), 0.0), 1.0)
        nearest = min(nearest, float(np.hypot(*(point - a - share * (b - a)))))
        angles += math.remainder(math.atan2(*(b - point)) - math.atan2(*(a - point)), 2.0 * math.pi)
    return nearest if abs(angles) > math.pi else -nearest


@given(RADII, PLACE, PLACE, st.floats(0.0, 40.0), st.floats(0.0, 10.0))
def test_a_circle_is_inside_if_its_centre_lies_deep_enough(
    radii: list[float], east: float, north: float, radius: float, margin: float
) -> None:
    fence, centre = star(radii), np.array([east, north])
    depth = depth_m(centre, fence)
    if abs(depth - radius - margin) > 1e-6 and abs(depth) > 1e-6:
        assert bool(circles_inside(centre, radius, fence, margin)) is (depth >= radius + margin)


@given(RADII, PLACE, PLACE, PLACE, PLACE, st.floats(0.0, 10.0))
def test_a_run_is_inside_if_all_of_its_points_are(
    radii: list[float], east0: float, north0: float, east1: float, north1: float, margin: float
) -> None:
    fence, start, end = star(radii), np.array([east0, north0]), np.array([east1, north1])
    inside = bool(runs_inside(start[np.newaxis], end[np.newaxis], fence, margin)[0])
    depths = [depth_m(start + share * (end - start), fence) for share in np.linspace(0.0, 1.0, 101)]
    step = float(np.hypot(*(end - start))) / 100.0
    if min(depths) < margin - 1e-6:
        assert not inside
    elif min(depths) > margin + step:
        assert inside


@given(st.lists(st.builds(PlanePose, PLACE, PLACE, st.floats(-7.0, 7.0)), min_size=2, max_size=2), st.floats(1.0, 30.0))
def test_between_poses_with_room_for_a_circle_a_way_stays_inside_a_convex_fence(
    poses: list[PlanePose], radius: float
) -> None:
    fence = np.array([[-110.0, -110.0], [-120.0, 100.0], [90.0, 130.0], [120.0, -100.0]])
    leave, arrive = turns_inside(np.array(poses), radius, LIMITS._replace(fence=fence))
    length = float(dubins_lengths(poses[0], poses[1], radius, leave, arrive))
    # Two turns to one side can always be joined by a straight, turns to different sides only far enough apart.
    assert math.isfinite(length) or not (leave & arrive).any()
    assert math.isinf(length) or (leave[:, np.newaxis] & arrive).any()
    assert length >= float(dubins_lengths(poses[0], poses[1], radius)) - 1e-6
    if math.isfinite(length):
        (path,) = dubins_paths(np.array([poses]), radius, leave[np.newaxis], arrive[np.newaxis])
        assert path is not None
        assert min(depth_m(place, fence) for place in sample_path(path, 0.05)[:, :2]) > -1e-6
