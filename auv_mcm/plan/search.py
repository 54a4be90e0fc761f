"""Search for the best route: start from ladders and greedy choice, improve by turns while there is time."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from auv_mcm.plan.ladders import laddered_legs
from auv_mcm.plan.orienteering import (
    Problem,
    Wanting,
    best_route,
    exact_route,
    greedy_legs,
    route_length_m,
    shifted_legs,
    trimmed_legs,
    worth_m2,
)
from auv_mcm.plan.tracks import MoreTime
from auv_mcm.plan.turns import ends_of, rough_way_m

NEARLY_ALL: Final = 0.99  # of what is wanting: the rest is rounding of cells
_SHIFTS: Final = 3  # tracks that a leg may move to either side at a time; bounds time
# Share of the area that a metre of track can see: what it clears of what ladders leave open; 0: no ladder.
_TAILS: Final = (0.5, 0.25, 0.12, 0.06, 0.0)
_REBUILT: Final = 3
_MAX_FITTING: Final = 5
_MAX_REBUILDS: Final = 60
_MIN_BETTER_M2: Final = 1e-6
# Share of the area that a metre of track can see: its cost against gains, so that of equal plans the shorter is taken.
_TRACK_M2: Final = 0.02


class SearchedRoute(NamedTuple):
    """Hold a route and its worth."""

    problem: Problem  # with the legs that were cut for it
    route: list[int]
    worth_m2: float


def searched(problem: Problem, more_time: MoreTime) -> tuple[SearchedRoute, list[int]]:
    """Find the best route and the legs that it began with.

    Ladders and greedy choice make routes, in several proportions. Of the best route some legs in a row are taken out
    and chosen anew. Few contacts alone are tried in every set and order instead.
    """
    exact = exact_route(problem)
    if exact is not None:
        return SearchedRoute(problem, exact, _net_m2(problem, exact)), [way // 2 for way in exact]
    every = np.ones(problem.tracks.n_legs, dtype=np.bool_)
    fresh_m2 = 2.0 * (problem.limits.swath[1] - problem.limits.swath[0])  # that a metre sees at most
    best: SearchedRoute | None = None
    tried: set[tuple[int, ...]] = set()
    began: list[int] = []
    for share in _TAILS:
        ladder = laddered_legs(problem, 1.0 / (share * fresh_m2), more_time) if share else []
        legs = greedy_legs(problem, every, ladder, more_time)
        began = began or legs
        if tuple(sorted(legs)) not in tried:
            tried.add(tuple(sorted(legs)))
            found = improved(problem, legs, more_time)
            best = found if best is None or found.worth_m2 > best.worth_m2 else best
        if not more_time():
            break
    assert best is not None
    for first in range(_MAX_REBUILDS):
        if not more_time() or len(best.route) <= _REBUILT:
            break
        taken_out = {(first * (_REBUILT - 1) + k) % len(best.route) for k in range(_REBUILT)}
        kept = [way // 2 for place, way in enumerate(best.route) if place not in taken_out]
        every = np.ones(best.problem.tracks.n_legs, dtype=np.bool_)
        every[[best.route[place] // 2 for place in taken_out]] = False  # else they would come back
        found = improved(best.problem, greedy_legs(best.problem, every, kept, more_time), more_time)
        best = found if found.worth_m2 > best.worth_m2 + _MIN_BETTER_M2 else best
    return best, began


def improved(problem: Problem, legs: list[int], more_time: MoreTime) -> SearchedRoute:
    """Improve a choice of legs: shift, cut and order them, as long as there is time."""
    problem, legs = trimmed_legs(problem, shifted_legs(problem, legs, _SHIFTS, more_time), more_time)
    route = best_route(problem, legs, more_time)
    found = SearchedRoute(problem, route, _net_m2(problem, route))
    wanting = Wanting(problem)
    wanting.take_all(way // 2 for way in route)
    if worth_m2(problem, (way // 2 for way in route)) >= NEARLY_ALL * wanting_m2_of(problem) or (
        route and not more_time()
    ):
        return found
    # Rough ways have misjudged what the track suffices for: there may be some left.
    for leg in _fitting(problem, route, wanting):
        if found.route and not more_time():
            break
        fuller = best_route(problem, [*(way // 2 for way in found.route), leg], more_time)
        wanted_m2 = _net_m2(problem, fuller)
        found = SearchedRoute(problem, fuller, wanted_m2) if wanted_m2 > found.worth_m2 else found
    return found


def _net_m2(problem: Problem, route: list[int]) -> float:
    near_m, far_m = problem.limits.swath
    gain = worth_m2(problem, (way // 2 for way in route))
    return gain - _TRACK_M2 * 2.0 * (far_m - near_m) * route_length_m(problem, route)


def wanting_m2_of(problem: Problem) -> float:
    """Compute what could be gained by all there is to gain."""
    one_side = problem.other_side >= np.arange(problem.tracks.n_legs)
    floor_m2 = float(-np.expm1(-problem.cells.need) @ problem.cells.weight_m2)
    return min(floor_m2, problem.enough_m2) + float(problem.contact_m2[one_side].sum())


def _fitting(problem: Problem, route: list[int], wanting: Wanting) -> list[int]:
    """Choose legs that would still gain most per metre and fit into the rest of the track, by rough ways."""
    tracks = problem.tracks
    exits = np.array([problem.pose, *(ends_of(tracks, way)[1] for way in route)])
    entries = np.concatenate([tracks.run[:, 0], tracks.run[:, 1] + np.array([0.0, 0.0, math.pi])])
    track_m = tracks.length_m + rough_way_m(exits, entries, problem.turns.radius_m)
    taken = [way // 2 for way in route]
    fits = track_m <= problem.limits.budget_m - route_length_m(problem, route)
    fits[taken] = fits[problem.other_side[taken]] = False
    legs = np.flatnonzero(fits).tolist()
    gain_m2 = {leg: gain for leg in legs if (gain := wanting.gain_m2(leg)) > _MIN_BETTER_M2}
    return sorted(gain_m2, key=lambda leg: (-gain_m2[leg] / track_m[leg], leg))[:_MAX_FITTING]
