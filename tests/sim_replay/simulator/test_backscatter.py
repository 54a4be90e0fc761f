"""The backscatter model against published values, against physics, and its tables against the model."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.simulator.backscatter import (
    HIGHEST_HZ,
    SEDIMENTS,
    TABLE_SIZE,
    Sediment,
    backscatter,
    lambert,
    lookup_table,
    sediment_from_grain_size,
    target_table,
)

GRAZING_DEG = (5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 80.0, 90.0)
# Strength in dB at 100 kHz and 1528 m/s, to 0.1 dB, computed independently from the report's equations.
PUBLISHED_DB = {
    "rough_rock": (-11.5, -8.8, -6.2, -4.9, -4.0, -3.8, -4.0, -4.2),
    "rock": (-22.2, -17.0, -12.0, -9.5, -7.8, -7.2, -7.2, -7.4),
    "cobble": (-26.8, -21.3, -16.2, -13.8, -12.4, -11.8, -11.2, -11.2),
    "sandy_gravel": (-29.8, -24.2, -19.3, -17.5, -16.4, -15.5, -13.6, -13.2),
    "coarse_sand": (-33.6, -27.2, -21.8, -20.1, -18.9, -17.1, -12.0, -10.7),
    "medium_sand": (-36.6, -29.8, -24.2, -22.6, -21.3, -19.5, -12.2, -9.7),
    "fine_sand": (-39.9, -33.5, -27.2, -24.6, -23.6, -22.0, -14.4, -9.9),
    "very_fine_sand": (-41.3, -34.0, -27.0, -25.6, -24.5, -23.5, -18.0, -10.0),
    "coarse_silt": (-39.0, -31.9, -27.8, -26.4, -25.0, -24.1, -21.4, -8.7),
    "medium_silt": (-41.0, -35.6, -31.7, -29.9, -28.3, -27.3, -25.5, -9.7),
    "clay": (-42.3, -36.4, -32.0, -30.1, -28.4, -27.4, -25.8, -10.6),
}
# Density ratio, sound-speed ratio, loss, volume parameter, spectral strength as the report's Table 2 prints them.
PUBLISHED_SEDIMENTS = {
    "sandy_gravel": (2.492, 1.3370, 0.01705, 0.002, 0.01294),
    "coarse_sand": (2.231, 1.2503, 0.01638, 0.002, 0.00696),
    "medium_sand": (1.845, 1.1782, 0.01624, 0.002, 0.00445),
    "fine_sand": (1.451, 1.1073, 0.01602, 0.002, 0.00271),
    "very_fine_sand": (1.268, 1.0568, 0.01875, 0.002, 0.00154),
    "coarse_silt": (1.195, 1.0179, 0.02158, 0.002, 0.00078),
    "medium_silt": (1.149, 0.9885, 0.00676, 0.001, 0.00052),
    "clay": (1.145, 0.9800, 0.00148, 0.001, 0.00052),
}
sediments = pytest.mark.parametrize("name", SEDIMENTS)


def strength_db(sediment: Sediment, frequency_hz: float, grazing_deg: Any) -> NDArray[np.float64]:
    return 10.0 * np.log10(backscatter(sediment, frequency_hz, np.radians(grazing_deg)))


def looked_up_db(table: NDArray[np.float32], grazing_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    entry = np.minimum((np.sin(np.radians(grazing_deg)) * TABLE_SIZE).astype(np.int64), TABLE_SIZE - 1)
    return 10.0 * np.log10(table[entry].astype(np.float64))


@sediments
def test_strength_is_the_published_one(name: str) -> None:
    np.testing.assert_allclose(strength_db(SEDIMENTS[name], 100e3, GRAZING_DEG), PUBLISHED_DB[name], atol=0.1)


@pytest.mark.parametrize("name", PUBLISHED_SEDIMENTS)
def test_grain_size_gives_the_published_sediment(name: str) -> None:
    sediment = SEDIMENTS[name]
    values = (
        sediment.density_ratio,
        sediment.sound_speed_ratio,
        sediment.loss,
        sediment.volume_parameter,
        sediment.spectral_strength_cm4,
    )
    np.testing.assert_allclose(values, PUBLISHED_SEDIMENTS[name], rtol=0.003, atol=5e-6)
    assert sediment.spectral_exponent == 3.25


@sediments
@pytest.mark.parametrize("frequency_hz", [100e3, 450e3, 900e3])
def test_table_is_the_model(name: str, frequency_hz: float) -> None:
    sediment, table = SEDIMENTS[name], lookup_table(SEDIMENTS[name], frequency_hz)
    grazing_deg = np.linspace(3.0, 80.0, 3000)
    assert table.shape == (TABLE_SIZE,)
    assert table.dtype == np.float32
    np.testing.assert_allclose(
        looked_up_db(table, grazing_deg), strength_db(sediment, frequency_hz, grazing_deg), atol=0.1
    )
    steep_deg = np.linspace(80.0, 90.0, 600)
    np.testing.assert_allclose(looked_up_db(table, steep_deg), strength_db(sediment, frequency_hz, steep_deg), atol=0.7)


def test_lambert_has_its_strength_at_normal_incidence_and_a_quarter_at_thirty_degrees() -> None:
    np.testing.assert_allclose(lambert(np.radians([90.0, 30.0, 0.0]), -20.0), [0.01, 0.0025, 0.0], atol=1e-17)


@sediments
@pytest.mark.parametrize("frequency_hz", [300e3, 450e3, 900e3])
def test_beyond_the_band_the_shape_stays_and_the_level_follows_the_roughness(name: str, frequency_hz: float) -> None:
    rise = strength_db(SEDIMENTS[name], frequency_hz, GRAZING_DEG) - strength_db(
        SEDIMENTS[name], HIGHEST_HZ, GRAZING_DEG
    )
    np.testing.assert_allclose(rise, rise[0], atol=1e-9)
    octaves = math.log2(frequency_hz / HIGHEST_HZ)
    perturbation_db_per_octave = 10.0 * math.log10(2.0) * (4.0 - 3.25)  # the most that a spectrum K^-3.25 can give
    assert -1e-9 <= rise[0] <= perturbation_db_per_octave * octaves
    if name in ("coarse_silt", "medium_silt", "clay"):
        assert rise[0] < 0.1


@sediments
def test_level_has_no_step_where_extrapolation_begins(name: str) -> None:
    just_beyond = strength_db(SEDIMENTS[name], HIGHEST_HZ * (1.0 + 1e-9), GRAZING_DEG)
    np.testing.assert_allclose(just_beyond, strength_db(SEDIMENTS[name], HIGHEST_HZ, GRAZING_DEG), atol=1e-6)


def test_rays_along_the_floor_and_beyond_the_vertical_take_the_nearest_angle() -> None:
    sand = SEDIMENTS["fine_sand"]
    np.testing.assert_array_equal(
        backscatter(sand, 100e3, np.radians([-10.0, 0.0])), [backscatter(sand, 100e3, math.radians(0.001))] * 2
    )
    assert backscatter(sand, 100e3, math.radians(95.0)) == backscatter(sand, 100e3, math.radians(90.0))


def test_shape_of_the_angles_is_kept() -> None:
    grazing_rad = np.linspace(0.1, 1.5, 24).reshape(2, 3, 4)
    sigma = backscatter(SEDIMENTS["rock"], 450e3, grazing_rad)
    assert sigma.shape == (2, 3, 4)
    np.testing.assert_allclose(sigma.ravel(), backscatter(SEDIMENTS["rock"], 450e3, grazing_rad.ravel()), rtol=1e-14)


@given(
    phi=st.floats(-1.0, 9.0),
    loss=st.floats(1e-12, 0.1),
    frequency_hz=st.floats(1e3, 3e6),
    sound_speed_mps=st.floats(1400.0, 1600.0),
    grazing_rad=st.floats(-0.1, 1.6),
)
def test_every_sediment_has_a_finite_positive_echo(
    phi: float, loss: float, frequency_hz: float, sound_speed_mps: float, grazing_rad: float
) -> None:
    usual = sediment_from_grain_size(phi)
    lossy = Sediment(
        density_ratio=usual.density_ratio,
        sound_speed_ratio=usual.sound_speed_ratio,
        loss=loss,
        volume_parameter=usual.volume_parameter,
        spectral_strength_cm4=usual.spectral_strength_cm4,
    )
    with np.errstate(all="raise", under="ignore"):
        for sediment in (usual, lossy):
            sigma = float(backscatter(sediment, frequency_hz, grazing_rad, sound_speed_mps))
            assert 0.0 < sigma < 100.0


def test_critical_angle_without_loss_is_no_pole() -> None:
    sediment = Sediment(
        density_ratio=2.0, sound_speed_ratio=1.25, loss=1e-300, volume_parameter=0.002, spectral_strength_cm4=0.005
    )
    critical_rad = math.acos(1.0 / 1.25)
    with np.errstate(all="raise", under="ignore"):
        assert np.isfinite(backscatter(sediment, 100e3, critical_rad + np.linspace(-1e-9, 1e-9, 101))).all()


def test_target_is_lambertian_aside_and_flashes_at_normal_incidence() -> None:
    table = target_table(-10.0, 15.0, 40.0)
    assert table.shape == (TABLE_SIZE,)
    assert table.dtype == np.float32
    grazing_deg = np.array([3.0, 10.0, 40.0, 60.0, 80.0, 85.0, 90.0])
    sines = np.sin(np.radians(grazing_deg))
    expected = 10.0 * np.log10(10.0**-1.0 * (sines**2 + 10.0**1.5 * sines**40.0))
    np.testing.assert_allclose(looked_up_db(table, grazing_deg), expected, atol=0.1)
    np.testing.assert_allclose(
        looked_up_db(target_table(-10.0, -math.inf, 40.0), grazing_deg), -10.0 + 20.0 * np.log10(sines), atol=0.1
    )


@pytest.mark.parametrize("phi", [-1.01, 9.01, math.nan])
def test_grain_size_outside_the_fits_is_refused(phi: float) -> None:
    with pytest.raises(ValueError, match="from -1"):
        sediment_from_grain_size(phi)


@pytest.mark.parametrize(
    ("frequency_hz", "sound_speed_mps"), [(0.0, 1500.0), (math.nan, 1500.0), (math.inf, 1500.0), (1e5, -1.0)]
)
def test_senseless_wave_is_refused(frequency_hz: float, sound_speed_mps: float) -> None:
    with pytest.raises(ValueError, match="must be a positive number"):
        backscatter(SEDIMENTS["rock"], frequency_hz, 0.3, sound_speed_mps)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("density_ratio", 0.9),
        ("loss", 0.0),
        ("loss", math.nan),
        ("spectral_strength_cm4", 0.0),
        ("spectral_exponent", 4.0),
    ],
)
def test_sediment_outside_the_limits_is_refused(field: str, value: float) -> None:
    usual = {
        "density_ratio": 2.0,
        "sound_speed_ratio": 1.2,
        "loss": 0.01,
        "volume_parameter": 0.002,
        "spectral_strength_cm4": 0.005,
    }
    with pytest.raises(ValueError, match=field):
        Sediment(**{**usual, field: value})


@pytest.mark.parametrize(
    "arguments", [(0.0, 10.0, 0.0), (math.nan, 10.0, 40.0), (0.0, math.inf, 40.0), (0.0, 10.0, math.nan)]
)
def test_senseless_target_is_refused(arguments: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="exponent"):
        target_table(*arguments)
