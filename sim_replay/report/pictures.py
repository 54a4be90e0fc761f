"""Collect waterfall strips of a mission, reduced to display bytes while tiles stream by.

A mission of any length fits a fixed number of bytes: when they are used up, all pictures are reduced by two and the
mission goes on at half the resolution.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from itertools import pairwise
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.contact_picture import (
    LEVELS,
    SOFT,
    TURNED,
    Bytes,
    coloured_levels,
    display_levels,
    encoded,
    snippet_picture,
)
from auv_mcm.records import LOW_RESOLUTION, TURN, VALID, Detection, Side, Tile

MAX_PIXELS: Final = 12_000_000  # kept: a pixel takes 0.17 to 0.24 bytes of JPEG at the lowest quality, so no more fit
# 2.5 MB in the page: enough to find a place, where each contact has a picture of its own
MAX_JPEG_BYTES: Final = 1_900_000
_MAX_SWATH_PIXELS: Final = 1600
_STRIP_ASPECT: Final = 1.25  # a strip's length along track over the swath's width
_QUALITIES: Final = (86, 74, 60, 48)


class PictureStrip(NamedTuple):
    """Hold a stretch of the waterfall, port left, starboard right, later pings above.

    As seen from above, travelling up.

    gaps_m: along-track stretches without data, metres from the mission's first grid row. turns_m: those in which the
    vehicle turned, which earn no coverage; they are marked beside the picture, which shows what was seen.
    """

    number: int
    start_m: float
    stop_m: float
    half_width_m: float
    jpeg: bytes
    width_px: int
    height_px: int
    gaps_m: tuple[tuple[float, float], ...]
    turns_m: tuple[tuple[float, float], ...] = ()

    def holds(self, row_m: float) -> bool:
        """Find whether the strip holds a place along the track, m."""
        return self.start_m <= row_m < self.stop_m


class _Piece(NamedTuple):
    """Hold one side of one tile's core. pixels: (rows, columns), column 0 at nadir."""

    side: Side
    first_row: int
    n_rows: int
    pixels: Bytes


