"""Estimate decibels per count of a logarithmic recorder, and the looks that it averages, from the shape of its speckle.

Skewness gives the looks, looks the standard deviation in decibels, and that the decibels per count. A prior joins them:
what 8 bits usually span, or how much a record usually spans.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import NAN
from auv_mcm.waterfall.log_gamma import LOOKS, LOOKS_PRIOR, log_std_and_skewness
from auv_mcm.waterfall.shape import Shape
from auv_mcm.waterfall.speckle import Speckle

_DB_PER_NAT: Final = 10.0 / math.log(10.0)
# 8 bits span from 50 to 130 dB, and no span within that is likelier than another: what recorders document is spread
# over
# all of it, and a narrower prior makes 0.2 dB per count of 4 to 8 looks over rippled or patchy floors a third too many.
USUAL_DB_PER_COUNT: Final = 0.32
_LEVEL_NATS: Final = 0.46
_BEYOND_SIGMA: Final = 0.15  # nats
# Between the 1st and 99th percentile of a record, water column included; other sample formats.
_USUAL_SPAN_DB: Final = 45.0
_SPAN_SIGMA: Final = 0.5  # nats
_EIGHT_BITS: Final = 255.0
_DB_GRID_NATS: Final = np.linspace(-2.0, 2.0, 161)  # about the prior's middle
# Logarithmic recorders that smooth or decimate what they have logged: their skewness does not give the looks.
_UNLAWFUL_SHARE: Final = 0.12
_UNLAWFUL_SKEWNESS: Final = -0.05
_UNLAWFUL_SIGMA: Final = 0.12
_UNLAWFUL_LOG_STD_SIGMA: Final = 0.05
_INTERVAL: Final = (0.05, 0.95)


class _Model(NamedTuple):
    """Model how shapes follow the law: share of skewness that is found, 1-sigma of ln std and of relative skewness."""

    skewness_kept: float
    log_std_sigma: float
    skewness_sigma: float


# From shapes of the missions that `auv-mcm bench law` calls fitted, by which each differs from that of its looks: even
# regions by +-2 % (std) and -4 +- 5 % (skewness), quiet cells by no more than their own scatter; twice that for echoes
# of the surface and others among the noise.
_EVEN: Final = _Model(0.96, 0.02, 0.045)
_QUIET: Final = _Model(1.0, 0.025, 0.05)
# Of even regions to quiet cells, which lose a tenth where 5 % of their samples are cut off.
_MAX_STD_RATIO: Final = 1.12


class Decibels(NamedTuple):
    """Hold what is known of decibels per count and looks.

    per_count: posterior median, interval: 5 to 95 %, NaN where nothing can be used. by_looks: posterior, on LOOKS.
    """

    per_count: float
    interval: tuple[float, float]
    by_looks: NDArray[np.float64]


def estimate_decibels(speckle: Speckle) -> Decibels:
    """Estimate decibels per count and looks, if the samples are logarithms."""
    even = () if speckle.absolute is None else (speckle.absolute,)
    # The sea floor and noise have the same speckle: what is much more spread than noise has texture left.
    if even and speckle.quiet and even[0].std > _MAX_STD_RATIO * max(shape.std for shape in speckle.quiet):
        even = ()
    if not even and not speckle.quiet:
        return Decibels(NAN, (NAN, NAN), LOOKS_PRIOR)
    if 1.0 < speckle.highest <= _EIGHT_BITS and not speckle.negative:
        middle, level, spread = math.log(USUAL_DB_PER_COUNT), _LEVEL_NATS, _BEYOND_SIGMA
    else:
        middle, level, spread = math.log(_USUAL_SPAN_DB / max(speckle.span_counts, 1e-6)), 0.0, _SPAN_SIGMA
    log_db = middle + _DB_GRID_NATS
    # Rows are decibels per count, columns looks.
    lawful = unlawful = np.zeros((len(log_db), len(LOOKS)))
    for shapes, model in ((even, _EVEN), (speckle.quiet, _QUIET)):
        for shape in shapes:
            as_law, as_none = _log_likelihoods(shape, log_db, model, len(shapes))
            lawful, unlawful = lawful + as_law, unlawful + as_none
    best = max(lawful.max(), unlawful.max())
    likelihood = (1.0 - _UNLAWFUL_SHARE) * np.exp(lawful - best) + _UNLAWFUL_SHARE * np.exp(unlawful - best)
    beyond = np.maximum(np.abs(log_db - middle) - level, 0.0)
    posterior = likelihood * np.exp(-0.5 * (beyond / spread) ** 2)[:, None] * LOOKS_PRIOR
    by_db = posterior.sum(axis=1)
    if not by_db.sum() > 0.0:
        return Decibels(NAN, (NAN, NAN), LOOKS_PRIOR)
    db = np.exp(log_db)
    return Decibels(grid_quantile(db, by_db, 0.5), grid_interval(db, by_db), posterior.sum(axis=0))


def grid_interval(grid: NDArray[np.float64], weight: NDArray[np.float64]) -> tuple[float, float]:
    """Take the 5 to 95 % interval of weights on an increasing grid of positive values."""
    low, high = (grid_quantile(grid, weight, probability) for probability in _INTERVAL)
    return low, high


def grid_quantile(grid: NDArray[np.float64], weight: NDArray[np.float64], probability: float) -> float:
    """Take a quantile of weights on an increasing grid of positive values, between its points by their logarithm."""
    cumulative = np.cumsum(weight) - 0.5 * weight
    return float(np.exp(np.interp(probability * weight.sum(), cumulative, np.log(grid))))


def _log_likelihoods(
    shape: Shape, log_db: NDArray[np.float64], model: _Model, n_shapes: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rate a shape by decibels per count and looks, ln likelihood: of a lawful recorder, and of one that smooths.

    What is off in one of n_shapes of a kind may be off in all of them.
    """
    log_std, skewness = log_std_and_skewness(shape.mean * np.exp(log_db) / _DB_PER_NAT)
    residual = math.log(shape.std / _DB_PER_NAT) + log_db[:, None] - log_std
    shared = math.sqrt(n_shapes)
    std_sigma = math.hypot(model.log_std_sigma * shared, shape.log_std_sigma)
    sigma = np.hypot(model.skewness_sigma * shared * np.abs(skewness), shape.skewness_sigma)
    lawful = _log_student(residual, std_sigma) + _log_student(shape.skewness - model.skewness_kept * skewness, sigma)
    std_sigma = math.hypot(_UNLAWFUL_LOG_STD_SIGMA * shared, shape.log_std_sigma)
    unlawful_sigma = math.hypot(_UNLAWFUL_SIGMA * shared, shape.skewness_sigma)
    unlawful = _log_student(residual, std_sigma) + _log_student(shape.skewness - _UNLAWFUL_SKEWNESS, unlawful_sigma)
    return lawful, unlawful


def _log_student(residual: Any, sigma: Any) -> Any:
    """Compute Student's t with four degrees of freedom, ln.

    What a model leaves out shows as a deviate of five, not never.
    """
    return -2.5 * np.log1p(np.square(residual / sigma) / 4.0) - np.log(sigma)
