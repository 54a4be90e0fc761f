"""Re-inspection plans: legs that view each contact from the direction it requests, sailable turns, short tours,
anywhere on the globe."""

from __future__ import annotations

import math
from itertools import count, pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.dubins import PlanePose, dubins_lengths, dubins_path
from auv_mcm.plan.reinspect import needs_second_look, plan_reinspection
from auv_mcm.plan.tour import exact_tour, nearly_shortest_tour, short_tour, tour_length
from auv_mcm.records import NAN, Contact, Waypoint
from auv_mcm.settings.plan_settings import PlanConfig
from tests.auv_mcm.classify import drawn_looks

CONFIG = PlanConfig(max_contacts=40)
START_HEADING = 0.4


def contact(
    name: str,
    latitude: float,
    longitude: float,
    p_mine: float = 0.9,
    next_look: tuple[float, ...] = (90.0,),
    aspects: tuple[float, ...] = (0.0,),
) -> Contact:
    return drawn_looks.contact(
        id=name,
        latitude_deg=latitude,
        longitude_deg=longitude,
        p_mine=p_mine,
        aspects_deg=aspects,
        next_look_deg=next_look,
    )


def field(
    n: int, latitude: float = 55.0, longitude: float = 12.0, seed: int = 1, half_m: float = 300.0
) -> list[Contact]:
    """Contacts strewn over a square around a place, with random directions to look from and p_mine above the limit."""
    generator = np.random.default_rng(seed)
    frame = LocalFrame(latitude_deg=latitude, longitude_deg=longitude)
    enu = np.column_stack([generator.uniform(-half_m, half_m, (n, 2)), np.zeros(n)])
    latitudes, longitudes, _ = frame.to_geodetic(enu)
    return [
        contact(
            f"C{i:04d}",
            float(latitudes[i]),
            float(longitudes[i]),
            generator.uniform(0.5, 1.0),
            (generator.uniform(0.0, 180.0),),
        )
        for i in range(n)
    ]


def legs_of(plan: tuple[Waypoint, ...]) -> list[tuple[Waypoint, Waypoint]]:
    entries = [point for point in plan if point.kind == "leg_entry"]
    exits = [point for point in plan if point.kind == "leg_exit"]
    assert [point.leg for point in entries] == [point.leg for point in exits] == list(range(1, len(entries) + 1))
    return list(zip(entries, exits, strict=True))


def local(frame: LocalFrame, point: Waypoint) -> NDArray[np.float64]:
    return np.asarray(frame.to_enu(point.latitude_deg, point.longitude_deg, 0.0)[:2], dtype=np.float64)


PLACES = pytest.mark.parametrize(
    ("latitude", "longitude"), [(0.0, 0.0), (55.0, 12.0), (-33.0, 180.0), (-70.0, -179.9999), (89.0, 40.0)]
)


@PLACES
def test_contacts_lie_at_the_stand_off_abeam_of_mid_leg_and_are_seen_from_the_direction_requested_or_its_opposite(
    latitude: float, longitude: float
) -> None:
    contacts = {found.id: found for found in field(12, latitude, longitude)}
    plan = plan_reinspection(contacts.values(), latitude, longitude, START_HEADING, CONFIG)
    legs = legs_of(plan)
    assert sorted(entry.contact_id for entry, _ in legs) == sorted(contacts)
    for entry, leave in legs:
        target = contacts[entry.contact_id]
        frame = LocalFrame(latitude_deg=target.latitude_deg, longitude_deg=target.longitude_deg)
        first, last = local(frame, entry), local(frame, leave)
        middle, track = (first + last) / 2.0, (last - first) / np.hypot(*(last - first))
        assert np.hypot(*middle) == pytest.approx(CONFIG.stand_off_m, abs=1e-6)
        assert abs(middle @ track) < 1e-6
        look_deg = math.degrees(math.atan2(-middle[0], -middle[1]))
        assert math.remainder(look_deg - target.next_look_deg[0], 180.0) == pytest.approx(0.0, abs=1e-5)
        assert f"this leg looks towards {round(look_deg) % 360:03d}°" in entry.why
        assert np.hypot(*(last - first)) >= CONFIG.leg_length_m + 2.0 * CONFIG.turn_radius_m - 1e-6
        side = "starboard" if math.remainder(look_deg - math.degrees(math.atan2(*track)), 360.0) > 0.0 else "port"
        assert f"{CONFIG.stand_off_m:.1f} m to {side}" in entry.why


