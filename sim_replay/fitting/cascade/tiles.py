"""Define labelled pieces of waterfall."""

from __future__ import annotations

from typing import Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import Side

Split: TypeAlias = Literal["train", "validate", "test"]
Origin: TypeAlias = Literal["simulated", "augmented"]


class TileObject(msgspec.Struct, frozen=True, kw_only=True):
    """Hold one object as a tile shows it.

    row, column: where the centre of its highlight is to be expected, fractional: pixel (i, j) covers [i, i + 1) and [j,
    j + 1), so the pixel that holds it is (floor(row), floor(column)). kind, seabed: as in truth.json, "unknown" if not
    given. ground_range_m: across-track distance of the object's middle. aspect_deg: direction of look against the
    object's long axis, clockwise, [0, 360): 90 and 270 are broadside; NaN if the axis is not known. length_m, width_m,
    height_m: of the whole object, NaN if not given.
    """

    row: float
    column: float
    kind: str
    is_target: bool
    seabed: str
    ground_range_m: float
    aspect_deg: float
    length_m: float
    width_m: float
    height_m: float


class LabelledTile(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold a tile of one side as the detector is given it, with everything that lies in it.

    codes: (n_rows, n_columns) uint16, round(min(intensity, 16) * 1024) with the local mean of the sea floor at 1024,
    which is also what pixels get that are not valid. valid: (n_rows, n_columns) bool, an echo was measured. usable: the
    same shape, the detector may report the pixel: valid, not of low resolution, in the core. Rows [core_start,
    core_stop) belong to this tile alone, the others are what windows of core pixels need. first_return_m: (n_rows,)
    float64 slant range of the first bottom return. objects: all whose expected centre is in the tile, its overlap
    included; those of the overlap come again in the next tile. background: "flat/600" or the name of a recorded line.
    Tiles of one background share their sea floor, so that splits keep them together.
    """

    codes: NDArray[np.uint16]
    valid: NDArray[np.bool_]
    usable: NDArray[np.bool_]
    core_start: int
    core_stop: int
    first_return_m: NDArray[np.float64]
    row_spacing_m: float
    column_spacing_m: float
    side: Side
    objects: tuple[TileObject, ...]
    background: str
    origin: Origin
