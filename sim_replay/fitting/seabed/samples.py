"""Collect textures of cells of simulated missions, and the true kinds of sea floor in each."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.geometry.georeference import locate, tile_echoes
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import SEABED_TYPES, SeabedType, Tile
from auv_mcm.seabed.texture import Texture, measure_texture
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.fitting.seabed.seabed_missions import KIND_OF, mission_scene, sonar_config
from sim_replay.fitting.theatre import USUAL, Theatre
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.plan import local_frame

KINDS: Final[tuple[SeabedType, ...]] = tuple(kind for kind in SEABED_TYPES if kind != "unknown")
_PER_CELL: Final = 4  # places asked for along each side of a cell
_EVERY: Final = 3  # cells of a mission that are kept: neighbours carry nearly the same information
_MIN_KNOWN: Final = 0.5  # of a cell's places that can be placed


class SeabedSamples(NamedTuple):
    """Hold samples: features (n, len(NAMES)) float32, all finite.

    cot_grazing (n,) float32, of the grazing angle; shares (n, len(KINDS)) float32, of each kind in the cell, 1 in all.
    """

    features: NDArray[np.float32]
    cot_grazing: NDArray[np.float32]
    shares: NDArray[np.float32]


def samples_of(seed: int, theatre: Theatre = USUAL) -> SeabedSamples:
    """Fly the mission of a seed and take every third of its cells, those at borders between kinds as well."""
    mission, config = drawn_mission(seed, theatre)
    return pooled([tile_samples(tile, mission, config.sonar) for tile in tiles_of(mission, config)])


def drawn_mission(seed: int, theatre: Theatre = USUAL) -> tuple[Mission, Config]:
    """Prepare the mission of a seed, with the picture of a theatre, and its sonar as somebody knows it."""
    scene, config = theatre.carried(mission_scene(seed), seed)
    return Mission(scene), Config(sonar=sonar_config(scene), waterfall=config.waterfall)


def tiles_of(mission: Mission, config: Config) -> Iterator[Tile]:
    """Fly a mission and give its tiles one after another; nothing is detected in them."""
    pipeline = Pipeline(config, detect=_nothing, seabed=lambda tile: None)
    for event in mission.events():
        yield from (result for result in pipeline.feed(event) if isinstance(result, Tile))
    yield from (result for result in pipeline.finish() if isinstance(result, Tile))


def tile_samples(tile: Tile, mission: Mission, sonar: SonarConfig) -> SeabedSamples:
    """Measure the cells of a tile and look up their kinds."""
    texture = measure_texture(tile)
    shares = true_shares(tile, texture, mission, sonar)
    total = shares.sum(axis=-1)
    kept = np.flatnonzero((np.isfinite(texture.features).all(axis=-1) & (total >= _MIN_KNOWN)).ravel())[::_EVERY]
    cot_grazing = np.broadcast_to(texture.cot_grazing, total.shape).ravel()[kept]
    features = texture.features.reshape(-1, texture.features.shape[-1])[kept]
    share = (shares / np.maximum(total, _MIN_KNOWN)[..., np.newaxis]).reshape(-1, len(KINDS))[kept]
    return SeabedSamples(features.astype(np.float32), cot_grazing.astype(np.float32), share.astype(np.float32))


def pooled(samples: list[SeabedSamples]) -> SeabedSamples:
    """Put samples together."""
    return SeabedSamples(*(np.concatenate(part) for part in zip(*samples, strict=True)))


def true_shares(tile: Tile, texture: Texture, mission: Mission, sonar: SonarConfig) -> NDArray[np.float64]:
    """Look up the share of each kind in cells, (n_along, n_across, len(KINDS)).

    Cells are where the payload believes them to lie.

    Shares of a cell of which part cannot be placed add up to less than 1.
    """
    n_along, n_across = texture.features.shape[:2]
    inside = (np.arange(_PER_CELL) + 0.5) / _PER_CELL
    row = (
        tile.core_start
        + ((np.arange(n_along)[:, np.newaxis] + inside) * texture.cell_m[0] / tile.row_spacing_m).ravel()
    )
    ground_m = ((np.arange(n_across)[:, np.newaxis] + inside) * texture.cell_m[1]).ravel()
    position, ground = (
        part.ravel() for part in np.meshgrid(np.clip(row, 0.0, len(tile.pose) - 1.0), ground_m, indexing="ij")
    )
    place = local_frame(mission.scene.origin).to_enu(*locate(tile_echoes(tile, position, ground), sonar))
    known = np.isfinite(place).all(axis=1)
    kind_of_cover = np.array([KINDS.index(KIND_OF[cover.type]) for cover in mission.sea.world.covers], dtype=np.int64)
    kind = np.full(position.shape, len(KINDS), dtype=np.int64)
    kind[known] = kind_of_cover[mission.sea.world.seabed_at(place[known, 0], place[known, 1])]
    by_cell = kind.reshape(n_along, _PER_CELL, n_across, _PER_CELL)
    return np.stack([(by_cell == index).mean(axis=(1, 3)) for index in range(len(KINDS))], axis=-1)


def _nothing(tile: Tile) -> TileDetections:
    return TileDetections((), 0, 0)
