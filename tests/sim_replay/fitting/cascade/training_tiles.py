"""Small labelled tiles of speckle with drawn targets and rocks, for the tests of this folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from auv_mcm.detect.cascade.codes import codes_of
from sim_replay.fitting.cascade.store import Manifest, pack, write_set
from sim_replay.fitting.cascade.tiles import LabelledTile, Split, TileObject

ROW_M: Final = 0.12
COLUMN_M: Final = 0.06
ALTITUDE_M: Final = 7.0
N_ROWS: Final = 70
N_COLUMNS: Final = 360
CORE: Final = slice(10, 60)


def tile_object(row: float, column: float, is_target: bool = True) -> TileObject:
    return TileObject(
        row=row,
        column=column,
        kind="cylinder" if is_target else "rock",
        is_target=is_target,
        seabed="sand",
        ground_range_m=column * COLUMN_M,
        aspect_deg=90.0,
        length_m=0.6,
        width_m=0.5,
        height_m=0.4,
    )


def labelled_tile(objects: tuple[TileObject, ...], seed: int = 0, background: str = "drawn/0") -> LabelledTile:
    """Targets are a highlight and the shadow of 0.35 m behind it, rocks the highlight alone."""
    intensity = np.random.Generator(np.random.PCG64(seed)).gamma(3.0, 1.0 / 3.0, (N_ROWS, N_COLUMNS)).astype(np.float32)
    for item in objects:
        row, column = int(item.row), int(item.column)
        rows = slice(max(row - 2, 0), row + 3)
        intensity[rows, column - 2 : column + 3] *= 5.0
        if item.is_target:
            shadow_px = round(0.35 * column / (ALTITUDE_M - 0.35))
            intensity[rows, column + 4 : column + 4 + shadow_px] *= 0.1
    valid = np.ones(intensity.shape, dtype=np.bool_)
    usable = valid.copy()
    usable[: CORE.start] = usable[CORE.stop :] = False
    usable[:, :20] = False
    return LabelledTile(
        codes=codes_of(intensity, valid),
        valid=valid,
        usable=usable,
        core_start=CORE.start,
        core_stop=CORE.stop,
        first_return_m=np.full(N_ROWS, ALTITUDE_M),
        row_spacing_m=ROW_M,
        column_spacing_m=COLUMN_M,
        side="starboard",
        objects=objects,
        background=background,
        origin="simulated",
    )


def drawn_tile(seed: int, background: str = "drawn/0") -> LabelledTile:
    """Three targets and two rocks at random places that are apart."""
    rng = np.random.Generator(np.random.PCG64([seed, 1]))
    columns = 60 + 60 * np.arange(5) + rng.integers(-8, 8, 5)
    rows = rng.integers(CORE.start + 6, CORE.stop - 6, 5)
    order = rng.permutation(5).tolist()
    places = list(zip(rows.tolist(), columns.tolist(), strict=True))
    return labelled_tile(
        tuple(tile_object(places[k][0] + 0.5, places[k][1] + 0.5, k < 3) for k in order), seed, background
    )


def write_drawn_set(
    folder: Path, n_train: int = 6, n_validate: int = 2, tiles: int = 2, made_from: dict[str, Any] | None = None
) -> Manifest:
    """A training set of missions with `tiles` tiles each."""
    folder.mkdir(exist_ok=True)
    packed = []
    for number in range(n_train + n_validate):
        split: Split = "train" if number < n_train else "validate"
        background = f"drawn/{number}"
        packed.append(
            pack([drawn_tile(100 * number + k, background) for k in range(tiles)], split, background, "simulated")
        )
    return write_set(folder, packed, made_from or {})
