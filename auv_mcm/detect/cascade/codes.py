"""Convert tiles to whole numbers and integral images, box sums of four look-ups (Crow 1984).

Intensity becomes a code in 1/1024 of the local mean of the sea floor, at most 16 times that mean. Sums of codes are
uint32 modulo 2**32: however long the mission, the difference of four of them is the exact sum over a box of fewer than
131072 pixels. Whoever adds any number to all of an integral image changes nothing.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.bands import margins_px
from auv_mcm.kernels.cascade import CODE_OF_MEAN, encode, integral
from auv_mcm.records import LOW_RESOLUTION, Tile

MAX_BOX_PX: Final = 131071
"""Pixels of a box whose sum is exact whatever they hold."""


class CodePlane(NamedTuple):
    """Hold what a cascade reads of a tile.

    sums, counts: (n_rows + 2 margin_rows + 1, n_columns + margin_near + margin_far + 1) uint32 integral images of codes
    and of valid pixels modulo 2**32; element (i, j) is the sum over the padded plane's rows before i and columns before
    j. Beyond the tile codes are CODE_OF_MEAN and nothing is valid. usable: (n_rows, n_columns) bool, where windows may
    be centred. first_return_m: (n_rows,) float64.
    """

    sums: NDArray[np.uint32]
    counts: NDArray[np.uint32]
    usable: NDArray[np.bool_]
    first_return_m: NDArray[np.float64]
    row_spacing_m: float
    column_spacing_m: float
    margin_rows: int
    margin_near: int

    @property
    def n_rows(self) -> int:
        """Count the rows of the tile."""
        return int(self.usable.shape[0])

    @property
    def n_columns(self) -> int:
        """Count the columns of the tile."""
        return int(self.usable.shape[1])


def codes_of(intensity: NDArray[np.float32], valid: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """Convert intensity to codes (n_rows, n_columns) uint16, 0 to 16384.

    A code is 1024 times the intensity, rounded half to even.

    CODE_OF_MEAN where not valid or NaN.
    """
    return encode(intensity, valid.view(np.uint8))[0]


def make_plane(
    codes: NDArray[np.uint16],
    valid: NDArray[np.bool_],
    usable: NDArray[np.bool_],
    first_return_m: NDArray[np.float64],
    row_spacing_m: float,
    column_spacing_m: float,
) -> CodePlane:
    """Make a plane from codes, where they are valid, and where windows may be centred.

    Each (n_rows, n_columns); first_return_m: (n_rows,).
    """
    margins = margins_px(row_spacing_m, column_spacing_m)
    return CodePlane(
        sums=integral(codes, margins, CODE_OF_MEAN),
        counts=integral(valid, margins, 0),
        usable=usable,
        first_return_m=first_return_m,
        row_spacing_m=row_spacing_m,
        column_spacing_m=column_spacing_m,
        margin_rows=margins[0],
        margin_near=margins[1],
    )


def plane_of_tile(tile: Tile, rows: slice) -> CodePlane:
    """Make a tile's plane.

    Windows may be centred on pixels of `rows` that are VALID and not of LOW_RESOLUTION; NaN is not valid.
    """
    codes, valid = encode(tile.intensity, tile.mask)
    usable = np.zeros_like(valid)
    usable[rows] = valid[rows] & ((tile.mask[rows] & LOW_RESOLUTION) == 0)
    return make_plane(codes, valid, usable, tile.first_return_m, tile.row_spacing_m, tile.column_spacing_m)


def box_sums(
    plane: CodePlane, rows: NDArray[np.integer], columns: NDArray[np.integer], boxes_px: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Sum codes over boxes around pixels, int32.

    Parameters
    ----------
    rows, columns
        (...) int.
    boxes_px
        (..., 4) of bands.pixel_boxes, broadcast against them; e.g. rows[:, None] and pixel_boxes(...)[bands] give
        (n_windows, n_boxes).
    """
    return _box_sums(plane.sums, rows + plane.margin_rows, columns + plane.margin_near, boxes_px).view(np.int32)


def valid_counts(
    plane: CodePlane, rows: NDArray[np.integer], columns: NDArray[np.integer], boxes_px: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Count valid pixels in boxes around pixels, int32; arguments as for box_sums."""
    return _box_sums(plane.counts, rows + plane.margin_rows, columns + plane.margin_near, boxes_px).view(np.int32)


def _box_sums(
    integral: NDArray[np.uint32], rows: NDArray[np.integer], columns: NDArray[np.integer], boxes_px: NDArray[np.int32]
) -> NDArray[np.uint32]:
    top, bottom, left, right = np.moveaxis(boxes_px, -1, 0)
    upper, lower = rows + top, rows + bottom
    before, behind = columns + left, columns + right
    return np.asarray(
        (integral[lower, behind] - integral[upper, behind]) - (integral[lower, before] - integral[upper, before])
    )
