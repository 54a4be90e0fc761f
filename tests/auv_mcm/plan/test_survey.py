"""Missions planned anew: no plan breaks a limit, whatever is requested; a request is met where it can be, else the
reason is given."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import HIGHEST_P, Clearance, clearance_over, look_bit, unsearched
from auv_mcm.clearance.detection_performance import CellView
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.dubins import PlanePose
from auv_mcm.plan.limits import Limits
from auv_mcm.plan.plan_words import survey_words
from auv_mcm.plan.survey import HIGHEST_REQUIRED, Plan, PlannedLeg, SurveyState, replan
from auv_mcm.records import SEABED_TYPES
from tests.auv_mcm.plan.survey_worlds import CELL_M, LIMITS, ORIGIN, Sonar, contact, world

POSE = PlanePose(-20.0, -20.0, 0.3)
SQUARE = np.array([[-60.0, -60.0], [-60.0, 140.0], [140.0, 140.0], [140.0, -60.0]])
BAY = np.array([[-60.0, -60.0], [-60.0, 140.0], [40.0, 60.0], [140.0, 140.0], [140.0, -60.0]])


def steps(n: int) -> Callable[[], bool]:
    left = iter(range(n))
    return lambda: next(left, None) is not None


def plane(plan: Plan, origin_deg: tuple[float, float] = ORIGIN) -> NDArray[np.float64]:
    frame = LocalFrame(latitude_deg=origin_deg[0], longitude_deg=origin_deg[1])
    return np.array(
        [frame.to_enu(point.latitude_deg, point.longitude_deg, 0.0)[:2] for point in plan.waypoints]
    ).reshape(-1, 2)


def even_odd(points: NDArray[np.float64], fence: NDArray[np.float64]) -> NDArray[np.bool_]:
    inside = np.zeros(len(points), dtype=np.bool_)
    for (east0, north0), (east1, north1) in zip(fence, np.roll(fence, -1, axis=0), strict=True):
        spans = (north0 > points[:, 1]) != (north1 > points[:, 1])
        height = north1 - north0 if north1 != north0 else 1.0
        inside ^= spans & (points[:, 0] < east0 + (points[:, 1] - north0) / height * (east1 - east0))
    return inside


def edge_distance(points: NDArray[np.float64], fence: NDArray[np.float64]) -> NDArray[np.float64]:
    nearest = np.full(len(points), np.inf)
    for a, b in zip(fence, np.roll(fence, -1, axis=0), strict=True):
        share = np.clip((points - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-12), 0.0, 1.0)
        nearest = np.minimum(nearest, np.hypot(*(points - a - share[:, np.newaxis] * (b - a)).T))
    return nearest


def assert_within_limits(plan: Plan, limits: Limits, pose: PlanePose) -> None:
    """By the way-points alone: the polygon that the vehicle is given."""
    places = plane(plan)
    if not len(places):
        assert plan.length_m == 0.0
        return
    assert np.hypot(*(places[0] - pose[:2])) < 1e-3
    pieces = np.hypot(*np.diff(places, axis=0).T)
    assert pieces.sum() <= plan.length_m + 1e-3 <= limits.budget_m + 2e-3
    # A circle that touches two pieces from inside where they meet, as far out as the shorter one allows, is no tighter
    # than the vehicle's.
    course = np.unwrap(np.arctan2(*np.diff(places, axis=0).T))
    for (before_m, after_m), turned in zip(pairwise(pieces), np.abs(np.diff(course)), strict=True):
        if turned > 1e-6:
            assert (
                turned <= math.radians(15.0) + 1e-6
                or 0.5 * min(before_m, after_m) / math.tan(turned / 2.0) >= limits.turn_radius_m - 0.01
            )
    kinds = [point.kind for point in plan.waypoints]
    entries = [at for at, kind in enumerate(kinds) if kind == "leg_entry"]
    assert [kinds[at + 1] for at in entries] == ["leg_exit"] * len(plan.legs)
    assert all(point.why for point in plan.waypoints)
    if limits.fence is not None:
        on_the_way = np.concatenate(
            [a + np.linspace(0.0, 1.0, 40)[:, np.newaxis] * (b - a) for a, b in pairwise(places)]
        )
        assert even_odd(on_the_way, limits.fence).all()
        assert edge_distance(on_the_way, limits.fence).min() >= limits.fence_margin_m - 1e-3


def legs_alone_raise(
    clearance: Clearance, legs: tuple[PlannedLeg, ...], sonar: Sonar, settling_m: float
) -> NDArray[np.float64]:
    """Miss exponents after the legs, one cell and one leg at a time."""
    exponent = clearance.exponent.copy()
    for row in range(exponent.shape[0]):
        for column in range(exponent.shape[1]):
            centre = np.array([clearance.first_east + column + 0.5, clearance.first_north + row + 0.5]) * CELL_M
            taken: list[float] = []
            for leg in legs:
                heading = leg.entry.heading_rad
                ahead, right = (
                    np.array([math.sin(heading), math.cos(heading)]),
                    np.array([math.cos(heading), -math.sin(heading)]),
                )
                along, beside = float((centre - leg.entry[:2]) @ ahead), float((centre - leg.entry[:2]) @ right)
                length = math.hypot(leg.exit.east_m - leg.entry.east_m, leg.exit.north_m - leg.entry.north_m)
                half = CELL_M / 2.0 * (abs(ahead[0]) + abs(ahead[1])) - 1e-3
                if not settling_m + half <= along <= length - settling_m - half:
                    continue
                near_m, far_m = LIMITS.swath
                part = min(max(min(abs(beside) - near_m, far_m - abs(beside)) / CELL_M + 0.5, 0.0), 1.0)
                look = heading + math.copysign(math.pi / 2.0, beside)
                view = CellView(
                    seabed=clearance.seabed[row, column],
                    ground_range_m=np.float32(abs(beside)),
                    altitude_m=np.float32(5.0),
                    look_rad=np.float32(look),
                    ripple_rad=clearance.ripple_rad[row, column],
                    unevenness_db=clearance.unevenness_db[row, column],
                )
                p = part * min(float(sonar.p_look(view)), HIGHEST_P)
                if p <= 0.0:
                    continue
                alike = any(abs(math.remainder(look - other, 2.0 * math.pi)) <= math.radians(15.0) for other in taken)
                rho = sonar.same_look_correlation if alike else sonar.other_look_correlation if taken else 0.0
                exponent[row, column] += -(1.0 - rho) * math.log1p(-p)
                taken.append(look)
    return exponent


def test_a_small_area_is_cleared_by_the_legs_of_its_plan() -> None:
    state = world()
    plan = replan(state, POSE, LIMITS, None, steps(200))
    assert plan.verdict == ""
    reached = -np.expm1(-legs_alone_raise(state.clearance, plan.legs, Sonar(), LIMITS.settling_m))
    assert np.mean(reached >= state.required - 0.01) >= 0.97
    # Whole ladders at the best spacing take at least eight legs of 100 m with their turns.
    assert plan.length_m < 1000.0


@pytest.mark.parametrize("ripple_deg", [math.nan, 0.0, 50.0])
def test_what_a_plan_says_it_gains_is_what_its_legs_add_cell_by_cell(ripple_deg: float) -> None:
    state = world(12, 16, seabed="ripple" if math.isfinite(ripple_deg) else "flat", ripple_deg=ripple_deg)
    plan = replan(state, POSE, LIMITS, None, steps(30))
    wanted = -math.log1p(-state.required)
    added = np.minimum(legs_alone_raise(state.clearance, plan.legs, Sonar(), LIMITS.settling_m), wanted)
    assert plan.gain_m2 == pytest.approx(-np.expm1(-added).sum() / state.required * CELL_M**2, rel=0.02)
    assert plan.gain_m2 <= plan.bound_m2


@pytest.mark.parametrize(("side", "thin"), [(60, 2), (64, 3), (105, 6)])
def test_of_very_many_cells_it_plans_with_as_many_in_every_row_and_column(side: int, thin: int) -> None:
    """Of 2000 at most. Each has a ripple of its own, by which the sonar knows it."""
    state, asked = world(side, side, required=0.5), set[float]()

    class Asked(Sonar):
        def p_look(self, view: CellView) -> NDArray[np.float64]:
            asked.update(np.asarray(view.ripple_rad).tolist())
            return super().p_look(view._replace(ripple_rad=np.full_like(view.ripple_rad, np.nan)))

    state.clearance.ripple_rad[:] = np.linspace(0.0, 1e-3, side**2).reshape(side, side)
    plan = replan(state._replace(performance=Asked()), POSE, LIMITS, None, steps(0))
    taken = np.isin(state.clearance.ripple_rad, list(asked))
    assert set(taken.sum(axis=0)) | set(taken.sum(axis=1)) <= {side // thin, -(-side // thin)}
    assert 0.8 < plan.gain_m2 / (side * CELL_M) ** 2 <= 1.001


def test_over_ripples_it_looks_across_the_crests() -> None:
    for ripple_deg in (0.0, 70.0, 135.0):
        state = world(16, 16, seabed="ripple", ripple_deg=ripple_deg, required=0.8)
        longest = max(replan(state, POSE, LIMITS, None, steps(200)).legs, key=lambda leg: leg.gain_m2)
        look = longest.entry.heading_rad + math.pi / 2.0
        assert abs(math.remainder(look - math.radians(ripple_deg), math.pi)) < math.radians(30.0)
        assert "of floor of unknown kind" in longest.why  # its ripples are expected, and not seen yet


@pytest.mark.parametrize(
    ("off_deg", "words"), [(-25.0, "across"), (35.0, "oblique to"), (-55.0, "oblique to"), (65.0, "along")]
)
def test_the_reason_names_how_the_look_meets_the_crests_and_what_else_is_there(off_deg: float, words: str) -> None:
    heading_rad, n = math.radians(40.0), 20
    gain_m2, seabed = np.full(n, 100.0), np.full(n, SEABED_TYPES.index("ripple"), dtype=np.uint8)
    seabed[:2] = SEABED_TYPES.index("flat")
    ripple_rad = np.full(n, math.radians(40.0 + 90.0 + off_deg), dtype=np.float32)
    assert survey_words(heading_rad, gain_m2, seabed, ripple_rad, np.ones(n, dtype=np.bool_)) == (
        f"clears 1\u2009800 m² of ripple and 200 m² of other kinds at 040° {words} the crests; "
        "2\u2009000 m² of it were searched before and not well enough"
    )


def test_the_reason_states_no_kind_of_floor_that_is_only_expected() -> None:
    kinds, crests = np.full(20, SEABED_TYPES.index("ripple"), dtype=np.uint8), np.zeros(20, dtype=np.float32)
    words = survey_words(0.0, np.full(20, 100.0), kinds, crests, np.zeros(20, dtype=np.bool_))
    assert words == "clears 2\u2009000 m² of floor of unknown kind at 000°"


def star(radii: list[float], turned: float) -> NDArray[np.float64]:
    angle = turned + np.linspace(0.0, 2.0 * math.pi, len(radii), endpoint=False)
    return np.asarray(np.column_stack([np.sin(angle), np.cos(angle)]) * np.array(radii)[:, np.newaxis] + 40.0)


FENCES = st.one_of(
    st.none(),
    st.just(SQUARE),
    st.just(BAY),
    st.builds(star, st.lists(st.floats(20.0, 250.0), min_size=3, max_size=9), st.floats(0.0, 6.0)),
)
CONTACTS = st.lists(
    st.tuples(st.floats(-30.0, 110.0), st.floats(-30.0, 110.0), st.floats(0.0, 360.0), st.floats(0.0, 1.0)), max_size=6
)


@settings(max_examples=30, deadline=None)
@given(
    fence=FENCES,
    radius_m=st.floats(2.0, 40.0),
    budget_m=st.floats(0.0, 3000.0),
    margin_m=st.floats(0.0, 10.0),
    settling_m=st.floats(0.0, 20.0),
    pose=st.builds(PlanePose, st.floats(-50.0, 130.0), st.floats(-50.0, 130.0), st.floats(-7.0, 7.0)),
    asking=CONTACTS,
    searched=st.floats(0.0, 1.0),
    patience=st.integers(0, 25),
)
def test_no_leg_and_no_turn_ever_breaks_a_limit(
    fence: NDArray[np.float64] | None,
    radius_m: float,
    budget_m: float,
    margin_m: float,
    settling_m: float,
    pose: PlanePose,
    asking: list[tuple[float, float, float, float]],
    searched: float,
    patience: int,
) -> None:
    state = world(14, 14, contacts=tuple(contact(number, *reported) for number, reported in enumerate(asking)))
    state.clearance.exponent[np.random.default_rng(7).random((14, 14)) < searched] = 3.0
    limits = LIMITS._replace(
        turn_radius_m=radius_m, budget_m=budget_m, fence=fence, fence_margin_m=margin_m, settling_m=settling_m
    )
    plan = replan(state, pose, limits, None, steps(patience))
    assert_within_limits(plan, limits, pose)
    assert bool(plan.legs) or plan.verdict.startswith(("cannot, because ", "done: "))
    assert plan.gain_m2 <= plan.bound_m2
    assert plan == replan(state, pose, limits, None, steps(patience))
    # As the plan is flown, what is left of it keeps the limits as well.
    if plan.legs and math.isfinite(budget_m):
        less = limits._replace(budget_m=0.5 * budget_m)
        assert_within_limits(replan(state, pose, less, plan, steps(3)), less, pose)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"altitude_m": 1.0}, "below the minimum of 2 m"),
        ({"altitude_m": math.nan}, "is below the minimum"),
        ({"turn_radius_m": 0.0}, "turn radius"),
        ({"swath": (50.0, 50.0)}, "m is empty"),
        ({"budget_m": 0.0}, "no track is left"),
        ({"budget_m": math.nan}, "no track is left"),
        ({"budget_m": 30.0}, "no leg can be reached"),
        ({"fence": SQUARE[:2]}, "must be a polygon"),
        ({"fence": SQUARE * math.nan}, "must be a polygon"),
        ({"fence": SQUARE + 500.0}, "outside its fence"),
        ({"fence": np.array([[-25.0, -25.0], [-25.0, -15.0], [-15.0, -15.0], [-15.0, -25.0]])}, "room for a turn"),
    ],
)
def test_where_nothing_can_be_planned_it_gives_the_reason(changes: dict[str, Any], reason: str) -> None:
    for state in (world(), world(contacts=(contact(1, 30.0, 40.0),))):
        plan = replan(state, POSE, LIMITS._replace(**changes), None, steps(50))
        assert not plan.legs
        assert not plan.waypoints
        assert plan.verdict.startswith("cannot, because ")
        assert reason in plan.verdict


@pytest.mark.parametrize(
    "pose", [PlanePose(math.nan, 0.0, 0.0), PlanePose(0.0, math.inf, 0.0), PlanePose(0.0, 0.0, math.nan)]
)
def test_without_a_pose_there_is_no_plan(pose: PlanePose) -> None:
    assert "pose is not known" in replan(world(), pose, LIMITS, None, steps(50)).verdict


@pytest.mark.parametrize("highest_p", [0.0, math.nan])
def test_a_sonar_that_finds_nothing_gives_an_empty_plan_with_a_reason(highest_p: float) -> None:
    plan = replan(world(sonar=Sonar(highest_p)), POSE, LIMITS, None, steps(50))
    assert plan.legs == ()
    assert plan.verdict.startswith("cannot, because ")
    assert "finds nothing" in plan.verdict


def test_what_no_leg_adds_to_counts_as_the_area_that_is_not_clear() -> None:
    state = world(5, 8, required=0.9, sonar=Sonar(0.0))
    state.clearance.exponent[:, 0] = 3.0  # clear
    state.clearance.exponent[:, 1:4] = 1.0
    verdict = replan(state, POSE, LIMITS, None, steps(50)).verdict
    assert verdict.startswith(f"cannot, because {5 * 7 * CELL_M**2:.0f} m² are not clear and no leg adds to that")


def test_what_cannot_be_reached_is_stated_with_the_best_that_can() -> None:
    plan = replan(world(sonar=Sonar(0.02)), POSE, LIMITS, None, steps(20))
    assert "cannot be brought to 0.90 by any leg; the best that can be reached is 0." in plan.verdict


def test_a_budget_for_a_part_is_spent_on_it_and_the_share_is_stated() -> None:
    plan = replan(world(40, 40), POSE, LIMITS._replace(budget_m=700.0), None, steps(200))
    assert 400.0 < plan.length_m <= 700.0
    assert "700 m of track suffice for" in plan.verdict


def test_a_cleared_area_is_done_and_an_empty_one_too() -> None:
    state = world()
    state.clearance.exponent[:] = 2.4
    assert replan(state, POSE, LIMITS, None, steps(5)) == Plan(
        verdict="done: required clearance of 0.90 reached in all of 6\u2009400 m²"
    )
    nothing = state._replace(area=np.zeros((20, 20), dtype=np.bool_))
    assert "no area to clear" in replan(nothing, POSE, LIMITS, None, steps(5)).verdict
    empty = SurveyState(unsearched(*ORIGIN, CELL_M), np.zeros((0, 0), dtype=np.bool_), 0.9, Sonar(), ())
    assert replan(empty, POSE, LIMITS, None, steps(5)).verdict.startswith("done: ")


def test_an_area_laid_out_otherwise_and_a_certainty_are_refused() -> None:
    state = world()
    with pytest.raises(ValueError, match="clearance_over"):
        replan(state._replace(area=np.ones((3, 3), dtype=np.bool_)), POSE, LIMITS, None, steps(5))
    for required in (0.0, 1.0, math.nan):
        with pytest.raises(ValueError, match="required probability"):
            replan(state._replace(required=required), POSE, LIMITS, None, steps(5))
    assert replan(state._replace(required=HIGHEST_REQUIRED), POSE, LIMITS, None, steps(5)).legs


def test_contacts_are_looked_at_towards_where_they_ask_from_the_range_that_is_best() -> None:
    asking = tuple(
        contact(number, 20.0 * number, 60.0 - 15.0 * number, look_deg=37.0 * number) for number in range(2, 6)
    )
    state = world(contacts=asking)
    state.clearance.exponent[:] = 3.0
    plan = replan(state, POSE, LIMITS, None, steps(50))
    assert sorted(leg.contact_id for leg in plan.legs) == [reported.id for reported in asking]
    for leg in plan.legs:
        place = np.array([20.0, -15.0]) * int(leg.contact_id[1:]) + np.array([0.0, 60.0])
        heading = leg.entry.heading_rad
        beside = float((place - leg.entry[:2]) @ np.array([math.cos(heading), -math.sin(heading)]))
        middle = 0.5 * (np.array(leg.entry[:2]) + leg.exit[:2])
        assert abs(float((place - middle) @ np.array([math.sin(heading), math.cos(heading)]))) < 0.01
        # In the middle of 6 to 26 m, which are as good, but for one of the 16 steps of 44 m that are tried.
        assert abs(abs(beside) - 16.0) < 44.0 / 16.0
        look_deg = math.degrees(heading) + math.copysign(90.0, beside)
        assert abs(math.remainder(look_deg - 37.0 * int(leg.contact_id[1:]), 180.0)) < 0.01
        look = 37 * int(leg.contact_id[1:])
        towards = f"towards {look:03d}° or {(look + 180) % 360:03d}°, {abs(beside):.0f} m to the side"
        assert leg.why.startswith(f"second view of {leg.contact_id} {towards}")


def test_contacts_all_at_one_place_are_each_looked_at() -> None:
    asking = tuple(contact(number, 40.0, 40.0, look_deg=0.0) for number in range(5))
    state = world(contacts=asking)._replace(area=np.zeros((20, 20), dtype=np.bool_))
    plan = replan(state, POSE, LIMITS, None, steps(50))
    assert [sorted(leg.contact_id for leg in plan.legs), plan.verdict] == [[reported.id for reported in asking], ""]


@pytest.mark.parametrize("origin_deg", [(0.0, 180.0), (-17.0, -179.9999), (89.99, 30.0)])
def test_it_plans_alike_anywhere_on_the_globe(origin_deg: tuple[float, float]) -> None:
    here = replan(world(origin_deg=ORIGIN), POSE, LIMITS, None, steps(40))
    there = replan(world(origin_deg=origin_deg), POSE, LIMITS, None, steps(40))
    assert there.legs == here.legs
    assert np.abs(plane(there, origin_deg) - plane(here)).max() < 1e-3
    assert all(-180.0 <= point.longitude_deg < 180.0 for point in there.waypoints)


def test_a_plan_that_is_being_sailed_is_kept_while_no_other_is_a_tenth_better() -> None:
    state = world(contacts=(contact(1, 60.0, 20.0),))
    plan = replan(state, POSE, LIMITS, None, steps(60))
    for n in (0, 5, 60):
        again = replan(state, POSE, LIMITS, plan, steps(n))
        assert [leg[:2] for leg in again.legs] == [leg[:2] for leg in plan.legs]
    # On its way along the first leg.
    first = plan.legs[0]
    part = 0.3
    on_leg = PlanePose(
        first.entry.east_m + part * (first.exit.east_m - first.entry.east_m),
        first.entry.north_m + part * (first.exit.north_m - first.entry.north_m),
        first.entry.heading_rad,
    )
    going_on = replan(state, on_leg, LIMITS, plan, steps(60))
    assert going_on.legs[0].exit == first.exit
    assert [leg.entry for leg in going_on.legs[1:]] == [leg.entry for leg in plan.legs[1:]]


def test_a_plan_goes_once_its_work_is_done_or_a_better_one_is_found() -> None:
    state = world(contacts=(contact(1, 60.0, 20.0),))
    plan = replan(state, POSE, LIMITS, None, steps(60))
    decided = state._replace(contacts=(msgspec.structs.replace(state.contacts[0], next_look_deg=()),))
    assert all(leg.contact_id == "" for leg in replan(decided, POSE, LIMITS, plan, steps(40)).legs)
    worse = msgspec.structs.replace(plan, legs=plan.legs[:1])
    assert len(replan(state, POSE, LIMITS, worse, steps(60)).legs) > 1


def test_a_clearance_is_laid_over_a_box_with_what_is_known_in_place() -> None:
    known = world(3, 4, first=(10, 20)).clearance
    known.exponent[:] = np.arange(12.0).reshape(3, 4)
    laid = clearance_over(known, 8, 21, (5, 9))
    expected = np.zeros((5, 9))
    expected[0:2, 2:6] = known.exponent[1:]
    np.testing.assert_array_equal(laid.exponent, expected)
    assert (laid.first_east, laid.first_north, laid.ripple_rad.shape) == (8, 21, (5, 9))
    assert not clearance_over(known, 100, 100, (2, 2)).exponent.any()
    assert not clearance_over(known, 0, 0, (2, 2)).exponent.any()


def test_where_a_mean_suffices_the_plan_gets_it_with_less_track() -> None:
    state = world(30, 30)
    limits = LIMITS._replace(fence=None)
    every = replan(state, POSE, limits, None, steps(100))
    mean = replan(state._replace(mean_required=0.5), POSE, limits, None, steps(100))
    assert mean.length_m < 0.8 * every.length_m
    assert mean.gain_m2 * state.required >= 0.99 * 0.5 * state.area.sum() * CELL_M**2
    assert mean.verdict == ""


def test_floor_that_was_seen_from_two_sides_is_looked_at_from_elsewhere() -> None:
    state = world(20, 20)
    state.clearance.exponent[:] = 0.8
    state.clearance.looks[:] = 2
    state.clearance.towards[:] = np.bitwise_or.reduce(look_bit([0.5 * math.pi, 1.5 * math.pi]))
    plan = replan(state, POSE, LIMITS, None, steps(100))
    longest = max(plan.legs, key=lambda leg: leg.gain_m2)
    assert abs(math.sin(longest.entry.heading_rad)) > math.sin(math.radians(15.0))
