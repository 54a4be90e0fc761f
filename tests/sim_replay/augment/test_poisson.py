"""Heights from slopes against a dense least-squares solution, and on fields whose heights are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.augment.forward import across_slope
from sim_replay.augment.poisson import Stiffness, integrate_slope

Array = NDArray[np.float64]
NEARLY_FREE = Stiffness(along_weight=1e-9, screen_per_m2=1e-9)


def dense_equation(
    slope: Array, row_m: float, column_m: float, stiffness: Stiffness, weight: Array
) -> tuple[Array, Array]:
    """Left and right side of a least-squares problem, one row per term of the sum."""
    n_pings, n_columns = slope.shape
    index = np.arange(slope.size).reshape(slope.shape)
    rows, right = [], []
    for i in range(n_pings):
        for j in range(n_columns):
            if j > 0:
                row = np.zeros(slope.size)
                row[index[i, j]], row[index[i, j - 1]] = 1.0 / column_m, -1.0 / column_m
                rows.append(np.sqrt(weight[i, j]) * row)
                right.append(np.sqrt(weight[i, j]) * slope[i, j])
            if i > 0:
                row = np.zeros(slope.size)
                row[index[i, j]], row[index[i - 1, j]] = 1.0 / row_m, -1.0 / row_m
                rows.append(np.sqrt(stiffness.along_weight) * row)
                right.append(0.0)
            row = np.zeros(slope.size)
            row[index[i, j]] = np.sqrt(stiffness.screen_per_m2)
            rows.append(row)
            right.append(0.0)
    return np.array(rows), np.array(right)


def draw_masked(seed: int, shape: tuple[int, int]) -> tuple[Array, Array]:
    """Slopes and their weights, of which three in ten are 0."""
    generator = np.random.Generator(np.random.PCG64(seed))
    slope = generator.standard_normal(shape)
    return slope, np.where(generator.random(shape) < 0.3, 0.0, generator.random(shape))


@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 2**32),
    st.integers(1, 7),
    st.integers(1, 9),
    st.floats(0.05, 0.4),
    st.floats(0.05, 0.4),
    st.floats(0.0, 1.0),
    st.floats(0.01, 3.0),
)
def test_heights_are_the_least_squares_solution(
    seed: int, n_pings: int, n_columns: int, row_m: float, column_m: float, along_weight: float, screen_per_m2: float
) -> None:
    slope = np.random.Generator(np.random.PCG64(seed)).standard_normal((n_pings, n_columns))
    stiffness = Stiffness(along_weight, screen_per_m2)
    found = integrate_slope(slope, row_m, column_m, stiffness)
    wanted = np.linalg.lstsq(*dense_equation(slope, row_m, column_m, stiffness, np.ones_like(slope)), rcond=None)[0]
    np.testing.assert_allclose(found.ravel(), wanted, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 7), st.integers(2, 9), st.floats(0.02, 1.0), st.floats(0.05, 3.0))
def test_masked_heights_leave_no_more_than_the_residual_promised(
    seed: int, n_pings: int, n_columns: int, along_weight: float, screen_per_m2: float
) -> None:
    slope, weight = draw_masked(seed, (n_pings, n_columns))
    stiffness = Stiffness(along_weight, screen_per_m2)
    found = integrate_slope(slope, 0.15, 0.1, stiffness, weight)
    left, right = dense_equation(slope, 0.15, 0.1, stiffness, weight)
    residual = left.T @ (right - left @ found.ravel())
    assert np.linalg.norm(residual) <= 1.000001e-4 * np.linalg.norm(left.T @ right)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 7), st.integers(2, 9), st.floats(0.02, 1.0), st.floats(100.0, 1000.0))
def test_masked_heights_that_the_screen_holds_are_the_least_squares_solution(
    seed: int, n_pings: int, n_columns: int, along_weight: float, screen_per_m2: float
) -> None:
    """The largest curvature is at most seven times the smallest, so that the heights are as near as the residual
    shows."""
    slope, weight = draw_masked(seed, (n_pings, n_columns))
    stiffness = Stiffness(along_weight, screen_per_m2)
    found = integrate_slope(slope, 0.15, 0.1, stiffness, weight)
    wanted = np.linalg.lstsq(*dense_equation(slope, 0.15, 0.1, stiffness, weight), rcond=None)[0]
    assert np.linalg.norm(found.ravel() - wanted) <= 7e-4 * np.linalg.norm(wanted)


def hills(n_pings: int, n_columns: int) -> Array:
    row, column = np.mgrid[:n_pings, :n_columns] / 20.0
    return np.asarray(0.2 * np.sin(2.1 * row + 0.3) * np.cos(1.7 * column) + 0.05 * np.cos(5.0 * column + row))


def test_heights_come_back_from_their_own_slopes() -> None:
    heights = hills(40, 60)
    found = integrate_slope(across_slope(heights, 0.1), 0.2, 0.1, NEARLY_FREE)
    # Slopes across do not determine a ping's height.
    np.testing.assert_allclose(found - found.mean(axis=1)[:, None], heights - heights.mean(axis=1)[:, None], atol=1e-6)


@pytest.mark.parametrize("axis", [0, 1])
def test_field_that_varies_in_one_direction_alone_does_so_after_integration(axis: int) -> None:
    profile = np.sin(np.arange(50) / 4.0)
    slope = np.tile(profile, (30, 1)) if axis == 1 else np.tile(profile[:, None], (1, 30))
    found = integrate_slope(slope, 0.2, 0.1, Stiffness(0.1, 0.2))
    if axis == 1:
        assert np.ptp(found, axis=0).max() < 1e-12
    else:
        singular = np.linalg.svd(integrate_slope(slope, 0.2, 0.1, Stiffness(0.0, 0.2)), compute_uv=False)
        assert singular[1] < 1e-12 * singular[0]


def test_flat_image_stays_flat_and_constant_slope_finite() -> None:
    assert not integrate_slope(np.zeros((8, 9)), 0.2, 0.1, Stiffness(0.1, 0.1)).any()
    steep = integrate_slope(np.full((400, 500), 1.2), 0.2, 0.1, Stiffness(0.1, 0.1))
    # Heights fall off over 1 / sqrt(screen) from the ends, where the slope adds up to 1.2 times that.
    assert np.abs(steep).max() < 1.2 / np.sqrt(0.1)
    with pytest.raises(ValueError, match="above 0"):
        integrate_slope(np.zeros((8, 9)), 0.2, 0.1, Stiffness(0.1, 0.0))


def test_hole_is_bridged_from_its_neighbours_along_the_track() -> None:
    heights = np.tile(hills(1, 60), (40, 1))
    slope, weight = across_slope(heights, 0.1), np.ones((40, 60))
    slope[15:25, 20:40], weight[15:25, 20:40] = 99.0, 0.0
    found = integrate_slope(slope, 0.2, 0.1, Stiffness(0.1, 1e-4), weight)
    np.testing.assert_allclose(found - found.mean(), heights - heights.mean(), atol=2e-3)


def test_good_start_is_kept() -> None:
    slope, weight = across_slope(hills(20, 30), 0.1), np.ones((20, 30))
    weight[:, 7:11] = 0.0
    once = integrate_slope(slope, 0.2, 0.1, Stiffness(0.1, 0.1), weight)
    np.testing.assert_allclose(integrate_slope(slope, 0.2, 0.1, Stiffness(0.1, 0.1), weight, once), once, atol=1e-4)
