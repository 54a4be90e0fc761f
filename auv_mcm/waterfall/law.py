"""Weigh what recorded numbers can be, amplitude, intensity or a logarithm, against what their speckle shows.

Intensity of L averaged looks of speckle has a Gamma distribution about its local mean, its root a Nakagami
distribution, its logarithm a log-Gamma distribution. So each law predicts, as a function of L alone, how standard
deviation and skewness go together:

    amplitude   std / mean 0.52 / sqrt(L) or so, skewness / (std / mean) from 1.2 (L = 1) down to 1
    intensity   std / mean 1 / sqrt(L), skewness / (std / mean) always 2
    logarithm   std 10 / ln 10 sqrt(psi'(L)) dB (5.57 dB for L = 1),
                skewness psi''(L) / psi'(L)^1.5 (-1.14 for L = 1, -0.36 for L = 8)

Besides, the standard deviation follows the mean from range to range unless the samples are logarithms. Bayes' rule
turns this into odds. What logarithms mean in decibels, `decibels` estimates.

Recorders that detect, smooth or decimate in their own way keep to no such law. Each law has therefore a wide part, too,
which grants it other shapes; where only the wide parts are left, the prior decides, which for linear samples is
amplitude.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.waterfall.decibels import estimate_decibels, grid_interval
from auv_mcm.waterfall.log_gamma import LOOKS, LOOKS_PRIOR, ln_gamma, log_std_and_skewness
from auv_mcm.waterfall.shape import Shape
from auv_mcm.waterfall.speckle import Speckle

Law = Literal["amplitude", "intensity", "log"]
LAWS: Final[tuple[Law, ...]] = ("amplitude", "intensity", "log")

_TEXTURE_NATS: Final = 0.1  # of ln intensity, left in the most even regions of simulated floors
# Intensity is rare in records, and the sonars that send it mostly state it. A recorded amplitude of odd statistics
# (an Iver2's) must not pass for it: that sets how rare.
_PRIOR: Final[dict[Law, float]] = {"amplitude": 0.63, "intensity": 0.02, "log": 0.35}
_WIDE_SHARE: Final = 0.02  # of a law's probability, for recorders that follow no law of speckle
# Where the skewness of even regions lies below that of pure speckle (range-correlated samples, trimming, what texture
# is left), and how
# closely the rest follows: medians and spread over the missions that `auv-mcm bench law` calls fitted.
_LOG_SKEWNESS_KEPT: Final = 0.95
_LINEAR_SKEWNESS_SHIFT: Final = 0.03  # of skewness / (std / mean)
_SKEWNESS_SIGMA: Final = 0.045
_RELATIVE_SKEWNESS_SIGMA: Final = 0.15  # of skewness / (std / mean)
_LOG_STD_SIGMA: Final = 0.05


class LawOdds(NamedTuple):
    """Hold the posterior probability of each law in the order of LAWS, and what follows if it is a logarithm.

    db_per_count: posterior median, NaN without usable samples; db_interval: its 5 to 95 % interval. looks_interval: the
    same of the looks of the likeliest law. n_regions: that could be used; 0 where only the prior counts.
    """

    probability: tuple[float, float, float]
    db_per_count: float
    db_interval: tuple[float, float]
    looks_interval: tuple[float, float]
    n_regions: int

    @property
    def likeliest(self) -> Law:
        """Return the most probable law."""
        return LAWS[max(range(len(LAWS)), key=self.probability.__getitem__)]

    def of(self, law: Law) -> float:
        """Give the probability of a law."""
        return self.probability[LAWS.index(law)]


def weigh_laws(speckle: Speckle) -> LawOdds:
    """Compute posterior odds of the laws, given what speckle shows; the prior where it shows nothing."""
    evidence = dict.fromkeys(LAWS, 0.0)
    looks = dict.fromkeys(LAWS, LOOKS_PRIOR)
    if speckle.relative is not None:
        for law in LAWS:
            tight, wide = _relative_likelihood(law, speckle.relative)
            evidence[law] = math.log(_WIDE_SHARE * wide + (1.0 - _WIDE_SHARE) * float(tight.sum()) + 1e-300)
            looks[law] = tight + _WIDE_SHARE / (1.0 - _WIDE_SHARE) * wide * LOOKS_PRIOR + 1e-300
            evidence[law] += _slope_evidence(law, speckle)
    if speckle.negative:
        evidence["amplitude"] += _LOG_NEVER
        evidence["intensity"] += _LOG_NEVER
    score = np.array([evidence[law] + math.log(_PRIOR[law]) for law in LAWS])
    probability = np.exp(score - score.max())
    probability /= probability.sum()
    decibels = estimate_decibels(speckle)
    looks["log"] = decibels.by_looks
    likeliest = LAWS[int(probability.argmax())]
    amplitude, intensity, log = (float(p) for p in probability)
    return LawOdds(
        (amplitude, intensity, log),
        decibels.per_count,
        decibels.interval,
        grid_interval(LOOKS, looks[likeliest]),
        0 if speckle.relative is None and speckle.absolute is None else speckle.n_regions,
    )


_LOG_NEVER: Final = -math.log(1e6)  # negative samples in a linear record are damage


def _relative_likelihood(law: Law, shape: Shape) -> tuple[NDArray[np.float64], float]:
    """Compute the density of (ln(std / mean), skewness) by looks, prior included.

    And that of recorders that follow no law.
    """
    log_cv, skewness = math.log(shape.std), shape.skewness
    cv_sigma = math.hypot(_LOG_STD_SIGMA, shape.log_std_sigma)
    if law == "log":
        # Where zero is does not follow from the law: std over mean may be anything.
        cv_density = _normal((log_cv - math.log(0.07)) / 0.8) / 0.8
        expected = _log_skewness()
        sigma = np.hypot(_SKEWNESS_SIGMA + 0.1 * np.abs(expected), shape.skewness_sigma)
        tight = LOOKS_PRIOR * cv_density * _student((skewness - expected) / sigma) / sigma
        wide = cv_density * _normal((skewness + 0.2) / 0.4) / 0.4
        return tight, float(wide)
    cv, ratio = (_NAKAGAMI_CV, _NAKAGAMI_RATIO) if law == "amplitude" else (_GAMMA_CV, _GAMMA_RATIO)
    expected = (ratio + _LINEAR_SKEWNESS_SHIFT) * shape.std
    sigma = np.hypot(_RELATIVE_SKEWNESS_SIGMA * shape.std, shape.skewness_sigma)
    tight = (
        LOOKS_PRIOR
        * _student((log_cv - np.log(cv)) / cv_sigma)
        / cv_sigma
        * _normal((skewness - expected) / sigma)
        / sigma
    )
    middle = math.log(0.4 if law == "amplitude" else 0.7)
    wide_sigma = math.hypot(1.0 * shape.std, shape.skewness_sigma)
    wide = _normal((log_cv - middle) / 0.4) / 0.4 * _normal((skewness - 1.8 * shape.std) / wide_sigma) / wide_sigma
    return tight, float(wide)


def _slope_evidence(law: Law, speckle: Speckle) -> float:
    if not math.isfinite(speckle.slope_sigma):
        return 0.0
    middle, spread = (0.1, 0.35) if law == "log" else (1.0, 0.25)
    sigma = math.hypot(spread, speckle.slope_sigma)
    return math.log(float(_student((speckle.slope - middle) / sigma)) / sigma)


def _normal(deviate: Any) -> Any:
    return np.exp(-0.5 * np.square(deviate))


def _student(deviate: Any) -> Any:
    """Compute Student's t with four degrees of freedom, unnormalised.

    What a model leaves out shows as a deviate of five, not never.
    """
    return (1.0 + np.square(deviate) / 4.0) ** -2.5


def _nakagami() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute std / mean of amplitude by looks, and its skewness over that."""
    first, third = (np.exp(ln_gamma(LOOKS + 0.5 * k) - ln_gamma(LOOKS)) * LOOKS ** (-0.5 * k) for k in (1, 3))
    variance = 1.0 - first**2
    skewness = (third - 3.0 * first * variance - first**3) / variance**1.5
    cv = np.sqrt(variance) / first
    return np.hypot(cv, 0.5 * _TEXTURE_NATS), skewness / cv


_NAKAGAMI_CV, _NAKAGAMI_RATIO = _nakagami()
_GAMMA_CV: Final = np.hypot(LOOKS**-0.5, _TEXTURE_NATS)
_GAMMA_RATIO: Final = np.full(len(LOOKS), 2.0)


@functools.cache
def _log_skewness() -> NDArray[np.float64]:
    """Compute the skewness of logarithmic samples by looks, with the texture left in even regions."""
    log_std, skewness = (values[0] for values in log_std_and_skewness(np.array([math.inf])))
    return np.asarray(_LOG_SKEWNESS_KEPT * skewness / (1.0 + _TEXTURE_NATS**2 * np.exp(-2.0 * log_std)) ** 1.5)
