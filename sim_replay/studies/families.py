"""Fly the source paper's examples of classical detection many times, with its feature families one by one and together
(section 4.4.1, figures 9 and 10).

First: 13 objects in an image, 2 of type A, 6 of B, 5 of C, found by a classifier that has seen targets of types B and C
only. Second: an A, three B and an object that is not a target, with a classifier that has seen A, B and C on flat sea
floor only, where there are ripples. Third: the first images, with classifiers that have seen two of the types.

The echo of the sea surface, which gave the paper a false alarm, is in the first images and in nothing that was learned
from. Thresholds that find a share of the types learned are taken from the images that are judged.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from sim_replay.fitting.cascade.classical.classical_model import ClassicalModel, score_contrast
from sim_replay.fitting.cascade.classical.extractors import FAMILIES, Family
from sim_replay.fitting.cascade.classical.train_classical import (
    ChipSamples,
    collect,
    fit_classical_model,
    merged,
    of_kinds,
)
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.cascade.spec import SimulatedLine
from sim_replay.fitting.cascade.training_images import simulated_tiles
from sim_replay.missions import FIRST_SEED
from sim_replay.scoring.intervals import density, poisson_interval, proportion
from sim_replay.simulator.scene import ObjectKind
from sim_replay.studies.paper_candidates import (
    FLOOR,
    NORMALISED,
    SURFACE,
    Array,
    ImageCandidates,
    Sighting,
    TileCandidates,
    fly_image,
    sightings,
)
from sim_replay.studies.paper_scenes import TYPES, add_flight_options, image_line, training_lines
from sim_replay.text_tables import columns, density_cell, markdown, share_cell

FEATURES: Final[Mapping[str, tuple[Family, ...]]] = MappingProxyType(
    {**{family: (family,) for family in FAMILIES}, "all six": FAMILIES}
)
EVEN: Final = 0.0  # log-odds
SHARES: Final = {"half of learned": 0.5, "9 in 10 learned": 0.9, "all learned": 1.0}
_SURFACE_ECHO_DB: Final = -18.0
_COMPARED: Final = 0.9  # share of the types learned that are found where the type left out is judged


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
        "all of A and B, and a false alarm on the object that is not a target",
        "ripple",
        {"truncated_cone": 1, "wedge": 3, "box": 1},
        frozenset({"box"}),
        None,
        ("A", "B", "C"),
        True,
    ),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench families`."""
    add_flight_options(parser, "experiment", 30, 3)


def run(arguments: argparse.Namespace) -> int:
    """Fly, learn, judge and print; return the exit code."""
    farm = Farm(arguments.workers)
    lines = training_lines(arguments.missions)
    parts = list(run_tasks(samples_of, lines, farm))
    laid_out = markdown if arguments.markdown else columns
    flown = []
    for experiment in EXPERIMENTS:
        samples = merged(
            [
                part
                for line, part in zip(lines, parts, strict=True)
                if line.background.startswith("flat/") or not experiment.flat_only
            ]
        )
        images = list(run_tasks(fly_image, image_lines(experiment, arguments.images), farm))
        flown.append((samples, images))
        models = models_of(samples, experiment.learned)
        print(f"\n{experiment.name}; {len(images)} images, {sum(image.area_km2() for image in images):.3f} km² in all")
        print(f"learned from {next(iter(models.values())).trained_on}")
        print(f"source paper, in one image with central filters: {experiment.paper}\n")
        print(laid_out(*table(experiment, images, models)))
    print(f"\nThe first images; a type of target that was not learned, where {_COMPARED:.0%} of the others are found\n")
    print(laid_out(*left_out_types(*flown[0])))
    return 0


def samples_of(line: SimulatedLine) -> ChipSamples:
    """Return the training samples in one mission."""
    return collect(simulated_tiles(line), line.config)


def image_lines(experiment: Experiment, n_images: int) -> tuple[SimulatedLine, ...]:
    """List the images of an experiment."""
    return tuple(
        image_line(experiment.floor, experiment.objects, experiment.not_targets, seed, experiment.surface_echo_db)
        for seed in range(FIRST_SEED, FIRST_SEED + n_images)
    )


def models_of(samples: ChipSamples, learned: Sequence[str]) -> dict[str, ClassicalModel]:
    """Fit a model per feature set to the types of targets that are learned."""
    chosen = of_kinds(samples, [TYPES[name] for name in learned])
    return {name: fit_classical_model(chosen, families) for name, families in FEATURES.items()}


