"""Fly the source paper's two examples of classical detection many times over (section 4.4.1, figures 9 and 10).

First: 13 objects in an image, 2 of type A, 6 of B, 5 of C, found by a classifier that has seen targets of types B and C
only. Second: an A, three B and an object that is not a target, with a classifier that has seen A, B and C on flat sea
floor only, where there are ripples.

The paper does not state which shapes its types are: here A is a truncated cone, B a wedge, C a cylinder. The echo of
the sea surface, which gave the paper a false alarm, is in the first image and in nothing that was learned from.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm.settings.config import Config
from sim_replay.arguments import count
from sim_replay.fitting.cascade.classical.chips import reference_shadow_m
from sim_replay.fitting.cascade.classical.classical_candidates import find_candidates
from sim_replay.fitting.cascade.classical.classical_model import ClassicalModel, score_windows
from sim_replay.fitting.cascade.classical.extractors import FAMILIES, Family
from sim_replay.fitting.cascade.classical.train_classical import (
    ChipSamples,
    collect,
    fit_classical_model,
    merged,
    of_kinds,
)
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.cascade.spec import Kind, SeedRange, Seeds, SimulatedLine, Spec, Targets, lines_of
from sim_replay.fitting.cascade.tiles import LabelledTile
from sim_replay.fitting.cascade.training_images import simulated_tiles
from sim_replay.missions import FIRST_SEED, config_for
from sim_replay.simulator.scene import EXACT, Lawnmower, ObjectKind, Scatter, Scene, TargetKind
from sim_replay.simulator.scene_file import read_scene
from sim_replay.text_tables import columns

TYPES: Final[Mapping[str, TargetKind]] = MappingProxyType({"A": "truncated_cone", "B": "wedge", "C": "cylinder"})
FEATURES: Final[Mapping[str, tuple[Family, ...]]] = MappingProxyType(
    {"central filters": ("central",), "all features": FAMILIES}
)

_FIRST_TRAINING_SEED: Final = 600
_LEG_M: Final = 120.0
_TILE_ROWS: Final = 2048  # an image is one tile on each side
_SURFACE_ECHO_DB: Final = -18.0
_SURFACE_M: Final = 1.5  # of slant range about the surface's first echo
_ON_OBJECT_M: Final = 1.5
_SAME_M: Final = 1.0
_EVEN: Final = 0.0  # log-odds
_SHARES: Final = {"half of learned": 0.5, "9 in 10 learned": 0.9, "all learned": 1.0}


class Experiment(NamedTuple):
    """paper: what the source paper found. floor: scene whose sea floor, sonar and strengths of echoes the images have.
    objects: in each image, by kind; not_targets: kinds that are none there. surface_echo_db: as in Sonar. learned:
    types of targets. flat_only: whether all that was learned from is flat.
    """

    name: str
    paper: str
    floor: str
    objects: dict[ObjectKind, int]
    not_targets: frozenset[str]
    surface_echo_db: float | None
    learned: tuple[str, ...]
    flat_only: bool


EXPERIMENTS: Final = (
    Experiment(
        "13 objects on flat sea floor, learned from B and C on flat, rippled and mixed sea floor",
        "all of B and C, and 3 false alarms: an A, a rock, and one on the surface return",
        "flat",
        {"truncated_cone": 2, "wedge": 6, "cylinder": 5, "rock": 4},
        frozenset({"rock"}),
        _SURFACE_ECHO_DB,
        ("B", "C"),
        False,
    ),
    Experiment(
        "5 objects on rippled sea floor, learned from A, B and C on flat sea floor",
        "all of A and B, and a false alarm on the object that is no target",
        "ripple",
        {"truncated_cone": 1, "wedge": 3, "box": 1},
        frozenset({"box"}),
        None,
        ("A", "B", "C"),
        True,
    ),
)


class Sighting(NamedTuple):
    """Hold the best odds in an image of one object, or of one place without any. what: its kind, "surface" or
    "floor"."""

    what: str
    log_odds: float


class Image(NamedTuple):
    """Hold the results of one image, by feature set. n_objects: by kind."""

    sightings: dict[str, tuple[Sighting, ...]]
    n_objects: dict[str, int]
    area_km2: float


class _Task(NamedTuple):
    line: SimulatedLine
    surface_m: float
    models: dict[str, ClassicalModel]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add options of `auv-mcm bench figure9`."""
    parser.add_argument(
        "--images", type=count, default=10, help=f"images per experiment, seeds {FIRST_SEED} on (default 10)"
    )
    parser.add_argument("--missions", type=count, default=2, help="missions per sea floor to learn from (default 2)")
    parser.add_argument("--workers", type=count, default=2, help="missions flown at once (default 2)")


