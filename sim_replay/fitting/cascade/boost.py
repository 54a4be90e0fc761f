"""Boost stumps over features in 256 bins: GentleBoost, asymmetric if misses cost more than false alarms.

Sources: J. Friedman, T. Hastie, R. Tibshirani, "Additive logistic regression", Annals of Statistics 28(2), 2000
(GentleBoost, weight trimming); P. Viola, M. Jones, "Fast and robust classification using asymmetric AdaBoost", NIPS
2001 (asymmetry spread over the rounds).

Weights are whole multiples of 2**-40 of their total: sums over bins are exact in any order, so that the same samples
give the same stumps bit for bit, and equal splits are equal.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.model import SCORE_UNIT

Bins = NDArray[np.uint8]
Weights = NDArray[np.float64]

N_BINS: Final = 256  # of a feature's values: fits a byte

_TOTAL: Final = 2.0**40  # sum of weights, as integers: sums are exact in float64, whatever their order
_LARGEST_LEAF: Final = 4.0  # in units of the boosted sum: bounds what one stump says
_LARGEST_GROWTH: Final = 100.0  # of a weight since the first round: one mislabelled sample must not take over
_TRIMMED_MASS: Final = 0.01  # of the weight, of easy examples that a stump leaves out
_RIDGE: Final = 1e-3  # share of the total weight that pulls leaves to 0, so that a few samples do not give certainty
_FEATURE_SHARE: Final = (
    0.25  # of the features, drawn anew every round: a quarter of the time, and stumps more unlike each other
)
_FEWEST_FEATURES: Final = 512  # drawn for a stump, minimum


class BoostedStump(NamedTuple):
    """Add `below` where the feature's bin is at most `last_below`, else `above`; leaves in 1/SCORE_UNIT."""

    feature: int
    last_below: int
    below: int
    above: int

    def scores(self, bins: Bins) -> NDArray[np.int32]:
        """Return (n_samples,) int32 scores for bins (n_features, n_samples) uint8."""
        return np.where(bins[self.feature] <= self.last_below, np.int32(self.below), np.int32(self.above))


class Split(NamedTuple):
    """Hold the best of many splits: its gain, place and leaves."""

    gain: float
    feature: int
    last_below: int
    below: float
    above: float


def gentle_stumps(
    bins: Bins, is_target: NDArray[np.bool_], n_rounds: int, asymmetry: float, rng: np.random.Generator
) -> Iterator[BoostedStump]:
    """Yield up to `n_rounds` stumps of GentleBoost, each leaf the weighted mean of the labels +-1 in it.

    Fewer if no feature splits the samples.

    Parameters
    ----------
    bins
        (n_features, n_samples) uint8.
    is_target
        (n_samples,) bool.
    asymmetry
        What a miss costs, in false alarms.

    Raises
    ------
    ValueError
        If either class is empty.
    """
    n_features, n_samples = bins.shape
    n_targets = int(np.count_nonzero(is_target))
    if not 0 < n_targets < n_samples:
        raise ValueError(f"{n_targets} targets among {n_samples} samples: there must be some, and something else")
    label = np.where(is_target, 1.0, -1.0)
    weight = np.where(is_target, 0.5 / n_targets, 0.5 / (n_samples - n_targets))
    largest = _LARGEST_GROWTH * weight
    favour = np.where(is_target, asymmetry ** (1.0 / n_rounds), 1.0)
    every = np.arange(n_features, dtype=np.intp)
    for _ in range(n_rounds):
        weight = _whole(np.minimum(weight * favour, largest))
        n_drawn = max(round(_FEATURE_SHARE * n_features), min(_FEWEST_FEATURES, n_features))
        drawn = np.sort(rng.choice(n_features, size=n_drawn, replace=False)) if n_drawn < n_features else every
        found = _search(bins, is_target, weight, drawn) or _search(bins, is_target, weight, every)
        if found is None:
            return
        stump = BoostedStump(found.feature, found.last_below, _leaf(found.below), _leaf(found.above))
        yield stump
        weight = weight * np.exp(-label * stump.scores(bins) / SCORE_UNIT) / _TOTAL


def gentle_split(target: Weights, other: Weights) -> Split | None:
    """Find the split with the minimum weighted squared error of the labels, or None if no feature splits the samples.

    Equal splits: the lowest feature, then the lowest bin, wins. The gain of a side is S**2 / (W + r) with S the sum of
    weight times label, W the sum of weight, r the ridge; its leaf S / (W + r).

    Parameters
    ----------
    target, other
        (n_features, 256) weight of either class in each bin.
    """
    signed, weight = _below(target - other), _below(target + other)
    total_signed, total = signed[:, -1:], weight[:, -1:]
    signed, weight = signed[:, :-1], weight[:, :-1]
    ridge = _RIDGE * float(total.max(initial=1.0))
    below, above = signed / (weight + ridge), (total_signed - signed) / (total - weight + ridge)
    gain = signed * below + (total_signed - signed) * above
    gain[(weight <= 0.0) | (weight >= total)] = -np.inf
    return _best(gain, below, above)


def histograms(bins: Bins, features: NDArray[np.intp], samples: NDArray[np.intp] | slice, weight: Weights) -> Weights:
    """Return (n_chosen, 256) float64: sum of `weight` over the chosen samples in each bin of the chosen features."""
    return np.stack([np.bincount(bins[feature][samples], weights=weight, minlength=N_BINS) for feature in features])


def _search(bins: Bins, is_target: NDArray[np.bool_], weight: Weights, features: NDArray[np.intp]) -> Split | None:
    heavy = _heavy(weight)
    parts = []
    for of_class in (is_target, ~is_target):
        chosen = heavy & of_class
        samples = np.flatnonzero(chosen)
        parts.append(histograms(bins, features, samples, weight[samples]))
    found = gentle_split(parts[0], parts[1])
    return None if found is None else found._replace(feature=int(features[found.feature]))


def _heavy(weight: Weights) -> NDArray[np.bool_]:
    """Select all samples but the lightest that hold 1 % of the weight together; they hardly count, but would cost as
    much.
    """
    order = np.argsort(weight, kind="stable")
    light = np.searchsorted(np.cumsum(weight[order]), _TRIMMED_MASS * weight.sum())
    kept = np.ones(weight.size, dtype=np.bool_)
    kept[order[:light]] = False
    return kept


def _whole(weight: Weights) -> Weights:
    return np.asarray(np.rint(weight * (_TOTAL / weight.sum())))


def _below(weight: Weights) -> Weights:
    return np.asarray(np.cumsum(weight, axis=1))


def _best(gain: Weights, below: Weights, above: Weights) -> Split | None:
    index = int(np.argmax(gain))
    if not np.isfinite(gain.flat[index]):
        return None
    feature, last_below = divmod(index, gain.shape[1])
    return Split(float(gain.flat[index]), feature, last_below, float(below.flat[index]), float(above.flat[index]))


def _leaf(value: float) -> int:
    return round(min(max(value, -_LARGEST_LEAF), _LARGEST_LEAF) * SCORE_UNIT)
