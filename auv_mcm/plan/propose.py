"""The re-inspection plan that is proposed to a vehicle: legs past undecided contacts, none of which leads out of its fence."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from auv_mcm.config import PlanConfig
from auv_mcm.geodesy import LocalFrame
from auv_mcm.plan.look_again import PlanRequest, Proposal
from auv_mcm.plan.reinspect import plan_reinspection
from auv_mcm.records import Contact, Waypoint
from auv_mcm.vehicle_config import VehicleConfig

Points = NDArray[np.float64]


def propose(contacts: Iterable[Contact], request: PlanRequest, plan: PlanConfig, vehicle: VehicleConfig) -> Proposal:
    """The plan from a pose through all legs that stay inside the fence, by its margin and the radius of arrival at least.

    A contact whose leg does not, or that cannot be reached from the one before without a turn outside, is left out, which `refused` says.
    """
    fence = _Fence(vehicle)
    wanted = [contact for contact in contacts if contact.id not in request.left_out]
    refused: dict[str, str] = {}
    while True:
        chosen = [contact for contact in wanted if contact.id not in refused]
        pose = request.latitude_deg, request.longitude_deg, request.heading_rad
        waypoints = plan_reinspection(chosen, *pose, plan, may_run=lambda *ends: fence.holds(ends))
        outside = _outside(waypoints, fence)
        if not outside:
            return Proposal(waypoints, tuple(refused.items()))
        refused |= outside


class _Fence:
    """least_m: so far inside it ways have to stay."""

    def __init__(self, vehicle: VehicleConfig) -> None:
        self._frame = LocalFrame(latitude_deg=vehicle.fence_deg[0][0], longitude_deg=vehicle.fence_deg[0][1])
        self._corners = self._points(vehicle.fence_deg)
        self.least_m = vehicle.fence_margin_m + vehicle.arrival_radius_m

    def holds(self, places_deg: Iterable[tuple[float, float]]) -> bool:
        """Whether the way from place to place stays inside."""
        return keeps_inside(self._points(places_deg), self._corners, self.least_m)

    def _points(self, places_deg: Iterable[tuple[float, float]]) -> Points:
        latitude_deg, longitude_deg = np.array(list(places_deg)).T
        return self._frame.to_enu(latitude_deg, longitude_deg, np.zeros_like(latitude_deg))[:, :2]


def _outside(waypoints: tuple[Waypoint, ...], fence: _Fence) -> dict[str, str]:
    """Contacts, with reasons, whose legs lead out of the fence; where all legs stay inside, the first whose turns do not."""
    places = [(point.latitude_deg, point.longitude_deg) for point in waypoints]
    why = f"comes within {fence.least_m:g} m of the fence or leads out of it"
    legs: dict[str, str] = {}
    turns: dict[str, str] = {}
    for at, point in enumerate(waypoints):
        if point.kind != "leg_exit":
            continue
        if not fence.holds(places[at - 1 : at + 1]):
            legs[point.contact_id] = f"its leg {why}"
        first = next(k for k, other in enumerate(waypoints) if other.leg == point.leg and other.kind != "start")
        before = max(first - 1, 1)  # the vehicle is where it is when the plan is made
        if not turns and not fence.holds(places[before:at]):
            turns[point.contact_id] = f"the turn towards it {why}"
    return legs or turns


def keeps_inside(path: Points, fence: Points, margin_m: float) -> bool:
    """Whether a path of straight pieces stays in a polygon, margin_m from its edges. path (n, 2), fence (k, 2): east and north, m."""
    starts, ends = fence, np.roll(fence, -1, axis=0)
    if not _all_within(path, starts, ends):
        return False
    if any(_cross(a, b, starts, ends) for a, b in pairwise(path)):
        return False
    distances = np.concatenate([_to_segments(path, starts, ends).ravel(), _to_segments(fence, path[:-1], path[1:]).ravel()])
    return float(distances.min()) >= margin_m


def _all_within(points: Points, starts: Points, ends: Points) -> bool:
    """By the even-odd rule: a ray to the east crosses the edges an odd number of times."""
    east, north = points[:, :1], points[:, 1:]
    spans = (starts[:, 1] > north) != (ends[:, 1] > north)
    rise = np.where(ends[:, 1] == starts[:, 1], 1.0, ends[:, 1] - starts[:, 1])
    at_east = starts[:, 0] + (north - starts[:, 1]) / rise * (ends[:, 0] - starts[:, 0])
    return bool(np.all(np.count_nonzero(spans & (at_east > east), axis=1) % 2 == 1))


def _cross(a: Points, b: Points, starts: Points, ends: Points) -> bool:
    """Whether the line from a to b crosses one of the edges."""

    def side(p: Points, q: Points, r: Points) -> Points:
        along, to = q - p, r - p
        turn: Points = along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]
        return turn

    apart = side(a, b, starts) * side(a, b, ends) <= 0.0
    return bool(np.any(apart & (side(starts, ends, a) * side(starts, ends, b) <= 0.0)))


def _to_segments(points: Points, starts: Points, ends: Points) -> Points:
    """(n, k) distances from n points to k segments."""
    along = ends - starts
    length2 = np.maximum(np.sum(along**2, axis=1), 1e-12)
    share = np.clip(np.sum((points[:, None] - starts) * along, axis=2) / length2, 0.0, 1.0)
    distance: Points = np.linalg.norm(points[:, None] - (starts + share[..., None] * along), axis=2)
    return distance
