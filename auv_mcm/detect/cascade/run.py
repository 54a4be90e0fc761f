"""Run a cascade over a tile: group by group on the windows still alive, within a fixed number of evaluations.

One evaluation is one stump on one window. The first groups, up to OPENING_STUMPS stumps, score all windows and rank
them; then the best-ranked windows go through the rest of the cascade before others start. So the evaluations of a
window never depend on worse ones: with a larger budget all windows are finished that were with a smaller one, and more.
A budget that does not even cover the opening finishes none. Evaluations, not seconds, are counted, so that every
computer comes to the same result.
"""

from __future__ import annotations

import functools
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.bands import N_BANDS, WINDOW, areas, band_edges, bands_at, pixel_boxes
from auv_mcm.detect.cascade.codes import MAX_BOX_PX, CodePlane, plane_of_tile
from auv_mcm.detect.cascade.model import CascadeModel
from auv_mcm.errors import UsageError
from auv_mcm.kernels.cascade import STUMP, Tables, WindowField, Windows, corners, open_windows, rank, run_groups
from auv_mcm.records import Tile

OPENING_STUMPS: Final = 16
"""Windows are ranked after the last group that ends within this number of stumps, or after the first group."""
MARGIN_M: Final = 1.0
"""How far beyond a tile's core windows are centred, so that a peak in the core is compared with all its neighbours."""

_MIN_SHARE: Final = (3, 5)  # of a window that must be valid
_SLICES: Final = 1024  # of the ranked windows, the last of which are not started if they might not be finished


class CascadeResult(NamedTuple):
    """Hold the windows that passed the whole cascade, by row and column.

    Tile-local rows, columns (n,) int32 and final scores (n,) int32.

    n_windows: that there are in the tile. n_evaluations: made, never more than the budget. n_cut: windows dropped
    because the budget was used up; evaluated_fraction: of the windows, the others. n_alive: after each group.
    n_rejected: windows that it rejected before its last group.
    """

    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    scores: NDArray[np.int32]
    n_windows: int
    n_evaluations: int
    n_cut: int
    evaluated_fraction: float
    n_alive: tuple[int, ...]
    n_rejected: int


def core_plane(tile: Tile) -> CodePlane:
    """Make a tile's plane with windows in its core and MARGIN_M around it.

    Windows are centred on pixels that are VALID and not LOW_RESOLUTION.
    """
    margin = round(MARGIN_M / tile.row_spacing_m) + 1
    return plane_of_tile(
        tile, slice(max(tile.core_start - margin, 0), min(tile.core_stop + margin, tile.mask.shape[0]))
    )


def run_plane(plane: CodePlane, model: CascadeModel, max_evaluations: int | None) -> CascadeResult:
    """Run a model over a plane; max_evaluations: the budget, None for none.

    A window is centred on each pixel where the plane is usable that has at least 0.6 of the window around it valid.
    Raises UsageError if the plane's pixels are too fine for exact sums.
    """
    run = _Run(plane, model, max_evaluations)
    n_windows, opened, n_cut = run.open()
    finished, n_late = run.finish(opened)
    n_cut += n_late
    order = np.argsort(finished.place)
    rows, columns = np.divmod(finished.place[order] - run.corner, np.int32(plane.sums.shape[1]))
    return CascadeResult(
        rows=rows,
        columns=columns,
        scores=finished.score[order],
        n_windows=n_windows,
        n_evaluations=run.n_evaluations,
        n_cut=n_cut,
        evaluated_fraction=1.0 - n_cut / max(n_windows, 1),
        n_alive=tuple(run.n_alive.tolist()),
        n_rejected=n_windows - n_cut - run.n_in_last,
    )


