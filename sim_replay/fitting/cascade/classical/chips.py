"""Cut image chips of a fixed grid around pixels of a tile whose pixels, ranges and altitudes differ.

A chip reaches as far along track whatever the range, and as far behind the object as the shadow of a reference object
would: its columns are metres up to the object's far side and shares of that shadow from there on. So one object looks
much the same at all ranges. The grid has as many cells as the snippets of the source paper (44 by 17, section 4.3).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.bands import REFERENCE_HEIGHT_M, SHADOW_LIMITS_M
from sim_replay.fitting.cascade.tiles import LabelledTile

Array = NDArray[np.float64]
Pixels = NDArray[np.int32]

N_ROWS: Final = 17  # cells along the track
N_COLUMNS: Final = 44  # cells across: of the object, and of the shadow
N_OBJECT_COLUMNS: Final = 20
"""Columns before this one are metres, those from it on shares of the reference shadow."""
CENTRE_ROW: Final = 8  # of N_ROWS, with the object
CENTRE_COLUMN: Final = 12  # of N_COLUMNS, with the object

_ROW_M: Final = 0.12  # m along the track per cell
_COLUMN_M: Final = 0.08  # m across the track per cell of the object
_COLUMN_SHADOW: Final = 0.05  # of the reference shadow
_MIN_CLEARANCE_M: Final = 0.3  # m between the reference object and the sonar, so that its shadow ends

_KNOWN: Final = 0.5  # of a cell
_KNOWN_OF_CHIP: Final = 0.6  # share of a chip's cells that has to be measured
_DARKEST: Final = 0.01  # -20 dB: darker than this is noise


class ChipPicture(NamedTuple):
    """Hold a tile as chips are cut from it.

    Sum of codes and number of valid pixels over all rows and columns before, (n_rows + 1, n_columns + 1) int64.
    first_return_m: (n_rows,) float64.
    """

    total: NDArray[np.int64]
    n_valid: NDArray[np.int64]
    first_return_m: Array
    row_spacing_m: float
    column_spacing_m: float


class Chips(NamedTuple):
    """Hold chips cut from tiles.

    contrast: (n, N_ROWS, N_COLUMNS) float64, ln of the mean of each cell over the median cell of its chip; 0 where less
    than half of a cell is known. known: (n,) bool, chips of which enough is known to judge them.
    """

    contrast: Array
    known: NDArray[np.bool_]


def picture_of(tile: LabelledTile) -> ChipPicture:
    """Return the tile's sums; the content of masked pixels does not count."""
    return picture(tile.codes, tile.valid, tile.first_return_m, tile.row_spacing_m, tile.column_spacing_m)


def picture(
    codes: NDArray[np.uint16],
    valid: NDArray[np.bool_],
    first_return_m: Array,
    row_spacing_m: float,
    column_spacing_m: float,
) -> ChipPicture:
    """Return sums of codes (n_rows, n_columns) uint16 where valid (n_rows, n_columns) bool."""
    return ChipPicture(
        _summed(np.where(valid, codes, 0)), _summed(valid), first_return_m, row_spacing_m, column_spacing_m
    )


def reference_shadow_m(ground_range_m: Array, first_return_m: Array) -> Array:
    """Return the shadow's length of an object of the reference height, at least 0.4 and at most 6 m.

    A first return less than 0.3 m above that height, or NaN, counts as that.
    """
    height_m = np.fmax(first_return_m, REFERENCE_HEIGHT_M + _MIN_CLEARANCE_M)
    return np.clip(REFERENCE_HEIGHT_M * ground_range_m / (height_m - REFERENCE_HEIGHT_M), *SHADOW_LIMITS_M)


