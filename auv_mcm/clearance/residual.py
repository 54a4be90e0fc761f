"""What a search leaves behind: mines that may still be there, and how wide a path a sonar sweeps.

Mines lie at random with an unknown density whose prior is a Gamma distribution. Of each, the search finds what `p_detected` says where it
lies, on its own: then what was found and what was not are independent Poisson counts given the density, and the density given what was
found is Gamma again (conjugacy; B. O. Koopman, "Search and Screening", 1946, for the search; any text on Bayesian statistics for the rest).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

_MOST_MINES: Final = 1_000_000


class Prior(NamedTuple):
    """What is known of the density before the search: Gamma, worth as much as shape mines found in rate_km2 searched for sure.

    The default is Jeffreys' prior, which leaves the density to what was found: any area worth a rate would outweigh a small search, and
    understate what that has left.
    """

    shape: float = 0.5
    rate_km2: float = 0.0


class Remaining(NamedTuple):
    """Mines not found. expected: mean, infinite where nothing was searched and nothing known. high: no more than these with the asked
    probability, at most a million. p_none: that there is none."""

    expected: float
    high: int
    p_none: float


def remaining_mines(
    n_found: float, p_detected: ArrayLike, cell_m2: float, prior: Prior | None = None, confidence: float = 0.95
) -> Remaining:
    """Mines that remain in the cells of an area.

    n_found: mines found there; contacts may count with their p_mine. p_detected: any shape, [0, 1], of every cell of the area, 0 for those
    not searched. Given n_found the density is Gamma(shape + n_found, rate + exposure), so that the number remaining is negative binomial.
    Raises ValueError for probabilities, areas or counts that cannot be.
    """
    prior = prior or Prior()
    p = np.asarray(p_detected, dtype=np.float64)
    if not (np.isfinite(p).all() and (p >= 0.0).all() and (p <= 1.0).all()):
        raise ValueError("p_detected holds a value that is no probability")
    if not (
        n_found >= 0.0
        and math.isfinite(n_found)
        and cell_m2 > 0.0
        and 0.0 < confidence < 1.0
        and prior.shape > 0.0
        and 0.0 <= prior.rate_km2 < math.inf
    ):
        raise ValueError(f"n_found {n_found}, cell_m2 {cell_m2}, confidence {confidence} or prior {prior} is out of range")
    searched_km2 = float(p.sum()) * cell_m2 * 1e-6
    missed_km2 = float((1.0 - p).sum()) * cell_m2 * 1e-6
    shape, rate = prior.shape + n_found, prior.rate_km2 + searched_km2
    if rate == 0.0 and missed_km2 > 0.0:
        return Remaining(math.inf, _MOST_MINES, 0.0)
    # Poisson with mean missed_km2 * density: negative binomial with odds missed_km2 / rate.
    log_none = -shape * math.log1p(missed_km2 / rate) if missed_km2 > 0.0 else 0.0
    log_share = -math.log1p(rate / missed_km2) if missed_km2 > 0.0 else -math.inf
    expected = missed_km2 * shape / rate if missed_km2 > 0.0 else 0.0
    return Remaining(expected, _quantile(shape, log_none, log_share, confidence), math.exp(log_none))


def sweep_width_m(ground_range_m: NDArray[np.float64], p_look: NDArray[np.float64]) -> float:
    """Width of the path that a sure sonar would have to see to find as many mines as this one on one side: the integral of P over range.

    ground_range_m: (n,) rising, p_look: (n,). Raises ValueError for ranges that do not rise.
    """
    if not (np.diff(ground_range_m) > 0.0).all():
        raise ValueError("ground_range_m must rise")
    return float(np.sum(0.5 * (p_look[1:] + p_look[:-1]) * np.diff(ground_range_m)))


def _quantile(shape: float, log_none: float, log_share: float, confidence: float) -> int:
    """Least n with P(N <= n) >= confidence for a negative binomial with P(0) = exp(log_none)."""
    if log_share == -math.inf:
        return 0
    log_p, total = log_none, math.exp(log_none)
    for n in range(_MOST_MINES):
        if total >= confidence:
            return n
        log_p += math.log((shape + n) / (n + 1)) + log_share
        total += math.exp(log_p)
    return _MOST_MINES