def trace_plane(
    plane: CodePlane, model: CascadeModel, rows: NDArray[np.integer], columns: NDArray[np.integer]
) -> NDArray[np.int32]:
    """Score the windows at rows, columns (n_windows,) after each group, none dropped: (n_windows, n_groups) int32."""
    stride = plane.sums.shape[1]
    tables = tables_of(model, plane.row_spacing_m, plane.column_spacing_m, stride)
    groups = tables.groups.copy()
    groups[:, 1] = np.iinfo(np.int32).min
    tables = tables._replace(groups=groups)
    edges = band_edges(plane.first_return_m, plane.n_columns, plane.column_spacing_m, model.reference_height_m)
    place, which = np.unique(
        ((rows + plane.margin_rows) * stride + columns + plane.margin_near).astype(np.int32), return_inverse=True
    )
    at = np.empty((2, place.size), dtype=np.intp)
    at[:, which] = rows, columns
    bands = bands_at(edges, at[0], at[1])
    by_band = np.argsort(bands, kind="stable")
    windows = Windows(
        place[by_band], np.zeros_like(place), np.cumsum(np.bincount(bands, minlength=N_BANDS)).astype(np.int64)
    )
    scores = np.empty((place.size, len(groups)), dtype=np.int32)
    for group in range(len(groups)):
        windows, _ = run_groups(plane.sums, tables, windows, group, group + 1)
        scores[by_band, group] = windows.score
    return np.asarray(scores[which])


def opening_groups(model: CascadeModel) -> int:
    """Count the groups before windows are ranked."""
    stops = np.cumsum([len(group) for group in model.groups])
    return max(1, int(np.searchsorted(stops, OPENING_STUMPS, side="right")))


@functools.lru_cache(maxsize=8)
def tables_of(model: CascadeModel, row_spacing_m: float, column_spacing_m: float, stride: int) -> Tables:
    """Convert a model's boxes to offsets into integral images with rows of `stride`.

    Raises UsageError if a box has too many pixels.
    """
    stumps = [stump for group in model.groups for stump in group]
    boxes = [box for stump in stumps for box in (stump.a, stump.b, stump.a if stump.w is None else stump.w)]
    boxes_px = pixel_boxes([*boxes, WINDOW], row_spacing_m, column_spacing_m)
    n_px = areas(boxes_px)
    if n_px.max() > MAX_BOX_PX:
        raise UsageError(
            f"pixels of {row_spacing_m} x {column_spacing_m} m: a box of the cascade has {n_px.max()}, but only sums "
            f"over {MAX_BOX_PX} are exact; use coarser pixels"
        )
    shape = (len(boxes_px), len(stumps))
    contrast = np.array([stump.kind == "contrast" for stump in stumps])
    threshold = np.array([stump.threshold for stump in stumps])
    per_px = 1.0 / n_px[:, :-1].reshape(*shape, 3)
    table = np.zeros(shape, dtype=STUMP)
    table["offset"] = corners(boxes_px[:, :-1], stride).reshape(*shape, 3, 4)
    factors = np.stack(
        (np.ones_like(threshold), np.where(contrast, 1.0, threshold), np.where(contrast, threshold, 0.0)), axis=-1
    )
    table["weight"] = per_px * factors
    table["leaf"] = [(stump.above, stump.below) for stump in stumps]
    table["contrast"] = contrast
    stops = np.cumsum([len(group) for group in model.groups])
    numerator, denominator = _MIN_SHARE
    return Tables(
        stumps=table,
        groups=np.array(list(zip(stops, model.reject, strict=True)), dtype=np.int32),
        window=corners(boxes_px[:, -1], stride),
        least=(numerator * n_px[:, -1] + denominator - 1) // denominator,
        restart=model.kind == "stages",
    )


