"""Minimise a Potts energy over labels of a grid: tree-reweighted message passing, and iterated conditional modes.

    E(x) = sum_s unary[s, x_s] + sum_<s,t> weight_st [x_s != x_t]

over three labels and eight neighbours; a weight for each of the directions right, down-left, down, down-right. TRW-S
after Kolmogorov, IEEE PAMI 28 (2006) 1568-1583, in raster order: every sweep raises (never lowers) a lower bound on the
energy of any labelling, so that the best labels found come with how far from optimal they can be. ICM after Besag, J.
R. Stat. Soc. B 48 (1986).

Messages are a reparametrisation: with M_t the message an edge keeps for the cell t the last pass sent to, the energy
equals the sum over cells of (unary + incoming messages) plus that over edges of (potential - both messages), whatever
the messages are. A backward pass bounds each part below, so the bound holds from any start, the messages of another
problem included.

Among equally good labels the smaller one wins. C and numpy round alike: same operations, same order, no fused ones.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call

N_LABELS = 3  # background, shadow and highlight; equal in C
N_EDGES = 4  # of a pixel to the neighbours that come after it, of eight; equal in C

_EARLIER = ((0, -1), (-1, 1), (-1, 0), (-1, -1))  # of a cell: where the other end of edge e is; later ones are opposite


class Minimum(NamedTuple):
    """Hold the best labels met.

    labels: (n_rows, n_columns) uint8; energy: theirs; lower_bound: no labelling has less.

    trace: (n_sweeps, 2) float64, lower bound and energy of the labels decoded after each sweep made.
    messages: (n_rows + 1, n_columns + 2, 3, 4) float64, a start for the same grid with slightly other costs.
    """

    labels: NDArray[np.uint8]
    energy: float
    lower_bound: float
    trace: NDArray[np.float64]
    messages: NDArray[np.float64]


def trws(
    unary: NDArray[np.float64],
    weight: NDArray[np.float64],
    n_sweeps: int,
    *,
    tolerance: float = 0.0,
    messages: NDArray[np.float64] | None = None,
) -> Minimum:
    """Minimise the energy in at most n_sweeps (>= 1) sweeps, fewer once it is within `tolerance` (>= 0) of its bound.

    Parameters
    ----------
    unary
        (n_rows, n_columns, 3) float64.
    weight
        (4,) float64, right, down-left, down, down-right, not negative.
    messages
        Of an earlier Minimum on a grid of the same shape; zeros without.

    Raises
    ------
    ValueError
        For other shapes, for costs or weights that are not finite, for negative weights and for no sweeps.
    """
    unary, weight = _checked(unary, weight, n_sweeps)
    n_rows, n_columns, _ = unary.shape
    shape = (n_rows + 1, n_columns + 2, N_LABELS, N_EDGES)
    if messages is not None and messages.shape != shape:
        raise ValueError(f"messages must have shape {shape} for this grid, not {messages.shape}")
    start = np.zeros(shape) if messages is None else np.array(messages, dtype=np.float64, order="C")  # updated in place
    labels = np.zeros((n_rows, n_columns), dtype=np.uint8)  # left so where costs are too large to be added up
    scratch = np.empty_like(labels)
    trace = np.empty((n_sweeps, 2))
    done = np.zeros(1, dtype=np.int64)
    if not call("trws", n_rows, n_columns, n_sweeps, tolerance, unary, weight, start, labels, scratch, trace, done):
        return _trws_in_place(unary, weight, n_sweeps, tolerance, start)
    return _minimum(labels, trace[: done[0]], start)


def trws_numpy(
    unary: NDArray[np.float64],
    weight: NDArray[np.float64],
    n_sweeps: int,
    *,
    tolerance: float = 0.0,
    messages: NDArray[np.float64] | None = None,
) -> Minimum:
    """Do as trws, in numpy alone."""
    n_rows, n_columns, _ = unary.shape
    start = np.zeros((n_rows + 1, n_columns + 2, N_LABELS, N_EDGES)) if messages is None else messages.copy()
    return _trws_in_place(unary, weight, n_sweeps, tolerance, start)


def icm(
    unary: NDArray[np.float64], weight: NDArray[np.float64], labels: NDArray[np.uint8], n_sweeps: int
) -> tuple[NDArray[np.uint8], int]:
    """Lower the energy one cell at a time in raster order, from `labels`.

    It ends when nothing changes or n_sweeps (>= 1) are made.

    unary and weight as for trws; labels: (n_rows, n_columns) uint8 of 0, 1, 2. Returns labels (same shape) and the
    sweeps made. Raises ValueError as trws does, and for labels of another shape or above 2.
    """
    unary, weight = _checked(unary, weight, n_sweeps)
    if labels.shape != unary.shape[:2] or (labels.size and labels.max() >= N_LABELS):
        raise ValueError(
            f"labels must be 0, 1 or 2 on a grid of {unary.shape[:2]}, not up to {labels.max(initial=0)} on "
            f"{labels.shape}"
        )
    labels = np.array(labels, dtype=np.uint8, order="C")
    done = np.zeros(1, dtype=np.int64)
    if not call("icm", *labels.shape, n_sweeps, unary, weight, labels, done):
        return icm_numpy(unary, weight, labels, n_sweeps)
    return labels, int(done[0])


def icm_numpy(
    unary: NDArray[np.float64], weight: NDArray[np.float64], labels: NDArray[np.uint8], n_sweeps: int
) -> tuple[NDArray[np.uint8], int]:
    """Do as icm, in numpy alone."""
    n_rows, n_columns, _ = unary.shape
    earlier, later = _edge_weights(n_rows, n_columns, weight)
    padded = np.zeros((n_rows + 2, n_columns + 2), dtype=np.uint8)
    padded[1:-1, 1:-1] = labels
    waves = _waves(n_rows, n_columns)
    done = 0
    for _ in range(n_sweeps):
        changed = 0
        for row, column in waves:
            cost = _against(padded, row, column, earlier[row, column], 1)
            cost = _against(padded, row, column, later[row, column], -1, cost) + unary[row, column]
            best = cost.argmin(axis=1)
            cells = np.arange(len(row))
            moved = cost[cells, best] < cost[cells, padded[row + 1, column + 1]]
            padded[row[moved] + 1, column[moved] + 1] = best[moved]
            changed += int(moved.sum())
        done += 1
        if not changed:
            break
    return padded[1:-1, 1:-1].copy(), done


def energy_of(labels: NDArray[np.uint8], unary: NDArray[np.float64], weight: NDArray[np.float64]) -> float:
    """Compute E(labels); labels (n_rows, n_columns), unary (n_rows, n_columns, 3), weight (4,)."""
    own = np.take_along_axis(unary, labels[:, :, None].astype(np.intp), axis=2).sum()
    pairs = (
        (labels[:, 1:], labels[:, :-1]),
        (labels[1:, :-1], labels[:-1, 1:]),
        (labels[1:], labels[:-1]),
        (labels[1:, 1:], labels[:-1, :-1]),
    )
    return float(own + sum(float(w) * int((a != b).sum()) for w, (a, b) in zip(weight, pairs, strict=True)))


class _Skewed:
    """Lay planes out so that cells that do not see each other are one slice: those of equal column + 2 row, a wave.

    Cell (row, column) stands at [column + 2 row + 3, ..., row + 1]. Neighbours in the same direction of a wave's cells
    are then a slice as well. Places without a cell hold 0 and have edges of no weight, so that nothing comes from them.
    """

    def __init__(self, n_rows: int, n_columns: int) -> None:
        row, column = np.mgrid[:n_rows, :n_columns]
        self.wave, self.at = column + 2 * row + 3, row + 1
        self.waves = range(3, n_columns + 2 * n_rows + 1)
        self.shape = n_columns + 2 * n_rows + 1, n_rows + 2

    def laid_out(self, plane: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lay out (n_rows, n_columns, ...) as (n_waves + 3, ..., n_rows + 2)."""
        out = np.zeros((self.shape[0], *plane.shape[2:], self.shape[1]))
        np.moveaxis(out, -1, 1)[self.wave, self.at] = plane
        return out

    def plane_of(self, laid_out: NDArray[Any]) -> NDArray[Any]:
        """Put what was laid out back into (n_rows, n_columns, ...)."""
        return np.asarray(np.moveaxis(laid_out, -1, 1)[self.wave, self.at])