@PLACES
@pytest.mark.parametrize("half_m", [8.0, 60.0, 300.0])
def test_no_three_waypoints_bend_tighter_than_the_turn_radius(latitude: float, longitude: float, half_m: float) -> None:
    plan = plan_reinspection(field(15, latitude, longitude, half_m=half_m), latitude, longitude, START_HEADING, CONFIG)
    frame = LocalFrame(latitude_deg=latitude, longitude_deg=longitude)
    points = np.array([local(frame, point) for point in plan])
    before, here, after = points[:-2], points[1:-1], points[2:]
    sides = [np.hypot(*(a - b).T) for a, b in ((before, here), (here, after), (before, after))]
    cross = np.abs((here - before)[:, 0] * (after - here)[:, 1] - (here - before)[:, 1] * (after - here)[:, 0])
    curvature = 2.0 * cross / (sides[0] * sides[1] * sides[2])  # Menger
    assert curvature.max() <= (1.0 + 1e-6) / CONFIG.turn_radius_m


@PLACES
def test_headings_are_true_courses_along_the_path(latitude: float, longitude: float) -> None:
    """The mean of two neighbouring headings is the direction of the chord between them, on arcs and straights alike."""
    plan = plan_reinspection(field(8, latitude, longitude), latitude, longitude, START_HEADING, CONFIG)
    for here, there in pairwise(plan):
        assert 0.0 <= here.heading_rad < 2.0 * math.pi
        frame = LocalFrame(latitude_deg=here.latitude_deg, longitude_deg=here.longitude_deg)
        east, north = local(frame, there)
        convergence = math.remainder(math.radians(there.longitude_deg - here.longitude_deg), 2.0 * math.pi) * math.sin(
            math.radians((here.latitude_deg + there.latitude_deg) / 2.0)
        )
        turned = math.remainder(there.heading_rad - convergence - here.heading_rad, 2.0 * math.pi)
        assert math.remainder(math.atan2(east, north) - here.heading_rad - turned / 2.0, math.pi) == pytest.approx(
            0.0, abs=2e-5
        )


def test_turn_points_are_dense_enough_to_follow() -> None:
    plan = plan_reinspection(field(10), 55.0, 12.0, START_HEADING, CONFIG)
    for here, there in pairwise(plan):
        assert abs(math.remainder(there.heading_rad - here.heading_rad, 2.0 * math.pi)) <= math.radians(15.001)


def test_the_plan_starts_at_the_start_and_equal_input_gives_equal_plans() -> None:
    contacts = field(20)
    plan = plan_reinspection(contacts, 55.0, 12.0, START_HEADING, CONFIG)
    assert plan == plan_reinspection(list(reversed(contacts)), 55.0, 12.0, START_HEADING, CONFIG)
    assert (plan[0].kind, plan[0].latitude_deg, plan[0].longitude_deg) == ("start", 55.0, 12.0)
    assert plan[0].heading_rad == pytest.approx(START_HEADING)
    assert {point.kind for point in plan[1:]} == {"turn", "leg_entry", "leg_exit"}
    assert all(point.why for point in plan)


def test_only_likely_mines_that_another_look_may_decide_are_visited_the_most_undecided_first() -> None:
    contacts = [
        contact("surer", 55.0, 12.0, 0.9),
        contact("open", 55.001, 12.0, 0.6, (20.0, 110.0), (350.0, 10.0)),
        contact("as_open", 55.002, 12.0, 0.6),
        contact("decided", 55.0, 12.001, 0.99, ()),
        contact("stone", 55.0, 12.001, 0.49),
        contact("lost", NAN, 12.0, 0.9),
        contact("lost_too", 55.0, math.inf, 0.9),
        contact("no_direction", 55.0, 12.0, 0.9, (NAN,)),
        contact("unknown_p", 55.0, 12.0, NAN),
    ]
    assert [c.id for c in contacts if needs_second_look(c, 0.5)] == ["surer", "open", "as_open"]
    for n_visited, visited in enumerate([{"as_open"}, {"as_open", "open"}, {"as_open", "open", "surer"}], start=1):
        plan = plan_reinspection(contacts, 55.0, 12.0, 0.0, PlanConfig(max_contacts=n_visited, min_p_mine=0.5))
        assert {point.contact_id for point in plan} == visited


