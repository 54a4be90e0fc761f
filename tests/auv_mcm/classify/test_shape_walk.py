"""Walks over the parameters of solids: points and the hypotheses they stand for, and C against the walk over any
cost."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.classify.fit import SOLIDS, hypotheses_of
from auv_mcm.classify.likelihood import beam_of, image_row_sums
from auv_mcm.kernels.shape import FORBIDDEN, PENCIL, Solid, intervals, intervals_numpy
from auv_mcm.kernels.shape_walk import (
    ONE,
    RATIO,
    SUNK,
    Walk,
    WalkSpace,
    costs_at,
    hypotheses_at,
    refine_shapes,
    refine_shapes_numpy,
    search_shapes,
    search_shapes_numpy,
)
from auv_mcm.solids.box_search import Optima, SearchBox, spread
from auv_mcm.solids.shapes import Cylinder, Shape, Sphere, TruncatedCone, Wedge
from tests.auv_mcm.classify.closed_forms import closed_form_region

Array = NDArray[np.float64]

SHAPES: dict[Solid, Shape] = {
    "sphere": Sphere(radius_m=0.4),
    "cylinder": Cylinder(radius_m=0.265, length_m=2.0, azimuth_rad=0.5),
    "truncated_cone": TruncatedCone(base_radius_m=0.49, top_radius_m=0.25, height_m=0.47),
    "wedge": Wedge(length_m=1.02, width_m=0.8, height_m=0.385, azimuth_rad=1.2),
}
PLACE = ((1.0, 1, ONE), (1.0, 2, ONE))
SPHERE = WalkSpace(
    "sphere",
    SearchBox(
        np.array([2.6, 19.5, 0.2, -0.3]),
        np.array([4.8, 20.8, 0.7, 0.6]),
        np.array([True, False, False, False]),
        np.full(4, 0.05),
    ),
    np.array([*PLACE, (1.0, RATIO, ONE), (1.0, 3, ONE), (1.0, SUNK, 3), *[(0.0, ONE, ONE)] * 3]),
    (0.06, 0.15),
    7.0,
)
CYLINDER = WalkSpace(
    "cylinder",
    SearchBox(
        np.array([2.6, 19.5, 0.2, 1.2, -0.5 * math.pi]),
        np.array([4.8, 20.8, 0.4, 2.6, 0.5 * math.pi]),
        np.array([False, False, False, False, True]),
        np.array([0.05, 0.05, 0.03, 0.1, 0.08]),
    ),
    np.array([*PLACE, (1.0, ONE, ONE), (1.0, 3, ONE), (1.0, 4, ONE), (1.0, 5, ONE), *[(0.0, ONE, ONE)] * 2]),
    (0.06, math.inf),
    0.0,
)


def hypothesis_by_hand(solid: Solid, point: list[float]) -> list[float]:
    """Burial as a share of radius or height; below 0 it is the altitude's; a cone has none, its height is a share of
    its base's width."""
    along, across, size, *more = point
    share = 0.0 if solid == "truncated_cone" else more[-1]
    before, sunk = [along, across, 1.0 + min(share, 0.0)], max(share, 0.0)
    match solid:
        case "sphere":
            fields = [size, sunk * size]
        case "cylinder":
            fields = [size, *more[:2], sunk * size]
        case "truncated_cone":
            fields = [size, size * more[0], 2.0 * size * more[1], 0.0]
        case "wedge":
            fields = [1.02 * size, 0.8 * size, 0.385 * size, more[0], sunk * 0.385 * size]
    return before + fields + [0.0] * (5 - len(fields))


@pytest.mark.parametrize("solid", SOLIDS)
@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_points_stand_for_the_hypotheses_worked_out_by_hand(solid: Solid, data: st.DataObject) -> None:
    n = {"sphere": 4, "cylinder": 6, "truncated_cone": 5, "wedge": 5}[solid]
    point = [*data.draw(st.lists(st.floats(0.1, 2.0), min_size=n - 1, max_size=n - 1)), data.draw(st.floats(-0.5, 0.6))]
    np.testing.assert_allclose(hypotheses_of(solid, np.array([point]))[0], hypothesis_by_hand(solid, point), rtol=1e-15)


