"""What recorded numbers mean, from simulated speckle whose law is known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace
from auv_mcm.settings.config import SonarConfig
from auv_mcm.waterfall.transfer import SINGLE_LOOK_STD_DB, Transfer, kind_from_speckle, resolve_transfer, speckle_evidence, to_intensity

N_SAMPLES, BOTTOM = 1500, 200
RANGE_SAMPLES = np.arange(N_SAMPLES)
PROFILES = {
    "level": np.ones(N_SAMPLES),
    "spreading": (BOTTOM / np.maximum(RANGE_SAMPLES, BOTTOM)) ** 3,
    "rising": np.exp(RANGE_SAMPLES / 700.0),
}


def intensity_pings(looks: int, profile: str, seed: int = 0, n_pings: int = 24) -> NDArray[np.float64]:
    """Gamma speckle over a range profile, 30 dB darker before the bottom."""
    random = np.random.default_rng(seed)
    mean = PROFILES[profile] * np.where(RANGE_SAMPLES < BOTTOM, 1e-3, 1.0)
    return mean * random.gamma(looks, 1.0 / looks, (n_pings, N_SAMPLES))


def traces(samples: NDArray[Any]) -> list[EchoTrace]:
    return [EchoTrace(samples=row, first_range_m=0.01, spacing_m=0.02) for row in samples]


def kind_of(samples: NDArray[Any]) -> str:
    return kind_from_speckle(speckle_evidence(traces(samples)))


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("gain", [1e-6, 1.0, 1e6])
def test_speckle_tells_amplitude_intensity_and_logarithm_apart_at_any_gain(profile: str, gain: float) -> None:
    single = intensity_pings(1, profile)
    assert kind_of(gain * np.sqrt(single)) == "amplitude"
    assert kind_of((gain * single).astype(np.float32)) == "intensity"
    assert kind_of(10.0 * np.log10(gain * single)) == "log"


@pytest.mark.parametrize("looks", [2, 4, 9])
@pytest.mark.parametrize("profile", PROFILES)
def test_averaged_looks_leave_amplitude_and_logarithm_apart(looks: int, profile: str) -> None:
    averaged = intensity_pings(looks, profile)
    assert kind_of(np.sqrt(averaged)) == "amplitude"
    assert kind_of(20.0 * np.log10(np.sqrt(averaged)) + 60.0) == "log"


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("seed", range(3))
def test_plants_and_stones_over_most_of_the_floor_do_not_make_amplitude_look_like_intensity(share: float, seed: int) -> None:
    """Patches with echoes up to 13 dB above and below, changing within half a metre: they spread samples more than speckle does."""
    random = np.random.default_rng(seed)
    single = intensity_pings(1, "level", seed)
    gain_db = np.repeat(random.uniform(-13.0, 13.0, (single.shape[0], N_SAMPLES // 20)), 20, axis=1)
    covered = np.repeat(random.random((single.shape[0], N_SAMPLES // 300)) < share, 300, axis=1)
    textured = single * 10.0 ** (0.1 * np.where(covered, gain_db, 0.0))
    assert kind_of(np.sqrt(textured)) == "amplitude"
    assert kind_of(textured) == "intensity"


def test_quantised_samples_are_recognised_too() -> None:
    single = intensity_pings(1, "level")
    assert kind_of(np.clip(60.0 * np.sqrt(single), 0, 255).astype(np.uint8)) == "amplitude"
    assert kind_of(np.clip(8000.0 * np.sqrt(single), 0, 32767).astype(np.uint16)) == "amplitude"
    assert kind_of(np.clip(5000.0 * single, 0, 65535).astype(np.uint16)) == "intensity"
    assert kind_of(np.clip(10.0 * np.log10(single) / 0.35 + 150.0, 0, 255).astype(np.uint8)) == "log"


def test_clipped_sea_floor_does_not_turn_amplitude_into_a_logarithm() -> None:
    assert kind_of(np.minimum(20000.0 * np.sqrt(intensity_pings(1, "spreading")), 32767).astype(np.uint16)) == "amplitude"


def test_a_single_decibel_near_zero_is_still_a_logarithm() -> None:
    """The mean of decibels near 0 dB is no measure of spread; nothing but the skewness speaks."""
    for offset_db in (-4.0, 0.0, 2.5):
        assert kind_of(10.0 * np.log10(intensity_pings(1, "level")) + offset_db) == "log"


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(("db_per_count", "dtype"), [(0.35, np.uint8), (0.5, np.uint8), (0.01, np.uint16), (1.0, np.float32)])
def test_decibels_per_count_are_found_within_five_percent(profile: str, db_per_count: float, dtype: type) -> None:
    decibels = 10.0 * np.log10(intensity_pings(1, profile, seed=3))
    counts = (decibels + 60.0) / db_per_count
    if dtype is not np.float32:
        counts = np.clip(np.rint(counts), 0, np.iinfo(dtype).max)
    transfer, notices = resolve_transfer(SonarConfig(), traces(counts.astype(dtype)))
    assert transfer.kind == "log"
    assert transfer.db_per_count == pytest.approx(db_per_count, rel=0.05)
    assert [notice.code for notice in notices] == ["transfer.chosen"]


def test_standard_deviation_of_logarithmic_speckle_is_that_of_the_log_of_an_exponential() -> None:
    draws = np.random.default_rng(1).exponential(size=1_000_000)
    assert pytest.approx(np.std(10.0 * np.log10(draws)), rel=5e-3) == SINGLE_LOOK_STD_DB


def test_a_configured_transfer_is_kept_and_doubted_aloud() -> None:
    amplitude = traces(np.sqrt(intensity_pings(1, "level")))
    transfer, notices = resolve_transfer(SonarConfig(transfer="log", db_per_count=0.5), amplitude)
    assert transfer == Transfer("log", 0.5)
    assert "transfer.disagrees" in [notice.code for notice in notices]
    assert all("sonar." in notice.text for notice in notices)

    logarithm = traces(10.0 * np.log10(intensity_pings(1, "level")) / 0.35 + 150.0)
    transfer, notices = resolve_transfer(SonarConfig(transfer="amplitude"), logarithm)
    assert transfer.kind == "amplitude"
    assert math.isnan(transfer.db_per_count)
    assert [notice.code for notice in notices] == ["transfer.disagrees"]

    transfer, notices = resolve_transfer(SonarConfig(transfer="log", db_per_count=1.0), logarithm)
    assert transfer.db_per_count == 1.0
    assert [notice.code for notice in notices] == ["transfer.db_per_count"]


def test_what_the_sonar_tells_beats_speckle_but_not_the_configuration() -> None:
    averaged = traces(intensity_pings(4, "level"))
    assert resolve_transfer(SonarConfig(), averaged)[0].kind == "amplitude"
    assert resolve_transfer(SonarConfig(), averaged, "intensity")[0].kind == "intensity"
    assert resolve_transfer(SonarConfig(transfer="amplitude"), averaged, "intensity")[0].kind == "amplitude"


def test_what_the_sonar_tells_is_doubted_aloud() -> None:
    logarithm = traces(10.0 * np.log10(intensity_pings(1, "level")) + 90.0)
    transfer, notices = resolve_transfer(SonarConfig(), logarithm, "intensity")
    assert transfer.kind == "intensity"
    assert [notice.code for notice in notices] == ["transfer.disagrees"]
    assert "the sonar tells 'intensity'" in notices[0].text


@pytest.mark.parametrize("looks", [1, 4, 9])
def test_a_configured_transfer_that_fits_raises_no_doubt(looks: int) -> None:
    intensity = intensity_pings(looks, "spreading")
    assert resolve_transfer(SonarConfig(transfer="intensity"), traces(intensity))[1] == ()
    assert resolve_transfer(SonarConfig(transfer="amplitude"), traces(np.sqrt(intensity)))[1] == ()
    assert resolve_transfer(SonarConfig(transfer="log"), traces(10.0 * np.log10(intensity) + 90.0))[1] == ()


@pytest.mark.parametrize(
    "samples",
    [
        np.zeros((0, N_SAMPLES)),
        np.zeros((4, 0)),
        np.ones((4, 30)),
        np.full((30, N_SAMPLES), np.nan),
        np.full((30, N_SAMPLES), 7, dtype=np.uint8),
        np.full((30, N_SAMPLES), 0.1),
    ],
    ids=["no pings", "no samples", "few samples", "NaN", "constant", "constant with rounding"],
)
def test_without_speckle_the_choice_is_the_commonest_and_says_so(samples: NDArray[Any]) -> None:
    for sonar, expected in (
        (SonarConfig(), "amplitude"),
        (SonarConfig(transfer="log"), "log"),
        (SonarConfig(transfer="intensity"), "intensity"),
    ):
        transfer, notices = resolve_transfer(sonar, traces(samples))
        assert transfer.kind == expected
        assert math.isfinite(transfer.db_per_count) == (expected == "log")
        assert [notice.code for notice in notices] == ["transfer.unchecked"]


def test_single_bad_samples_do_not_spoil_the_evidence() -> None:
    samples = np.sqrt(intensity_pings(1, "level"))
    samples[:, ::333] = np.nan
    samples[3, 700] = np.inf
    assert kind_of(samples) == "amplitude"


@given(
    samples=hnp.arrays(
        np.float64, st.integers(0, 20), elements=st.floats(-1e3, 1e9) | st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -0.0])
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
        np.float32, st.integers(0, 20), elements=st.floats(-1000, 1000, width=32) | st.sampled_from([math.nan, math.inf, -math.inf])
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


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.uint16, np.int16, np.uint32, np.int32, np.float16, np.float32, np.float64])
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
