"""A threshold lets through what it may and no more, and a resampled interval holds what it is of."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_replay.scoring.thresholds import called_at, resampled, threshold_at

scores = st.lists(st.floats(-5.0, 5.0).map(lambda x: round(x, 1)), max_size=30)


@given(false_alarms=scores, n_allowed=st.floats(0.0, 40.0))
def test_no_more_false_alarms_lie_above_than_allowed_and_no_lower_threshold_does_as_well(
    false_alarms: list[float], n_allowed: float
) -> None:
    above = threshold_at(false_alarms, n_allowed)
    assert sum(one > above for one in false_alarms) <= n_allowed
    lower = [one for one in {*false_alarms, -math.inf} if one < above]
    assert all(sum(one > low for one in false_alarms) > n_allowed for low in lower)


@given(false_alarms=scores, n_allowed=st.floats(0.01, 40.0), n_tries=st.floats(1.0, 1e6))
def test_chance_takes_its_part_of_what_is_allowed(false_alarms: list[float], n_allowed: float, n_tries: float) -> None:
    above = threshold_at(false_alarms, n_allowed, n_tries=n_tries, nothing=-99.0)
    expected = sum(one > above for one in false_alarms) + n_tries * math.exp(-above)
    assert expected <= n_allowed * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("targets", "others", "share", "found"),
    [
        ([0.9, 0.8, 0.7, 0.2], [0.95, 0.5, 0.1], 0.75, (1, 3)),
        ([0.9, 0.8, 0.7, 0.2], [0.95, 0.5, 0.1], 1.0, (2, 3)),
        ([0.9, -math.inf], [0.95], 0.5, (1, 1)),
        ([0.9, -math.inf], [0.95], 1.0, None),
        ([], [0.95], 0.9, None),
    ],
)
def test_others_are_counted_where_the_share_of_targets_is_called(
    targets: list[float], others: list[float], share: float, found: tuple[int, int] | None
) -> None:
    called = called_at(targets, others, share)
    assert (None if called is None else (called.count, called.of)) == found


def test_a_resampled_mean_has_the_interval_of_its_standard_error() -> None:
    values = np.random.Generator(np.random.PCG64(4)).normal(2.0, 1.0, 100)
    found = resampled(lambda chosen: float(values[list(chosen)].mean()), len(values), seed=1)
    assert found.value == pytest.approx(values.mean())
    half = 1.96 * values.std() / math.sqrt(len(values))
    assert found.high - found.value == pytest.approx(half, rel=0.1)
    assert found.value - found.low == pytest.approx(half, rel=0.1)
    assert resampled(lambda chosen: float(values[list(chosen)].mean()), len(values), seed=1) == found
