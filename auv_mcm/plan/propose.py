"""Make the re-inspection plan that is proposed to a vehicle: legs past undecided contacts that stay inside its
fence."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import islice, takewhile
from typing import NamedTuple

import numpy as np

from auv_mcm.clearance.area import in_plane
from auv_mcm.geometry.fence import Points, circles_inside, runs_inside
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.look_again import LEAVES_LEG_M, PlanRequest, Proposal
from auv_mcm.plan.reinspect import plan_reinspection
from auv_mcm.records import Contact, Waypoint
from auv_mcm.settings.plan_settings import PlanConfig
from auv_mcm.settings.vehicle_settings import VehicleConfig


def propose(
    contacts: Iterable[Contact],
    request: PlanRequest,
    plan: PlanConfig,
    vehicle: VehicleConfig,
    more_time: Callable[[], bool] = lambda: True,
) -> Proposal:
    """Plan from a pose through all legs that stay inside the fence by at least its margin and the radius of arrival.

    A contact is left out, with a reason in `refused`, if its leg leaves the fence or cannot be reached from the leg
    before without a turn outside. Legs beyond the track that is left are left out as well.

    Parameters
    ----------
    more_time
        Whether there is time to leave out one contact after the other, and to order the rest anew each time. Without,
        the plan ends before the first leg that cannot be reached, and the rest is for the next one.
    """
    fence = _Fence(vehicle)
    wanted = [contact for contact in contacts if contact.id not in request.left_out]
    refused: dict[str, str] = {}
    while True:
        chosen = [contact for contact in wanted if contact.id not in refused]
        pose = request.latitude_deg, request.longitude_deg, request.heading_rad
        leaves_m = vehicle.arrival_radius_m + LEAVES_LEG_M
        waypoints = plan_reinspection(chosen, *pose, plan, lambda *ends: fence.holds(ends), more_time, leaves_m)
        legs = _checked(waypoints, fence)
        outside = _outside(legs, fence)
        if outside and not more_time() and (n_inside := _n_inside(legs)):
            waypoints, outside = waypoints[:n_inside], {}
        if not outside:
            return Proposal(_within(waypoints, plan.max_track_m - request.sailed_m), tuple(refused.items()))
        refused |= outside


class _Fence:
    """Keep ways inside the fence by at least min_m metres."""

    def __init__(self, vehicle: VehicleConfig) -> None:
        self._frame = LocalFrame(latitude_deg=vehicle.fence_deg[0][0], longitude_deg=vehicle.fence_deg[0][1])
        self._corners = self._points(vehicle.fence_deg)
        self.min_m = vehicle.fence_margin_m + vehicle.arrival_radius_m

    def holds(self, places_deg: Iterable[tuple[float, float]]) -> bool:
        """Check whether the way from place to place stays inside."""
        points = self._points(places_deg)
        at_ends = circles_inside(points, 0.0, self._corners, self.min_m)
        return bool(at_ends.all() and runs_inside(points[:-1], points[1:], self._corners, self.min_m).all())

    def _points(self, places_deg: Iterable[tuple[float, float]]) -> Points:
        return in_plane(list(places_deg), self._frame)


def _within(waypoints: tuple[Waypoint, ...], track_m: float) -> tuple[Waypoint, ...]:
    """Keep the legs, from the first on, that a track of this length suffices for."""
    if not waypoints:
        return ()
    frame = LocalFrame(latitude_deg=waypoints[0].latitude_deg, longitude_deg=waypoints[0].longitude_deg)
    points = in_plane([(point.latitude_deg, point.longitude_deg) for point in waypoints], frame)
    way_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    ends = [n for n, point in enumerate(waypoints, start=1) if point.kind == "leg_exit" and way_m[n - 1] <= track_m]
    return waypoints[: max(ends, default=0)]


class _Checked(NamedTuple):
    """Hold a leg of a plan: how many way-points there are up to its end, and whether it and the turn towards it stay
    inside the fence."""

    contact_id: str
    n_until_end: int
    leg_holds: bool
    turn_holds: bool


def _checked(waypoints: tuple[Waypoint, ...], fence: _Fence) -> list[_Checked]:
    places = [(point.latitude_deg, point.longitude_deg) for point in waypoints]
    found = []
    for at, point in enumerate(waypoints):
        if point.kind == "leg_exit":
            first = next(k for k, other in enumerate(waypoints) if other.leg == point.leg and other.kind != "start")
            before = max(first - 1, 1)  # the vehicle is where it is when the plan is made
            leg_holds, turn_holds = fence.holds(places[at - 1 : at + 1]), fence.holds(places[before:at])
            found.append(_Checked(point.contact_id, at + 1, leg_holds, turn_holds))
    return found


def _outside(legs: list[_Checked], fence: _Fence) -> dict[str, str]:
    """Find contacts, with reasons, whose legs leave the fence; where none does, the first whose turns do."""
    why = f"comes within {fence.min_m:g} m of the fence or leads out of it"
    outside = {leg.contact_id: f"its leg {why}" for leg in legs if not leg.leg_holds}
    turns = {leg.contact_id: f"the turn towards it {why}" for leg in legs if not leg.turn_holds}
    return outside or dict(islice(turns.items(), 1))


def _n_inside(legs: list[_Checked]) -> int:
    """Count the way-points up to the first leg or turn that leaves the fence."""
    held = takewhile(lambda leg: leg.leg_holds and leg.turn_holds, legs)
    return max((leg.n_until_end for leg in held), default=0)
