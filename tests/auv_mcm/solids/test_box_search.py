"""The search over a box: spread of starts, what walks find, and the covariance of where they end."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.solids.box_search import Optima, SearchBox, apart, curvature_covariance, look_around, spread, walk

Array = NDArray[np.float64]


def box(n: int, *, wraps: bool = False) -> SearchBox:
    return SearchBox(np.full(n, -2.0), np.full(n, 2.0), np.full(n, wraps), np.full(n, 0.1))


@pytest.mark.parametrize("n_dimensions", [1, 2, 5])
def test_starts_fill_the_cube_more_evenly_than_chance_would(n_dimensions: int) -> None:
    points = spread(512, n_dimensions)
    assert points.min() >= 0.0
    assert points.max() < 1.0
    random = np.random.Generator(np.random.PCG64(1)).uniform(size=points.shape)
    worst = [
        np.abs(np.sort(values, axis=0) - (np.arange(512)[:, np.newaxis] + 0.5) / 512).max()
        for values in (points, random)
    ]
    assert worst[0] < 0.5 * worst[1]
    np.testing.assert_array_equal(points[100:], spread(412, n_dimensions, first=100))


def test_the_lowest_point_of_a_tilted_bowl_is_found() -> None:
    lowest = np.array([0.3, -1.2, 0.9])
    turned = np.array([[2.0, 0.6, 0.0], [0.6, 1.0, 0.3], [0.0, 0.3, 4.0]])

    def cost(points: Array) -> Array:
        away = points - lowest
        return np.asarray(np.einsum("ni,ij,nj->n", away, turned, away))

    starts = look_around(cost, box(3), 200, 4)
    found = walk(cost, box(3), starts, 40, 8, first_stride=3.0)
    np.testing.assert_allclose(box(3).points(found.unit[:1])[0], lowest, atol=0.03)
    assert (np.diff(found.cost) >= 0.0).all()
    assert (found.cost[0] <= starts.cost).all()


def test_two_valleys_are_two_optima() -> None:
    def cost(points: Array) -> Array:
        valleys = np.array([[-1.0, 0.0], [1.0, 0.5]])
        away = np.square(points[:, np.newaxis] - valleys).sum(axis=2) + np.array([0.1, 0.0])
        return np.asarray(away.min(axis=1))

    found = apart(walk(cost, box(2), look_around(cost, box(2), 300, 6), 30, 6, first_stride=2.0), box(2), 2)
    np.testing.assert_allclose(box(2).points(found.unit), [[1.0, 0.5], [-1.0, 0.0]], atol=0.05)


def test_what_wraps_is_walked_across_and_what_does_not_is_reflected() -> None:
    wrapping, reflecting = box(1, wraps=True), box(1)
    np.testing.assert_allclose(wrapping.points(np.array([[1.1], [-0.1]])), [[-1.6], [1.6]])
    np.testing.assert_allclose(reflecting.points(np.array([[1.1], [-0.1]])), [[1.6], [-1.6]])
    start = Optima(np.array([[0.97]]), np.array([math.inf]))
    for space, expected in ((wrapping, -1.9), (reflecting, 2.0)):

        def cost(points: Array) -> Array:
            return np.asarray(np.minimum(np.abs(points[:, 0] + 1.9), 0.5 + np.abs(points[:, 0] - 2.0)))

        found = walk(cost, space, start, 30, 6, first_stride=1.0)
        assert space.points(found.unit)[0, 0] == pytest.approx(expected, abs=0.03)


def test_points_near_across_the_wrap_are_not_apart() -> None:
    optima = Optima(np.array([[0.99], [0.01], [0.5]]), np.array([0.0, 1.0, 2.0]))
    assert apart(optima, box(1, wraps=True), 3).cost.tolist() == [0.0, 2.0]
    assert apart(optima, box(1), 3).cost.tolist() == [0.0, 1.0, 2.0]


def test_covariance_is_the_inverse_of_the_curvature() -> None:
    information = np.array([[900.0, 200.0], [200.0, 2500.0]])
    centre = np.array([0.4, -0.7])

    def cost(points: Array) -> Array:
        away = points - centre
        return np.asarray(0.5 * np.einsum("ni,ij,nj->n", away, information, away))

    np.testing.assert_allclose(curvature_covariance(cost, box(2), centre), np.linalg.inv(information), rtol=1e-6)


def test_covariance_of_a_flat_or_forbidden_neighbourhood_is_finite_and_positive() -> None:
    for level in (0.0, 1e12):

        def cost(points: Array, level: float = level) -> Array:
            return np.where(points[:, 0] == 0.5, 0.0, level)

        covariance = curvature_covariance(cost, box(2), np.array([0.5, 0.5]))
        assert np.isfinite(covariance).all()
        assert (np.diag(covariance) > 0.0).all()
