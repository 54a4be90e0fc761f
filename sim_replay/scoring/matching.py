"""Match contacts with objects: one-to-one by distance, for every threshold of p_mine.

Matching is done anew for each threshold, over the contacts that reach it. A match made once with all contacts would let
a weak contact that lies nearer take an object from a strong one, and the object would count as missed wherever the weak
one is not called.

Detections, duplicates and false alarms then never fall as the threshold falls. Against the best matching before, the
best one with further contacts differs only along alternating paths that start at a new contact: such a path ends at an
object that was free, or at a contact that gives its place away. No object loses its match, and no contact left over
finds one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

SIGMAS: Final = 3.0  # of a contact's position, that widen the gate
MAX_SIGMA_GATE_M: Final = 4.0  # m: a contact that knows its place no better does not get a wider gate
UNMATCHED: Final = -1  # instead of an index
_STAY_M: Final = 1e-6  # between equal distances, who was matched stays matched


def gates_m(gate_m: float, sigma_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute each contact's maximum distance of a match, m: 3 sigma up to 4 m, and never less than `gate_m`.

    NaN sigma: `gate_m`.
    """
    return np.fmax(gate_m, np.minimum(SIGMAS * sigma_m, MAX_SIGMA_GATE_M))


def match_by_threshold(
    near: NDArray[np.bool_], distance_m: NDArray[np.float64], p_mine: NDArray[np.float64]
) -> Iterator[tuple[float, NDArray[np.int64]]]:
    """Iterate over each distinct p_mine, falling: that threshold, and per contact the index of its object.

    `near` and `distance_m` are (n_contacts, n_objects), `near` where a match is allowed; `p_mine` is (n_contacts,).
    What comes back is (n_contacts,), -1 for contacts below the threshold or left over: as many matches as can be, with
    the least sum of distances among those (Kuhn, "The Hungarian method for the assignment problem", 1955).
    """
    contact_group, object_group = _groups(near)
    matched = np.full(len(p_mine), UNMATCHED, dtype=np.int64)
    for threshold in np.unique(p_mine)[::-1].tolist():
        called = p_mine >= threshold
        for group in np.unique(contact_group[(p_mine == threshold) & near.any(axis=1)]):
            contacts, objects = np.flatnonzero(called & (contact_group == group)), np.flatnonzero(object_group == group)
            place = np.ix_(contacts, objects)
            matched[contacts] = _best(near[place], distance_m[place], objects, matched[contacts])
        yield threshold, matched.copy()


def _best(
    near: NDArray[np.bool_], distance_m: NDArray[np.float64], objects: NDArray[np.int64], before: NDArray[np.int64]
) -> NDArray[np.int64]:
    from scipy.optimize import linear_sum_assignment

    # A pair out of gate costs more than all distances together, so that it is taken only where nothing is left.
    out_of_gate = 1.0 + min(near.shape) * float(distance_m[near].max())
    cost = np.where(near, distance_m - _STAY_M * (before[:, None] == objects), out_of_gate)
    matched = np.full(len(before), UNMATCHED, dtype=np.int64)
    for contact, place in zip(*linear_sum_assignment(cost), strict=True):
        if near[contact, place]:
            matched[contact] = objects[place]
    return matched


def _groups(near: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number the sets of contacts and objects that gates link with each other, per contact and per object."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n_contacts, n_objects = near.shape
    contacts, objects = np.nonzero(near)
    n_nodes = n_contacts + n_objects
    links = coo_array((np.ones(len(contacts)), (contacts, n_contacts + objects)), shape=(n_nodes, n_nodes))
    _, group = connected_components(links, directed=False)
    return group[:n_contacts].astype(np.int64), group[n_contacts:].astype(np.int64)
