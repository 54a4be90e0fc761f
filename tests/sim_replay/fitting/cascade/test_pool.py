from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.detect.cascade.bands import areas, band_edges, bands_at, box_fault, pixel_boxes
from auv_mcm.detect.cascade.codes import CodePlane, box_sums, codes_of, make_plane
from auv_mcm.kernels.cascade import CODE_OF_MEAN
from sim_replay.fitting.cascade.boost import BoostedStump
from sim_replay.fitting.cascade.pool import (
    Feature,
    Pool,
    bin_edges,
    feature_pool,
    feature_values,
    model_stump,
    pool_box_means,
    quantise,
)

POOL = feature_pool()
ROW_M, COLUMN_M, ALTITUDE_M = 0.12, 0.06, 7.0


def _plane(codes: np.ndarray) -> CodePlane:
    everywhere = np.ones(codes.shape, dtype=np.bool_)
    return make_plane(codes, everywhere, everywhere, np.full(len(codes), ALTITUDE_M), ROW_M, COLUMN_M)


def _speckle(seed: int, shape: tuple[int, int] = (40, 300)) -> np.ndarray:
    speckle = np.random.Generator(np.random.PCG64(seed)).gamma(0.7, 1.4, shape)
    return codes_of(speckle.astype(np.float32), np.ones(shape, dtype=np.bool_))


def _windows(n: int, seed: int, shape: tuple[int, int] = (40, 300)) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.Generator(np.random.PCG64(seed))
    return rng.integers(0, shape[0], n), rng.integers(0, shape[1], n)


def test_pool_is_the_same_every_time_and_of_thousands_of_features() -> None:
    assert feature_pool.__wrapped__() == POOL  # made again
    assert 4000 <= len(POOL.features) <= 10_000
    assert len(set(POOL.features)) == len(POOL.features)


def test_every_box_may_stand_in_a_model_and_every_box_is_used() -> None:
    assert [box_fault(box) for box in POOL.boxes] == [None] * len(POOL.boxes)
    assert {number for feature in POOL.features for number in feature[1:]} | {0} == set(range(len(POOL.boxes)))


def test_box_means_are_those_of_pixels_added_one_by_one() -> None:
    codes = _speckle(1)
    rows, columns = _windows(6, 2)
    means = pool_box_means(_plane(codes), POOL.boxes, rows, columns)
    bands = bands_at(band_edges(np.full(40, ALTITUDE_M), 300, COLUMN_M), rows, columns)
    tables = pixel_boxes(POOL.boxes, ROW_M, COLUMN_M)
    for window, (row, column, band) in enumerate(zip(rows, columns, bands, strict=True)):
        for box in range(0, len(POOL.boxes), 17):
            top, bottom, left, right = tables[band, box].tolist()
            inside = [
                int(codes[i, j]) if 0 <= i < 40 and 0 <= j < 300 else CODE_OF_MEAN
                for i in range(row + top, row + bottom)
                for j in range(column + left, column + right)
            ]
            assert means[box, window] == pytest.approx(sum(inside) / len(inside), rel=1e-6)


def test_features_are_ratios_of_means_and_differences_over_the_window() -> None:
    pool = Pool(POOL.boxes[:3], (Feature(True, 1, 2), Feature(False, 1, 2)))
    means = np.array([[10.0, 0.0], [6.0, 0.0], [4.0, 0.0]], dtype=np.float32)
    values = feature_values(pool, range(2), means)
    assert values[:, 0] == pytest.approx([1.5, 0.2])
    assert np.isnan(values[:, 1]).all()


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), level=st.sampled_from([0.0, 0.001, 1.0, 16.0]), n_windows=st.integers(1, 60))
def test_a_value_is_below_an_edge_if_and_only_if_its_bin_is(seed: int, level: float, n_windows: int) -> None:
    pool = Pool(POOL.boxes, POOL.features[::97])
    means = pool_box_means(
        _plane((_speckle(seed) * level).clip(0, 16384).astype(np.uint16)), pool.boxes, *_windows(n_windows, seed)
    )
    edges, values = bin_edges(pool, means), feature_values(pool, range(len(pool.features)), means)
    assert np.isfinite(edges).all()
    assert (np.diff(edges, axis=1) >= 0).all()
    bins = quantise(pool, edges, means)
    for k in (0, 1, 100, 253, 254):
        assert np.array_equal(values < edges[:, k : k + 1], bins <= k)


def test_what_is_not_a_number_is_above_every_edge() -> None:
    pool = Pool(POOL.boxes[:3], (Feature(True, 1, 2), Feature(False, 1, 2)))
    edges = bin_edges(pool, np.ones((3, 5), dtype=np.float32))
    assert quantise(pool, edges, np.zeros((3, 2), dtype=np.float32)).tolist() == [[255, 255], [255, 255]]


def test_a_boosted_stump_decides_as_the_model_s_comparison_of_sums_does() -> None:
    plane = _plane(_speckle(9))
    rows, columns = _windows(400, 3)
    pool = Pool(POOL.boxes, POOL.features[::199])
    means = pool_box_means(plane, pool.boxes, rows, columns)
    edges = bin_edges(pool, means)
    bins = quantise(pool, edges, means)
    bands = bands_at(band_edges(plane.first_return_m, plane.n_columns, COLUMN_M), rows, columns)
    for feature in range(len(pool.features)):
        boosted = BoostedStump(feature, 130, -7, 5)
        stump = model_stump(pool, edges, boosted)
        boxes = pixel_boxes([stump.a, stump.b, stump.w or stump.a], ROW_M, COLUMN_M)[bands]
        sums = box_sums(plane, rows[:, np.newaxis], columns[:, np.newaxis], boxes).astype(np.float32).T
        area = areas(boxes).T
        threshold = stump.threshold
        w_a, w_b, w_w = (
            (k / area[i]).astype(np.float32) for i, k in enumerate((1.0, 1.0 if stump.w else threshold, threshold))
        )
        holds = sums[0] * w_a - sums[1] * w_b < sums[2] * w_w if stump.w else sums[0] * w_a < sums[1] * w_b
        assert np.array_equal(np.where(holds, -7, 5), boosted.scores(bins))


def test_quantiles_of_no_windows_are_refused() -> None:
    with pytest.raises(ValueError, match="no windows"):
        bin_edges(POOL, np.empty((len(POOL.boxes), 0), dtype=np.float32))


@pytest.mark.parametrize("level", [0, 1, 16384])
def test_thresholds_stay_within_what_a_model_may_hold_however_dark_or_bright_the_tile(level: int) -> None:
    means = pool_box_means(_plane(np.full((40, 300), level, dtype=np.uint16)), POOL.boxes, *_windows(20, 5))
    edges = bin_edges(POOL, means)
    for feature in range(0, len(POOL.features), 23):
        for last_below in (0, 254):
            threshold = model_stump(POOL, edges, BoostedStump(feature, last_below, 1, -1)).threshold
            assert 1e-4 <= threshold <= 1e4 if POOL.features[feature].is_ratio else abs(threshold) <= 1e4
