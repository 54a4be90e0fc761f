"""Lay out what a tile surveyed in square cells of the mission's own plane."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.georeference import locate, tile_echoes
from auv_mcm.kernels.texture import summed
from auv_mcm.records import NAN, SEABED_TYPES, SeabedCells, SurveyedCells, Tile
from auv_mcm.settings.config import SonarConfig

Array = NDArray[np.float64]

_BLOCK_M: Final = 0.5  # pixels within a block are placed together
_MIN_FRACTION: Final = 0.01  # share of a cell, below which it counts as not seen
_KEY: Final = 1 << 32  # east index times this plus north index: one number per cell


class _Blocks(NamedTuple):
    """Hold blocks of covered pixels, (n,) each.

    row: of the tile. place_m: east and north in the plane, (n, 2). look_m: from the near to the far end of their row,
    (n, 2).
    """

    area_m2: Array
    row: Array
    ground_m: Array
    place_m: Array
    look_m: Array


class _Cells(NamedTuple):
    """Assign blocks to cells.

    of_block: index of each block's cell, (n,). kept: indices of the cells of which enough was seen, of n_cells.
    """

    of_block: NDArray[np.int64]
    n_cells: int
    kept: NDArray[np.int64]

    def sums(self, value: Array) -> Array:
        """Sum a value of blocks, (n,), over each cell that is kept."""
        return np.asarray(np.bincount(self.of_block, value, self.n_cells)[self.kept], dtype=np.float64)


class _Floor(NamedTuple):
    """Hold the sea floor of cells, (n,) each, as `SurveyedCells` names it."""

    kind: NDArray[np.int64]
    confidence: Array
    ripple_rad: Array
    wavelength_m: Array
    unevenness_db: Array


def surveyed_cells(
    tile: Tile,
    covered: NDArray[np.bool_],
    sonar: SonarConfig,
    frame: LocalFrame,
    cell_m: float,
    seabed: SeabedCells | None = None,
    evaluated_fraction: float = 1.0,
) -> SurveyedCells | None:
    """Gather the covered pixels of a tile's core into cells.

    Cells of which less than a hundredth was seen are left out. None if nothing was covered. Memory grows with the
    number of blocks, not with the distance between them.

    Parameters
    ----------
    covered
        (core rows, n_columns) bool, False where the row cannot be placed.
    frame
        The mission's plane. Pixels are placed in blocks of half a metre.
    evaluated_fraction
        Of the places to look at, those that the detector's budget allowed for.
    """
    blocks = _blocks(tile, covered, sonar, frame)
    if blocks is None or not len(blocks.area_m2):
        return None
    index = np.floor(blocks.place_m / cell_m).astype(np.int64)
    cell, of_block = np.unique(index[:, 0] * _KEY + index[:, 1], return_inverse=True)
    total_m2 = np.bincount(of_block, blocks.area_m2, len(cell))
    kept = np.flatnonzero(total_m2 >= _MIN_FRACTION * cell_m * cell_m)
    if not len(kept):
        return None
    cells = _Cells(of_block, len(cell), kept)

    def mean(value: Array) -> Array:
        return np.asarray(cells.sums(blocks.area_m2 * value) / total_m2[kept])

    east = (cell[kept] + _KEY // 2) // _KEY
    look = blocks.look_m / np.maximum(np.hypot(blocks.look_m[:, 0], blocks.look_m[:, 1]), 1e-9)[:, np.newaxis]
    look_rad = np.mod(np.arctan2(mean(look[:, 0]), mean(look[:, 1])), 2.0 * math.pi)
    altitude_m = tile.first_return_m[np.minimum(np.rint(blocks.row).astype(int), len(tile.first_return_m) - 1)]
    floor = _floor(seabed, tile, blocks, cells)
    return SurveyedCells(
        origin_latitude_deg=frame.latitude_deg,
        origin_longitude_deg=frame.longitude_deg,
        cell_m=cell_m,
        east_index=east.astype(np.int32),
        north_index=(cell[kept] - east * _KEY).astype(np.int32),
        fraction=(evaluated_fraction * np.minimum(total_m2[kept] / (cell_m * cell_m), 1.0)).astype(np.float32),
        ground_range_m=mean(blocks.ground_m).astype(np.float32),
        altitude_m=mean(altitude_m).astype(np.float32),
        look_rad=np.where(look_rad >= 2.0 * math.pi, 0.0, look_rad).astype(np.float32),
        seabed=floor.kind.astype(np.uint8),
        confidence=floor.confidence.astype(np.float32),
        ripple_rad=floor.ripple_rad.astype(np.float32),
        wavelength_m=floor.wavelength_m.astype(np.float32),
        unevenness_db=floor.unevenness_db.astype(np.float32),
    )


def _blocks(tile: Tile, covered: NDArray[np.bool_], sonar: SonarConfig, frame: LocalFrame) -> _Blocks | None:
    """Place the covered pixels in blocks, on the line between both ends of their rows; None if nothing was covered."""
    n_rows, n_columns = (max(1, round(_BLOCK_M / side_m)) for side_m in (tile.row_spacing_m, tile.column_spacing_m))
    area_m2 = _sums(covered, n_rows, n_columns) * (tile.row_spacing_m * tile.column_spacing_m)
    used = np.flatnonzero(area_m2.any(axis=1))
    if not len(used):
        return None
    area_m2 = area_m2[used]
    of_block, at_column = np.nonzero(area_m2)
    row = tile.core_start + np.minimum((used + 0.5) * n_rows, covered.shape[0]) - 0.5
    width_m = covered.shape[1] * tile.column_spacing_m
    near_m, far_m = (_placed(tile, row, ground_m, sonar, frame) for ground_m in (0.0, width_m))
    ground_m: Array = np.asarray((at_column + 0.5) * n_columns * tile.column_spacing_m, dtype=np.float64)
    share = (ground_m / width_m)[:, np.newaxis]
    place_m = near_m[of_block] * (1.0 - share) + far_m[of_block] * share
    every = _Blocks(area_m2[of_block, at_column], row[of_block], ground_m, place_m, (far_m - near_m)[of_block])
    finite = np.isfinite(place_m)
    return every if finite.all() else _Blocks(*(values[finite.all(axis=1)] for values in every))


def _sums(covered: NDArray[np.bool_], n_rows: int, n_columns: int) -> Array:
    """Sum covered pixels per block; the last ones may be cut short."""
    whole = np.pad(covered, ((0, -covered.shape[0] % n_rows), (0, -covered.shape[1] % n_columns)))
    return summed(whole.astype(np.float32), (n_rows, n_columns)).astype(np.float64)


def _placed(tile: Tile, row: Array, ground_m: float, sonar: SonarConfig, frame: LocalFrame) -> Array:
    """Compute (n, 2) east and north of a ground range at fractional rows, m."""
    latitude, longitude, height = locate(tile_echoes(tile, row, ground_m), sonar)
    return frame.to_enu(latitude, longitude, height)[:, :2]


def _floor(seabed: SeabedCells | None, tile: Tile, blocks: _Blocks, cells: _Cells) -> _Floor:
    """Say what lies in each cell: the commonest kind of sea floor, and of all of it how uneven it is."""
    n_kept, area_m2 = len(cells.kept), blocks.area_m2
    if seabed is None:
        nothing = np.full(n_kept, NAN)
        return _Floor(np.full(n_kept, SEABED_TYPES.index("unknown")), np.zeros(n_kept), nothing, nothing, nothing)
    n_along, n_across = seabed.kind.shape
    along = np.clip(
        ((blocks.row - tile.core_start + 0.5) * tile.row_spacing_m // seabed.cell_m[0]).astype(int), 0, n_along - 1
    )
    across = np.clip((blocks.ground_m // seabed.cell_m[1]).astype(int), 0, n_across - 1)
    kind = seabed.kind[along, across]
    by_kind = np.stack([cells.sums(area_m2 * (kind == index)) for index in range(len(SEABED_TYPES))])
    commonest = np.argmax(by_kind, axis=0)
    commonest_of = np.zeros(cells.n_cells, dtype=int)
    commonest_of[cells.kept] = commonest
    agrees_m2 = area_m2 * (kind == commonest_of[cells.of_block])
    of_kept = np.maximum(by_kind[commonest, np.arange(n_kept)], 1e-12)
    confidence = cells.sums(agrees_m2 * seabed.confidence[along, across]) / of_kept
    ripple_rad = seabed.ripple_rad[along, across].astype(np.float64)
    rippled_m2 = np.where(np.isfinite(ripple_rad), agrees_m2, 0.0)
    wavelength_m = _mean(seabed.wavelength_m[along, across], rippled_m2, cells)
    uneven_db = seabed.unevenness_db[along, across].astype(np.float64)
    measured_m2 = np.where(np.isfinite(uneven_db), area_m2, 0.0)
    return _Floor(
        commonest,
        confidence,
        _axial_mean(ripple_rad, rippled_m2, cells),
        wavelength_m,
        _mean(uneven_db, measured_m2, cells),
    )


def _mean(value: Array, weight: Array, cells: _Cells) -> Array:
    """Average a value of blocks over each cell; NaN where nothing weighs, and NaN counts nothing."""
    total = cells.sums(weight)
    mean = cells.sums(weight * np.nan_to_num(value)) / np.maximum(total, 1e-12)
    return np.where(total > 0.0, mean, NAN)


def _axial_mean(angle_rad: Array, weight: Array, cells: _Cells) -> Array:
    """Average directions over each cell, [0, pi): twice the angle, since the opposite is the same ripples."""
    twice = 2.0 * np.nan_to_num(angle_rad)
    sine, cosine = (cells.sums(weight * part) for part in (np.sin(twice), np.cos(twice)))
    direction = np.mod(0.5 * np.arctan2(sine, cosine), math.pi)
    return np.where(cells.sums(weight) > 0.0, np.where(direction >= math.pi, 0.0, direction), NAN)
