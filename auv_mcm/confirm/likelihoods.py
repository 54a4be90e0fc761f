"""Compute the cost of an intensity under each class: minus the log of its probability density, up to a common term.

Intensities are means over blocks of speckle, Gamma distributed with L looks (L = 1: exponential intensity, Rayleigh
amplitude). A spiky sea floor adds a Gamma texture of shape nu: the K distribution (Jakeman and Pusey 1976), estimated
from the mean and variance of the logarithm (log-cumulants, Nicolas 2002). Left out of every cost is minus the logarithm
of L^L I^(L-1) / Gamma(L), with the looks L of the sea floor.
"""

from __future__ import annotations

import functools
import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float64]

_SPIKY_BELOW_NU: Final = 20.0  # shape above which texture cannot be separated from none
# shape of the K law's texture, minimum: spikier than any sea floor, keeps the law normalisable in the table
_MIN_NU: Final = 0.3
_MAX_LOOKS: Final = 50.0  # looks beyond which speckle no longer matters to a label; bounds the inverse trigamma
_SIGMAS: Final = 3.0  # of the log-variance's scatter: threshold for a texture or more looks
_MORE_LOOKS: Final = 0.25  # of the nominal variance; the nominal looks themselves are measured
_TABLE_BINS: Final = 2048  # entries of the table over the logarithm of intensity; bounds the error of interpolation
_TAIL: Final = 40.0  # natural logarithm of what the integral of a Bessel function may leave out: below float64's 2e-16
_BESSEL_STEPS: Final = 120  # of the trapezoidal rule; half as many are 3e-9 off, a third 5e-6
_TABLE_LOG_RANGE: Final = (math.log(1e-7), math.log(1e7))


class BackgroundLaw(NamedTuple):
    """Describe the sea floor: Gamma with `looks`, times a Gamma texture of shape `nu`; nu is infinite for none."""

    looks: float
    nu: float


def choose_background_law(log_variance: float, nominal_looks: float, n_independent: float) -> BackgroundLaw:
    """Choose the law of a sea floor whose log-intensity has this variance.

    The Gamma law of the nominal looks stands unless the variance differs by more than three times its own scatter: a
    larger one means texture, a smaller one more looks.

    Parameters
    ----------
    nominal_looks
        What speckle alone gives.
    n_independent
        Number of independent samples the variance comes from.
    """
    nominal = trigamma(nominal_looks)
    # Variance of a sample variance: 2 trigamma^2 and the fourth cumulant, the polygamma of order 3, here to 20 % for
    # one look or more.
    scatter = nominal * math.sqrt((2.0 + 2.4 / nominal_looks) / max(n_independent, 1.0))
    excess = log_variance - nominal
    if excess > max(_SIGMAS * scatter, trigamma(_SPIKY_BELOW_NU)):
        return BackgroundLaw(nominal_looks, max(_MIN_NU, inverse_trigamma(excess)))
    if excess < -max(_SIGMAS * scatter, _MORE_LOOKS * nominal):
        return BackgroundLaw(min(_MAX_LOOKS, inverse_trigamma(log_variance)), math.inf)
    return BackgroundLaw(nominal_looks, math.inf)


def background_cost(intensity: Plane, mean: float, law: BackgroundLaw) -> Plane:
    """Compute the cost of intensities (> 0, any shape) under the sea floor's law with this mean (> 0)."""
    if math.isinf(law.nu):
        return gamma_cost(intensity, mean, law.looks)
    log_ratio, cost = k_table(law.looks, law.nu)
    return np.asarray(np.interp(np.log(intensity / mean), log_ratio, cost) + law.looks * math.log(mean))


def gamma_cost(intensity: Plane, mean: float, looks: float) -> Plane:
    """Compute the cost under a Gamma law with the looks of the sea floor.

    L (ln mean + I / mean): shadow, highlight, and sea floor without texture.
    """
    return np.asarray(looks * (intensity / mean + math.log(mean)))


@functools.lru_cache(maxsize=8)
def k_table(looks: float, nu: float) -> tuple[Plane, Plane]:
    """Tabulate the logarithm of intensity over mean, and the cost there, for the K law with mean 1.

    (2048,) float64 each.
    """
    log_ratio = np.linspace(*_TABLE_LOG_RANGE, _TABLE_BINS)
    log_bessel = log_bessel_k(nu - looks, 2.0 * np.sqrt(looks * nu * np.exp(log_ratio)))
    cost = 0.5 * (looks - nu) * log_ratio - log_bessel - math.log(2.0) + math.lgamma(nu)
    return log_ratio, cost - 0.5 * (looks + nu) * math.log(looks * nu) + looks * math.log(looks)


def log_bessel_k(order: float, x: Plane) -> Plane:
    """Compute ln K, of the modified Bessel function of the second kind and this real order, at x > 0, any shape.

    Half the integral of exp(order t - x cosh t) over all t (DLMF 10.32.9) by the trapezoidal rule, which converges
    exponentially here. Against scipy.special.kve, for orders up to 50 and x from 3e-4 to 3e5, it differs by no more
    than 2e-13 and one rounding of ln K.
    """
    order = abs(order)
    peak, at_peak = np.arcsinh(order / x), np.hypot(x, order)
    # Beyond these the integrand is below exp(-40) of its peak: it falls as exp(-at_peak (cosh s - 1)) or faster on the
    # right; on the left no slower than exp(-at_peak (s - 1)), and to less than on the right at the place mirrored at 0.
    right = np.arccosh(1.0 + _TAIL / at_peak)
    left = np.minimum(2.0 * peak + right, 1.0 + _TAIL / at_peak)
    step = (left + right) / _BESSEL_STEPS
    total = np.zeros(np.shape(x))
    for k in range(_BESSEL_STEPS + 1):
        s = k * step - left
        total += np.exp(order * s - 2.0 * x * np.sinh(peak + 0.5 * s) * np.sinh(0.5 * s))
    return np.asarray(np.log(0.5 * step * total) + order * peak - at_peak)


def trigamma(x: float) -> float:
    """Compute the second derivative of ln Gamma at x > 0, to 1e-10.

    Recurrence up to 8, then the asymptotic series (Abramowitz and Stegun 6.4.12).
    """
    total = 0.0
    while x < 8.0:
        total += 1.0 / (x * x)
        x += 1.0
    square = 1.0 / (x * x)
    series = 1.0 / 6.0 - square * (1.0 / 30.0 - square * (1.0 / 42.0 - square * (1.0 / 30.0 - square * 5.0 / 66.0)))
    return total + 1.0 / x + 0.5 * square + square / x * series


def inverse_trigamma(value: float) -> float:
    """Find x > 0 with trigamma(x) = value > 0, by bisection in ln x over 1e-4 to 1e8; the nearer end beyond."""
    low, high = math.log(1e-4), math.log(1e8)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if trigamma(math.exp(middle)) > value else (low, middle)
    return math.exp(0.5 * (low + high))
