"""Minimise a Potts energy of a grid by alpha expansion on scipy's maximum flow, as a user would without our kernels.

Boykov, Veksler and Zabih, IEEE PAMI 23 (2001) 1222-1239.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from auv_mcm.kernels.trws import energy_of

_STEPS_PER_COST: Final = 1000  # scipy's flow takes whole numbers: costs are rounded to a thousandth
_EDGES: Final = ((0, 1), (1, -1), (1, 0), (1, 1))  # rows and columns on, in the order of the kernel's weights


def expanded(unary: NDArray[np.float64], weight: NDArray[np.float64], max_rounds: int = 5) -> NDArray[np.uint8]:
    """Expand each label in turn until no round lowers the energy; (n_rows, n_columns) uint8.

    Parameters
    ----------
    unary
        (n_rows, n_columns, n_labels), the cost of each label.
    weight
        (4,), of the edges right, down-left, down, down-right.
    max_rounds
        After which it ends in any case.
    """
    labels = np.asarray(unary.argmin(axis=2), dtype=np.uint8)
    best = energy_of(labels, unary, weight)
    for _ in range(max_rounds):
        before = best
        for alpha in range(unary.shape[2]):
            tried = _one_expansion(unary, weight, labels, alpha)
            energy = energy_of(tried, unary, weight)
            if energy < best:
                labels, best = tried, energy
        if best >= before:
            break
    return labels


def _one_expansion(
    unary: NDArray[np.float64], weight: NDArray[np.float64], labels: NDArray[np.uint8], alpha: int
) -> NDArray[np.uint8]:
    """Cut once: cells on the sink's side take alpha. Edges of unlike labels add to the cells' own costs.

    Of cells p and q, the energy of an edge is A where both stay, B where q alone takes alpha, C where p alone does, and
    0 where both do (Kolmogorov and Zabih, IEEE PAMI 26, 2004).
    """
    n_rows, n_columns = labels.shape
    cell = np.arange(labels.size).reshape(labels.shape)
    stay = np.take_along_axis(unary, labels[:, :, np.newaxis].astype(np.intp), axis=2)[:, :, 0].ravel().copy()
    take = unary[:, :, alpha].ravel().copy()
    heads, tails, capacities = [], [], []
    for (down, right), cost in zip(_EDGES, weight.tolist(), strict=True):
        first = (slice(0, n_rows - down), slice(max(-right, 0), n_columns - max(right, 0)))
        second = (slice(down, n_rows), slice(max(right, 0), n_columns + min(right, 0)))
        p, q = cell[first].ravel(), cell[second].ravel()
        at_p, at_q = labels[first].ravel(), labels[second].ravel()
        both, q_alone, p_alone = cost * (at_p != at_q), cost * (at_p != alpha), cost * (at_q != alpha)
        np.add.at(stay, p, both - p_alone)
        np.add.at(stay, q, p_alone)
        heads.append(p)
        tails.append(q)
        capacities.append(q_alone + p_alone - both)
    least = np.minimum(stay, take)
    n = labels.size
    # A cell with the source stays; the edge that is cut then is the one to the sink, of the cost of staying.
    rows = np.concatenate([np.full(n, n), np.arange(n), *heads])
    columns = np.concatenate([np.arange(n), np.full(n, n + 1), *tails])
    values = np.rint(np.concatenate([take - least, stay - least, *capacities]) * _STEPS_PER_COST).astype(np.int32)
    graph = csr_array((values, (rows, columns)), shape=(n + 2, n + 2))
    left = graph - maximum_flow(graph, n, n + 1).flow
    left.data[left.data < 0] = 0
    left.eliminate_zeros()
    reached = np.zeros(n + 2, dtype=np.bool_)
    reached[breadth_first_order(left, n, return_predecessors=False)] = True
    return np.where(reached[:n].reshape(labels.shape), labels, np.uint8(alpha)).astype(np.uint8)
