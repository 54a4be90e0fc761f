"""Choose legs, their order and directions, so that the track that is left gains the maximum.

Legs gain what they add to the wanting miss exponent, cell by cell and up to what is wanting, and what a view of their
contact is worth. Such a gain never rises when more legs are sailed (it is submodular), so legs are chosen greedily by
gain per metre, with gains measured anew only where an old one could still be the best (M. Minoux, "Accelerated greedy
algorithms for maximizing submodular set functions", 1978; budgeted: J. Leskovec et al., "Cost-effective outbreak
detection in networks", 2007), then ordered as a tour and improved.

A way is 2 * leg, or 2 * leg + 1 for the leg sailed backwards. A route is a list of ways in order.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import LookModel
from auv_mcm.plan.dubins import Array, PlanePose, dubins_lengths
from auv_mcm.plan.limits import Limits
from auv_mcm.plan.tour import richest_tour, short_tour, tour_length
from auv_mcm.plan.tracks import Cells, MoreTime, Tracks, enterable, half_extent_m
from auv_mcm.plan.turns import Turns, ends_of, reverse_poses, rough_way_m

_NO_WAY_M: Final = 1e7  # m instead of infinity where no way is: more than any budget, and sums stay finite
_MIN_M2: Final = 1e-6  # m² worth of a gain: less is rounding
_ROUNDS: Final = 4  # of choice and order in turn; bounds time, the best found is kept
_SWEEPS: Final = 10  # over all legs, at most; it ends earlier when none moves
EXACT_LEGS: Final = 9  # up to which every order is tried; bounds time, 9 legs each either way
_OVERFULL: Final = 1.25  # of the budget, chosen by rough ways; exact ways then drop the excess
MIN_ALIKE: Final = 0.7
"""Minimum share of a repeated view from one direction that adds nothing new, as plans expect it; chosen.

Maps credit views that were flown by the tables alone, where 0.27 adds nothing new. Tables hold little about such pairs,
and what hides from one side may show from another: plans take legs from there where the tables see no difference.
"""
_MIN_CUT_M: Final = 2.0  # m that have to be saved: less is not worth a new request
_MADE_GOOD: Final = 0.1  # of all gains: what moving the others can recover of a leg that is left out


class Problem(NamedTuple):
    """Hold what a route is measured by.

    contact_m2: (n,) what a look at the leg's contact is worth. other_side: (n,) the leg on the other side of the same
    contact, else itself. enough_m2: what is gained of the sea floor beyond it is worth nothing.
    """

    tracks: Tracks
    contact_m2: Array
    other_side: NDArray[np.int64]
    cells: Cells
    model: LookModel
    pose: PlanePose
    limits: Limits
    turns: Turns
    enough_m2: float = math.inf


class Wanting:
    """Hold the miss exponent that cells still want as legs are sailed one after another."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._need = problem.cells.need.copy()
        self._missed_m2 = problem.cells.weight_m2.copy()
        self._towards = problem.cells.towards.copy()
        self._seen_again = 1.0 - problem.model.other_look_correlation
        self._seen_alike = 1.0 - max(problem.model.same_look_correlation, MIN_ALIKE)
        self._renewed = np.where(problem.cells.looked, self._seen_again, 1.0)

    def copy(self) -> Wanting:
        """Copy the state, so that legs can be tried."""
        other = Wanting.__new__(Wanting)
        other.__dict__ = {
            name: value.copy() if isinstance(value, np.ndarray) else value for name, value in self.__dict__.items()
        }
        return other

    def _added(self, leg: int) -> tuple[slice, NDArray[np.int32], Array]:
        """Give the elements of `Tracks` that a leg sees, their cells, and what it adds to each, up to what is
        wanting."""
        tracks = self._problem.tracks
        part = slice(tracks.first[leg], tracks.last[leg])
        cell = tracks.cell[part]
        alike = (self._towards[cell] & tracks.alike[part]) != 0
        renewed = np.where(alike, self._seen_alike, self._renewed[cell])
        return part, cell, np.minimum(self._need[cell], renewed * tracks.exponent[part])

    def per_cell(self, leg: int) -> tuple[slice, Array]:
        """Give the elements of `Tracks` that a leg sees, and what it would gain in each."""
        part, cell, added = self._added(leg)
        return part, -np.expm1(-added) * self._missed_m2[cell]

    def gain_m2(self, leg: int) -> float:
        """Compute what a leg adds to what was taken, m² worth."""
        _, cell, added = self._added(leg)
        return float(self._problem.contact_m2[leg] - np.expm1(-added) @ self._missed_m2[cell])

    def take(self, leg: int) -> float:
        """Sail the leg; return its gain."""
        part, cell, added = self._added(leg)
        gained = -np.expm1(-added) * self._missed_m2[cell]
        self._need[cell] -= added
        self._missed_m2[cell] -= gained
        self._renewed[cell] = self._seen_again
        self._towards[cell] |= self._problem.tracks.bit[part]
        return float(self._problem.contact_m2[leg] + gained.sum())

    def take_all(self, legs: Iterable[int]) -> float:
        """Take legs in turn and sum what they add, m² worth."""
        return sum(map(self.take, legs))


