"""Judge weights on domains that they were not fitted on: scenes, kinds of recorders and recorded lines.

Weights are fitted without a domain, and without what is like it, and judged on it. Looks count one by one, taken in
full; views of an object are not joined. A pass that saw a target and left no look at it is a miss.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.odds import FoundAt, LeftOut, MineOdds, Weights
from auv_mcm.records import MeasuredStep
from sim_replay.fitting.fit_odds import (
    CROWD,
    CROWD_SEEDS,
    DRAWN_SEEDS,
    N_TREES,
    LookTable,
    StepTable,
    fit_step,
    log_odds_of,
)
from sim_replay.fitting.fit_odds import FIRST_SEED as FITTED_SEED
from sim_replay.fitting.looks import DRAWN, LookTask, MissionLooks, pooled
from sim_replay.fitting.recorders import RECORDED_SCENES, RECORDERS
from sim_replay.scoring.calibration import calibration_error
from sim_replay.scoring.intervals import proportion
from sim_replay.text_tables import columns, markdown

Array = NDArray[np.float64]

FIRST_SEED: Final = 2000  # weights were fitted on seeds below 1000 and from 10500 on, rates are taken from 9100 on
CROWDED_SEED: Final = FITTED_SEED + CROWD_SEEDS
DRAWN_SEED: Final = FITTED_SEED + DRAWN_SEEDS
LIMITS_PER_KM2: Final = (10.0, 100.0, 300.0)
"""False alarms per km² at which Pd is compared."""
COMPARED_PER_KM2: Final = 100.0
"""False alarms per km² at which differences are given."""
RECIPES: Final[Mapping[str, frozenset[str]]] = {
    "scenes": frozenset({"scenes"}),
    "drawn": frozenset({"drawn"}),
    "lines": frozenset({"lines"}),
    "scenes and drawn": frozenset({"scenes", "drawn"}),
    "all": frozenset({"scenes", "drawn", "lines"}),
}
"""What the weights are fitted on, but for what is judged: missions of named scenes, drawn ones, recorded lines."""
KINDS: Final = ("scenes", "recorders", "recorded lines")
_DRAWS: Final = 300  # of missions, for the interval of a difference: its ends are then known to a tenth of its width
_DIGITS: Final = 4  # decimals in the file of a model
_DRAW_SEED: Final = 22  # fixed, so that intervals repeat


def left_out_tasks(
    scenes: Sequence[str],
    *,
    n_seeds: int,
    n_crowded: int,
    n_drawn: int,
    recorders: Sequence[str],
    logs: Sequence[Path],
    n_log_seeds: int,
) -> list[LookTask]:
    """List the missions, those of one domain one after the other."""
    seeds = range(FIRST_SEED, FIRST_SEED + n_seeds)
    tasks = []
    for name in scenes:
        tasks += [LookTask(name, seed) for seed in seeds]
        tasks += [LookTask(name, seed, CROWD) for seed in range(CROWDED_SEED, CROWDED_SEED + n_crowded)]
    tasks += [LookTask(name, seed, 1, recorder) for recorder in recorders for name in RECORDED_SCENES for seed in seeds]
    tasks += [LookTask(DRAWN, seed) for seed in range(DRAWN_SEED, DRAWN_SEED + n_drawn)]
    log_seeds = range(FIRST_SEED, FIRST_SEED + n_log_seeds)
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
    missions: Sequence[MissionLooks], recipe: frozenset[str], out: frozenset[str], judged_only: frozenset[str]
) -> list[MissionLooks]:
    """Choose the missions that weights are fitted on where the domains `out` are left out.

    Missions over the very sea floor of one that is judged are left out too; other kinds of recorder never are fitted
    on, since they share sea floors with the scenes.
    """
    laws = {RECORDERS[domain].recorder.samples for domain in out if domain in RECORDERS}
    floors = {(one.task.source, one.task.seed) for one in missions if one.task.domain in out}
    parts = {"scenes": "scenes", DRAWN: "drawn", "recorded lines": "lines"}
    return [
        one
        for one in missions
        if parts.get(kind_of(one.task)) in recipe
        and one.task.domain not in out | judged_only
        and (one.task.source, one.task.seed) not in floors
        and not (one.task.source == DRAWN and one.law in laws)
    ]


def scored(mission: MissionLooks, weights: Weights, step: MeasuredStep = "shape") -> Scored:
    """Judge a mission's looks by weights of a step."""
    looks = mission.looks
    log_odds = log_odds_of(weights, looks.steps[step]) if len(looks.weight) else np.empty(0)
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