_HERE = slice(1, -1)
_BEFORE = ((1, _HERE), (1, slice(0, -2)), (2, slice(0, -2)), (3, slice(0, -2)))
"""How many waves before, and where in it, a wave's earlier neighbours stand, in the order of _EARLIER."""


def _trws_in_place(
    unary: NDArray[np.float64],
    weight: NDArray[np.float64],
    n_sweeps: int,
    tolerance: float,
    messages: NDArray[np.float64],
) -> Minimum:
    n_rows, n_columns, _ = unary.shape
    skewed = _Skewed(n_rows, n_columns)
    earlier, later = (skewed.laid_out(each) for each in _edge_weights(n_rows, n_columns, weight))
    chains = np.maximum(*(exists.sum(axis=2) for exists in _edge_exists(n_rows, n_columns)))
    share = skewed.laid_out(1.0 / np.maximum(chains, 1))
    own_costs = skewed.laid_out(unary)
    # (waves, edges, labels, rows)
    sent = skewed.laid_out(messages[1:, 1:-1].swapaxes(2, 3))
    trace: list[tuple[float, float]] = []
    best_labels, best_energy = np.zeros((n_rows, n_columns), dtype=np.uint8), np.inf
    bound = np.zeros(skewed.shape)
    for _ in range(n_sweeps):
        for wave in skewed.waves:
            value = share[wave, _HERE] * _gathered(own_costs, sent, wave) - sent[wave, :, :, _HERE]
            value -= value.min(axis=1, keepdims=True)
            np.minimum(value, later[wave, :, None, _HERE], out=sent[wave, :, :, _HERE])
        for wave in reversed(skewed.waves):
            cost = _gathered(own_costs, sent, wave)
            floor_cost = cost.min(axis=0)
            scaled = share[wave, _HERE] * cost
            from_earlier = [sent[wave - back, e, :, rows] for e, (back, rows) in enumerate(_BEFORE)]
            value = scaled - np.stack(from_earlier)
            minimum = value.min(axis=1, keepdims=True)
            value -= minimum
            np.minimum(value, earlier[wave, :, None, _HERE], out=value)
            for message, new in zip(from_earlier, value, strict=True):
                message[...] = new
            part = minimum[:, 0] - share[wave, _HERE] * floor_cost
            bound[wave, _HERE] = floor_cost + ((part[0] + part[1]) + (part[2] + part[3]))
        labels, energy = _decoded(skewed, own_costs, earlier, sent)
        trace.append((_summed(skewed.plane_of(bound)[::-1, ::-1]), energy))
        if energy < best_energy:
            best_labels, best_energy = labels, energy
        if best_energy - trace[-1][0] <= tolerance:
            break
    messages[1:, 1:-1] = skewed.plane_of(sent).swapaxes(2, 3)
    return _minimum(best_labels, np.array(trace), messages)


