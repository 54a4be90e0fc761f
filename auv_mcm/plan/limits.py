"""Hold what a plan must never break, and state why no plan may be possible at all."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.fence import Flags, circles_inside
from auv_mcm.plan.dubins import PlanePose


class Limits(NamedTuple):
    """Hold the limits of the vehicle and of the order, in metres.

    budget_m: length of track that is left, by energy and by time. fence: (n, 2) corners east, north in the mission's
    plane, possibly concave, None for none; legs and turns stay fence_margin_m inside. swath: nearest and farthest
    ground range that is used. settling_m: straight run before and after a leg earns nothing because the vehicle still
    swings.
    """

    turn_radius_m: float
    budget_m: float
    fence: NDArray[np.float64] | None
    altitude_m: float
    min_altitude_m: float
    swath: tuple[float, float]
    settling_m: float = 10.0
    fence_margin_m: float = 0.0


def obstacle(pose: PlanePose, limits: Limits) -> str:
    """State why nothing can be planned from here; empty if a plan may be possible."""
    near_m, far_m = limits.swath
    if not all(map(math.isfinite, pose)):
        return (
            f"the vehicle's pose is not known (east {pose.east_m} m, north {pose.north_m} m, heading "
            f"{pose.heading_rad} rad)"
        )
    if not (limits.turn_radius_m > 0.0 and math.isfinite(limits.turn_radius_m)):
        return f"a turn radius of {limits.turn_radius_m:g} m cannot be sailed"
    if not (0.0 <= near_m < far_m and math.isfinite(far_m)):
        return f"a swath from {near_m:g} to {far_m:g} m is empty"
    if not limits.altitude_m >= limits.min_altitude_m:
        return f"the survey altitude of {limits.altitude_m:g} m is below the minimum of {limits.min_altitude_m:g} m"
    if not limits.budget_m > 0.0:
        return "no track is left in the budget"
    if limits.fence is None:
        return ""
    if limits.fence.shape[0] < 3 or not np.isfinite(limits.fence).all():
        return "the fence must be a polygon of at least three known corners"
    here = np.array([pose.east_m, pose.north_m])
    if not circles_inside(here, 0.0, limits.fence, limits.fence_margin_m):
        return "the vehicle is outside its fence" + (
            f" or nearer to it than {limits.fence_margin_m:g} m" if limits.fence_margin_m else ""
        )
    return ""


def turns_inside(poses: NDArray[np.float64], radius_m: float, limits: Limits) -> Flags:
    """Check whether the full circles to the left and right of (..., 3) poses keep to the fence, (..., 2) bool."""
    if limits.fence is None:
        return np.ones((*poses.shape[:-1], 2), dtype=np.bool_)
    heading = poses[..., 2:]
    left = np.concatenate([-np.cos(heading), np.sin(heading)], axis=-1)
    centres = poses[..., np.newaxis, :2] + radius_m * np.stack([left, -left], axis=-2)
    return circles_inside(centres, radius_m, limits.fence, limits.fence_margin_m)
