"""Plan the baseline: parallel lines laid before the mission without knowledge of the sea floor.

Spacing and number of passes are the shortest for which the clearance expected on an assumed sea floor is the ordered
one (mean over the area of 1 - prod(1 - P_k), B. O. Koopman, "Search and Screening", 1946), with the same worth of
looks, the same discount for looks from one direction and the same gap below the vehicle as the adaptive planner counts
with.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import HIGHEST_P, LookModel
from auv_mcm.plan.dubins import PlanePose, dubins_lengths
from auv_mcm.plan.limits import Limits
from auv_mcm.records import NAN, SEABED_TYPES, SeabedType
from sim_replay.simulator.plan import Leg

Array = NDArray[np.float64]

MAX_LINES: Final = 12  # of one direction
_CELL_M: Final = 4.0  # m: side of the cells whose clearance is averaged
_N_CRESTS: Final = 6  # directions of ripple crests averaged over half a turn


class LawnmowerLegs(NamedTuple):
    """Hold the legs of a lawnmower.

    legs: in order of flying, the first set of lines northwards and back, the second, if any, eastwards and back.

    length_m: from the start to the end of the last leg. expected: mean p_detected on the assumed sea floor.
    """

    n_north: int
    n_east: int
    legs: tuple[Leg, ...]
    length_m: float
    expected: float


def shortest_lawnmower(
    side_m: float, required: float, assumed: dict[SeabedType, float], model: LookModel, limits: Limits, start: PlanePose
) -> LawnmowerLegs | None:
    """Find the shortest lawnmower that is expected to clear a square as required.

    It has up to MAX_LINES lines each way; None if none is expected to.

    assumed: shares of the kinds of sea floor, of which the ripples may run in any direction.
    """
    candidates = sorted(_lawnmowers(side_m, limits, start), key=lambda each: each.length_m)
    for candidate in candidates:
        expected = expected_clearance(candidate.legs, side_m, assumed, model, limits)
        if expected >= required:
            return candidate._replace(expected=expected)
    return None


def worst_seabed(model: LookModel, limits: Limits) -> SeabedType:
    """Return the known kind of sea floor on which one look at the swath finds fewest targets."""
    ground_m = np.linspace(*limits.swath, 32)
    known = [kind for kind in SEABED_TYPES if kind != "unknown"]
    return min(known, key=lambda kind: float(_p(model, kind, ground_m, np.zeros(32), limits).mean()))


def expected_clearance(
    legs: Sequence[Leg], side_m: float, assumed: dict[SeabedType, float], model: LookModel, limits: Limits
) -> float:
    """Average p_detected over the square, were it everywhere the assumed mixture.

    Of a further look counts what `ClearanceMap` counts.
    """
    near_m, far_m = limits.swath
    middle = (np.arange(math.ceil(side_m / _CELL_M)) + 0.5) * side_m / math.ceil(side_m / _CELL_M)
    east, north = (part.ravel() for part in np.meshgrid(middle, middle))
    kinds = list(assumed)
    exponent = np.zeros((len(kinds), len(east)))
    seen = np.zeros((4, len(east)), dtype=bool)  # from each of the four directions
    for leg in legs:
        sine, cosine = math.sin(leg.direction_rad), math.cos(leg.direction_rad)
        across = (east - leg.east_m) * cosine - (north - leg.north_m) * sine
        for sense in (1.0, -1.0):
            ground_m = sense * across
            part = np.clip(np.minimum(ground_m - near_m, far_m - ground_m) / _CELL_M + 0.5, 0.0, 1.0)
            cells = np.flatnonzero(part)
            if not len(cells):
                continue
            look_rad = (leg.direction_rad + sense * 0.5 * math.pi) % (2.0 * math.pi)
            direction = round(look_rad / (0.5 * math.pi)) % 4
            first = ~seen[:, cells].any(axis=0)
            again = seen[direction, cells]
            weight = np.where(
                first, 1.0, np.where(again, 1.0 - model.same_look_correlation, 1.0 - model.other_look_correlation)
            )
            for number, kind in enumerate(kinds):
                p = part[cells] * _p(model, kind, ground_m[cells], np.full(len(cells), look_rad), limits)
                exponent[number, cells] -= weight * np.log1p(-p)
            seen[direction, cells] = True
    share = np.array(list(assumed.values()))
    return float(share @ -np.expm1(-exponent).mean(axis=1) / share.sum())


def _p(model: LookModel, kind: SeabedType, ground_m: Array, look_rad: Array, limits: Limits) -> Array:
    """Return (n,) probability of one look; with ripples the mean over the directions that they may have."""
    crests = np.arange(_N_CRESTS) * math.pi / _N_CRESTS if kind == "ripple" else np.array([NAN])
    n, m = len(ground_m), len(crests)
    p = model.p_look(
        np.full(n * m, SEABED_TYPES.index(kind), dtype=np.uint8),
        np.repeat(ground_m, m).astype(np.float32),
        np.full(n * m, limits.altitude_m, dtype=np.float32),
        np.repeat(look_rad, m).astype(np.float32),
        np.tile(crests, n).astype(np.float32),
    )
    return np.asarray(np.clip(p, 0.0, HIGHEST_P).reshape(n, m).mean(axis=1))


def _lawnmowers(side_m: float, limits: Limits, start: PlanePose) -> Iterator[LawnmowerLegs]:
    for n_north in range(1, MAX_LINES + 1):
        for n_east in range(MAX_LINES + 1):
            legs = [*_lines(side_m, n_north, 0.0, limits, start)]
            if n_east:
                last = legs[-1]
                legs += _lines(side_m, n_east, 0.5 * math.pi, limits, PlanePose(*last.end, last.direction_rad))
            yield LawnmowerLegs(n_north, n_east, tuple(legs), way_m(legs, limits, start), NAN)


def _lines(side_m: float, n_lines: int, direction_rad: float, limits: Limits, start: PlanePose) -> list[Leg]:
    """Return evenly spaced lines there and back, begun at the corner that is nearest to the start."""
    length_m = side_m + 2.0 * limits.settling_m
    offsets = [(number + 0.5) * side_m / n_lines for number in range(n_lines)]

    def leg(offset: float, back: bool) -> Leg:
        along = side_m + limits.settling_m if back else -limits.settling_m
        place = (offset, along) if direction_rad == 0.0 else (along, offset)
        return Leg(*place, direction_rad + (math.pi if back else 0.0), length_m)

    ways = [
        [leg(offset, bool((number + first) % 2)) for number, offset in enumerate(order)]
        for order in (offsets, offsets[::-1])
        for first in (0, 1)
    ]
    return min(ways, key=lambda legs: way_m(legs, limits, start))


def way_m(legs: Sequence[Leg], limits: Limits, start: PlanePose) -> float:
    """Return the length of the legs and of the shortest turns to and between them."""
    entries = [PlanePose(leg.east_m, leg.north_m, leg.direction_rad) for leg in legs]
    exits = [start, *(PlanePose(*leg.end, leg.direction_rad) for leg in legs[:-1])]
    return float(dubins_lengths(exits, entries, limits.turn_radius_m).sum()) + sum(leg.length_m for leg in legs)