def _minimum(labels: NDArray[np.uint8], trace: NDArray[np.float64], messages: NDArray[np.float64]) -> Minimum:
    return Minimum(labels, float(trace[:, 1].min()), float(trace[:, 0].max()), trace, messages)


def _gathered(own_costs: NDArray[np.float64], sent: NDArray[np.float64], wave: int) -> NDArray[np.float64]:
    """Add what a wave's cells cost and all that was sent to them, (3, n_rows)."""
    own = sent[wave, :, :, _HERE]
    later = (own[0] + own[1]) + (own[2] + own[3])
    left, above_right, above, above_left = (sent[wave - back, e, :, rows] for e, (back, rows) in enumerate(_BEFORE))
    cost: NDArray[np.float64] = own_costs[wave, :, _HERE] + later
    cost += (above_right + above) + above_left
    cost += left
    return cost


def _decoded(
    skewed: _Skewed, own_costs: NDArray[np.float64], earlier: NDArray[np.float64], sent: NDArray[np.float64]
) -> tuple[NDArray[np.uint8], float]:
    labels, energy = np.zeros(skewed.shape, dtype=np.uint8), np.zeros(skewed.shape)
    every = np.arange(N_LABELS, dtype=np.uint8)[:, None]
    for wave in skewed.waves:
        own = sent[wave, :, :, _HERE]
        pair = np.zeros(own.shape[1:])
        for e, (back, rows) in enumerate(_BEFORE):
            pair += earlier[wave, e, _HERE] * (labels[wave - back, rows] != every)
        alone = own_costs[wave, :, _HERE] + pair
        label = (alone + ((own[0] + own[1]) + (own[2] + own[3]))).argmin(axis=0)
        labels[wave, _HERE] = label
        energy[wave, _HERE] = np.take_along_axis(alone, label[None], axis=0)[0]
    return skewed.plane_of(labels), _summed(skewed.plane_of(energy))


