"""Boosted trees that mend what a linear sum of features gets wrong: three questions deep, fitted to the log-loss by
Newton steps.

J. H. Friedman, "Greedy function approximation: a gradient boosting machine", Annals of Statistics 29, 2001;
second-order leaves after Friedman, Hastie and Tibshirani, "Additive logistic regression", Annals of Statistics 28,
2000. Every tree sees a part of the examples and splits on a part of the features, so that trees differ (Friedman,
"Stochastic gradient boosting", 2002).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.odds import DEPTH

Array = NDArray[np.float64]

N_QUESTIONS: Final = 2**DEPTH - 1
N_LEAVES: Final = 2**DEPTH
_N_BINS: Final = 64  # of a feature's values
_RATE: Final = 0.07  # share of a tree's answer that is added
_RIDGE: Final = 5.0  # added to the curvature of a leaf
_MIN_HESSIAN: Final = 2.0  # of a leaf: about as many targets
_EXAMPLES: Final = 0.6  # share that a tree sees
_FEATURES: Final = 0.25  # share that a tree sees
_FEWEST_FEATURES: Final = 4  # that a tree sees, minimum
_SEED: Final = 1958  # of what a tree sees, fixed so that models repeat
_NEVER: Final = 1e30  # above every value: a question that parts nothing


class GrownTree(NamedTuple):
    """Hold a tree.

    Question i asks whether feature[i] is above threshold[i]; no leads to question 2 i + 1, yes to 2 i + 2, the last to
    leaves.

    feature: (7,) int columns. threshold: (7,). nats: (8,), what each leaf adds to the log-odds.
    """

    feature: NDArray[np.int64]
    threshold: Array
    nats: Array


def boost(values: Array, is_target: NDArray[np.bool_], weight: Array, start: Array, n_trees: int) -> list[GrownTree]:
    """Grow trees on features `values` (n, k) that add up to the correction of the log-odds `start` (n,).

    weight: (n,), how many each example stands for.

    The same examples in the same order give the same trees.
    """
    random = np.random.Generator(np.random.PCG64(_SEED))
    edges = [_edges(column) for column in values.T]
    # A row per feature, since features are counted one by one.
    bins = np.array([np.searchsorted(edge, column, side="left") for edge, column in zip(edges, values.T, strict=True)])
    odds = start.astype(np.float64).copy()
    n_examples, n_features = values.shape
    some = min(n_features, max(_FEWEST_FEATURES, round(_FEATURES * n_features)))
    trees = []
    for _ in range(n_trees):
        p = 1.0 / (1.0 + np.exp(-odds))
        gradient, hessian = weight * (is_target - p), weight * p * (1.0 - p)
        seen = np.flatnonzero(random.random(n_examples) < _EXAMPLES)
        chosen = np.sort(random.choice(n_features, some, replace=False))
        tree = _grow(bins[np.ix_(chosen, seen)], gradient[seen], hessian[seen], [edges[k] for k in chosen], chosen)
        trees.append(tree)
        odds += tree.nats[leaves(tree, values)]
    return trees


def leaves(tree: GrownTree, values: Array) -> NDArray[np.int64]:
    """Return (n,) int64 leaf, 0 to 7, of each row of `values` (n, k)."""
    place = np.zeros(len(values), dtype=np.int64)
    rows = np.arange(len(values))
    for _ in range(DEPTH):
        above = values[rows, tree.feature[place]] > tree.threshold[place]
        place = 2 * place + 1 + above
    return place - N_QUESTIONS


def _edges(column: Array) -> Array:
    """Return candidate thresholds, between values that differ."""
    middle = np.unique(np.quantile(column, np.arange(1, _N_BINS) / _N_BINS, method="lower"))
    return np.asarray(middle[middle < column.max()])


def _grow(
    bins: NDArray[np.int64], gradient: Array, hessian: Array, edges: list[Array], chosen: NDArray[np.int64]
) -> GrownTree:
    """Grow a tree on bins (k, n) of the chosen features, (k,) of all, with their edges."""
    n_examples = bins.shape[1]
    feature = np.zeros(N_QUESTIONS, dtype=np.int64)
    threshold = np.full(N_QUESTIONS, _NEVER)
    asked = np.zeros(N_QUESTIONS, dtype=np.int64)  # as feature, by place among the chosen
    place = np.zeros(n_examples, dtype=np.int64)
    for depth in range(DEPTH):
        first, n_nodes = 2**depth - 1, 2**depth
        node = place - first
        best_gain = np.zeros(n_nodes)
        best_bin = np.full(n_nodes, _N_BINS)  # no value lies above: all go one way
        cells = node * _N_BINS
        for column in range(len(chosen)):
            if not len(edges[column]):
                continue
            cell = cells + bins[column]
            below_g, below_h = (
                np.bincount(cell, weights=part, minlength=n_nodes * _N_BINS).reshape(n_nodes, _N_BINS).cumsum(axis=1)
                for part in (gradient, hessian)
            )
            all_g, all_h = below_g[:, -1:], below_h[:, -1:]
            gain = _worth(below_g, below_h) + _worth(all_g - below_g, all_h - below_h) - _worth(all_g, all_h)
            gain[(below_h < _MIN_HESSIAN) | (all_h - below_h < _MIN_HESSIAN)] = 0.0
            at = gain[:, : len(edges[column])].argmax(axis=1)
            found = gain[np.arange(n_nodes), at]
            better = found > best_gain
            best_gain = np.where(better, found, best_gain)
            best_bin = np.where(better, at, best_bin)
            asked[first : first + n_nodes][better] = column
            feature[first : first + n_nodes][better] = chosen[column]
            threshold[first : first + n_nodes][better] = edges[column][at[better]]
        above = bins[asked[place], np.arange(n_examples)] > best_bin[node]
        place = 2 * place + 1 + above
    leaf = place - N_QUESTIONS
    sums_g, sums_h = (np.bincount(leaf, weights=part, minlength=N_LEAVES) for part in (gradient, hessian))
    nats = _RATE * sums_g / (sums_h + _RIDGE)
    return GrownTree(feature, threshold, nats)


def _worth(gradient: Array, hessian: Array) -> Array:
    return gradient**2 / (hessian + _RIDGE)
