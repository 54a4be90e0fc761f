"""The waterfall's kernels: small ones against definitions taken pixel by pixel, and C against numpy to the bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm import kernels
from auv_mcm.kernels import waterfall_boxes as boxes
from auv_mcm.kernels import waterfall_rows as by_row
from auv_mcm.kernels import waterfall_steps as steps
from auv_mcm.kernels import waterfall_sums as along
from auv_mcm.kernels.waterfall_rows import Turning
from auv_mcm.kernels.waterfall_sums import Sampled
from auv_mcm.records import LOW_RESOLUTION, SATURATED, TURN, VALID

needs_c = pytest.mark.skipif(kernels.backend() != "c", reason=f"no C kernels: {kernels.loaded().reason}")

seeds = st.integers(0, 2**32 - 1)
shapes = st.tuples(st.integers(1, 9), st.integers(1, 40))
trace_shapes = st.tuples(st.integers(1, 9), st.integers(0, 40))
halves = st.tuples(st.integers(1, 6), st.integers(1, 50))


def drawn(seed: int, shape: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.uint8]]:
    """Speckle with glints and holes, where it is usable, and masks."""
    random = np.random.Generator(np.random.PCG64(seed))
    intensity = random.exponential(size=shape).astype(np.float32)
    intensity[random.random(shape) < 0.05] *= np.float32(100.0)
    intensity[random.random(shape) < 0.05] = 0.0
    usable = random.random(shape) < random.choice([0.3, 0.9, 1.0])
    mask = (random.integers(0, 16, shape).astype(np.uint8) & ~np.uint8(VALID)) | np.where(
        usable, np.uint8(VALID), np.uint8(0)
    )
    return np.where(usable, intensity, np.float32(0.0)), usable, mask


def same(one: object, other: object) -> None:
    for a, b in zip(as_tuple(one), as_tuple(other), strict=True):
        np.testing.assert_array_equal(a, b, strict=True)


def as_tuple(value: object) -> tuple[object, ...]:
    return value if isinstance(value, tuple) else (value,)


def traces(seed: int, shape: tuple[int, int]) -> Sampled:
    intensity, usable, mask = drawn(seed, shape)
    weight = None if usable.all() else along.sums_to_the_end_numpy(usable)
    clipped = along.sums_to_the_end_numpy((mask & SATURATED)[:, : seed % (shape[1] + 1)] != 0) if seed % 3 else None
    return Sampled(along.sums_to_the_end_numpy(intensity), weight, clipped, 0.31, 0.07)


@needs_c
@given(seed=seeds, shape=trace_shapes, n_edges=st.integers(2, 30), n_edge_rows=st.integers(1, 4))
@settings(deadline=None)
def test_c_sums_and_averages_along_range_as_numpy_does(
    seed: int, shape: tuple[int, int], n_edges: int, n_edge_rows: int
) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    intensity, _, _ = drawn(seed, shape)
    same(along.sums_to_the_end(intensity), along.sums_to_the_end_numpy(intensity))
    edges_m = np.cumsum(random.exponential(0.1, size=(n_edge_rows, n_edges)), axis=1)
    edge_row = np.sort(random.integers(0, n_edge_rows, shape[0]))
    same(*(means(traces(seed, shape), edges_m, edge_row) for means in (along.means, along.means_numpy)))


@given(seed=seeds, shape=trace_shapes, kind=st.sampled_from([np.uint8, np.uint16]))
@settings(deadline=None)
def test_counts_add_up_as_the_intensities_they_stand_for(seed: int, shape: tuple[int, int], kind: type) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    last = np.iinfo(kind).max
    intensity = random.exponential(size=last + 1).astype(np.float32)
    counts = random.integers(0, last, shape, dtype=kind, endpoint=True)
    same(along.sums_of_counts(counts, intensity), along.sums_to_the_end_numpy(intensity[counts]))


@needs_c
@given(
    seed=seeds, shape=st.tuples(st.integers(1, 5), st.integers(0, 300)), n_values=st.sampled_from([1, 2, 3, 40, 10**6])
)
@settings(deadline=None)
def test_c_finds_the_medians_that_numpy_finds(seed: int, shape: tuple[int, int], n_values: int) -> None:
    """Of values that repeat, as those of coarse samples do, and of values over many decades."""
    random = np.random.Generator(np.random.PCG64(seed))
    values = (random.integers(0, n_values, shape) - n_values // 2) * random.choice([1.0, 1e-3])
    values = np.where(
        random.random(shape) < random.choice([0.0, 0.3]), np.exp(random.normal(scale=9.0, size=shape)), values
    )
    usable = random.random(shape) < random.choice([0.1, 0.7, 1.0])
    for chosen in (usable, None):
        for minimum in (1, 24):
            same(*(medians(values, chosen, minimum) for medians in (by_row.row_medians, by_row.row_medians_numpy)))


@needs_c
@given(seed=seeds, shape=shapes, n_factors=st.integers(1, 4))
@settings(deadline=None)
def test_c_scales_rows_as_numpy_does(seed: int, shape: tuple[int, int], n_factors: int) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    values, factor = random.exponential(size=shape), random.exponential(size=(n_factors, shape[1]))
    factor_row = random.integers(0, n_factors, shape[0])
    same(*(scale(values, factor, factor_row) for scale in (by_row.scale_rows, by_row.scale_rows_numpy)))


@needs_c
@given(
    seed=seeds,
    shape=st.tuples(st.integers(1, 5), st.integers(1, 60)),
    blank=st.integers(1, 20),
    window=st.integers(2, 12),
)
@settings(deadline=None)
def test_c_finds_the_steps_that_numpy_finds(seed: int, shape: tuple[int, int], blank: int, window: int) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    values = random.normal(size=shape) + 3.0 * (np.arange(shape[1]) > random.integers(0, shape[1]))
    valid = random.random(shape) < 0.9
    same(
        steps.step_ratios(values, valid, blank, window, 0.7, 3.3),
        steps.step_ratios_numpy(values, valid, blank, window, 0.7, 3.3),
    )


@needs_c
@given(seed=seeds, shape=shapes, share=st.sampled_from([1.0, 0.37]))
@settings(deadline=None)
def test_c_adds_the_votes_that_numpy_adds(seed: int, shape: tuple[int, int], share: float) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    ratios = np.maximum(random.normal(0.0, 9.0, shape), 0.0) * random.choice([0.0, 1.0], (shape[0], 1))
    scores = np.ones((2, *shape))
    for score, add in zip(scores, (steps.add_votes, steps.add_votes_numpy), strict=True):
        add(score, ratios, share, 10.0, 6.0)
    same(*scores)


@needs_c
@given(seed=seeds, shape=shapes, bin_m=st.sampled_from([0.05, 0.3]), pull=st.sampled_from([1.0, 0.3]))
@settings(deadline=None)
def test_c_pulls_to_readings_as_numpy_does(seed: int, shape: tuple[int, int], bin_m: float, pull: float) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    altitude_m = random.choice([np.nan, np.inf, -1.0, 0.0, 0.3, 1.0, 2.7], shape[0])
    scores = np.repeat(random.normal(size=(1, *shape)), 2, axis=0)
    for score, lower in zip(scores, (steps.pull_to_reading, steps.pull_to_reading_numpy), strict=True):
        lower(score, altitude_m, bin_m, 1.6, 8.0, pull)
    np.testing.assert_allclose(scores[0], scores[1], rtol=0.0, atol=1e-12)


@needs_c
@given(seed=seeds, shape=shapes, n_rows=st.integers(0, 8), n_steps=st.integers(1, 4))
@settings(deadline=None)
def test_c_averages_pings_to_rows_as_numpy_does(seed: int, shape: tuple[int, int], n_rows: int, n_steps: int) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    intensity, _, mask = drawn(seed, shape)
    source = random.integers(0, shape[0], (n_rows, n_steps))
    overlap = np.maximum(random.normal(0.02, 0.05, (n_rows, n_steps)), 0.0)
    same(
        *(
            average(intensity, mask, source, overlap, 0.06)
            for average in (by_row.average_rows, by_row.average_rows_numpy)
        )
    )


@needs_c
@given(seed=seeds, shape=shapes, half=halves)
@settings(deadline=None)
def test_c_levels_as_numpy_does(seed: int, shape: tuple[int, int], half: tuple[int, int]) -> None:
    intensity, usable, mask = drawn(seed, shape)
    same(*(pick(intensity, mask, 0.05, 20.0) for pick in (boxes.usable_pixels, boxes.usable_pixels_numpy)))
    logarithms = np.log(np.clip(intensity, np.float32(0.05), np.float32(20.0))) * usable
    reached = float(logarithms.max()) + 1e-3  # just, in float64
    for rule in ((2.4, 3.0, 1e-3), (1e3, reached, 1e-3)):
        same(*(spots(logarithms, usable, half, *rule) for spots in (boxes.bright_spots, boxes.bright_spots_numpy)))
    same(*(level(intensity, usable, half, 0.25) for level in (boxes.box_level, boxes.box_level_numpy)))
    columns = np.arange(0, shape[1], 3)
    both = boxes.divide_by_level, boxes.divide_by_level_numpy
    same(*(divide(intensity, mask, intensity, usable, half, 0.25, columns) for divide in both))


@needs_c
@given(seed=seeds, shape=shapes, spread=st.sampled_from([0.0, 1.0, 20.0]))
@settings(deadline=None)
def test_c_raises_to_a_floor_as_numpy_does(seed: int, shape: tuple[int, int], spread: float) -> None:
    intensity, usable, _ = drawn(seed, shape)
    random = np.random.Generator(np.random.PCG64(seed))
    values = intensity.astype(np.float64) * np.exp(random.normal(0.0, spread, shape))
    both = values.copy(), values.copy()
    for raised, raise_to in zip(both, (by_row.raise_to_floor, by_row.raise_to_floor_numpy), strict=True):
        raise_to(raised, usable, 1e-6, 1e-300)
    same(*both)
    floor = 1e-6 * np.median(values, axis=1, keepdims=True) + 1e-300
    np.testing.assert_array_equal(both[0], np.where(usable, np.maximum(values, floor), 1.0))


@needs_c
@given(seed=seeds, shape=shapes)
@settings(deadline=None)
def test_c_masks_as_numpy_does(seed: int, shape: tuple[int, int]) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    _, usable, mask = drawn(seed, shape)
    pitch, yaw = random.normal(0.0, 0.3, shape[0]), random.normal(0.0, random.choice([0.005, 0.05]), shape[0])
    turning = Turning(pitch, yaw, random.random(shape[0]) < 0.1)
    ground_m = np.arange(0.45, 0.9 * shape[1], 0.9)[: shape[1]].astype(np.float64)
    coarse = np.where(random.random((3, shape[1])) < 0.3, np.uint8(LOW_RESOLUTION), np.uint8(0))
    arguments = usable, (mask & SATURATED) != 0, turning, ground_m, coarse, random.integers(0, 3, shape[0]), 2.0
    same(by_row.ping_masks(*arguments), by_row.ping_masks_numpy(*arguments))
    # Every pixel by itself: the kernels look at all of them only where the ends of a row say so.
    ratio = 1.0 + pitch[:, np.newaxis] + yaw[:, np.newaxis] * ground_m
    bent = (ratio > 2.0) | (ratio * 2.0 < 1.0) | turning.fast[:, np.newaxis]
    np.testing.assert_array_equal((by_row.ping_masks(*arguments) & TURN) != 0, bent)


@needs_c
@given(seed=seeds, shape=shapes, known=st.sets(st.integers(0, 29), min_size=1))
@settings(deadline=None)
def test_c_follows_the_angle_curve_that_numpy_follows(seed: int, shape: tuple[int, int], known: set[int]) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    angle = random.uniform(0.0, 30.0, (3, shape[1]))
    angle[random.random(angle.shape) < 0.3] = np.nextafter(random.integers(0, 30) + 0.5, random.choice([0.0, 40.0]))
    angle[random.random(angle.shape) < 0.1] = 30.0
    angle_row = random.integers(0, 3, shape[0])
    values, usable, centre = random.normal(size=shape), random.random(shape) < 0.8, random.normal(size=30)
    for about in (None, centre):
        same(
            *(
                sums(angle, angle_row, values, usable, 30, about, 1.0)
                for sums in (by_row.angle_sums, by_row.angle_sums_numpy)
            )
        )
    bins = np.array(sorted(known), dtype=np.intp)
    same(*(curve(angle, bins, centre[bins]) for curve in (by_row.along_curve, by_row.along_curve_numpy)))


@needs_c
@given(
    seed=seeds,
    shape=st.tuples(st.integers(1, 30), st.integers(1, 12)),
    half=st.tuples(st.integers(1, 6), st.integers(1, 12)),
)
@settings(deadline=None)
def test_rows_that_share_their_usable_pixels_are_counted_right(
    seed: int, shape: tuple[int, int], half: tuple[int, int]
) -> None:
    """Counts are kept where the row that enters a box has the usable pixels of the one that leaves it."""
    random = np.random.Generator(np.random.PCG64(seed))
    intensity, usable, mask = drawn(seed, shape)
    usable = usable[random.integers(0, min(2, shape[0]), shape[0])]
    level = np.where(usable, intensity, np.float32(0.0))
    columns = np.array([shape[1] - 1])
    both = boxes.divide_by_level, boxes.divide_by_level_numpy
    same(*(divide(intensity, mask, level, usable, half, 0.25, columns) for divide in both))


@given(
    seed=seeds,
    shape=st.tuples(st.integers(1, 6), st.integers(1, 8)),
    half=st.tuples(st.integers(1, 3), st.integers(1, 4)),
)
@settings(deadline=None)
def test_a_level_is_the_mean_of_the_usable_pixels_around(
    seed: int, shape: tuple[int, int], half: tuple[int, int]
) -> None:
    intensity, usable, _ = drawn(seed, shape)
    mean, known = boxes.box_level(intensity, usable, half, 0.25)
    logarithms = np.log(np.clip(intensity, np.float32(0.05), np.float32(20.0))) * usable
    places, limits = boxes.bright_spots(logarithms, usable, half, 0.5, 3.0, 0.0)
    reported = dict(zip(places.tolist(), limits.tolist(), strict=True))
    for row in range(shape[0]):
        for column in range(shape[1]):
            box = (
                slice(max(row - half[0], 0), row + half[0] + 1),
                slice(max(column - half[1], 0), column + half[1] + 1),
            )
            around = intensity[box][usable[box]].astype(np.float64)
            expected = around.mean() if around.size else 0.0
            assert mean[row, column] == pytest.approx(expected, abs=1e-9)
            if expected > 1e-6 or expected == 0.0:
                assert known[row, column] == (around.size >= max(0.25 * usable[box].size, 1.0) and expected > 0.0)
            if usable[row, column]:
                limit = logarithms[box][usable[box]].astype(np.float64).mean() + 0.5
                if abs(logarithms[row, column] - min(limit, 3.0)) > 1e-6:
                    assert (row * shape[1] + column in reported) == (logarithms[row, column] >= min(limit, 3.0))
                assert reported.get(row * shape[1] + column, limit) == pytest.approx(limit)


def test_a_row_takes_what_its_pings_say() -> None:
    intensity = np.array([[1.0, 2.0, 4.0], [3.0, 6.0, 8.0]], dtype=np.float32)
    mask = np.array([[VALID, VALID | TURN, 0], [VALID | SATURATED, 0, LOW_RESOLUTION | SATURATED]], dtype=np.uint8)
    source, overlap = np.array([[0, 1], [1, 0]]), np.array([[0.09, 0.03], [0.12, 0.0]])
    rows, flags = by_row.average_rows(intensity * ((mask & VALID) != 0), mask, source, overlap, 0.06)
    np.testing.assert_allclose(rows, [[1.5, 2.0, 0.0], [3.0, 0.0, 0.0]], rtol=1e-6)
    np.testing.assert_array_equal(
        flags, [[VALID | SATURATED, VALID | TURN, LOW_RESOLUTION], [VALID | SATURATED, 0, LOW_RESOLUTION]]
    )
