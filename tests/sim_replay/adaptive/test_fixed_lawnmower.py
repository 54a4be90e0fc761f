"""The lawnmower laid beforehand is the shortest that is expected to do, by a sum over all looks at all places."""

from __future__ import annotations

import math

import numpy as np
import pytest

from auv_mcm.plan.dubins import PlanePose, dubins_path
from auv_mcm.plan.limits import Limits
from sim_replay.adaptive.lawnmower import expected_clearance, shortest_lawnmower, way_m, worst_seabed
from sim_replay.simulator.plan import Leg
from tests.make.looks import EvenLook

START = PlanePose(10.0, -30.0, 0.0)
LIMITS = Limits(turn_radius_m=10.0, budget_m=9000.0, fence=None, altitude_m=5.0, min_altitude_m=2.0, swath=(2.0, 30.0))


def seen_from(leg: Leg, east: float, north: float) -> tuple[float, float]:
    """Part of a 4 m cell that a leg sees, and the direction it looks in, degrees."""
    across = leg.along_across(east, north)[1]
    part = min(max(min(abs(across) - 2.0, 30.0 - abs(across)) / 4.0 + 0.5, 0.0), 1.0)
    return part, round(math.degrees(leg.direction_rad) + math.copysign(90.0, across)) % 360


def clearance_place_by_place(legs: tuple[Leg, ...], side_m: float, p: float, same: float, other: float) -> float:
    n = math.ceil(side_m / 4.0)
    total = 0.0
    for east in (np.arange(n) + 0.5) * side_m / n:
        for north in (np.arange(n) + 0.5) * side_m / n:
            exponent, before = 0.0, set[float]()
            for leg in legs:
                part, direction = seen_from(leg, float(east), float(north))
                if part == 0.0:
                    continue
                weight = 1.0 if not before else 1.0 - (same if direction in before else other)
                exponent -= weight * math.log(1.0 - part * p)
                before.add(direction)
            total += 1.0 - math.exp(-exponent)
    return total / n**2


@pytest.mark.parametrize("required", [0.5, 0.8, 0.95])
def test_expected_clearance_is_the_sum_over_all_looks_at_all_places(required: float) -> None:
    lawnmower = shortest_lawnmower(80.0, required, {"flat": 1.0}, EvenLook(0.6), LIMITS, START)
    assert lawnmower is not None
    assert lawnmower.expected >= required
    assert lawnmower.expected == pytest.approx(clearance_place_by_place(lawnmower.legs, 80.0, 0.6, 0.5, 0.1), abs=1e-9)


def test_more_clearance_is_never_shorter() -> None:
    lengths = []
    for required in (0.3, 0.5, 0.7, 0.9):
        lawnmower = shortest_lawnmower(80.0, required, {"flat": 1.0}, EvenLook(0.6), LIMITS, START)
        assert lawnmower is not None
        lengths.append(lawnmower.length_m)
    assert lengths == sorted(lengths)


def test_the_length_is_that_of_legs_and_turns_between_them() -> None:
    lawnmower = shortest_lawnmower(80.0, 0.8, {"flat": 1.0}, EvenLook(0.6), LIMITS, START)
    assert lawnmower is not None
    length, pose = 0.0, START
    for leg in lawnmower.legs:
        length += dubins_path(pose, PlanePose(leg.east_m, leg.north_m, leg.direction_rad), 10.0).length_m + leg.length_m
        pose = PlanePose(*leg.end, leg.direction_rad)
    assert lawnmower.length_m == pytest.approx(length)
    assert way_m(lawnmower.legs, LIMITS, START) == pytest.approx(length)


def test_where_nothing_is_found_there_is_no_lawnmower() -> None:
    assert shortest_lawnmower(80.0, 0.5, {"flat": 1.0}, EvenLook(0.0), LIMITS, START) is None


def test_a_mixture_is_expected_to_give_the_mean_of_its_parts() -> None:
    class ByKind(EvenLook):
        def p_look(self, seabed, ground_range_m, altitude_m, look_rad, ripple_rad):  # type: ignore[no-untyped-def]  # as of LookModel
            return np.where(seabed == 0, 0.8, 0.2)

    lawnmower = shortest_lawnmower(80.0, 0.5, {"flat": 0.25, "rough": 0.75}, ByKind(0.0), LIMITS, START)
    assert lawnmower is not None
    flat, rough = (
        expected_clearance(lawnmower.legs, 80.0, {kind: 1.0}, ByKind(0.0), LIMITS) for kind in ("flat", "rough")
    )
    assert lawnmower.expected == pytest.approx(0.25 * flat + 0.75 * rough)
    assert worst_seabed(ByKind(0.0), LIMITS) != "flat"
