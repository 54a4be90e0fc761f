"""Draw recorded lines beside their classified sea floor, for inspection: the truth is unknown."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_picture import KIND_COLOURS
from auv_mcm.contacts.contact_picture import display_levels
from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.errors import BadInputError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import SEABED_TYPES, SeabedCells, Tile
from auv_mcm.seabed.seabed_cells import seabed_cells
from auv_mcm.seabed.seabed_model import SeabedModel
from auv_mcm.settings.config import Config
from sim_replay.logs.open_log import open_log

Canvas = NDArray[np.uint8]

_PIXEL_M: Final = 0.12  # m per pixel
_PER_LEVEL: Final = 4  # there are 63 of them
_GAP_PX: Final = 8  # pixels between panels
_BAR_PX: Final = 30  # pixels: height of the legend
_TINT: Final = 0.5  # share of a pixel that its type colours
_LETTER: Final = 0.55  # times OpenCV's letters
_WHITE: Final = 255  # of 8 bits


def seabed_picture(logs: Sequence[Path], n_tiles: int, model: SeabedModel) -> Canvas:
    """Draw sea floor with its types.

    (rows, columns, 3) uint8: the first tiles of each log, a side each, track upwards and range to the right, and each
    once more in the colours of the kinds.

    Raises BadInputError for a log that cannot be read or that has no tile.
    """
    panels = []
    for log in logs:
        tiles = _tiles(log)
        if not tiles:
            raise BadInputError(f"{log}: no sea floor to draw. Give a log with sonar pings and navigation")
        for tile in tiles[:n_tiles]:
            shown = _shown(tile)
            panels += [shown, _tinted(shown, tile, seabed_cells(tile, model))]
    height = max(len(panel) for panel in panels)
    padded = [
        np.pad(
            panel,
            ((0, height - len(panel)), (0, _GAP_PX if number % 2 == 0 else 3 * _GAP_PX), (0, 0)),
            constant_values=_WHITE,
        )
        for number, panel in enumerate(panels)
    ]
    return np.concatenate([np.concatenate(padded, axis=1), _legend(sum(part.shape[1] for part in padded))])


def _tiles(log: Path) -> list[Tile]:
    config = Config()
    pipeline = Pipeline(config, detect=lambda tile: TileDetections((), 0, 0))
    outputs = [tile for event in open_log(log, config) for tile in pipeline.feed(event)] + pipeline.finish()
    return [tile for tile in outputs if isinstance(tile, Tile)]


def _shown(tile: Tile) -> Canvas:
    """Return the core, in squares of _PIXEL_M."""
    core = np.asarray(tile.intensity[tile.core_start : tile.core_stop], dtype=np.float32)
    size = (round(core.shape[1] * tile.column_spacing_m / _PIXEL_M), round(len(core) * tile.row_spacing_m / _PIXEL_M))
    grey = _PER_LEVEL * display_levels(cv2.resize(core, size, interpolation=cv2.INTER_AREA))
    return np.asarray(np.repeat(grey[::-1, :, np.newaxis], 3, axis=2), dtype=np.uint8)


def _tinted(shown: Canvas, tile: Tile, cells: SeabedCells) -> Canvas:
    row = np.minimum(((np.arange(len(shown)) + 0.5) * _PIXEL_M / cells.cell_m[0]).astype(int), cells.kind.shape[0] - 1)[
        ::-1
    ]
    column = np.minimum(
        ((np.arange(shown.shape[1]) + 0.5) * _PIXEL_M / cells.cell_m[1]).astype(int), cells.kind.shape[1] - 1
    )
    colours = np.array([KIND_COLOURS[kind] for kind in SEABED_TYPES], dtype=np.float64)[cells.kind[np.ix_(row, column)]]
    return np.rint((1.0 - _TINT) * shown + _TINT * colours * (0.4 + 0.6 * shown / _WHITE)).astype(np.uint8)


def _legend(width: int) -> Canvas:
    bar = np.full((_BAR_PX, width, 3), _WHITE, dtype=np.uint8)
    for number, (kind, colour) in enumerate(KIND_COLOURS.items()):
        left = _GAP_PX + number * 4 * _BAR_PX
        cv2.rectangle(bar, (left, 8), (left + 14, 22), colour, cv2.FILLED)
        cv2.putText(bar, kind, (left + 20, 20), cv2.FONT_HERSHEY_SIMPLEX, _LETTER, (20, 20, 20), 1, cv2.LINE_AA)
    return bar
