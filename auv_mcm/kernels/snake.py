"""Move a highlight and a shadow polygon together until a description length stops falling.

Both polygons are lists of (row, column) nodes in pixels, pixel (r, k) covering [r, r + 1) x [k, k + 1). A pixel is
inside if its centre is, half-open on both axes. Sums over the inside come from row cumulative sums at the columns where
edges cross row centres, so a moved node costs as much as its two edges are high, whatever the area (Chesnaud, Refregier
and Boulet, IEEE PAMI 21(11), 1999). As an object's highlight and shadow are one interval in each ping, every row
crosses a polygon at most twice.

The criterion, in nats, is a description length after Martin, Refregier, Galland and Guerault (2006) and Ruch and
Refregier (2001):

    J = sum over highlight, shadow and what is left of the window of  N (ln mu + mean / mu - 1) / A_c + 1/2 ln(N / A_c)
      + for each polygon of n nodes with mean |difference| of rows m_r and of columns m_c between neighbours
        ln(N_window / A_c) + 2 ln n + n (2 ln 2e + ln(m_r m_c / A_c)), the last product at least 1/4
      + cooperation

The first term is the negative log-likelihood of single-look speckle. mu is the region's mean, or the bound where a
highlight is dimmer or a shadow brighter than objects show: neither expands over sea floor that merely differs a little.
A_c, the speckle's correlation area in pixels, makes everything count independent samples instead of pixels.
Cooperation penalises along-track extents that differ, a gap between highlight and shadow, and a shadow too long for the
height of a mine (`Settings`); it forbids overlap and a shadow that starts nearer than the highlight.

Intensities are divided by the window's mean and rounded to 2^-20 of it. Sums are then exact in any order, and C and the
Python twin take the same decisions to the last bit.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels import snake_criterion, snake_twin
from auv_mcm.kernels.order import median
from auv_mcm.kernels.signatures import call
from auv_mcm.kernels.snake_criterion import EdgeSums, Settings
from auv_mcm.kernels.snake_twin import Moved

MAX_NODES: Final = 64  # of a polygon; equal in C, where it bounds memory
NAMES: Final = ("highlight", "shadow")
QUANTUM: Final = 2.0**-20
"""Intensities are whole multiples of this part of the window's mean."""
# times the median: brighter than any highlight; brighter pixels would outweigh the rest of the window
_SPIKE: Final = 1e3
_BRIGHTEST: Final = 1e6  # times the window's mean; keeps sums over any window within 2^53 quanta
_STEPS_PER_PX: Final = 16.0  # sixteenths of a pixel, exact in binary, so that C and numpy move alike
_NODES_PER_PX: Final = 2.0**20  # sums of coordinates, and halves of edges, stay exact
_NONE: Final = np.empty((0, 2))
_NO_STAGES: Final = np.empty((0, 3))


class WindowRowSums(NamedTuple):
    """Hold cumulative sums along rows of a window.

    table: (n_rows, n_columns + 1, 2) float64, table[r, k] = sum over columns below k of (intensity over its mean, 1)
    where valid. mean: of the valid intensities, 0 if there are none or no echo among them; the table's intensities are
    then 0. Both of intensities cut at 1000 times their median, unless that is 0.
    """

    table: NDArray[np.float64]
    mean: float


def window_row_sums(intensity: NDArray[np.float64], valid: NDArray[np.bool_]) -> WindowRowSums:
    """Sum the rows of a (n_rows, n_columns) window.

    Pixels that are not valid, or hold no finite number >= 0, count as not measured.
    """
    counted = valid & (intensity >= 0.0) & (intensity < np.inf)
    measured = np.where(counted, intensity, 0.0)
    n_counted = int(counted.sum())
    level = median(measured[counted]) if n_counted else 0.0
    if level > 0.0:
        measured = np.minimum(measured, _SPIKE * level)
    highest = float(measured.max(initial=0.0))
    table = np.zeros((intensity.shape[0], intensity.shape[1] + 1, 2))
    np.cumsum(counted, axis=1, out=table[:, 1:, 1])
    if highest <= 0.0:
        return WindowRowSums(table, 0.0)
    relative_mean = float((measured / highest).sum()) / n_counted  # no overflow, no denormals, whatever the gain
    normalised = np.minimum(measured / highest / relative_mean, _BRIGHTEST)
    np.cumsum(np.rint(normalised / QUANTUM) * QUANTUM, axis=1, out=table[:, 1:, 0])
    return WindowRowSums(table, highest * relative_mean)