def difference(
    one: Sequence[Scored], other: Sequence[Scored], limit_per_km2: float = COMPARED_PER_KM2
) -> tuple[float, float, float]:
    """Compare Pd of two weights on the same missions: how much higher the first is, and the 95 % interval.

    Missions are drawn again with replacement (B. Efron, Annals of Statistics 7, 1979).
    """
    random = np.random.Generator(np.random.PCG64(_DRAW_SEED))
    drawn = []
    for _ in range(_DRAWS):
        some = random.integers(len(one), size=len(one)).tolist()
        drawn.append(
            pd_at([one[place] for place in some], limit_per_km2)
            - pd_at([other[place] for place in some], limit_per_km2)
        )
    low, high = np.quantile(drawn, [0.025, 0.975]).tolist()
    return pd_at(one, limit_per_km2) - pd_at(other, limit_per_km2), low, high


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
    recipe: frozenset[str],
    judged_only: frozenset[str],
    folds: Sequence[frozenset[str]],
    without: frozenset[str] = frozenset(),
    n_trees: int = N_TREES["shape"],
    step: MeasuredStep = "shape",
    never: Collection[LookTask] = (),
) -> list[Scored]:
    """Judge every mission of each fold by weights fitted without the fold's domains.

    Folds that nothing is left to fit on are not judged.

    Parameters
    ----------
    recipe
        Of RECIPES.
    judged_only
        Domains that are never fitted on.
    folds
        Domains left out together.
    without
        Measurements that are left out as well.
    never
        Missions that are judged and not fitted on.
    """
    found = []
    for out in folds:
        training = [one for one in fitted_on(missions, recipe, out, judged_only) if one.task not in never]
        scenes = fitted_on(missions, RECIPES["scenes"], out, judged_only)
        usual = [one for one in scenes if is_judged(one) and one.task not in never]
        if not any(one.looks.is_target.any() for one in training) or not any(
            one.looks.is_target.any() for one in usual
        ):
            continue
        looks, usual_looks = (_less(pooled(some), step, without) for some in (training, usual))
        weights = fit_step(looks, step, n_trees, usual_looks)
        found += [scored(one, weights, step) for one in missions if is_of(one, out)]
    return found


def dealt(missions: Sequence[MissionLooks], n_folds: int | None) -> list[frozenset[str]]:
    """Deal the domains that are judged into parts in turn; every domain is one if `n_folds` is None."""
    domains = tuple(dict.fromkeys(one.task.domain for one in missions if is_judged(one)))
    n_folds = min(n_folds or len(domains), len(domains))
    return [frozenset(domains[first::n_folds]) for first in range(n_folds)]


def groups_of(missions: Sequence[MissionLooks]) -> dict[str, frozenset[str]]:
    """Return the domains of each row: every one alone, all of a kind, and all."""
    kinds = {one.task.domain: kind_of(one.task) for one in missions if is_judged(one)}
    groups = {domain: frozenset({domain}) for domain in kinds}
    for kind in KINDS:
        if of := frozenset(domain for domain, its in kinds.items() if its == kind):
            groups[f"all {kind}"] = of
    return groups | {"all domains": frozenset(kinds)}


def is_of(mission: MissionLooks, domains: frozenset[str]) -> bool:
    """Check whether a mission is judged as one of the domains."""
    return is_judged(mission) and mission.task.domain in domains


def _less(looks: LookTable, step: MeasuredStep, names: frozenset[str]) -> LookTable:
    table: StepTable = looks.steps[step].without(names)
    return looks._replace(steps={**looks.steps, step: table})


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


def left_out_table(odds: MineOdds, *, in_markdown: bool = False) -> str:
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
    return (markdown if in_markdown else columns)(header, rows)
