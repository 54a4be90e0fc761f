"""Keep the waterfall of a mission on disk, a byte a pixel, to be cut into pictures of any place and scale.

Each piece of the waterfall is stored three times: as it is, reduced by 8 and by 64 both ways. Any other power of two is
reduced from the next finer one when it is asked for, so that no request reads more than four times what it returns per
axis. Means are taken over linear intensity.
"""

from __future__ import annotations

import math
import os
import tempfile
import weakref
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import wrap_longitude_deg
from auv_mcm.records import NAN, SIDES, VALID, PoseTrack, Side, Tile
from auv_mcm.snippet import pack_snippet, unpack_snippet

TILE_PX: Final = 256
"""Rows and columns of a picture tile: 64 kB, decoded within a frame of 16 ms."""
MAX_LEVEL: Final = 12
"""Most halvings of a picture: 4096 rows of 0.12 m in a pixel, which shows 10 h in 150 pixels."""
MAX_BYTES: Final = 8 << 30
"""Bytes on disk for all pixels: 70 h of two sides of 833 columns at 2 m/s and 0.12 m; later ones are not kept."""

_STEP: Final = 8  # reduction between two stored levels
_STORED: Final = (0, 3, 6)  # levels on disk: powers of _STEP
_POSE: Final = (
    *("time_s", "latitude_deg", "longitude_deg", "depth_m", "heading_rad", "pitch_rad", "roll_rad"),
    *("speed_mps", "altitude_m", "stale"),
)
_FIELDS: Final = (*_POSE, "first_return_m")
_FIRST_ROWS: Final = 4096  # that room is made for at first


class Seen(NamedTuple):
    """Hold when something was seen, on which side, and where it lies; "" and NaN for what is not known."""

    time_s: float
    side: str = ""
    latitude_deg: float = NAN
    longitude_deg: float = NAN


class _Piece(NamedTuple):
    """Hold where a piece of one side at one level is. row, n_rows: in pixels of the level; offset: in the file."""

    row: int
    n_rows: int
    n_columns: int
    offset: int