@pytest.mark.parametrize("chart", [SPHERE, CYLINDER], ids=lambda chart: chart.solid)
@pytest.mark.parametrize("beam_width_rad", [0.0, 0.01])
def test_c_takes_the_steps_that_a_walk_over_any_cost_takes(chart: WalkSpace, beam_width_rad: float) -> None:
    for seed in range(3):
        random = np.random.Generator(np.random.PCG64(seed))
        region = closed_form_region(SHAPES[chart.solid], 20.0, random=random, beam_width_rad=beam_width_rad)
        image = image_row_sums(region, 1.3)
        assert image is not None
        beam = beam_of(region)
        assert beam.share.size == (3 if beam_width_rad else 1)
        walk = Walk(5, 12, 5, first_stride=3.0)
        fast, slow = (search(chart, image, PENCIL, 100, walk) for search in (search_shapes, search_shapes_numpy))
        assert_same(fast, slow)
        starts = costs_at(chart, chart.box.points(spread(100, len(chart.box.low))), image, PENCIL)
        assert fast.cost[0] < starts.min() < FORBIDDEN
        fine = Walk(3, 12, 5, first_stride=1.2)
        fast, slow = (refine(chart, image, beam, slow, fine) for refine in (refine_shapes, refine_shapes_numpy))
        assert_same(fast, slow)
        np.testing.assert_allclose(costs_at(chart, chart.box.points(fast.unit), image, beam), fast.cost, atol=1e-6)


def assert_same(fast: Optima, slow: Optima) -> None:
    np.testing.assert_array_equal(fast.unit, slow.unit)
    np.testing.assert_array_equal(fast.cost, slow.cost)


def test_a_search_finds_fewer_places_than_requested_where_no_more_lie_apart() -> None:
    image = image_row_sums(closed_form_region(SHAPES["sphere"], 20.0), 1.0)
    assert image is not None
    walk = Walk(4000, 1, 1, first_stride=1.0)
    fast, slow = (search(SPHERE, image, PENCIL, 5000, walk) for search in (search_shapes, search_shapes_numpy))
    assert 1 < len(fast.cost) < 4000
    assert_same(fast, slow)


def test_wrong_altitudes_burials_and_parameters_cost_nats() -> None:
    image = image_row_sums(closed_form_region(SHAPES["sphere"], 20.0), 1.0)
    assert image is not None
    points = np.array([[3.66, 20.0, 0.4, share] for share in (0.0, -0.06, 0.3)])
    plain = SPHERE._replace(sigma=(math.inf, math.inf), fixed_cost=0.0)
    assert (costs_at(plain, points, image, PENCIL) < FORBIDDEN).all()
    extra = costs_at(SPHERE, points, image, PENCIL) - costs_at(plain, points, image, PENCIL)
    np.testing.assert_allclose(extra, [7.0, 7.5, 9.0], rtol=1e-9)
    np.testing.assert_allclose(hypotheses_at(SPHERE.terms, points)[:, 2], [1.0, 0.94, 1.0])


@pytest.mark.parametrize("solid", SOLIDS)
@pytest.mark.parametrize("squint", [0.0, 0.1])
def test_intervals_of_c_and_numpy_are_the_same_columns(solid: Solid, squint: float) -> None:
    image = image_row_sums(closed_form_region(SHAPES[solid], 20.0, squint_rad=squint), 1.5)
    assert image is not None
    random = np.random.Generator(np.random.PCG64(5))
    sizes = {
        "sphere": [0.4, 0.1],
        "cylinder": [0.27, 2.0, 0.4, 0.1],
        "truncated_cone": [0.5, 0.3, 0.4, 0.1],
        "wedge": [1.0, 0.8, 0.4, 1.0, 0.1],
    }
    hypotheses = np.zeros((20, 8))
    hypotheses[:, :3] = random.uniform([3.4, 19.5, 0.95], [3.9, 20.5, 1.05], (20, 3))
    hypotheses[:, 3 : 3 + len(sizes[solid])] = np.array(sizes[solid]) * random.uniform(
        0.9, 1.1, (20, len(sizes[solid]))
    )
    fast, slow = intervals(solid, hypotheses, image), intervals_numpy(solid, hypotheses, image)
    assert fast.any()
    np.testing.assert_allclose(fast, slow, atol=1e-8)
