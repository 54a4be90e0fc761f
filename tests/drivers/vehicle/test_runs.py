"""Points along runs: evenly on the line, and nowhere else."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.navigation.corrections import offset_m
from drivers.vehicle.runs import ON_LEG, with_points_on_legs
from tests.drivers.vehicle.test_pilot import HOME_DEG, plan, waypoint

Metres = st.tuples(st.floats(-500.0, 500.0), st.floats(-500.0, 500.0))


@given(entry=Metres, way_out=Metres, spacing_m=st.floats(1.0, 100.0))
def test_points_lie_evenly_on_the_run(
    entry: tuple[float, float], way_out: tuple[float, float], spacing_m: float
) -> None:
    whole = plan((entry, way_out))
    flown = with_points_on_legs(whole, spacing_m)
    assert tuple(point for point in flown if point.kind != ON_LEG) == whole
    places = [offset_m(HOME_DEG, (point.latitude_deg, point.longitude_deg)) for point in flown[1:]]
    steps = [math.dist(*pair) for pair in pairwise(places)]
    assert max(steps) <= spacing_m * 1.001 + 1e-3
    assert max(steps) - min(steps) <= 0.02
    assert sum(steps) == pytest.approx(math.dist(entry, way_out), rel=1e-3, abs=0.05)


def test_turns_and_what_begins_a_plan_are_left_as_they_are() -> None:
    points = (
        waypoint(1, "start", (0.0, 0.0)),
        waypoint(1, "turn", (0.0, 90.0)),
        waypoint(1, "leg_entry", (90.0, 90.0)),
    )
    assert with_points_on_legs(points, 10.0) == points