def gains_m2(problem: Problem, legs: list[int]) -> list[float]:
    """Compute what each leg adds to those before it."""
    wanting = Wanting(problem)
    return [wanting.take(leg) for leg in legs]


def worth_m2(problem: Problem, legs: Iterable[int]) -> float:
    """Compute what legs gain together, of the sea floor no more than is enough."""
    wanting = Wanting(problem)
    floor_m2 = contacts_m2 = 0.0
    for leg in legs:
        contact_m2 = float(problem.contact_m2[leg])
        floor_m2 += wanting.take(leg) - contact_m2
        contacts_m2 += contact_m2
    return min(floor_m2, problem.enough_m2) + contacts_m2


def greedy_legs(problem: Problem, among: NDArray[np.bool_], first: list[int], more_time: MoreTime) -> list[int]:
    """Order legs by gain per metre, after those in `first`, until gains or track are used up.

    The way to a leg counts from the nearest of those chosen before, by a straight line and the turns at its ends.
    """
    runs, length_m = problem.tracks.run, problem.tracks.length_m
    wanting = Wanting(problem)
    open_legs = among.copy()
    ends = np.concatenate([runs[:, 0], reverse_poses(runs[:, 1])])  # as entered
    way_m = rough_way_m(np.array([problem.pose]), ends, problem.turns.radius_m)
    chosen: list[int] = []
    used_m = floor_m2 = 0.0
    tracks_heading = problem.tracks.heading

    def choose(leg: int) -> None:
        nonlocal way_m, used_m, floor_m2
        used_m += float(length_m[leg] + way_m[leg])
        chosen.append(leg)
        gained_m2 = wanting.take(leg)
        floor_m2 += gained_m2 if tracks_heading[leg] >= 0 else 0.0
        open_legs[[leg, problem.other_side[leg]]] = False
        way_m = np.minimum(
            way_m, rough_way_m(np.stack([runs[leg, 1], reverse_poses(runs[leg, :1])[0]]), ends, problem.turns.radius_m)
        )

    for leg in first:
        choose(leg)
    gain = np.full(len(runs), np.inf)
    fresh = np.zeros(len(runs), dtype=np.bool_)
    for leg in np.flatnonzero(open_legs).tolist():
        gain[leg] = wanting.gain_m2(leg)
    while open_legs.any():
        rate = np.where(
            open_legs & (used_m + length_m + way_m <= _OVERFULL * problem.limits.budget_m),
            gain / (length_m + way_m),
            -1.0,
        )
        fresh[:] = not chosen or chosen == first
        while True:
            leg = int(np.argmax(rate))
            if rate[leg] <= 0.0 or fresh[leg]:
                break
            gain[leg] = wanting.gain_m2(leg)
            rate[leg], fresh[leg] = gain[leg] / (length_m[leg] + way_m[leg]), True
        if rate[leg] <= 0.0 or gain[leg] <= _MIN_M2:
            break
        choose(leg)
        if floor_m2 >= problem.enough_m2:
            open_legs &= tracks_heading < 0
        if not more_time():
            break
    return chosen


