"""Validate a cascade on held-out sea floor: which targets pass, how many other windows do, what
scores mean."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.model import Calibration, CascadeModel, ExpectedPd
from auv_mcm.detect.cascade.run import run_plane, trace_plane
from sim_replay.fitting.cascade.bootstrap import clear_of_targets, planes_of, target_bags, well_apart
from sim_replay.fitting.cascade.soft import best_windows
from sim_replay.fitting.cascade.store import Shard
from sim_replay.fitting.cascade.tiles import LabelledTile

_GATE_M: Final = 2.0  # m between detection and target, maximum, as in scoring
_RANGE_BANDS_M: Final = (0.0, 10.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0, 200.0)  # m of ground range, edges of the bands
_MAX_LOG_ODDS: Final = 12.0  # nats: bounds what a bin without clutter says


class Inspection(NamedTuple):
    """Hold a model and a shard to run it over."""

    folder: Path
    shard: Shard
    model: CascadeModel


class ValidationSighting(NamedTuple):
    """Hold a target of a validation shard.

    Its sea floor and ground range, and (n_groups,) int32 scores of its best window.
    """

    seabed: str
    ground_range_m: float
    trace: NDArray[np.int32]


class PassRates(NamedTuple):
    """Hold what a cascade lets through.

    windows: (n,) int32 final scores of all windows clear of targets that pass, of n_windows in all. detections:
    (n_detections,) int32 scores of what is left once windows near better ones are dropped, is_target: which of those
    are the best on a target.
    """

    n_windows: int
    area_m2: float
    windows: NDArray[np.int32]
    detections: NDArray[np.int32]
    is_target: NDArray[np.bool_]


def sightings(inspection: Inspection) -> list[ValidationSighting]:
    """Return the best window of every target in a shard, whatever the model rejects."""
    seen: list[ValidationSighting] = []
    for tile, plane in planes_of(inspection.folder, inspection.shard):
        bags = target_bags(tile, plane)
        scores = trace_plane(plane, inspection.model, bags.rows, bags.columns)
        best = best_windows(scores[:, -1], bags.bag)
        for target, window in zip(bags.targets, best, strict=True):
            seen.append(ValidationSighting(target.seabed, target.ground_range_m, scores[window]))
    return seen


def passed(inspection: Inspection) -> PassRates:
    """Return the windows of a shard that pass the model."""
    n_windows, area_m2 = 0, 0.0
    windows, detections, is_target = (
        [np.empty(0, dtype=np.int32)],
        [np.empty(0, dtype=np.int32)],
        [np.empty(0, dtype=np.bool_)],
    )
    for tile, plane in planes_of(inspection.folder, inspection.shard):
        found = run_plane(plane, inspection.model, None)
        clear = clear_of_targets(tile)
        n_windows += found.n_windows - int(np.count_nonzero(tile.usable & ~clear))
        area_m2 += int(np.count_nonzero(clear)) * tile.row_spacing_m * tile.column_spacing_m
        is_clear = clear[found.rows, found.columns]
        windows.append(found.scores[is_clear])
        best = well_apart(tile, found, found.rows.size)
        on_target = _best_on_targets(tile, found.rows[best], found.columns[best])
        counts = on_target | is_clear[best]
        detections.append(found.scores[best][counts])
        is_target.append(on_target[counts])
    return PassRates(n_windows, area_m2, np.concatenate(windows), np.concatenate(detections), np.concatenate(is_target))


def passes(model: CascadeModel, scores: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return (n,) bool, which traces (n, n_groups) pass every group."""
    return np.asarray(np.all(scores >= np.array(model.reject, dtype=np.int32), axis=1))


def expected_pd(model: CascadeModel, seen: Sequence[ValidationSighting]) -> tuple[ExpectedPd, ...]:
    """Return the share of the targets of each sea floor and band of ground range that pass.

    Bands without targets are left out.
    """
    cells: dict[tuple[str, int], list[bool]] = defaultdict(list)
    if not seen:
        return ()
    found = passes(model, np.stack([sighting.trace for sighting in seen]))
    for sighting, is_found in zip(seen, found.tolist(), strict=True):
        band = int(np.searchsorted(_RANGE_BANDS_M, sighting.ground_range_m, side="right")) - 1
        if 0 <= band < len(_RANGE_BANDS_M) - 1:
            cells[sighting.seabed, band].append(is_found)
    return tuple(
        ExpectedPd(
            seabed=seabed,
            near_m=_RANGE_BANDS_M[band],
            far_m=_RANGE_BANDS_M[band + 1],
            n_targets=len(hits),
            pd=round(sum(hits) / len(hits), 4),
        )
        for (seabed, band), hits in sorted(cells.items())
    )


def calibrate(score: NDArray[np.int32], is_target: NDArray[np.bool_]) -> Calibration:
    """Fit log-odds of a target by isotonic regression of labels on scores (n,), n at least 1.

    Pool-adjacent-violators (M. Ayer et al., Annals of Mathematical Statistics 26, 1955). Each pool of n with k targets
    gives ln((k + 1/2) / (n - k + 1/2)) at its mean score, so that pools of one kind stay finite.
    """
    values, where = np.unique(score, return_inverse=True)
    pools: list[tuple[float, float, float]] = []  # targets, samples, sum of scores
    targets = np.bincount(where, weights=is_target)
    for value, n_targets, n in zip(values.tolist(), targets.tolist(), np.bincount(where).tolist(), strict=True):
        pools.append((n_targets, n, value * n))
        while len(pools) > 1 and pools[-2][0] * pools[-1][1] >= pools[-1][0] * pools[-2][1]:
            last = pools.pop()
            pools[-1] = (pools[-1][0] + last[0], pools[-1][1] + last[1], pools[-1][2] + last[2])
    knots: dict[int, float] = {}
    highest = -_MAX_LOG_ODDS
    for n_targets, n, total in pools:
        highest = max(highest, min(float(np.log((n_targets + 0.5) / (n - n_targets + 0.5))), _MAX_LOG_ODDS))
        knots[round(total / n)] = round(highest, 4)
    if len(knots) == 1:
        ((at, odds),) = knots.items()
        knots[at + 1] = odds
    return Calibration(score=tuple(knots), log_odds=tuple(knots.values()))


def _best_on_targets(tile: LabelledTile, rows: NDArray[np.int32], columns: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return (n,) bool: the first of the detections, best first, within the gate of each target."""
    is_best = np.zeros(rows.size, dtype=np.bool_)
    for tile_object in tile.objects:
        if tile_object.is_target and rows.size:
            along_m = (rows + 0.5 - tile_object.row) * tile.row_spacing_m
            across_m = (columns + 0.5 - tile_object.column) * tile.column_spacing_m
            inside = np.hypot(along_m, across_m) <= _GATE_M
            is_best[np.argmax(inside)] |= inside.any()
    return is_best