def _against(
    padded: NDArray[np.uint8],
    row: NDArray[np.intp],
    column: NDArray[np.intp],
    weight: NDArray[np.float64],
    sense: int,
    cost: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    cost = np.zeros((len(row), N_LABELS)) if cost is None else cost
    for e, (down, right) in enumerate(_EARLIER):
        neighbour = padded[row + 1 + sense * down, column + 1 + sense * right]
        cost = cost + weight[:, e, None] * (neighbour[:, None] != np.arange(N_LABELS))
    return cost


def _edge_exists(n_rows: int, n_columns: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Check which earlier and later edges of each cell stay in the grid, (n_rows, n_columns, 4) each."""
    row, column = np.mgrid[:n_rows, :n_columns]
    both = []
    for sense in (1, -1):
        there = [(row + sense * down, column + sense * right) for down, right in _EARLIER]
        both.append(np.stack([(r >= 0) & (r < n_rows) & (c >= 0) & (c < n_columns) for r, c in there], axis=2))
    return both[0], both[1]


def _edge_weights(
    n_rows: int, n_columns: int, weight: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    earlier, later = _edge_exists(n_rows, n_columns)
    return earlier * weight, later * weight


def _waves(n_rows: int, n_columns: int) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    waves = []
    for wave in range(n_columns + 2 * (n_rows - 1)):
        row = np.arange(max(0, (wave - n_columns + 2) // 2), min(n_rows - 1, wave // 2) + 1)
        waves.append((row, wave - 2 * row))
    return waves


def _summed(plane: NDArray[np.float64]) -> float:
    """Sum one term after the other, as the C loop does; numpy's own sum pairs them."""
    return float(np.add.accumulate(plane.ravel())[-1])


def _checked(
    unary: NDArray[np.float64], weight: NDArray[np.float64], n_sweeps: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    unary = np.ascontiguousarray(unary, dtype=np.float64)
    weight = np.ascontiguousarray(weight, dtype=np.float64)
    if unary.ndim != 3 or unary.shape[2] != N_LABELS or unary.size == 0:
        raise ValueError(
            f"unary must have shape (n_rows, n_columns, {N_LABELS}) with at least one cell, not {unary.shape}"
        )
    if weight.shape != (N_EDGES,) or not (np.isfinite(weight).all() and weight.min() >= 0.0):
        raise ValueError(f"weight must be {N_EDGES} finite numbers that are not negative, not {weight}")
    if not np.isfinite(unary).all():
        raise ValueError("unary holds NaN or infinity; use 0 for every label of a cell without data")
    if n_sweeps < 1:
        raise ValueError(f"n_sweeps must be at least 1, not {n_sweeps}")
    return unary, weight
