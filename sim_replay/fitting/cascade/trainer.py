"""Train a cascade from a set of labelled tiles: boosting, hard negatives, reject thresholds, calibration.

Each round learns from all that the rounds before brought: the window that shows each target best, and windows that are
no target. The last round's stumps become the cascade, whose thresholds, calibration and expected detection come from
the validation tiles. The same tiles give the same model, byte for byte, on any number of workers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.model import Calibration, CascadeModel, Stump, check_model
from auv_mcm.errors import UsageError
from sim_replay.fitting.cascade.boost import BoostedStump, gentle_stumps
from sim_replay.fitting.cascade.bootstrap import Errand, glean
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.cascade.pool import Pool, bin_edges, feature_pool, model_stump, quantise
from sim_replay.fitting.cascade.soft import group_sizes, reject_thresholds
from sim_replay.fitting.cascade.store import Manifest, Shard, read_manifest
from sim_replay.fitting.cascade.tiles import Split
from sim_replay.fitting.cascade.validation import (
    Inspection,
    PassRates,
    ValidationSighting,
    calibrate,
    expected_pd,
    passed,
    passes,
    sightings,
)

Progress: TypeAlias = Callable[[str], None]
Floats: TypeAlias = NDArray[np.float32]

N_STUMPS: Final = 320
"""Of a soft cascade, unless asked otherwise."""

_SEED: Final = 7  # of the training, fixed so that models repeat
_DETECTION: Final = (
    0.95  # share of the validation targets that the cascade keeps: the last few are hidden in rocks, or hardly show
)
_PASSES: Final = 5  # over the tiles, each with so many more of a soft cascade's stumps
_ASYMMETRY: Final = 4.0  # times the weight of clutter, that targets start with
_MINING_DETECTION: Final = 0.99  # share of targets kept by the models that look for hard windows
_MINING_MARGIN: Final = 1024  # below the worst target kept: few stumps separate their own training targets too well
_OTHERS: Final = 20_000  # windows a pass is to bring, over all tiles
_MAX_PER_TILE: Final = 30  # hard windows of one tile, so that no tile makes up the set
_FEWEST: Final = 0.01  # of the windows a pass was to bring; with fewer there is little left to learn
_EDGE_WINDOWS: Final = 6000  # of each class, for the quantiles
_SPACING_TOLERANCE: Final = 0.1  # relative change of a tile's spacing that a model accepts
_SHARES: Final = (0.8, 0.9, 0.95, 0.98)  # of targets that pass, for which the report gives the windows that pass
_UNKNOWN: Final = Calibration(score=(0, 1), log_odds=(0.0, 0.0))


class _Tiles(NamedTuple):
    """Hold a folder of tiles, and the farm that processes it."""

    folder: Path
    manifest: Manifest
    farm: Farm

    def shards(self, split: Split) -> list[Shard]:
        return [shard for shard in self.manifest.shards if shard.split == split]


class _Lesson(NamedTuple):
    """Hold the samples of a pass over the training shards: box means (n_boxes, n) of targets and others; where others
    stand, (n, 4): shard, tile, row, column. n_asked: others that would have been taken. spacings_m: (n_tiles, 2).
    """

    targets: Floats
    others: Floats
    places: NDArray[np.int32]
    n_asked: int
    spacings_m: NDArray[np.float64]


def train(folder: Path, farm: Farm, progress: Progress, n_stumps: int = N_STUMPS) -> CascadeModel:
    """Train on the "train" shards of a folder, settle thresholds and calibration on its "validate" shards.

    Parameters
    ----------
    progress
        Takes lines about progress.
    n_stumps
        Of the cascade, at most.

    Raises
    ------
    BadInputError
        For a folder that holds no training set, UsageError for one that lacks targets.
    """
    tiles = _Tiles(folder, read_manifest(folder), farm)
    splits: tuple[Split, Split] = ("train", "validate")
    for split in splits:
        if not any(shard.n_targets for shard in tiles.shards(split)):
            raise UsageError(
                f"{folder}: no targets among the '{split}' tiles. Render a set with seeds and targets for both splits"
            )
    pool = feature_pool()
    progress(f"{len(pool.features)} features of {len(pool.boxes)} boxes")
    model = _validated(tiles, _soft(tiles, pool, progress, n_stumps), progress)
    check_model(model, f"the model trained on {folder}")
    return model


def _soft(tiles: _Tiles, pool: Pool, progress: Progress, n_stumps: int) -> CascadeModel:
    model: CascadeModel | None = None
    others: list[Floats] = []
    known: set[tuple[int, ...]] = set()
    n_rounds = 0
    for number in range(_PASSES):
        lesson = _pass(tiles, pool, model, number)
        places = [tuple(place) for place in lesson.places.tolist()]
        is_new = np.array([place not in known for place in places], dtype=np.bool_)
        known.update(places)
        others.append(lesson.others[:, is_new])
        every = np.concatenate(others, axis=1)
        progress(
            f"pass {number + 1}: {lesson.targets.shape[1]} targets, {every.shape[1]} others, {is_new.sum()} of them new"
        )
        few = int(is_new.sum()) < _FEWEST * lesson.n_asked
        if few and n_rounds == n_stumps:
            break
        # The first passes show what is easy: few stumps will do. The last one, and one that shows hardly anything new,
        # gets all.
        n_rounds = (
            n_stumps if few or number == _PASSES - 1 else max(n_rounds, math.ceil((number + 1) * n_stumps / _PASSES))
        )
        model = _boosted(tiles, pool, lesson, every, n_rounds, _rng(number))
        progress(f"pass {number + 1}: {model.n_stumps} stumps in {len(model.groups)} groups")
    assert model is not None
    return model


def _boosted(
    tiles: _Tiles, pool: Pool, lesson: _Lesson, others: Floats, n_rounds: int, rng: np.random.Generator
) -> CascadeModel:
    """Boost a soft cascade with thresholds that nearly all targets pass that it learned from, and what is almost as
    good as those.
    """
    edges = _edges(pool, lesson.targets, others)
    bins = quantise(pool, edges, np.concatenate((lesson.targets, others), axis=1))
    is_target = np.arange(bins.shape[1]) < lesson.targets.shape[1]
    stumps = list(gentle_stumps(bins, is_target, n_rounds, _ASYMMETRY, rng))
    if not stumps:
        raise UsageError(f"{tiles.folder}: no feature separates targets from clutter. Render a set with more missions")
    sizes = group_sizes(len(stumps))
    stops = list(accumulate(sizes))
    after = np.cumsum([stump.scores(bins[:, is_target]) for stump in stumps], axis=0, dtype=np.int32)[
        np.array(stops) - 1
    ].T
    reject = [score - _MINING_MARGIN for score in reject_thresholds(after, np.arange(len(after)), _MINING_DETECTION)]
    groups = [_model_group(pool, edges, stumps[stop - size : stop]) for size, stop in zip(sizes, stops, strict=True)]
    return _model(tiles, groups, reject, lesson, others.shape[1])


def _pass(tiles: _Tiles, pool: Pool, model: CascadeModel | None, number: int) -> _Lesson:
    shards = tiles.shards("train")
    n_tiles = sum(shard.n_tiles for shard in shards)
    n_others = min(_MAX_PER_TILE, math.ceil(_OTHERS / n_tiles))
    errands = [Errand(tiles.folder, shard, pool.boxes, model, n_others, _SEED + number) for shard in shards]
    gleaned = list(run_tasks(glean, errands, tiles.farm))
    return _Lesson(
        targets=np.concatenate([item.targets for item in gleaned], axis=1),
        others=np.concatenate([item.others for item in gleaned], axis=1),
        places=np.concatenate([np.insert(item.places, 0, shard, axis=1) for shard, item in enumerate(gleaned)]),
        n_asked=n_others * n_tiles,
        spacings_m=np.concatenate([item.spacings_m for item in gleaned]),
    )


def _rng(number: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64([_SEED, number]))


def _edges(pool: Pool, targets: Floats, others: Floats) -> Floats:
    """Return bins as fine for the few targets as for the many others."""
    samples = [
        means[:, np.linspace(0, means.shape[1] - 1, min(means.shape[1], _EDGE_WINDOWS)).astype(np.intp)]
        for means in (targets, others)
    ]
    return bin_edges(pool, np.concatenate(samples, axis=1))


def _model_group(pool: Pool, edges: Floats, stumps: Sequence[BoostedStump]) -> tuple[Stump, ...]:
    return tuple(model_stump(pool, edges, stump) for stump in stumps)


def _model(
    tiles: _Tiles, groups: Sequence[tuple[Stump, ...]], reject: Sequence[int], lesson: _Lesson, n_others: int
) -> CascadeModel:
    backgrounds = sorted({shard.background.rsplit("/", 1)[0] for shard in tiles.shards("train")})
    min_m, max_m = lesson.spacings_m.min(axis=0), lesson.spacings_m.max(axis=0)
    spacings = [
        (round(float(a) * (1.0 - _SPACING_TOLERANCE), 5), round(float(b) * (1.0 + _SPACING_TOLERANCE), 5))
        for a, b in zip(min_m, max_m, strict=True)
    ]
    return CascadeModel(
        kind="soft",
        trained_on=(
            f"{lesson.targets.shape[1]} looks at targets and {n_others} other windows of {', '.join(backgrounds)}"
        ),
        training_sha256=tiles.manifest.sha256,
        row_spacing_m=spacings[0],
        column_spacing_m=spacings[1],
        calibration=_UNKNOWN,
        reject=tuple(reject),
        groups=tuple(groups),
    )


def _validated(tiles: _Tiles, model: CascadeModel, progress: Progress) -> CascadeModel:
    """Return the model with thresholds, calibration and expected detection from the validation shards."""
    shards = tiles.shards("validate")
    seen = [
        sighting
        for found in run_tasks(sightings, [Inspection(tiles.folder, s, model) for s in shards], tiles.farm)
        for sighting in found
    ]
    if not seen:
        raise UsageError(
            f"{tiles.folder}: no window of a validation target can be judged. Render a set with more validation "
            "missions"
        )
    scores = np.stack([sighting.trace for sighting in seen])
    model = msgspec.structs.replace(model, reject=reject_thresholds(scores, np.arange(len(scores)), _DETECTION))
    parts = list(run_tasks(passed, [Inspection(tiles.folder, shard, model) for shard in shards], tiles.farm))
    detections = np.concatenate([part.detections for part in parts])
    is_target = np.concatenate([part.is_target for part in parts])
    if detections.size:
        model = msgspec.structs.replace(model, calibration=calibrate(detections, is_target))
    model = msgspec.structs.replace(model, expected_pd=expected_pd(model, seen))
    for line in _report(model, seen, parts):
        progress(line)
    return model


def _report(model: CascadeModel, seen: Sequence[ValidationSighting], parts: Sequence[PassRates]) -> list[str]:
    """Report the results on the validation tiles, line by line."""
    scores = np.stack([sighting.trace for sighting in seen])
    final = np.sort(scores[passes(model, scores), -1])[::-1]
    windows = np.concatenate([part.windows for part in parts])
    alarms = np.concatenate([part.detections[~part.is_target] for part in parts])
    n_windows, area_km2 = sum(part.n_windows for part in parts), sum(part.area_m2 for part in parts) / 1e6
    lines = [
        f"{len(seen)} looks at validation targets, {len(final)} pass; {n_windows} other windows on {area_km2:.3f} km2"
    ]
    lines.append(f"{'targets':>8} {'windows per million':>20} {'false alarms per km2':>21}")
    for share in (*_SHARES, len(final) / len(seen)):
        n_kept = math.ceil(share * len(seen) - 1e-9)
        if 0 < n_kept <= len(final):
            above = final[n_kept - 1]
            lines.append(
                f"{share:>8.1%} {1e6 * np.count_nonzero(windows >= above) / max(n_windows, 1):>20.2f} "
                f"{np.count_nonzero(alarms >= above) / max(area_km2, 1e-9):>21.1f}"
            )
    return lines
