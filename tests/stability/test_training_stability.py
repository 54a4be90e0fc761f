"""Boosting, thresholds and calibration on samples as bad as they come: no flag, bounded leaves, models that can be read
back.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.detect.cascade.codes import CodePlane, make_plane
from auv_mcm.detect.cascade.model import (
    MAX_LEAF,
    MAX_STUMPS,
    SCORE_UNIT,
    CascadeModel,
    check_model,
    encode_model,
    parse_model,
)
from auv_mcm.detect.cascade.run import trace_plane
from auv_mcm.kernels.cascade import encode
from sim_replay.fitting.cascade.boost import N_BINS, Bins, BoostedStump, gentle_split, gentle_stumps, histograms
from sim_replay.fitting.cascade.pool import Pool, bin_edges, feature_pool, model_stump, pool_box_means, quantise
from sim_replay.fitting.cascade.soft import best_windows, reject_thresholds
from sim_replay.fitting.cascade.validation import ValidationSighting, calibrate, expected_pd
from tests.make.models import model_with
from tests.make.random_numbers import generator
from tests.stability.tile_pictures import PICTURES

Labels = NDArray[np.bool_]

POOL = feature_pool()
SOME = Pool(POOL.boxes, POOL.features[::41])
SHAPE = (40, 160)
MOST = MAX_STUMPS * MAX_LEAF


def plane_of(
    picture: NDArray[np.float64], first_return_m: float = 6.0, spacing: tuple[float, float] = (0.12, 0.06)
) -> CodePlane:
    codes, valid = encode(picture.astype(np.float32), np.ones(picture.shape, dtype=np.uint8))
    return make_plane(codes, valid, valid, np.full(len(picture), first_return_m), *spacing)


def places(n: int = 300) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    return generator(1).integers(0, SHAPE[0], n), generator(2).integers(0, SHAPE[1], n)


def model_of(stumps: list[BoostedStump], edges: NDArray[np.float32]) -> CascadeModel:
    model = model_with((tuple(model_stump(SOME, edges, stump) for stump in stumps),), -MOST)
    check_model(model, "trained here")
    return model


# --- features of extreme tiles ---


@pytest.mark.parametrize("name", PICTURES)
def test_what_is_learned_of_a_picture_is_what_the_model_says_of_it(name: str) -> None:
    plane = plane_of(PICTURES[name][45 : 45 + SHAPE[0], : SHAPE[1]])
    rows, columns = places()
    is_target = (rows > 20) | (columns > 110)
    with np.errstate(all="raise", under="ignore"):
        means = pool_box_means(plane, SOME.boxes, rows, columns)
        edges = bin_edges(SOME, means)
        bins = quantise(SOME, edges, means)
        stumps = list(gentle_stumps(bins, is_target, 8, 3.0, generator(3)))
        if not stumps:
            assert name == "constant"
            return
        model = model_of(stumps, edges)
        assert parse_model(encode_model(model), "written here") == model
        learned = np.sum([stump.scores(bins) for stump in stumps], axis=0)
        # Where there are few values, many are equal to an edge, and rounding puts them on either side of it.
        assert (trace_plane(plane, model, rows, columns)[:, -1] == learned).mean() > 0.9


@pytest.mark.parametrize("first_return_m", [0.0, 0.3, 1.0, 30.0, math.nan])
@pytest.mark.parametrize("spacing", [(0.12, 0.06), (2.0, 2.0), (0.02, 0.02)])
def test_box_means_stay_within_the_codes_at_every_altitude_on_every_grid(
    first_return_m: float, spacing: tuple[float, float]
) -> None:
    plane = plane_of(np.where(generator(4).random(SHAPE) < 0.5, 16.0, 0.0), first_return_m, spacing)
    with np.errstate(all="raise"):
        means = pool_box_means(plane, SOME.boxes, *places(20))
        edges = bin_edges(SOME, means)
    assert means.min() >= 0.0
    assert means.max() <= 16384.0
    assert np.isfinite(edges).all()


# --- boosting ---


def hard_samples() -> dict[str, tuple[Bins, Labels]]:
    random = generator(8)
    values = random.integers(0, 256, (6, 400)).astype(np.uint8)
    alike = np.repeat(np.array([[3], [200]], dtype=np.uint8), 400, axis=1)
    one_apart = np.zeros((2, 400), dtype=np.uint8)
    one_apart[1, 7] = 255
    return {
        "separable": (values, values[2] > 100),
        "one target": (values, np.arange(400) == 5),
        "one other": (values, np.arange(400) != 5),
        "separated by one sample alone": (one_apart, np.arange(400) < 30),
        "labels by chance": (values, random.random(400) < 0.5),
        "equal samples with either label": (alike, np.arange(400) % 2 == 0),
        "one mislabelled": (values, (values[2] > 100) ^ (np.arange(400) == 11)),
        "first and last bin": (np.where(values > 128, 255, 0).astype(np.uint8), values[0] > 128),
    }


@pytest.mark.parametrize("asymmetry", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("case", hard_samples())
def test_boosting_raises_no_flag_and_bounds_its_leaves(asymmetry: float, case: str) -> None:
    bins, is_target = hard_samples()[case]
    with np.errstate(all="raise", under="ignore"):
        stumps = list(gentle_stumps(bins, is_target, 120, asymmetry, generator(9)))
    assert all(abs(leaf) <= 4 * SCORE_UNIT for stump in stumps for leaf in (stump.below, stump.above))
    assert all(0 <= stump.last_below < N_BINS - 1 for stump in stumps)
    assert bool(stumps) == (case != "equal samples with either label")


def test_one_mislabelled_sample_does_not_take_over() -> None:
    bins, is_target = hard_samples()["one mislabelled"]
    stumps = list(gentle_stumps(bins, is_target, 200, 1.0, generator(9)))
    said = np.sum([stump.scores(bins) for stump in stumps], axis=0) > 0
    assert (said == (bins[2] > 100)).mean() > 0.99


def test_the_same_samples_give_the_same_stumps_on_two_threads_at_once() -> None:
    bins, is_target = generator(10).integers(0, 256, (700, 300)).astype(np.uint8), generator(11).random(300) < 0.3

    def trained(seed: int) -> list[BoostedStump]:
        return list(gentle_stumps(bins, is_target, 10, 2.0, generator(seed)))

    alone = [trained(seed) for seed in (1, 2)]
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(trained, (1, 2))) == alone


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), largest=st.sampled_from([1, 2**20, 2**34]))
def test_weights_add_up_to_the_same_bits_in_any_order_and_split_alike(seed: int, largest: int) -> None:
    random = generator(seed)
    bins, is_target = random.integers(0, 256, (3, 60)).astype(np.uint8), random.random(60) < 0.5
    weight, order = random.integers(0, largest + 1, 60).astype(np.float64), random.permutation(60)
    features = np.arange(3)
    parts = [histograms(bins, features, np.flatnonzero(label), weight[label]) for label in (is_target, ~is_target)]
    mixed = [
        histograms(bins[:, order], features, np.flatnonzero(label), weight[order][label])
        for label in (is_target[order], ~is_target[order])
    ]
    for one, other in zip(parts, mixed, strict=True):
        assert one.tobytes() == other.tobytes()
    if weight.any():
        with np.errstate(all="raise"):
            found = gentle_split(*parts)
        assert found is None or np.isfinite(found).all()


# --- thresholds ---


@pytest.mark.parametrize("level", [-MOST, -1, 0, MOST])
@pytest.mark.parametrize("detection", [1e-6, 0.5, 1.0])
def test_thresholds_of_equal_scores_are_that_score(level: int, detection: float) -> None:
    trace = np.full((1000, 3), level, dtype=np.int32)
    bag = np.repeat(np.arange(100), 10)
    with np.errstate(all="raise"):
        assert reject_thresholds(trace, bag, detection) == (level,) * 3


def test_scores_at_both_ends_of_the_numbers_keep_their_order() -> None:
    ends = np.array([-(2**31), 2**31 - 1, 0, 2**31 - 1], dtype=np.int32)
    assert best_windows(ends, np.zeros(4, dtype=np.intp)).tolist() == [1]
    trace = np.stack((ends, ends[::-1]), axis=1)
    assert reject_thresholds(trace, np.arange(4), 1.0) == (-(2**31), -(2**31))


# --- calibration ---


@pytest.mark.parametrize("spread", [1, 1000, MOST - 1])
@pytest.mark.parametrize("share", [0.0, 1e-4, 0.5, 1.0])
def test_any_scores_are_calibrated_to_odds_that_can_be_written_and_read(spread: int, share: float) -> None:
    random = generator(13)
    score = random.integers(-spread, spread + 1, 20_000).astype(np.int32)
    for labels in (
        random.random(score.size) < share,
        score >= np.quantile(score, 1.0 - share),
        score < np.quantile(score, share),
    ):
        with np.errstate(all="raise"):
            found = calibrate(score, labels)
            odds = found.log_odds_of(np.array([-MOST, -spread, 0, spread, MOST]))
        assert (np.diff(odds) >= 0.0).all()
        assert np.abs(odds).max() <= 12.0
        model = msgspec.structs.replace(
            model_of([BoostedStump(0, 0, 1, -1)], np.ones((1, 1), dtype=np.float32)), calibration=found
        )
        assert parse_model(encode_model(model), "written here") == model


@pytest.mark.parametrize("is_target", [True, False])
def test_a_single_detection_is_no_certainty(is_target: bool) -> None:
    with np.errstate(all="raise"):
        found = calibrate(np.array([7], dtype=np.int32), np.array([is_target]))
    assert found.log_odds == pytest.approx((math.copysign(math.log(3.0), is_target - 0.5),) * 2, abs=1e-4)


def test_targets_at_no_range_count_in_no_cell() -> None:
    model = model_of([BoostedStump(0, 0, 1, -1)], np.ones((1, 1), dtype=np.float32))
    passing = np.zeros(1, dtype=np.int32)
    seen = [
        ValidationSighting("mud", ground_range_m, passing)
        for ground_range_m in (math.nan, -1e-9, 200.0, math.inf, 0.0, math.nextafter(200.0, 0.0))
    ]
    with np.errstate(all="raise"):
        cells = expected_pd(model, seen)
    assert [(cell.near_m, cell.n_targets) for cell in cells] == [(0.0, 1), (120.0, 1)]
