"""Compute counts with their 95 % confidence intervals: shares of trials, and densities over an area."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammainccinv, gammaincinv, ndtri

CONFIDENCE: Final = 0.95  # of all intervals


class Proportion(msgspec.Struct, frozen=True, kw_only=True):
    """Hold `count` of `of` trials, with Wilson's interval.

    `value` is None without trials, where the interval is 0..1.
    """

    count: int
    of: int
    value: float | None
    low: float
    high: float


class Density(msgspec.Struct, frozen=True, kw_only=True):
    """Hold `count` events over an area, per square kilometre, with the exact Poisson interval.

    None where the area is not known.
    """

    count: int
    area_km2: float | None
    per_km2: float | None
    low: float | None
    high: float | None


def wilson_interval(count: ArrayLike, of: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bound the probability behind `count` successes in `of` trials; arrays broadcast; 0..1 without trials.

    Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22 (1927). Its coverage is near
    the nominal one on average over probabilities, not for each of them.
    """
    successes, trials = np.broadcast_arrays(np.asarray(count, dtype=np.float64), np.asarray(of, dtype=np.float64))
    z2 = float(ndtri(0.5 + 0.5 * CONFIDENCE)) ** 2
    n = np.maximum(trials, 1.0)
    centre = (successes + 0.5 * z2) / (n + z2)
    half = np.sqrt(z2 * (successes * (n - successes) / n + 0.25 * z2)) / (n + z2)
    # At the ends the bound is the end itself, which rounding misses.
    low = np.where(successes == 0.0, 0.0, centre - half)
    high = np.where(successes == trials, 1.0, centre + half)
    return low, high


def poisson_interval(count: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bound the mean behind `count` Poisson events; covers with CONFIDENCE or more, whatever the mean.

    Garwood, "Fiducial limits for the Poisson distribution", Biometrika 28 (1936).
    """
    events = np.asarray(count, dtype=np.float64)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low = np.where(events > 0.0, gammaincinv(np.maximum(events, 1.0), tail), 0.0)
    return low, np.asarray(gammainccinv(events + 1.0, tail), dtype=np.float64)


def proportion(count: int, of: int) -> Proportion:
    """Compute a proportion with Wilson's interval."""
    low, high = wilson_interval(count, of)
    return Proportion(count=count, of=of, value=count / of if of else None, low=float(low), high=float(high))


def density(count: int, area_km2: float | None) -> Density:
    """Compute a density with the exact Poisson interval; no value without an area."""
    if not area_km2:
        return Density(count=count, area_km2=area_km2, per_km2=None, low=None, high=None)
    low, high = poisson_interval(count)
    return Density(
        count=count, area_km2=area_km2, per_km2=count / area_km2, low=float(low) / area_km2, high=float(high) / area_km2
    )
