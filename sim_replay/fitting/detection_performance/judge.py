"""Judge whether looks find as many targets as predicted, on held-out missions."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import HIGHEST_P
from auv_mcm.clearance.detection_performance import Performance
from auv_mcm.records import SEABED_TYPES, SeabedType
from sim_replay.fitting.detection_performance.fit_performance import Outcomes, pairs, predicted
from sim_replay.scoring.calibration import calibration_error

Array = NDArray[np.float64]

MIN_LOOKS: Final = 30  # with fewer, a share carries no information
_MEAN_DEVIATION: Final = math.sqrt(2.0 / math.pi)  # of a normal distribution, in standard deviations


class PerformanceShare(NamedTuple):
    """Compare looks that were to find a target with mean probability `predicted`, and did with share `realised`.

    by_chance: how far off a share of so few looks is in the mean even if the prediction is right for each of them on
    its own; by_mission: the same with missions that differ from each other as these do.
    """

    n: int
    predicted: float
    realised: float
    by_chance: float
    by_mission: float

    @property
    def error(self) -> float:
        """Compute how far the prediction is off."""
        return abs(self.realised - self.predicted)


class PerformancePlace(NamedTuple):
    """Hold looks at one kind of sea floor within a band of ground range."""

    seabed: SeabedType
    near_m: float
    far_m: float
    share: PerformanceShare


class JudgedPredictions(NamedTuple):
    """Hold how well predictions hold.

    brier: mean square of probability less outcome; brier_constant: that of one and the same probability for all.
    calibration_error: as in `scoring.calibration`. places: those with looks. same, other: pairs of looks at one target,
    from the same direction and from others, found by either; None without any.
    """

    n_looks: int
    n_missions: int
    brier: float
    brier_constant: float
    calibration_error: float
    places: tuple[PerformancePlace, ...]
    same: PerformanceShare | None
    other: PerformanceShare | None

    @property
    def judged(self) -> tuple[PerformancePlace, ...]:
        """Return the places with enough looks to judge."""
        return tuple(place for place in self.places if place.share.n >= MIN_LOOKS)


def judge_predictions(performance: Performance, seen: Outcomes) -> JudgedPredictions:
    """Judge the tables by looks whose floor is the true one. Raises ValueError if there are none."""
    p = predicted(performance, seen)
    base = float(seen.found.mean()) if len(p) else 0.0
    return JudgedPredictions(
        n_looks=len(p),
        n_missions=len(np.unique(seen.mission)),
        calibration_error=calibration_error(p, seen.found),
        brier=float(((p - seen.found) ** 2).mean()),
        brier_constant=base * (1.0 - base),
        places=tuple(_places(performance, seen, p)),
        same=_either(seen, p, *pairs(seen)[0], performance.same_look_correlation),
        other=_either(seen, p, *pairs(seen)[1], performance.other_look_correlation),
    )


def share(p: Array, found: NDArray[np.bool_], mission: NDArray[np.int64]) -> PerformanceShare:
    """Compare predicted with found shares.

    Looks (n,), at least one, taken together. The deviation over missions is that of a ratio of sums over clusters (W.
    Cochran, "Sampling Techniques", 1977, Sec. 6.3), and no less than by chance alone.
    """
    n, realised = len(p), float(found.mean())
    by_chance = math.sqrt(float((p * (1.0 - p)).sum())) / n
    _, cluster = np.unique(mission, return_inverse=True)
    surplus = np.bincount(cluster, found - p) - np.bincount(cluster) * (realised - float(p.mean()))
    n_missions = len(surplus)
    by_mission = (
        math.sqrt(float((surplus**2).sum()) * n_missions / (n_missions - 1)) / n if n_missions > 1 else by_chance
    )
    return PerformanceShare(
        n, float(p.mean()), realised, _MEAN_DEVIATION * by_chance, _MEAN_DEVIATION * max(by_mission, by_chance)
    )


def mean_error(places: tuple[PerformancePlace, ...]) -> tuple[float, float, float]:
    """Average the absolute error over places, 1 or more, each counting the same.

    And what it would be by chance, and by missions, alone.
    """
    errors = [(place.share.error, place.share.by_chance, place.share.by_mission) for place in places]
    error, by_chance, by_mission = np.mean(errors, axis=0).tolist()
    return error, by_chance, by_mission


def _places(performance: Performance, seen: Outcomes, p: Array) -> list[PerformancePlace]:
    edges = performance.edges_m
    band = np.clip(np.searchsorted(edges, seen.ground_range_m, side="right") - 1, 0, len(edges) - 2)
    found = []
    for index, name in enumerate(SEABED_TYPES):
        for number, (near_m, far_m) in enumerate(pairwise(edges)):
            here = (seen.seabed == index) & (band == number)
            if here.any():
                found.append(
                    PerformancePlace(name, near_m, far_m, share(p[here], seen.found[here], seen.mission[here]))
                )
    return found


def _either(
    seen: Outcomes, p: Array, first: NDArray[np.int64], second: NDArray[np.int64], correlation: float
) -> PerformanceShare | None:
    if not len(first):
        return None
    bounded = np.minimum(p, HIGHEST_P)
    missed = (1.0 - bounded[first]) * (1.0 - bounded[second]) ** (1.0 - correlation)
    return share(1.0 - missed, seen.found[first] | seen.found[second], seen.mission[first])
