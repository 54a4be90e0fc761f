"""Peaks are the highest scores around in the core of a tile."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.detect.contrasts import contrasts
from auv_mcm.records import LOW_RESOLUTION, VALID
from tests.auv_mcm.detect.scene_tiles import COLUMN_M, ROW_M, make_tile, speckle
from tests.auv_mcm.detect.test_contrasts import threshold_of
from tests.auv_mcm.detect.test_prescreen import pixels


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    p_false_alarm=st.sampled_from((0.3, 1e-2, 5e-4)),
    radius_m=st.sampled_from((0.1, 0.4, 1.0)),
)
def test_peaks_are_the_highest_scores_around_in_the_core(seed: int, p_false_alarm: float, radius_m: float) -> None:
    random = np.random.default_rng(seed)
    shape = (int(random.integers(1, 30)), int(random.integers(1, 40)))
    start = int(random.integers(0, shape[0]))
    core = (start, int(random.integers(start + 1, shape[0] + 1)))
    mask = np.where(random.random(shape) < 0.1, VALID | LOW_RESOLUTION, VALID).astype(np.uint8)
    tile = make_tile(speckle(seed, shape), mask, core=core)
    score = (random.integers(-4, 12, shape) * 0.5).astype(np.float32)  # coarse steps, so that ties occur
    score[random.random(shape) < 0.1] = -np.inf
    half_rows, half_columns = pixels(radius_m, ROW_M), pixels(radius_m, COLUMN_M)
    expected = []
    able = np.where(mask == VALID, score, -np.inf)  # what is near nadir holds no peak and hides none
    for i, j in np.ndindex(shape):
        around = able[max(i - half_rows, 0) : i + half_rows + 1, max(j - half_columns, 0) : j + half_columns + 1]
        allowed = core[0] <= i < core[1] and mask[i, j] == VALID
        if allowed and score[i, j] >= threshold_of(p_false_alarm) and score[i, j] == around.max():
            expected.append((-float(score[i, j]), i, j))
    high = np.where(score >= threshold_of(p_false_alarm), score, np.float32(-np.inf))
    found = contrasts(tile, p_false_alarm)._replace(score=high).peaks(radius_m)
    assert [(-p.score, p.row, p.column) for p in found] == sorted(expected)


def test_lower_thresholds_only_add_peaks() -> None:
    tile = make_tile(speckle(9, (100, 150)))
    counts = [set(contrasts(tile, p).peaks(0.4)) for p in (1e-6, 5e-4, 1e-2, 0.3)]
    assert all(fewer <= more for fewer, more in pairwise(counts))
    assert counts[3]
