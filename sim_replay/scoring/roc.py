"""Trace Pd against false alarms per km² for some kinds of targets, with a band from missions drawn again.

Every threshold counts exactly what `auv-mcm score` counts at it. False alarms are those of all contacts on no target,
whichever kind of target is asked about.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_replay.scoring.inputs import ScoredMission
from sim_replay.scoring.intervals import CONFIDENCE, wilson_interval
from sim_replay.scoring.layout import Outcome, lay_out, states
from sim_replay.scoring.matching import UNMATCHED
from sim_replay.scoring.score import GATE_M

N_RESAMPLES: Final = 1000  # of missions: bounds move by less than 0.01 with more
_AT_ONCE: Final = 100  # resamples, bounds the memory that many thresholds take
_SEED: Final = 1  # of the resampling, fixed so that bands repeat

Floats = NDArray[np.float64]


class RankedMission(NamedTuple):
    """Hold the thresholds at which a mission's targets are found and its false alarms arise.

    targets: by kind, of each target that a pass saw the highest threshold that finds it, -inf if none does.
    false_alarms: of each the highest threshold that calls it.
    """

    group: str
    targets: dict[str, Floats]
    false_alarms: Floats
    area_km2: float


class Roc(NamedTuple):
    """Hold a curve: the best Pd within each of per_km2 false alarms, and bounds of 95 % at each.

    The bounds are the wider ones of the percentiles over missions drawn again and of Wilson's, which counts targets:
    where all or none are found all resamples agree. last_per_km2: false alarms when every contact is called.
    """

    per_km2: Floats
    pd: Floats
    low: Floats
    high: Floats
    n_targets: int
    last_per_km2: float


def ranked(group: str, mission: ScoredMission) -> RankedMission:
    """Rank a mission's targets and false alarms by the threshold that calls them."""
    layout = lay_out(mission, GATE_M)
    found = np.full(len(layout.objects), -np.inf)
    false_alarms: list[float] = []
    for state in states(layout):
        matched = state.matched[state.matched != UNMATCHED]
        found[matched] = np.maximum(found[matched], state.threshold)
        n_false_alarms = int(np.count_nonzero(np.isin(state.outcome, (Outcome.ON_CLUTTER, Outcome.ELSEWHERE))))
        false_alarms += [state.threshold] * (n_false_alarms - len(false_alarms))
    kinds = np.array([one.kind for one in layout.objects], dtype=object)
    asked = layout.is_target & layout.is_seen
    return RankedMission(
        group=group,
        targets={kind: found[asked & (kinds == kind)] for kind in dict.fromkeys(kinds[asked].tolist())},
        false_alarms=np.array(false_alarms),
        area_km2=mission.truth.area_km2,
    )


def roc(missions: Sequence[RankedMission], kinds: Collection[str], per_km2: Floats) -> Roc:
    """Trace the curve of some kinds over missions pooled, at given false alarms per km², with its band."""
    counts = _Counts.of(missions, kinds)
    n_targets = int(counts.targets.sum())
    pd = counts.best(np.ones((1, len(missions))), per_km2)[0]
    drawn = resampled(missions, kinds, per_km2)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.nanquantile(drawn, [tail, 1.0 - tail], axis=0)
    fewest, most = wilson_interval(np.round(pd * n_targets), n_targets)
    return Roc(
        per_km2=per_km2,
        pd=pd,
        low=np.minimum(low, fewest),
        high=np.maximum(high, most),
        n_targets=n_targets,
        last_per_km2=sum(len(one.false_alarms) for one in missions) / sum(one.area_km2 for one in missions),
    )


def resampled(missions: Sequence[RankedMission], kinds: Collection[str], per_km2: Floats) -> Floats:
    """Return the best Pd, (N_RESAMPLES, n_limits), of missions drawn again with replacement, NaN without targets.

    As many missions draw the same ones whatever they hold, so that systems on the same missions compare in pairs.
    """
    counts = _Counts.of(missions, kinds)
    random = np.random.Generator(np.random.PCG64(_SEED))
    drawn = random.multinomial(len(missions), np.full(len(missions), 1.0 / len(missions)), size=N_RESAMPLES)
    parts = np.array_split(drawn.astype(np.float64), math.ceil(N_RESAMPLES / _AT_ONCE))
    return np.concatenate([counts.best(weights, per_km2) for weights in parts])


class _Counts(NamedTuple):
    """Hold the counts at falling thresholds, (n_missions, n_thresholds), and targets and area, (n_missions,)."""

    detections: Floats
    false_alarms: Floats
    targets: Floats
    area_km2: Floats

    @classmethod
    def of(cls, missions: Sequence[RankedMission], kinds: Collection[str]) -> _Counts:
        """Count at every threshold that calls anything, and above all of them."""
        found = [
            np.concatenate([np.empty(0), *(one.targets[kind] for kind in kinds if kind in one.targets)])
            for one in missions
        ]
        steps = np.unique(np.concatenate([*found, *(one.false_alarms for one in missions)]))
        thresholds = np.append(np.inf, steps[np.isfinite(steps)][::-1])
        return cls(
            detections=np.stack([_reaching(values, thresholds) for values in found]),
            false_alarms=np.stack([_reaching(one.false_alarms, thresholds) for one in missions]),
            targets=np.array([len(values) for values in found], dtype=np.float64),
            area_km2=np.array([one.area_km2 for one in missions]),
        )

    def best(self, weights: Floats, per_km2: Floats) -> Floats:
        """Return the best Pd within each limit, (n, n_limits), where missions count by weights (n, n_missions)."""
        targets = weights @ self.targets
        pd = weights @ self.detections / np.where(targets > 0.0, targets, np.nan)[:, None]
        alarms = weights @ self.false_alarms / (weights @ self.area_km2)[:, None]
        places = np.stack([np.searchsorted(row, per_km2 * (1.0 + 1e-12), side="right") - 1 for row in alarms])
        return np.take_along_axis(pd, places, axis=1)


def _reaching(values: Floats, thresholds: Floats) -> Floats:
    """Count the values that reach each of falling thresholds."""
    rising = np.sort(values)
    return (len(rising) - np.searchsorted(rising, thresholds, side="left")).astype(np.float64)
