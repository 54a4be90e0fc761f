"""Statistics of regions against loops that follow their definition."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.kernels.ping_windows import STRIDES, ping_windows, ping_windows_numpy
from auv_mcm.waterfall.regions import N_CELLS, measure_regions

N_PART = 20  # of 800 samples


def test_cumulants_are_k_statistics_of_four_pings_at_one_range() -> None:
    samples = np.random.default_rng(2).gamma(2.0, 50.0, (16, 800))
    table = measure_regions([samples]).table
    region, cell = 7, 2
    first = (region + 1) * N_PART + cell * N_PART // N_CELLS
    block = samples[:, first : first + N_PART // N_CELLS]
    assert table.mean[region, cell] == pytest.approx(block.mean())
    for index, stride in enumerate(STRIDES):
        starts = [start for start in range(16) if start % (4 * stride) < stride]
        by_window = [k_statistics(block[[start + k * stride for k in range(4)]]) for start in starts]
        for half in range(2):
            expected = np.mean(by_window[half::2], axis=0)
            assert table.cumulants[index, region, cell, half] == pytest.approx(expected)


def k_statistics(window: NDArray[np.float64]) -> tuple[float, float]:
    """Second and third k-statistic of each column of four, their means over columns."""
    deviation = window - window.mean(axis=0)
    return float((deviation**2).sum(axis=0).mean() / 3.0), float((deviation**3).sum(axis=0).mean() * 4.0 / 6.0)


def test_halves_of_strides_two_and_four_share_no_ping() -> None:
    samples = np.random.default_rng(3).normal(size=(16, 800))
    before = measure_regions([samples]).table.cumulants
    samples[1::2] *= 3.0  # the second half holds every second ping
    after = measure_regions([samples]).table.cumulants
    assert after[1:, :, :, 0] == pytest.approx(before[1:, :, :, 0])
    assert (after[1:, :, :, 1, 0] > before[1:, :, :, 1, 0]).all()


def test_covariance_shows_texture_and_not_speckle() -> None:
    random = np.random.default_rng(4)
    speckle = random.normal(size=(16, 800))
    texture = np.repeat(random.normal(size=(16, 40)), 20, axis=1)
    assert abs(measure_regions([speckle]).table.covariance.mean()) < 0.02
    assert measure_regions([speckle + texture]).table.covariance.mean() > 0.4


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_regions_with_bad_samples_are_left_out_and_no_other(bad: float) -> None:
    samples = np.random.default_rng(5).gamma(1.0, 1.0, (16, 800))
    clean = measure_regions([samples]).table
    samples[3, 10 * N_PART + 4] = bad
    spoilt = measure_regions([samples]).table
    others = clean.place != 9
    assert list(spoilt.place) == list(clean.place[others])
    assert np.array_equal(spoilt.cumulants, clean.cumulants[:, others])
    assert np.array_equal(spoilt.mean, clean.mean[others])


@pytest.mark.parametrize("n_part", [16, 25, 61])
def test_c_and_numpy_agree_to_the_bit(n_part: int) -> None:
    random = np.random.default_rng(6)
    samples = np.round(random.gamma(1.0, 40.0, (16, 9 * n_part))) / 3.0
    samples[5, 2 * n_part + 1] = np.nan
    samples[:, 4 * n_part : 5 * n_part] = 0.0
    for order in ("C", "F"):
        by_c, by_numpy = (
            measure(samples.copy(order), n_part, N_CELLS, (6, 8), 1e19)
            for measure in (ping_windows, ping_windows_numpy)
        )
        for name, found, expected in zip(by_c._fields, by_c, by_numpy, strict=True):
            assert np.array_equal(found, expected, equal_nan=True), name


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int16, np.float32])
def test_percentiles_are_those_of_all_samples_of_any_type(dtype: type) -> None:
    samples: NDArray[Any] = np.random.default_rng(7).gamma(1.0, 30.0, (16, 300)).clip(0, 255).astype(dtype)
    regions = measure_regions([samples])
    assert (regions.percentile_1, regions.percentile_99) == tuple(np.quantile(samples, (0.01, 0.99)))
