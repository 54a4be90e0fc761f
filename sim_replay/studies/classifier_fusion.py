"""Fuse classifiers of different features and techniques, and compare with each of them and with one of all features.

The source paper (section 4.4.1): "Fusing the results from multiple classifiers using different feature sets and
classification techniques can improve performance". Here a linear discriminant per family of features, boosted trees on
all features, and the odds of the detector that nothing was trained for, are judged and fused out of sample: other
seeds, and three sea floors that were not learned from.

Every member's odds are calibrated, and the stacker fitted, on missions that the member did not learn from. The best
single member is chosen by its log-loss there too.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from auv_mcm.classify.beliefs import EVERYTHING, MAX_RELIABILITY, MINES, N_SUBSETS, dempster
from sim_replay.fitting.cascade.classical.classical_model import ClassicalModel
from sim_replay.fitting.cascade.classical.discriminant import Discriminant, fit_discriminant
from sim_replay.fitting.cascade.classical.extractors import FAMILIES, extract
from sim_replay.fitting.cascade.classical.train_classical import (
    ChipSamples,
    fit_classical_model,
    merged,
    samples_at,
)
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.cascade.spec import SimulatedLine
from sim_replay.fitting.cascade.training_images import simulated_tiles
from sim_replay.fitting.cascade.trees import boost, leaves
from sim_replay.fitting.left_out import Scored
from sim_replay.studies.families import judge_by
from sim_replay.studies.paper_candidates import (
    NORMALISED,
    Array,
    Bools,
    ImageCandidates,
    Judge,
    TileCandidates,
    detected,
    fly_image,
    remembered,
    scored_image,
    tile_candidates,
)
from sim_replay.studies.paper_scenes import (
    FLOORS_LEFT_OUT,
    LEARNED_FLOORS,
    add_flight_options,
    judged_lines,
    training_lines,
)
from sim_replay.studies.shadow_normalisation import difference_cell, pd_cell, pd_words
from sim_replay.text_tables import columns, markdown

TREES: Final = "boosted trees, all six"
DETECTOR: Final = "detector, nothing trained"
TOGETHER: Final = "all six in one discriminant"
POOLS: Final = {"six families": FAMILIES, "six families, trees, detector": (*FAMILIES, TREES, DETECTOR)}
"""Members that are fused, by name."""
LIMIT_PER_KM2: Final = 1000.0  # false alarms per km² at which differences are given
_LIMITS_PER_KM2: Final = (300.0, LIMIT_PER_KM2)
_N_TREES: Final = 120  # chosen for the run time
_N_FOLDS: Final = 3  # of the missions
_RIDGE: Final = 1.0  # of calibration and stacker: small against hundreds of targets
_CALIBRATION_RIDGE: Final = 1e-3
_LEAST_STRETCH: Final = 1e-3  # odds without evidence, or with the opposite sign, must not reverse the order

Rule: TypeAlias = Callable[[Array, float], Array]
"""Takes calibrated log-odds (n, k) and the prior's log-odds; returns fused log-odds (n,)."""


class Mission(NamedTuple):
    """Hold one mission to learn from: samples for the members, and candidates for what is fitted on top of them."""

    samples: ChipSamples
    candidates: ImageCandidates


class Judged(NamedTuple):
    """Hold members' log-odds (n, k) of candidates that they did not learn from; is_target: (n,)."""

    log_odds: Array
    is_target: Bools


