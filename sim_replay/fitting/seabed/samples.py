"""Textures of cells whose windows show one kind of sea floor alone, and which kind that is."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.geometry.georeference import NOMINAL_SOUND_SPEED_MPS, EchoGeometry, locate
from auv_mcm.geometry.navigation import interpolate_track
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import SEABED_TYPES, Tile
from auv_mcm.seabed.texture import CELL_BLOCKS, WINDOW_BLOCKS, measure_texture
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.fitting.seabed.seabed_missions import KIND_OF, mission_scene
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.plan import local_frame

_PER_WINDOW: Final = 7  # places asked for along each side of a window

COVERS: Final = tuple(KIND_OF)
MIXED: Final = 255
"""In place of a cover: the window shows several, or part of it cannot be placed."""


class Samples(NamedTuple):
    """features (n, len(NAMES)) float64, all finite; cot_grazing (n,), of the grazing angle; cover (n,) uint8, index into COVERS."""

    features: NDArray[np.float64]
    cot_grazing: NDArray[np.float64]
    cover: NDArray[np.uint8]


class TrueTile(NamedTuple):
    """A tile and, per cell, (n_along, n_across) uint8, the cover of its whole window, index into COVERS, or MIXED."""

    tile: Tile
    cover: NDArray[np.uint8]


def kind_of_covers() -> NDArray[np.uint8]:
    """(len(COVERS),) index into SEABED_TYPES of what each cover counts as."""
    return np.array([SEABED_TYPES.index(KIND_OF[cover]) for cover in COVERS], dtype=np.uint8)


def true_tiles(seed: int) -> list[TrueTile]:
    """Every tile of the mission of a seed."""
    mission = Mission(mission_scene(seed))
    config = Config(sonar=SonarConfig(transfer="amplitude"))  # as a mission's settings say that knows its recorder
    pipeline = Pipeline(config, detect=_nothing)
    tiles: list[Tile] = []
    for event in mission.events():
        tiles += [told for told in pipeline.feed(event) if isinstance(told, Tile)]
    tiles += [told for told in pipeline.finish() if isinstance(told, Tile)]
    return [TrueTile(tile, true_covers(tile, mission, config.sonar)) for tile in tiles]


def samples_of(seed: int) -> Samples:
    """Pure cells of the mission of a seed."""
    parts = []
    for tile, cover in true_tiles(seed):
        texture = measure_texture(tile)
        pure = (cover != MIXED) & np.isfinite(texture.features).all(axis=-1)
        grazing = np.broadcast_to(texture.cot_grazing, cover.shape)
        parts.append((texture.features[pure], grazing[pure], cover[pure]))
    return Samples(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def pooled(samples: list[Samples]) -> Samples:
    return Samples(*(np.concatenate(part) for part in zip(*samples, strict=True)))


def true_covers(tile: Tile, mission: Mission, sonar: SonarConfig) -> NDArray[np.uint8]:
    """Per cell of a tile the cover of its window, by where the payload believes it to lie, or MIXED."""
    texture = measure_texture(tile)
    n_along, n_across = texture.features.shape[:2]
    cell_rows = texture.cell_m[0] / tile.row_spacing_m
    reach = np.linspace(-0.5, 0.5, _PER_WINDOW) * WINDOW_BLOCKS / CELL_BLOCKS
    row = tile.core_start + ((np.arange(n_along)[:, np.newaxis] + 0.5 + reach) * cell_rows).ravel()
    ground_m = ((np.arange(n_across)[:, np.newaxis] + 0.5 + reach) * texture.cell_m[1]).ravel()
    position, ground = (
        part.ravel() for part in np.meshgrid(np.clip(row, 0.0, len(tile.pose) - 1.0), np.maximum(ground_m, 0.0), indexing="ij")
    )
    first_return_m = np.interp(position, np.arange(len(tile.pose)), tile.first_return_m)
    echoes = EchoGeometry(
        side=tile.side,
        pose=interpolate_track(tile.pose, position),
        slant_range_m=np.hypot(ground, first_return_m),
        first_return_m=first_return_m,
        sound_speed_mps=np.full(position.shape, NOMINAL_SOUND_SPEED_MPS),
    )
    place = local_frame(mission.scene.origin).to_enu(*locate(echoes, sonar))
    known = np.isfinite(place).all(axis=1)
    of_cover = np.array([COVERS.index(cover.type) for cover in mission.sea.world.covers], dtype=np.uint8)
    cover = np.full(position.shape, MIXED, dtype=np.uint8)
    cover[known] = of_cover[mission.sea.world.seabed_at(place[known, 0], place[known, 1])]
    windows = cover.reshape(n_along, _PER_WINDOW, n_across, _PER_WINDOW).swapaxes(1, 2).reshape(n_along, n_across, -1)
    return np.where((windows == windows[..., :1]).all(axis=-1), windows[..., 0], MIXED).astype(np.uint8)


def _nothing(tile: Tile) -> TileDetections:
    return TileDetections((), 0, 0)
