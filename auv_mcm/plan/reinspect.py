"""Plan straight legs past contacts that are still undecided, each seen from the direction that adds most information.

A cylinder seen end-on may look like a stone; from a direction 90 degrees away it shows its side. Evenly spread aspects
are the best choice when nothing is known about an object's orientation (Bourque and Nguyen, "Optimal aspect angles for
multi-view target recognition with side-scan sonar", 2011), so every contact names the middle of the widest gap between
its own. The plan is a proposal: the vehicle decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.geometry.geodesy import LocalFrame, local_to_ecef_rotation
from auv_mcm.plan.dubins import PlanePose, dubins_lengths, dubins_path, sample_path
from auv_mcm.plan.tour import short_tour
from auv_mcm.plan.turns import ARC_STEP_RAD
from auv_mcm.records import Contact, Waypoint
from auv_mcm.settings.plan_settings import PlanConfig

Place: TypeAlias = tuple[float, float]
"""Latitude and longitude, degrees."""

# straight run before and after the leg proper, in turn radii: the turn's yaw rate has died away
SETTLING_RADII: Final = 1.0
_MIN_STEP_M: Final = 1e-3  # way-points closer than this are one
_DETOUR_M: Final = 1e6  # longer than any real tour
_BLOCK: Final = 1 << 18  # pairs of legs measured at once, bounds memory


class _Leg(NamedTuple):
    """Hold one of the four ways to pass a contact.

    `entry` and `exit` lie in the plan's plane, `ends_deg` are their latitude and longitude.
    """

    contact: Contact
    look_side: str
    track_deg: float
    entry: PlanePose
    exit: PlanePose
    ends_deg: tuple[tuple[float, float], tuple[float, float]]


def needs_second_look(contact: Contact, min_p_mine: float) -> bool:
    """Check whether a contact is a likely mine at a known place that another view may decide."""
    if not (contact.p_mine >= min_p_mine and contact.next_look_deg):
        return False
    return all(map(math.isfinite, (contact.latitude_deg, contact.longitude_deg, contact.next_look_deg[0])))


def most_undecided(contacts: Iterable[Contact], config: PlanConfig) -> tuple[Contact, ...]:
    """Choose the `max_contacts` that need a second view most."""
    undecided = (contact for contact in contacts if needs_second_look(contact, config.min_p_mine))
    return tuple(sorted(undecided, key=lambda contact: (abs(contact.p_mine - 0.5), contact.id))[: config.max_contacts])


def plan_reinspection(
    contacts: Iterable[Contact],
    start_latitude_deg: float,
    start_longitude_deg: float,
    start_heading_rad: float,
    config: PlanConfig,
    may_run: Callable[[Place, Place], bool] = lambda entry, leaving: True,
    more_time: Callable[[], bool] = lambda: True,
    settling_m: float = 0.0,
) -> tuple[Waypoint, ...]:
    """Plan way-points from the start pose past the `max_contacts` most undecided contacts, in sailing order.

    Each contact is viewed from the first of its `next_look_deg` or from the opposite, whichever makes the shorter tour.

    Per leg: `turn` points, `leg_entry` and `leg_exit`; a contact lies abeam of the middle of its leg at `stand_off_m`.
    The leg is `leg_length_m` long plus a settling distance at both ends. `heading_rad` is the true course at each
    point, [0, 2 pi). Turns are planned a little wider than `turn_radius_m` so that the circles that touch the sides of
    the way-point polygon from inside are not tighter than it either. Equal input gives equal plans while there is time.
    Empty if no contact needs a second view.

    Parameters
    ----------
    may_run
        Whether a leg from place to place is wanted; others are planned only where a contact leaves no choice.
    more_time
        Whether a long tour may still be made shorter.
    settling_m
        Minimum settling distance, for a vehicle that leaves a leg so far before its end.

    Raises BadInputError if there are contacts to visit but the start pose is not finite.
    """
    chosen = most_undecided(contacts, config)
    if not chosen:
        return ()
    if not all(map(math.isfinite, (start_latitude_deg, start_longitude_deg, start_heading_rad))):
        raise BadInputError(
            f"re-inspection plan: the start pose is not known (latitude {start_latitude_deg}, longitude "
            f"{start_longitude_deg}, heading {start_heading_rad} rad); give a navigated pose to start from"
        )
    frame = LocalFrame(latitude_deg=start_latitude_deg, longitude_deg=start_longitude_deg)
    start = PlanePose(0.0, 0.0, start_heading_rad)
    radius_m = config.turn_radius_m / math.cos(ARC_STEP_RAD / 2.0)
    half_m = config.leg_length_m / 2.0 + max(SETTLING_RADII * config.turn_radius_m, settling_m)
    legs = [leg for contact in chosen for leg in _ways_past(contact, frame, config.stand_off_m, half_m)]
    unwanted_m = np.array([0.0 if may_run(*leg.ends_deg) else _DETOUR_M for leg in legs])
    tour = short_tour(_connections(start, legs, radius_m) + _shares(unwanted_m), more_time)
    return _waypoints(
        start, (start_latitude_deg, start_longitude_deg), [legs[index] for index in tour], radius_m, frame, config
    )


def _ways_past(contact: Contact, plan_frame: LocalFrame, stand_off_m: float, half_m: float) -> list[_Leg]:
    """Lay four legs per contact: on either side, in either direction. Number i sailed backwards is number i ^ 1.

    Legs reach half_m to either side of their middle. They are laid out in the contact's own frame: true north at the
    contact is what its aspects refer to, which matters near the poles.
    """
    frame = LocalFrame(latitude_deg=contact.latitude_deg, longitude_deg=contact.longitude_deg)
    course_deg = contact.next_look_deg[0] - 90.0
    course = math.radians(course_deg)
    along, right = (
        np.array([math.sin(course), math.cos(course), 0.0]),
        np.array([math.cos(course), -math.sin(course), 0.0]),
    )
    legs = []
    for side in (1.0, -1.0):  # the track runs on this side (1: right) of the contact, as seen along the course
        for way in (1.0, -1.0):
            track_deg = (course_deg + (0.0 if way > 0.0 else 180.0)) % 360.0
            middle = side * stand_off_m * right
            latitude, longitude, height = frame.to_geodetic(
                [middle - way * half_m * along, middle + way * half_m * along]
            )
            (east0, north0, _), (east1, north1, _) = plan_frame.to_enu(
                latitude, longitude, np.zeros_like(height)
            ).tolist()
            heading = math.atan2(east1 - east0, north1 - north0)
            ends = (float(latitude[0]), float(longitude[0])), (float(latitude[1]), float(longitude[1]))
            look_side = "port" if side * way > 0.0 else "starboard"
            legs.append(
                _Leg(
                    contact,
                    look_side,
                    track_deg,
                    PlanePose(east0, north0, heading),
                    PlanePose(east1, north1, heading),
                    ends,
                )
            )
    return legs


def _connections(start: PlanePose, legs: list[_Leg], radius_m: float) -> NDArray[np.float64]:
    """Compute (n + 1, n) lengths from the start (row 0) and from every leg's exit to every leg's entry."""
    entries = np.array([leg.entry for leg in legs])
    exits = np.array([start, *(leg.exit for leg in legs)])
    cost = np.empty((len(exits), len(entries)))
    rows = max(1, _BLOCK // len(entries))
    for row in range(0, len(exits), rows):
        cost[row : row + rows] = dubins_lengths(exits[row : row + rows, np.newaxis], entries[np.newaxis], radius_m)
    return cost


def _shares(unwanted_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the extra cost of ways, (n + 1, n), half on either side, so that a reversed tour costs the same."""
    return 0.5 * (np.concatenate([[0.0], unwanted_m])[:, np.newaxis] + unwanted_m)