class PictureCollector:
    """Keep small pictures of the tiles it is given, never more than `max_pixels` bytes of them."""

    def __init__(self, max_pixels: int = MAX_PIXELS) -> None:
        self._max_pixels = max_pixels
        self._pieces: list[_Piece] = []
        self._marks: dict[int, float] = {}
        self._rows_per_pixel = 1
        self._columns_per_pixel = 0
        self._row_spacing_m = 0.0
        self._column_spacing_m = 0.0

    @property
    def n_bytes(self) -> int:
        return sum(piece.pixels.nbytes for piece in self._pieces)

    def add_tile(self, tile: Tile) -> None:
        """Reduce a tile's core to its display picture; the tile itself is not kept."""
        if not self._columns_per_pixel:
            self._row_spacing_m, self._column_spacing_m = tile.row_spacing_m, tile.column_spacing_m
            self._columns_per_pixel = 1
            while 2 * tile.intensity.shape[1] > _MAX_SWATH_PIXELS * self._columns_per_pixel:
                self._halve()
        core = slice(tile.core_start, tile.core_stop)
        if tile.core_stop <= tile.core_start or not tile.intensity.shape[1]:
            return
        pixels = _reduced(tile.intensity[core], tile.mask[core], self._rows_per_pixel, self._columns_per_pixel)
        first_row = tile.first_row + tile.core_start
        self._pieces.append(_Piece(tile.side, first_row, tile.core_stop - tile.core_start, pixels))
        times = tile.pose.time_s[core]
        timed = np.flatnonzero(np.isfinite(times) & (tile.ping_number[core] >= 0))
        for row in (*timed[:1].tolist(), *timed[-1:].tolist()):
            self._marks[first_row + row] = float(times[row])
        while self.n_bytes > self._max_pixels:
            self._halve()

    def times(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """List along-track metres from the first grid row, ascending, and the UTC seconds of the vehicle there.

        Two arrays of equal length.
        """
        marks = sorted(self._marks.items())
        return np.array([row * self._row_spacing_m for row, _ in marks]), np.array([time_s for _, time_s in marks])

    def strips(self, max_bytes: int = MAX_JPEG_BYTES) -> tuple[PictureStrip, ...]:
        """Cut a mission that has any echo into strips of about equal length, their pictures within `max_bytes`."""
        while True:
            for quality in _QUALITIES:
                if (strips := self._drawn(quality, max_bytes)) is not None:
                    return strips
            self._halve()

    def _halve(self) -> None:
        """Halve the resolution, first across only, until pixels are about square."""
        pixel_m = self._rows_per_pixel * self._row_spacing_m, self._columns_per_pixel * self._column_spacing_m
        rows = 2 if pixel_m[0] < 1.5 * pixel_m[1] else 1
        columns = 2 if pixel_m[1] < 1.5 * pixel_m[0] else 1
        self._pieces = [piece._replace(pixels=_coarser(piece.pixels, rows, columns)) for piece in self._pieces]
        self._rows_per_pixel *= rows
        self._columns_per_pixel *= columns

    def _drawn(self, quality: int, max_bytes: int) -> tuple[PictureStrip, ...] | None:
        if not any((piece.pixels & LEVELS).any() for piece in self._pieces):
            return ()
        first = min(piece.first_row for piece in self._pieces)
        stop = max(piece.first_row + piece.n_rows for piece in self._pieces)
        half_px = max(_columns_used(piece.pixels) for piece in self._pieces)
        half_m = half_px * self._columns_per_pixel * self._column_spacing_m
        n_strips = max(1, round((stop - first) * self._row_spacing_m / (2.0 * half_m * _STRIP_ASPECT)))
        edges = np.linspace(first, stop, n_strips + 1).round().astype(int).tolist()
        strips: list[PictureStrip] = []
        for start_row, stop_row in pairwise(edges):
            here = [
                piece
                for piece in self._pieces
                if piece.first_row < stop_row and piece.first_row + piece.n_rows > start_row
            ]
            if here:
                strips.append(self._strip(len(strips) + 1, here, start_row, stop_row, half_px, quality))
                max_bytes -= len(strips[-1].jpeg)
            if max_bytes < 0:
                return None  # whatever the others are
        return tuple(strips)

    def _strip(
        self, number: int, pieces: Sequence[_Piece], start_row: int, stop_row: int, half_px: int, quality: int
    ) -> PictureStrip:
        rows = max(1, -(-(stop_row - start_row) // self._rows_per_pixel))
        canvas = np.zeros((rows, 2 * half_px), dtype=np.uint8)
        for piece in pieces:
            top = round((piece.first_row - start_row) / self._rows_per_pixel)
            pixels = piece.pixels[max(0, -top) : max(0, rows - top), :half_px]
            at = slice(max(0, top), max(0, top) + len(pixels))
            if piece.side == "port":
                canvas[at, half_px - pixels.shape[1] : half_px] = pixels[:, ::-1]
            else:
                canvas[at, half_px : half_px + pixels.shape[1]] = pixels
        in_turn = canvas >> 6 == TURNED
        turned = in_turn.sum(axis=1) > 0.5 * np.maximum(np.count_nonzero(canvas, axis=1), 1)
        canvas[in_turn] &= LEVELS
        jpeg = encoded(coloured_levels(canvas[::-1]), ".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality])
        metres = self._row_spacing_m
        return PictureStrip(
            number=number,
            start_m=start_row * metres,
            stop_m=stop_row * metres,
            half_width_m=half_px * self._columns_per_pixel * self._column_spacing_m,
            jpeg=jpeg,
            width_px=2 * half_px,
            height_px=rows,
            gaps_m=tuple((start * metres, stop * metres) for start, stop in _gaps(pieces, start_row, stop_row)),
            turns_m=tuple(
                (
                    metres * (start_row + start * self._rows_per_pixel),
                    metres * (start_row + stop * self._rows_per_pixel),
                )
                for start, stop in _stretches(turned)
            ),
        )


def snippet_jpeg(view: Detection) -> bytes:
    """Encode a contact's picture at its own resolution, for the page."""
    return encoded(snippet_picture(view), ".jpg", [cv2.IMWRITE_JPEG_QUALITY, 88])


def _reduced(intensity: NDArray[np.float32], mask: Bytes, rows: int, columns: int) -> Bytes:
    """Average linear intensity over blocks of rows x columns pixels, as display bytes."""
    valid = (mask & VALID) != 0
    total, count, bits = np.where(valid, intensity, np.float32(0.0)), valid, mask
    if rows > 1 or columns > 1:
        total = sum(_phases(total, rows, columns), start=np.zeros((1, 1), dtype=np.float32))
        count = sum(_phases(count, rows, columns), start=np.zeros((1, 1), dtype=np.uint16))
        bits = reduce(np.bitwise_or, _phases(mask, rows, columns))
    pixels = display_levels(total / np.maximum(count, 1).astype(np.float32))
    pixels[count == 0] = 0
    pixels[(bits & LOW_RESOLUTION) != 0] |= SOFT << 6
    pixels[(bits & TURN) != 0] = (pixels[(bits & TURN) != 0] & LEVELS) | TURNED << 6
    return pixels


def _coarser(pixels: Bytes, rows: int, columns: int) -> Bytes:
    """Take the mean level of the echoes and the gravest condition of blocks of display bytes."""
    phases = _phases(pixels, rows, columns)
    total = sum((phase & LEVELS for phase in phases), start=np.zeros((1, 1), dtype=np.uint16))
    count = sum(((phase & LEVELS) > 0 for phase in phases), start=np.zeros((1, 1), dtype=np.uint16))
    mean = (total + count // 2) // np.maximum(count, 1)
    condition = reduce(np.maximum, (phase >> 6 for phase in phases))
    return np.asarray(condition << 6 | mean.astype(np.uint8), dtype=np.uint8)


def _phases(image: NDArray[Any], rows: int, columns: int) -> list[NDArray[Any]]:
    """Split an image into the rows x columns images of every rows-th row and columns-th column.

    It is padded with zeros to whole blocks first.
    """
    padded = np.pad(image, ((0, -image.shape[0] % rows), (0, -image.shape[1] % columns)))
    return [padded[row::rows, column::columns] for row in range(rows) for column in range(columns)]


def _columns_used(pixels: Bytes) -> int:
    used = np.flatnonzero(pixels.any(axis=0))
    return int(used[-1]) + 1 if len(used) else 1


def _stretches(chosen: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Find the stretches [first, stop) in which something holds."""
    edges = np.flatnonzero(np.diff(np.pad(chosen.astype(np.int8), 1)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _gaps(pieces: Sequence[_Piece], start_row: int, stop_row: int) -> list[tuple[int, int]]:
    gaps, seen = [], start_row
    for first, stop in sorted((piece.first_row, piece.first_row + piece.n_rows) for piece in pieces):
        if first > seen:
            gaps.append((seen, min(first, stop_row)))
        seen = max(seen, stop)
    return [*gaps, (seen, stop_row)] if seen < stop_row else gaps
