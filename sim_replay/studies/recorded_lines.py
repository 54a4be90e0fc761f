"""Recorded missions as inversion takes them: one side of the waterfall on its metric grid, and the scenes found in
it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.geometry.navigation import slice_pose
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import VALID, PoseTrack, Side, SourceEvent, Tile
from auv_mcm.settings.config import Config
from auv_mcm.waterfall.grid import concatenate_poses
from sim_replay.augment.direct import invert
from sim_replay.augment.forward import SeafloorScene

_MAX_ROWS: Final = 800  # of one picture: longer lines are cut

Array = NDArray[np.float64]


class LinePicture(NamedTuple):
    """Hold rows of one side without a gap; column j is around (j + 0.5) * column_spacing_m.

    intensity: (n_rows, n_columns) float64, local sea floor about 1, 0 where not valid. valid: the same shape, bool.
    altitude_m, along_m: (n_rows,) float64, slant range of the first bottom return and distance from mission start.
    pose: of each row.
    """

    side: Side
    intensity: Array
    valid: NDArray[np.bool_]
    altitude_m: Array
    along_m: Array
    column_spacing_m: float
    pose: PoseTrack


def invert_waterfall(
    events: Iterable[SourceEvent], config: Config, side: Side
) -> Iterator[tuple[LinePicture, SeafloorScene]]:
    """Yield the pictures of one side of a mission and their recovered scenes, in the order of the track."""
    for picture in waterfall_pictures(events, config, side):
        yield (
            picture,
            invert(picture.intensity, picture.valid, picture.altitude_m, picture.along_m, picture.column_spacing_m),
        )


def waterfall_pictures(events: Iterable[SourceEvent], config: Config, side: Side) -> Iterator[LinePicture]:
    """Yield the chain's waterfall of pings and navigation: bottom tracking, ground range, radiometry. At most 800 rows
    each.
    """
    run: list[Tile] = []
    for tile in _tiles(events, config, side):
        n_rows = sum(one.core_stop - one.core_start for one in run)
        if run and (
            _core_row(tile) != _core_row(run[-1]) + run[-1].core_stop - run[-1].core_start or n_rows >= _MAX_ROWS
        ):
            yield _joined(run)
            run = []
        run.append(tile)
    if run:
        yield _joined(run)


def _tiles(events: Iterable[SourceEvent], config: Config, side: Side) -> Iterator[Tile]:
    pipeline = Pipeline(config, detect=_nothing)
    for event in events:
        yield from (output for output in pipeline.feed(event) if isinstance(output, Tile) and output.side == side)
    yield from (output for output in pipeline.finish() if isinstance(output, Tile) and output.side == side)


def _nothing(tile: Tile) -> TileDetections:
    """Detect nothing: no detections are needed here."""
    return TileDetections((), 0, 0)


def _core_row(tile: Tile) -> int:
    """Return the index in the mission's grid of the first row that is the tile's own."""
    return tile.first_row + tile.core_start


def _joined(run: list[Tile]) -> LinePicture:
    cores = [slice(tile.core_start, tile.core_stop) for tile in run]
    n_columns = max(tile.mask.shape[1] for tile in run)
    intensity, valid = (
        np.concatenate([np.pad(plane, ((0, 0), (0, n_columns - plane.shape[1]))) for plane in planes])
        for planes in (
            [tile.intensity[core].astype(np.float64) for tile, core in zip(run, cores, strict=True)],
            [(tile.mask[core] & VALID) != 0 for tile, core in zip(run, cores, strict=True)],
        )
    )
    last = int(np.flatnonzero(valid.any(axis=0))[-1]) + 1 if valid.any() else 1
    first = run[0]
    return LinePicture(
        side=first.side,
        intensity=np.where(valid, intensity, 0.0)[:, :last],
        valid=valid[:, :last],
        altitude_m=np.concatenate([tile.first_return_m[core] for tile, core in zip(run, cores, strict=True)]),
        along_m=(_core_row(first) + 0.5 + np.arange(len(intensity), dtype=np.float64)) * first.row_spacing_m,
        column_spacing_m=first.column_spacing_m,
        pose=concatenate_poses([slice_pose(tile.pose, core) for tile, core in zip(run, cores, strict=True)]),
    )
