"""Estimate what a search leaves behind: mines that may still be there, and how wide a path a sonar sweeps.

A mine that a look does not find nearly always makes a contact all the same, one that is not called mine-like. So the
sum of `p_mine` over contacts not called estimates how many mines lie among them, mission by mission; a table of
probabilities holds only averages:
floors, water and mines differ so much that of two floors with the same table one shows 0.9 of its mines and the other
0.25. Not all of that sum are mines; which part is, and how far missions scatter about it, was measured (`auv-mcm bench
clearance`). Like `p_mine` itself, it presumes that mines lie about as densely as in simulated missions: where there are
none it is too high.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

MIN_P_MINE: Final = 0.02
"""The lowest p_mine that counts, so that the estimate does not depend on how much less likely contacts are reported as
well."""
DOUBTFUL_SHARE: Final = 0.87
"""Mines missed over the sum of p_mine of contacts not called, of MIN_P_MINE or more, on the named scenes, seeds 91001
and 91002; 0.83 to 0.92 with one scene left out."""
SHAPE: Final = 10.0
"""Of the Gamma distribution of mines left about that estimate, from mission to mission: a relative deviation of 0.32
beside chance."""
USUAL_PER_KM2: Final = 300
"""Mines in those missions: 20 to 24 on 0.06 to 0.11 km²."""

_PRIOR_MINES: Final = 0.5  # mines: Jeffreys' prior of a Poisson density, what an empty search may hide
_TAIL: Final = 0.025  # probability beyond each end of the central 95 % interval
_MAX_MINES: Final = 1_000_000  # bounds the search for a quantile; more mines than any area holds


class Remaining(NamedTuple):
    """Hold the mines not found.

    expected: mean, infinite where the search could not have found any. low, high: of the central 95 % interval.
    at_most_95: no more than these with 95 %. p_none: that there is none. Counts are bounded by a million.
    """

    expected: float
    low: int
    high: int
    at_most_95: int
    p_none: float


def remaining_mines(p_doubtful: ArrayLike, p_detected: ArrayLike) -> Remaining:
    """Estimate mines that remain where was searched.

    The number remaining is a Poisson count whose mean is Gamma distributed about the estimate: negative binomial.

    Parameters
    ----------
    p_doubtful
        p_mine of the contacts that are not called mine-like.
    p_detected
        Any shape, [0, 1], of every cell searched; of mines that leave no contact at all half a one is expected, times
        the odds against its being found.

    Raises
    ------
    ValueError
        For a value outside 0 to 1.
    """
    doubtful, p = np.asarray(p_doubtful, dtype=np.float64), np.asarray(p_detected, dtype=np.float64)
    for name, values in (("p_doubtful", doubtful), ("p_detected", p)):
        if not (np.isfinite(values).all() and (values >= 0.0).all() and (values <= 1.0).all()):
            raise ValueError(f"{name} holds a value outside 0 to 1")
    doubtful = doubtful[doubtful >= MIN_P_MINE]
    mean_p = float(p.mean()) if p.size else 1.0
    if mean_p == 0.0:
        return Remaining(math.inf, 0, _MAX_MINES, _MAX_MINES, 0.0)
    return remaining_about(DOUBTFUL_SHARE * float(doubtful.sum()) + without_contact(mean_p))


def without_contact(mean_p_detected: float) -> float:
    """Expect mines that leave no contact where one is found with a probability above 0."""
    return _PRIOR_MINES * (1.0 - mean_p_detected) / mean_p_detected


def remaining_about(expected: float) -> Remaining:
    """Spread the number of mines left about what is expected, finite."""
    low, high, at_most = (_quantile(expected, share) for share in (_TAIL, 1.0 - _TAIL, 1.0 - 2.0 * _TAIL))
    return Remaining(expected, low, high, at_most, math.exp(-SHAPE * math.log1p(expected / SHAPE)))


def sweep_width_m(ground_range_m: NDArray[np.float64], p_look: NDArray[np.float64]) -> float:
    """Integrate P over range.

    The width of the path that a sure sonar would have to see to find as many mines as this one on one side.

    ground_range_m: (n,) rising, p_look: (n,). Raises ValueError for ranges that do not rise.
    """
    if not (np.diff(ground_range_m) > 0.0).all():
        raise ValueError("ground_range_m must rise")
    return float(np.sum(0.5 * (p_look[1:] + p_look[:-1]) * np.diff(ground_range_m)))


def _quantile(mean: float, share: float) -> int:
    """Find the smallest n with P(N <= n) >= share, of a negative binomial with a mean and SHAPE."""
    if mean == 0.0:
        return 0
    log_p = -SHAPE * math.log1p(mean / SHAPE)
    log_ratio = -math.log1p(SHAPE / mean)
    total = math.exp(log_p)
    for n in range(_MAX_MINES):
        if total >= share:
            return n
        log_p += math.log((SHAPE + n) / (n + 1)) + log_ratio
        total += math.exp(log_p)
    return _MAX_MINES