def shifted_legs(problem: Problem, legs: list[int], reach: int, more_time: MoreTime) -> list[int]:
    """Shift survey legs to the side as long as that gains more; drop legs that become needless."""
    best, best_m2 = legs, worth_m2(problem, legs)
    for _ in range(_SWEEPS):
        tried = _moved(problem, best, reach, more_time)
        tried_m2 = worth_m2(problem, tried)
        if tried_m2 <= best_m2 + _MIN_M2:
            break
        best, best_m2 = tried, tried_m2
    surveys = [leg for leg in best if problem.tracks.heading[leg] >= 0]
    if not more_time():
        return best
    for leg in sorted(surveys, key=lambda leg: _without(problem, best, leg).gain_m2(leg)):
        if not more_time():
            break
        fewer = [other for other in best if other != leg]
        fewer_m2 = worth_m2(problem, fewer)
        if _MIN_M2 < best_m2 - fewer_m2 < _MADE_GOOD * best_m2:
            fewer = _moved(problem, fewer, reach, more_time)
            fewer_m2 = worth_m2(problem, fewer)
        if leg in best and fewer_m2 >= best_m2 - _MIN_M2:
            best, best_m2 = fewer, fewer_m2
    return best


def _without(problem: Problem, legs: list[int], leg: int) -> Wanting:
    """Compute what is wanting after all legs but one."""
    wanting = Wanting(problem)
    wanting.take_all(other for other in legs if other != leg)
    return wanting


def _moved(problem: Problem, legs: list[int], reach: int, more_time: MoreTime) -> list[int]:
    tracks = problem.tracks
    legs = list(legs)
    before = Wanting(problem)
    for place, leg in enumerate(legs):
        if tracks.heading[leg] >= 0 and more_time():
            wanting = before.copy()
            wanting.take_all(legs[place + 1 :])
            beside = (tracks.heading == tracks.heading[leg]) & (np.abs(tracks.line - tracks.line[leg]) <= reach)
            options = [other for other in np.flatnonzero(beside).tolist() if other == leg or other not in legs]
            gains = [wanting.gain_m2(option) for option in options]
            best = int(np.argmax(gains))
            if gains[best] > gains[options.index(leg)] + _MIN_M2:
                legs[place] = options[best]
        before.take(legs[place])
    return legs


def trimmed_legs(problem: Problem, legs: list[int], more_time: MoreTime) -> tuple[Problem, list[int]]:
    """Cut legs back to what the others leave to them, as further legs of the problem; drop empty ones."""
    tracks, cells, limits = problem.tracks, problem.cells, problem.limits
    legs = list(legs)
    if not more_time():
        return problem, legs
    alone = {leg: _without(problem, legs, leg).gain_m2(leg) for leg in legs if tracks.heading[leg] >= 0}
    for leg in sorted(alone, key=lambda leg: (alone[leg], leg)):
        if not more_time():
            break
        part, gained = _without(problem, legs, leg).per_cell(leg)
        cell = tracks.cell[part]
        useful = np.flatnonzero(gained > _MIN_M2)
        at = legs.index(leg)
        if not len(useful):
            del legs[at]
            continue
        first, last = int(useful[0]), int(useful[-1])
        entry, leave = tracks.run[leg]
        sine, cosine = math.sin(entry[2]), math.cos(entry[2])
        along = cells.east_m[cell] * sine + cells.north_m[cell] * cosine
        margin_m = limits.settling_m + half_extent_m(cells.cell_m, float(entry[2]))
        forward_m = along[first] - (entry[0] * sine + entry[1] * cosine) - margin_m
        back_m = (leave[0] * sine + leave[1] * cosine) - along[last] - margin_m
        if forward_m + back_m < _MIN_CUT_M:
            continue
        ahead = np.array([sine, cosine, 0.0])
        run = np.stack([entry + max(forward_m, 0.0) * ahead, leave - max(back_m, 0.0) * ahead])
        if not enterable(run[np.newaxis], limits)[0]:
            continue
        problem = _with_leg(problem, leg, run, (part.start + first, part.start + last + 1))
        tracks = problem.tracks
        legs[at] = tracks.n_legs - 1
    return problem, legs


def _with_leg(problem: Problem, like: int, run: Array, part: tuple[int, int]) -> Problem:
    tracks = problem.tracks
    tracks = tracks._replace(
        run=np.concatenate([tracks.run, run[np.newaxis]]),
        first=np.append(tracks.first, part[0]),
        last=np.append(tracks.last, part[1]),
        line=np.append(tracks.line, tracks.line[like]),
        heading=np.append(tracks.heading, tracks.heading[like]),
    )
    contact_m2, other_side = np.append(problem.contact_m2, 0.0), np.append(problem.other_side, tracks.n_legs - 1)
    return problem._replace(tracks=tracks, contact_m2=contact_m2, other_side=other_side)


