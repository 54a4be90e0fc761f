"""Measure speckle where the sea floor is most even, without what texture adds to it.

What texture is left makes a region uneven, so only the most even regions count. They are chosen by one half of their
windows and measured by the other half, as a region chosen by the very numbers that are measured would look more even
than it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.ping_windows import STRIDES
from auv_mcm.waterfall.shape import Shape
from auv_mcm.waterfall.texture import speckle_variance

Floats = NDArray[np.float64]

_MIN_REGIONS: Final = 24  # regions that a shape is measured from, minimum: three times _MIN_EVEN
_EVEN_SHARE: Final = 0.1  # about what water column and noise take up, which are even over any sea floor
_LOG_EVEN_SHARE: Final = 0.15  # texture is taken away, and third cumulants of logarithms are the noisier
_MIN_EVEN: Final = 8  # regions that count as even, minimum
_EVEN_LEVEL: Final = 1.05  # of the variance of the most even tenth, below which any other region counts as even, too
# Share trimmed at both ends, of samples over their mean and of logarithms: a fish or a target is in few regions.
# Linear samples have the longer tails.
_RELATIVE_TRIM: Final = 0.1
_LOG_TRIM: Final = 0.03
_N_GROUPS: Final = 8
_SIGMA_PER_MAD: Final = 1.4826  # of a normal distribution
_MAX_GROWTH: Final = 1.12  # of the variance from one stride to the next, beyond which speckle lasts over pings
_STRIDE_TWO: Final = STRIDES.index(2)
# Regions that hold more texture, by which its growth from stride 1 to 2 is measured: up to twice the even level, beyond
# which it is of other kinds.
_UNEVEN_LEVEL: Final = 2.0
_MIN_UNEVEN: Final = 16
# Of ln variance: of all even regions together, whatever their number, and of one half region with 13 samples in range
# of which every second is independent.
_VARIANCE_SIGMA: Final = 0.01
_HALF_REGION_SIGMA: Final = 0.16
_TEXTURE_SKEWNESS_SIGMA: Final = 0.1  # of the skewness, per texture's share of the variance at stride 2


def relative_shape(cumulants: Floats, mean: Floats, place: NDArray[np.int64]) -> Shape | None:
    """Measure samples over their local mean in the most even regions; None where there are too few regions.

    Parameters
    ----------
    cumulants
        (n_strides, n, 2, 2) by half of the windows.
    mean
        (n,) counts.
    place
        (n,).
    """
    if len(mean) < _MIN_REGIONS:
        return None
    scaled = cumulants / np.stack([mean**2, mean**3], axis=-1)[:, None, :]
    shapes = [_shape(_even_values(each[None], each, place)[0]) for each in scaled[_STRIDE_TWO:]]
    for index in range(len(shapes) - 1):
        if shapes[index + 1].std ** 2 < _MAX_GROWTH * shapes[index].std ** 2:
            return shapes[index]
    return shapes[-1]


def log_shape(cumulants: Floats, mean: Floats, place: NDArray[np.int64], *, is_cut: bool) -> Shape | None:
    """Measure the samples themselves in the most even regions, without texture.

    Arguments and result are those of relative_shape, but halves of regions hold alternate cells of range, and is_cut:
    the recorder stores nothing below zero.
    """
    if len(mean) < _MIN_REGIONS:
        return None
    at_two = cumulants[_STRIDE_TWO]
    chosen, level = _even_regions(at_two, _LOG_EVEN_SHARE, _LOG_TRIM)
    values = _in_order(cumulants, chosen, place)
    totals = np.array([_trimmed(each, _LOG_TRIM) for each in values])
    variance_sigma = math.hypot(_VARIANCE_SIGMA, _HALF_REGION_SIGMA / math.sqrt(values.shape[1]))
    speckle = speckle_variance(totals[:, 0], _uneven_variances(cumulants, chosen, level), variance_sigma)
    # Speckle that lasts over pings loses about as much of its third cumulant as of its variance.
    short = slice(0, _STRIDE_TWO + 1)
    share = speckle.variance * speckle.left[_STRIDE_TWO] / totals[_STRIDE_TWO, 0]
    third = totals[short, 1].sum() / speckle.left[short].sum()
    skewness = float(third / speckle.variance**1.5)
    groups = np.array([_group_totals(each) for each in values[short]])
    skewnesses = groups[..., 1].sum(axis=0) / (speckle.left[short].sum() * (share * groups[_STRIDE_TWO, :, 0]) ** 1.5)
    texture = _TEXTURE_SKEWNESS_SIGMA * (1.0 / share - 1.0)
    shape = Shape(
        math.sqrt(speckle.variance),
        skewness,
        0.5 * speckle.log_sigma,
        math.hypot(_error_of_mean(skewnesses), texture * skewness, 1.5 * speckle.log_sigma * skewness),
    )
    if not is_cut:
        return shape
    even = _lowest(at_two[..., 0].mean(axis=1), min(values.shape[1] // 2, len(mean)))
    return shape._replace(mean=float(np.median(mean[even])))


def _even_regions(
    by_half: Floats, share: float, trim: float
) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], float]:
    """Choose the regions that each half of their windows, by_half (n, 2, 2), shows to be even.

    Returns those chosen by either half, increasing, and the variance of the most even share.
    """
    n_even = min(max(round(share * len(by_half)), _MIN_EVEN), len(by_half))
    lowest = [_lowest(by_half[:, half, 0], n_even) for half in range(2)]
    level = float(np.mean([_trimmed(by_half[lowest[half], 1 - half], trim)[0] for half in range(2)]))
    even = [np.flatnonzero(by_half[:, half, 0] <= _EVEN_LEVEL * level) for half in range(2)]
    first, second = (even[half] if len(even[half]) >= n_even else lowest[half] for half in range(2))
    return (first, second), level


def _in_order(cumulants: Floats, chosen: Sequence[NDArray[np.int64]], place: NDArray[np.int64]) -> Floats:
    """Take the halves that did not choose, (n_strides, n_even, 2), in the order of their place."""
    values = np.concatenate([cumulants[:, chosen[half], 1 - half] for half in range(2)], axis=1)
    return values[:, np.argsort(place[np.concatenate(chosen)], kind="stable")]


def _uneven_variances(cumulants: Floats, even: Sequence[NDArray[np.int64]], level: float) -> Floats | None:
    """Measure variances (n_strides,) of regions less even than those chosen; None where there are too few."""
    parts = []
    for half in range(2):
        variance = cumulants[_STRIDE_TWO, :, half, 0]
        is_uneven = (variance > _EVEN_LEVEL * level) & (variance <= _UNEVEN_LEVEL * level)
        is_uneven[even[half]] = False
        parts.append(cumulants[:, is_uneven, 1 - half])
    values = np.concatenate(parts, axis=1)
    if values.shape[1] < _MIN_UNEVEN:
        return None
    return np.array([_trimmed(each, _LOG_TRIM)[0] for each in values])


def _even_values(cumulants: Floats, by_half: Floats, place: NDArray[np.int64]) -> Floats:
    """Pick each half of regions that the other half, by_half (n, 2, 2), shows to be even: (n_strides, n_even, 2)."""
    chosen, _ = _even_regions(by_half, _EVEN_SHARE, _RELATIVE_TRIM)
    return _in_order(cumulants, chosen, place)


def _shape(values: Floats) -> Shape:
    """Join the cumulants of values (n, 2), with sigmas from groups of them."""
    second, third = _trimmed(values, _RELATIVE_TRIM)
    groups = _group_totals(values, _RELATIVE_TRIM)
    return Shape(
        float(np.sqrt(second)),
        float(third / second**1.5),
        0.5 * _error_of_mean(np.log(groups[:, 0])),
        _error_of_mean(groups[:, 1] / groups[:, 0] ** 1.5),
    )


def _group_totals(values: Floats, trim: float = _LOG_TRIM) -> Floats:
    """Take the trimmed means of groups of values (n, 2): (n_groups, 2)."""
    return np.array([_trimmed(group, trim) for group in np.array_split(values, _N_GROUPS)])


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
