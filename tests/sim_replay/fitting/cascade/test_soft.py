from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_replay.fitting.cascade.soft import best_windows, group_sizes, reject_thresholds


@st.composite
def traces(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, float]:
    rng = np.random.Generator(np.random.PCG64(draw(st.integers(0, 2**32 - 1))))
    n_windows, n_groups = draw(st.integers(1, 60)), draw(st.integers(1, 6))
    steps = rng.integers(-draw(st.sampled_from([1, 500])), 500, (n_windows, n_groups))
    bag = rng.integers(0, draw(st.integers(1, 20)), n_windows)
    return (
        np.cumsum(steps, axis=1).astype(np.int32),
        bag.astype(np.intp),
        draw(st.sampled_from([0.01, 0.5, 0.9, 0.98, 1.0])),
    )


@settings(deadline=None)
@given(traces())
def test_no_target_to_keep_is_lost_and_none_loses_its_best_score(case: tuple[np.ndarray, np.ndarray, float]) -> None:
    trace, bag, detection = case
    reject = np.array(reject_thresholds(trace, bag, detection), dtype=np.int32)
    passes = np.all(trace >= reject, axis=1)
    kept = 0
    for target in set(bag.tolist()):
        windows = bag == target
        if passes[windows].any():
            kept += 1
            assert trace[windows & passes, -1].max() == trace[windows, -1].max()
    assert kept >= math.ceil(detection * len(set(bag.tolist())) - 1e-9)


@settings(deadline=None)
@given(traces())
def test_thresholds_could_not_be_higher(case: tuple[np.ndarray, np.ndarray, float]) -> None:
    trace, bag, detection = case
    reject = reject_thresholds(trace, bag, detection)
    best = trace[best_windows(trace[:, -1], bag)]
    assert np.array_equal(best[(best >= np.array(reject)).all(axis=1)].min(axis=0), reject)


def test_of_equal_windows_the_first_is_best() -> None:
    assert best_windows(np.array([3, 7, 7, 1, 1], dtype=np.int32), np.array([1, 1, 1, 0, 0])).tolist() == [3, 1]


def test_nothing_to_prune_on_is_refused() -> None:
    with pytest.raises(ValueError, match="0 windows"):
        reject_thresholds(np.empty((0, 3), dtype=np.int32), np.empty(0, dtype=np.intp), 0.9)


@pytest.mark.parametrize("n_stumps", [1, 2, 3, 9, 24, 25, 200])
def test_groups_hold_all_stumps(n_stumps: int) -> None:
    assert sum(group_sizes(n_stumps)) == n_stumps
    assert group_sizes(300)[:8] == (1, 1, 2, 4, 8, 8, 16, 16)
