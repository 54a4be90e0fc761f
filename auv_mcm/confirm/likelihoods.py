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
    from scipy.special import kve  # late: most regions never need it

    log_ratio = np.linspace(*_TABLE_LOG_RANGE, _TABLE_BINS)
    argument = 2.0 * np.sqrt(looks * nu * np.exp(log_ratio))
    log_bessel = np.log(kve(nu - looks, argument)) - argument
    cost = 0.5 * (looks - nu) * log_ratio - log_bessel - math.log(2.0) + math.lgamma(nu)
    return log_ratio, cost - 0.5 * (looks + nu) * math.log(looks * nu) + looks * math.log(looks)


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
