"""Generate Gaussian random fields of endless extent, at any place in any order.

A field is the sum of two periodic ones, made once by Fourier transform, whose periods have no common divisor: where one
repeats the other does not. Long-waved fields have wide grids and are drawn finer by cubic B-splines, whose slopes have
no facets.
"""

from __future__ import annotations

import functools
import math
import zlib
from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np
import scipy.fft
import scipy.special
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float32]
Spectrum: TypeAlias = Callable[[NDArray[np.float64]], NDArray[np.float64]]

# Bottom roughness spectra measured for APL-UW TR 9407, Sec. IV: exponents 3.0 to 3.4, 3.25 where nothing is known.
ROUGHNESS_EXPONENT: Final = 3.25
_SPLINE_LIMIT: Final = 0.5
_PADDING_STEP: Final = 66
_WIDEST_STEP: Final = 256
_GAMMA_TABLE_SIZE: Final = 8192
_GAMMA_TABLE_SIGMAS: Final = 5.0


def generator(seed: int, name: str) -> np.random.Generator:
    """Return the random numbers that belong to one named part of a scene."""
    return np.random.Generator(np.random.PCG64([seed, zlib.crc32(name.encode())]))


def power_law(outer_m: float, exponent: float = ROUGHNESS_EXPONENT) -> Spectrum:
    """Return W(K) = (K^2 + K0^2)^(-exponent/2) with K0 = 2 pi / outer_m: APL-UW TR 9407's form with an outer scale."""
    corner = 2.0 * math.pi / outer_m

    def spectrum(wavenumber: NDArray[np.float64]) -> NDArray[np.float64]:
        return (wavenumber**2 + corner**2) ** (-0.5 * exponent)

    return spectrum


