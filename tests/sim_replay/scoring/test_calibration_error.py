"""Probabilities against how often what they promise comes true."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_replay.scoring.calibration import calibration_error


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.booleans()), min_size=1, max_size=30), st.integers(1, 12))
def test_the_error_is_the_gap_of_every_bin_weighted_by_its_count(
    outcomes: list[tuple[float, bool]], n_bins: int
) -> None:
    expected = 0.0
    for number in range(n_bins):
        inside = [(p, true) for p, true in outcomes if min(int(p * n_bins), n_bins - 1) == number]
        expected += abs(sum(p - true for p, true in inside)) / len(outcomes)
    probabilities, came_true = zip(*outcomes, strict=True)
    assert calibration_error(probabilities, came_true, n_bins) == pytest.approx(expected, abs=1e-12)


def test_promises_that_are_kept_have_hardly_an_error() -> None:
    random = np.random.Generator(np.random.PCG64(5))
    p = random.beta(0.8, 0.8, 20000)
    true = random.random(p.size) < p
    assert calibration_error(p, true) < 0.012
    assert calibration_error(p**3, true) > 0.1


def test_what_has_no_error_is_refused() -> None:
    for p, true, reason in (
        ([], [], "one or more"),
        ([0.5], [True, False], "as many"),
        ([0.5, math.nan], [True, False], "lie in"),
        ([0.5, 1.5], [True, False], "lie in"),
    ):
        with pytest.raises(ValueError, match=reason):
            calibration_error(p, true)
