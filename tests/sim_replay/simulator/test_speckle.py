"""Speckle against its definition in plain Python, against the laws it must follow, and C against numpy."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.simulator import backend
from sim_replay.simulator.speckle import (
    MAX_ENERGY,
    MAX_TAPS,
    WHITE,
    band_limited_rows,
    gaussian_taps,
    lasting_rows,
    low_pass_taps,
    normal_table,
    row_keys,
    speckle_rows,
    speckle_rows_numpy,
    white_rows,
)

Rows: TypeAlias = Callable[[NDArray[np.float64], NDArray[np.uint64], NDArray[np.float32]], NDArray[np.float32]]

needs_c = pytest.mark.skipif(backend.library() is None, reason=f"no C library: {backend.simulator_library().reason}")


def splitmix(state: int) -> int:
    mixed = (state + 0x9E3779B97F4A7C15) % 2**64
    mixed = (mixed ^ (mixed >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
    mixed = (mixed ^ (mixed >> 27)) * 0x94D049BB133111EB % 2**64
    return mixed ^ (mixed >> 31)


def plain_key(seed: int, stream: int, row: int) -> int:
    return splitmix((splitmix((splitmix(seed) + stream) % 2**64) + row) % 2**64)


def plain_sample(key: int, column: int) -> complex:
    """White sample of unit power."""
    table = normal_table()
    word = (column * 0x9E3779B9 + key) % 2**32
    word = (word ^ word >> 16) * 0x7FEB352D % 2**32
    word = (word + (key >> 32)) % 2**32
    word = (word ^ word >> 15) * 0x846CA68B % 2**32
    word ^= word >> 16
    other = word * 0x9E3779B1 % 2**32
    other ^= other >> 15
    real, imaginary = (float(table[bits % 2048]) + float(table[bits // 2**21]) for bits in (word, other))
    return complex(real, imaginary) / math.sqrt(2.0)


def plain_intensity(
    energy: NDArray[np.float64], keys: NDArray[np.uint64], taps: NDArray[np.float32]
) -> NDArray[np.float64]:
    """The definition: mean over looks of |h * (sqrt(E) w)|^2, the edge bins' energy going on outside."""
    n_rows, n_columns = energy.shape
    half = taps.size // 2
    intensity = np.zeros((n_rows, n_columns))
    for look, row, column in np.ndindex(keys.shape[0], n_rows, n_columns):
        field = 0j
        for t in range(taps.size):
            source = column + t - half
            level = energy[row, min(max(source, 0), n_columns - 1)]
            field += float(taps[t]) * math.sqrt(level) * plain_sample(int(keys[look, row]), source)
        intensity[row, column] += abs(field) ** 2 / keys.shape[0]
    return intensity


def autocorrelation(taps: NDArray[np.float32]) -> NDArray[np.float64]:
    """At lags 0, 1, ..., n_taps - 1."""
    exact = taps.astype(np.float64)
    return np.correlate(exact, exact, "full")[taps.size - 1 :]


def correlation_of_intensity(intensity: NDArray[np.float32], row_lag: int, column_lag: int) -> float:
    n_rows, n_columns = intensity.shape
    excess = intensity.astype(np.float64) - 1.0
    return float((excess[row_lag:, column_lag:] * excess[: n_rows - row_lag, : n_columns - column_lag]).mean())


def highest_correlation(one: NDArray[np.complex64], other: NDArray[np.complex64]) -> float:
    """Largest modulus over all circular lags of the correlation of two white sequences, in its standard deviations."""
    spectrum = np.fft.fft(one) * np.fft.fft(other).conj()
    return float(np.abs(np.fft.ifft(spectrum)).max() / math.sqrt(one.size))


@given(
    energy=st.lists(st.floats(0.0, 1e6), min_size=1, max_size=7),
    seed=st.integers(0, 2**64 - 1),
    first_row=st.integers(-5, 2**40),
    n_looks=st.integers(1, 3),
    width=st.sampled_from([0.0, 0.7, 1.5, 4.0]),
)
@settings(max_examples=30)
def test_rows_follow_the_definition(energy: list[float], seed: int, first_row: int, n_looks: int, width: float) -> None:
    levels = np.array([energy, energy[::-1]])
    keys, taps = row_keys(seed, range(n_looks), first_row, 2), gaussian_taps(width)
    expected = plain_intensity(levels, keys, taps)
    for rows in (speckle_rows, speckle_rows_numpy):
        np.testing.assert_allclose(rows(levels, keys, taps), expected, rtol=1e-4, atol=1e-6 * levels.max())


