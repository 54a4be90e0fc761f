"""Fit logistic regression with a ridge, and probabilities that hold out of sample.

Logistic discrimination: D. R. Cox, J. Royal Statistical Society B 20, 1958. Calibration by a straight line through the
odds of samples held out: J. Platt, Advances in Large Margin Classifiers, 1999. Sums run in one fixed order, so that
threads change nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import UsageError

Array = NDArray[np.float64]

_STEPS: Final = 50  # of Newton's method; a guard, it settles earlier
_SMALLEST_STEP: Final = 1e-8  # below which it has settled
_MIN_CURVATURE: Final = 1e-9  # keeps the system solvable where all is certain
_N_PARTS: Final = 5  # of the cross-validation


class Discriminant(NamedTuple):
    """Compute log-odds = offset + features @ slopes. slopes: (k,) float64."""

    offset: float
    slopes: Array

    def log_odds(self, features: Array) -> Array:
        """Return (n,) log-odds of features (n, k)."""
        return self.offset + _odds(features, self.slopes)


def fit_discriminant(features: Array, is_positive: NDArray[np.bool_], weight: Array, ridge: float) -> Discriminant:
    """Fit the most likely discriminant for samples (n, k) that count `weight` (n,) times each.

    ridge: precision, above 0, of the prior around 0 of the slopes of standardised features; what never varies gets
    none. Raises UsageError if all samples are of one kind.
    """
    if is_positive.all() or not is_positive.any():
        raise UsageError(
            f"{is_positive.sum()} of {len(is_positive)} samples are targets: a classifier needs targets and others to "
            "learn from"
        )
    mean = np.average(features, axis=0, weights=weight)
    scale = np.sqrt(np.average((features - mean) ** 2, axis=0, weights=weight))
    varies = np.ptp(features, axis=0) > 0.0
    scale = np.where(varies, scale, 1.0)
    columns = np.column_stack([np.ones(len(features)), np.where(varies, (features - mean) / scale, 0.0)])
    found = _newton(columns, is_positive.astype(np.float64), weight, ridge)
    slopes = found[1:] / scale
    return Discriminant(float(found[0] - slopes @ mean), slopes)


def fit_calibrated(
    features: Array, is_positive: NDArray[np.bool_], weight: Array, ridge: float, groups: Sequence[str]
) -> Discriminant:
    """Fit as `fit_discriminant`, with odds calibrated on samples of other groups.

    groups: what each sample belongs to, such as its background; the groups are parted in five, each judged by a fit to
    the others, and all odds are moved and stretched as those judgements ask for. With one group, or where a part leaves
    one kind only, as `fit_discriminant`.
    """
    found = fit_discriminant(features, is_positive, weight, ridge)
    names = sorted(set(groups))
    part_of = {name: index % _N_PARTS for index, name in enumerate(names)}
    part = np.array([part_of[group] for group in groups])
    judged = np.full(len(features), math.nan)
    for index in range(min(len(names), _N_PARTS)):
        held_out = part == index
        others = is_positive[~held_out]
        if not others.any() or others.all():
            return found
        judged[held_out] = fit_discriminant(features[~held_out], others, weight[~held_out], ridge).log_odds(
            features[held_out]
        )
    line = fit_discriminant(judged[:, np.newaxis], is_positive, weight, 1e-3)
    # Odds without evidence, or with the opposite sign, must not reverse the order of samples.
    stretch = max(float(line.slopes[0]), 1e-3)
    return Discriminant(line.offset + stretch * found.offset, stretch * found.slopes)


def _newton(columns: Array, target: Array, weight: Array, ridge: float) -> Array:
    """Return (k,) coefficients of minimum log-loss plus ridge for columns (n, k), the first of which is the constant
    and goes free.
    """
    penalty = np.full(columns.shape[1], ridge)
    penalty[0] = 0.0
    at = np.zeros(columns.shape[1])
    loss = _loss(columns, target, weight, penalty, at)
    for _ in range(_STEPS):
        p = 1.0 / (1.0 + np.exp(-np.clip(_odds(columns, at), -500.0, 500.0)))
        gradient = np.einsum("nk,n->k", columns, weight * (p - target)) + penalty * at
        bend = weight * np.maximum(p * (1.0 - p), _MIN_CURVATURE)
        step = np.linalg.solve(
            np.einsum("nj,nk->jk", columns * bend[:, np.newaxis], columns) + np.diag(penalty), gradient
        )
        share = 1.0
        while (lower := _loss(columns, target, weight, penalty, at - share * step)) > loss and share > _SMALLEST_STEP:
            share *= 0.5
        at, loss = at - share * step, min(lower, loss)
        if share * float(np.abs(step).max()) < _SMALLEST_STEP:
            break
    return at


def _loss(columns: Array, target: Array, weight: Array, penalty: Array, at: Array) -> float:
    odds = _odds(columns, at)
    return float((weight * (np.logaddexp(0.0, odds) - target * odds)).sum() + 0.5 * (penalty * at**2).sum())


def _odds(columns: Array, at: Array) -> Array:
    return np.asarray(np.einsum("nk,k->n", columns, at))
