"""Separate the variance of speckle from that of texture by how it grows with the stride of windows of pings.

Texture adds variance that grows with the distance between the pings of a window; speckle adds the same to all, less
what it loses in short windows where it lasts over pings. By the linearity of variances, windows of stride s hold
V_s = l_s S + T_s, with the speckle's variance S, the share l_s that is left of it, and the texture's variance T_s.

    T_1 / T_2   is measured: places with more texture differ from even ones in both, and not in speckle.
    T_2 / T_4   is taken as a half: covariance first falls off linearly. Places with more texture cannot show it, as
                theirs has other scales: it is from 0.37 to 0.58 in even places, and from 0.45 to 1 in others.
    l_s         is 1 less the mean correlation of the pairs of a window, which for intensity is q^(lag^2).

The three strides give S and q. Both ratios are uncertain, so q has a posterior, and S with it.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.ping_windows import STRIDES, WINDOW_PINGS

Floats = NDArray[np.float64]

# Of the missions that `auv-mcm bench law` calls fitted: over even floors T_1 / T_2 is from 0.26 to 0.56.
_HALF: Final = 0.5
_RATIO_SIGMA: Final = 0.06  # of a ratio, measured or taken
_UNCLEAR_GROWTH: Final = 0.05  # of the variance: what more texture must add for T_1 / T_2 to be measured
_RATIO_LIMITS: Final = (0.2, 1.0)
_MIN_SPECKLE_SHARE: Final = 0.3  # of the variance at stride 2
_ROUNDS: Final = 3  # of texture and its uncertainty in turn; the third changes the variance by less than 0.5 %

_CORRELATION: Final = np.linspace(0.0, 0.85, 86)
# Most sonars' speckle is drawn anew with each ping; the others' correlation may be anything.
_PRIOR: Final = np.where(_CORRELATION == 0.0, 20.0, 1.0)
_LAGS: Final = range(1, WINDOW_PINGS)
_N_PAIRS: Final = WINDOW_PINGS * (WINDOW_PINGS - 1) / 2


def _log_correlation(correlation: Floats) -> Floats:
    """Compute the correlation of logarithms of speckle of two looks from that of its intensities.

    The sum of rho^k (k - 1)! / (k (k + 1)!), over that of rho = 1: Kibble's bivariate Gamma distribution, expanded in
    Laguerre polynomials. Of one look and of eight it differs from this by 0.07 at most.
    """
    k = np.arange(1, 200)
    terms = 1.0 / (k**2 * (k + 1.0))
    return np.asarray((correlation[..., None] ** k) @ terms / terms.sum())


# Share of the variance left in windows of each stride, by correlation.
_LEFT: Final = np.array(
    [
        1.0 - sum((WINDOW_PINGS - k) * _log_correlation(_CORRELATION ** ((k * stride) ** 2)) for k in _LAGS) / _N_PAIRS
        for stride in STRIDES
    ]
)


class SpeckleVariance(NamedTuple):
    """Hold the variance of speckle, 1-sigma of its logarithm, and the share left in windows of each stride."""

    variance: float
    log_sigma: float
    left: Floats


def speckle_variance(even: Floats, uneven: Floats | None, log_sigma: float) -> SpeckleVariance:
    """Solve for the variance of speckle.

    Parameters
    ----------
    even
        (n_strides,) variance of windows in even places.
    uneven
        The same in less even ones, None where there are too few.
    log_sigma
        Of the variances' logarithm.
    """
    ratio = np.array([_first_ratio(even, uneven), _HALF])
    shorter, longer = even[:-1], even[1:]
    # What is left of V_s when its texture, in proportion to that of the next stride, is taken away.
    without = shorter - ratio * longer
    left = _LEFT[:-1] - ratio[:, None] * _LEFT[1:]
    highest = np.min(even[:, None] / _LEFT, axis=0)
    variance = float(even[1])
    for _ in range(_ROUNDS):
        texture = np.maximum(longer - variance, 0.0)
        sigma = np.hypot(log_sigma * longer * np.hypot(1.0, ratio), _RATIO_SIGMA * texture)[:, None]
        weight = np.sum((left / sigma) ** 2, axis=0)
        by_q = np.sum(left * without[:, None] / sigma**2, axis=0) / weight
        by_q = np.clip(by_q, np.minimum(_MIN_SPECKLE_SHARE * even[1], highest), highest)
        misfit = np.sum(((without[:, None] - left * by_q) / sigma) ** 2, axis=0)
        posterior = _PRIOR * np.exp(-0.5 * (misfit - misfit.min()))
        posterior /= posterior.sum()
        log_by_q = np.log(by_q)
        log_variance = float(posterior @ log_by_q)
        variance = float(np.exp(log_variance))
    spread = posterior @ ((log_by_q - log_variance) ** 2 + 1.0 / (weight * by_q**2))
    return SpeckleVariance(variance, float(np.sqrt(spread)), _LEFT @ posterior)


def _first_ratio(even: Floats, uneven: Floats | None) -> float:
    """Measure by how much less texture adds at stride 1 than at stride 2; a half where it adds too little to see it."""
    if uneven is None:
        return _HALF
    added_one, added_two = np.maximum(uneven[:2] - even[:2], 0.0)
    unclear = (_UNCLEAR_GROWTH * even[1]) ** 2
    return float(np.clip((added_one * added_two + _HALF * unclear) / (added_two**2 + unclear), *_RATIO_LIMITS))