class WaterfallStore:
    """Take tiles in order and give pictures and poses of what is there. One thread adds, others may read."""

    def __init__(self, max_bytes: int = MAX_BYTES, *, is_provisional: bool = False) -> None:
        """Open a temporary file without a name: it goes when the process does.

        is_provisional: another store takes its place, so that no picture is final.
        """
        self.is_provisional = is_provisional
        with tempfile.TemporaryFile() as file:
            self._descriptor = os.dup(file.fileno())
        self.close = weakref.finalize(self, os.close, self._descriptor)
        """Gives the disk space back, as the end of the store does."""
        self._max_bytes = max_bytes
        self._n_bytes = 0
        self._pieces: dict[tuple[str, int], list[_Piece]] = {(side, level): [] for side in SIDES for level in _STORED}
        self._rows = np.full((_FIRST_ROWS, len(_FIELDS)), np.nan)
        self.row_spacing_m = self.column_spacing_m = 0.0
        self.first_row = self.stop_row = 0
        self.n_columns = 0
        """Columns of the wider side so far."""
        self.is_full = False
        """Whether pixels were left out because the disk space for them is used up."""

    def add(self, tile: Tile) -> None:
        """Keep the core of a tile. Raises OSError, as on a full disk."""
        core = slice(tile.core_start, tile.core_stop)
        n_rows = tile.core_stop - tile.core_start
        if n_rows <= 0:
            return
        first_row = tile.first_row + tile.core_start
        if not self.row_spacing_m:
            self.row_spacing_m, self.column_spacing_m, self.first_row = (
                tile.row_spacing_m,
                tile.column_spacing_m,
                first_row,
            )
        self._keep_rows(tile, core, first_row)
        linear = np.where((tile.mask[core] & VALID) != 0, tile.intensity[core], np.float32(0.0))
        row = first_row
        for level in _STORED:
            if level:
                linear, row = _mean(linear, _STEP), (row + _STEP // 2) // _STEP
            self._write(tile.side, level, row, pack_snippet(linear))
        self.n_columns = max(self.n_columns, tile.intensity.shape[1])
        self.first_row = min(self.first_row, first_row)
        self.stop_row = max(self.stop_row, first_row + n_rows)

    def picture(self, level: int, tile_row: int, tile_column: int) -> NDArray[np.uint8]:
        """Cut out one picture tile, (TILE_PX, TILE_PX) codes of `auv_mcm.snippet`, 0 where there is nothing.

        Its pixels are 2**level rows and columns of the waterfall. Earlier rows come first; columns go from port to
        starboard, column 0 is the first one to starboard.

        Parameters
        ----------
        level
            0 to MAX_LEVEL.
        tile_row, tile_column
            Number of the tile, from row and column 0 of the mission; negative columns are to port.
        """
        stored = max(held for held in _STORED if held <= level)
        factor = 1 << (level - stored)
        size = TILE_PX * factor
        first = tile_row * size
        near = tile_column * size if tile_column >= 0 else -(tile_column + 1) * size
        side: Side = "starboard" if tile_column >= 0 else "port"
        # What lies beyond the last row and column is not worth reducing.
        n_rows = max(min(size, (self.stop_row >> stored) + 1 - first), 0)
        n_columns = max(min(size, (self.n_columns >> stored) + 1 - near), 0)
        codes = self._read(side, stored, first, near, (n_rows, n_columns))
        if factor > 1:
            codes = pack_snippet(_mean(unpack_snippet(codes), factor))
        tile = np.zeros((TILE_PX, TILE_PX), dtype=np.uint8)
        tile[: codes.shape[0], : codes.shape[1]] = codes
        return tile if side == "starboard" else np.ascontiguousarray(tile[:, ::-1])

    def is_final(self, level: int, tile_row: int) -> bool:
        """Find whether a row of picture tiles is complete, so that it will not change."""
        return not self.is_provisional and (tile_row + 1) * TILE_PX << level <= self.stop_row - _STEP**2

    def poses(self, rows: NDArray[np.int64]) -> tuple[PoseTrack, NDArray[np.float64]]:
        """Give the poses and first returns, m, of rows (n,); the first or last row stands for those beyond it.

        NaN where a row has no ping.
        """
        kept = self._rows[np.clip(rows, 0, max(self.stop_row - 1, 0))]
        columns = {name: np.ascontiguousarray(kept[:, index]) for index, name in enumerate(_FIELDS)}
        first_return_m = columns.pop("first_return_m")
        stale: NDArray[np.bool_] = columns.pop("stale") != 0.0  # NaN, of a row without a ping, is stale
        return PoseTrack(stale=stale, **columns), first_return_m

    def times(self) -> NDArray[np.float64]:
        """Give the time of each row from row 0, UTC seconds, NaN where there is none; a view of what is kept."""
        return self._rows[: self.stop_row, 0]

    def rows_at(self, seen: Sequence[Seen]) -> list[float]:
        """Find the row at which each was seen, from the upper edge of row 0; NaN where there is none (yet).

        A time may have several rows, as where sides have logs of their own or a clock was set back: of these it is one
        that shows the side, and the one nearest to the place.
        """
        times = self.times()
        known = np.flatnonzero(np.isfinite(times))
        if not len(known) or not seen:
            return [math.nan] * len(seen)
        wanted_s, latitude_deg, longitude_deg = np.array([(one.time_s, *one[2:]) for one in seen], dtype=np.float64).T
        shape = len(seen), 1 + np.count_nonzero(np.diff(times[known]) < 0.0)
        rows, lacking, away_deg, outside_s = np.full((4, *shape), np.nan)
        for number, run in enumerate(np.split(known, np.flatnonzero(np.diff(times[known]) < 0.0) + 1)):
            rows[:, number] = np.interp(wanted_s, times[run], run + 0.5)
            outside_s[:, number] = np.maximum(times[run[0]] - wanted_s, wanted_s - times[run[-1]]).clip(0.0)
            at = np.nan_to_num(rows[:, number]).astype(np.int64)
            there = self._rows[at]
            north_deg, east_deg = latitude_deg - there[:, 1], wrap_longitude_deg(longitude_deg - there[:, 2])
            away_deg[:, number] = np.hypot(north_deg, east_deg * np.cos(np.radians(latitude_deg)))
            lacking[:, number] = [not self._shows(one.side, row) for one, row in zip(seen, at.tolist(), strict=True)]
        # a metre at 0.5 m/s is within two seconds: what lies farther off is not in this waterfall
        outside = ~(outside_s <= 2.0)
        best = np.lexsort((outside_s, away_deg, lacking, outside), axis=-1)[:, :1]
        found = np.take_along_axis(np.where(outside, np.nan, rows), best, axis=-1)
        return [float(row) for row in found[:, 0]]

    def _shows(self, side: str, row: int) -> bool:
        """Find whether a side has pixels at a row."""
        pieces = self._pieces.get((side, 0), [])
        at = bisect_right(pieces, row, key=_row_of) - 1
        return at >= 0 and row < pieces[at].row + pieces[at].n_rows

    def _keep_rows(self, tile: Tile, core: slice, first_row: int) -> None:
        stop = first_row + tile.core_stop - tile.core_start
        if stop > len(self._rows):
            grown = np.full((max(2 * len(self._rows), stop), len(_FIELDS)), np.nan)
            grown[: len(self._rows)] = self._rows
            self._rows = grown
        values = [*(getattr(tile.pose, name)[core] for name in _POSE), tile.first_return_m[core]]
        self._rows[first_row:stop] = np.column_stack(values)

    def _write(self, side: Side, level: int, row: int, codes: NDArray[np.uint8]) -> None:
        if self._n_bytes + codes.nbytes > self._max_bytes:
            self.is_full = True
            return
        rest = memoryview(codes.tobytes())
        offset = self._n_bytes
        while rest:
            n_bytes = os.pwrite(self._descriptor, rest, self._n_bytes)
            self._n_bytes += n_bytes
            rest = rest[n_bytes:]
        self._pieces[side, level].append(_Piece(row, codes.shape[0], codes.shape[1], offset))

    def _read(self, side: Side, level: int, first: int, near: int, shape: tuple[int, int]) -> NDArray[np.uint8]:
        codes = np.zeros(shape, dtype=np.uint8)
        pieces = self._pieces[side, level]
        start = max(bisect_left(pieces, first, key=_row_of) - 1, 0)
        for piece in _until(pieces, start, first + shape[0]):
            top, stop = max(piece.row, first), min(piece.row + piece.n_rows, first + shape[0])
            n_columns = min(piece.n_columns - near, shape[1])
            if stop <= top or n_columns <= 0:
                continue
            data = os.pread(
                self._descriptor, (stop - top) * piece.n_columns, piece.offset + (top - piece.row) * piece.n_columns
            )
            pixels = np.frombuffer(data, dtype=np.uint8).reshape(stop - top, piece.n_columns)
            codes[top - first : stop - first, :n_columns] = pixels[:, near : near + n_columns]
        return codes


def _row_of(piece: _Piece) -> int:
    return piece.row


def _until(pieces: list[_Piece], start: int, stop_row: int) -> Iterable[_Piece]:
    for index in range(start, len(pieces)):
        if pieces[index].row >= stop_row:
            return
        yield pieces[index]


def _mean(linear: NDArray[Any], factor: int) -> NDArray[np.float32]:
    """Average linear intensity over blocks of factor x factor pixels, those without an echo (0) left out."""
    padded = np.pad(linear, ((0, -linear.shape[0] % factor), (0, -linear.shape[1] % factor)))
    blocks = padded.reshape(padded.shape[0] // factor, factor, padded.shape[1] // factor, factor)
    n_echoes = np.count_nonzero(blocks, axis=(1, 3))
    return np.asarray(blocks.sum(axis=(1, 3), dtype=np.float32) / np.maximum(n_echoes, 1), dtype=np.float32)
