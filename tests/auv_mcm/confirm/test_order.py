"""Medians and quantiles are numpy's to the last bit."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.kernels.order import median, quantile

numbers = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40)


@given(numbers)
def test_median_is_that_of_numpy(values: list[float]) -> None:
    assert median(np.array(values)) == np.median(values)


@given(
    numbers | st.lists(st.integers(0, 90), min_size=1, max_size=40), st.sampled_from([0.0, 0.05, 0.5, 0.77, 0.95, 1.0])
)
def test_quantile_is_that_of_numpy(values: list[float], share: float) -> None:
    assert quantile(np.array(sorted(values)), share) == np.quantile(values, share)
