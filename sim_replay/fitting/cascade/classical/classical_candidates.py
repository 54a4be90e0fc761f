"""Choose the classical classifier's candidates: detections of the training-free prescreen in a labelled tile; and what
that is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.detect_tile import detect_tile
from auv_mcm.records import LOW_RESOLUTION, VALID, Detection, PoseTrack, Tile
from auv_mcm.settings.config import Config
from sim_replay.fitting.cascade.classical.chips import Pixels, reference_shadow_m
from sim_replay.fitting.cascade.tiles import LabelledTile, TileObject

_CODES: Final = 1024.0  # of a labelled tile for the mean of the sea floor
_ON_OBJECT_M: Final = 1.0  # m from a target, within which a candidate is on it
_CLEAR_M: Final = 3.0  # m around objects where a candidate counts as neither


class Candidates(NamedTuple):
    """Hold rows, columns: (n,) int32 pixels of the objects' centres, best score of the prescreen first."""

    rows: Pixels
    columns: Pixels


def unlabelled(tile: LabelledTile) -> Tile:
    """Return the tile as the detector gets it, but somewhere on the equator and without its saturation mask."""
    n_rows = tile.codes.shape[0]
    core = np.zeros(tile.valid.shape, dtype=np.bool_)
    core[tile.core_start : tile.core_stop] = True
    mask = np.where(tile.valid, np.uint8(VALID), np.uint8(0))
    mask |= np.where(tile.valid & core & ~tile.usable, np.uint8(LOW_RESOLUTION), np.uint8(0))
    fields = [name for name in PoseTrack.__struct_fields__ if name != "stale"]
    return Tile(
        side=tile.side,
        index=0,
        first_row=0,
        core_start=tile.core_start,
        core_stop=tile.core_stop,
        row_spacing_m=tile.row_spacing_m,
        column_spacing_m=tile.column_spacing_m,
        intensity=np.where(tile.valid, tile.codes / np.float32(_CODES), np.float32(0.0)).astype(np.float32),
        mask=mask,
        pose=PoseTrack(**dict.fromkeys(fields, np.zeros(n_rows)), stale=np.zeros(n_rows, dtype=np.bool_)),
        first_return_m=tile.first_return_m,
        first_return_sigma_m=np.zeros(n_rows),
        ping_number=np.arange(n_rows, dtype=np.int64),
    )


def find_candidates(tile: LabelledTile, config: Config) -> Candidates:
    """Return the detections in the core of the detection stage with this configuration."""
    plain = unlabelled(tile)
    return Candidates(*pixels_of(detect_tile(plain, config).detections, plain))


def pixels_of(detections: Sequence[Detection], tile: Tile) -> tuple[Pixels, Pixels]:
    """Return rows and columns (n,) of the tile's pixels that hold detections; those just outside go to the edge."""
    places = np.floor(
        np.array([(d.row - tile.first_row, d.column) for d in detections], dtype=np.float64).reshape(-1, 2)
    )
    n_rows, n_columns = tile.mask.shape
    row, column = np.clip(places[:, 0], 0, n_rows - 1), np.clip(places[:, 1], 0, n_columns - 1)
    return row.astype(np.int32), column.astype(np.int32)


class Labels(NamedTuple):
    """Hold what candidates stand for.

    object_index: (n,) intp, of the target in the tile's core that a candidate stands for, -1 for none. is_other: (n,)
    bool, the candidate is certain to be no target. Candidates that are neither lie beside or behind a target, and teach
    nothing.
    """

    object_index: NDArray[np.intp]
    is_other: NDArray[np.bool_]


def label(tile: LabelledTile, found: Candidates) -> Labels:
    """Label candidates: for each target in the core the candidate nearest to it, at most a metre away.

    And what is clear of all targets by 3 m and more.
    """
    object_index = np.full(len(found.rows), -1, dtype=np.intp)
    is_other = np.ones(len(found.rows), dtype=np.bool_)
    for index, tile_object in enumerate(tile.objects):
        if not tile_object.is_target:
            continue
        along_m, across_m = _offsets_m(tile, found, tile_object)
        is_other &= ~_near(tile, tile_object, along_m, across_m)
        distance_m = np.hypot(along_m, across_m)
        if tile.core_start <= tile_object.row < tile.core_stop and distance_m.size and distance_m.min() <= _ON_OBJECT_M:
            object_index[int(distance_m.argmin())] = index
    return Labels(object_index, is_other)


def _offsets_m(
    tile: LabelledTile, found: Candidates, tile_object: TileObject
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    along_m = (found.rows.astype(np.float64) + 0.5 - tile_object.row) * tile.row_spacing_m
    across_m = (found.columns.astype(np.float64) + 0.5 - tile_object.column) * tile.column_spacing_m
    return along_m, across_m


def _near(
    tile: LabelledTile, tile_object: TileObject, along_m: NDArray[np.float64], across_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    first_return_m = tile.first_return_m[min(max(math.floor(tile_object.row), 0), len(tile.first_return_m) - 1)]
    shadow_m = float(reference_shadow_m(np.array(tile_object.ground_range_m), np.array(first_return_m)))
    return (np.abs(along_m) < _CLEAR_M) & (across_m > -_CLEAR_M) & (across_m < _CLEAR_M + shadow_m)
