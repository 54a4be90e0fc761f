"""Judge weights on domains that they were not fitted on: scenes, kinds of recorders and recorded lines.

Weights are fitted without a domain, and without what is like it, and judged on it. Looks count one by one, by the last
step that measurements decide: those of the cascade before the verifier. Views of an object are not joined. A pass that
saw a target and left no look at it is a miss.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.odds import FoundAt, LeftOut, MineOdds, Weights
from sim_replay.fitting.fit_odds import LAST_STEP, N_TREES, fit_step, log_odds_of
from sim_replay.fitting.looks import DRAWN, LookTask, MissionLooks, pooled
from sim_replay.fitting.recorders import RECORDED_SCENES, RECORDERS
from sim_replay.scoring.calibration import calibration_error
from sim_replay.scoring.intervals import proportion
from sim_replay.text_tables import columns

Array = NDArray[np.float64]

FIRST_SEED: Final = 2000  # weights were fitted on seeds below 1000 and from 10500 on, rates are taken from 9100 on
LIMITS_PER_KM2: Final = (10.0, 100.0, 300.0)
"""False alarms per km² at which Pd is compared."""
FITTED: Final = ("scenes", DRAWN)
"""Kinds of missions that weights are fitted on, but for what is judged."""
KINDS: Final = ("scenes", "recorders", "recorded lines")
_DIGITS: Final = 4  # decimals in the file of a model


def left_out_tasks(scenes: Sequence[str], n_seeds: int, logs: Sequence[Path], n_log_seeds: int) -> list[LookTask]:
    """List the missions that are judged, those of one domain one after the other: scenes, recorders, recorded lines."""
    seeds, log_seeds = (range(FIRST_SEED, FIRST_SEED + n) for n in (n_seeds, n_log_seeds))
    tasks = [LookTask(name, seed) for name in scenes for seed in seeds]
    tasks += [LookTask(name, seed, 1, recorder) for recorder in RECORDERS for name in RECORDED_SCENES for seed in seeds]
    return tasks + [LookTask(str(log), seed) for log in logs for seed in log_seeds]


class Scored(NamedTuple):
    """Hold one mission's looks as they are judged: log-odds, targets, weights, (n,) each."""

    domain: str
    log_odds: Array
    is_target: NDArray[np.bool_]
    weight: Array
    n_targets: int
    area_km2: float


def kind_of(task: LookTask) -> str:
    """Name the kind of domain: of KINDS, or DRAWN."""
    if task.recorder is not None:
        return "recorders"
    if task.is_line:
        return "recorded lines"
    return DRAWN if task.source == DRAWN else "scenes"


def is_judged(mission: MissionLooks) -> bool:
    """Check whether a mission is judged: those with as many objects as usual, but for drawn ones."""
    return mission.task.times == 1 and mission.task.source != DRAWN


def fitted_on(
    missions: Sequence[MissionLooks], kinds: Collection[str], out: frozenset[str], judged_only: frozenset[str]
) -> list[MissionLooks]:
    """Choose the missions of some kinds that weights are fitted on where the domains `out` are left out.

    Missions over the very sea floor of one that is judged are left out too; other kinds of recorder never are fitted
    on, since they share sea floors with the scenes.
    """
    laws = {RECORDERS[domain].recorder.samples for domain in out if domain in RECORDERS}
    floors = {(one.task.source, one.task.seed) for one in missions if one.task.domain in out}
    return [
        one
        for one in missions
        if kind_of(one.task) in kinds
        and one.task.domain not in out | judged_only
        and (one.task.source, one.task.seed) not in floors
        and not (one.task.source == DRAWN and one.law in laws)
    ]


def scored(mission: MissionLooks, weights: Weights) -> Scored:
    """Judge a mission's looks by the last step that measurements decide."""
    looks = mission.looks
    log_odds = log_odds_of(weights, looks.steps[LAST_STEP[mission.task.detector]]) if len(looks.weight) else np.empty(0)
    return Scored(mission.task.domain, log_odds, looks.is_target, looks.weight, mission.n_targets, mission.area_km2)


def found_at(missions: Sequence[Scored], limit_per_km2: float) -> float:
    """Count the looks at targets above the lowest log-odds with so many false alarms per km² or fewer."""
    log_odds, is_target, weight = (
        np.concatenate([getattr(one, name) for one in missions]) for name in ("log_odds", "is_target", "weight")
    )
    others = np.flatnonzero(~is_target)
    order = others[np.argsort(-log_odds[others])]
    too_many = np.flatnonzero(np.cumsum(weight[order]) > limit_per_km2 * sum(one.area_km2 for one in missions))
    above = log_odds[order[too_many[0]]] if too_many.size else -np.inf
    return float(weight[is_target & (log_odds > above)].sum())


