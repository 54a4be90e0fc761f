"""Read recorded numbers as intensity, whatever the recorder stores: a power of the echo, or a logarithm of it.

Amplitude, intensity, any root of them and a logarithm of any decibels per count are one picture, but for one factor and
one offset of the logarithm. Two questions are left:

Linear or logarithmic. Linear samples are skewed upwards and spread in proportion to their mean; logarithms are skewed
downwards and spread alike at any level. A logistic regression on skewness, relative spread and growth of the spread
answers, without any law of pure speckle.

The factor. Linear samples are amplitudes, unless the spread is more than single-look amplitude can have (then they are
compressed to it: intensity) or the skewness is less than any amplitude has (a root). Logarithms are scaled so that the
floor is spread as speckle of their skewness is. Errors compress the picture rather than stretch it: stretched speckle
costs detections and makes false alarms, compressed speckle hardly does.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from auv_mcm.records import Transfer, TransferKind
from auv_mcm.waterfall.floor_speckle import FloorSpeckle

# Logistic regression, fitted to 700 drawn recorders: correlation of 1 to 5 samples, gamma and log-normal texture, 1 to
# 8 looks, smoothing and decimation by up to 3. Of 700 none is on the wrong side.
_OFFSET: Final = -5.25
_PER_SKEWNESS: Final = 15.3  # of relative skewness
_PER_SPREAD_NAT: Final = 5.65  # of ln(relative spread / 0.1)
_USUAL_SPREAD: Final = 0.1
_PER_GROWTH: Final = 11.0  # of growth over 0.5, weighed by the levels' spread in nats, 1 at the maximum
_GROWTHS: Final = (-0.5, 1.5)  # what growth is bounded to: it is noisy where levels hardly differ
SURE_NATS: Final = math.log(100.0)
"""Odds of 100 to 1, in nats, below which the law is open and linear amplitude is taken."""
_NEGATIVE_NATS: Final = 14.0  # odds of a million to 1: negative samples of a linear recorder are damage. Chosen

# Relative spread of single-look amplitude, 0.52 by Rayleigh's distribution, with the texture that even regions keep:
# nine in ten drawn amplitudes lie below it.
_SINGLE_LOOK_SPREAD: Final = 0.6
# The shape of Weibull's distribution, which powers of single-look speckle have, follows its relative spread by this
# exponent within 3 % between a spread of 0.3 and 1.3.
_WEIBULL_EXPONENT: Final = 1.08
# Skewness over relative spread from which samples are no root of amplitude: 0.91 at a spread of 0.19 (eight looks),
# 1.07 from 0.38 on. Drawn amplitudes without smoothing stay above; the power 0.7 of single looks is at 0.6 to 1.0.
_ROOT_RATIO: Final = (0.75, 0.85, 1.07)  # at no spread, per spread, maximum
_ROOT_SLOPE: Final = 3.0  # of the exponent against that ratio. Chosen: from no root to the power 0.7 within a tenth
_LOWEST_EXPONENT: Final = 0.7  # of stored amplitude. Chosen: lower roots are read too flat

# Spread in decibels of logarithmic speckle by its skewness, from drawn recorders: hypot(2, 5.4 skewness), within a
# third for nine in ten. Pure speckle of a single look has 5.57 dB at -1.14, that of four looks 2.3 dB at -0.53, which
# this takes for 3.5: texture and smoothing look alike.
_SMOOTH_DB: Final = 2.0
_DB_PER_SKEWNESS: Final = 5.4
_SINGLE_LOOK_DB: Final = 5.8  # maximum; 5.57 dB with the texture of even regions
_SPREAD_SIGMAS: Final = (0.08, 0.35)  # nats that this is off by at the skewness of a single look and at none
_SINGLE_LOOK_SKEWNESS: Final = 0.95  # as found in even regions, less than the 1.14 of pure speckle
USUAL_DB_PER_COUNT: Final = 0.3
"""Decibels per count of an 8-bit logarithm: 8 bits span 50 to 130 dB."""
_USUAL_SIGMA: Final = 0.3  # nats of that
_USUAL_SPAN_DB: Final = 45.0  # from the 1st to the 99th percentile of a record; other sample formats
_SPAN_SIGMA: Final = 0.5  # nats of that


class SampleLaw(NamedTuple):
    """State what samples are taken for.

    transfer: how they become intensity. linear_nats: log-odds that they are linear, 0 where nothing could be seen.
    n_regions: of sea floor that showed it.
    """

    transfer: Transfer
    linear_nats: float
    n_regions: int

    @property
    def is_sure(self) -> bool:
        """Check whether the odds for linear or logarithmic are 100 to 1 or better."""
        return abs(self.linear_nats) >= SURE_NATS

    @property
    def seen(self) -> TransferKind:
        """Name the kind that the samples look like, sure or not: amplitude stands for any linear one."""
        return "amplitude" if self.linear_nats >= 0.0 else "log"


def sample_law(speckle: FloorSpeckle, kind: TransferKind | None = None) -> SampleLaw:
    """Decide what samples of such speckle are.

    Parameters
    ----------
    kind
        Known to be so: amplitude and intensity are then taken as they are, and of a logarithm only the decibels per
        count are estimated.
    """
    nats = _linear_nats(speckle)
    if kind is None:
        kind = "log" if nats <= -SURE_NATS else "amplitude"
        power = _power(speckle) if nats >= SURE_NATS else 2.0
        transfer = Transfer("amplitude", power=power) if kind == "amplitude" else _logarithm(speckle)
    else:
        transfer = _logarithm(speckle) if kind == "log" else Transfer(kind)
    return SampleLaw(transfer, nats, speckle.n_regions)


def law_measures(speckle: FloorSpeckle) -> tuple[float, float, float]:
    """Compute what linear samples and logarithms differ in: skewness, ln spread and growth of the spread."""
    low, high = _GROWTHS
    growth = (min(max(speckle.growth, low), high) - 0.5) * min(speckle.level_nats, 1.0)
    return speckle.relative_skewness, math.log(speckle.relative_spread / _USUAL_SPREAD), growth


def _linear_nats(speckle: FloorSpeckle) -> float:
    """Compute the log-odds that samples are linear."""
    damage = -_NEGATIVE_NATS if speckle.negative else 0.0
    if math.isnan(speckle.relative_spread):
        return damage
    skewness, spread, growth = law_measures(speckle)
    return damage + _OFFSET + _PER_SKEWNESS * skewness + _PER_SPREAD_NAT * spread + _PER_GROWTH * growth


def _power(speckle: FloorSpeckle) -> float:
    """Compute the power of linear samples that is intensity: 2 of amplitude."""
    spread, skewness = speckle.undisturbed or (speckle.relative_spread, speckle.relative_skewness)
    if spread > _SINGLE_LOOK_SPREAD:
        return float(2.0 * (_SINGLE_LOOK_SPREAD / spread) ** _WEIBULL_EXPONENT)
    ratio = skewness / spread
    low, per_spread, high = _ROOT_RATIO
    exponent = 1.0 - _ROOT_SLOPE * (min(low + per_spread * spread, high) - ratio)
    return 2.0 / min(max(exponent, _LOWEST_EXPONENT), 1.0)


def _logarithm(speckle: FloorSpeckle) -> Transfer:
    """Estimate the decibels per count of logarithms."""
    if speckle.byte_sized:
        usual, usual_sigma = USUAL_DB_PER_COUNT, _USUAL_SIGMA
    elif speckle.span_counts > 0.0:
        usual, usual_sigma = _USUAL_SPAN_DB / speckle.span_counts, _SPAN_SIGMA
    else:
        return Transfer("log", USUAL_DB_PER_COUNT)
    if speckle.n_regions == 0:
        return Transfer("log", usual)
    skewness = min(max(-speckle.skewness, 0.0), _SINGLE_LOOK_SKEWNESS)
    found = math.hypot(_SMOOTH_DB, _DB_PER_SKEWNESS * skewness) / speckle.spread_counts
    near, far = _SPREAD_SIGMAS
    sigma = far + (near - far) * skewness / _SINGLE_LOOK_SKEWNESS
    weight = usual_sigma**2 / (usual_sigma**2 + sigma**2)
    db_per_count = math.exp(weight * math.log(found) + (1.0 - weight) * math.log(usual))
    return Transfer("log", min(db_per_count, _SINGLE_LOOK_DB / speckle.spread_counts))


def same_picture(one: Transfer, other: Transfer, within_nats: float) -> bool:
    """Check whether two transfers of one kind differ by no more than a factor of decibels."""
    if one.kind != other.kind:
        return False
    first, second = (t.db_per_count if t.kind == "log" else t.intensity_power for t in (one, other))
    return abs(math.log(first / second)) <= within_nats
