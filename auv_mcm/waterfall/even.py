"""Measure speckle where the sea floor is most even, without what texture adds to it.

What texture is left makes a region uneven, so only the most even regions count. They are chosen by one half of their
windows and measured by the other half, as a region chosen by the very numbers that are measured would look more even
than it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.ping_windows import STRIDES, WINDOW_PINGS
from auv_mcm.waterfall.shape import Shape

Floats = NDArray[np.float64]

_MIN_REGIONS: Final = 24
_EVEN_SHARE: Final = 0.1  # about what water column and noise take up, which are even over any sea floor
_LOG_EVEN_SHARE: Final = 0.15  # texture is taken away, and third cumulants of logarithms are the noisier
_MIN_EVEN: Final = 8
_EVEN_LEVEL: Final = 1.05  # of the variance of the most even tenth, below which any other region counts as even, too
# Share trimmed at both ends, of samples over their mean and of logarithms: a fish or a target is in few regions.
# Linear samples have the longer tails.
_RELATIVE_TRIM: Final = 0.1
_LOG_TRIM: Final = 0.03
_N_GROUPS: Final = 8
_SIGMA_PER_MAD: Final = 1.4826  # of a normal distribution
_MAX_GROWTH: Final = 1.12  # of the variance from one stride to the next, beyond which speckle lasts over pings
_STRIDE_TWO: Final = STRIDES.index(2)
_ROUNDS: Final = 3  # of solving for slope and correlation in turn; the third changes the variance by less than 0.5 %
# What cannot be taken away of texture, per share by which the variances of speckle and of both larger strides differ:
# 0.02 over flat floors of single looks, 0.3 of 8 looks, above 1 where ripples leave nothing even.
_TEXTURE_LOG_STD_SIGMA: Final = 0.05
_TEXTURE_SKEWNESS_SIGMA: Final = 0.1  # of the skewness
_MIN_SPECKLE_SHARE: Final = 0.5  # minimum share of the variance at stride 2, whatever the extrapolation gives


def relative_shape(cumulants: Floats, mean: Floats, place: NDArray[np.int64]) -> Shape | None:
    """Measure samples over their local mean in the most even regions; None where there are too few regions.

    cumulants: (n_strides, n, 2, 2) by half of the windows. mean: (n,) counts. place: (n,).
    """
    if len(mean) < _MIN_REGIONS:
        return None
    scaled = cumulants / np.stack([mean**2, mean**3], axis=-1)[:, None, :]
    shapes = [_shape(_even_values(each[None], each, place, _EVEN_SHARE, _RELATIVE_TRIM), _first) for each in scaled[_STRIDE_TWO:]]
    for index in range(len(shapes) - 1):
        if shapes[index + 1].std ** 2 < _MAX_GROWTH * shapes[index].std ** 2:
            return shapes[index]
    return shapes[-1]


def log_shape(cumulants: Floats, mean: Floats, place: NDArray[np.int64], *, is_cut: bool) -> Shape | None:
    """Measure the samples themselves in the most even regions, without texture.

    Arguments and result are those of relative_shape, and is_cut: the recorder stores nothing below zero.
    """
    if len(mean) < _MIN_REGIONS:
        return None
    at_two = cumulants[_STRIDE_TWO]
    values = _even_values(cumulants, at_two, place, _LOG_EVEN_SHARE, _LOG_TRIM)
    shape = _shape(values, _without_texture)
    variances = [shape.std**2, *(float(_trimmed(each, _LOG_TRIM)[0]) for each in values[_STRIDE_TWO:])]
    texture = max(variances) / min(variances) - 1.0
    shape = shape._replace(
        log_std_sigma=math.hypot(shape.log_std_sigma, _TEXTURE_LOG_STD_SIGMA * texture),
        skewness_sigma=math.hypot(shape.skewness_sigma, _TEXTURE_SKEWNESS_SIGMA * texture * abs(shape.skewness)),
    )
    if not is_cut:
        return shape
    even = _lowest(at_two[..., 0].mean(axis=1), min(values.shape[1] // 2, len(mean)))
    return shape._replace(mean=float(np.median(mean[even])))


def _even_values(cumulants: Floats, by_half: Floats, place: NDArray[np.int64], share: float, trim: float) -> Floats:
    """Pick each half of regions that the other half, by_half (n, 2, 2), shows to be even: (n_strides, n_even, 2)."""
    n_even = min(max(round(share * len(place)), _MIN_EVEN), len(place))
    level = np.mean([_trimmed(by_half[_lowest(by_half[:, half, 0], n_even), 1 - half], trim)[0] for half in range(2)])
    chosen, places = [], []
    for half in range(2):
        variance = by_half[:, half, 0]
        even = np.flatnonzero(variance <= _EVEN_LEVEL * level)
        if len(even) < n_even:
            even = _lowest(variance, n_even)
        chosen.append(cumulants[:, even, 1 - half])
        places.append(place[even])
    return np.concatenate(chosen, axis=1)[:, np.argsort(np.concatenate(places), kind="stable")]


def _shape(values: Floats, cumulants_of: Callable[[Floats], tuple[float, float]]) -> Shape:
    """Join the cumulants of values (n_strides, n, 2), with sigmas from groups of them."""
    second, third = cumulants_of(values)
    groups = np.array([cumulants_of(group) for group in np.array_split(values, _N_GROUPS, axis=1)])
    return Shape(
        float(np.sqrt(second)),
        float(third / second**1.5),
        0.5 * _error_of_mean(np.log(groups[:, 0])),
        _error_of_mean(groups[:, 1] / groups[:, 0] ** 1.5),
    )


def _first(values: Floats) -> tuple[float, float]:
    second, third = _trimmed(values[0], _RELATIVE_TRIM)
    return float(second), float(third)


def _without_texture(values: Floats) -> tuple[float, float]:
    """Solve for second and third cumulant of speckle from those of windows of stride 1, 2 and 4, values (3, n, 2).

    Texture adds variance in proportion to the stride, as its covariance first falls off linearly. Speckle that lasts
    over pings, with correlation q^(lag^2), loses variance in windows of short strides. The three strides give speckle,
    slope and q. Texture hardly adds to the third cumulant, which is that of stride 2.
    """
    one, two, four = (_trimmed(each, _LOG_TRIM) for each in values)
    slope = max(0.5 * (four[0] - two[0]), 0.0)
    for _ in range(_ROUNDS):
        ratio = (one[0] - slope) / max(two[0] - 2.0 * slope, 1e-3 * two[0])
        left_two, left_four = (float(np.interp(ratio, _LEFT_ONE_TO_TWO, left)) for left in (_LEFT[1], _LEFT[2]))
        speckle = max((2.0 * two[0] - four[0]) / (2.0 * left_two - left_four), _MIN_SPECKLE_SHARE * two[0])
        slope = max(0.5 * (two[0] - left_two * speckle), 0.0)
    return float(speckle), float(two[1])


# Share of the variance left in windows of each stride, of speckle of correlation q from ping to ping: 1 less the mean
# of q^(lag^2) over the six pairs of a window.
_CORRELATION: Final = np.linspace(0.75, 0.0, 151)
_N_PAIRS: Final = WINDOW_PINGS * (WINDOW_PINGS - 1) / 2
_LAGS: Final = range(1, WINDOW_PINGS)
_LEFT: Final = [1.0 - sum((WINDOW_PINGS - k) * _CORRELATION ** ((k * stride) ** 2) for k in _LAGS) / _N_PAIRS for stride in STRIDES]
_LEFT_ONE_TO_TWO: Final = _LEFT[0] / _LEFT[1]  # grows as q falls


def _lowest(values: Floats, n: int) -> NDArray[np.int64]:
    return np.sort(np.argpartition(values, n - 1)[:n])


def _error_of_mean(groups: Floats) -> float:
    """Estimate 1-sigma of the mean of values of groups, from their median absolute deviation.

    One group may hold a wreck.
    """
    deviation = np.median(np.abs(groups - np.median(groups)))
    return float(_SIGMA_PER_MAD * deviation / np.sqrt(len(groups) - 1))


def _trimmed(values: Floats, trim: float) -> Floats:
    """Take the trimmed mean of each column of (n, 2) values."""
    cut = int(trim * len(values))
    return np.asarray(np.sort(values, axis=0)[cut : len(values) - cut].mean(axis=0))