def pd_at(missions: Sequence[Scored], limit_per_km2: float) -> float:
    """Compute the share of looks at targets that are found with so many false alarms per km², at most 1."""
    return min(found_at(missions, limit_per_km2) / max(sum(one.n_targets for one in missions), 1), 1.0)


def error_of(missions: Sequence[Scored]) -> float | None:
    """Compute the expected calibration error of p_mine over looks; None without any."""
    log_odds, is_target, weight = (
        np.concatenate([getattr(one, name) for one in missions]) for name in ("log_odds", "is_target", "weight")
    )
    if not len(weight):
        return None
    repeated = np.repeat(np.arange(len(weight)), weight.astype(np.intp))
    return calibration_error(1.0 / (1.0 + np.exp(-log_odds[repeated])), is_target[repeated])


def left_out_scores(
    missions: Sequence[MissionLooks],
    judged_only: frozenset[str],
    folds: Sequence[frozenset[str]],
    n_trees: int = N_TREES,
    never: Collection[LookTask] = (),
) -> list[Scored]:
    """Judge every mission of each fold by weights fitted without the fold's domains.

    Folds that nothing is left to fit on are not judged.

    Parameters
    ----------
    judged_only
        Domains that are never fitted on.
    folds
        Domains left out together.
    never
        Missions that are judged and not fitted on.
    """
    found = []
    for out in folds:
        training, scenes = (
            [one for one in fitted_on(missions, kinds, out, judged_only) if one.task not in never]
            for kinds in (FITTED, FITTED[:1])
        )
        usual = [one for one in scenes if is_judged(one)]
        if not all(any(one.looks.is_target.any() for one in some) for some in (training, usual)):
            continue
        weights = fit_step(pooled(training), LAST_STEP[usual[0].task.detector], n_trees, pooled(usual))
        found += [scored(one, weights) for one in missions if is_judged(one) and one.task.domain in out]
    return found


def dealt(missions: Sequence[MissionLooks], n_folds: int) -> list[frozenset[str]]:
    """Deal the domains that are judged into parts in turn, at most one part a domain."""
    domains = tuple(dict.fromkeys(one.task.domain for one in missions if is_judged(one)))
    n_folds = min(n_folds, len(domains))
    return [frozenset(domains[first::n_folds]) for first in range(n_folds)]


def groups_of(missions: Sequence[MissionLooks]) -> dict[str, frozenset[str]]:
    """Return the domains of each row: every one alone, all of a kind, and all."""
    kinds = {one.task.domain: kind_of(one.task) for one in missions if is_judged(one)}
    groups = {domain: frozenset({domain}) for domain in kinds}
    for kind in KINDS:
        if of := frozenset(domain for domain, its in kinds.items() if its == kind):
            groups[f"all {kind}"] = of
    return groups | {"all domains": frozenset(kinds)}


def left_out_rows(scores: Sequence[Scored], groups: Mapping[str, frozenset[str]]) -> tuple[LeftOut, ...]:
    """Count what was found in every group of domains, with Wilson's 95 % intervals."""
    return tuple(
        _left_out_row(name, own) for name, of in groups.items() if (own := [one for one in scores if one.domain in of])
    )


def _left_out_row(name: str, scores: Sequence[Scored]) -> LeftOut:
    n_targets = sum(one.n_targets for one in scores)
    found = []
    for limit in LIMITS_PER_KM2:
        share = proportion(round(pd_at(scores, limit) * n_targets), n_targets)
        value = 0.0 if share.value is None else share.value
        pd, low, high = (round(end, _DIGITS) for end in (value, share.low, share.high))
        found.append(FoundAt(false_alarms_per_km2=limit, pd=pd, low=low, high=high))
    error = error_of(scores)
    return LeftOut(
        domain=name,
        n_looks=n_targets,
        area_km2=round(sum(one.area_km2 for one in scores), _DIGITS),
        found=tuple(found),
        calibration_error=None if error is None else round(error, _DIGITS),
    )


def left_out_table(odds: MineOdds) -> str:
    """Lay out what a model's file says of domains left out."""
    header = ["domain left out", "looks at targets", "km²"]
    header += [f"Pd at {limit:g} FA/km²" for limit in LIMITS_PER_KM2] + ["calibration error"]
    rows = [
        [
            row.domain,
            str(row.n_looks),
            f"{row.area_km2:.3f}",
            *(f"{at.pd:.2f} ({at.low:.2f}-{at.high:.2f})" for at in row.found),
            "-" if row.calibration_error is None else f"{row.calibration_error:.3f}",
        ]
        for row in odds.left_out
    ]
    return columns(header, rows)
