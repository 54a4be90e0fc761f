"""Measure the live sea floor's time against its error."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import Tile
from auv_mcm.seabed.seabed_cells import seabed_cells
from auv_mcm.seabed.seabed_model import kind_indices, seabed_odds, shipped_seabed_model
from auv_mcm.seabed.texture import Texture, measure_texture
from sim_replay.benches.every_stage.rows import Row
from sim_replay.fitting.seabed.samples import drawn_mission, tiles_of, true_shares

JUDGED_SEEDS: Final = range(91010, 91020)
"""A mission like each of the ten named scenes; none was fitted on."""
MIN_KNOWN: Final = 0.5  # of a cell's places, as where the payload's model is fitted
_MAX_WRONG: Final = 0.3  # of cells of each kind; a check for what is broken, drawn missions differ much


class _Judged(NamedTuple):
    """Hold a tile, and its cells (n, 2) of which the truth is known with the shares of kinds in each."""

    tile: Tile
    texture: Texture
    cells: NDArray[np.intp]
    shares: NDArray[np.float64]


def sea_floor_rows(n: int) -> list[Row]:
    """Classify tiles of held-out missions, with neighbours and without."""
    judged = [_first_tile(seed) for seed in JUDGED_SEEDS[:n]]
    model, kinds = shipped_seabed_model(), kind_indices(shipped_seabed_model())
    shares = np.concatenate([each.shares for each in judged])

    def with_neighbours() -> list[NDArray[np.uint8]]:
        return [seabed_cells(each.tile, model).kind for each in judged]

    def alone() -> list[NDArray[np.uint8]]:
        textures = [measure_texture(each.tile) for each in judged]
        return [
            kinds[
                seabed_odds(found.features, np.broadcast_to(found.cot_grazing, found.features.shape[:2]), model)[
                    0
                ].argmax(axis=-1)
            ]
            for found in textures
        ]

    def wrong(found: list[NDArray[np.uint8]]) -> float:
        taken = np.concatenate([kind[tuple(each.cells.T)] for kind, each in zip(found, judged, strict=True)])
        place = np.full(256, -1)  # of `unknown`, which counts as wrong
        place[kinds] = np.arange(len(kinds))
        return share_wrong(place[taken], shares)

    cells, unit = f"{len(judged)} tiles, {len(shares)} cells", "share of cells wrong, mean over kinds"
    return [
        Row("sea floor", f"{name}, {cells}", work, wrong, unit, _MAX_WRONG)
        for name, work in (("each cell alone", alone), ("with neighbours", with_neighbours))
    ]


def share_wrong(found: NDArray[np.integer], shares: NDArray[np.floating]) -> float:
    """Measure the share of cells taken for another kind than most of them is, the mean over the kinds there are."""
    true = shares.argmax(axis=1)
    return float(np.mean([np.mean(found[true == kind] != kind) for kind in np.unique(true)]))


def _first_tile(seed: int) -> _Judged:
    mission, config = drawn_mission(seed)
    tile, sonar = next(tiles_of(mission, config)), config.sonar
    texture = measure_texture(tile)
    shares = true_shares(tile, texture, mission, sonar)
    cells = np.argwhere(np.isfinite(texture.features).all(axis=-1) & (shares.sum(axis=-1) >= MIN_KNOWN))
    return _Judged(tile, texture, cells, shares[tuple(cells.T)])
