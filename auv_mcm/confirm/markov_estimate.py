"""Estimate the smoothness of a label field from the field itself: weighted least squares.

H. Derin and H. Elliott, IEEE PAMI 9 (1987). For two labels i and j around which the same neighbours stand, the model
gives ln(n_j / n_i) = E_i - E_j, linear in the parameters.
"""

from __future__ import annotations

import itertools
import math
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

_MIN_COUNT: Final = 5  # a rarer configuration has too uncertain a logarithm, none at all has no logarithm
_RIDGE: Final = 1e-3  # of the scaled normal equations: keeps them solvable where two neighbourhoods are nearly alike
_WORST_CONDITION: Final = 1e8  # number beyond which half of the digits of a solution are lost and no estimate is given
# nats: smoothness outside of it leaves speckle as it is, or wipes out small shadows; chosen, not measured
_RANGE: Final = (0.2, 2.0)


class MarkovEstimate(NamedTuple):
    """Hold an estimate.

    smoothness: cost of an edge between unlike neighbours, nats; diagonal ones count 1/sqrt(2).

    condition: of the scaled normal equations. verdict: `estimated`; `clipped` to the range 0.2 to 2; or `prior` where
    the field does not determine it (too few configurations, or one label everywhere) and the value is the one given.
    """

    smoothness: float
    condition: float
    verdict: Literal["estimated", "clipped", "prior"]


def estimate_smoothness(labels: NDArray[np.uint8], prior: float) -> MarkovEstimate:
    """Estimate the smoothness of labels 0, 1, 2, shape (n_rows, n_columns) uint8; `prior` where it is undetermined."""
    equations, values, weights = _equations(labels)
    if len(values) < 3:
        return MarkovEstimate(prior, math.inf, "prior")
    normal = equations.T @ (weights[:, None] * equations)
    # A label that never occurs has no equation and no effect on smoothness; its zero row must not count as singular.
    known = np.diag(normal) > 0.0
    known[2] = True
    normal, right = normal[np.ix_(known, known)], (equations.T @ (weights * values))[known]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), np.finfo(np.float64).tiny))
    scaled = normal * np.outer(scale, scale)
    condition = float(np.linalg.cond(scaled))
    if not condition < _WORST_CONDITION:
        return MarkovEstimate(prior, condition, "prior")
    solution = scale * np.linalg.solve(scaled + _RIDGE * np.eye(len(scaled)), scale * right)
    smoothness = float(solution[-1])
    clipped = min(max(smoothness, _RANGE[0]), _RANGE[1])
    return MarkovEstimate(clipped, condition, "estimated" if clipped == smoothness else "clipped")


def _equations(labels: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Set up rows (field of label 1, of label 2, smoothness), values and weights; fields are relative to label 0."""
    empty = np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    if min(labels.shape) < 3:
        return empty
    n_rows, n_columns = labels.shape
    shifts = {
        "axis": ((0, 1), (2, 1), (1, 0), (1, 2)),
        "diagonal": ((0, 0), (0, 2), (2, 0), (2, 2)),
    }
    # Four counts from 0 to 4 suffice: how many axis and diagonal neighbours have labels 1 and 2.
    key = np.zeros((n_rows - 2, n_columns - 2), dtype=np.int64)
    for where, label in itertools.product(("axis", "diagonal"), (1, 2)):
        count = sum(
            (labels[r : r + n_rows - 2, c : c + n_columns - 2] == label).astype(np.int64) for r, c in shifts[where]
        )
        key = 5 * key + count
    number = np.bincount((3 * key + labels[1:-1, 1:-1]).ravel(), minlength=3 * 5**4).reshape(-1, 3)
    rows, values, weights = [], [], []
    for configuration in np.flatnonzero((number >= _MIN_COUNT).sum(axis=1) >= 2):
        axis_1, axis_2, diagonal_1, diagonal_2 = (int(configuration) // 5**power % 5 for power in (3, 2, 1, 0))
        agree = np.array([4.0 - axis_1 - axis_2, axis_1, axis_2]) + math.sqrt(0.5) * np.array(
            [4.0 - diagonal_1 - diagonal_2, diagonal_1, diagonal_2]
        )
        for i, j in itertools.combinations(range(3), 2):
            n_i, n_j = (int(number[configuration, label]) for label in (i, j))
            if min(n_i, n_j) >= _MIN_COUNT:
                # E_i - E_j = field_i - field_j - smoothness (agree_i - agree_j)
                rows.append([(i == 1) - (j == 1), (i == 2) - (j == 2), agree[j] - agree[i]])
                values.append(math.log(n_j / n_i))
                weights.append(1.0 / (1.0 / n_i + 1.0 / n_j))
    return (np.array(rows, dtype=np.float64), np.array(values), np.array(weights)) if rows else empty