@given(seed=st.integers(0, 2**64 - 1), stream=st.integers(0, 2**64 - 1), first_row=st.integers(-(2**62), 2**62))
def test_keys_follow_the_definition(seed: int, stream: int, first_row: int) -> None:
    expected = [[plain_key(seed, one, first_row + row) for row in range(3)] for one in (stream, 7)]
    np.testing.assert_array_equal(row_keys(seed, [stream, 7], first_row, 3), np.array(expected, dtype=np.uint64))


def test_field_follows_the_definition() -> None:
    row_taps, column_taps = gaussian_taps(1.0), low_pass_taps(1.5)
    row_half, column_half = row_taps.size // 2, column_taps.size // 2
    field = band_limited_rows(5, 6, -2, 3, 4, row_taps, column_taps)
    for row, column in np.ndindex(3, 4):
        expected = sum(
            float(row_taps[i] * column_taps[j])
            * plain_sample(plain_key(5, 6, -2 + row + i - row_half), column + j - column_half)
            for i, j in np.ndindex(row_taps.size, column_taps.size)
        )
        assert abs(field[row, column] - expected) < 1e-5


def test_lasting_rows_follow_the_definition() -> None:
    signal = np.array([[1.0, 4.0, 0.0, 9.0], [2.0, 0.5, 3.0, 0.0]])
    row_taps, taps, noise = gaussian_taps(1.0), gaussian_taps(0.7), 0.25
    along, across = row_taps.size // 2, taps.size // 2
    intensity = lasting_rows(signal, noise, 5, [(6, 16), (7, 17)], -2, row_taps, taps)
    for row, column in np.ndindex(2, 4):
        expected = 0.0
        for of_echo, of_noise in ((6, 16), (7, 17)):
            field = 0j
            for j in range(taps.size):
                place = column + j
                level = signal[row, min(max(place - across, 0), 3)]
                echo = sum(
                    float(row_taps[i]) * plain_sample(plain_key(5, of_echo, -2 + row + i - along), place)
                    for i in range(row_taps.size)
                )
                hiss = plain_sample(plain_key(5, of_noise, -2 + row), place)
                field += float(taps[j]) * (math.sqrt(level) * echo + math.sqrt(noise) * hiss)
            expected += 0.5 * abs(field) ** 2
        assert intensity[row, column] == pytest.approx(expected, rel=1e-4)


@needs_c
@given(
    n_rows=st.integers(0, 4),
    n_columns=st.integers(0, 5) | st.integers(505, 520) | st.integers(1020, 1030),
    n_looks=st.integers(1, 4),
    width=st.sampled_from([0.0, 0.3, 1.5, 3.3, 20.0, 255.0]),
    seed=st.integers(0, 2**64 - 1),
    exponent=st.integers(-60, 36),
)
@settings(max_examples=60)
def test_c_and_numpy_give_the_same_bytes(
    n_rows: int, n_columns: int, n_looks: int, width: float, seed: int, exponent: int
) -> None:
    energy = np.random.Generator(np.random.PCG64(seed)).random((n_rows, n_columns)) * 10.0**exponent
    keys, taps = row_keys(seed, range(n_looks), 0, n_rows), gaussian_taps(width)
    np.testing.assert_array_equal(speckle_rows(energy, keys, taps), speckle_rows_numpy(energy, keys, taps), strict=True)


def test_intensity_of_all_sums_of_entries_is_exponential() -> None:
    table = normal_table()
    squares = np.sort((table[:, None] + table).ravel() ** 2)
    assert squares[0] > 0.0

    def above(threshold: float, other_squares: NDArray[np.float32]) -> float:
        return 1.0 - float(np.searchsorted(squares, np.float32(2.0 * threshold) - other_squares).mean()) / squares.size

    thinned = squares[8::16]
    for threshold in np.concatenate([np.arange(0.01, 0.2, 0.01), np.arange(0.2, 7.0, 0.2)]):
        assert above(threshold, thinned) == pytest.approx(math.exp(-threshold), abs=1.5e-4)
    for threshold, tolerance in ((2.0, 0.002), (4.0, 0.005), (6.0, 0.01), (8.0, 0.01), (10.0, 0.07), (12.0, 0.22)):
        assert above(threshold, squares) == pytest.approx(math.exp(-threshold), rel=tolerance)


