"""What recorded numbers are taken for, from speckle whose recorder is known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.settings.config import SonarConfig
from auv_mcm.waterfall.floor_speckle import FloorSpeckle
from auv_mcm.waterfall.law_watch import law_of_pings
from auv_mcm.waterfall.sample_law import SampleLaw, sample_law
from tests.auv_mcm.waterfall.law_pings import BOTTOM, N_SAMPLES, PROFILES, decibels, intensity_pings, log_counts, pings

RANGE = np.arange(N_SAMPLES)


def law_of(samples: NDArray[Any]) -> SampleLaw:
    return law_of_pings(pings(samples), SonarConfig())


def stretched(samples: NDArray[Any], exponent: float) -> float:
    """Decibels read for each decibel of echo of samples that are intensity ** exponent."""
    law = law_of(samples)
    assert law.is_sure
    assert law.transfer.kind == "amplitude"
    return law.transfer.intensity_power * exponent


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("gain", [1e-6, 1.0, 1e6])
def test_any_power_of_single_look_intensity_is_the_same_picture_at_any_gain(profile: str, gain: float) -> None:
    single = intensity_pings(1, profile)
    assert stretched(gain * np.sqrt(single), 0.5) == pytest.approx(1.0, abs=0.02)
    assert stretched((gain * single).astype(np.float32), 1.0) == pytest.approx(1.0, abs=0.25)
    assert stretched(gain * single**0.35, 0.35) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("looks", [1, 2, 4, 8])
@pytest.mark.parametrize("profile", PROFILES)
def test_amplitude_of_any_looks_is_taken_as_it_is(looks: int, profile: str) -> None:
    assert stretched(np.sqrt(intensity_pings(looks, profile)), 0.5) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("looks", [1, 2, 4, 8])
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("db_per_count", [0.2, 0.314, 0.45])
def test_logarithms_are_recognised_and_scaled_by_the_spread_of_the_floor(
    profile: str, looks: int, db_per_count: float
) -> None:
    law = law_of(log_counts(intensity_pings(looks, profile, seed=3, n_pings=256), db_per_count))
    assert law.is_sure
    assert law.transfer.kind == "log"
    read = law.transfer.db_per_count / db_per_count
    # looks, texture and smoothing look alike
    assert 0.85 < read < 1.15 if looks == 1 else 0.6 < read < (1.6 if looks < 8 else 2.0)


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
    assert 0.8 < stretched(np.sqrt(textured), 0.5) <= 1.01


@pytest.mark.parametrize("reach", [1, 2, 3, 5])
@pytest.mark.parametrize("texture_cv", [0.0, 0.5, 0.9])
def test_correlated_and_textured_speckle_leaves_amplitude_what_it_is(reach: int, texture_cv: float) -> None:
    """The flaw of three floors in ten made elsewhere: correlated K-distributed amplitude was taken for intensity."""
    random = np.random.default_rng(reach)
    white = random.normal(size=(128, N_SAMPLES + reach)) + 1j * random.normal(size=(128, N_SAMPLES + reach))
    field = np.lib.stride_tricks.sliding_window_view(white, reach, axis=1).mean(axis=2)[:, :N_SAMPLES] * reach**0.5
    coarse = np.repeat(np.repeat(random.gamma(4.0, 0.25, (32, N_SAMPLES // 8)), 4, axis=0), 8, axis=1)
    texture = 1.0 + texture_cv * (coarse - 1.0)
    assert 0.8 < stretched(np.abs(field) * np.sqrt(np.maximum(texture, 1e-3)), 0.5) <= 1.01


def test_quantised_samples_are_recognised_too() -> None:
    single = intensity_pings(1, "level")
    assert law_of(np.clip(60.0 * np.sqrt(single), 0, 255).astype(np.uint8)).seen == "amplitude"
    assert law_of(np.clip(8000.0 * np.sqrt(single), 0, 32767).astype(np.uint16)).seen == "amplitude"
    assert law_of(np.clip(5000.0 * single, 0, 65535).astype(np.uint16)).seen == "amplitude"
    assert law_of(log_counts(single, 0.35)).seen == "log"


def test_clipped_sea_floor_does_not_turn_amplitude_into_a_logarithm() -> None:
    clipped = np.minimum(20000.0 * np.sqrt(intensity_pings(1, "spreading")), 32767).astype(np.uint16)
    assert law_of(clipped).transfer.kind == "amplitude"


def test_decibels_around_zero_are_still_a_logarithm() -> None:
    for offset_db in (-4.0, 0.0, 2.5):
        law = law_of(decibels(intensity_pings(1, "level")) + offset_db)
        assert law.transfer.kind == "log"
        assert law.transfer.db_per_count == pytest.approx(1.0, rel=0.35)


def test_speckle_that_lasts_over_pings_does_not_change_the_law() -> None:
    """Overlapping beams draw speckle anew only every other ping or so."""
    random = np.random.default_rng(1)
    field = random.normal(size=(260, N_SAMPLES)) + 1j * random.normal(size=(260, N_SAMPLES))
    lasting = 0.6 * field[:-1] + 0.8 * field[1:]
    intensity = np.abs(lasting) ** 2 * np.where(RANGE < BOTTOM, 1e-3, 1.0)
    assert stretched(np.sqrt(intensity), 0.5) == pytest.approx(1.0, abs=0.05)
    law = law_of(log_counts(0.5 * intensity, 0.3))
    assert law.transfer.db_per_count == pytest.approx(0.3, rel=0.15)


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
def test_without_speckle_samples_are_linear_amplitude_and_the_law_is_open(samples: NDArray[Any]) -> None:
    law = law_of(samples)
    assert law.n_regions == 0
    assert not law.is_sure
    assert law.transfer.kind == "amplitude"
    assert law.transfer.intensity_power == 2.0


@pytest.mark.parametrize("gain", [1e-300, 1e-120, 1e-30, 1e15])
def test_absurd_gains_of_floating_point_samples_do_no_harm(gain: float) -> None:
    assert law_of(gain * np.sqrt(intensity_pings(1, "level", n_pings=32))).transfer.kind == "amplitude"


def test_single_bad_samples_do_not_spoil_the_evidence() -> None:
    samples = np.sqrt(intensity_pings(1, "level"))
    samples[:, ::333] = np.nan
    samples[3, 700] = np.inf
    samples[5, 800] = 1e300
    assert law_of(samples).transfer.kind == "amplitude"


finite = st.floats(-3.0, 3.0)


@settings(deadline=None)
@given(
    spread=st.floats(0.01, 3.0),
    relative_skewness=finite,
    spread_counts=st.floats(0.5, 60.0),
    skewness=finite,
    growth=finite,
    level_nats=st.floats(0.0, 3.0),
)
def test_what_the_data_leave_open_is_linear_amplitude_and_no_picture_is_stretched_beyond_a_single_look(
    spread: float, relative_skewness: float, spread_counts: float, skewness: float, growth: float, level_nats: float
) -> None:
    speckle = FloorSpeckle(
        spread, relative_skewness, spread_counts, skewness, growth, level_nats, 120.0, 100, True, negative=False
    )
    law = sample_law(speckle)
    if not law.is_sure:
        assert law.transfer.kind == "amplitude"
        assert law.transfer.intensity_power == 2.0
    elif law.transfer.kind == "log":
        assert law.transfer.db_per_count * spread_counts <= 5.8 + 1e-9
    else:
        assert 0.0 < law.transfer.intensity_power <= 2.0 / 0.7 + 1e-9
        if spread > 0.6:
            assert law.transfer.intensity_power < 2.0
    assert math.isfinite(law.linear_nats)
