"""Made-up tiles and chips for the tests of the classical classifier."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import Side
from sim_replay.fitting.cascade.classical.chips import CENTRE_COLUMN, CENTRE_ROW, N_COLUMNS, N_OBJECT_COLUMNS, N_ROWS
from sim_replay.fitting.cascade.tiles import LabelledTile, TileObject

Array = NDArray[np.float64]

N_TILE_ROWS: Final = 260
N_TILE_COLUMNS: Final = 400
ALTITUDE_M: Final = 6.0
ROW_M, COLUMN_M = 0.12, 0.06


def generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def chip_of(seed: int, with_object: bool) -> Array:
    """Contrast (N_ROWS, N_COLUMNS) of log-normal floor, with a highlight and a shadow if asked for."""
    contrast = generator(seed).normal(0.0, 0.4, (N_ROWS, N_COLUMNS))
    if with_object:
        contrast[CENTRE_ROW - 2 : CENTRE_ROW + 3, CENTRE_COLUMN - 3 : CENTRE_COLUMN + 4] += 2.0
        contrast[CENTRE_ROW - 2 : CENTRE_ROW + 3, N_OBJECT_COLUMNS - 2 : N_OBJECT_COLUMNS + 16] -= 2.0
    return contrast - np.median(contrast)


def tile_with(kinds: tuple[str, ...], seed: int, background: str = "made up/1", side: Side = "port") -> LabelledTile:
    """Speckle with an object every 6 m along track, each at another range: a mine is a highlight before a shadow, a
    "rock" a small highlight alone."""
    draw = generator(seed)
    intensity = draw.gamma(4.0, 0.25, (N_TILE_ROWS, N_TILE_COLUMNS))
    objects = []
    for index, kind in enumerate(kinds):
        row, column = 40 + 50 * index, 120 + int(draw.integers(0, 160))
        shadow = round(0.35 * column / (ALTITUDE_M - 0.35))
        half_rows, half_columns = (2, 2) if kind == "rock" else (4, 5)
        intensity[row - half_rows : row + half_rows + 1, column - half_columns : column + half_columns + 1] *= 6.0
        if kind != "rock":
            intensity[row - 4 : row + 5, column + half_columns + 1 : column + half_columns + 1 + shadow + 5] *= 0.05
        objects.append(
            TileObject(
                row=row + 0.5,
                column=column + 0.5,
                kind=kind,
                is_target=kind != "rock",
                seabed="sand",
                ground_range_m=(column + 0.5) * COLUMN_M,
                aspect_deg=90.0,
                length_m=1.0,
                width_m=0.6,
                height_m=0.35,
            )
        )
    usable = np.zeros(intensity.shape, dtype=np.bool_)
    usable[20:-20, 40:] = True
    return LabelledTile(
        codes=np.rint(np.minimum(intensity, 16.0) * 1024.0).astype(np.uint16),
        valid=np.ones(intensity.shape, dtype=np.bool_),
        usable=usable,
        core_start=20,
        core_stop=N_TILE_ROWS - 20,
        first_return_m=np.full(N_TILE_ROWS, ALTITUDE_M),
        row_spacing_m=ROW_M,
        column_spacing_m=COLUMN_M,
        side=side,
        objects=tuple(objects),
        background=background,
        origin="simulated",
    )