def move_pair(
    table: NDArray[np.float64],
    settings: Settings,
    schedule: NDArray[np.float64],
    highlight: NDArray[np.float64],
    shadow: NDArray[np.float64],
) -> Moved:
    """Move the pair through all stages of the schedule.

    Nodes are rounded to 2^-20 pixel.

    Parameters
    ----------
    table
        Of `window_row_sums`.
    schedule
        (n_stages, 3) float64, each row the number of nodes to subdivide to, the length of moves in pixels (whole
        multiples of 1/16) and how many sweeps at most; length 0 prunes nodes instead.
    highlight, shadow
        (n, 2) float64 nodes inside the window, from the near upper corner over the far one on; (0, 2) for a polygon
        that does not exist.

    Raises
    ------
    ValueError
        If shapes do not fit, a polygon has 1, 2 or more than 64 nodes, lies outside the window, holds no measured pixel
        or fewer than settings.min_area_px, or is not simple and crossed twice by each row.
    """
    table = np.ascontiguousarray(table, dtype=np.float64)
    schedule = np.ascontiguousarray(schedule, dtype=np.float64)
    parts = checked(table, schedule, highlight, shadow)
    ran = _ran(table, settings, schedule, parts)
    if ran is None:
        refuse([snake_twin.fault_of(table, settings, nodes) for nodes in parts], settings)
        return snake_twin.move_pair(table, settings, schedule, parts[0], parts[1])
    refuse(ran.faults, settings)
    return moved_of(ran.nodes, ran.n_nodes, ran.out)


def checked(
    table: NDArray[np.float64],
    schedule: NDArray[np.float64],
    highlight: NDArray[np.float64],
    shadow: NDArray[np.float64],
) -> list[NDArray[np.float64]]:
    """Round the nodes of both polygons to 2^-20 pixel.

    Raises ValueError as move_pair does, but for polygons that cannot be moved.
    """
    parts = [
        np.rint(np.asarray(nodes, dtype=np.float64) * _NODES_PER_PX) / _NODES_PER_PX for nodes in (highlight, shadow)
    ]
    _check(table, schedule, parts)
    if len(parts[0]) + len(parts[1]) == 0:
        raise ValueError("there is neither a highlight nor a shadow to move")
    return parts


def moved_of(nodes: NDArray[np.float64], n_nodes: list[int], out: list[float]) -> Moved:
    """Take apart what C leaves.

    Nodes (2, MAX_NODES, 2), their numbers, and criterion, moves, proposals and both sums.
    """
    n_sums = len(EdgeSums._fields)
    return Moved(
        nodes[0, : n_nodes[0]].copy(),
        nodes[1, : n_nodes[1]].copy(),
        out[0],
        int(out[1]),
        int(out[2]),
        EdgeSums(*out[3 : 3 + n_sums]),
        EdgeSums(*out[3 + n_sums :]),
    )


def fault_of(table: NDArray[np.float64], settings: Settings, nodes: NDArray[np.float64]) -> int:
    """Find what keeps a polygon (n, 2) from being moved.

    0 nothing, 1 too small, clockwise or not measured, 2 not sound.

    table, settings and nodes as move_pair has them. Raises ValueError for shapes that do not fit and nodes outside the
    window.
    """
    table = np.ascontiguousarray(table, dtype=np.float64)
    _check(table, _NO_STAGES, [nodes])
    ran = _ran(table, settings, _NO_STAGES, [nodes, _NONE])
    return snake_twin.fault_of(table, settings, nodes) if ran is None else ran.faults[0]


