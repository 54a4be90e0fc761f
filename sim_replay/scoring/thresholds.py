"""Choose thresholds by the false alarms or the Pd that they give, and say how sure a difference is.

Scores are of any kind that rises with what speaks for a mine: p_mine, log-odds, nats of evidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_replay.scoring.inputs import ScoredMission
from sim_replay.scoring.intervals import CONFIDENCE, Proportion, proportion
from sim_replay.scoring.layout import MissionLayout, lay_out
from sim_replay.scoring.score import GATE_M, Score

_BAND_SEED: Final = 1  # of missions drawn again, fixed so that bands repeat
_N_RESAMPLES: Final = 2000  # of missions: bounds of 95 % move by less than 0.01 with more

Floats = NDArray[np.float64]


class Interval(NamedTuple):
    """Hold a value and the interval that holds 95 % of resampled missions."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:+.2f} ({self.low:+.2f} to {self.high:+.2f})"


def threshold_at(false_alarms: ArrayLike, n_allowed: float, *, nothing: float = -math.inf) -> float:
    """Find the lowest threshold above which no more false alarms lie than allowed.

    Parameters
    ----------
    false_alarms
        Score of each, (n,).
    n_allowed
        Their number.
    nothing
        Score of what was not found, the lowest there is.
    """
    ordered = np.append(np.sort(np.asarray(false_alarms, dtype=np.float64))[::-1], nothing)
    return float(ordered[min(math.floor(n_allowed), len(ordered) - 1)])


def resampled(statistic: Callable[[Sequence[int]], float], n_missions: int, *, seed: int) -> Interval:
    """Bound a statistic of missions by drawing them again with replacement (B. Efron, Annals of Statistics 7, 1979).

    Parameters
    ----------
    statistic
        Of missions by their numbers; for a paired difference both ways of a mission go together.
    n_missions
        Their number, 1 or more.
    seed
        Of the draws, fixed so that reports repeat.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    drawn = random.integers(0, n_missions, (_N_RESAMPLES, n_missions))
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile([statistic(row) for row in drawn.tolist()], (tail, 1.0 - tail)).tolist()
    return Interval(statistic(range(n_missions)), low, high)


def pd_at(score: Score, limit_per_km2: float, *, on_clutter: bool = True) -> Proportion:
    """Find the best Pd with at most so many false alarms per km².

    Parameters
    ----------
    score
        Of missions.
    limit_per_km2
        False alarms per km².
    on_clutter
        Whether those on known clutter count.
    """
    if score.area_km2 <= 0.0:
        return proportion(0, score.n_targets)
    allowed = [
        point.pd
        for point in score.froc
        if point.false_alarms.count - (0 if on_clutter else point.on_known_clutter) <= limit_per_km2 * score.area_km2
    ]
    return max(allowed, key=lambda pd: pd.count, default=proportion(0, score.n_targets))


class BestScores(NamedTuple):
    """Hold one mission by its scores, of any kind that rises with what speaks for a mine.

    targets: of the best contact on each that was seen, -inf for none. false_alarms: of contacts on no target.
    """

    targets: Floats
    false_alarms: Floats
    area_km2: float


def best_scores(mission: ScoredMission) -> BestScores:
    """Place contacts on the nearest object within GATE_M, on targets before others, and take the best of each."""
    layout = lay_out(mission, GATE_M)
    on = _objects_under(layout)
    best = np.full(len(layout.objects), -math.inf)
    np.maximum.at(best, on[on >= 0], layout.p_mine[on >= 0])
    on_target = (on >= 0) & np.append(layout.is_target, False)[on]
    return BestScores(
        targets=best[layout.is_target & layout.is_seen],
        false_alarms=layout.p_mine[~on_target],
        area_km2=mission.truth.area_km2,
    )


def _objects_under(layout: MissionLayout) -> NDArray[np.intp]:
    """Find the object that each contact lies on, -1 for none, (n,): the nearest target, or else the nearest object."""
    found = np.full(len(layout.contacts), -1, dtype=np.intp)
    for index in range(len(found)):
        near = np.flatnonzero(layout.near[index])
        if near.size:
            away = np.hypot(*layout.offset_m[index][near].T)
            found[index] = near[np.lexsort((away, ~layout.is_target[near]))[0]]
    return found


def found_at(missions: Sequence[BestScores], limit_per_km2: float) -> Proportion:
    """Find the share of targets above the lowest threshold with so many false alarms per km² or fewer."""
    n_allowed = limit_per_km2 * sum(one.area_km2 for one in missions)
    above = threshold_at(np.concatenate([one.false_alarms for one in missions]), n_allowed)
    n_found = sum(int(np.count_nonzero(one.targets > above)) for one in missions)
    return proportion(n_found, sum(len(one.targets) for one in missions))


def banded_at(missions: Sequence[BestScores], limit_per_km2: float) -> Interval:
    """Find Pd as `found_at` does, with the wider of two bounds of 95 %: of missions drawn again, and of targets.

    Wilson's, which counts targets, is the wider one where all or none are found: all drawn again agree there.
    """
    found = found_at(missions, limit_per_km2)
    drawn = resampled(
        lambda some: found_at([missions[k] for k in some], limit_per_km2).value or 0.0, len(missions), seed=_BAND_SEED
    )
    return Interval(found.value or 0.0, min(drawn.low, found.low or 0.0), max(drawn.high, found.high or 0.0))