def best_route(problem: Problem, legs: list[int], more_time: MoreTime) -> list[int]:
    """Order the legs as a short tour, one of both sides per contact.

    Legs beyond the track, and those that no turn leads to, are left out.
    """
    cost, ways = _connections(problem, legs)
    worth = dict(zip(legs, gains_m2(problem, legs), strict=True))
    runs = problem.tracks.length_m[[way // 2 for way in ways]]
    left = list(range(len(legs)))
    route: list[int] = []
    for _ in range(_ROUNDS):
        picked = _tour(cost, left, more_time)
        if len(left) <= EXACT_LEGS and _tour_m(picked, cost, runs) > problem.limits.budget_m:
            picked = richest_tour(cost, runs, np.array([worth[leg] for leg in legs]), problem.limits.budget_m)
        picked = _within_budget(problem, picked, cost, runs, [worth[legs[way // 4]] for way in picked])
        route = [ways[way] for way in picked]
        blocked = _blocked(problem, route)
        left = sorted(way // 4 for way in picked)
        if not blocked:
            break
        for before, after in blocked:
            i, j = (picked[before] + 1 if before >= 0 else 0), picked[after]
            cost[i, j] = _NO_WAY_M
            if before >= 0:
                cost[(j ^ 1) + 1, picked[before] ^ 1] = _NO_WAY_M
    return sailable(problem, route)


def exact_route(problem: Problem) -> list[int] | None:
    """Find the route that gains most, of equal ones the shortest, by every set and order of few contacts.

    None where that would prove nothing: gains add up only without survey legs, and no route is shorter than connections
    say, so that what is best by them is best if a fence lets it be sailed.
    """
    legs = np.flatnonzero(problem.other_side >= np.arange(problem.tracks.n_legs)).tolist()
    if len(legs) > EXACT_LEGS or (problem.tracks.heading >= 0).any():
        return None
    cost, ways = _connections(problem, legs)
    runs = problem.tracks.length_m[[way // 2 for way in ways]]
    picked = richest_tour(cost, runs, problem.contact_m2[legs], problem.limits.budget_m)
    route = [ways[way] for way in picked]
    return route if sailable(problem, route) == route else None


def _tour_m(tour: list[int], cost: Array, runs: Array) -> float:
    return tour_length(tour, cost) + float(runs[tour].sum())


def _tour(cost: Array, items: list[int], more_time: MoreTime) -> list[int]:
    """Find a short tour through some of the items, as columns of the whole."""
    if not items:
        return []
    columns = np.add.outer(4 * np.array(items), np.arange(4)).ravel()
    part = cost[np.append(0, columns + 1)[:, np.newaxis], columns]
    return [int(columns[way]) for way in short_tour(part, more_time)]


def sailable(problem: Problem, route: list[int]) -> list[int]:
    """Drop legs of a route that no turn inside the fence leads to, and its end beyond the track."""
    kept: list[int] = []
    used_m = 0.0
    pose = problem.pose
    for way in route:
        entry, leave = ends_of(problem.tracks, way)
        path = problem.turns.between(pose, entry)
        if path is None:
            continue
        length_m = path.length_m + float(problem.tracks.length_m[way // 2])
        if used_m + length_m > problem.limits.budget_m:
            break
        used_m += length_m
        kept.append(way)
        pose = leave
    return kept


def route_length_m(problem: Problem, route: list[int]) -> float:
    """Measure a route that can be sailed."""
    poses = [problem.pose, *(pose for way in route for pose in ends_of(problem.tracks, way))]
    turns = problem.turns.all_between(list(pairwise(poses))[::2])
    return sum(path.length_m for path in turns if path is not None) + float(
        problem.tracks.length_m[[way // 2 for way in route]].sum()
    )


def _connections(problem: Problem, legs: list[int]) -> tuple[Array, list[int]]:
    """Compute costs as `tour` defines them, (4 n + 1, 4 n), and the way that each column stands for."""
    ways = [2 * side + way for leg in legs for side in (leg, int(problem.other_side[leg])) for way in (0, 1)]
    different, column = np.unique(ways, return_inverse=True)
    ends = [ends_of(problem.tracks, way) for way in different.tolist()]
    entries = np.array([entry for entry, _ in ends]).reshape(-1, 3)
    exits = np.array([problem.pose, *(leave for _, leave in ends)])
    leave, arrive = problem.turns.room(exits[:, np.newaxis]), problem.turns.room(entries[np.newaxis])
    if leave is not None:
        leave[0] = True  # see `Turns`
    cost = dubins_lengths(exits[:, np.newaxis], entries[np.newaxis], problem.turns.radius_m, leave, arrive)
    cost = np.where(np.isfinite(cost), cost, _NO_WAY_M)
    return cost[np.append(0, column + 1)[:, np.newaxis], column], ways


def _within_budget(problem: Problem, tour: list[int], cost: Array, runs: Array, worth: list[float]) -> list[int]:
    """Drop legs of the tour with the smallest gain per track until the budget suffices."""
    tour, worth = list(tour), list(worth)
    while tour:
        stops = [0, *(way + 1 for way in tour)]
        into = np.array([cost[before, way] for before, way in zip(stops, tour, strict=False)])
        if float(into.sum() + runs[tour].sum()) <= problem.limits.budget_m:
            break
        past = np.array([cost[before, way] for before, way in zip(stops, tour[1:], strict=False)] + [0.0])
        saved = into + runs[tour] + np.append(into[1:], 0.0) - past
        at = int(np.argmin(np.array(worth) / np.maximum(saved, 1e-3)))
        del tour[at], worth[at]
    return tour


def _blocked(problem: Problem, route: list[int]) -> list[tuple[int, int]]:
    """Find pairs of places in the route, -1 for the start, between which no turn stays inside the fence."""
    if problem.limits.fence is None:
        return []
    poses = [problem.pose, *(pose for way in route for pose in ends_of(problem.tracks, way))]
    paths = problem.turns.all_between(list(pairwise(poses))[::2])
    return [(place - 1, place) for place, path in enumerate(paths) if path is None]


def gain_bound_m2(problem: Problem, prefixes: list[list[int]]) -> float:
    """Bound the gain of any route within the budget, whatever its order.

    For any set of legs already taken, a route gains at most what that set does and the gains that single legs would add
    to it, of which the track pays for only so many (fractional knapsack over each leg's length and its shortest
    connection). The minimum over the given sets. What a leg counts for here is never less than in a route: of what was
    seen before it counts as a look from elsewhere.
    """
    tracks, cells, limits = problem.tracks, problem.cells, problem.limits
    if not tracks.n_legs:
        return 0.0
    renewed = np.where(cells.looked, 1.0 - problem.model.other_look_correlation, 1.0)
    max_added = renewed[tracks.cell] * tracks.exponent
    cost_m = tracks.length_m
    best = math.inf
    for taken in prefixes:
        need, missed_m2 = cells.need.copy(), cells.weight_m2.copy()
        base = float(problem.contact_m2[taken].sum())
        for leg in taken:
            part = slice(int(tracks.first[leg]), int(tracks.last[leg]))
            cell = tracks.cell[part]
            added = np.minimum(need[cell], max_added[part])
            gained = -np.expm1(-added) * missed_m2[cell]
            need[cell] -= added
            missed_m2[cell] -= gained
            base += float(gained.sum())
        value = -np.expm1(-np.minimum(need[tracks.cell], max_added)) * missed_m2[tracks.cell]
        total = np.append(0.0, np.cumsum(value))
        gain = total[tracks.last] - total[tracks.first] + problem.contact_m2
        gain[taken] = 0.0
        gain[problem.other_side[taken]] = 0.0
        one_side = problem.other_side >= np.arange(tracks.n_legs)  # one leg per contact
        gain = np.where(one_side, gain, 0.0)
        order = np.argsort(-gain / np.maximum(cost_m, 1e-9), kind="stable")
        spent = np.cumsum(cost_m[order])
        share = np.clip((limits.budget_m - (spent - cost_m[order])) / np.maximum(cost_m[order], 1e-9), 0.0, 1.0)
        wanted = float(-np.expm1(-need) @ missed_m2) + float(problem.contact_m2[one_side].sum())
        best = min(best, base + min(float(share @ gain[order]), wanted))
    return best
