"""Choice and order of legs against trying everything on small problems: near the optimum, and never above the bound."""

from __future__ import annotations

import math
from itertools import pairwise, permutations, product
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.plan.contact_legs import contact_legs, information_nats
from auv_mcm.plan.dubins import Array, PlanePose, dubins_lengths
from auv_mcm.plan.limits import Limits
from auv_mcm.plan.orienteering import Problem, gain_bound_m2, gains_m2, greedy_legs, route_length_m, trimmed_legs
from auv_mcm.plan.search import improved
from auv_mcm.plan.survey import SurveyState, replan
from auv_mcm.plan.tour import WAYS, richest_tour, tour_length
from auv_mcm.plan.tracks import Cells, survey_tracks
from auv_mcm.plan.turns import Turns, ends_of
from tests.auv_mcm.plan.survey_worlds import CELL_M, LIMITS, Sonar, contact, world

POSE = PlanePose(-20.0, 10.0, 0.5)


def always() -> bool:
    return True


def problem_of(state: SurveyState, limits: Limits, kept: list[int] | None = None) -> Problem:
    """Survey legs of an unsearched world, of all or some."""
    row, column = np.nonzero(state.area)
    n = len(row)
    wanted = -math.log1p(-state.required)
    clearance = state.clearance
    cells = Cells(
        east_m=np.asarray((column + 0.5) * clearance.cell_m, dtype=np.float64),
        north_m=np.asarray((row + 0.5) * clearance.cell_m, dtype=np.float64),
        need=np.full(n, wanted),
        weight_m2=np.full(n, clearance.cell_m**2 / state.required),
        looked=np.zeros(n, dtype=np.bool_),
        towards=np.zeros(n, dtype=np.uint64),
        seabed=clearance.seabed[row, column],
        ripple_rad=clearance.ripple_rad[row, column],
        unevenness_db=clearance.unevenness_db[row, column],
        cell_m=clearance.cell_m,
    )
    tracks = survey_tracks(cells, state.performance, limits, [], always)
    at = np.arange(tracks.n_legs) if kept is None else np.array(kept) % tracks.n_legs
    tracks = tracks._replace(
        run=tracks.run[at],
        first=tracks.first[at],
        last=tracks.last[at],
        line=tracks.line[at],
        heading=tracks.heading[at],
    )
    return Problem(tracks, np.zeros(len(at)), np.arange(len(at)), cells, Sonar(), POSE, limits, Turns(POSE, limits))


class Best(NamedTuple):
    gain_m2: float
    route: tuple[int, ...]


