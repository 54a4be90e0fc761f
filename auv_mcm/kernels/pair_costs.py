"""Count, for each cell of a label field, shadow behind it and highlight before it in its own and the two rows beside
it.

A highlight without shadow behind it, and a shadow without highlight before it, cost more, by degrees:
cost = whole * (1 - min(1, number * share per pixel)). C and numpy round alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call

Plane = NDArray[np.float64]

SHADOW, HIGHLIGHT = 1, 2  # labels, as auv_mcm.confirm.region numbers them


class Lack(NamedTuple):
    """Set what a label costs without support, nats. Each pixel of the other label removes a share of it."""

    whole: float
    share: float


def pair_costs(
    labels: NDArray[np.uint8], reach: NDArray[np.int64], attached: int, highlight: Lack, shadow: Lack
) -> Plane:
    """Weigh labels by their neighbours in the rows of a field, (3, n_rows, n_columns) float64; 0 for background.

    Parameters
    ----------
    labels
        (n_rows, n_columns) uint8.
    reach
        (n_columns,) int64, columns before each in which highlights support a shadow.
    attached
        Columns behind each in which shadows support a highlight.
    """
    n_rows, n_columns = labels.shape
    scalars, sums, room = np.array([*highlight, *shadow]), np.empty(2 * n_columns + 2), np.empty((2, n_rows, n_columns))
    cost = np.zeros((3, n_rows, n_columns))
    if not call("pair_costs", n_rows, n_columns, labels, reach, attached, scalars, sums, *room, cost):
        return pair_costs_numpy(labels, reach, attached, highlight, shadow)
    return cost


def pair_costs_numpy(
    labels: NDArray[np.uint8], reach: NDArray[np.int64], attached: int, highlight: Lack, shadow: Lack
) -> Plane:
    """Do as pair_costs, in numpy alone."""
    n_columns = labels.shape[1]
    columns = np.arange(n_columns)
    dark, bright = (_row_sums(labels == label) for label in (SHADOW, HIGHLIGHT))
    behind = dark[:, np.minimum(columns + 1 + attached, n_columns)] - dark[:, columns + 1]
    before = bright[:, columns] - bright[:, np.maximum(columns - reach, 0)]
    cost = np.zeros((3, *labels.shape))
    for label, number, lack in ((HIGHLIGHT, behind, highlight), (SHADOW, before, shadow)):
        cost[label] = lack.whole * (1.0 - np.minimum(1.0, _three_rows(number) * lack.share))
    return cost


def _row_sums(mask: NDArray[np.bool_]) -> Plane:
    """Sum the first 0, 1, ... n_columns of each row."""
    sums = np.zeros((mask.shape[0], mask.shape[1] + 1))
    np.cumsum(mask, axis=1, out=sums[:, 1:])
    return sums


def _three_rows(plane: Plane) -> Plane:
    total = plane.copy()
    total[1:] += plane[:-1]
    total[:-1] += plane[1:]
    return total