class _Run:
    """Run a model over a plane and keep count: evaluations made, windows alive after each group and in the last one."""

    def __init__(self, plane: CodePlane, model: CascadeModel, max_evaluations: int | None) -> None:
        stride = plane.sums.shape[1]
        self.corner = plane.margin_rows * stride + plane.margin_near
        self.n_evaluations = self.n_in_last = 0
        self.n_alive = np.zeros(len(model.groups), dtype=np.int64)
        self._plane = plane
        self._tables = tables_of(model, plane.row_spacing_m, plane.column_spacing_m, stride)
        self._edges = band_edges(
            plane.first_return_m, plane.n_columns, plane.column_spacing_m, model.reference_height_m
        )
        self._sizes = np.array([len(group) for group in model.groups], dtype=np.int64)
        self._budget = max_evaluations
        # Without a budget to run out of there is no rank to find.
        self._n_usable = int(np.count_nonzero(plane.usable))
        self._n_open = len(self._sizes) if self._affords(self._n_usable, 0, len(self._sizes)) else opening_groups(model)

    def open(self) -> tuple[int, Windows, int]:
        """Run the opening; return the windows alive after it and the number cut by the budget."""
        if self._affords(self._n_usable, 0, self._n_open):
            n_windows, windows = self._opened(self._n_open)
            return n_windows, windows, 0
        n_windows, windows = self._opened(0)
        if not self._affords(n_windows, 0, 1):
            return n_windows, windows, n_windows
        _, windows = self._opened(1)
        for group in range(1, self._n_open):
            if not self._affords(len(windows.place), group, group + 1):
                return n_windows, _none(windows), len(windows.place)
            windows = self._run(windows, group, group + 1)
        return n_windows, windows, 0

    def finish(self, windows: Windows) -> tuple[Windows, int]:
        """Run the rest of the cascade on the opening's survivors; return those that pass, and how many are cut."""
        first, last = self._n_open, len(self._sizes)
        n = len(windows.place)
        if first == last:
            return windows, 0
        if self._affords(n, first, last):
            return self._run(windows, first, last), 0
        # Best score first, then in the order of windows: by band, row, column.
        n_all, slice_size = int(self._sizes[first:].sum()), max(1, n // _SLICES)
        done = 0
        finished: list[Windows] = []
        ranked = rank(windows.score, self._left() // n_all)  # if none is dropped there will be no others
        while done < n:
            # A window starts if it and a few behind it could go all the way: then it makes no difference how they are
            # sliced.
            affordable = self._left() // n_all
            if affordable < min(n - done, slice_size):
                break
            length = n - done if affordable >= n - done else affordable - slice_size + 1
            if done + length > len(ranked):
                ranked = rank(windows.score, n)
            chosen = np.zeros(n, dtype=np.bool_)
            chosen[ranked[done : done + length]] = True
            finished.append(self._run(_some(windows, chosen), first, last))
            done += length
        return _together(finished, windows), n - done

    def _affords(self, n_windows: int, first: int, last: int) -> bool:
        """Check whether the budget holds for groups [first, last) on so many windows even if none is dropped."""
        return self._budget is None or n_windows * int(self._sizes[first:last].sum()) <= self._left()

    def _left(self) -> int:
        assert self._budget is not None
        return self._budget - self.n_evaluations

    def _opened(self, n_groups: int) -> tuple[int, Windows]:
        plane = self._plane
        opened = open_windows(
            WindowField(plane.sums, plane.counts, self.corner, plane.usable, self._edges), self._tables, n_groups
        )
        self._account(opened.n_windows, 0, opened.n_alive)
        return opened.n_windows, opened.windows

    def _run(self, windows: Windows, first: int, last: int) -> Windows:
        finished, n_alive = run_groups(self._plane.sums, self._tables, windows, first, last)
        self._account(len(windows.place), first, n_alive)
        return finished

    def _account(self, n_windows: int, first: int, n_alive: NDArray[np.int64]) -> None:
        last = first + len(n_alive)
        entered = np.concatenate(([n_windows], n_alive))[: len(n_alive)]
        self.n_evaluations += int(entered @ self._sizes[first:last])
        self.n_alive[first:last] += n_alive
        if last == len(self._sizes):
            self.n_in_last += int(entered[-1])


def _some(windows: Windows, chosen: NDArray[np.bool_]) -> Windows:
    """Select windows, (n,)."""
    indices = np.flatnonzero(chosen)
    return Windows(
        windows.place[indices], windows.score[indices], np.searchsorted(indices, windows.band_stop).astype(np.int64)
    )


def _none(windows: Windows) -> Windows:
    return Windows(windows.place[:0], windows.score[:0], np.zeros_like(windows.band_stop))


def _together(parts: list[Windows], of: Windows) -> Windows:
    """Join the windows of some runs on parts of `of`; by run, not by band."""
    parts = [_none(of), *parts]
    place, score = (np.concatenate([part[k] for part in parts]) for k in range(2))
    return Windows(place, score, np.full_like(of.band_stop, len(place)))
