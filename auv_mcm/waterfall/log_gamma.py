"""Compute how the logarithm of speckle is spread, by looks and by how much of its lower tail a recorder cuts off.

The intensity of L averaged looks, over its mean, has a Gamma distribution of shape L; x, its natural logarithm, the
density L^L / Gamma(L) exp(L (x - e^x)), whose variance is psi'(L) and whose third cumulant psi''(L). Samples that
cannot go below zero hold max(x, c) - c for some cut c.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

LOOKS: Final = np.geomspace(1.0, 32.0, 96)
_MANY_LOOKS: Final = 10.0  # recorders average a few: each look costs resolution
_ONE_LOOK: Final = 0.25  # of all recorders average none
_FEW_LOOKS: Final = np.exp(-((LOOKS / _MANY_LOOKS) ** 2))
LOOKS_PRIOR: Final = (1.0 - _ONE_LOOK) * _FEW_LOOKS / _FEW_LOOKS.sum()
LOOKS_PRIOR[0] += _ONE_LOOK
LOOKS_PRIOR.flags.writeable = False

_STEP_NATS: Final = 0.05  # of the mean above the cut
_N_STEPS: Final = 320  # to 16 nats, where less than 1e-6 is cut off
_X_STEP_NATS: Final = 0.02  # nats: step of the integrals over ln I


def ln_gamma(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute ln Gamma of positive values (n,), few enough for the standard library.

    Scipy.special takes 0.2 s to load.
    """
    return np.array([math.lgamma(value) for value in values.tolist()])


def log_std_and_skewness(mean_nats: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Look up ln of the standard deviation in nats, and skewness, of log speckle: (n, n_looks) each.

    mean_nats: (n,) that its mean lies above the cut, infinite for none.
    """
    variance, third = _cumulants()
    at = np.clip(mean_nats / _STEP_NATS, 0.0, _N_STEPS - 1.001)
    low = at.astype(np.int64)
    part = (at - low)[:, None]
    second_here = (1.0 - part) * variance[low] + part * variance[low + 1]
    third_here = (1.0 - part) * third[low] + part * third[low + 1]
    return 0.5 * np.log(second_here), third_here / second_here**1.5


@functools.cache
def _cumulants() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Tabulate variance and third cumulant (n_steps, n_looks) by mean above the cut and looks."""
    x = np.arange(-18.0, 3.0, _X_STEP_NATS)
    means = np.arange(_N_STEPS) * _STEP_NATS
    variance, third = np.empty((2, _N_STEPS, len(LOOKS)))
    for column, looks in enumerate(LOOKS.tolist()):
        density = np.exp(looks * (x - np.exp(x)) + looks * math.log(looks) - math.lgamma(looks)) * _X_STEP_NATS
        # Moments of what lies above each cut x, then of its excess over the cut.
        s0, s1, s2, s3 = (_from_above(density * x**k) for k in range(4))
        m1 = s1 - x * s0
        m2 = s2 - 2.0 * x * s1 + x**2 * s0
        m3 = s3 - 3.0 * x * s2 + 3.0 * x**2 * s1 - x**3 * s0
        by_mean = m1[::-1]
        variance[:, column] = np.interp(means, by_mean, (m2 - m1**2)[::-1])
        third[:, column] = np.interp(means, by_mean, (m3 - 3.0 * m1 * m2 + 2.0 * m1**3)[::-1])
    return np.maximum(variance, _MIN_VARIANCE), third


_MIN_VARIANCE: Final = 1e-6  # nats squared, where all is cut off


def _from_above(values: NDArray[np.float64]) -> Any:
    return np.cumsum(values[::-1])[::-1]