def judge_by(model: ClassicalModel, tile: TileCandidates, cut: str = NORMALISED) -> Array:
    """Return a model's log-odds (n,) of a tile's candidates, -inf where too little of a chip is known.

    cut: of the chips that the model learned from.
    """
    chips = tile.chips[cut]
    return np.where(chips.known, score_contrast(model, chips.contrast.astype(np.float64)), -math.inf)


def table(
    experiment: Experiment, images: Sequence[ImageCandidates], models: Mapping[str, ClassicalModel]
) -> tuple[list[str], list[list[str]]]:
    """Lay out objects found and false alarms of every feature set, as header and rows.

    At even odds, and where given shares of the trained kinds are found.
    """
    learned = [TYPES[name] for name in experiment.learned]
    kinds = (*TYPES.values(), *sorted(experiment.not_targets))
    there = {kind: sum(image.count(kind) for image in images) for kind in kinds}
    rows = []
    for features, model in models.items():
        seen = [one for image in images for one in sightings(image.tiles, partial(judge_by, model))]
        for words, threshold in thresholds(seen, learned, sum(there[kind] for kind in learned)).items():
            if not math.isfinite(threshold):
                rows.append([features, words, "not found at any", *[""] * (len(kinds) + 3)])
                continue
            called = Counter(one.what for one in seen if one.log_odds >= threshold)
            rows.append(
                [
                    features,
                    words,
                    *(share_cell(proportion(called[kind], there[kind])) for kind in kinds),
                    str(called[SURFACE]),
                    str(called[FLOOR]),
                    *_false_alarm_cells(called, images),
                ]
            )
    header = ["features", "called from", *TYPES, *sorted(experiment.not_targets)]
    return [*header, "surface", "floor", "FA per image", "FA/km²"], rows


def left_out_types(samples: ChipSamples, images: Sequence[ImageCandidates]) -> tuple[list[str], list[list[str]]]:
    """Lay out what is found of each type by models that learned the other two, as header and rows."""
    cells: dict[str, list[str]] = {name: [name] for name in FEATURES}
    for name, kind in TYPES.items():
        others = [other for other in TYPES if other != name]
        learned = [TYPES[other] for other in others]
        n_learned, n_left_out = (
            sum(image.count(one) for image in images for one in some) for some in (learned, [kind])
        )
        for features, model in models_of(samples, others).items():
            seen = [one for image in images for one in sightings(image.tiles, partial(judge_by, model))]
            threshold = odds_of_share(_falling(seen, learned), n_learned, _COMPARED)
            called = Counter(one.what for one in seen if one.log_odds >= threshold)
            cells[features] += [share_cell(proportion(called[kind], n_left_out)), _false_alarm_cells(called, images)[1]]
    header = [words for name in TYPES for words in (f"{name} found, not learned", "FA/km²")]
    return ["features", *header], list(cells.values())


def thresholds(seen: Sequence[Sighting], learned: Sequence[str], n_learned: int) -> dict[str, float]:
    """Return the thresholds on the odds that are compared, by name: even odds, and those that find SHARES."""
    falling = _falling(seen, learned)
    return {"even odds": EVEN} | {words: odds_of_share(falling, n_learned, share) for words, share in SHARES.items()}


def odds_of_share(falling: Sequence[float], n_objects: int, share: float) -> float:
    """Return the threshold on the odds that calls that share of n_objects; -inf if fewer were seen at all."""
    needed = math.ceil(share * n_objects - 1e-9)
    return falling[needed - 1] if 0 < needed <= len(falling) else -math.inf


def _falling(seen: Sequence[Sighting], kinds: Sequence[str]) -> list[float]:
    return sorted((one.log_odds for one in seen if one.what in kinds), reverse=True)


def _false_alarm_cells(called: Counter[str], images: Sequence[ImageCandidates]) -> tuple[str, str]:
    """Write false alarms per image and per km²; targets of a type that was not learned count as none."""
    n_false = sum(called.values()) - sum(called[kind] for kind in TYPES.values())
    low, high = poisson_interval(n_false)
    per_image = [float(number) / len(images) for number in (n_false, low, high)]
    return (
        f"{per_image[0]:.1f} ({per_image[1]:.1f}-{per_image[2]:.1f})",
        density_cell(density(n_false, sum(image.area_km2() for image in images))),
    )