def best_of_all(problem: Problem) -> Best:
    """Every subset of the legs, in every order, each sailed either way."""
    ways = [ends_of(problem.tracks, way) for way in range(2 * problem.tracks.n_legs)]
    exits = np.array([POSE, *(leave for _, leave in ways)])
    between = dubins_lengths(
        exits[:, np.newaxis], np.array([entry for entry, _ in ways])[np.newaxis], problem.turns.radius_m
    )
    best = Best(0.0, ())
    for n in range(1, problem.tracks.n_legs + 1):
        for order in permutations(range(problem.tracks.n_legs), n):
            gain = sum(gains_m2(problem, list(order)))
            legs_m = float(problem.tracks.length_m[list(order)].sum())
            for turned in product((0, 1), repeat=n):
                route = [2 * leg + way for leg, way in zip(order, turned, strict=True)]
                turns_m = sum(
                    between[before, after - 1] for before, after in pairwise([0, *(way + 1 for way in route)])
                )
                if gain > best.gain_m2 and legs_m + turns_m <= problem.limits.budget_m:
                    best = Best(gain, order)
    return best


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 10_000), min_size=1, max_size=4, unique=True), st.floats(100.0, 1500.0))
def test_no_choice_of_few_legs_gains_more_than_the_bound_or_much_more_than_the_route(
    numbers: list[int], budget_m: float
) -> None:
    limits = LIMITS._replace(budget_m=budget_m)
    problem = drawn = problem_of(world(10, 10), limits, numbers)
    n = problem.tracks.n_legs
    legs = greedy_legs(problem, np.ones(n, dtype=np.bool_), [], always)
    found = improved(problem, legs, always)
    problem, route = found.problem, found.route
    gain = sum(gains_m2(problem, [way // 2 for way in route]))
    best = best_of_all(drawn)
    assert route_length_m(problem, route) <= budget_m
    for taken in ([], legs, legs[:1]):
        assert gain_bound_m2(drawn, [taken]) >= best.gain_m2 - 1e-6
    # Of so few legs the greedy choice loses at most what one leg gains.
    assert gain >= 0.5 * best.gain_m2 - 1e-6


def test_greedy_gains_are_those_of_measuring_every_leg_anew_each_time() -> None:
    problem = problem_of(world(12, 12), LIMITS)
    legs = greedy_legs(problem, np.ones(problem.tracks.n_legs, dtype=np.bool_), [], always)
    gains = gains_m2(problem, legs)
    assert sum(gains) == pytest.approx(12 * 12 * 16.0, rel=0.01)
    assert min(gains) > 0.0
    single = [gains_m2(problem, [leg])[0] for leg in legs]
    assert all(later <= alone + 1e-9 for later, alone in zip(gains, single, strict=True))


def test_legs_are_cut_back_by_what_others_see_and_lose_nothing() -> None:
    problem = problem_of(world(16, 30), LIMITS)
    every = np.ones(problem.tracks.n_legs, dtype=np.bool_)
    for heading in range(8):
        beside = np.flatnonzero(problem.tracks.heading == heading)
        longest = beside[np.argsort(-problem.tracks.length_m[beside])[:6]].tolist()
        legs = greedy_legs(problem, every, longest, always)
        cut, left = trimmed_legs(problem, legs, always)
        assert sum(gains_m2(cut, left)) == pytest.approx(sum(gains_m2(problem, legs)), abs=1e-4)
        assert cut.tracks.length_m[left].sum() < 0.8 * problem.tracks.length_m[legs].sum()
        for leg in left:  # what it counts for lies abeam of its run, less the settling
            entry, leave = cut.tracks.run[leg]
            cell = cut.tracks.cell[cut.tracks.first[leg] : cut.tracks.last[leg]]
            sine, cosine = math.sin(entry[2]), math.cos(entry[2])
            along_m = (cut.cells.east_m[cell] - entry[0]) * sine + (cut.cells.north_m[cell] - entry[1]) * cosine
            margin_m = LIMITS.settling_m + 0.5 * CELL_M * (abs(sine) + abs(cosine)) - 1e-3
            assert along_m.min() >= margin_m
            assert along_m.max() <= math.dist(entry[:2], leave[:2]) - margin_m


def test_a_run_of_the_plan_before_counts_for_what_the_same_leg_does_now() -> None:
    problem = problem_of(world(16, 30), LIMITS)
    for leg in [int(np.flatnonzero(problem.tracks.heading == heading)[9]) for heading in range(8)]:
        entry, leave = ends_of(problem.tracks, 2 * leg)
        again = survey_tracks(problem.cells, problem.model, LIMITS, [(entry, leave)], always)
        of_each = (slice(tracks.first[k], tracks.last[k]) for tracks, k in ((problem.tracks, leg), (again, -1)))
        before, now = next(of_each), next(of_each)
        np.testing.assert_array_equal(again.cell[now], problem.tracks.cell[before])
        np.testing.assert_allclose(again.exponent[now], problem.tracks.exponent[before])


def test_lines_are_cut_back_alike_whichever_corner_the_fence_cuts_off() -> None:
    fence = np.array([[-140.0, -140.0], [-140.0, 140.0], [-80.0, 140.0], [140.0, -80.0], [140.0, -140.0]])
    legs_m = [
        problem_of(world(20, 20), LIMITS._replace(fence=fence * mirror + 40.0)).tracks.length_m.sum()
        for mirror in product((1.0, -1.0), repeat=2)
    ]
    assert legs_m == pytest.approx([legs_m[0]] * 4)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 4), st.integers(0, 1000), st.floats(0.0, 4.0))
def test_the_richest_tour_is_the_best_of_all_subsets_orders_and_ways(n: int, seed: int, budget: float) -> None:
    generator = np.random.default_rng(seed)
    cost = generator.uniform(0.1, 1.0, (WAYS * n + 1, WAYS * n))
    runs = np.repeat(generator.uniform(0.0, 0.5, n), WAYS)
    worth = generator.uniform(0.1, 1.0, n)
    best = 0.0
    for size in range(1, n + 1):
        for order in permutations(range(n), size):
            value = float(worth[list(order)].sum())
            if value > best:
                tours = (
                    [4 * k + way for k, way in zip(order, ways, strict=True)] for ways in product(range(4), repeat=size)
                )
                best = value if any(tour_length(tour, cost) + runs[tour].sum() <= budget for tour in tours) else best
    tour = richest_tour(cost, runs, worth, budget) if n else []
    assert sum(worth[way // 4] for way in tour) == pytest.approx(best)
    assert not tour or tour_length(tour, cost) + runs[tour].sum() <= budget


def exact_contacts_m2(state: SurveyState, limits: Limits) -> float:
    """The most that looks at contacts can gain within the budget, by the exact tours."""
    looks = contact_legs(state.contacts, state.clearance, state.performance, limits)
    ends: list[tuple[Array, Array]] = []
    for look in looks:
        for run in look.runs:
            ends += [(run[0], run[1]), (run[1] + [0.0, 0.0, math.pi], run[0] + [0.0, 0.0, math.pi])]
    entries, exits = np.array([entry for entry, _ in ends]), np.array([POSE, *(leave for _, leave in ends)])
    cost = dubins_lengths(exits[:, np.newaxis], entries[np.newaxis], limits.turn_radius_m / math.cos(math.radians(7.5)))
    runs = np.full(len(ends), 50.0)
    worth = np.array([look.gain_m2 for look in looks])
    tour = richest_tour(cost, runs, worth, limits.budget_m)
    return float(sum(worth[way // 4] for way in tour))


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 9), st.integers(0, 10_000), st.floats(100.0, 2000.0), st.booleans())
def test_plans_for_few_contacts_gain_what_the_best_of_all_sets_and_orders_does(
    n: int, seed: int, budget_m: float, fenced: bool
) -> None:
    generator = np.random.default_rng(seed)
    places = generator.uniform(0.0, 300.0, (n, 2)).tolist()
    asking = tuple(
        contact(k, east, north, generator.uniform(0.0, 360.0), generator.uniform(0.1, 0.9))
        for k, (east, north) in enumerate(places)
    )
    state = world(contacts=asking)
    state.clearance.exponent[:] = 3.0
    wide = np.array([[-200.0, -200.0], [-200.0, 500.0], [500.0, 500.0], [500.0, -200.0]])
    limits = LIMITS._replace(budget_m=budget_m, fence=wide if fenced else None)
    plan = replan(state, POSE, limits, None, always)
    best = exact_contacts_m2(state, limits)
    assert plan.gain_m2 == pytest.approx(best, abs=1e-6)
    assert plan.length_m <= budget_m
    assert plan.bound_m2 >= best - 1e-6


def test_where_a_fence_blocks_the_best_order_of_contacts_the_plan_is_one_that_can_be_sailed() -> None:
    asking = (contact(0, 40.0, 40.0, 0.0, 0.5), contact(1, 260.0, 40.0, 0.0, 0.5))
    state = world(contacts=asking)
    state.clearance.exponent[:] = 3.0
    wall = [(140.0, 110.0), (140.0, -60.0), (160.0, -60.0), (160.0, 110.0)]  # leaves 20 m, too few for a turn
    fence = np.array([(-80.0, -80.0), (-80.0, 110.0), *wall, (340.0, 110.0), (340.0, -80.0)])
    plans = [replan(state, POSE, LIMITS._replace(fence=each), None, always) for each in (fence, None)]
    assert [[leg.contact_id for leg in plan.legs] for plan in plans] == [["C00000"], ["C00000", "C00001"]]


def test_a_look_adds_most_where_nothing_is_decided_and_nothing_where_it_sees_no_difference() -> None:
    assert information_nats(0.5, 0.9) > information_nats(0.9, 0.9) > information_nats(0.999, 0.9) > 0.0
    assert information_nats(0.5, 0.9) > information_nats(0.5, 0.6) > 0.0
    assert information_nats(0.5, 0.1) == pytest.approx(0.0, abs=1e-12)
    assert information_nats(0.0, 0.9) == information_nats(1.0, 0.9) == 0.0
    # A sure sonar without false calls would leave ln 2 to nothing; with one false call in ten it brings most of it.
    assert 0.3 < information_nats(0.5, 0.98) < math.log(2.0)
