"""Weigh the network beside the detector's measurements, and judge both on missions left out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.chips import Chip, chip_of, chips_beside
from auv_mcm.classify.odds import MineOdds, Verification
from auv_mcm.classify.verifier import CLASSES, MINE_KINDS, Network, mean_scores, rest_ratio
from auv_mcm.confirm.region import Region
from auv_mcm.errors import UsageError
from auv_mcm.snippet import unpack_snippet
from sim_replay.fitting.verifier.mill import BESIDE, FLOOR, GEOMETRY, MINE, OTHER, Catch, read_catch
from sim_replay.fitting.verifier.train import ChipTable

Array = NDArray[np.float64]

LIMITS_PER_KM2: Final = (30.0, 100.0, 300.0)
"""False alarms per km² at which Pd is compared."""
_OTHER_NATS: Final = tuple(np.arange(-4.0, 2.01, 0.5))  # tried, added to the score of other objects
_FLOOR_KEPT: Final = 2  # so many detections on the floor that one is learnt from: there are as many then as of mines
_RIDGE: Final = 1.0  # on slopes about a half, as much as a look or so
_DIGITS: Final = 4  # decimals in the file


class Looks(NamedTuple):
    """Hold what is known of n looks of a mission.

    group: what the mission is of. detector: log-odds by the detector's measurements. scores: of the network, (n,
    len(CLASSES)). kind: index into CLASSES. label: MINE, OTHER, FLOOR. first: the best look of a passage of an object;
    all of the floor. n_targets: passes that saw a mine. area_km2: seen by the mission.
    """

    group: str
    detector: Array
    scores: Array
    kind: NDArray[np.int8]
    label: NDArray[np.int8]
    first: NDArray[np.bool_]
    n_targets: int
    area_km2: float


def regions_of(caught: Catch) -> list[Region]:
    """Unpack the sea floor around each detection."""
    regions, start = [], 0
    for (n_rows, n_columns), values in zip(caught.shapes.tolist(), caught.geometry.tolist(), strict=True):
        codes = caught.codes[start : start + n_rows * n_columns].reshape(n_rows, n_columns)
        start += n_rows * n_columns
        known = dict(zip(GEOMETRY, values, strict=True))
        altitude_m = known.pop("first_return_m")
        intensity = unpack_snippet(codes).astype(np.float64)
        regions.append(Region(intensity=intensity, valid=codes > 0, altitude_m=altitude_m, **known))
    return regions


def chips_of(places: Sequence[Path]) -> ChipTable:
    """Cut the chips of missions to learn from: on objects, and one in _FLOOR_KEPT on the floor.

    Raises UsageError if there are none.
    """
    parts = []
    for place in places:
        caught = read_catch(place)
        kept = np.flatnonzero((caught.label == MINE) | (caught.label == OTHER) | _is_kept_floor(caught.label))
        regions = regions_of(caught)
        chips = [chip_of(regions[k]) for k in kept]
        if chips:
            parts.append(table_of(chips, classes_of(caught)[kept]))
    if not parts:
        raise UsageError("no mission has a detection to learn from. Fly more of them, or scenes with more objects")
    return ChipTable(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def classes_of(caught: Catch) -> NDArray[np.int8]:
    """Give the index into CLASSES of each detection, (n,); -1 beside an object."""
    found = np.full(len(caught.label), -1, dtype=np.int8)
    found[caught.label == OTHER] = CLASSES.index("other object")
    found[caught.label == FLOOR] = CLASSES.index("floor")
    for number, kind in enumerate(MINE_KINDS):
        found[(caught.label == MINE) & (caught.kind == kind)] = number
    return found


def _is_kept_floor(label: NDArray[np.int8]) -> NDArray[np.bool_]:
    is_floor = label == FLOOR
    return np.asarray(is_floor & (np.cumsum(is_floor) % _FLOOR_KEPT == 1))


def table_of(chips: Sequence[Chip], label: NDArray[np.int8]) -> ChipTable:
    """Lay chips out as arrays."""
    return ChipTable(
        np.array([chip.by_metres for chip in chips], dtype=np.float16),
        np.array([chip.by_height for chip in chips], dtype=np.float16),
        np.array([chip.place for chip in chips], dtype=np.float32),
        label,
    )


def looks_of(place: Path, group: str, network: Network, odds: MineOdds) -> Looks:
    """Score the looks of a mission, those beside an object left out."""
    caught = read_catch(place)
    regions = regions_of(caught)
    kept = np.flatnonzero(caught.label != BESIDE)
    names = caught.names.tolist()
    detector = np.array(
        [odds.log_ratio("detector", dict(zip(names, row, strict=True))) for row in caught.features[kept].tolist()]
    )
    chips = [chip_of(regions[k]) for k in kept]
    beside = [other for k, chip in zip(kept, chips, strict=True) for other in chips_beside(regions[k], chip)]
    scores = mean_scores(network.scores(chips), network.scores(beside))
    label = caught.label[kept]
    first = np.ones(len(kept), dtype=np.bool_)
    for each in set(zip(caught.nearest[kept].tolist(), caught.passage[kept].tolist(), strict=True)):
        same = (caught.nearest[kept] == each[0]) & (caught.passage[kept] == each[1]) & np.isin(label, (MINE, OTHER))
        others = np.flatnonzero(same)
        first[others] = False
        if len(others):
            first[others[detector[others].argmax()]] = True
    return Looks(
        group,
        detector + odds.prior,
        scores,
        classes_of(caught)[kept],
        label,
        first,
        int(caught.n_targets),
        float(caught.area_km2),
    )


def weighed(looks: Sequence[Looks], digest: str) -> Verification:
    """Fit the weights of detector and network by logistic regression, so that p_mine is right on these missions.

    Groups of missions count alike, however many looks they have: the detector knows the named scenes, whose kind of
    floor it was trained on, and the network the drawn missions.

    Raises UsageError without mines, or nothing else, among the looks.
    """
    is_mine = np.concatenate([(one.label == MINE)[one.first] for one in looks])
    if not is_mine.any() or is_mine.all():
        raise UsageError("no mines, or nothing else, were looked at in the missions to weigh on. Fly them again")
    detector = np.concatenate([one.detector[one.first] for one in looks])
    scores = np.concatenate([one.scores[one.first] for one in looks])
    group = np.concatenate([np.full(int(one.first.sum()), one.group) for one in looks])
    counts = {name: int(np.count_nonzero(group == name)) for name in np.unique(group).tolist()}
    weight = len(group) / len(counts) / np.array([counts[name] for name in group.tolist()])
    tried = []
    for other_nats in _OTHER_NATS:
        columns = np.column_stack([detector, rest_ratio(scores, other_nats), np.ones(len(detector))])
        found, loss = _logistic(columns, is_mine, weight)
        tried.append((loss, other_nats, found))
    _, other_nats, (slope, network, offset) = min(tried, key=lambda one: one[0])
    return Verification(
        digest=digest,
        offset=round(float(offset), _DIGITS),
        detector=round(float(slope), _DIGITS),
        network=round(float(network), _DIGITS),
        other_nats=round(float(other_nats), _DIGITS),
    )


def log_odds_of(one: Looks, weights: Verification) -> Array:
    """Weigh the looks of a mission, (n,)."""
    nats = rest_ratio(one.scores, weights.other_nats)
    return np.array([weights.log_odds(a, b) for a, b in zip(one.detector.tolist(), nats.tolist(), strict=True)])


def pd_at(one: Looks, odds: Array, per_km2: float, *, others: bool) -> float:
    """Compute the share of passes found at a density of false alarms; other objects count among those if `others`."""
    is_mine = one.label[one.first] == MINE
    is_alarm = ~is_mine if others else one.label[one.first] > OTHER
    odds = odds[one.first]
    ranked = np.sort(odds[is_alarm])[::-1]
    allowed = int(per_km2 * one.area_km2)
    level = ranked[allowed] if allowed < len(ranked) else -np.inf
    return float(np.count_nonzero(odds[is_mine] > level)) / max(one.n_targets, 1)


def auc_of(one: Looks, odds: Array) -> float:
    """Compute the share of pairs of mine and other object that are in order; NaN without any."""
    mines, others = (odds[one.first & (one.label == label)] for label in (MINE, OTHER))
    if not len(mines) or not len(others):
        return float("nan")
    return float(np.mean((mines[:, None] > others) + 0.5 * (mines[:, None] == others)))


def _logistic(columns: Array, is_mine: NDArray[np.bool_], weight: Array) -> tuple[Array, float]:
    """Return two slopes and an offset of least log-loss, with a slight pull of the slopes towards a half, and that."""
    from scipy.optimize import minimize

    middle, ridge = np.array([0.5, 0.5, 0.0]), np.array([_RIDGE, _RIDGE, 0.0])

    def loss(at: Array) -> tuple[float, Array]:
        odds = columns @ at
        value = float(weight @ (np.logaddexp(0.0, odds) - is_mine * odds) + 0.5 * ridge @ (at - middle) ** 2)
        slope = columns.T @ (weight * (np.exp(-np.logaddexp(0.0, -odds)) - is_mine))
        return value, slope + ridge * (at - middle)

    found = minimize(loss, middle, jac=True, method="BFGS", options={"gtol": 1e-4})
    return np.asarray(found.x), float(found.fun)