@pytest.mark.parametrize(
    ("row_taps", "column_taps"), [(low_pass_taps(1.25), low_pass_taps(2.0)), (gaussian_taps(3.0), WHITE)]
)
def test_field_correlates_by_its_taps(row_taps: NDArray[np.float32], column_taps: NDArray[np.float32]) -> None:
    field = band_limited_rows(3, 4, 0, 700, 700, row_taps, column_taps)
    power = np.abs(field) ** 2
    assert power.mean() == pytest.approx(1.0, abs=0.02)
    row_rho, column_rho = autocorrelation(row_taps), autocorrelation(column_taps)
    for row_lag, column_lag in np.ndindex(4, 4):
        rho = (row_rho[row_lag] if row_lag < row_rho.size else 0.0) * (
            column_rho[column_lag] if column_lag < column_rho.size else 0.0
        )
        measured = (field[row_lag:, column_lag:] * field[: 700 - row_lag, : 700 - column_lag].conj()).mean()
        assert abs(measured - rho) < 0.015
        assert correlation_of_intensity(power, row_lag, column_lag) == pytest.approx(rho**2, abs=0.04)


def test_rows_streams_and_seeds_share_nothing_at_any_lag() -> None:
    n = 1 << 14
    fields = {
        (seed, stream, row): white_rows(row_keys(seed, [stream], row, 1)[0], n)[0]
        for seed in (0, 1, 2**63)
        for stream in (0, 1, 2)
        for row in (-1, 0, 1, 2**32)
    }
    names = list(fields)
    for index, name in enumerate(names):
        for other in names[:index]:
            # P(modulus > x) = exp(-x^2) per lag: 1e-6 for all lags of all pairs to stay below 5.5
            assert highest_correlation(fields[name], fields[other]) < 5.5, (name, other)


def test_rows_whose_counters_overlap_differ() -> None:
    low = 0x12345678
    shifted = (low + 3 * 0x9E3779B9) % 2**32
    keys = np.array([low + (0xDEADBEEF << 32), shifted + (0x0BADF00D << 32)], dtype=np.uint64)
    one, other = white_rows(keys, 1 << 14)
    assert highest_correlation(one, other) < 5.5


def test_columns_share_nothing_at_any_lag() -> None:
    field = white_rows(row_keys(9, [0], 0, 64)[0], 1 << 13)
    spectrum = np.abs(np.fft.fft(field, axis=1)) ** 2
    correlation = np.abs(np.fft.ifft(spectrum, axis=1)).mean(axis=0)[1:] / math.sqrt(field.shape[1])
    assert correlation.max() < math.sqrt(math.pi) / 2.0 + 6.0 * 0.463 / math.sqrt(
        64
    )  # Rayleigh: mean and deviation over 64 rows


@pytest.mark.parametrize("width", [0.0, 2.0])
def test_level_of_the_energy_only_scales_the_intensity(width: float) -> None:
    keys, taps = row_keys(1, [0], 0, 3), gaussian_taps(width)
    unit = speckle_rows(np.ones((3, 600)), keys, taps)
    for energy in (1e-30, 1e-6, 1e6, 1e30, MAX_ENERGY):
        scaled = speckle_rows(np.full((3, 600), energy), keys, taps).astype(np.float64)
        np.testing.assert_allclose(scaled, unit * energy, rtol=1e-5, atol=1e-6 * energy)


@pytest.mark.parametrize("rows", [speckle_rows, speckle_rows_numpy])
@pytest.mark.parametrize("width", [0.0, 2.0])
@pytest.mark.parametrize("energy", [0.0, 5e-324, 1e-310])
def test_no_energy_gives_no_intensity(rows: Rows, width: float, energy: float) -> None:
    np.testing.assert_array_equal(
        rows(np.full((2, 20), energy), row_keys(1, [0], 0, 2), gaussian_taps(width)), np.zeros((2, 20))
    )


@pytest.mark.parametrize(("n_rows", "n_columns"), [(0, 5), (0, 0), (3, 0), (1, 1), (4, 1)])
def test_degenerate_blocks_keep_their_shape(n_rows: int, n_columns: int) -> None:
    for width in (0.0, 2.0):
        for rows in (speckle_rows, speckle_rows_numpy):
            intensity = rows(np.ones((n_rows, n_columns)), row_keys(1, [0], 0, n_rows), gaussian_taps(width))
            assert intensity.shape == (n_rows, n_columns)
            assert intensity.dtype == np.float32
            assert (intensity > 0.0).all()
        field = band_limited_rows(1, 0, 0, n_rows, n_columns, gaussian_taps(width), gaussian_taps(width))
        assert field.shape == (n_rows, n_columns)
        assert field.dtype == np.complex64