def run(arguments: argparse.Namespace) -> int:
    """Fly, learn, judge and print; return the exit code."""
    farm = Farm(arguments.workers)
    lines = training_lines(arguments.missions)
    parts = list(run_tasks(samples_of, lines, farm, _progress("training missions", len(lines))))
    for experiment in EXPERIMENTS:
        chosen = [
            part
            for line, part in zip(lines, parts, strict=True)
            if line.background.startswith("flat/") or not experiment.flat_only
        ]
        samples = of_kinds(merged(chosen), [TYPES[name] for name in experiment.learned])
        models = {name: fit_classical_model(samples, families) for name, families in FEATURES.items()}
        images = list(
            run_tasks(
                judge_figure,
                image_tasks(experiment, models, arguments.images),
                farm,
                _progress("images", arguments.images),
            )
        )
        print(f"\n{experiment.name}; {len(images)} images, {sum(image.area_km2 for image in images):.3f} km² in all")
        print(f"learned from {next(iter(models.values())).trained_on}")
        print(f"source paper, in one image with central filters: {experiment.paper}\n")
        print(table(experiment, images))
    return 0


def training_lines(n_missions: int) -> tuple[SimulatedLine, ...]:
    """List missions with many targets of all three types over flat, rippled and mixed sea floor."""
    spec = Spec(
        scenes=("flat", "ripple", "mixed"),
        seeds=Seeds(train=SeedRange(first=_FIRST_TRAINING_SEED, count=n_missions)),
        targets=Targets(kinds={kind: Kind() for kind in TYPES.values()}),
    )
    return tuple(line for line in lines_of(spec, Path()) if isinstance(line, SimulatedLine))


def samples_of(line: SimulatedLine) -> ChipSamples:
    """Return the training samples in one mission."""
    return collect(simulated_tiles(line), line.config)


def image_scene(experiment: Experiment, seed: int) -> Scene:
    """Build one short leg with the experiment's objects, strong and weak as in the source scene."""
    scene = read_scene(experiment.floor)
    like = next(group for group in scene.scatter if group.kind == "wedge")
    scatter = tuple(
        Scatter(
            kind=kind,
            count=n,
            ground_range_m=like.ground_range_m,
            strength_db=like.strength_db,
            is_target=kind not in experiment.not_targets,
        )
        for kind, n in experiment.objects.items()
    )
    return msgspec.structs.replace(
        scene,
        name="figure",
        seed=seed,
        scatter=scatter,
        sonar=msgspec.structs.replace(scene.sonar, surface_echo_db=experiment.surface_echo_db),
        track=msgspec.structs.replace(scene.track, plan=Lawnmower(n_legs=1, leg_m=_LEG_M), pings_in_turns=False),
        navigation_error=EXACT,
    )


def image_tasks(experiment: Experiment, models: dict[str, ClassicalModel], n_images: int) -> tuple[_Task, ...]:
    """List images to fly over, with their judges."""
    tasks = []
    for seed in range(FIRST_SEED, FIRST_SEED + n_images):
        scene = image_scene(experiment, seed)
        config = _whole(config_for(scene))
        surface_m = math.nan if experiment.surface_echo_db is None else scene.world.depth_m - scene.track.altitude_m
        tasks.append(_Task(SimulatedLine(scene, config, "test", f"figure/{seed}"), surface_m, models))
    return tuple(tasks)


def judge_figure(task: _Task) -> Image:
    """Fly over an image and judge every candidate in it with every model."""
    sightings: dict[str, list[Sighting]] = {name: [] for name in task.models}
    n_objects: dict[str, int] = {}
    usable_m2 = 0.0
    for tile in simulated_tiles(task.line):
        usable_m2 += int(np.count_nonzero(tile.usable)) * tile.row_spacing_m * tile.column_spacing_m
        for scene_object in tile.objects:
            if tile.core_start <= scene_object.row < tile.core_stop:
                n_objects[scene_object.kind] = n_objects.get(scene_object.kind, 0) + 1
        found = find_candidates(tile, task.line.config)
        for name, model in task.models.items():
            odds = score_windows(model, tile, found.rows, found.columns)
            places = [
                Place(float(r), float(c), float(o)) for r, c, o in zip(found.rows, found.columns, odds, strict=True)
            ]
            sightings[name] += sighted(tile, places, task.surface_m)
    return Image({name: tuple(found) for name, found in sightings.items()}, n_objects, usable_m2 / 1e6)


class Place(NamedTuple):
    """Hold a pixel and its log-odds."""

    row: float
    column: float
    log_odds: float


