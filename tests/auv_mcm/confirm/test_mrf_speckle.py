"""Grain of speckle measured on drawn regions, and blocks of it against plain loops and sampled variances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.confirm.speckle import (
    Correlation,
    block_means,
    grain_area,
    looks_of_blocks,
    measure_correlation,
    nyquist_factors,
)
from auv_mcm.kernels.speckle import half_differences, half_differences_in, half_differences_numpy
from tests.make.drawn_regions import Drawing, draw_region


def sea_floor(seed: int, spread_rows: float, spread_columns: float) -> NDArray[np.float64]:
    drawing = Drawing(
        object_rows=0, spread_rows=spread_rows, spread_columns=spread_columns, seed=seed, n_rows=160, n_columns=200
    )
    return draw_region(drawing)[0].intensity


@pytest.mark.parametrize(("spread_rows", "spread_columns"), [(0.0, 0.0), (0.8, 0.8), (1.4, 1.1), (0.0, 1.2)])
def test_grain_is_that_of_the_point_spread(spread_rows: float, spread_columns: float) -> None:
    measured = np.mean(
        [measure_correlation(plane := sea_floor(seed, spread_rows, spread_columns), plane >= 0) for seed in range(4)],
        axis=0,
    )
    expected = [max(1.0, math.sqrt(2.0 * math.pi) * spread) for spread in (spread_rows, spread_columns)]
    np.testing.assert_allclose(measured, expected, rtol=0.1)


def test_a_slope_of_brightness_is_no_grain() -> None:
    plane = sea_floor(1, 0.0, 0.0) * np.linspace(0.7, 1.3, 200)
    assert max(measure_correlation(plane, plane >= 0.0)) < 1.3


def test_pixels_left_out_do_not_count() -> None:
    plane = sea_floor(2, 0.8, 0.8)
    background = np.ones(plane.shape, dtype=np.bool_)
    background[40:90, 60:140] = False
    spoilt = np.where(background, plane, 1e5)
    assert measure_correlation(spoilt, background) == measure_correlation(np.where(background, plane, 0.0), background)
    assert measure_correlation(plane, np.zeros_like(background)) == Correlation(1.0, 1.0)


GRAINS = pytest.mark.parametrize(("spread_rows", "spread_columns"), [(0.0, 0.0), (0.8, 0.8), (1.4, 1.1), (0.0, 1.2)])


def area_in(plane: NDArray[np.float64]) -> float:
    return grain_area(plane, np.ones(plane.shape, dtype=np.bool_))


@GRAINS
def test_the_area_of_a_grain_is_that_of_the_point_spread(spread_rows: float, spread_columns: float) -> None:
    expected = math.prod(max(1.0, math.sqrt(2.0 * math.pi) * spread) for spread in (spread_rows, spread_columns))
    for seed in range(4):
        assert area_in(sea_floor(seed, spread_rows, spread_columns)) == pytest.approx(expected, rel=0.25)


@GRAINS
@pytest.mark.parametrize("object_rows", [10, 60])
def test_an_object_with_its_shadow_hardly_changes_the_area_of_a_grain(
    spread_rows: float, spread_columns: float, object_rows: int
) -> None:
    drawing = Drawing(
        object_rows=object_rows,
        spread_rows=spread_rows,
        spread_columns=spread_columns,
        seed=5,
        n_rows=160,
        n_columns=200,
    )
    with_object = draw_region(drawing)[0].intensity
    assert area_in(with_object) == pytest.approx(area_in(sea_floor(5, spread_rows, spread_columns)), rel=0.15)


@GRAINS
@pytest.mark.parametrize("along_rows", [True, False])
def test_a_ripple_crest_hardly_changes_the_area_of_a_grain(
    spread_rows: float, spread_columns: float, along_rows: bool
) -> None:
    """Bright and dark stripes over two fifths of the region, which by themselves are correlated over several pixels."""
    plain = sea_floor(6, spread_rows, spread_columns)
    plane = plain.copy()
    stripes = plane.T if along_rows else plane
    n = 2 * len(stripes) // 5
    stripes[:n] *= 1.0 + 0.9 * np.sin(2.0 * math.pi * np.arange(n) / 14.0)[:, np.newaxis]
    assert area_in(plane) == pytest.approx(area_in(plain), rel=0.15)


def test_pixels_not_measured_do_not_count_for_the_area_of_a_grain() -> None:
    plane = sea_floor(7, 0.8, 0.8)
    usable = np.ones(plane.shape, dtype=np.bool_)
    usable[:100] = False
    spoilt = np.where(usable, plane, 1e5)
    assert grain_area(spoilt, usable) == grain_area(np.where(usable, plane, math.nan), usable)
    assert grain_area(spoilt, usable) == pytest.approx(area_in(plane), rel=0.2)


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (2, 50), (50, 2), (20, 20)])
def test_where_nothing_can_be_measured_grains_are_taken_for_pixels(shape: tuple[int, int]) -> None:
    assert area_in(sea_floor(8, 0.8, 0.8)[: shape[0], : shape[1]]) == 1.0
    assert grain_area(sea_floor(8, 0.8, 0.8), np.zeros((160, 200), dtype=np.bool_)) == 1.0
    assert area_in(np.ones((100, 100))) == 1.0


@pytest.mark.parametrize("factors", [(1, 1), (2, 3), (3, 2), (4, 4)])
def test_block_means_are_means_of_usable_pixels(factors: tuple[int, int]) -> None:
    random = np.random.Generator(np.random.PCG64(3))
    plane, usable = random.exponential(1.0, (11, 13)), random.random((11, 13)) < 0.6
    usable[:4, :6] = False
    mean, coverage = block_means(plane, usable, factors)
    assert mean.shape == (-(-11 // factors[0]), -(-13 // factors[1]))
    for row, column in np.ndindex(mean.shape):
        block = np.s_[row * factors[0] : (row + 1) * factors[0], column * factors[1] : (column + 1) * factors[1]]
        values = plane[block][usable[block]]
        assert mean[row, column] == pytest.approx(values.mean() if len(values) else 1.0)
        assert coverage[row, column] == pytest.approx(len(values) / (factors[0] * factors[1]))


@pytest.mark.parametrize(("spread", "factors"), [(0.0, (2, 2)), (0.8, (2, 2)), (1.1, (3, 3)), (1.4, (3, 4))])
def test_looks_of_blocks_are_one_over_their_variance(spread: float, factors: tuple[int, int]) -> None:
    correlation = Correlation(*[max(1.0, math.sqrt(2.0 * math.pi) * spread)] * 2)
    planes = [sea_floor(seed, spread, spread) for seed in range(10, 16)]
    means = np.concatenate([block_means(plane, plane >= 0.0, factors)[0][:-1, :-1].ravel() for plane in planes])
    assert looks_of_blocks(correlation, factors) == pytest.approx(means.mean() ** 2 / means.var(), rel=0.12)


def test_blocks_hold_one_grain_but_stay_small_against_a_mine() -> None:
    assert nyquist_factors(Correlation(3.4, 1.2), 0.03, 0.03) == (3, 1)
    assert nyquist_factors(Correlation(3.4, 3.4), 0.12, 0.06) == (2, 3)
    assert nyquist_factors(Correlation(9.0, 9.0), 0.5, 0.5) == (1, 1)


@given(
    seed=st.integers(0, 10**6),
    n_rows=st.integers(1, 9),
    n_columns=st.integers(1, 14),
    share=st.sampled_from([0.0, 0.5, 1.0]),
)
@settings(max_examples=60, deadline=None)
def test_half_differences_are_those_of_pairs_taken_one_by_one(
    seed: int, n_rows: int, n_columns: int, share: float
) -> None:
    random = np.random.default_rng(seed)
    usable = random.uniform(size=(n_rows, n_columns)) < share
    plane = np.where(usable, random.exponential(1.0, (n_rows, n_columns)), np.nan)
    lags = (1, 2, 7)
    wanted = np.full((2, len(lags)), np.nan)
    for axis, (down, right) in enumerate(((1, 0), (0, 1))):
        for k, lag in enumerate(lags):
            ends = [(r, c, r + lag * down, c + lag * right) for r in range(n_rows) for c in range(n_columns)]
            pairs = [
                (plane[r, c], plane[s, d])
                for r, c, s, d in ends
                if s < n_rows and d < n_columns and usable[r, c] and usable[s, d]
            ]
            if len(pairs) >= 3:
                wanted[axis, k] = 0.5 * sum((a - b) ** 2 for a, b in pairs) / len(pairs)
    for function in (half_differences, half_differences_numpy):
        np.testing.assert_allclose(function(plane, usable, lags, 3), wanted, rtol=1e-12)


def test_planes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="one 2-d shape"):
        half_differences(np.ones((3, 4)), np.ones((4, 3), dtype=np.bool_), (1,), 1)


def test_half_differences_of_parts_are_those_of_the_parts_alone() -> None:
    random = np.random.Generator(np.random.PCG64(8))
    plane, usable = random.exponential(1.0, (20, 33)), random.random((20, 33)) > 0.1
    boxes = [(0, 0, 20, 33), (3, 5, 17, 30), (0, 32, 20, 33), (4, 4, 4, 9)]
    together = half_differences_in(plane, usable, boxes, (1, 2, 7), 5)
    for found, (top, near, bottom, far) in zip(together, boxes, strict=True):
        alone = half_differences_numpy(plane[top:bottom, near:far], usable[top:bottom, near:far], (1, 2, 7), 5)
        np.testing.assert_allclose(found, alone, rtol=1e-12)
    with pytest.raises(ValueError, match="must lie in a plane of 20 rows and 33 columns"):
        half_differences_in(plane, usable, [(0, 0, 21, 33)], (1,), 1)
