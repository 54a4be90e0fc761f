"""Scores where they matter against the scores of all pixels: the same bits, whatever the tile, the threshold and where
it was cut."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.detect.contrasts import MIN_THRESHOLD, contrasts
from auv_mcm.kernels import contrast as kernel
from auv_mcm.records import LOW_RESOLUTION, SATURATED, VALID, Tile
from tests.auv_mcm.detect.all_scores import all_scores
from tests.auv_mcm.detect.scene_tiles import Plane, make_tile, speckle

FACES = (
    "image_sums",
    "background",
    "ratios",
    "local_variances",
    "extremes",
    "bright_places",
    "dark_places",
    "raise_before",
    "box_means",
    "peaks",
)


def threshold_of(p_false_alarm: float) -> np.float32:
    return np.float32(-NormalDist().inv_cdf(p_false_alarm))


def drawn_tile(seed: int, shape: tuple[int, int], row_m: float = 0.12, column_m: float = 0.06) -> Tile:
    """Speckle of some kind with objects, holes, silent stretches, a masked border and a core."""
    random = np.random.default_rng(seed)
    intensity = speckle(seed, shape, spread_pixels=0.7 * (seed % 3), texture_nu=2.0 * (seed % 2))
    mask = np.full(shape, VALID, dtype=np.uint8)
    for _ in range(int(random.integers(0, 8))):
        i, j, tall, wide = (int(random.integers(0, n)) for n in (*shape, 8, 30))
        intensity[i : i + tall, j : j + 5] *= np.float32(10.0 ** random.uniform(0.0, 3.0))
        intensity[i : i + tall, j + 5 : j + 5 + wide] *= np.float32(random.choice((0.0, 0.02, 0.3)))
    for _ in range(int(random.integers(0, 4))):
        i, j, tall, wide = (int(random.integers(0, n)) for n in (*shape, 12, 40))
        mask[i : i + tall, j : j + wide] = random.choice((0, VALID | LOW_RESOLUTION, VALID | SATURATED))
    if seed % 4 == 0:
        intensity[: shape[0] // 3] = 0.0
    if seed % 5 == 0:
        mask[:, shape[1] * 3 // 4 :] = 0
    start = int(random.integers(0, shape[0]))
    core = (start, int(random.integers(start + 1, shape[0] + 1)))
    first_return_m = float(random.choice((0.3, 4.0, 9.0, 40.0)))
    return make_tile(intensity, mask, core=core, row_m=row_m, column_m=column_m, first_return_m=first_return_m)


def assert_same(tile: Tile, p_false_alarm: float) -> None:
    score, found, exhaustive = (
        all_scores(tile).score, contrasts(tile, p_false_alarm), contrasts(tile, p_false_alarm, bounded=False)
    )  # fmt: skip
    high = np.where(score >= threshold_of(p_false_alarm), score, np.float32(-np.inf))
    np.testing.assert_array_equal(found.score, high, strict=True)
    np.testing.assert_array_equal(exhaustive.score, high, strict=True)
    random = np.random.default_rng(tile.mask.size)
    rows, columns = (random.integers(0, n, 12).tolist() for n in tile.mask.shape)
    half_rows, half_columns = (int(n) for n in random.integers(0, 9, 2))
    asked = rows, columns, half_rows, half_columns
    for peak, row, column in zip(found.clearest(*asked), rows, columns, strict=True):
        assert peak == clearest(score, row, column, half_rows, half_columns)


def clearest(score: Plane, row: int, column: int, half_rows: int, half_columns: int) -> tuple[float, int, int]:
    best = (-np.inf, max(row - half_rows, 0), max(column - half_columns, 0))
    for i in range(best[1], min(row + half_rows + 1, score.shape[0])):
        for j in range(max(column - half_columns, 0), min(column + half_columns + 1, score.shape[1])):
            if score[i, j] > best[0]:
                best = (float(score[i, j]), i, j)
    return best


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 100_000),
    shape=st.tuples(st.integers(1, 70), st.integers(1, 260)),
    spacing_m=st.sampled_from(((0.12, 0.06), (0.06, 0.03), (0.3, 0.25), (2.0, 2.0))),
    p_false_alarm=st.sampled_from((0.3, 5e-3, 1e-3, 1e-4, 1e-9)),
)
def test_scores_over_the_threshold_and_clearest_pixels_are_those_of_all_pixels_to_the_bit(
    seed: int, shape: tuple[int, int], spacing_m: tuple[float, float], p_false_alarm: float
) -> None:
    assert_same(drawn_tile(seed, shape, *spacing_m), p_false_alarm)


@pytest.mark.parametrize("seed", range(4))
def test_large_tiles_score_as_by_all_pixels(seed: int) -> None:
    assert_same(drawn_tile(seed, (150, 700)), 1e-4)


def test_threads_change_nothing() -> None:
    tiles = [drawn_tile(seed, (60, 300)) for seed in range(6)]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(lambda tile: contrasts(tile, 1e-3).peaks(0.4), tiles))
    assert together == [contrasts(tile, 1e-3).peaks(0.4) for tile in tiles]


def test_low_thresholds_weigh_all_pixels() -> None:
    assert threshold_of(0.3) < MIN_THRESHOLD < threshold_of(1e-3)


# ---------------------------------------------------------------- kernels


def assert_alike(name: str, *arguments: object) -> None:
    """C, where there is a compiler, and numpy give the same bits."""
    for ours, theirs in zip(
        as_tuple(getattr(kernel, name)(*arguments)), as_tuple(getattr(kernel, f"{name}_numpy")(*arguments)), strict=True
    ):
        np.testing.assert_array_equal(ours, theirs, strict=True)


def as_tuple(value: NDArray[np.float32] | tuple[NDArray[np.float32], ...]) -> tuple[NDArray[np.float32], ...]:
    return value if isinstance(value, tuple) else (value,)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 100_000), shape=st.tuples(st.integers(1, 40), st.integers(1, 90)))
def test_every_kernel_gives_the_bits_of_its_twin_in_numpy(seed: int, shape: tuple[int, int]) -> None:
    tile, random = drawn_tile(seed, shape), np.random.default_rng(seed)
    assert_alike("image_sums", tile.intensity, tile.mask, 100.0)
    sums = kernel.image_sums(tile.intensity, tile.mask, 100.0)
    low, high = -random.integers(0, 30, (8, 2)), random.integers(1, 30, (8, 2))
    boxes = np.stack((low[:, 0], high[:, 0], low[:, 1], high[:, 1]), axis=1).astype(np.int32)
    frame = kernel.Frame(boxes[0], boxes[1] // 2, 20.0)
    pixels = tile.intensity, tile.mask, frame, 6.0, np.float32(1e-6)
    assert_alike("background", *pixels)
    level, known = kernel.background(*pixels)
    assert_alike("ratios", sums, level, boxes[:3], 1e-3)
    planes = np.log(kernel.ratios(sums, level, boxes[:3], 1e-3))
    half = (int(random.integers(0, 50)), int(random.integers(0, 100)))
    start = int(random.integers(0, shape[0]))
    rows = (start, int(random.integers(start + 1, shape[0] + 1)))
    assert_alike("local_variances", planes, known, rows, half, 1.2, 1e-3)
    blocks = kernel.Blocks(*(int(n) for n in random.integers(1, 40, 2)))
    assert_alike("extremes", planes[0], blocks)
    limits = random.uniform(0.3, 2.0, (3, *blocks.shape(shape)))
    boxes[3, :2] = boxes[2, :2]
    assert_alike("bright_places", sums, level, known, rows, boxes[2:5], limits, blocks)
    half_rows, clearance_m = random.integers(0, 2, 3), random.uniform(0.05, 20.0, (3, shape[0]))
    shadows = kernel.Shadows(half_rows, np.array([0.1, 0.35, 0.7]), clearance_m, 0.06, (0.18, 6.0), 0.6)
    assert_alike("dark_places", sums, level, rows, shadows, limits, blocks)
    places = random.integers(0, tile.mask.size, 50).astype(np.int32)
    assert_alike("box_means", sums, places, boxes[random.integers(0, 8, 50)])
    raised = [np.zeros(shape, dtype=np.float32) for _ in range(2)]
    starts = (rows[0] * shape[1] + random.integers(0, (rows[1] - rows[0]) * shape[1], 30)).astype(np.int32)
    deviates = random.normal(-2.0, 2.0, 30).astype(np.float32)
    for name, plane in zip(("raise_before", "raise_before_numpy"), raised, strict=True):
        getattr(kernel, name)(plane, rows, starts, deviates, 5)
    np.testing.assert_array_equal(raised[0], raised[1], strict=True)
    scores = np.where(random.random(shape) < 0.3, random.integers(0, 5, shape), -np.inf).astype(np.float32)
    assert_alike("peaks", scores, rows, *(int(n) for n in random.integers(0, 9, 2)))


def test_integral_images_do_not_take_part_in_what_numpy_replaces() -> None:
    """Every face of the kernels has a twin."""
    assert all(callable(getattr(kernel, f"{name}_numpy")) for name in FACES)
