"""Move borders of a label field to where an image of finite resolution has them.

The mean intensity a sonar shows is the mean of each label smeared by the point-spread function: m = spread * level[x].
Under exponential speckle the cost of labels x is

    information sum_s (ln m_s + I_s / m_s) + sum_<s,t> weight_st [x_s != x_t]

A likelihood without the smearing puts the border of a shadow near the geometric mean of shadow and sea floor,
inside the true one by about the spread. Lowered here one pixel at a time, in raster order there and back; only pixels
beside another label change, to one of the labels beside them, and only if the cost falls.

C and numpy round alike: same operations, same order, no fused ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call

Plane = NDArray[np.float64]
Labels = NDArray[np.uint8]

_REACH: Final = 2.5  # of the point spread, in its sigmas
# rows down and columns right of each of the eight, in the order of the weights; equal in C
_NEIGHBOURS: Final = ((0, 1), (1, -1), (1, 0), (1, 1), (0, -1), (-1, 1), (-1, 0), (-1, -1))


def point_spread(sigma: float) -> Plane:
    """Sample a Gaussian of 1-sigma `sigma` pixels, cut at 2.5 sigma, its sum 1.

    (2 reach + 1,) float64; just 1 for sigma 0.
    """
    reach = math.ceil(_REACH * sigma)
    if reach == 0:
        return np.ones(1)
    spread = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return np.asarray(spread / spread.sum())


def smeared(plane: Plane, spread_rows: Plane, spread_columns: Plane) -> Plane:
    """Smear a plane (n_rows, n_columns) along both axes; beyond its edges it goes on as at the edge.

    Parameters
    ----------
    spread_rows, spread_columns
        (n,) float64 with odd n, the share of each neighbour.
    """
    between, found = (np.empty(plane.shape) for _ in range(2))
    edge, spreads = np.empty(plane.shape[1] + len(spread_columns)), (spread_rows, spread_columns)
    given = [part for spread in spreads for part in (len(spread), spread)]
    if plane.size == 0 or not call("smear", *plane.shape, plane, *given, between, edge, found):
        return smeared_numpy(plane, spread_rows, spread_columns)
    return found


def smeared_numpy(plane: Plane, spread_rows: Plane, spread_columns: Plane) -> Plane:
    """Do as smeared, in numpy alone."""
    n_rows, n_columns = plane.shape
    rows, columns = (
        np.arange(-(len(spread) // 2), n + len(spread) // 2)
        for n, spread in ((n_rows, spread_rows), (n_columns, spread_columns))
    )
    padded = plane.take(rows, axis=0, mode="clip")
    plane = _added_up([padded[k : k + n_rows] for k in range(len(spread_rows))], spread_rows)
    padded = plane.take(columns, axis=1, mode="clip")
    return _added_up([padded[:, k : k + n_columns] for k in range(len(spread_columns))], spread_columns)


def _added_up(planes: list[Plane], shares: Plane) -> Plane:
    total: Plane = shares[0] * planes[0]
    part = np.empty_like(total)
    for plane, share in zip(planes[1:], shares[1:], strict=True):
        total += np.multiply(plane, share, out=part)
    return total


def soft_edges(
    intensity: Plane,
    usable: NDArray[np.bool_],
    labels: Labels,
    *,
    level: Plane,
    spread_rows: Plane,
    spread_columns: Plane,
    weight: Plane,
    information: float,
    n_sweeps: int,
) -> Labels:
    """Improve the labels in n_sweeps (>= 1) sweeps or fewer, until nothing changes; (n_rows, n_columns) uint8.

    Parameters
    ----------
    intensity
        (n_rows, n_columns) float64, not negative.
    usable
        Same shape bool, False for no data.
    labels
        Same shape uint8 of 0, 1, 2.
    level
        (3,) float64 > 0, mean intensity of each label.
    spread_rows, spread_columns
        Point spread along each axis, odd length.
    weight
        (4,) right, down-left, down, down-right.
    information
        Independent samples per pixel.

    Raises
    ------
    ValueError
        For shapes that do not fit, levels that are not positive, labels above 2.
    """
    start = _prepared(intensity, usable, labels, level, spread_rows, spread_columns, weight)
    scratch, done = np.empty((6, len(spread_rows), len(spread_columns))), np.zeros(1, dtype=np.int64)
    settled = np.zeros(labels.shape, dtype=np.uint8)
    numbers = *labels.shape, len(spread_rows) // 2, len(spread_columns) // 2, n_sweeps, information
    if not call("soft_edges", *numbers, *start[:4], level, weight, start.labels, scratch, settled, done):
        return _soft_edges_in_place(start, level, weight, information, n_sweeps)
    return start.labels


def soft_edges_numpy(
    intensity: Plane,
    usable: NDArray[np.bool_],
    labels: Labels,
    *,
    level: Plane,
    spread_rows: Plane,
    spread_columns: Plane,
    weight: Plane,
    information: float,
    n_sweeps: int,
) -> Labels:
    """Do as soft_edges, in numpy alone."""
    start = _prepared(intensity, usable, labels, level, spread_rows, spread_columns, weight)
    return _soft_edges_in_place(start, level, weight, information, n_sweeps)


class _Start(NamedTuple):
    """Hold planes with room for the point spread, the mean that goes with the labels, and a copy of the labels."""

    data: Plane
    measured: Plane
    mean: Plane
    spread: Plane
    labels: Labels


def _prepared(
    intensity: Plane,
    usable: NDArray[np.bool_],
    labels: Labels,
    level: Plane,
    spread_rows: Plane,
    spread_columns: Plane,
    weight: Plane,
) -> _Start:
    if not intensity.shape == usable.shape == labels.shape or intensity.ndim != 2 or intensity.size == 0:
        raise ValueError(
            f"intensity, usable and labels must have one 2-d shape, not {intensity.shape}, {usable.shape}, "
            f"{labels.shape}"
        )
    if level.shape != (3,) or not (np.isfinite(level).all() and level.min() > 0.0) or labels.max() > 2:
        raise ValueError(
            f"labels must be 0, 1 or 2 and level three positive numbers, not up to {labels.max()} and {level}"
        )
    if len(spread_rows) % 2 == 0 or len(spread_columns) % 2 == 0 or weight.shape != (4,):
        raise ValueError("a point spread must have an odd number of values, and weight four")
    reach_rows, reach_columns = len(spread_rows) // 2, len(spread_columns) // 2
    shape = labels.shape[0] + 2 * reach_rows, labels.shape[1] + 2 * reach_columns
    inner = slice(reach_rows, reach_rows + labels.shape[0]), slice(reach_columns, reach_columns + labels.shape[1])
    data, measured, mean = np.zeros(shape), np.zeros(shape), np.ones(shape)
    data[inner] = np.where(usable, intensity, 0.0)
    measured[inner] = usable
    mean[inner] = np.where(usable, smeared(level[labels], spread_rows, spread_columns), 1.0)
    spread = np.outer(spread_rows, spread_columns)
    return _Start(data, measured, mean, spread, np.array(labels, dtype=np.uint8, order="C"))


def _soft_edges_in_place(start: _Start, level: Plane, weight: Plane, information: float, n_sweeps: int) -> Labels:
    data, measured, mean, spread, labels = start
    n_rows, n_columns = labels.shape
    high, wide = spread.shape
    # Nearly every pixel lies among its own label: only the others are visited.
    padded = np.pad(labels, 1, mode="edge")
    views = [padded[1 + down : 1 + down + n_rows, 1 + right : 1 + right + n_columns] for down, right in _NEIGHBOURS]
    near = np.logical_or.reduce([view != labels for view in views])
    for sweep in range(n_sweeps):
        changed = False
        for step in _true_places(near.ravel()[:: -1 if sweep % 2 else 1]):
            row, column = divmod(labels.size - 1 - step if sweep % 2 else step, n_columns)
            own = int(labels[row, column])
            alike = [0.0, 0.0, 0.0]
            for n, (down, right) in enumerate(_NEIGHBOURS):
                if 0 <= row + down < n_rows and 0 <= column + right < n_columns:
                    alike[labels[row + down, column + right]] += float(weight[n % 4])
            window = (slice(row, row + high), slice(column, column + wide))
            local = spread * measured[window]
            best, best_label = 0.0, own
            for label in range(3):
                if label == own or alike[label] == 0.0:
                    continue
                rise = float(level[label] - level[own])
                change = alike[own] - alike[label] + information * _data_change(data[window], mean[window], local, rise)
                if change < best:
                    best, best_label = change, label
            if best_label != own:
                mean[window] += float(level[best_label] - level[own]) * local
                labels[row, column] = best_label
                near[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2] = True
                changed = True
        if not changed:
            break
    return labels


def _true_places(mask: NDArray[np.bool_]) -> Iterator[int]:
    """List where the mask is True, in order; places ahead that become True meanwhile are included."""
    at = 0
    while at < mask.size:
        at += int(mask[at:].argmax())
        if not mask[at]:
            return
        yield at
        at += 1


def _data_change(data: Plane, before: Plane, local: Plane, rise: float) -> float:
    after = before + rise * local
    product = np.multiply.accumulate(after / before, axis=1)[:, -1]
    linear = np.add.accumulate(data * (1.0 / after - 1.0 / before), axis=1)[:, -1]
    total = 0.0
    for one, other in zip(product, linear, strict=True):
        total += math.log(one) + float(other)
    return total