def _waypoints(
    start: PlanePose,
    start_deg: tuple[float, float],
    legs: list[_Leg],
    radius_m: float,
    frame: LocalFrame,
    config: PlanConfig,
) -> tuple[Waypoint, ...]:
    waypoints: list[Waypoint] = []

    def add(leg: int, kind: str, place_deg: tuple[float, float], heading_rad: float, why: str) -> None:
        latitude, longitude = place_deg
        course = heading_rad % (2.0 * math.pi)
        waypoints.append(
            Waypoint(
                leg=leg,
                kind=kind,
                latitude_deg=latitude,
                longitude_deg=longitude,
                heading_rad=course,
                contact_id=legs[leg - 1].contact.id,
                why=why,
            )
        )

    add(1, "start", start_deg, start.heading_rad, "where the plan starts")
    pose = start
    for number, leg in enumerate(legs, start=1):
        path = sample_path(dubins_path(pose, leg.entry, radius_m), ARC_STEP_RAD)
        steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
        turns = path[1:][(steps > _MIN_STEP_M) & (np.hypot(*(path[1:, :2] - leg.entry[:2]).T) > _MIN_STEP_M)]
        for latitude, longitude, course in np.column_stack(on_the_globe(turns, frame)).tolist():
            add(number, "turn", (latitude, longitude), course, f"turn towards {leg.contact.id}")
        why = _reason(leg, config)
        add(number, "leg_entry", leg.ends_deg[0], _true_course(*leg.ends_deg), why)
        add(number, "leg_exit", leg.ends_deg[1], _true_course(leg.ends_deg[1], leg.ends_deg[0]) + math.pi, why)
        pose = leg.exit
    return tuple(waypoints)


def on_the_globe(
    poses: NDArray[np.float64], frame: LocalFrame
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Convert (n, 3) poses in a plane to (n,) latitudes, longitudes and true courses in [0, 2 pi).

    The plane's north turns against true north, most near the poles.
    """
    level = np.zeros(len(poses))
    ahead = np.column_stack([np.sin(poses[:, 2]), np.cos(poses[:, 2]), level])
    here = np.column_stack([poses[:, :2], level])
    latitude, longitude, _ = frame.to_geodetic(here)
    step = (ahead @ frame.rotation().T)[:, np.newaxis] @ local_to_ecef_rotation(latitude, longitude)
    course = np.mod(np.arctan2(step[:, 0, 0], step[:, 0, 1]), 2.0 * math.pi)
    return latitude, longitude, np.where(course >= 2.0 * math.pi, 0.0, course)


def _true_course(here_deg: tuple[float, float], there_deg: tuple[float, float]) -> float:
    east, north, _ = LocalFrame(latitude_deg=here_deg[0], longitude_deg=here_deg[1]).to_enu(*there_deg, 0.0)
    return math.atan2(east, north)


def _reason(leg: _Leg, config: PlanConfig) -> str:
    contact = leg.contact
    looks = "one view" if len(contact.aspects_deg) == 1 else f"{len(contact.aspects_deg)} views"
    look_deg = round(leg.track_deg + (90.0 if leg.look_side == "starboard" else -90.0)) % 360
    return (
        f"second view of {contact.id}: p_mine {contact.p_mine:.2f} is undecided after {looks}; this leg looks towards "
        f"{look_deg:03d}°, in the widest gap between the directions viewed, {config.stand_off_m:.1f} m to "
        f"{leg.look_side} at its middle"
    )
