"""Measure speckle of single pictures without pings to compare: statistics of short windows along rows, texture
included.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

_WINDOW: Final = 64
_MIN_WINDOWS: Final = 16


class PictureSpeckle(NamedTuple):
    """Hold medians over short windows: skewness, and standard deviation over the mean's magnitude. n_windows: that
    could be used.
    """

    skewness: float
    relative_std: float
    n_windows: int


def picture_speckle(counts: NDArray[np.generic]) -> PictureSpeckle:
    """Measure windows of 64 samples along the rows of a picture (n_rows, n_columns), the linear trend removed.

    The windows with the brighter neighbours are used: choosing by their own mean would favour those that happen to hold
    no deep fade. NaN with too few usable windows.
    """
    start = counts.shape[1] // 8
    n_windows = (counts.shape[1] - start) // _WINDOW
    if n_windows < 2 or not counts.shape[0]:
        return PictureSpeckle(math.nan, math.nan, 0)
    windows = counts[:, start : start + n_windows * _WINDOW].reshape(-1, n_windows, _WINDOW).astype(np.float64)
    means = windows.mean(axis=2)
    before = np.concatenate([means[:, 1:2], means[:, :-1]], axis=1)
    after = np.concatenate([means[:, 1:], means[:, -2:-1]], axis=1)
    brightness = (0.5 * (before + after)).ravel()
    stack = windows.reshape(-1, _WINDOW)
    # A clipped window has no tail left to judge.
    kept = (stack == stack.max(initial=-math.inf)).sum(axis=1) <= 2
    stack, brightness = stack[kept], brightness[kept]
    mean = stack.mean(axis=1, keepdims=True)
    ramp = np.arange(_WINDOW) - (_WINDOW - 1) / 2.0
    residual = stack - mean - ramp * (stack @ ramp / (ramp @ ramp))[:, None]
    std = np.sqrt((residual**2).sum(axis=1) / (_WINDOW - 2))
    # A constant window leaves rounding errors only.
    good = std > 1e-9 * np.abs(stack).max(axis=1, initial=0.0)
    n_good = int(np.count_nonzero(good))
    if n_good < _MIN_WINDOWS:
        return PictureSpeckle(math.nan, math.nan, n_good)
    bright = good & (brightness >= np.median(brightness[good]))
    mean, std, residual = mean[bright, 0], std[bright], residual[bright]
    skewness = ((residual / std[:, None]) ** 3).mean(axis=1)
    relative_std = std / np.maximum(np.abs(mean), 1e-9 * std)
    return PictureSpeckle(float(np.median(skewness)), float(np.median(relative_std)), n_good)