def gaussian(length_m: float) -> Spectrum:
    """Return the spectrum of a field whose autocorrelation is exp(-(distance / length_m)^2)."""

    def spectrum(wavenumber: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.exp(-((0.5 * wavenumber * length_m) ** 2))

    return spectrum


def periodic_field(
    random: np.random.Generator, period: int, spacing_m: float, spectrum: Spectrum, splined: bool = False
) -> FloatArray:
    """Shape white noise by `spectrum`, mean 0 and root mean square 1.

    Returns (period, period) float32; the last row continues in the first, and so do columns.

    Parameters
    ----------
    random
        Where the noise comes from.
    period
        Nodes per side.
    spacing_m
        Between nodes.
    spectrum
        Power against wavenumber in rad/m; above the grid's limit pi / spacing_m it is cut.
    splined
        Gives the coefficients of the cubic B-spline through the field instead of the field, and fades from half the
        limit.
    """
    rows = scipy.fft.fftfreq(period, d=1.0 / (2.0 * math.pi))[:, None]
    columns = scipy.fft.rfftfreq(period, d=1.0 / (2.0 * math.pi))[None, :]
    wavenumber = np.hypot(rows, columns) / spacing_m
    power = np.where(wavenumber <= math.pi / spacing_m, spectrum(wavenumber), 0.0)
    power[0, 0] = 0.0
    if splined:
        # Splines through waves near the grid's limit follow the grid's directions rather than the waves'.
        power *= np.exp(-((wavenumber * spacing_m / (_SPLINE_LIMIT * math.pi)) ** 4))
    mirrored = np.full(columns.shape, 2.0)
    mirrored[0, 0] = 1.0
    if period % 2 == 0:
        mirrored[0, -1] = 1.0
    gain = np.sqrt(power / (np.sum(power * mirrored) / period**2))
    if splined:
        gain *= 9.0 / ((2.0 + np.cos(rows)) * (2.0 + np.cos(columns)))
    noise = scipy.fft.rfft2(random.standard_normal((period, period), dtype=np.float32))
    field: FloatArray = scipy.fft.irfft2(noise * gain.astype(np.float32), s=(period, period))
    return field


class Noise:
    """Generate a field of mean 0 and root mean square 1 on nodes every `step` cells."""

    def __init__(
        self,
        seed: int,
        name: str,
        *,
        step: int,
        cell_m: float,
        spectrum: Spectrum,
        periods: tuple[int, int],
        splined: bool = False,
    ) -> None:
        self.step = step
        self._periods = periods
        self._padding = 0
        self._fields = [
            math.sqrt(0.5)
            * periodic_field(generator(seed, f"{name} {period}"), period, step * cell_m, spectrum, splined)
            for period in periods
        ]

    def window(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray:
        """Return the nodes from (row, column) on; both may be negative.

        Returns (n_rows, n_columns) float32, the caller's own.
        """
        if max(n_rows, n_columns) > self._padding:
            # Fields continued past their ends make every window one plain slice.
            self._padding = -(-max(n_rows, n_columns) // _PADDING_STEP) * _PADDING_STEP
            self._fields = [
                np.pad(field[:period, :period], ((0, self._padding), (0, self._padding)), mode="wrap")
                for field, period in zip(self._fields, self._periods, strict=True)
            ]
        (first, second), (p, q) = self._fields, self._periods
        out: FloatArray = np.add(
            first[row % p : row % p + n_rows, column % p : column % p + n_columns],
            second[row % q : row % q + n_rows, column % q : column % q + n_columns],
        )
        return out

    def on_cells(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray:
        """Return the B-spline surface of a splined field on cell nodes from (row, column) on.

        (n_rows, n_columns) float32.
        """
        return refined_window(self.window, self.step, row, column, n_rows, n_columns)


def refined_window(
    coefficients: Callable[[int, int, int, int], FloatArray],
    factor: int,
    row: int,
    column: int,
    n_rows: int,
    n_columns: int,
) -> FloatArray:
    """Apply `refine` to a window that may start anywhere.

    Returns (..., n_rows, n_columns) float32.

    Parameters
    ----------
    coefficients
        Gives those of a window, as `Noise.window` does.
    factor
        Nodes of the result per coefficient.
    row, column, n_rows, n_columns
        The window in nodes of the result.
    """
    first_row, first_column = row // factor, column // factor
    skip_row, skip_column = row - first_row * factor, column - first_column * factor
    rows, columns = skip_row + n_rows, skip_column + n_columns
    window = coefficients(first_row - 1, first_column - 1, -(-rows // factor) + 3, -(-columns // factor) + 3)
    return refine(window, factor, rows, columns)[..., skip_row:, skip_column:]


@functools.cache
def _spline_weights(factor: int) -> FloatArray:
    t = np.arange(factor) / factor
    weights = (
        np.stack([(1.0 - t) ** 3, 3.0 * t**3 - 6.0 * t**2 + 4.0, -3.0 * t**3 + 3.0 * t**2 + 3.0 * t + 1.0, t**3]) / 6.0
    )
    return weights.astype(np.float32)


def refine(coefficients: FloatArray, factor: int, n_rows: int, n_columns: int) -> FloatArray:
    """Draw the cubic B-spline surface of `coefficients` (de Boor, "A Practical Guide to Splines") `factor` times finer.

    Returns (..., n_rows, n_columns) float32. Element (0, 0) lies on coefficient (1, 1). A node's value depends on the
    coefficients around it alone, to the last bit, however the call is cut.

    Parameters
    ----------
    coefficients
        (..., rows, columns) float32.
    factor
        Nodes of the result per coefficient.
    n_rows, n_columns
        Of the result, at most factor * (rows - 3) and factor * (columns - 3).
    """
    weights = _spline_weights(factor)[:, :, None]
    groups = -(-n_columns // factor)
    wide = coefficients[..., None, :groups] * weights[0]
    for tap in range(1, 4):
        wide += coefficients[..., None, tap : tap + groups] * weights[tap]
    across = wide.swapaxes(-1, -2).reshape(*coefficients.shape[:-1], -1)[..., None, :n_columns]
    groups = -(-n_rows // factor)
    out = across[..., :groups, :, :] * weights[0]
    scratch = np.empty_like(out)
    for tap in range(1, 4):
        out += np.multiply(across[..., tap : tap + groups, :, :], weights[tap], out=scratch)
    fine: FloatArray = out.reshape(*coefficients.shape[:-2], -1, n_columns)[..., :n_rows, :]
    return fine


def step_for(length_m: float, cell_m: float) -> int:
    """Return the largest power of two of cells that `length_m` holds, 1 to 256; windows are widened to whole steps."""
    return min(_WIDEST_STEP, 1 << max(0, math.floor(math.log2(length_m / cell_m))))


class GammaLaw:
    """Turn standard normal values into Gamma-distributed ones of mean 1 and variance 1 / shape, keeping their order."""

    def __init__(self, shape: float) -> None:
        normal = np.linspace(-_GAMMA_TABLE_SIGMAS, _GAMMA_TABLE_SIGMAS, _GAMMA_TABLE_SIZE)
        # From the upper tail where it is the small one: 1 - 1e-16 has no digits left.
        values = np.where(
            normal < 0.0,
            scipy.special.gammaincinv(shape, scipy.special.ndtr(normal)),
            scipy.special.gammainccinv(shape, scipy.special.ndtr(-normal)),
        )
        density = np.exp(-0.5 * normal**2)
        self._table = (values / (np.sum(values * density) / np.sum(density))).astype(np.float32)

    def __call__(self, normal: FloatArray) -> FloatArray:
        """Transform float32 values of any shape in place and return them, same shape, float32."""
        per_sigma = (_GAMMA_TABLE_SIZE - 1) / (2.0 * _GAMMA_TABLE_SIGMAS)
        normal *= np.float32(per_sigma)
        normal += np.float32(per_sigma * _GAMMA_TABLE_SIGMAS + 0.5)
        return np.take(self._table, normal.astype(np.intp), mode="clip")
