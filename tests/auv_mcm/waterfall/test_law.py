"""What recorded numbers are taken for, from speckle whose law is known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.waterfall.law import LawOdds
from auv_mcm.waterfall.law_watch import weigh_pings
from tests.auv_mcm.waterfall.law_pings import BOTTOM, N_SAMPLES, PROFILES, decibels, intensity_pings, log_counts, pings


def odds_of(samples: NDArray[Any]) -> LawOdds:
    return weigh_pings(pings(samples))


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("gain", [1e-6, 1.0, 1e6])
def test_speckle_distinguishes_amplitude_intensity_and_logarithm_at_any_gain(profile: str, gain: float) -> None:
    single = intensity_pings(1, profile)
    for samples, law in (
        (gain * np.sqrt(single), "amplitude"),
        ((gain * single).astype(np.float32), "intensity"),
        (decibels(gain * single), "log"),
    ):
        odds = odds_of(samples)
        assert odds.likeliest == law
        assert odds.of(odds.likeliest) > 0.95


@pytest.mark.parametrize("looks", [2, 4, 8])
@pytest.mark.parametrize("profile", PROFILES)
def test_averaged_looks_leave_all_three_laws_apart(looks: int, profile: str) -> None:
    averaged = intensity_pings(looks, profile)
    assert odds_of(np.sqrt(averaged)).likeliest == "amplitude"
    assert odds_of(averaged).likeliest == "intensity"
    assert odds_of(decibels(averaged) + 60.0).likeliest == "log"


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("seed", range(2))
def test_plants_and_stones_over_most_of_the_floor_do_not_make_amplitude_look_like_intensity(
    share: float, seed: int
) -> None:
    """Patches with echoes up to 13 dB above and below, changing within half a metre: they spread samples more than
    speckle does."""
    random = np.random.default_rng(seed)
    single = intensity_pings(1, "level", seed)
    n_patches = single.shape[0] // 8  # of 8 pings by 20 samples
    gain_db = np.repeat(np.repeat(random.uniform(-13.0, 13.0, (n_patches, N_SAMPLES // 20)), 20, axis=1), 8, axis=0)
    covered = np.repeat(np.repeat(random.random((n_patches, N_SAMPLES // 300)) < share, 300, axis=1), 8, axis=0)
    textured = single * 10.0 ** (0.1 * np.where(covered, gain_db, 0.0))
    assert odds_of(np.sqrt(textured)).likeliest == "amplitude"
    assert odds_of(textured).likeliest == "intensity"


def test_quantised_samples_are_recognised_too() -> None:
    single = intensity_pings(1, "level")
    assert odds_of(np.clip(60.0 * np.sqrt(single), 0, 255).astype(np.uint8)).likeliest == "amplitude"
    assert odds_of(np.clip(8000.0 * np.sqrt(single), 0, 32767).astype(np.uint16)).likeliest == "amplitude"
    assert odds_of(np.clip(5000.0 * single, 0, 65535).astype(np.uint16)).likeliest == "intensity"
    assert odds_of(log_counts(single, 0.35)).likeliest == "log"


def test_clipped_sea_floor_does_not_turn_amplitude_into_a_logarithm() -> None:
    clipped = np.minimum(20000.0 * np.sqrt(intensity_pings(1, "spreading")), 32767).astype(np.uint16)
    assert odds_of(clipped).likeliest == "amplitude"


def test_decibels_around_zero_are_still_a_logarithm() -> None:
    for offset_db in (-4.0, 0.0, 2.5):
        assert odds_of(decibels(intensity_pings(1, "level")) + offset_db).likeliest == "log"


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("looks", [1, 2, 4, 8])
@pytest.mark.parametrize("db_per_count", [0.25, 0.314, 0.45])
def test_decibels_per_count_do_not_take_averaged_looks_for_single_ones(
    profile: str, looks: int, db_per_count: float
) -> None:
    """Single-look speckle would make them too many by half for 2 looks, by a factor of 3.5 for 8."""
    odds = odds_of(log_counts(intensity_pings(looks, profile, seed=3, n_pings=256), db_per_count))
    assert odds.db_per_count == pytest.approx(db_per_count, rel=0.2)
    low, high = odds.db_interval
    assert low < db_per_count < high
    assert odds.looks_interval[0] <= 1.15 * looks
    assert odds.looks_interval[1] >= looks


def test_speckle_that_lasts_over_pings_does_not_change_the_law() -> None:
    """Overlapping beams draw speckle anew only every other ping or so."""
    random = np.random.default_rng(1)
    field = random.normal(size=(260, N_SAMPLES)) + 1j * random.normal(size=(260, N_SAMPLES))
    lasting = 0.6 * field[:-1] + 0.8 * field[1:]
    intensity = np.abs(lasting) ** 2 * np.where(RANGE < BOTTOM, 1e-3, 1.0)
    assert odds_of(np.sqrt(intensity)).likeliest == "amplitude"
    assert odds_of(intensity).likeliest == "intensity"
    odds = odds_of(log_counts(0.5 * intensity, 0.3))
    assert odds.likeliest == "log"
    assert odds.db_per_count == pytest.approx(0.3, rel=0.15)


RANGE = np.arange(N_SAMPLES)


@pytest.mark.parametrize(
    "samples",
    [
        np.zeros((0, N_SAMPLES)),
        np.zeros((40, 0)),
        np.ones((40, 30)),
        np.full((40, N_SAMPLES), np.nan),
        np.full((40, N_SAMPLES), 7, dtype=np.uint8),
        np.full((40, N_SAMPLES), 0.1),
    ],
    ids=["no pings", "no samples", "few samples", "NaN", "constant", "constant with rounding"],
)
def test_without_speckle_only_the_prior_speaks(samples: NDArray[Any]) -> None:
    odds = odds_of(samples)
    assert odds.n_regions == 0
    assert odds.likeliest == "amplitude"
    assert math.isnan(odds.db_per_count)


@pytest.mark.parametrize("gain", [1e-300, 1e-120, 1e-30, 1e15])
def test_absurd_gains_of_floating_point_samples_do_no_harm(gain: float) -> None:
    odds = odds_of(gain * np.sqrt(intensity_pings(1, "level", n_pings=32)))
    assert odds.likeliest == "amplitude"
    assert np.isfinite(odds.looks_interval).all()


def test_single_bad_samples_do_not_spoil_the_evidence() -> None:
    samples = np.sqrt(intensity_pings(1, "level"))
    samples[:, ::333] = np.nan
    samples[3, 700] = np.inf
    samples[5, 800] = 1e300
    assert odds_of(samples).likeliest == "amplitude"