def sighted(tile: LabelledTile, places: Iterable[Place], surface_m: float) -> list[Sighting]:
    """Yield each object at the best odds among places on it or in its shadow, then the remaining places, best first.

    surface_m: slant range of the surface's first echo, NaN if there is none.
    """
    taken: dict[int, Place] = {}
    kept: list[Place] = []
    for place in sorted(places, key=lambda p: (-p.log_odds, p.row, p.column)):
        on = next(
            (
                index
                for index, scene_object in enumerate(tile.objects)
                if _covers(tile, scene_object.row, scene_object.column, place, _ON_OBJECT_M)
            ),
            None,
        )
        if on is not None:
            taken.setdefault(on, place)
        elif not any(_covers(tile, other.row + 0.5, other.column + 0.5, place, _SAME_M) for other in kept):
            kept.append(place)
    objects = [Sighting(tile.objects[index].kind, place.log_odds) for index, place in sorted(taken.items())]
    return objects + [
        Sighting("surface" if _on_surface(tile, place, surface_m) else "floor", place.log_odds) for place in kept
    ]


def table(experiment: Experiment, images: Sequence[Image]) -> str:
    """Lay out objects found and false alarms of every feature set.

    At even odds, and where given shares of the trained kinds are found.
    """
    learned = [TYPES[name] for name in experiment.learned]
    kinds = (*TYPES.values(), *sorted(experiment.not_targets))
    there = {kind: sum(image.n_objects.get(kind, 0) for image in images) for kind in kinds}
    area_km2 = sum(image.area_km2 for image in images)
    rows: list[tuple[str, ...]] = []
    for features in FEATURES:
        seen = [sighting for image in images for sighting in image.sightings[features]]
        wanted = sum(there[kind] for kind in learned)
        odds = sorted((s.log_odds for s in seen if s.what in learned), reverse=True)
        for words, threshold in (
            ("even odds", _EVEN),
            *((words, odds_of_share(odds, wanted, share)) for words, share in _SHARES.items()),
        ):
            called = Counter(sighting.what for sighting in seen if sighting.log_odds >= threshold)
            n_false = sum(called.values()) - sum(called[kind] for kind in TYPES.values())
            found = (f"{called[kind]} of {there[kind]}" for kind in kinds)
            others = (
                str(called["surface"]),
                str(called["floor"]),
                f"{n_false / len(images):.1f}",
                f"{n_false / area_km2:.0f}",
            )
            rows.append(
                (features, words, *found, *others)
                if math.isfinite(threshold)
                else (features, words, "not found at any")
            )
    header = (
        "features",
        "called from",
        *TYPES,
        *sorted(experiment.not_targets),
        "surface",
        "floor",
        "FA per image",
        "FA/km²",
    )
    return columns(header, [(*row, *[""] * (len(header) - len(row))) for row in rows])


def odds_of_share(falling: Sequence[float], n_objects: int, share: float) -> float:
    """Return the threshold on the odds that calls that share of n_objects; -inf if fewer were seen at all."""
    needed = math.ceil(share * n_objects - 1e-9)
    return falling[needed - 1] if 0 < needed <= len(falling) else -math.inf


def _covers(tile: LabelledTile, row: float, column: float, place: Place, reach_m: float) -> bool:
    """Report whether a place, by its pixel, is within reach of an object's highlight at (row, column) or in the shadow
    behind it.
    """
    along_m = abs(place.row + 0.5 - row) * tile.row_spacing_m
    across_m = (place.column + 0.5 - column) * tile.column_spacing_m
    altitude_m = tile.first_return_m[min(max(math.floor(row), 0), len(tile.first_return_m) - 1)]
    shadow_m = float(reference_shadow_m(np.array(column * tile.column_spacing_m), np.array(altitude_m)))
    return along_m < reach_m and -reach_m < across_m < reach_m + shadow_m


def _on_surface(tile: LabelledTile, place: Place, surface_m: float) -> bool:
    altitude_m = float(tile.first_return_m[math.floor(place.row)])
    return abs(math.hypot((place.column + 0.5) * tile.column_spacing_m, altitude_m) - surface_m) < _SURFACE_M


def _whole(config: Config) -> Config:
    """Return the configuration with tiles as long as an image, and with candidates for all the tiles it replaces."""
    n_tiles = -(-_TILE_ROWS // config.waterfall.tile_rows)
    return msgspec.structs.replace(
        config,
        waterfall=msgspec.structs.replace(config.waterfall, tile_rows=_TILE_ROWS),
        detect=msgspec.structs.replace(
            config.detect, max_candidates_per_tile=n_tiles * config.detect.max_candidates_per_tile
        ),
    )


def _progress(what: str, total: int) -> Callable[[int], None]:
    def show_progress(done: int) -> None:
        print(f"\r{done} of {total} {what}", end="\n" if done == total else "", file=sys.stderr, flush=True)

    return show_progress
