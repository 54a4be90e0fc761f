"""Collect training windows of a shard of tiles: each target's best window, and the false alarms of the cascade so far.

The highlight of a target is known to half a metre: all windows within that are one bag, of which the best counts (P.
Viola, J. Platt, C. Zhang, "Multiple instance boosting for object detection", NIPS 2005). It is the brightest at first,
then the one that the cascade trained so far scores best. Others are windows away from all targets, rocks among them:
any at first, then those that pass the cascade (K.-K. Sung, T. Poggio, IEEE Trans. PAMI 20(1), 1998).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.bands import WINDOW, FeatureBox, areas, band_edges, bands_at, pixel_boxes
from auv_mcm.detect.cascade.codes import CodePlane, make_plane, valid_counts
from auv_mcm.detect.cascade.model import CascadeModel
from auv_mcm.detect.cascade.peaks import spaced_apart
from auv_mcm.detect.cascade.run import CascadeResult, run_plane, trace_plane
from sim_replay.fitting.cascade.pool import pool_box_means
from sim_replay.fitting.cascade.soft import best_windows
from sim_replay.fitting.cascade.store import Shard, read_shard
from sim_replay.fitting.cascade.tiles import LabelledTile, TileObject

CLEAR_M: Final = 3.0
"""Windows nearer than this to a target, along and across the track, are neither it nor anything else."""

_BAG_M: Final = 0.5  # m around a target whose windows count as its own
_APART_M: Final = 1.0  # m between windows of clutter, minimum
_HIGHLIGHT: Final = FeatureBox(-0.18, 0.18, -0.12, 0.0, 0.12, 0.0)
_MIN_SHARE: Final = 0.6  # of a window that must be valid, as where a cascade runs


class Bags(NamedTuple):
    """Hold windows of a tile's targets.

    targets: whose core rows hold them and of which there is any window. bag: (n,) intp, its number among `targets`,
    ascending; rows, columns: (n,) intp.
    """

    targets: tuple[TileObject, ...]
    bag: NDArray[np.intp]
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]


class Errand(NamedTuple):
    """Specify what to collect from a shard: means over `boxes`, of up to n_others windows per tile that are no target.
    model: the cascade so far, None before there is one. Of what passes it the best scores are taken, well apart.
    """

    folder: Path
    shard: Shard
    boxes: tuple[FeatureBox, ...]
    model: CascadeModel | None
    n_others: int
    seed: int


class Gleaned(NamedTuple):
    """Hold what passes bring.

    targets: (n_boxes, n_targets) float32 box means of each target's best window, in an order that is the same for every
    errand to a shard. others: (n_boxes, n_others) float32, of the windows at `places` (n_others, 3) int32: tile in
    shard, row, column. spacings_m: (n_tiles, 2) float64, of rows and columns.
    """

    targets: NDArray[np.float32]
    others: NDArray[np.float32]
    places: NDArray[np.int32]
    spacings_m: NDArray[np.float64]


def glean(errand: Errand) -> Gleaned:
    """Run an errand."""
    targets = [np.empty((len(errand.boxes), 0), dtype=np.float32)]
    others, places = list(targets), [np.empty((0, 3), dtype=np.int32)]
    spacings_m: list[tuple[float, float]] = []
    for number, (tile, plane) in enumerate(planes_of(errand.folder, errand.shard)):
        bags = target_bags(tile, plane)
        best = best_windows(_merit(plane, errand.model, bags), bags.bag)
        targets.append(pool_box_means(plane, errand.boxes, bags.rows[best], bags.columns[best]))
        rng = np.random.Generator(np.random.PCG64([errand.seed, number, *errand.shard.sha256.encode()]))
        rows, columns = _others(tile, plane, errand, rng)
        others.append(pool_box_means(plane, errand.boxes, rows, columns))
        places.append(np.column_stack((np.full(rows.size, number), rows, columns)).astype(np.int32))
        spacings_m.append((tile.row_spacing_m, tile.column_spacing_m))
    return Gleaned(
        targets=np.concatenate(targets, axis=1),
        others=np.concatenate(others, axis=1),
        places=np.concatenate(places),
        spacings_m=np.array(spacings_m, dtype=np.float64).reshape(-1, 2),
    )


def planes_of(folder: Path, shard: Shard) -> Iterator[tuple[LabelledTile, CodePlane]]:
    """Yield the tiles of a shard, each with its input to a cascade."""
    for tile in read_shard(folder, shard):
        yield (
            tile,
            make_plane(
                tile.codes, tile.valid, tile.usable, tile.first_return_m, tile.row_spacing_m, tile.column_spacing_m
            ),
        )


def target_bags(tile: LabelledTile, plane: CodePlane) -> Bags:
    """Return all windows within half a metre of each target along and across the track."""
    targets: list[TileObject] = []
    bag: list[NDArray[np.intp]] = []
    places: list[NDArray[np.intp]] = []
    for tile_object in tile.objects:
        if not tile_object.is_target or not tile.core_start <= tile_object.row < tile.core_stop:
            continue
        rows, columns = np.nonzero(tile.usable & _near(tile, tile_object, _BAG_M))
        whole = _is_whole(plane, rows, columns)
        if whole.any():
            bag.append(np.full(int(whole.sum()), len(targets), dtype=np.intp))
            places.append(np.stack((rows[whole], columns[whole])))
            targets.append(tile_object)
    none = np.empty(0, dtype=np.intp)
    rows, columns = np.concatenate([np.empty((2, 0), dtype=np.intp), *places], axis=1)
    return Bags(tuple(targets), np.concatenate([none, *bag]), rows, columns)


def clear_of_targets(tile: LabelledTile) -> NDArray[np.bool_]:
    """Return (n_rows, n_columns) bool: usable, and CLEAR_M or more from every target, those of the overlap included."""
    clear = tile.usable.copy()
    for tile_object in tile.objects:
        if tile_object.is_target:
            clear &= ~_near(tile, tile_object, CLEAR_M)
    return clear


def well_apart(tile: LabelledTile, found: CascadeResult, n_max: int) -> NDArray[np.intp]:
    """Return indices of up to `n_max` windows that passed a cascade, best first.

    None lies within a metre of a better one.
    """
    half_rows, half_columns = _APART_M / tile.row_spacing_m, _APART_M / tile.column_spacing_m
    return spaced_apart(found.rows, found.columns, found.scores, half_rows, half_columns, n_max)


def _merit(plane: CodePlane, model: CascadeModel | None, bags: Bags) -> NDArray[Any]:
    if model is None:
        return np.asarray(pool_box_means(plane, (_HIGHLIGHT,), bags.rows, bags.columns)[0])
    return trace_plane(plane, model, bags.rows, bags.columns)[:, -1]


def _others(
    tile: LabelledTile, plane: CodePlane, errand: Errand, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    clear = clear_of_targets(tile)
    if errand.model is None:
        rows, columns = np.nonzero(clear)
        chosen = np.sort(rng.choice(rows.size, size=min(errand.n_others, rows.size), replace=False))
        chosen = chosen[_is_whole(plane, rows[chosen], columns[chosen])]
        return rows[chosen], columns[chosen]
    passed = run_plane(plane._replace(usable=clear), errand.model, None)
    chosen = well_apart(tile, passed, errand.n_others)
    return passed.rows[chosen].astype(np.intp), passed.columns[chosen].astype(np.intp)


def _near(tile: LabelledTile, tile_object: TileObject, reach_m: float) -> NDArray[np.bool_]:
    n_rows, n_columns = tile.usable.shape
    rows = np.abs(np.arange(n_rows) + 0.5 - tile_object.row) * tile.row_spacing_m < reach_m
    columns = np.abs(np.arange(n_columns) + 0.5 - tile_object.column) * tile.column_spacing_m < reach_m
    return np.asarray(rows[:, np.newaxis] & columns)


def _is_whole(plane: CodePlane, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[np.bool_]:
    bands = bands_at(band_edges(plane.first_return_m, plane.n_columns, plane.column_spacing_m), rows, columns)
    boxes = pixel_boxes((WINDOW,), plane.row_spacing_m, plane.column_spacing_m)[bands, 0]
    return np.asarray(valid_counts(plane, rows, columns, boxes) >= _MIN_SHARE * areas(boxes))
