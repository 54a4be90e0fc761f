"""Store the seabed types under a survey as a grid of run-length coded text in truth.json.

Row 0 is the southernmost, columns grow eastward, in the plane tangent at the grid's south-west corner. A row is a
repeated `<count><letter>`: `a` is the first of `types`, `b` the second; `.` is sea floor that the sonar did not sweep.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Final

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike, NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.geometry.geodesy import LocalFrame

NOT_SWEPT: Final = -1  # instead of a type
MAX_TYPES: Final = 26  # letters of the alphabet
_MAX_CELLS: Final = 1 << 28  # 16 km by 16 km of 1 m; a damaged file must not ask for all memory
_SIGNS: Final = ".abcdefghijklmnopqrstuvwxyz"  # by type + 1
_RUN: Final = re.compile(r"([0-9]{1,9})([.a-z])")
_ROW: Final = re.compile(r"(?:[0-9]{1,9}[.a-z])*")


class SeabedMap(msgspec.Struct, frozen=True, kw_only=True):
    """Hold the sea floor's types on a grid.

    `latitude_deg`, `longitude_deg` are the grid's south-west corner; `rows` from south to north.
    """

    cell_m: Annotated[float, Meta(gt=0.0)]
    latitude_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    longitude_deg: Annotated[float, Meta(ge=-180.0, le=360.0)]
    types: Annotated[tuple[str, ...], Meta(max_length=MAX_TYPES)]
    n_rows: Annotated[int, Meta(ge=0)]
    n_columns: Annotated[int, Meta(ge=0)]
    rows: tuple[str, ...]


def encode(
    cells: NDArray[np.integer], *, types: Sequence[str], cell_m: float, latitude_deg: float, longitude_deg: float
) -> SeabedMap:
    """Encode the map of (n_rows, n_columns) indices into `types`, -1 where not swept.

    Raises ValueError for more than 26 types or an index without a type.
    """
    if len(types) > MAX_TYPES:
        raise ValueError(f"{len(types)} sea floor types, but the alphabet has {MAX_TYPES} letters")
    if cells.size and not NOT_SWEPT <= int(cells.min()) <= int(cells.max()) < len(types):
        raise ValueError(f"sea floor indices {cells.min()} to {cells.max()}, but there are {len(types)} types")
    n_rows, n_columns = cells.shape
    return SeabedMap(
        cell_m=cell_m,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        types=tuple(types),
        n_rows=n_rows,
        n_columns=n_columns,
        rows=tuple(_coded(row) for row in cells),
    )


def decode(seabed: SeabedMap) -> NDArray[np.int8]:
    """Decode the map: (n_rows, n_columns) indices into `types`, -1 where not swept.

    Raises BadInputError naming the row.
    """
    if len(seabed.rows) != seabed.n_rows:
        raise BadInputError(f"seabed_map.rows: {len(seabed.rows)} rows, but n_rows is {seabed.n_rows}. Make them agree")
    if seabed.n_rows * seabed.n_columns > _MAX_CELLS:
        raise BadInputError(
            f"seabed_map: {seabed.n_rows} x {seabed.n_columns} cells are more than {_MAX_CELLS}. Use a larger cell_m"
        )
    cells = np.empty((seabed.n_rows, seabed.n_columns), dtype=np.int8)
    signs = _SIGNS[: len(seabed.types) + 1]
    for index, text in enumerate(seabed.rows):
        where = f"seabed_map.rows[{index}]"
        if not _ROW.fullmatch(text):
            raise BadInputError(f"{where}: not a repeated <count><letter> such as 12a40b3. - correct the row")
        runs = _RUN.findall(text)
        strange = next((sign for _, sign in runs if sign not in signs), None)
        if strange is not None:
            raise BadInputError(
                f"{where}: letter '{strange}' has no type, there are {len(seabed.types)}. Add it to seabed_map.types"
            )
        counts = [int(count) for count, _ in runs]
        if sum(counts) != seabed.n_columns:
            raise BadInputError(
                f"{where}: runs of {sum(counts)} cells, but n_columns is {seabed.n_columns}. Make them agree"
            )
        cells[index] = np.repeat(np.array([signs.index(sign) - 1 for _, sign in runs], dtype=np.int8), counts)
    return cells


def types_at(
    seabed: SeabedMap, cells: NDArray[np.int8], latitude_deg: ArrayLike, longitude_deg: ArrayLike
) -> NDArray[np.int64]:
    """Look up indices into `types` under positions, in their shape.

    -1 off the grid, where it was not swept, and for NaN.
    """
    frame = LocalFrame(latitude_deg=seabed.latitude_deg, longitude_deg=seabed.longitude_deg)
    place = np.floor(frame.to_enu(latitude_deg, longitude_deg, 0.0)[..., :2] / seabed.cell_m)
    column, row = place[..., 0], place[..., 1]
    inside = (row >= 0) & (row < seabed.n_rows) & (column >= 0) & (column < seabed.n_columns)
    found = np.full(inside.shape, NOT_SWEPT, dtype=np.int64)
    found[inside] = cells[row[inside].astype(np.int64), column[inside].astype(np.int64)]
    return found


def _coded(row: NDArray[np.integer]) -> str:
    if row.size == 0:
        return ""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(row)) + 1])
    counts = np.diff(np.append(starts, row.size))
    return "".join(
        f"{count}{_SIGNS[kind + 1]}" for count, kind in zip(counts.tolist(), row[starts].tolist(), strict=True)
    )
