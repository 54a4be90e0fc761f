"""Hold the ordered area as cells of the mission's plane: the state of its search, and the expected effect of looks not
reported yet.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import HIGHEST_P, Clearance, LookModel, clearance_over, look_bit, unsearched
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.limits import Limits
from auv_mcm.plan.tracks import bits_alike
from auv_mcm.records import SIDES, Side
from sim_replay.adaptive.order import Order
from sim_replay.simulator.plan import Leg

Array = NDArray[np.float64]

_ACROSS_M: Final = 0.5  # m: step of the sum across the swath
_ALONG_M: Final = 1.0  # m: step of the sum along a leg


def clearance_over_order(
    clearance: Clearance | None, order: Order, origin: LocalFrame, plane: LocalFrame, cell_m: float
) -> Clearance:
    """Return the clearance of cells whose middles lie in the ordered area, and of no others.

    Nothing where nothing was seen.

    Parameters
    ----------
    origin
        The plane that the order is in.
    plane
        That of the clearance, and of the cells.
    """
    known = clearance or unsearched(plane.latitude_deg, plane.longitude_deg, cell_m)
    corner = plane.to_enu(origin.latitude_deg, origin.longitude_deg, 0.0)[:2]
    first = np.ceil(corner / cell_m - 0.5).astype(int)
    n_east, n_north = (np.ceil((corner + order.side_m) / cell_m - 0.5).astype(int) - first).tolist()
    return clearance_over(known, int(first[0]), int(first[1]), (n_north, n_east))


def with_expected(ground: Clearance, model: LookModel, limits: Limits, side: Side, track: Array) -> Clearance:
    """Add to the clearance the expected effect of a straight track on one side.

    track: (n, 3) east, north, heading in the clearance's plane, evenly spaced in time.
    """
    if len(track) < 2:
        return ground
    near_m, far_m = limits.swath
    step_m = float(np.hypot(*np.diff(track[:, :2], axis=0).T).mean())
    ground_m = np.arange(near_m + 0.5 * _ACROSS_M, far_m, _ACROSS_M)
    sense = 1.0 if side == "starboard" else -1.0
    east = track[:, :1] + sense * ground_m * np.cos(track[:, 2:])
    north = track[:, 1:2] - sense * ground_m * np.sin(track[:, 2:])
    n_north, n_east = ground.exponent.shape
    row = np.floor(north / ground.cell_m).astype(np.int64) - ground.first_north
    column = np.floor(east / ground.cell_m).astype(np.int64) - ground.first_east
    inside = (row >= 0) & (row < n_north) & (column >= 0) & (column < n_east)
    if not inside.any():
        return ground
    key = (row * n_east + column)[inside]
    look = np.broadcast_to(track[:, 2:] + sense * 0.5 * math.pi, inside.shape)[inside]
    count = np.bincount(key, minlength=n_north * n_east)
    cell = np.flatnonzero(count)

    def mean(value: Array) -> Array:
        return np.asarray(np.bincount(key, value, len(count))[cell] / count[cell])

    place = np.unravel_index(cell, ground.exponent.shape)
    look_rad = np.mod(np.arctan2(mean(np.sin(look)), mean(np.cos(look))), 2.0 * math.pi).astype(np.float32)
    p = model.p_look(
        ground.seabed[place],
        mean(np.broadcast_to(ground_m, inside.shape)[inside]).astype(np.float32),
        np.full(len(cell), limits.altitude_m, dtype=np.float32),
        look_rad,
        ground.ripple_rad[place],
    )
    fraction = np.minimum(count[cell] * step_m * _ACROSS_M / ground.cell_m**2, 1.0)
    again = np.where(ground.looks[place] > 0, 1.0 - model.other_look_correlation, 1.0)
    alike = (ground.towards[place] & bits_alike(look_rad)) != 0
    renewed = np.where(alike, 1.0 - model.same_look_correlation, again)
    exponent, looks, towards = ground.exponent.copy(), ground.looks.copy(), ground.towards.copy()
    exponent[place] -= renewed * np.log1p(-fraction * np.clip(p, 0.0, HIGHEST_P))
    looks[place] = np.minimum(looks[place], 254) + 1
    towards[place] |= look_bit(look_rad)
    return msgspec.structs.replace(ground, exponent=exponent, looks=looks, towards=towards)


def would_come_to(
    ground: Clearance, legs: Sequence[Leg], origin: LocalFrame, model: LookModel, limits: Limits
) -> float:
    """Return the mean clearance that legs would give over the known sea floor, were nothing else flown.

    legs: in the plane of `origin`, which is as good as parallel to the clearance's. Where nothing is known the worst is
    assumed.
    """
    here = LocalFrame(latitude_deg=ground.origin_latitude_deg, longitude_deg=ground.origin_longitude_deg)
    corner = here.to_enu(origin.latitude_deg, origin.longitude_deg, 0.0)
    flown = msgspec.structs.replace(
        ground,
        exponent=np.zeros_like(ground.exponent),
        looks=np.zeros_like(ground.looks),
        towards=np.zeros_like(ground.towards),
    )
    for leg in legs:
        along = np.arange(0.5 * _ALONG_M, leg.length_m, _ALONG_M)
        east = leg.east_m + float(corner[0]) + along * math.sin(leg.direction_rad)
        north = leg.north_m + float(corner[1]) + along * math.cos(leg.direction_rad)
        track = np.column_stack([east, north, np.full(len(along), leg.direction_rad)])
        for side in SIDES:
            flown = with_expected(flown, model, limits, side, track)
    return float(flown.p_detected.mean())