class Calibration(NamedTuple):
    """Hold a line per member for its log-odds, by name, and the log-odds of the prior."""

    lines: dict[str, Discriminant]
    prior: float

    def odds(self, member: str, log_odds: Array) -> Array:
        """Return calibrated log-odds (n,)."""
        line = self.lines[member]
        return line.offset + max(float(line.slopes[0]), _LEAST_STRETCH) * log_odds


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench fusion`."""
    add_flight_options(parser, "sea floor", 6, 2)


def run(arguments: argparse.Namespace) -> int:
    """Fly, learn, judge and print; return the exit code."""
    farm = Farm(arguments.workers)
    missions = list(run_tasks(fly_mission, training_lines(arguments.missions), farm))
    images = list(run_tasks(fly_image, judged_lines(arguments.images), farm))
    judges, best = judges_of(missions)
    print(f"{len(images)} images, {sum(image.area_km2() for image in images):.3f} km² in all; best single: {best}\n")
    print((markdown if arguments.markdown else columns)(*table(judges, best, images)))
    return 0


def fly_mission(line: SimulatedLine) -> Mission:
    """Fly a mission and take its samples and its candidates."""
    samples, tiles = [], []
    for tile in simulated_tiles(line):
        samples.append(samples_at(tile, detected(tile, line.config)[0]))
        tiles.append(tile_candidates(tile, line.config))
    return Mission(merged(samples), ImageCandidates(line.background, tuple(tiles)))


def members_of(samples: ChipSamples) -> dict[str, Judge]:
    """Fit every member, and the discriminant of all features."""
    models = {family: fit_classical_model(samples, (family,)) for family in FAMILIES}
    together = fit_classical_model(samples, FAMILIES)
    members: dict[str, Judge] = {family: partial(judge_by, model) for family, model in models.items()}
    return members | {TREES: boosted(samples, together), DETECTOR: _detector, TOGETHER: partial(judge_by, together)}


def boosted(samples: ChipSamples, model: ClassicalModel) -> Judge:
    """Grow trees on all features. model: whose templates are used."""
    templates = {name: np.array(rows) for name, rows in model.templates.items()}
    is_target = np.array([kind != "" for kind in samples.kind], dtype=np.bool_)
    prior = math.log(samples.weight[is_target].sum() / samples.weight[~is_target].sum())
    values = extract(samples.contrast.astype(np.float64), FAMILIES, templates)
    trees = boost(values, is_target, samples.weight, np.full(len(values), prior), _N_TREES)

    def judge(tile: TileCandidates) -> Array:
        chips = tile.chips[NORMALISED]
        features = extract(chips.contrast.astype(np.float64), FAMILIES, templates)
        odds = prior + np.sum([tree.nats[leaves(tree, features)] for tree in trees], axis=0)
        return np.where(chips.known, odds, -math.inf)

    return judge


def judges_of(missions: Sequence[Mission]) -> tuple[dict[str, Judge], str]:
    """Fit all members and all fusions of them; return them by name, and the name of the best single family."""
    names = (*FAMILIES, TREES, DETECTOR, TOGETHER)
    judged = judged_across(missions, names)
    column = {name: judged.log_odds[:, [index]] for index, name in enumerate(names)}
    ones = np.ones(len(judged.is_target))
    calibration = Calibration(
        {name: fit_discriminant(odds, judged.is_target, ones, _CALIBRATION_RIDGE) for name, odds in column.items()},
        math.log(judged.is_target.sum() / (~judged.is_target).sum()),
    )
    sign = np.where(judged.is_target, 1.0, -1.0)
    loss = {
        name: float(np.logaddexp(0.0, -sign * calibration.odds(name, odds[:, 0])).mean())
        for name, odds in column.items()
    }
    fitted = members_of(merged([mission.samples for mission in missions]))
    members = {name: remembered(judge) for name, judge in fitted.items()}
    judges = dict(members)
    for pool, of in POOLS.items():
        for words, rule in RULES.items():
            judges[f"{words} of {pool}"] = partial(_fused, [members[one] for one in of], of, calibration, rule)
        stacked = np.column_stack([column[one] for one in of])
        stacker = fit_discriminant(stacked, judged.is_target, ones, _RIDGE)
        judges[f"stacker on {pool}"] = partial(_stacked, [members[one] for one in of], stacker)
    return judges, min(FAMILIES, key=lambda name: loss[name])


def judged_across(missions: Sequence[Mission], names: Sequence[str]) -> Judged:
    """Judge each fold of missions by members that learned from the others.

    A row per target, the candidate on it that members find best on average, and per candidate on anything else.
    """
    rows, targets = [], []
    folds = [index * _N_FOLDS // len(missions) for index in range(len(missions))]
    for fold in range(_N_FOLDS):
        members = members_of(merged([one.samples for one, its in zip(missions, folds, strict=True) if its != fold]))
        for mission in (one for one, its in zip(missions, folds, strict=True) if its == fold):
            for tile in mission.candidates.tiles:
                odds = np.column_stack([members[name](tile) for name in names])
                best = _rows_judged(tile, odds)
                rows.append(odds[best])
                targets.append(_on_target(tile)[best])
    return Judged(np.concatenate(rows), np.concatenate(targets))


def _on_target(tile: TileCandidates) -> Bools:
    is_target = np.array([*tile.is_target, False, False], dtype=np.bool_)  # -1 and -2 stand for none
    return np.asarray(is_target[tile.object_index])


def _rows_judged(tile: TileCandidates, odds: Array) -> list[int]:
    known = np.isfinite(odds).all(axis=1)
    mean = np.where(known, odds.mean(axis=1), -math.inf)
    on_target = _on_target(tile)
    rows = np.flatnonzero(known & ~on_target & (tile.object_index != -2)).tolist()
    for index in np.flatnonzero(tile.is_target):
        own = np.flatnonzero(known & (tile.object_index == index))
        rows += [int(own[mean[own].argmax()])] if own.size else []
    return rows


def mean_odds(log_odds: Array, prior: float) -> Array:
    """Average the log-odds, which orders candidates as the product of the odds does."""
    return np.asarray(log_odds.mean(axis=1))


def product_of_probabilities(log_odds: Array, prior: float) -> Array:
    """Multiply the probabilities of a target."""
    return np.asarray(-np.logaddexp(0.0, -log_odds).sum(axis=1))


def maximum(log_odds: Array, prior: float) -> Array:
    """Take the highest of the log-odds."""
    return np.asarray(log_odds.max(axis=1))


def majority(log_odds: Array, prior: float) -> Array:
    """Take the log-odds that more than half of the members reach: the threshold up to which they outvote the others."""
    return np.asarray(np.sort(log_odds, axis=1)[:, (log_odds.shape[1] - 1) // 2])


def dempster_shafer(log_odds: Array, prior: float) -> Array:
    """Combine the members' evidence beyond the prior by Dempster's rule, each discounted to the usual reliability.

    Returns ln of the plausibility of a mine over that of clutter.
    """
    share = MAX_RELIABILITY / (1.0 + np.exp(-np.clip(log_odds - prior, -500.0, 500.0)))
    masses = np.zeros((log_odds.shape[1], len(log_odds), N_SUBSETS))
    masses[..., MINES] = share.T
    masses[..., EVERYTHING & ~MINES] = MAX_RELIABILITY - share.T
    masses[..., EVERYTHING] = 1.0 - MAX_RELIABILITY
    mass = dempster(masses).mass
    unknown = mass[:, EVERYTHING]
    return np.asarray(np.log((mass[:, MINES] + unknown) / (mass[:, EVERYTHING & ~MINES] + unknown)))


RULES: Final[Mapping[str, Rule]] = {
    "mean log-odds": mean_odds,
    "product of p": product_of_probabilities,
    "maximum": maximum,
    "majority vote": majority,
    "Dempster-Shafer": dempster_shafer,
}


def table(
    judges: Mapping[str, Judge], best: str, images: Sequence[ImageCandidates]
) -> tuple[list[str], list[list[str]]]:
    """Lay out Pd of members and fusions on floors learned and left out, as header and rows.

    Differences are on floors left out, to the best single family and to all features in one discriminant; images are
    drawn again for the intervals.
    """
    scores = {name: [scored_image(image, judge) for image in images] for name, judge in judges.items()}
    groups = {"learned": LEARNED_FLOORS, "left out": FLOORS_LEFT_OUT}
    rows = []
    for name, own in scores.items():
        cells = [name]
        for floors in groups.values():
            cells += [pd_cell(_of(own, floors), limit) for limit in _LIMITS_PER_KM2]
        cells += [
            ""
            if name == other
            else difference_cell(_of(own, FLOORS_LEFT_OUT), _of(scores[other], FLOORS_LEFT_OUT), LIMIT_PER_KM2)
            for other in (best, TOGETHER)
        ]
        rows.append(cells)
    header = [f"{words}, {pd_words(limit)}" for words in groups for limit in _LIMITS_PER_KM2]
    header += [f"left out, more than {other}" for other in (best, TOGETHER)]
    return ["classifier", *header], rows


def _of(scores: Sequence[Scored], floors: Sequence[str]) -> list[Scored]:
    return [one for one in scores if one.domain.split("/")[0] in floors]


def _detector(tile: TileCandidates) -> Array:
    return tile.detector_odds


def _fused(
    members: Sequence[Judge], names: Sequence[str], calibration: Calibration, rule: Rule, tile: TileCandidates
) -> Array:
    odds = np.column_stack([member(tile) for member in members])
    known = np.isfinite(odds).all(axis=1)
    calibrated = np.column_stack(
        [calibration.odds(name, column) for name, column in zip(names, odds[known].T, strict=True)]
    )
    fused = np.full(len(odds), -math.inf)
    fused[known] = rule(calibrated, calibration.prior)
    return fused


def _stacked(members: Sequence[Judge], stacker: Discriminant, tile: TileCandidates) -> Array:
    odds = np.column_stack([member(tile) for member in members])
    known = np.isfinite(odds).all(axis=1)
    fused = np.full(len(odds), -math.inf)
    fused[known] = stacker.log_odds(odds[known])
    return fused
