from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.simulator.fields import (
    GammaLaw,
    Noise,
    gaussian,
    generator,
    periodic_field,
    power_law,
    refine,
    step_for,
)

CELL_M = 0.05
GRAIN = Noise(1, "grain", step=1, cell_m=CELL_M, spectrum=power_law(1.0), periods=(180, 203))
FORMS = Noise(1, "forms", step=8, cell_m=CELL_M, spectrum=gaussian(2.0), periods=(100, 121), splined=True)


def radial_spectrum(field: NDArray[np.float32], spacing_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean power in rings of wavenumber, rad/m: one ring per harmonic of the field's length."""
    size = len(field)
    power = np.abs(np.fft.fft2(field.astype(np.float64))) ** 2
    harmonic = np.hypot(*np.meshgrid(np.fft.fftfreq(size, 1.0 / size), np.fft.fftfreq(size, 1.0 / size)))
    ring = np.rint(harmonic).astype(int)
    mean: NDArray[np.float64] = np.bincount(ring.ravel(), power.ravel()) / np.bincount(ring.ravel())
    kept = np.arange(4, size // 2 - 2)
    return (kept * (2.0 * math.pi / (size * spacing_m))).astype(np.float64), mean[kept]


def test_spectrum_has_the_exponent_asked_above_the_outer_scale() -> None:
    field = periodic_field(generator(3, "slope"), 512, CELL_M, power_law(5.0, 3.25))
    wavenumber, power = radial_spectrum(field, CELL_M)
    steep = wavenumber > 4.0 * 2.0 * math.pi / 5.0
    slope = np.polyfit(np.log(wavenumber[steep]), np.log(power[steep]), 1)[0]
    assert slope == pytest.approx(-3.25, abs=0.08)


def test_spectrum_is_level_below_the_outer_scale() -> None:
    field = periodic_field(generator(4, "level"), 512, CELL_M, power_law(0.5, 3.25))
    wavenumber, power = radial_spectrum(field, CELL_M)
    level = wavenumber < 0.3 * 2.0 * math.pi / 0.5
    assert np.polyfit(np.log(wavenumber[level]), np.log(power[level]), 1)[0] == pytest.approx(0.0, abs=0.3)


@pytest.mark.parametrize("period", [125, 128])
def test_field_has_mean_0_and_unit_rms_and_closes_on_itself(period: int) -> None:
    fields = [periodic_field(generator(seed, "rms"), period, 1.0, power_law(8.0)) for seed in range(12)]
    assert np.mean([np.mean(field) for field in fields]) == pytest.approx(0.0, abs=1e-5)
    assert np.mean([np.mean(field**2) for field in fields]) == pytest.approx(1.0, rel=0.05)
    step = np.abs(np.diff(fields[0], axis=0)).max()
    assert np.abs(fields[0][0] - fields[0][-1]).max() <= step


def test_gaussian_field_decorrelates_over_its_length() -> None:
    field = periodic_field(generator(5, "length"), 512, 0.25, gaussian(2.0)).astype(np.float64)
    for lag_m in (1.0, 2.0, 3.0):
        correlation = np.mean(field * np.roll(field, int(lag_m / 0.25), axis=0)) / np.mean(field**2)
        assert correlation == pytest.approx(math.exp(-((lag_m / 2.0) ** 2)), abs=0.05)


def test_seed_and_name_make_fields_what_they_are() -> None:
    first, again = (periodic_field(generator(1, "a"), 64, 1.0, power_law(8.0)) for _ in range(2))
    assert first.tobytes() == again.tobytes()
    for seed, name in ((2, "a"), (1, "b")):
        other = periodic_field(generator(seed, name), 64, 1.0, power_law(8.0))
        assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.5


@settings(max_examples=40, deadline=None)
@given(st.integers(-5000, 5000), st.integers(-5000, 5000), st.integers(1, 40), st.integers(1, 40))
def test_window_is_part_of_any_window_around_it(row: int, column: int, n_rows: int, n_columns: int) -> None:
    part = GRAIN.window(row, column, n_rows, n_columns)
    around = GRAIN.window(row - 3, column - 7, n_rows + 300, n_columns + 9)
    assert part.tobytes() == np.ascontiguousarray(around[3 : 3 + n_rows, 7 : 7 + n_columns]).tobytes()


def test_noise_repeats_only_where_both_periods_end() -> None:
    here = GRAIN.window(-5, 11, 20, 20)
    np.testing.assert_array_equal(GRAIN.window(-5 + 180 * 203, 11 - 180 * 203, 20, 20), here)
    for period in (180, 203):
        assert not np.allclose(GRAIN.window(-5 + period, 11, 20, 20), here, atol=0.1)


def test_noise_of_two_fields_has_unit_rms() -> None:
    noise = Noise(1, "rms", step=1, cell_m=CELL_M, spectrum=power_law(0.3), periods=(180, 203))
    assert np.sqrt(np.mean(noise.window(0, 0, 600, 600) ** 2)) == pytest.approx(1.0, rel=0.04)


def basis_spline(t: float) -> float:
    """The cubic B-spline on knots -2..2, by its definition as a sum of truncated cubes."""
    return math.fsum((-1) ** k * math.comb(4, k) * max(0.0, t + 2.0 - k) ** 3 for k in range(5)) / 6.0


@settings(max_examples=30, deadline=None)
@given(st.sampled_from([1, 2, 4, 8]), st.integers(0, 2**32 - 1), st.integers(1, 17), st.integers(1, 17))
def test_refining_sums_basis_splines(factor: int, seed: int, n_rows: int, n_columns: int) -> None:
    shape = -(-n_rows // factor) + 3, -(-n_columns // factor) + 3
    coefficients = generator(seed, "coefficients").standard_normal(shape, dtype=np.float32)
    down = np.array([[basis_spline(i / factor + 1.0 - k) for k in range(shape[0])] for i in range(n_rows)])
    right = np.array([[basis_spline(j / factor + 1.0 - k) for k in range(shape[1])] for j in range(n_columns)])
    np.testing.assert_allclose(
        refine(coefficients, factor, n_rows, n_columns), down @ coefficients @ right.T, atol=2e-6
    )


def test_splined_noise_keeps_unit_rms_and_smooth_slopes_between_its_nodes() -> None:
    surface = FORMS.on_cells(0, 0, 800, 800).astype(np.float64)
    assert np.sqrt(np.mean(surface**2)) == pytest.approx(1.0, rel=0.12)
    bend = np.abs(np.diff(surface, n=2, axis=0))
    on_nodes = bend[7::8].mean()
    assert on_nodes == pytest.approx(bend[3::8].mean(), rel=0.25)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(-3000, 3000),
    st.integers(-3000, 3000),
    st.integers(1, 60),
    st.integers(1, 60),
    st.integers(0, 20),
    st.integers(0, 20),
)
def test_splined_window_is_part_of_any_window_around_it(
    row: int, column: int, n_rows: int, n_columns: int, up: int, left: int
) -> None:
    part = FORMS.on_cells(row, column, n_rows, n_columns)
    around = FORMS.on_cells(row - up, column - left, n_rows + up + 5, n_columns + left + 3)
    assert (
        np.ascontiguousarray(part).tobytes()
        == np.ascontiguousarray(around[up : up + n_rows, left : left + n_columns]).tobytes()
    )


@pytest.mark.parametrize(("length_m", "step"), [(0.01, 1), (0.05, 1), (0.39, 4), (0.41, 8), (100.0, 256)])
def test_step_is_a_power_of_two_of_cells(length_m: float, step: int) -> None:
    assert step_for(length_m, CELL_M) == step


@pytest.mark.parametrize("shape", [0.5, 1.5, 4.0, 25.0])
def test_gamma_law_has_the_moments_of_its_shape_and_keeps_order(shape: float) -> None:
    normal = generator(8, "normal").standard_normal(400_000, dtype=np.float32)
    values = GammaLaw(shape)(normal.copy()).astype(np.float64)
    assert values.mean() == pytest.approx(1.0, rel=0.01)
    assert values.var() == pytest.approx(1.0 / shape, rel=0.03)
    assert np.mean((values - 1.0) ** 3) == pytest.approx(2.0 / shape**2, rel=0.15)
    assert np.all(np.diff(values[np.argsort(normal)]) >= 0.0)


def test_gamma_law_takes_normal_values_beyond_its_table() -> None:
    low, high = GammaLaw(2.0)(np.array([-9.0, 9.0], dtype=np.float32))
    assert 0.0 <= low < high < 20.0