def test_below_the_even_odds_the_nearest_to_them_come_first_too() -> None:
    contacts = [
        contact("likely", 55.0, 12.0, 0.75),
        contact("unlikely", 55.001, 12.0, 0.375),
        contact("hardly", 55.002, 12.0, 0.1),
    ]
    plan = plan_reinspection(contacts, 55.0, 12.0, 0.0, PlanConfig(max_contacts=1, min_p_mine=0.1))
    assert {point.contact_id for point in plan} == {"unlikely"}


def test_the_reason_names_the_direction_and_what_is_open() -> None:
    one, two = (
        plan_reinspection([contact("C1", 55.0, 12.0, 0.625, (20.0, 110.0), aspects)], 55.0, 12.0, 0.0, CONFIG)[-1].why
        for aspects in ((110.0,), (350.0, 10.0))
    )
    assert one.startswith("second view of C1: p_mine 0.62 is undecided after one view; this leg looks towards ")
    assert "looks towards 020°" in one or "looks towards 200°" in one
    assert "undecided after 2 views" in two


def test_directions_a_hair_from_north_count_as_north() -> None:
    for next_look in (0.3, 179.8):
        plan = plan_reinspection([contact("C1", 55.0, 12.0, 0.6, (next_look,))], 55.0, 12.0, 0.0, CONFIG)
        assert any(f"looks towards {reported}°" in plan[-1].why for reported in ("000", "180"))


def test_nothing_to_visit_is_an_empty_plan() -> None:
    assert plan_reinspection([], 55.0, 12.0, 0.0, CONFIG) == ()
    assert plan_reinspection([], NAN, NAN, NAN, CONFIG) == ()
    assert plan_reinspection(field(3), 55.0, 12.0, 0.0, PlanConfig(max_contacts=0)) == ()


def test_an_unknown_start_is_refused_with_a_reason() -> None:
    with pytest.raises(BadInputError, match="start pose is not known"):
        plan_reinspection(field(1), NAN, 12.0, 0.0, CONFIG)


def test_contacts_all_at_one_place_give_a_sailable_plan() -> None:
    contacts = [contact(f"C{i}", 55.0, 12.0) for i in range(6)]
    assert len(legs_of(plan_reinspection(contacts, 55.0, 12.0, 0.0, CONFIG))) == 6


def costs(n_contacts: int, seed: int, half: float = 150.0) -> NDArray[np.float64]:
    """Connections between random legs of length 50 with the four ways of the planner."""
    generator = np.random.default_rng(seed)
    entries: list[tuple[float, ...]] = []
    exits: list[tuple[float, ...]] = [(0.0, 0.0, 0.3)]
    for _ in range(n_contacts):
        east, north, course = (
            generator.uniform(-half, half),
            generator.uniform(-half, half),
            generator.uniform(0.0, 2.0 * math.pi),
        )
        along, right = np.array([math.sin(course), math.cos(course)]), np.array([math.cos(course), -math.sin(course)])
        for side in (12.0, -12.0):
            for way in (25.0, -25.0):
                heading = course if way > 0.0 else course + math.pi
                middle = np.array([east, north]) + side * right
                entries.append((*(middle - way * along), heading))
                exits.append((*(middle + way * along), heading))
    return dubins_lengths(np.array(exits)[:, np.newaxis], np.array(entries)[np.newaxis], 10.0)


