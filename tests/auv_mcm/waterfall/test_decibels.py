"""Decibels per count where texture, lasting speckle or the end of the scale get in the way of speckle."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from auv_mcm.waterfall.law import LawOdds
from auv_mcm.waterfall.law_watch import weigh_pings
from auv_mcm.waterfall.log_gamma import LOOKS, log_std_and_skewness
from auv_mcm.waterfall.quiet import quiet_shapes
from auv_mcm.waterfall.regions import measure_regions
from auv_mcm.waterfall.speckle import Speckle, summarise
from auv_mcm.waterfall.texture import speckle_variance
from tests.auv_mcm.waterfall.law_pings import pings

N_PINGS: Final = 256
N_SAMPLES: Final = 1000
BOTTOM: Final = 120
DB_PER_COUNT: Final = 0.25


def speckle_of(samples: NDArray[Any]) -> Speckle:
    return summarise([measure_regions([samples[first : first + 16]]) for first in range(0, len(samples), 16)])


def estimate(samples: NDArray[Any]) -> LawOdds:
    return weigh_pings(pings(samples))


def texture_db(seed: int, std_db: float, reach_pings: float = 12.0, reach_samples: float = 3.0) -> NDArray[np.float64]:
    """Texture (n_pings, n_samples) whose covariance falls off exponentially along the track and in range."""
    field = np.random.default_rng(seed).normal(size=(N_PINGS + 200, N_SAMPLES + 200))
    for axis, reach in ((0, reach_pings), (1, reach_samples)):
        kept = np.exp(-1.0 / reach)
        field = lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], field, axis=axis)
    return np.asarray(std_db * field[200:, 200:])


def mean_db(floor_db: float, water_db: float) -> NDArray[np.float64]:
    return np.where(np.arange(N_SAMPLES) < BOTTOM, water_db, floor_db)


def gamma_db(looks: int, seed: int) -> NDArray[np.float64]:
    return 10.0 * np.log10(np.random.default_rng(seed).gamma(looks, 1.0 / looks, (N_PINGS, N_SAMPLES)))


def ripples_db() -> NDArray[np.float64]:
    """Ripples (n_pings, n_samples) over the whole sea floor, oblique to the track."""
    phase = 0.9 * np.arange(N_PINGS)[:, None] + 0.4 * np.arange(N_SAMPLES)
    return np.where(np.arange(N_SAMPLES) < BOTTOM, 0.0, 5.0 * np.sin(phase))


def counts(decibels: NDArray[np.float64]) -> NDArray[np.uint8]:
    """8-bit counts of decibels above the lowest count."""
    return np.rint(np.clip(decibels / DB_PER_COUNT, 0.0, 255.0)).astype(np.uint8)


@pytest.mark.parametrize("looks", [1, 4, 8])
def test_texture_that_leaves_no_region_even_does_not_pass_for_speckle(looks: int) -> None:
    """The water column is at zero counts.

    Taken for speckle, texture makes decibels 27 % too few at 4 looks, and 33 % too many at 8.
    """
    floor = gamma_db(looks, seed=1) + texture_db(seed=2, std_db=3.0, reach_pings=20.0) + mean_db(40.0, -40.0)
    found = estimate(counts(floor))
    assert found.db_per_count == pytest.approx(DB_PER_COUNT, rel=0.15)
    assert found.db_interval[0] < DB_PER_COUNT < found.db_interval[1]


@pytest.mark.parametrize("looks", [1, 2, 4, 8])
def test_the_water_column_shows_decibels_where_ripples_fill_the_floor(looks: int) -> None:
    found = estimate(counts(gamma_db(looks, seed=3) + ripples_db() + mean_db(50.0, 25.0)))
    assert found.db_per_count == pytest.approx(DB_PER_COUNT, rel=0.1)
    assert found.db_interval[0] < DB_PER_COUNT < found.db_interval[1]


@pytest.mark.parametrize(("looks", "water_db"), [(1, 14.0), (2, 10.0), (4, 7.0), (8, 5.0)])
def test_a_water_column_partly_below_the_lowest_count_shows_decibels(looks: int, water_db: float) -> None:
    """Its tail is cut off at zero: without allowance, skewness would make looks too many and decibels too few."""
    samples = counts(gamma_db(looks, seed=4) + ripples_db() + mean_db(45.0, water_db))
    assert (samples[:, :BOTTOM] == 0).any()
    assert speckle_of(samples).quiet
    found = estimate(samples)
    assert found.db_per_count == pytest.approx(DB_PER_COUNT, rel=0.15)


@pytest.mark.parametrize("looks", [1, 8])
def test_speckle_that_lasts_over_pings_on_a_textured_floor_is_separated_from_texture(looks: int) -> None:
    random = np.random.default_rng(6)
    taps = np.exp(-2.0 * np.log(2.0) * (np.arange(-4, 5) / 1.75) ** 2)
    taps /= np.sqrt(taps @ taps)
    intensity = np.zeros((N_PINGS, N_SAMPLES))
    for _ in range(2 * looks):
        field = lfilter(taps, [1.0], random.normal(size=(N_PINGS + 8, N_SAMPLES)), axis=0)[8:]
        intensity += field**2 / (2 * looks)
    floor = 10.0 * np.log10(intensity) + texture_db(seed=7, std_db=1.0) + mean_db(40.0, -40.0)
    assert estimate(counts(floor)).db_per_count == pytest.approx(DB_PER_COUNT, rel=0.15)


def test_quiet_cells_are_those_of_the_water_column_alone() -> None:
    samples = counts(gamma_db(2, seed=8) + texture_db(seed=9, std_db=1.0) + mean_db(50.0, 22.0))
    shapes = speckle_of(samples).quiet
    assert len(shapes) == 4
    assert all(shape.mean < 24.0 / DB_PER_COUNT for shape in shapes)
    assert speckle_of(counts(gamma_db(2, seed=8) + texture_db(seed=9, std_db=1.0) + 50.0)).quiet == ()


def test_fish_in_the_water_column_do_not_change_what_it_shows() -> None:
    decibels = gamma_db(2, seed=10) + mean_db(50.0, 22.0)
    fish = decibels.copy()
    fish[40:44, 60:66] += 25.0
    fish[150:158, 80:90] += 12.0
    clean, disturbed = estimate(counts(decibels)), estimate(counts(fish))
    assert disturbed.db_per_count == pytest.approx(clean.db_per_count, rel=0.02)


def test_a_textured_water_column_is_not_quiet() -> None:
    bubbles = texture_db(seed=11, std_db=3.0, reach_pings=2.0, reach_samples=20.0)
    assert speckle_of(counts(gamma_db(2, seed=12) + bubbles + mean_db(60.0, 20.0))).quiet == ()


def test_samples_whose_skewness_adds_nothing_are_left_to_the_prior() -> None:
    """Smoothed and decimated logarithms are spread nearly normally, which would be 32 looks and more."""
    smoothed = np.random.default_rng(13).normal(0.0, 2.0, (N_PINGS, N_SAMPLES))
    low, high = estimate(counts(smoothed + texture_db(seed=14, std_db=0.5) + mean_db(40.0, 20.0))).db_interval
    assert high > 1.5 * low
    assert low < 0.33 < high


def test_without_blocks_of_one_layout_there_are_no_quiet_cells() -> None:
    random = np.random.default_rng(14)
    blocks = [measure_regions([random.gamma(1.0, 50.0, (16, n))]) for n in (400, 12)]
    table = blocks[1].table
    assert quiet_shapes(blocks[1:], table, table.cumulants.mean(axis=3), 1.0, is_cut=True) == ()
    assert summarise(blocks).quiet == ()


@pytest.mark.parametrize("looks", [2, 8])
def test_speckle_of_even_regions_is_that_of_its_looks(looks: int) -> None:
    shape = speckle_of(counts(gamma_db(looks, seed=15) + 50.0)).absolute
    assert shape is not None
    log_std, skewness = (values[0] for values in log_std_and_skewness(np.array([np.inf])))
    at = int(np.abs(LOOKS - looks).argmin())
    assert shape.std * DB_PER_COUNT * np.log(10.0) / 10.0 == pytest.approx(np.exp(log_std[at]), rel=0.02)
    assert shape.skewness == pytest.approx(skewness[at], rel=0.06)


@pytest.mark.parametrize(
    ("texture", "lasting"), [((0.03, 0.10, 0.27), 0.0), ((0.13, 0.33, 0.69), 0.0), ((0.0, 0.0, 0.0), 0.5)]
)
def test_speckle_is_separated_from_texture_of_any_growth(texture: tuple[float, ...], lasting: float) -> None:
    """Texture in even places need not grow in proportion from the first stride to the second."""
    left = np.array([1.0 - lasting * share for share in (0.51, 0.055, 0.0)])
    even = left + np.array(texture)
    uneven = left + 2.0 * np.array(texture) if any(texture) else None
    found = speckle_variance(even, uneven, 0.01)
    assert found.variance == pytest.approx(1.0, abs=0.05)
    assert abs(np.log(found.variance)) < 2.0 * found.log_sigma
