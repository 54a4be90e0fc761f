"""Decide which of what was seen now is which of what was known: by place, by kind, and one to one."""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.assignment import cheapest_columns

Array: TypeAlias = NDArray[np.float64]

IMPOSSIBLE: Final = 1e6
"""Squared deviations: more than any gate allows, so that such a pair is never made."""
MIN_COVARIANCE_M2: Final = 1e-4 * np.eye(2)
"""No centroid is known better than to a centimetre, whatever the errors configured."""
_MIN_SAME_KIND: Final = 1e-3  # probability, however much two views differ: one may be of the end that shows nothing


def squared_deviation(offset_m: Array, one_m2: Array, other_m2: Array) -> float:
    """Compute the squared Mahalanobis distance of two places.

    offset_m: (2,) east and north from one to the other; one_m2, other_m2: (2, 2) covariances.
    """
    return float(offset_m @ np.linalg.solve(one_m2 + other_m2 + MIN_COVARIANCE_M2, offset_m))


def unlikeness(p_mine: float, other_p_mine: float) -> float:
    """Compute the cost of joining two views beside their distance.

    It is twice the negative logarithm of the probability that both are a mine or neither.
    """
    same_kind = p_mine * other_p_mine + (1.0 - p_mine) * (1.0 - other_p_mine)
    return -2.0 * math.log(max(same_kind, _MIN_SAME_KIND))


def pair_off(deviation: Array, unlike: Array, gate_chi2: float) -> list[int | None]:
    """Choose for each row the column that it is a view of, or None for something new.

    Parameters
    ----------
    deviation, unlike
        (n_rows, n_columns) float64: `squared_deviation` and `unlikeness` of each pair, IMPOSSIBLE where it may not be.
    gate_chi2
        The largest squared deviation allowed. Something new costs as much, so that no good match is given up for two
        bad ones.
    """
    matches: list[int | None] = [None] * len(deviation)
    possible = np.flatnonzero((deviation < IMPOSSIBLE).any(axis=0))
    if possible.size == 0:
        return matches
    # Beside the likest in reach, so that a row joins an unlike column where there is no other.
    cost = np.where(unlike < IMPOSSIBLE, deviation + unlike - unlike.min(axis=1, keepdims=True), IMPOSSIBLE)
    in_reach = cost[:, possible] < IMPOSSIBLE
    if in_reach.sum(axis=0).max() <= 1 and in_reach.sum(axis=1).max() <= 1:
        for row, column in np.argwhere(in_reach).tolist():
            matches[row] = int(possible[column])
        return matches
    competing = np.flatnonzero(in_reach.any(axis=1))
    opening = np.full((competing.size, competing.size), gate_chi2)
    chosen = cheapest_columns(np.concatenate([cost[np.ix_(competing, possible)], opening], axis=1))
    for row, column in zip(competing.tolist(), chosen.tolist(), strict=True):
        if column < possible.size:
            matches[row] = int(possible[column])
    return matches