def sides(nodes: NDArray[np.float64], n_rows: int, n_columns: int) -> NDArray[np.int64]:
    """Find the columns at which a polygon's near and far side cross each row, (2, n_rows) int64; -1 where they do not.

    nodes: (n, 2) float64, finite. The near side runs up; of a polygon that crosses a row more than twice the last edge
    counts. Raises ValueError for nodes of another shape.
    """
    nodes = np.ascontiguousarray(nodes, dtype=np.float64)
    if nodes.ndim != 2 or nodes.shape[1] != 2:
        raise ValueError(f"nodes must have shape (n, 2), not {nodes.shape}")
    found = np.empty((2, n_rows), dtype=np.int64)
    if not call("snake_sides", n_rows, n_columns, len(nodes), nodes, found):
        return sides_numpy(nodes, n_rows, n_columns)
    return found


def sides_numpy(nodes: NDArray[np.float64], n_rows: int, n_columns: int) -> NDArray[np.int64]:
    """Do as sides, in numpy alone."""
    found = np.full((2, n_rows), -1, dtype=np.int64)
    for a, b in zip(nodes, np.roll(nodes, -1, axis=0), strict=True):
        rows, columns = snake_criterion.crossings(a, b, n_rows, n_columns)
        found[int(b[0] > a[0]), rows] = columns
    return found


class _Ran(NamedTuple):
    """Hold what the C function left of both polygons."""

    nodes: NDArray[np.float64]
    n_nodes: list[int]
    out: list[float]
    faults: list[int]


def _ran(
    table: NDArray[np.float64], settings: Settings, schedule: NDArray[np.float64], parts: list[NDArray[np.float64]]
) -> _Ran | None:
    """Move polygons in C; None where the twin serves."""
    room = np.zeros((2, MAX_NODES, 2))
    n_nodes = np.array([len(nodes) for nodes in parts], dtype=np.int64)
    for which, nodes in enumerate(parts):
        room[which, : len(nodes)] = nodes
    bound, out, faults = np.empty(len(table)), np.empty(3 + 2 * len(EdgeSums._fields)), np.empty(2, dtype=np.int64)
    numbers = np.array(settings, dtype=np.float64)
    shape = table.shape[0], table.shape[1] - 1
    if not call("snake", *shape, table, numbers, len(schedule), schedule, *room, n_nodes, bound, out, faults):
        return None
    return _Ran(room, n_nodes.tolist(), out.tolist(), faults.tolist())


def _check(table: NDArray[np.float64], schedule: NDArray[np.float64], parts: list[NDArray[np.float64]]) -> None:
    if table.ndim != 3 or table.shape[1] < 2 or table.shape[2] != 2:
        raise ValueError(
            f"table must have shape (n_rows, n_columns + 1, 2) as window_row_sums makes it, not {table.shape}"
        )
    if schedule.ndim != 2 or schedule.shape[1] != 3 or not ((schedule >= 0.0) & (schedule <= MAX_NODES)).all():
        raise ValueError(f"schedule must hold rows of (nodes, pixels, sweeps), each 0 to {MAX_NODES}")
    if (np.rint(schedule[:, 1] * _STEPS_PER_PX) != schedule[:, 1] * _STEPS_PER_PX).any():
        raise ValueError("lengths of moves in the schedule must be whole multiples of 1/16 pixel")
    window = table.shape[0], table.shape[1] - 1
    for name, nodes in zip(NAMES, parts, strict=False):
        if nodes.ndim != 2 or nodes.shape[1] != 2 or len(nodes) in (1, 2) or len(nodes) > MAX_NODES:
            raise ValueError(f"{name} must have shape (n, 2) with 3 to {MAX_NODES} nodes or none, not {nodes.shape}")
        if len(nodes) and not (
            nodes.min() >= 0.0 and nodes[:, 0].max() <= window[0] and nodes[:, 1].max() <= window[1]
        ):
            raise ValueError(f"{name} has nodes outside the window of {window[0]} rows and {window[1]} columns")


def refuse(faults: list[int], settings: Settings) -> None:
    """Raise ValueError for polygons that cannot be moved. faults: of highlight and shadow, as fault_of gives them."""
    why = {
        1: f"covers fewer than {settings.min_area_px:g} pixels, none that was measured, or runs up its far side",
        2: "crosses itself, has coinciding nodes, or is crossed more than twice by a row",
    }
    for name, fault in zip(NAMES, faults, strict=True):
        if fault:
            raise ValueError(f"{name} {why[fault]}")