def cut_chips(source: ChipPicture, rows: Pixels, columns: Pixels, shadow_m: float | None = None) -> Chips:
    """Cut chips centred on the pixels (rows, columns), (n,) each, inside the tile.

    What lies beyond the tile is not known.

    Parameters
    ----------
    shadow_m
        Length, m, that the columns behind the object share at every range; the reference shadow's if None.
    """
    if shadow_m is None:
        lengths_m = reference_shadow_m(
            (columns.astype(np.float64) + 0.5) * source.column_spacing_m, source.first_return_m[rows]
        )
    else:
        lengths_m = np.full(len(columns), shadow_m)
    row_edges, column_edges = _edges(lengths_m, source.row_spacing_m, source.column_spacing_m)
    row_edges, column_edges = row_edges + (rows[:, np.newaxis] + 0.5), column_edges + (columns[:, np.newaxis] + 0.5)
    total = _cell_sums(source.total, row_edges, column_edges)
    count = _cell_sums(source.n_valid, row_edges, column_edges)
    area = np.diff(row_edges, axis=1)[:, :, np.newaxis] * np.diff(column_edges, axis=1)[:, np.newaxis]
    known = count > _KNOWN * area
    mean = np.divide(total, count, out=np.zeros_like(total), where=known)
    return Chips(_contrast(mean, known), known.mean(axis=(1, 2)) >= _KNOWN_OF_CHIP)


def _edges(shadow_m: Array, row_m: float, column_m: float) -> tuple[Array, Array]:
    """Return edges of the cells in pixels from the centre: rows (1, N_ROWS + 1) and columns (n, N_COLUMNS + 1)."""
    rows: Array = (np.arange(N_ROWS + 1, dtype=np.float64) - 0.5 * N_ROWS) * (_ROW_M / row_m)
    index = np.arange(N_COLUMNS + 1)
    near_m = (np.minimum(index, N_OBJECT_COLUMNS) - CENTRE_COLUMN - 0.5) * _COLUMN_M
    shadows = np.maximum(index - N_OBJECT_COLUMNS, 0) * _COLUMN_SHADOW
    columns_m: Array = near_m + shadow_m[:, np.newaxis] * shadows
    return rows[np.newaxis], columns_m / column_m


def _cell_sums(integral: NDArray[np.int64], row_edges: Array, column_edges: Array) -> Array:
    """Return (n, N_ROWS, N_COLUMNS) sums over cells with edges in fractions of pixels, each pixel being even."""
    row, row_share = _split(row_edges, integral.shape[0] - 1)
    column, column_share = _split(column_edges, integral.shape[1] - 1)
    row, row_share = row[:, :, np.newaxis], row_share[:, :, np.newaxis]
    column, column_share = column[:, np.newaxis], column_share[:, np.newaxis]
    upper = integral[row, column] * (1.0 - column_share) + integral[row, column + 1] * column_share
    lower = integral[row + 1, column] * (1.0 - column_share) + integral[row + 1, column + 1] * column_share
    corners = upper * (1.0 - row_share) + lower * row_share
    return np.asarray(np.diff(np.diff(corners, axis=1), axis=2))


def _split(edges: Array, n: int) -> tuple[NDArray[np.intp], Array]:
    """Return pixel and share of it at each edge, no farther than the tile reaches."""
    inside: Array = np.clip(edges, 0.0, float(n))
    pixel = np.minimum(inside.astype(np.intp), n - 1)
    return pixel, inside - pixel


def _contrast(mean: Array, known: NDArray[np.bool_]) -> Array:
    background = np.nanmedian(
        np.where(known | ~known.any(axis=(1, 2), keepdims=True), mean, np.nan), axis=(1, 2), keepdims=True
    )
    usable = known & (background > 0.0)
    ratio = np.divide(mean, background, out=np.ones_like(mean), where=usable)
    return np.asarray(np.log(np.maximum(ratio, _DARKEST)))


def _summed(values: NDArray[np.generic]) -> NDArray[np.int64]:
    total = np.zeros((values.shape[0] + 1, values.shape[1] + 1), dtype=np.int64)
    np.cumsum(np.cumsum(values, axis=0, dtype=np.int64), axis=1, out=total[1:, 1:])
    return total
