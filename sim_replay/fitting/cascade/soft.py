"""Set thresholds of a soft cascade by direct backward pruning.

What a target's best window would pass is settled first, rejection follows.

Sources: C. Zhang, P. Viola, "Multiple-instance pruning for learning efficient cascade detectors", NIPS 2007; L.
Bourdev, J. Brandt, "Robust object detection via soft cascade", CVPR 2005.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray


def best_windows(merit: NDArray[Any], bag: NDArray[np.intp]) -> NDArray[np.intp]:
    """Find the window with the highest merit of each bag, (n_bags,), the first of equal ones, by ascending bag.

    Parameters
    ----------
    merit
        (n_windows,) of numbers, e.g. the final score.
    bag
        (n_windows,) intp, the target a window belongs to; every window of a target centres on it, as near as its
        highlight is known.
    """
    order = np.lexsort((np.arange(bag.size), -merit.astype(np.float64), bag))
    first = np.ones(order.size, dtype=np.bool_)
    first[1:] = bag[order[1:]] != bag[order[:-1]]
    return order[first]


def reject_thresholds(trace: NDArray[np.int32], bag: NDArray[np.intp], detection: float) -> tuple[int, ...]:
    """Score below which windows are dropped after each group, n_groups numbers.

    The last threshold is the lowest best score of the targets kept; the others are the lowest score after that group of
    their best windows. So every target kept passes with its best window, and with no score changed.

    Parameters
    ----------
    trace
        (n_windows, n_groups) int32, the score of each window of each target after every group.
    detection
        Share of the targets, 0..1 exclusive of 0, to keep.

    Raises
    ------
    ValueError
        If there is no window or `detection` is out of range.
    """
    if not len(trace) or not 0.0 < detection <= 1.0:
        raise ValueError(
            f"{len(trace)} windows, detection {detection}: there must be windows, and a detection above 0 and up to 1"
        )
    of_targets = trace[best_windows(trace[:, -1], bag)]
    n_kept = math.ceil(detection * len(of_targets) - 1e-9)
    final = np.sort(of_targets[:, -1])[len(of_targets) - n_kept]
    return tuple(int(lowest) for lowest in of_targets[of_targets[:, -1] >= final].min(axis=0))


def group_sizes(n_stumps: int) -> tuple[int, ...]:
    """Size the groups 1, 1, 2, 4, 8, 8, 16, 16... stumps.

    Rejection is tried often while all windows are alive, seldom when few are.
    """
    sizes: list[int] = []
    for size in (1, 1, 2, 4, 8, 8):
        sizes.append(min(size, n_stumps - sum(sizes)))
    while sum(sizes) < n_stumps:
        sizes.append(min(16, n_stumps - sum(sizes)))
    return tuple(size for size in sizes if size > 0)
