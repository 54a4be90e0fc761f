"""Estimate what a search leaves behind: mines that may still be there.

A mine that is not found usually makes a contact all the same, one that is not mine-like. So the sum of probabilities
over such contacts estimates how many mines lie among them, mission by mission; a table holds only averages. `p_mine`
presumes a share of mines among contacts. The mission's own contacts show theirs, by which they are weighed: over a
floor without mines fewer are expected. What leaves no contact at all is not in this (`auv-mcm bench clearance`).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

MIN_P_MINE: Final = 0.02
"""The lowest p_mine that counts, so that the estimate does not depend on how much less likely contacts are reported as
well."""
PRIOR_SHARE: Final = 0.2
"""Share of mines among contacts of MIN_P_MINE or more that p_mine presumes: its mean over them is 0.17 on ten missions
of the named scenes and 0.22 on forty drawn ones."""
PRIOR_CONTACTS: Final = 20.0
"""Contacts that the prior share counts for: chosen, about as many as a short mission has."""
SHAPE: Final = 2.0
"""Of the Gamma distribution of mines left about that estimate, from mission to mission: a relative deviation of 0.7
beside chance. Of ten named scenes flown three times each then holds what was left, with 3 two do not: 1 was left where
17 were expected, and 26 where 12 were (`auv-mcm bench clearance --first-seed 93001 --seeds 3`)."""

_PRIOR_MINES: Final = 0.5  # mines: Jeffreys' prior of a Poisson density, what an empty search may hide
_TAIL: Final = 0.025  # probability beyond each end of the central 95 % interval
_STEPS: Final = 1000  # bounds the search for the share; tens suffice
_SAME_SHARE: Final = 1e-9  # of the share: far below what a contact moves it
_MAX_MINES: Final = 1_000_000  # bounds the search for a quantile; more mines than any area holds


class Remaining(NamedTuple):
    """Hold the mines not found.

    expected: mean, infinite where the search could not have found any. low, high: of the central 95 % interval.
    at_most_95: no more than these with 95 %. p_none: that there is none. Counts are bounded by a million. share: of
    mines among contacts, by the mission's own evidence.
    """

    expected: float
    low: int
    high: int
    at_most_95: int
    p_none: float
    share: float


def own_odds(p_mine: ArrayLike) -> tuple[NDArray[np.float64], float]:
    """Weigh p_mine, (n,), by the share of mines that these contacts show themselves, and return that share too.

    It is the mode under a Beta prior of PRIOR_CONTACTS at PRIOR_SHARE, by steps of expectation and maximisation (M.
    Saerens, P. Latinne and C. Decaestecker, Neural Computation 14(1), 2002, eq. 2.7, with the prior's counts added).
    """
    given = np.asarray(p_mine, dtype=np.float64)
    share, p = PRIOR_SHARE, given
    for _ in range(_STEPS):
        factor = share / (1.0 - share) * (1.0 - PRIOR_SHARE) / PRIOR_SHARE
        p = factor * given / (factor * given + (1.0 - given))
        before, share = share, float(p.sum() + PRIOR_CONTACTS * PRIOR_SHARE) / (p.size + PRIOR_CONTACTS)
        if abs(share - before) < _SAME_SHARE:
            break
    return p, share


def remaining_mines(p_mine: ArrayLike, mine_like: ArrayLike, p_detected: ArrayLike) -> Remaining:
    """Estimate mines that remain where was searched.

    The number remaining is a Poisson count whose mean is Gamma distributed about the estimate: negative binomial.

    Parameters
    ----------
    p_mine
        (n,), of all contacts.
    mine_like
        (n,) bool, which of them are reported as mine-like: those are not left.
    p_detected
        Any shape, [0, 1], of every cell searched; of mines that leave no contact at all half a one is expected, times
        the odds against its being found.

    Raises
    ------
    ValueError
        For a value outside 0 to 1.
    """
    given, p = np.asarray(p_mine, dtype=np.float64), np.asarray(p_detected, dtype=np.float64)
    for name, values in (("p_mine", given), ("p_detected", p)):
        if not (np.isfinite(values).all() and (values >= 0.0).all() and (values <= 1.0).all()):
            raise ValueError(f"{name} holds a value outside 0 to 1")
    counts = given >= MIN_P_MINE
    own, share = own_odds(given[counts])
    doubtful = float(own[~np.asarray(mine_like, dtype=np.bool_)[counts]].sum())
    mean_p = float(p.mean()) if p.size else 1.0
    if mean_p == 0.0:
        return Remaining(math.inf, 0, _MAX_MINES, _MAX_MINES, 0.0, share)
    return remaining_about(doubtful + without_contact(mean_p), share)


def without_contact(mean_p_detected: float) -> float:
    """Expect mines that leave no contact where one is found with a probability above 0."""
    return _PRIOR_MINES * (1.0 - mean_p_detected) / mean_p_detected


def remaining_about(expected: float, share: float = PRIOR_SHARE) -> Remaining:
    """Spread the number of mines left about what is expected, finite. share: of mines among contacts, to be stated."""
    low, high, at_most = (_quantile(expected, below) for below in (_TAIL, 1.0 - _TAIL, 1.0 - 2.0 * _TAIL))
    return Remaining(expected, low, high, at_most, math.exp(-SHAPE * math.log1p(expected / SHAPE)), share)


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
