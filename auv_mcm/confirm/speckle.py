"""Measure how far speckle is correlated from pixel to pixel, and average blocks of pixels that are independent again.

An image sampled finer than its resolution shows each speckle grain in several pixels. A likelihood that takes them for
independent counts every grain several times over, more than any smoothness prior can outweigh.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.speckle import half_differences, half_differences_in

Plane = NDArray[np.float64]

_NEAR_LAGS: Final = range(1, 5)  # pixels; grains of well processed images are 1 to 4 pixels
_PLATEAU_LAGS: Final = range(7, 10)
_NO_CORRELATION: Final = 0.05  # of the variance: less is the scatter of the estimate
_MIN_PAIRS: Final = 200  # of pixels for an estimate at one lag: 7 % of error for independent pairs
_CLIP: Final = 5.0  # times the mean: one speckle in 150 is brighter; bright texture would outweigh all grains
_LARGEST_BLOCK_M: Final = 0.25  # blocks must stay small against the shadow of the smallest mine
_PARTS: Final = 3  # of a region along each axis
_MOSTLY_USABLE: Final = 0.5  # share of a box that has to be measured; chosen, not measured
_UNCORRELATED: Final = 1.15  # pixels; measurement scatter about 1


class Correlation(NamedTuple):
    """Hold the length of one speckle grain along each axis, pixels, 1 or more: the correlation summed over all lags."""

    rows: float
    columns: float

    @property
    def spread_rows(self) -> float:
        """Compute 1-sigma of the Gaussian point-spread function of intensity along rows, pixels.

        0 without correlation.
        """
        return _spread(self.rows)

    @property
    def spread_columns(self) -> float:
        """Compute the same as spread_rows, along columns."""
        return _spread(self.columns)


def measure_correlation(intensity: Plane, background: NDArray[np.bool_]) -> Correlation:
    """Measure the grain size of the sea floor's speckle.

    From half the mean squared difference at each lag over that at lags no grain spans: what varies slowly (texture, a
    gradient) differs little over one grain and so hardly counts as correlation. Too few pairs count as uncorrelated.

    Parameters
    ----------
    intensity
        (n_rows, n_columns) float64, mean about 1.
    background
        Same shape bool, pixels to use; pairs with another pixel are left out.
    """
    halves = half_differences(np.minimum(intensity, _CLIP), background, (*_NEAR_LAGS, *_PLATEAU_LAGS), _MIN_PAIRS)
    return Correlation(*(_grain(along) for along in halves.tolist()))


def grain_area(intensity: Plane, usable: NDArray[np.bool_]) -> float:
    """Measure the pixels that one grain of speckle covers, 1 or more, where the sea floor is least correlated.

    Ripples and objects are correlated too: the second lowest of nine parts is taken, since grains are what all of them
    have in common. 1 where nothing can be measured.

    Parameters
    ----------
    intensity, usable
        (n_rows, n_columns), float64 with mean about 1 and bool.
    """
    rows, columns = (np.linspace(0, size, _PARTS + 1).astype(int).tolist() for size in intensity.shape)
    boxes = [
        (top, near, bottom, far)
        for top, bottom in pairwise(rows)
        for near, far in pairwise(columns)
        if np.count_nonzero(usable[top:bottom, near:far]) > _MOSTLY_USABLE * ((bottom - top) * (far - near))
    ]
    if not boxes:
        return 1.0
    halves = half_differences_in(np.minimum(intensity, _CLIP), usable, boxes, (*_NEAR_LAGS, *_PLATEAU_LAGS), _MIN_PAIRS)
    areas = sorted(math.prod(_grain(along) for along in part) for part in halves.tolist())
    return areas[min(1, len(areas) - 1)]


def nyquist_factors(correlation: Correlation, row_spacing_m: float, column_spacing_m: float) -> tuple[int, int]:
    """Choose rows and columns of a block that holds about one grain, but is no longer than a quarter of a metre."""
    rows, columns = (
        max(1, min(round(length), int(_LARGEST_BLOCK_M / spacing_m)))
        for length, spacing_m in zip(correlation, (row_spacing_m, column_spacing_m), strict=True)
    )
    return rows, columns


def block_means(plane: Plane, usable: NDArray[np.bool_], factors: tuple[int, int]) -> tuple[Plane, Plane]:
    """Average the usable pixels of each block, 1 where there are none; give the fraction of a whole block they are.

    Returns two (ceil(n_rows / factors[0]), ceil(n_columns / factors[1])) float64; the last blocks may reach over the
    edge.

    Parameters
    ----------
    plane, usable
        (n_rows, n_columns).
    """
    number = _block_sums(usable.astype(np.float64), factors)
    total = _block_sums(np.where(usable, plane, 0.0), factors)
    return np.where(number > 0.0, total / np.maximum(number, 1.0), 1.0), number / math.prod(factors)


def _block_sums(plane: Plane, factors: tuple[int, int]) -> Plane:
    n_rows, n_columns = plane.shape
    high, wide = (-(-size // factor) for size, factor in zip(plane.shape, factors, strict=True))
    padded = np.zeros((high * factors[0], wide * factors[1]))
    padded[:n_rows, :n_columns] = plane
    return np.asarray(padded.reshape(high, factors[0], wide, factors[1]).sum(axis=(1, 3)), dtype=np.float64)


def looks_of_blocks(correlation: Correlation, factors: tuple[int, int]) -> float:
    """Compute the looks of the mean over a block of single-look pixels.

    One over its variance, for a Gaussian point-spread function.

    Goodman, Speckle Phenomena in Optics, sec. 4.6: the correlation of intensity is exp(-lag^2 / (4 spread^2)) for a
    spread of the intensity's point-spread function.
    """
    variance = 1.0
    for factor, spread in zip(factors, (correlation.spread_rows, correlation.spread_columns), strict=True):
        lag = np.subtract.outer(np.arange(factor), np.arange(factor)).astype(np.float64)
        shared = np.exp(-0.25 * (lag / spread) ** 2) if spread > 0.0 else np.equal(lag, 0.0)
        variance *= float(shared.mean())
    return 1.0 / variance


def _spread(length: float) -> float:
    # The correlation exp(-lag^2 / (4 s^2)) sums to 2 s sqrt(pi) over all lags.
    return length / (2.0 * math.sqrt(math.pi)) if length > _UNCORRELATED else 0.0


def _grain(halves: list[float]) -> float:
    """Compute the grain from half the mean squared differences at _NEAR_LAGS and _PLATEAU_LAGS, NaN where not known."""
    plateau = [half for half in halves[len(_NEAR_LAGS) :] if not math.isnan(half)]
    if not plateau or max(plateau) <= 0.0:
        return 1.0
    far = sum(plateau) / len(plateau)
    length = 1.0
    for near in halves[: len(_NEAR_LAGS)]:
        if math.isnan(near) or 1.0 - near / far < _NO_CORRELATION:
            break
        length += 2.0 * (1.0 - near / far)
    return length
