"""Find the edges of shadows in the pixels of the waterfall, as an analyst's eye does, for clicks that know no truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.snippet import unpack_snippet
from sim_replay.view.places import WaterfallPoint
from sim_replay.view.waterfall_store import TILE_PX, WaterfallStore

_SMOOTH: Final = (5, 3)  # rows and columns that an eye averages over: 0.6 m by 0.18 m
_DARK_DB: Final = -3.0  # of the sea floor: half its power, where an edge is taken
_CLEAR_DB: Final = -6.0  # on average: a shadow that an analyst would measure
_DIM_DB: Final = 7.0  # over the darkest half: a flat top that sends back little, before its shadow; chosen
_BRIDGE_M: Final = 0.3  # speckle in a shadow is shorter
_BRIGHT_DB: Final = 3.0  # brighter is the object
_BEFORE_M: Final = 1.5  # before the object that a profile begins
_REACH_M: Final = 9.0  # behind the object that a shadow is looked for: that of 0.8 m at 45 m, 5 m over the floor
_GAP_M: Final = 0.4  # between the object and its shadow at most
_MIN_SHADOW_M: Final = 0.5  # shorter ones are speckle
_BESIDE_ROWS: Final = range(-9, 10)  # rows about a contact's that are looked at: over 2.3 m, the longest target
_LONG: Final = 0.5  # of the longest: rows with as long a shadow are those of the object; chosen
_N_MEASURED: Final = 5  # rows in the middle of these that are measured
_FAR: Final = 0.9  # of the swath, beyond which shadows run out of it


class ShadowEdges(NamedTuple):
    """Hold where a shadow begins and ends in one row, and its mean level over that of the sea floor, dB."""

    begin: WaterfallPoint
    end: WaterfallPoint
    level_db: float

    @property
    def length_m(self) -> float:
        """Return the length over the sea floor."""
        return abs(self.end.across_m - self.begin.across_m)


def clearest_shadow(store: WaterfallStore, views: Sequence[WaterfallPoint]) -> tuple[int, list[ShadowEdges]]:
    """Find the view in which a contact's shadow is clearest, and its edges in up to five rows about its middle.

    View -1 and no edges where no view has a clear shadow that ends within the swath.

    Parameters
    ----------
    store
        The waterfall.
    views
        The contact's highlight in each of its views.
    """
    found: list[tuple[int, list[ShadowEdges]]] = []
    for index, (row, across_m) in enumerate(views):
        if not abs(across_m) <= _FAR * store.n_columns * store.column_spacing_m:  # NaN counts as outside
            continue
        edges = [shadow_edges(store, WaterfallPoint(row + beside, across_m)) for beside in _BESIDE_ROWS]
        if middle := _middle(edges):
            found.append((index, middle))
    return min(found, key=lambda one: float(np.mean([edges.level_db for edges in one[1]])), default=(-1, []))


def shadow_edges(store: WaterfallStore, highlight: WaterfallPoint) -> ShadowEdges | None:
    """Find a shadow's two ends in the row of a highlight; None where there is no clear shadow."""
    row, across_m = highlight
    if not (math.isfinite(row) and math.isfinite(across_m)):
        return None
    column_m, sign = store.column_spacing_m, -1 if across_m < 0.0 else 1
    level_db = _profile(store, row, across_m)
    centre = round(_BEFORE_M / column_m)
    bright = np.flatnonzero(level_db[: centre + round(1.0 / column_m)] > _BRIGHT_DB)
    near = bright[np.abs(bright - centre) <= round(0.8 / column_m)]
    if not len(near):
        return None
    gap = round(_BRIDGE_M / column_m)
    lit = np.flatnonzero(level_db > _DARK_DB)
    behind = np.arange(near[-1] + 1, near[-1] + 1 + round(_GAP_M / column_m))
    start = next((int(at) for at in behind if not np.isin(at, lit)), None)
    if start is None:
        return None
    # The first stretch of light that is longer than speckle ends the shadow.
    end = next((int(at) for at in lit[lit > start] if np.isin(np.arange(at, at + gap + 1), lit).all()), None)
    if end is None or (end - start) * column_m < _MIN_SHADOW_M or level_db[start:end].mean() > _CLEAR_DB:
        return None
    first_m, at_m = abs(across_m) - _BEFORE_M, math.floor(row) + 0.5
    begin = start + _dim_columns(level_db[start:end], gap)
    return ShadowEdges(
        WaterfallPoint(at_m, sign * (first_m + begin * column_m)),
        WaterfallPoint(at_m, sign * (first_m + end * column_m)),
        float(level_db[start:end].mean()),
    )