def shortest_tour(cost: NDArray[np.float64]) -> float:
    """Exact, by dynamic programming over sets of contacts and the way sailed last (Held and Karp)."""
    n_ways = cost.shape[1]
    reach: dict[tuple[int, int], float] = {(1 << way // 4, way): float(cost[0, way]) for way in range(n_ways)}
    for _ in range(n_ways // 4 - 1):
        further: dict[tuple[int, int], float] = {}
        for (done, last), length in reach.items():
            for way in range(n_ways):
                if not done >> way // 4 & 1:
                    key, total = (done | 1 << way // 4, way), length + float(cost[last + 1, way])
                    further[key] = min(total, further.get(key, math.inf))
        reach = further
    return min(reach.values())


@pytest.mark.parametrize("half", [15.0, 150.0])
def test_tours_of_few_contacts_are_the_shortest(half: float) -> None:
    for seed in range(6):
        cost = costs(5, seed, half)
        for found in (short_tour, nearly_shortest_tour):  # the latter orders up to eight at once
            assert tour_length(found(cost), cost) == pytest.approx(shortest_tour(cost), rel=1e-12)


@pytest.mark.parametrize("half", [15.0, 60.0, 150.0])
def test_tours_of_many_contacts_are_nearly_the_shortest(half: float) -> None:
    ratios = [
        tour_length(nearly_shortest_tour(cost), cost) / tour_length(exact_tour(cost), cost)
        for cost in (costs(11, seed, half) for seed in range(8))
    ]
    assert min(ratios) >= 1.0 - 1e-12
    assert max(ratios) <= 1.0 / 0.9
    assert np.mean(ratios) <= 1.0 / 0.95


@given(st.integers(1, 25), st.integers(0, 10_000))
def test_tours_visit_every_contact_once_and_never_lose_to_the_naive_order(n_contacts: int, seed: int) -> None:
    cost = costs(n_contacts, seed)
    tour = short_tour(cost)
    assert sorted(way // 4 for way in tour) == list(range(n_contacts))
    naive = [4 * number for number in range(n_contacts)]
    for place in range(n_contacts):  # each contact in the way that is best after the one before
        before = naive[place - 1] + 1 if place else 0
        naive[place] = 4 * place + int(np.argmin(cost[before, 4 * place : 4 * place + 4]))
    assert tour_length(tour, cost) <= tour_length(naive, cost) + 1e-9


def test_a_tour_sailed_backwards_is_as_long() -> None:
    cost = costs(5, 3)
    ways = np.arange(20)
    np.testing.assert_allclose(
        cost[ways[:, np.newaxis] + 1, ways], cost[(ways ^ 1)[np.newaxis, :] + 1, (ways ^ 1)[:, np.newaxis]], atol=1e-6
    )


def test_the_planned_tour_is_shorter_than_visiting_by_rank() -> None:
    contacts = field(20)
    by_rank = sorted(contacts, key=lambda found: -found.p_mine)
    together = plan_reinspection(contacts, 55.0, 12.0, START_HEADING, CONFIG)
    frame = LocalFrame(latitude_deg=55.0, longitude_deg=12.0)

    def path_m(plan: tuple[Waypoint, ...]) -> float:
        return sum(math.dist(local(frame, here), local(frame, there)) for here, there in pairwise(plan))

    single = [plan_reinspection([found], 55.0, 12.0, START_HEADING, CONFIG) for found in by_rank]
    naive, pose = 0.0, PlanePose(0.0, 0.0, START_HEADING)
    for plan in single:
        ((entry, leave),) = legs_of(plan)
        start, stop = local(frame, entry), local(frame, leave)
        naive += dubins_path(
            pose, PlanePose(start[0], start[1], entry.heading_rad), CONFIG.turn_radius_m
        ).length_m + math.dist(start, stop)
        pose = PlanePose(stop[0], stop[1], leave.heading_rad)
    assert path_m(together) < 0.7 * naive


def test_forty_contacts_are_planned_in_a_bounded_number_of_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counts of work in place of a quarter of a second, which a busy machine does not keep."""
    n_lengths: list[int] = []

    def counted(*poses: Any) -> NDArray[np.float64]:
        n_lengths.append((lengths := dubins_lengths(*poses)).size)
        return lengths

    n_steps = count()
    monkeypatch.setattr("auv_mcm.plan.reinspect.dubins_lengths", counted)
    plan_reinspection(field(40), 55.0, 12.0, START_HEADING, CONFIG, more_time=lambda: next(n_steps) >= 0)
    assert sum(n_lengths) == (1 + 4 * 40) * 4 * 40, "each way past a contact from each other, once"
    assert next(n_steps) <= 125  # 115