@pytest.mark.parametrize("width", [1.0, 2.0, 3.5, 60.0, 255.0])
def test_gaussian_has_half_its_power_density_half_a_width_out(width: float) -> None:
    taps = gaussian_taps(width).astype(np.float64)
    lags = np.arange(taps.size) - taps.size // 2
    assert (taps**2).sum() == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(taps / taps.max(), 0.5 ** (2.0 * (lags / width) ** 2), rtol=1e-5)
    assert taps[0] == taps[-1] < 0.005 * taps.max()


@pytest.mark.parametrize("resolution", [1.05, 1.25, 2.0, 3.3, 10.0, 100.0])
def test_low_pass_is_down_by_three_decibels_at_the_edge_of_its_band(resolution: float) -> None:
    taps = low_pass_taps(resolution).astype(np.float64)
    lags = np.arange(taps.size) - taps.size // 2
    response_db = [
        20.0 * math.log10(abs((taps * np.cos(2.0 * math.pi * frequency * lags)).sum()) / taps.sum())
        for frequency in (0.25 / resolution, 0.5 / resolution)
    ]
    assert response_db[0] > -0.3
    assert response_db[1] == pytest.approx(-10.0 * math.log10(2.0), abs=0.01)
    assert (taps**2).sum() == pytest.approx(1.0, abs=1e-6)
    if resolution >= 2.0:
        assert 20.0 * math.log10(abs((taps * np.cos(2.0 * math.pi * lags / resolution)).sum()) / taps.sum()) < -30.0


def test_one_sample_per_resolution_cell_or_fewer_are_independent() -> None:
    for taps in (gaussian_taps(0.0), low_pass_taps(1.0), low_pass_taps(0.5)):
        np.testing.assert_array_equal(taps, [1.0])


@pytest.mark.parametrize(
    ("energy", "n_key_rows", "taps", "message"),
    [
        (np.ones(3), 1, WHITE, "shape"),
        (np.ones((2, 3)), 1, WHITE, "keys"),
        (np.full((1, 3), np.nan), 1, WHITE, "energy must be from 0"),
        (np.full((1, 3), -1.0), 1, WHITE, "energy must be from 0"),
        (np.full((1, 3), np.inf), 1, WHITE, "energy must be from 0"),
        (np.ones((1, 3)), 1, np.full(2, math.sqrt(0.5), dtype=np.float32), "odd"),
        (np.ones((1, 3)), 1, np.full(MAX_TAPS + 2, (MAX_TAPS + 2) ** -0.5, dtype=np.float32), "at most"),
        (np.ones((1, 3)), 1, np.full(3, 0.5, dtype=np.float32), "add up to"),
        (np.ones((1, 3)), 1, np.full(3, np.nan, dtype=np.float32), "add up to"),
    ],
)
def test_senseless_rows_are_refused(
    energy: NDArray[np.float64], n_key_rows: int, taps: NDArray[np.float32], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        speckle_rows(energy, row_keys(0, [0], 0, n_key_rows), taps)


def test_rows_without_a_look_or_with_signed_keys_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one look"):
        speckle_rows(np.ones((1, 3)), row_keys(0, [], 0, 1))
    with pytest.raises(ValueError, match="uint64"):
        speckle_rows(np.ones((1, 3)), row_keys(0, [0], 0, 1).astype(np.int64))


@pytest.mark.parametrize(("seed", "stream"), [(-1, 0), (2**64, 0), (0, -1), (0, 2**64)])
def test_seeds_and_streams_beyond_64_bits_are_refused(seed: int, stream: int) -> None:
    with pytest.raises(ValueError, match=r"from 0 to 2\^64"):
        row_keys(seed, [stream], 0, 1)


@pytest.mark.parametrize("size", [-1.0, math.nan, 1e4])
def test_senseless_widths_are_refused(size: float) -> None:
    with pytest.raises(ValueError, match="width is"):
        gaussian_taps(size)
    with pytest.raises(ValueError, match="resolution is"):
        low_pass_taps(size)
