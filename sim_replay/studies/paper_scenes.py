"""Name the missions that the source paper's classical detection is flown again on: to learn from, and to judge by.

The paper does not state which shapes its types A, B and C are: here A is a truncated cone, B a wedge, C a cylinder.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

import msgspec

from auv_mcm.settings.config import Config
from sim_replay.arguments import count
from sim_replay.fitting.cascade.spec import Kind, SeedRange, Seeds, SimulatedLine, Spec, Targets, lines_of
from sim_replay.missions import FIRST_SEED, config_for
from sim_replay.simulator.scene import EXACT, Lawnmower, ObjectKind, Scatter, Scene, TargetKind
from sim_replay.simulator.scene_file import read_scene

TYPES: Final[Mapping[str, TargetKind]] = MappingProxyType({"A": "truncated_cone", "B": "wedge", "C": "cylinder"})
LEARNED_FLOORS: Final = ("flat", "ripple", "mixed")
"""Named scenes whose sea floor is learned from."""
FLOORS_LEFT_OUT: Final = ("boulders", "rough", "seagrass")

_FIRST_TRAINING_SEED: Final = 600
_LEG_M: Final = 120.0
_TARGETS_PER_TYPE, _ROCKS = 5, 10  # of an image
_IMAGE_ROWS: Final = 2048  # an image is one tile on each side


def add_flight_options(parser: argparse.ArgumentParser, images_of: str, n_images: int, n_missions: int) -> None:
    """Add how much is flown.

    Parameters
    ----------
    images_of
        What so many images are for each of, in the help.
    n_images, n_missions
        Defaults: images to judge, and missions per sea floor to learn from.
    """
    images = f"images per {images_of}, seeds {FIRST_SEED} on (default {n_images})"
    missions = f"missions per sea floor to learn from (default {n_missions})"
    parser.add_argument("--images", type=count, default=n_images, help=images)
    parser.add_argument("--missions", type=count, default=n_missions, help=missions)
    parser.add_argument("--workers", type=count, default=2, help="missions flown at once (default 2)")
    parser.add_argument("--markdown", action="store_true", help="print the tables in Markdown")


def training_lines(n_missions: int, floors: tuple[str, ...] = LEARNED_FLOORS) -> tuple[SimulatedLine, ...]:
    """List missions with many targets of all three types, so many per sea floor."""
    spec = Spec(
        scenes=floors,
        seeds=Seeds(train=SeedRange(first=_FIRST_TRAINING_SEED, count=n_missions)),
        targets=Targets(kinds={kind: Kind() for kind in TYPES.values()}),
    )
    return tuple(line for line in lines_of(spec, Path()) if isinstance(line, SimulatedLine))


def image_line(
    floor: str,
    objects: Mapping[ObjectKind, int],
    not_targets: Collection[str],
    seed: int,
    surface_echo_db: float | None = None,
) -> SimulatedLine:
    """Describe an image: one short leg over the sea floor of a named scene, each side of it one tile.

    Parameters
    ----------
    floor
        The scene, which gives the sonar, and the strengths and ranges of all objects too.
    objects
        How many of each kind lie in the image; nothing else does but the floor's own stones.
    surface_echo_db
        As in Sonar.
    """
    scene = read_scene(floor)
    like = next(group for group in scene.scatter if group.kind == "wedge")
    flown = msgspec.structs.replace(
        scene,
        name="figure",
        seed=seed,
        scatter=tuple(
            Scatter(
                kind=kind,
                count=n,
                ground_range_m=like.ground_range_m,
                strength_db=like.strength_db,
                is_target=kind not in not_targets,
            )
            for kind, n in objects.items()
        ),
        sonar=msgspec.structs.replace(scene.sonar, surface_echo_db=surface_echo_db),
        track=msgspec.structs.replace(scene.track, plan=Lawnmower(n_legs=1, leg_m=_LEG_M), pings_in_turns=False),
        navigation_error=EXACT,
    )
    return SimulatedLine(flown, in_one_tile(config_for(flown)), "test", f"{floor}/{seed}")


def judged_lines(n_images: int) -> tuple[SimulatedLine, ...]:
    """List images with as many targets of each type and as many rocks, so many over every sea floor, learned or not."""
    objects: dict[ObjectKind, int] = dict.fromkeys(TYPES.values(), _TARGETS_PER_TYPE)
    objects["rock"] = _ROCKS
    return tuple(
        image_line(floor, objects, {"rock"}, seed)
        for floor in (*LEARNED_FLOORS, *FLOORS_LEFT_OUT)
        for seed in range(FIRST_SEED, FIRST_SEED + n_images)
    )


def surface_range_m(scene: Scene) -> float:
    """Return the slant range of the sea surface's first echo."""
    return scene.world.depth_m - scene.track.altitude_m


def in_one_tile(config: Config) -> Config:
    """Return the configuration with tiles as long as an image, and with candidates for all the tiles it replaces."""
    n_tiles = -(-_IMAGE_ROWS // config.waterfall.tile_rows)
    return msgspec.structs.replace(
        config,
        waterfall=msgspec.structs.replace(config.waterfall, tile_rows=_IMAGE_ROWS),
        detect=msgspec.structs.replace(
            config.detect, max_candidates_per_tile=n_tiles * config.detect.max_candidates_per_tile
        ),
    )
