"""Lay straight legs past contacts that are undecided, and weigh what one more view of each is worth.

A view calls a mine a mine with the probability p that it finds one there, and clutter a mine with FALSE_CALL. The
expected drop of the entropy of p_mine by such a call is its information. A further view of one object mostly repeats
the first, so only the part NEWS of it counts.

Contacts and unsearched sea floor are compared by entropy. Mines that lie at random with density q per square metre have
an entropy of q (1 - ln q) nats per square metre (a sparse Poisson process located to the square metre). At the mean
density a nat at a contact is therefore worth NAT_M2 square metres searched.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np

from auv_mcm.clearance.clearance_map import HIGHEST_P, Clearance, LookModel
from auv_mcm.clearance.detection_performance import CellView
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.dubins import Array
from auv_mcm.plan.limits import Limits
from auv_mcm.plan.tracks import RIGHT, enterable
from auv_mcm.records import NAN, SEABED_TYPES, Contact

NEWS: Final = 0.2  # share of a further view's information that the first has not; for planning only, chosen
FALSE_CALL: Final = 0.1  # probability that a view calls clutter a mine; for planning only, chosen, not measured
LOOK_RUN_M: Final = 30.0  # straight, with the contact abeam of its middle, beside the settling
_MINES_M2: Final = 5e-6  # per square metre: the density that plans are weighed by
NAT_M2: Final = 1.0 / (_MINES_M2 * (1.0 - math.log(_MINES_M2)))
_RANGES: Final = 16  # stand-offs tried per side; finer than half a metre on a usual swath is lost in steering
# of the best stand-off's probability: among equals the middle one tolerates most error of steering
_AS_GOOD: Final = 0.98
_MIN_M2: Final = 1e-6  # m² worth of a gain: less is rounding


class ContactLegs(NamedTuple):
    """Hold the ways to view one contact again.

    runs: (1 or 2, 2, 3) poses of entry and exit, one per side. look_deg: true direction of view, or its opposite.
    """

    contact: Contact
    runs: Array
    gain_m2: float
    look_deg: float
    stand_off_m: float


class _Request(NamedTuple):
    contact: Contact
    look_deg: float
    look_rad: float  # in the plane
    east_m: float
    north_m: float


def information_nats(p_mine: float, p_look: float) -> float:
    """Compute the expected drop of the entropy of p_mine by one call, before NEWS."""
    called = p_mine * p_look + (1.0 - p_mine) * FALSE_CALL
    after = 0.0
    for p_call, p_both in ((called, p_mine * p_look), (1.0 - called, p_mine * (1.0 - p_look))):
        if p_call > 0.0:
            after += p_call * _entropy(min(p_both / p_call, 1.0))
    return max(_entropy(p_mine) - after, 0.0)


def contact_legs(
    contacts: Iterable[Contact], clearance: Clearance, model: LookModel, limits: Limits
) -> list[ContactLegs]:
    """Lay legs past contacts that request another view, in order of id.

    Each contact gets the first of its directions that the fence allows and that adds information.
    """
    frame = LocalFrame(latitude_deg=clearance.origin_latitude_deg, longitude_deg=clearance.origin_longitude_deg)
    requests = []
    for contact in sorted(contacts, key=lambda contact: contact.id):
        place_deg = contact.latitude_deg, contact.longitude_deg
        if all(map(math.isfinite, (*place_deg, contact.p_mine, *contact.next_look_deg))):
            east, north, _ = frame.to_enu(*place_deg, 0.0).tolist()
            for look_deg in contact.next_look_deg:
                requests.append(
                    _Request(
                        contact,
                        look_deg,
                        _in_plane(math.radians(look_deg), place_deg, (east, north), frame),
                        east,
                        north,
                    )
                )
    if not requests:
        return []
    stand_off_m, p = _stand_offs(requests, clearance, model, limits)
    runs = np.array(
        [
            [_run(one.east_m, one.north_m, one.look_rad + turned, float(far_m), limits) for turned in (0.0, math.pi)]
            for one, far_m in zip(requests, stand_off_m, strict=True)
        ]
    )
    fits = enterable(runs.reshape(-1, 2, 3), limits).reshape(-1, 2)
    found: dict[str, ContactLegs] = {}
    for number, one in enumerate(requests):
        gain_m2 = NAT_M2 * NEWS * information_nats(min(max(one.contact.p_mine, 0.0), 1.0), float(p[number]))
        if gain_m2 > _MIN_M2 and fits[number].any() and one.contact.id not in found:
            sides = runs[number][fits[number]]
            found[one.contact.id] = ContactLegs(
                one.contact, sides, gain_m2, one.look_deg % 360.0, float(stand_off_m[number])
            )
    return list(found.values())


def _entropy(p: float) -> float:
    return -sum(q * math.log(q) for q in (p, 1.0 - p) if q > 0.0)


def _in_plane(
    bearing_rad: float, place_deg: tuple[float, float], place_m: tuple[float, float], frame: LocalFrame
) -> float:
    """Turn a true bearing into a direction in the plane.

    The plane's north differs from true north far from its origin and near the poles.
    """
    here = LocalFrame(latitude_deg=place_deg[0], longitude_deg=place_deg[1])
    latitude, longitude, _ = here.to_geodetic([math.sin(bearing_rad), math.cos(bearing_rad), 0.0])
    east, north, _ = (frame.to_enu(latitude, longitude, 0.0)).tolist()
    return math.atan2(east - place_m[0], north - place_m[1])


def _stand_offs(
    requests: list[_Request], clearance: Clearance, model: LookModel, limits: Limits
) -> tuple[Array, Array]:
    """Choose the stand-off of each request, (n,) m, and the probability of detection there, (n,).

    The stand-off is the middle of the ranges that are about as good as the best one, seen from the worse side.
    """
    near_m, far_m = limits.swath
    ground = near_m + (far_m - near_m) * (np.arange(_RANGES) + 0.5) / _RANGES
    row = np.array([math.floor(one.north_m / clearance.cell_m) for one in requests]) - clearance.first_north
    column = np.array([math.floor(one.east_m / clearance.cell_m) for one in requests]) - clearance.first_east
    n_north, n_east = clearance.seabed.shape
    known = (row >= 0) & (row < n_north) & (column >= 0) & (column < n_east)
    seabed = np.full(len(requests), SEABED_TYPES.index("unknown"), dtype=np.uint8)
    ripple, unevenness = (np.full(len(requests), NAN, dtype=np.float32) for _ in range(2))
    seabed[known] = clearance.seabed[row[known], column[known]]
    ripple[known] = clearance.ripple_rad[row[known], column[known]]
    unevenness[known] = clearance.unevenness_db[row[known], column[known]]
    look = np.add.outer([one.look_rad for one in requests], [0.0, math.pi]) % (2.0 * math.pi)
    view = CellView(
        seabed=seabed[:, None, None],
        ground_range_m=ground.astype(np.float32),
        altitude_m=np.float32(limits.altitude_m),
        look_rad=look.astype(np.float32)[..., None],
        ripple_rad=ripple[:, None, None],
        unevenness_db=unevenness[:, None, None],
    )
    p = np.clip(np.nan_to_num(model.p_look(view).min(axis=1), nan=0.0), 0.0, HIGHEST_P)
    good = [np.flatnonzero(of_one >= _AS_GOOD * of_one.max()) for of_one in p]
    best = np.array([ranges[len(ranges) // 2] for ranges in good])
    return ground[best], p[np.arange(len(requests)), best]


def _run(east: float, north: float, look_rad: float, stand_off_m: float, limits: Limits) -> list[list[float]]:
    """Lay a run that has the contact to starboard, towards look_rad."""
    heading = math.remainder(look_rad - RIGHT, 2.0 * math.pi)
    half_m = 0.5 * LOOK_RUN_M + limits.settling_m
    middle = east - stand_off_m * math.sin(look_rad), north - stand_off_m * math.cos(look_rad)
    return [
        [middle[0] + way * half_m * math.sin(heading), middle[1] + way * half_m * math.cos(heading), heading]
        for way in (-1.0, 1.0)
    ]
