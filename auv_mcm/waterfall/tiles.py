"""Cut the stream of grid rows into overlapping metric tiles with the local seabed level divided out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import SIDES, Side, Tile
from auv_mcm.settings.config import WaterfallConfig
from auv_mcm.waterfall.grid import LEVEL_COLUMNS, Swath, concatenate_swaths, slice_swath, with_own_image
from auv_mcm.waterfall.radiometry import level_out


class TileCutter:
    """Hold rows until a tile's core and its overlap on both ends are there.

    The cores of tiles partition the mission grid at multiples of `tile_rows` (shifted by `origin_row`); the overlap
    holds what any decision about a core pixel can depend on, so where the boundaries lie does not matter to the result.
    """

    def __init__(self, config: WaterfallConfig, overlap_m: float, origin_row: int = 0) -> None:
        self._config = config
        self._overlap = math.ceil(overlap_m / config.row_spacing_m)
        self._origin = origin_row
        self._pieces: list[Swath] = []  # rows that follow each other, put together where a tile is cut
        self._n_rows = 0
        self._first_row = 0  # of the pieces
        self._core_row = 0  # next row not yet in any core
        self.squint_rad = 0.0
        """Of the pings of the segment under way."""

    def add(self, first_row: int, rows: Swath) -> list[Tile]:
        """Take finished rows, which continue those before; return the tiles they complete."""
        if not self._pieces:
            self._first_row = self._core_row = first_row
        self._pieces.append(rows)
        self._n_rows += rows.n_rows
        tiles: list[Tile] = []
        while self._stop_row >= self._next_boundary() + self._overlap:
            tiles += self._cut(self._next_boundary())
        return tiles

    def close(self) -> list[Tile]:
        """Give the tiles of the remaining rows; the cutter is ready for another segment afterwards."""
        tiles: list[Tile] = []
        while self._pieces and self._core_row < self._stop_row:
            tiles += self._cut(min(self._next_boundary(), self._stop_row))
        self._pieces, self._n_rows = [], 0
        return tiles

    def newest(self, from_row: int, min_rows: int, n_behind: int, n_ahead: int) -> list[Tile]:
        """Give the rows from `from_row` on, or from the first that is held, as tiles that belong to no partition.

        It leaves all as it is. The newest `n_ahead` rows and up to `n_behind` rows before are overlap. Empty where the
        core would have fewer than `min_rows` rows.
        """
        core_start, core_stop = max(from_row, self._first_row), self._stop_row - n_ahead
        if core_stop - core_start < max(min_rows, 1):
            return []
        start = max(core_start - n_behind, self._first_row)
        pieces: list[Swath] = []
        n_rows = 0
        for swath in reversed(self._pieces):
            pieces.append(swath)
            n_rows += swath.n_rows
            if n_rows >= self._stop_row - start:
                break
        rows = concatenate_swaths(pieces[::-1])
        piece = slice_swath(rows, slice(n_rows - (self._stop_row - start), None))
        index = (core_start - self._origin) // self._config.tile_rows
        return [
            self._tile(side, index, start, core_start - start, core_stop - start, piece)
            for side in SIDES
            if side in piece.sides
        ]

    def next_segment_row(self) -> int:
        """Give the first row another segment may start at, so that no two tiles share an index."""
        return self._next_boundary()

    @property
    def _stop_row(self) -> int:
        return self._first_row + self._n_rows

    def _next_boundary(self) -> int:
        tile_rows = self._config.tile_rows
        return ((self._core_row - self._origin) // tile_rows + 1) * tile_rows + self._origin

    def _cut(self, core_stop: int) -> list[Tile]:
        rows = concatenate_swaths(self._pieces)
        start = max(self._core_row - self._overlap, self._first_row)
        stop = min(core_stop + self._overlap, self._stop_row)
        piece = slice_swath(rows, slice(start - self._first_row, stop - self._first_row))
        index, core_row = (self._core_row - self._origin) // self._config.tile_rows, self._core_row
        keep = max(core_stop - self._overlap, self._first_row)
        # Before tiles are levelled: the pieces take as much memory as the rows.
        self._pieces = [with_own_image(slice_swath(rows, slice(keep - self._first_row, None)))]
        self._core_row, self._n_rows, self._first_row = core_stop, self._pieces[0].n_rows, keep
        del rows
        return [
            self._tile(side, index, start, core_row - start, core_stop - start, piece)
            for side in SIDES
            if side in piece.sides
        ]

    def _tile(self, side: Side, index: int, first_row: int, core_start: int, core_stop: int, piece: Swath) -> Tile:
        image = piece.sides[side]
        row_spacing_m, column_spacing_m = self._config.row_spacing_m, self._config.column_spacing_m
        n_columns = image.mask.shape[1]
        some = np.minimum(np.arange(LEVEL_COLUMNS // 2, n_columns + LEVEL_COLUMNS // 2, LEVEL_COLUMNS), n_columns - 1)
        levelled = level_out(image.intensity, image.mask, some, row_spacing_m, column_spacing_m)
        return Tile(
            side=side,
            index=index,
            first_row=first_row,
            core_start=core_start,
            core_stop=core_stop,
            row_spacing_m=row_spacing_m,
            column_spacing_m=column_spacing_m,
            intensity=levelled.intensity,
            mask=levelled.mask,
            pose=piece.pose,
            first_return_m=piece.first_return_m,
            first_return_sigma_m=piece.first_return_sigma_m,
            ping_number=piece.ping_number,
            level=_level(image.offset, levelled.mean, levelled.known),
            squint_rad=self.squint_rad,
        )


def _level(
    offset: NDArray[np.float32] | None, mean: NDArray[np.float64], known: NDArray[np.bool_]
) -> NDArray[np.float32] | None:
    """Measure the local mean against that of the mission at the same grazing angle; all (n_rows, n), in the columns of
    the offset."""
    if offset is None:
        return None
    log_mean = np.log(mean, out=np.full(mean.shape, np.nan), where=known & (mean > 0.0))
    return np.asarray(log_mean + offset, dtype=np.float32)
