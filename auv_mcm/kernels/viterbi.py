"""Find the best path through a grid of scores, one bin per ping: dynamic programming after Viterbi (1967).

The path k maximises  sum_p score[p, k_p] - step_cost * |k_p - k_(p-1)|  over all paths with |k_p - k_(p-1)| <=
max_step. Among equally good predecessors the smaller step wins, then the smaller bin; among equally good ends, the
smaller bin. A score of -inf forbids a bin. A ping without data should score 0 everywhere: if every bin of a ping is
forbidden, or none can be reached, the pings before it have no effect on those after.

After each ping the largest cost is taken off all of them, which changes no path and keeps the sums bounded however long
the mission. C and numpy round alike: same candidates, same order, no fused operations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call


def viterbi_path(score: NDArray[np.float64], max_step: int, step_cost: float) -> NDArray[np.int64]:
    """Find the best path through the whole of `score`.

    score: (n_pings, n_bins) float64. Returns (n_pings,) int64 bins.
    Raises ValueError if score is not 2-d, has no bins, or holds NaN or +inf, or if max_step or step_cost is negative.
    """
    score = np.ascontiguousarray(score, dtype=np.float64)
    start = np.zeros(score.shape[-1] if score.ndim == 2 else 0)
    cost, back = viterbi_forward(start, score, max_step, step_cost)
    return backtrack(int(cost.argmax()), back)


def viterbi_forward(
    previous_cost: NDArray[np.float64], score: NDArray[np.float64], max_step: int, step_cost: float
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Carry the search over the pings of one block, so that a long mission can be searched piece by piece.

    Returns cost (n_bins,) float64 after the last ping, its maximum 0, and back (n_pings, n_bins) int32: the best
    predecessor of each bin (in row 0: bins of the block before).

    Parameters
    ----------
    previous_cost
        (n_bins,) float64, the cost returned for the block before; zeros at the start of a mission.
    score
        (n_pings, n_bins) float64.

    Raises
    ------
    ValueError
        As viterbi_path does, or if the shapes do not fit.
    """
    score = np.ascontiguousarray(score, dtype=np.float64)
    cost = np.array(previous_cost, dtype=np.float64, order="C")  # a copy: the kernel updates it in place
    _check(cost, score, max_step, step_cost)
    n_pings, n_bins = score.shape
    scratch = np.empty((2, n_bins))
    back = np.empty((n_pings, n_bins), dtype=np.int32)
    if not call("viterbi_forward", n_pings, n_bins, max_step, step_cost, score, cost, scratch, back):
        return viterbi_forward_numpy(cost, score, max_step, step_cost)
    return cost, back


def backtrack(end: int, back: NDArray[np.int32]) -> NDArray[np.int64]:
    """Trace the path that ends in bin `end` of the last ping.

    back: (n_pings, n_bins) int32. Returns (n_pings,) int64.
    """
    path = np.empty(back.shape[0], dtype=np.int64)
    bin_ = end
    for ping in range(back.shape[0] - 1, -1, -1):
        path[ping] = bin_
        bin_ = back[ping, bin_]
    return path


def viterbi_forward_numpy(
    previous_cost: NDArray[np.float64], score: NDArray[np.float64], max_step: int, step_cost: float
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Do as viterbi_forward, in numpy alone."""
    n_pings, n_bins = score.shape
    bins = np.arange(n_bins, dtype=np.int32)
    cost = previous_cost
    back = np.empty((n_pings, n_bins), dtype=np.int32)
    for ping in range(n_pings):
        best, origin = cost.copy(), bins.copy()
        for step in range(1, min(max_step, n_bins - 1) + 1):
            for here, there in ((slice(step, None), slice(None, -step)), (slice(None, -step), slice(step, None))):
                candidate = cost[there] - step_cost * step
                better = candidate > best[here]
                best[here][better] = candidate[better]
                origin[here][better] = bins[there][better]
        best += score[ping]
        highest = best.max()
        cost = best - highest if highest > -np.inf else np.zeros(n_bins)
        back[ping] = origin
    return cost, back


def _check(cost: NDArray[np.float64], score: NDArray[np.float64], max_step: int, step_cost: float) -> None:
    if score.ndim != 2 or score.shape[1] == 0:
        raise ValueError(f"score must have shape (n_pings, n_bins) with at least one bin, not {score.shape}")
    if cost.shape != score.shape[1:]:
        raise ValueError(f"previous_cost must have shape ({score.shape[1]},) like a row of score, not {cost.shape}")
    for name, values in (("score", score), ("previous_cost", cost)):
        if values.size and not values.max() < np.inf:  # the maximum carries NaN
            raise ValueError(f"{name} holds NaN or +inf; use -inf for a forbidden bin and 0 for a ping without data")
    if max_step < 0 or not 0.0 <= step_cost < np.inf:
        raise ValueError(f"max_step and step_cost must be finite and not negative, not {max_step} and {step_cost}")
