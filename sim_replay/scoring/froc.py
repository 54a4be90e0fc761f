"""Trace the free-response receiver operating characteristic: Pd against false alarms per km², over p_mine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from sim_replay.scoring.intervals import CONFIDENCE, Density, Proportion, density, proportion
from sim_replay.scoring.layout import MissionLayout, Outcome, State, nothing_called, states

HEADLINE_PER_KM2: Final = (10.0, 30.0, 100.0)  # false alarms per km² at which Pd is printed
AREA_FROM_PER_KM2: Final = 1.0  # false alarms per km² where the area under the curve begins
AREA_TO_PER_KM2: Final = 1000.0  # and where it ends
MIN_BOOTSTRAP_MISSIONS: Final = 3  # fewer say nothing of the scatter between missions
_N_RESAMPLES: Final = 2000  # of the bootstrap
_RESAMPLES_AT_ONCE: Final = 100  # bounds the memory that many thresholds take
_SEED: Final = 1  # of the bootstrap, fixed so that scores repeat


class OperatingPoint(msgspec.Struct, frozen=True, kw_only=True):
    """Count all contacts with p_mine of `threshold` or more.

    Those `on_known_clutter` are among the false alarms, duplicates are not.
    """

    threshold: float
    pd: Proportion
    false_alarms: Density
    on_known_clutter: int
    duplicates: int
    on_unseen_targets: int


class Headline(msgspec.Struct, frozen=True, kw_only=True):
    """Hold the best Pd within `limit_per_km2` false alarms.

    At `threshold`, None if every threshold gives more of them (Pd 0 then).
    """

    limit_per_km2: float
    pd: Proportion
    threshold: float | None
    per_km2: float


class Bounds(msgspec.Struct, frozen=True, kw_only=True):
    """Hold an interval."""

    low: float
    high: float


class Bootstrap(msgspec.Struct, frozen=True, kw_only=True):
    """Hold the interval that holds 95 % of resampled missions.

    Targets and clutter of one mission may depend on each other.

    None where no resample holds a target. `headline_pd` goes with the limits of the headlines.
    """

    n_missions: int
    n_resamples: int
    seed: int
    pd: Bounds | None
    fa_per_km2: Bounds | None
    headline_pd: tuple[Bounds | None, ...]


class Curve(NamedTuple):
    """Hold missions pooled, over falling thresholds.

    (n_missions, n_thresholds, n_outcomes) `counts`, and per mission targets and area.
    """

    thresholds: NDArray[np.float64]
    counts: NDArray[np.int64]
    targets: NDArray[np.int64]
    area_km2: NDArray[np.float64]

    @property
    def detections(self) -> NDArray[np.int64]:
        """Count detections, (n_missions, n_thresholds)."""
        return self.counts[..., Outcome.DETECTION]

    @property
    def false_alarms(self) -> NDArray[np.int64]:
        """Count false alarms, (n_missions, n_thresholds)."""
        return self.counts[..., Outcome.ON_CLUTTER] + self.counts[..., Outcome.ELSEWHERE]


def trace(layouts: Sequence[MissionLayout], area_km2: Sequence[float], threshold: float) -> tuple[Curve, list[State]]:
    """Trace the curve over all distinct thresholds; return it with each mission's state at `threshold`."""
    chosen: list[State] = []
    steps: list[tuple[NDArray[np.float64], NDArray[np.int64]]] = []
    for layout in layouts:
        state = nothing_called(layout)
        own_thresholds, own_counts = [state.threshold], [_counts(state)]
        for further in states(layout):
            own_thresholds.append(further.threshold)
            own_counts.append(_counts(further))
            if further.threshold >= threshold:
                state = further
        chosen.append(state)
        steps.append((np.array(own_thresholds), np.array(own_counts)))
    thresholds = np.unique(np.concatenate([own[1:] for own, _ in steps]))[::-1]
    # Between its own thresholds a mission stands where it stood at the one before; above all of them nothing is called.
    counts = np.stack([own_counts[np.searchsorted(-own, -thresholds, side="right") - 1] for own, own_counts in steps])
    targets = np.array([np.count_nonzero(layout.is_target & layout.is_seen) for layout in layouts], dtype=np.int64)
    return Curve(thresholds, counts, targets, np.array(area_km2, dtype=np.float64)), chosen


def operating_points(curve: Curve) -> tuple[OperatingPoint, ...]:
    """List all operating points of a curve, by falling threshold."""
    pooled, targets, area_km2 = curve.counts.sum(axis=0), int(curve.targets.sum()), float(curve.area_km2.sum())
    return tuple(
        _point(level, row, targets, area_km2) for level, row in zip(curve.thresholds.tolist(), pooled, strict=True)
    )


