"""Samples are scaled only where their powers would not fit, and negative ones are reported once."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace
from auv_mcm.waterfall.sample_checks import SampleCheck

SAMPLES = np.random.default_rng(4).rayleigh(1.0, 500)


def trace(samples: NDArray[np.generic]) -> EchoTrace:
    return EchoTrace(samples=samples, first_range_m=0.05, spacing_m=0.1)


def check(full_scale: float | None = None) -> SampleCheck:
    return SampleCheck("port", full_scale, Counter())


@pytest.mark.parametrize("gain", [1e-6, 1.0, 1e6])
def test_samples_whose_powers_fit_stay_as_they_are(gain: float) -> None:
    given = trace((SAMPLES * gain).astype(np.float32))
    assert check().scaled(given) is given


@pytest.mark.parametrize("gain", [1e-300, 1e-30, 1e25, 1e300])
def test_samples_are_scaled_by_one_power_of_two_for_the_whole_side(gain: float) -> None:
    side = check()
    first, second = (side.scaled(trace(SAMPLES * gain * level)).samples for level in (1.0, 3.0))
    assert 0.1 < np.median(first) < 2.0
    np.testing.assert_allclose(second / first, 3.0)


def test_integers_and_samples_with_a_configured_full_scale_are_not_scaled() -> None:
    integers, floats = trace(np.array([1, 2, 3], dtype=np.uint16)), trace(SAMPLES * 1e-30)
    assert check().scaled(integers) is integers
    assert check(full_scale=1e-28).scaled(floats) is floats


def test_nothing_and_nonsense_do_not_change_the_scale() -> None:
    side = check()
    for samples in (np.zeros(9), np.full(9, np.nan), np.full(9, np.inf)):
        given = trace(samples)
        assert side.scaled(given) is given


def test_negative_samples_are_reported_once_they_go_on() -> None:
    side = check()
    notices = [
        notice for n in range(60) for notice in side.check(trace(-1.0 - SAMPLES if n != 10 else SAMPLES), f"ping {n}")
    ]
    (notice,) = notices
    assert notice.code == "quality.samples_negative"
    assert notice.place == "ping 30"


@pytest.mark.parametrize(
    "samples", [np.zeros(9), np.full(9, np.nan), np.array([-3, 1], dtype=np.int16), np.array([], dtype=np.float32)]
)
def test_samples_of_which_some_are_positive_or_none_known_raise_nothing(samples: NDArray[np.generic]) -> None:
    side = check()
    assert [notice for _ in range(60) for notice in side.check(trace(samples), "")] == []
