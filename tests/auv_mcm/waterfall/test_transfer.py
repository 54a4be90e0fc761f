"""How recorded numbers become intensity."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from auv_mcm.records import Transfer
from auv_mcm.waterfall.transfer import to_intensity


@given(
    samples=hnp.arrays(
        np.float64,
        st.integers(0, 20),
        elements=st.floats(-1e3, 1e9) | st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -0.0]),
    ),
    kind=st.sampled_from(["amplitude", "intensity"]),
)
def test_linear_samples_follow_the_definition(samples: NDArray[np.float64], kind: Any) -> None:
    intensity, valid = to_intensity(samples, Transfer(kind))
    assert intensity.dtype == np.float32
    assert valid.dtype == np.bool_
    for value, found, ok in zip(samples.tolist(), intensity.tolist(), valid.tolist(), strict=True):
        expected_ok = 0.0 <= value < 1e100
        assert ok == expected_ok
        assert found == pytest.approx(value ** (2 if kind == "amplitude" else 1) if expected_ok else 0.0, rel=1e-6)


@given(
    samples=hnp.arrays(
        np.float32,
        st.integers(0, 20),
        elements=st.floats(-1000, 1000, width=32) | st.sampled_from([math.nan, math.inf, -math.inf]),
    ),
    db_per_count=st.floats(0.01, 0.5),
)
def test_differences_of_logarithmic_samples_are_ratios(samples: NDArray[np.float32], db_per_count: float) -> None:
    intensity, valid = to_intensity(samples, Transfer("log", db_per_count))
    np.testing.assert_array_equal(valid, np.isfinite(samples))
    assert (intensity[~valid] == 0.0).all()
    assert np.isfinite(intensity).all()
    bounded = valid & (np.abs(samples * db_per_count) < 150.0)
    decibels = 10.0 * np.log10(intensity[bounded].astype(np.float64))
    expected = samples[bounded].astype(np.float64) * db_per_count
    np.testing.assert_allclose(decibels - decibels[:1], expected - expected[:1], atol=2e-3)


@pytest.mark.parametrize(
    "dtype", [np.uint8, np.int8, np.uint16, np.int16, np.uint32, np.int32, np.float16, np.float32, np.float64]
)
@pytest.mark.parametrize("kind", ["amplitude", "intensity", "log"])
def test_every_stored_type_is_read(dtype: type, kind: Any) -> None:
    samples: NDArray[Any] = np.array([0, 1, 100], dtype=dtype)
    intensity, valid = to_intensity(samples, Transfer(kind, 0.35))
    assert valid.all()
    exponent = {"amplitude": 2.0, "intensity": 1.0, "log": None}[kind]
    if exponent is None:
        assert float(intensity[2] / intensity[0]) == pytest.approx(10.0**3.5, rel=1e-4)
    else:
        np.testing.assert_allclose(intensity, [0.0, 1.0, 100.0**exponent])
    assert to_intensity(samples[:0], Transfer(kind, 0.35))[0].shape == (0,)
    assert samples.tolist() == [0, 1, 100]