def point_at(curve: Curve, threshold: float) -> OperatingPoint:
    """Compute the operating point of any threshold, also one that no contact has."""
    reached = int(np.count_nonzero(curve.thresholds >= threshold))
    row = curve.counts[:, reached - 1].sum(axis=0) if reached else np.zeros(len(Outcome), dtype=np.int64)
    return _point(threshold, row, int(curve.targets.sum()), float(curve.area_km2.sum()))


def headlines(curve: Curve) -> tuple[Headline, ...]:
    """Compute the best Pd at each of HEADLINE_PER_KM2."""
    detections, targets, area_km2 = curve.detections.sum(axis=0), int(curve.targets.sum()), float(curve.area_km2.sum())
    per_km2 = curve.false_alarms.sum(axis=0) / area_km2
    found = []
    for limit in HEADLINE_PER_KM2:
        allowed = int(np.count_nonzero(per_km2 <= limit))
        found.append(
            Headline(
                limit_per_km2=limit,
                pd=proportion(int(detections[allowed - 1]) if allowed else 0, targets),
                threshold=float(curve.thresholds[allowed - 1]) if allowed else None,
                per_km2=float(per_km2[allowed - 1]) if allowed else 0.0,
            )
        )
    return tuple(found)


def partial_area(curve: Curve) -> float | None:
    """Average Pd over the logarithm of 1 to 1000 false alarms per km², 0..1; None without targets.

    Pd at a density is the best one with at most that many, so the curve is a stair, and level beyond its last point.
    """
    targets = int(curve.targets.sum())
    if not targets:
        return None
    per_km2 = curve.false_alarms.sum(axis=0) / curve.area_km2.sum()
    edges = np.log(np.clip(np.append(per_km2, np.inf), AREA_FROM_PER_KM2, AREA_TO_PER_KM2))
    share = np.diff(edges) / np.log(AREA_TO_PER_KM2 / AREA_FROM_PER_KM2)
    return float(np.sum(share * curve.detections.sum(axis=0) / targets))


def bootstrap(curve: Curve, threshold: float) -> Bootstrap | None:
    """Resample missions with replacement; None for fewer than three. The same missions give the same bounds.

    Efron, "Bootstrap methods: another look at the jackknife", Annals of Statistics 7 (1979); percentile intervals.
    """
    n_missions = len(curve.targets)
    if n_missions < MIN_BOOTSTRAP_MISSIONS:
        return None
    random = np.random.Generator(np.random.PCG64(_SEED))
    drawn = random.multinomial(n_missions, np.full(n_missions, 1.0 / n_missions), size=_N_RESAMPLES)
    # A column in front for thresholds above all contacts, where nothing is called.
    detections = np.pad(curve.detections, ((0, 0), (1, 0)))
    false_alarms = np.pad(curve.false_alarms, ((0, 0), (1, 0)))
    chosen = int(np.count_nonzero(curve.thresholds >= threshold))
    rows = []
    for weights in np.array_split(drawn, _N_RESAMPLES // _RESAMPLES_AT_ONCE):
        targets = (weights @ curve.targets).astype(np.float64)
        pd = weights @ detections / np.where(targets > 0.0, targets, np.nan)[:, None]
        per_km2 = weights @ false_alarms / (weights @ curve.area_km2)[:, None]
        allowed = [np.count_nonzero(per_km2 <= limit, axis=1) - 1 for limit in HEADLINE_PER_KM2]
        best = [np.take_along_axis(pd, place[:, None], axis=1)[:, 0] for place in allowed]
        rows.append(np.stack([pd[:, chosen], per_km2[:, chosen], *best]))
    pd_bounds, fa_bounds, *headline_bounds = [_bounds(samples) for samples in np.concatenate(rows, axis=1)]
    return Bootstrap(
        n_missions=n_missions,
        n_resamples=_N_RESAMPLES,
        seed=_SEED,
        pd=pd_bounds,
        fa_per_km2=fa_bounds,
        headline_pd=tuple(headline_bounds),
    )


def _counts(state: State) -> NDArray[np.int64]:
    return np.bincount(state.outcome, minlength=len(Outcome))


def _point(threshold: float, counts: NDArray[np.int64], targets: int, area_km2: float) -> OperatingPoint:
    return OperatingPoint(
        threshold=threshold,
        pd=proportion(int(counts[Outcome.DETECTION]), targets),
        false_alarms=density(int(counts[Outcome.ON_CLUTTER] + counts[Outcome.ELSEWHERE]), area_km2),
        on_known_clutter=int(counts[Outcome.ON_CLUTTER]),
        duplicates=int(counts[Outcome.DUPLICATE]),
        on_unseen_targets=int(counts[Outcome.ON_UNSEEN]),
    )


def _bounds(samples: NDArray[np.float64]) -> Bounds | None:
    samples = samples[np.isfinite(samples)]
    if not samples.size:
        return None
    low, high = np.quantile(samples, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    return Bounds(low=float(low), high=float(high))