def _dim_columns(level_db: NDArray[np.float64], gap: int) -> int:
    """Count columns of an object's top before its shadow: darker than the sea floor, and clearly above the darkest
    half. gap: columns that speckle is shorter than.
    """
    n = len(level_db)
    limit_db = float(np.sort(level_db)[: max(n // 2, 1)].mean()) + _DIM_DB
    if limit_db >= _DARK_DB:  # nothing is between shadow and sea floor
        return 0
    dim = level_db > limit_db
    starts = [at for at in range(n - gap) if dim[at : at + gap].all()]
    # A top begins where the highlight ends, and its shadow is the longer part of what is dark.
    top = [at for at in starts if at < 0.6 * n]
    return max(top) + gap if top and top[0] <= 2 else 0


def _middle(edges: Sequence[ShadowEdges | None]) -> list[ShadowEdges]:
    """Choose rows about the middle of those whose shadow is not much shorter than the longest."""
    length_m = np.array([0.0 if one is None else one.length_m for one in edges])
    padded = np.pad(length_m, 1)
    smooth_m = np.median(np.stack([padded[:-2], length_m, padded[2:]]), axis=0)
    if not smooth_m.max() > 0.0:
        return []
    centre = round(float(np.median(np.flatnonzero(smooth_m >= _LONG * smooth_m.max()))))
    half = _N_MEASURED // 2
    return [one for one in edges[max(centre - half, 0) : centre + half + 1] if one is not None]


def _profile(store: WaterfallStore, row: float, across_m: float) -> NDArray[np.float64]:
    """Average what lies abeam of a contact, dB, (n,), from 1.5 m before it, going away from the sonar."""
    n_lines, n_smooth = _SMOOTH
    first_row, first_column = (
        math.floor(row) - n_lines // 2,
        round((abs(across_m) - _BEFORE_M) / store.column_spacing_m),
    )
    n_columns = round((_BEFORE_M + _REACH_M) / store.column_spacing_m)
    linear = np.zeros((n_lines, n_columns), dtype=np.float32)
    for tile_row in {first_row // TILE_PX, (first_row + n_lines - 1) // TILE_PX}:
        for tile_column in range(first_column // TILE_PX, (first_column + n_columns) // TILE_PX + 1):
            if across_m < 0.0:
                pixels = unpack_snippet(store.picture(0, max(tile_row, 0), -1 - tile_column))[:, ::-1]
            else:
                pixels = unpack_snippet(store.picture(0, max(tile_row, 0), tile_column))
            top, left = tile_row * TILE_PX - first_row, tile_column * TILE_PX - first_column
            rows = slice(max(top, 0), min(top + TILE_PX, n_lines))
            cut = slice(max(left, 0), min(left + TILE_PX, n_columns))
            if rows.start < rows.stop and cut.start < cut.stop:
                linear[rows, cut] = pixels[rows.start - top : rows.stop - top, cut.start - left : cut.stop - left]
    smooth = np.convolve(linear.mean(axis=0), np.full(n_smooth, 1.0 / n_smooth), mode="same")
    return np.asarray(10.0 * np.log10(np.maximum(smooth, 1e-3)), dtype=np.float64)
