"""Order straight legs, and the direction of each: a short open tour over measured connections.

Every contact k can be passed in four ways, numbered 4 k .. 4 k + 3; way i sailed backwards is way i ^ 1. `cost[0, j]`
is the length from the start to way j's entry, `cost[i + 1, j]` from way i's exit to way j's entry. A path sailed
backwards is as long:
cost[i + 1, j] == cost[(j ^ 1) + 1, i ^ 1], so reversing a stretch of the tour changes only the two connections at its
ends.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

Costs: TypeAlias = NDArray[np.float64]

WAYS: Final = 4  # to pass one contact: on either side, in either direction
EXACT_CONTACTS: Final = 12  # up to which the exact tour is found; bounds time, which doubles per contact
_STRETCH: Final = 8  # contacts whose order is made exact at once; bounds time
_MAX_SWEEPS: Final = 10  # of stretches along the tour; it ends earlier when nothing gets shorter
_MIN_GAIN_M: Final = 1e-6  # m: less is rounding
_MAX_MOVES: Final = 20_000_000  # moves measured: bounds the time for very many contacts, equal on every machine


def tour_length(tour: list[int], cost: Costs) -> float:
    """Sum the connections from the start through the ways in order."""
    return float(sum(cost[before, after - 1] for before, after in pairwise([0, *(way + 1 for way in tour)])))


def short_tour(cost: Costs, more_time: Callable[[], bool] = lambda: True) -> list[int]:
    """Choose one way per contact in sailing order: the shortest tour for few contacts, nearly the shortest for many."""
    return exact_tour(cost) if cost.shape[1] <= WAYS * EXACT_CONTACTS else nearly_shortest_tour(cost, more_time)


def exact_tour(cost: Costs) -> list[int]:
    """Find the shortest tour. Time and memory double with every contact."""
    return _shortest_through(0, list(range(cost.shape[1] // WAYS)), None, cost)


def nearly_shortest_tour(cost: Costs, more_time: Callable[[], bool] = lambda: True) -> list[int]:
    """Find a tour never longer than the contacts as numbered, each passed the best way.

    It improves as long as there is more time.

    Insertion where it costs least, then the best of 2-opt (reverse a stretch), Or-opt (move one contact, any way) and
    the best ways for the order found, until nothing gets shorter (S. Lin, "Computer solutions of the traveling salesman
    problem", 1965; I. Or, 1976), then every stretch of a few contacts in its best order, and so on until neither helps.
    """
    as_numbered = _best_ways(list(range(cost.shape[1] // WAYS)), cost)
    tours = [_improved(tour, cost, more_time) for tour in (_inserted(cost), as_numbered)]
    return min(
        (_stretches_in_best_order(tour, cost, more_time) for tour in tours), key=lambda tour: tour_length(tour, cost)
    )


def _inserted(cost: Costs) -> list[int]:
    tour: list[int] = []
    for contact in range(cost.shape[1] // WAYS):
        tour, _ = _with_contact(tour, contact, cost)
    return tour


def _with_contact(tour: list[int], contact: int, cost: Costs) -> tuple[list[int], float]:
    """Insert one more contact where it adds the minimum; give the tour and what it adds."""
    ways = WAYS * contact + np.arange(WAYS)
    before = np.array([0, *(way + 1 for way in tour)])
    added = cost[before[:, np.newaxis], ways]
    if tour:
        after = np.array(tour)
        added[:-1] += cost[ways + 1][:, after].T - cost[before[:-1], after][:, np.newaxis]
    place, way = divmod(int(np.argmin(added)), WAYS)
    return [*tour[:place], int(ways[way]), *tour[place:]], float(added[place, way])


def _improved(tour: list[int], cost: Costs, more_time: Callable[[], bool]) -> list[int]:
    moves_left = _MAX_MOVES
    length = tour_length(tour, cost)
    while moves_left > 0 and more_time():
        moves_left -= len(tour) * len(tour) * (WAYS + 1)
        shorter = min(
            (_reversed_stretch(tour, cost), _moved_contact(tour, cost)), key=lambda other: tour_length(other, cost)
        )
        if tour_length(shorter, cost) > length - _MIN_GAIN_M:
            shorter = _best_ways([way // WAYS for way in tour], cost)
            if tour_length(shorter, cost) > length - _MIN_GAIN_M:
                break
        tour, length = shorter, tour_length(shorter, cost)
    return tour


def _reversed_stretch(tour: list[int], cost: Costs) -> list[int]:
    """Find the best of all tours with one stretch (possibly one leg) sailed backwards."""
    ways = np.array(tour)
    before = np.array([0, *(ways[:-1] + 1)])
    backwards = ways ^ 1
    into, out = cost[before, ways], np.append(cost[ways[:-1] + 1, ways[1:]], 0.0)
    gain = into[:, np.newaxis] + out - cost[before[:, np.newaxis], backwards]
    gain[:, :-1] -= cost[backwards[:, np.newaxis] + 1, ways[1:]]
    first, last = divmod(int(np.argmax(np.where(np.tri(len(tour), dtype=np.bool_).T, gain, -np.inf))), len(tour))
    return [*tour[:first], *(way ^ 1 for way in reversed(tour[first : last + 1])), *tour[last + 1 :]]


def _moved_contact(tour: list[int], cost: Costs) -> list[int]:
    """Find the best of all tours with one contact moved anywhere, sailed in any way."""
    best, max_saved = tour, 0.0
    stops = [0, *(way + 1 for way in tour)]
    for place, way in enumerate(tour):
        rest = [*tour[:place], *tour[place + 1 :]]
        saved = cost[stops[place], way]
        if place + 1 < len(tour):
            saved += cost[way + 1, tour[place + 1]] - cost[stops[place], tour[place + 1]]
        moved, added = _with_contact(rest, way // WAYS, cost)
        if saved - added > max_saved:
            best, max_saved = moved, saved - added
    return best


def _stretches_in_best_order(tour: list[int], cost: Costs, more_time: Callable[[], bool]) -> list[int]:
    for _ in range(_MAX_SWEEPS):
        length = tour_length(tour, cost)
        for first in range(0, len(tour), _STRETCH // 2):
            if not more_time():
                return tour
            stretch, rest = tour[first : first + _STRETCH], tour[first + _STRETCH :]
            before = tour[first - 1] + 1 if first else 0
            contacts = [way // WAYS for way in stretch]
            tour = [*tour[:first], *_shortest_through(before, contacts, rest[0] if rest else None, cost), *rest]
        tour = _improved(tour, cost, more_time)
        if tour_length(tour, cost) > length - _MIN_GAIN_M:
            break
    return tour


def _shortest_through(before: int, contacts: list[int], after: int | None, cost: Costs) -> list[int]:
    """Find the shortest way from row `before` of `cost` through all contacts to way `after` (None: any end).

    Dynamic programming over sets of contacts and the way sailed last (M. Held and R. M. Karp, "A dynamic programming
    approach to sequencing problems", 1962), all sets of equal size at once.
    """
    ways, bits, reach = _shortest_to(before, contacts, cost)
    done_set = len(reach) - 1
    last = reach[done_set] + (cost[ways + 1, after] if after is not None else 0.0)
    return _traced(done_set, int(np.argmin(last)), ways, bits, reach, cost)


def richest_tour(cost: Costs, runs_m: Costs, worth: Costs, budget_m: float) -> list[int]:
    """Find the tour that is worth most of those within the budget; of equal ones the shortest. Exact.

    runs_m: (n_ways,) length of each leg, worth: (n_contacts,). Time and memory double with every contact.
    """
    contacts = list(range(cost.shape[1] // WAYS))
    ways, bits, reach = _shortest_to(0, contacts, cost, runs_m)
    length_m = reach.min(axis=1)
    length_m[0] = 0.0
    member = (np.arange(len(reach))[:, np.newaxis] >> np.arange(len(contacts))) & 1
    total = np.where(length_m <= budget_m, member @ worth, -np.inf)
    best = int(np.lexsort((length_m, -total))[0])
    return _traced(best, int(np.argmin(reach[best])), ways, bits, reach, cost) if best else []


_Bits: TypeAlias = NDArray[np.int64]


def _shortest_to(
    before: int, contacts: list[int], cost: Costs, runs_m: Costs | None = None
) -> tuple[_Bits, _Bits, Costs]:
    """Compute the ways past the contacts, each way's contact bit, and the minimum lengths.

    Lengths are through every set of contacts to every way last.
    """
    ways = np.add.outer(WAYS * np.array(contacts), np.arange(WAYS)).ravel()
    bits = 1 << np.arange(len(ways)) // WAYS
    run_m = np.zeros(len(ways)) if runs_m is None else runs_m[ways]
    between = cost[ways[:, np.newaxis] + 1, ways] + run_m
    sets = np.arange(1 << len(contacts))
    size = sum((sets >> place) & 1 for place in range(len(contacts)))
    reach = np.full((len(sets), len(ways)), np.inf)
    reach[bits, np.arange(len(ways))] = cost[before, ways] + run_m
    for n_done in range(1, len(contacts)):
        done = sets[size == n_done]
        through = np.min(reach[done][:, :, np.newaxis] + between, axis=1)
        row, column = np.nonzero((done[:, np.newaxis] & bits) == 0)
        reach[done[row] | bits[column], column] = through[row, column]
    return ways, bits, reach


def _traced(done_set: int, last: int, ways: _Bits, bits: _Bits, reach: Costs, cost: Costs) -> list[int]:
    """Trace the tour through a set of contacts that ends with a way, back from its end."""
    picked = [last]
    while done_set := int(done_set & ~bits[picked[-1]]):
        picked.append(int(np.argmin(reach[done_set] + cost[ways + 1, ways[picked[-1]]])))
    return [int(way) for way in ways[picked[::-1]]]


def _best_ways(order: list[int], cost: Costs) -> list[int]:
    """Choose the ways that make the tour in this order shortest (dynamic programming over the four ways)."""
    ways = WAYS * np.array(order)[:, np.newaxis] + np.arange(WAYS)
    reach = cost[0, ways[0]]
    choices = []
    for before, after in pairwise(ways):
        through = reach[:, np.newaxis] + cost[before[:, np.newaxis] + 1, after]
        choices.append(np.argmin(through, axis=0))
        reach = through.min(axis=0)
    way = int(np.argmin(reach))
    picked = [way]
    for choice in reversed(choices):
        way = int(choice[way])
        picked.append(way)
    return [int(options[way]) for options, way in zip(ways, reversed(picked), strict=True)]
