"""Judge the odds of a mine on domains that nothing was fitted on, and what each group of measurements is worth there.

auv-mcm bench left-out --looks FOLDER                       flies, fits, judges and prints
auv-mcm bench left-out --looks FOLDER --log LINE.xtf        recorded lines with embedded targets as further domains
auv-mcm bench left-out --looks FOLDER --ablate              fits anew without each group of measurements

Every named scene, kind of recorder and recorded line is judged by weights that are fitted without it; a kind of
recorder without any drawn mission that stores samples alike. Looks count one by one, taken in full; views of an object
are not joined. A pass that saw a target and left no look at it is a miss. Missions are kept in the folder, so that a
second run only fits. Weights that ship were fitted on the named scenes but seagrass, with other seeds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.odds import Weights, shipped_odds
from auv_mcm.errors import UsageError
from auv_mcm.records import LookStep
from sim_replay.arguments import count
from sim_replay.benches.domains import LIMITS_PER_KM2, RECORDED_SCENES, RECORDERS
from sim_replay.benches.looks import DRAWN, LookTask, MissionLooks, all_looks, pooled
from sim_replay.benches.point import check_lines
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.fit_odds import (
    CROWD,
    CROWD_SEEDS,
    DRAWN_SEEDS,
    N_TREES,
    STEPS,
    LookTable,
    StepTable,
    fit_step,
    log_odds_of,
)
from sim_replay.fitting.fit_odds import FIRST_SEED as FITTED_SEED
from sim_replay.missions import SCENES
from sim_replay.scoring.calibration import calibration_error
from sim_replay.scoring.intervals import proportion
from sim_replay.simulator.scene_file import named_scenes
from sim_replay.text_tables import columns, markdown, share_cell

Array = NDArray[np.float64]

FIRST_SEED: Final = 2000  # weights were fitted on seeds below 1000 and from 10500 on, rates are taken from 9100 on
CROWDED_SEED: Final = FITTED_SEED + CROWD_SEEDS
DRAWN_SEED: Final = FITTED_SEED + DRAWN_SEEDS
SHIPPED: Final = "shipped"
RECIPES: Final[Mapping[str, frozenset[str]]] = {
    "scenes": frozenset({"scenes"}),
    "drawn": frozenset({"drawn"}),
    "lines": frozenset({"lines"}),
    "scenes and drawn": frozenset({"scenes", "drawn"}),
    "all": frozenset({"scenes", "drawn", "lines"}),
}
"""What the weights are fitted on, but for what is judged: missions of named scenes, drawn ones, recorded lines."""
WHOLE: Final = "scenes and drawn"
"""Of RECIPES, the one that groups of measurements are taken from."""
KINDS: Final = ("scenes", "recorders", "recorded lines")
_COMPARED_PER_KM2: Final = 100.0  # false alarms at which differences are given
_DRAWS: Final = 300  # of missions, for the interval of a difference: its ends are then known to a tenth of its width
_DRAW_SEED: Final = 22  # fixed, so that intervals repeat

GROUPS: Final[Mapping[str, tuple[str, ...]]] = {
    "cascade's score": ("cascade_score", "cascade_score_by_range"),
    "score of contrasts": ("contrast",),
    "detector's belief, by Dempster-Shafer": ("detector_odds", "detector_odds_by_range"),
    "levels that the detector measured": (
        "highlight_db",
        "shadow_db",
        "no_highlight",
        "no_shadow",
        "highlight_db_by_range",
    ),
    "sizes that the detector measured": (
        "detected_length_m",
        "detected_width_m",
        "detected_height_m",
        "detected_shadow_m",
        "too_large",
    ),
    "crowding": ("crowded",),
    "range and altitude": ("range", "range_squared", "ground_range_m", "altitude_m", "beam_footprint_m"),
    "contours": (
        "contour_gain",
        "contour_repetition",
        "contour_height_m",
        "contour_shadow",
        "contour_rules_broken",
        "contour_without_highlight",
        "contour_without_shadow",
        "highlight_level",
        "highlight_area",
        "highlight_length_m",
        "shadow_length_m",
        "highlight_front_bend_m",
        "shadow_end_bend_m",
        "shadow_front_roughness_m",
        "contour_highlight_mean",
        "contour_shadow_mean",
        "contour_background_mean",
        "contour_highlight_m2",
        "contour_length_m",
        "contour_gain_nats",
        "contour_repeats",
        "contour_rejected",
    ),
    "labels of the Markov field": ("labelled_highlight", "labelled_highlight_share", "labelled_shadow_share"),
    "solids": (
        "shape_evidence",
        "shape_evidence_of_usual_size",
        "shape_evidence_by_range",
        "shape_plausibility",
        "shape_over_contours",
        "shape_altitude_off",
        "at_bound",
        "cut_off",
        "highlight_deeper_m",
        "burial_m",
        "sphere_nats",
        "cylinder_nats",
        "truncated_cone_nats",
        "wedge_nats",
        "contour_nats",
        "solid_nats",
        "contour_over_solid_nats",
        "solid_highlight_contrast",
        "solid_shadow_contrast",
        "solid_highlight_across_m",
        "observed_highlight_across_m",
        "solid_highlight_samples",
        "solid_along_off_m",
        "solid_across_off_m",
        "second_solid_behind_nats",
    ),
}
"""Measurements by what makes them. Every one that a look has is in one group."""


_LATER_STEPS: Final = "field, second contours and solids"
_ALL_STEPS: Final = "the whole close look"


class Scored(NamedTuple):
    """Hold one mission's looks as they are judged: log-odds, targets, weights, (n,) each."""

    domain: str
    log_odds: Array
    is_target: NDArray[np.bool_]
    weight: Array
    n_targets: int
    area_km2: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench left-out`."""
    parser.add_argument(
        "--looks", type=Path, required=True, metavar="FOLDER", help="folder that keeps what looks measured"
    )
    parser.add_argument("--scenes", help="scenes by name, with commas between (default: the ten)")
    parser.add_argument("--seeds", type=count, default=2, help="missions per scene and recorder (default 2)")
    parser.add_argument("--crowded", type=count, default=2, help="crowded missions per scene (default 2)")
    parser.add_argument("--drawn", type=count, default=60, help="drawn missions (default 60)")
    parser.add_argument("--no-recorders", action="store_true", help="leave out the recorders")
    parser.add_argument(
        "--log", type=Path, action="append", default=[], metavar="FILE", help="a recorded line, XTF; repeatable"
    )
    parser.add_argument(
        "--judge-log",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="a recorded line that is judged and never fitted on; repeatable",
    )
    parser.add_argument("--log-seeds", type=count, default=8, help="draws of targets per recorded line (default 8)")
    parser.add_argument(
        "--folds",
        type=count,
        metavar="N",
        help="parts that the domains are dealt into, each judged by weights fitted without it (default: every domain "
        "is a part)",
    )
    parser.add_argument("--ablate", action="store_true", help="fit without each group of measurements instead")
    parser.add_argument("--workers", type=count, default=2, help="missions flown at once (default 2)")
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")


def run(arguments: argparse.Namespace) -> int:
    """Fly, fit, judge and print; returns the exit code.

    Raises UsageError for unknown scenes, a folder that cannot be made and a line without room for a seed's objects,
    BadInputError for an unreadable log.
    """
    names = SCENES if arguments.scenes is None else tuple(name for name in arguments.scenes.split(",") if name)
    if unknown := [name for name in names if name not in named_scenes()]:
        raise UsageError(f"--scenes: there is no {', '.join(unknown)}. Choose from {', '.join(named_scenes())}")
    logs = [*arguments.log, *arguments.judge_log]
    check_lines(logs, range(FIRST_SEED, FIRST_SEED + arguments.log_seeds))
    tasks = left_out_tasks(
        names,
        n_seeds=arguments.seeds,
        n_crowded=arguments.crowded,
        n_drawn=arguments.drawn,
        recorders=[] if arguments.no_recorders else list(RECORDERS),
        logs=logs,
        n_log_seeds=arguments.log_seeds,
    )
    missions = all_looks(tasks, arguments.looks, Farm(arguments.workers), _show)
    judged_only = frozenset(log.stem for log in arguments.judge_log)
    table = ablation if arguments.ablate else comparison
    folds = dealt(missions, arguments.folds)
    print(table(missions, judged_only, folds, in_markdown=arguments.markdown))
    return 0


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


def scored(mission: MissionLooks, weights: Weights, step: LookStep = "shape") -> Scored:
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
    one: Sequence[Scored], other: Sequence[Scored], limit_per_km2: float = _COMPARED_PER_KM2
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
    step: LookStep = "shape",
) -> list[Scored]:
    """Judge every mission of each fold by weights fitted without the fold's domains.

    without: measurements that are left out as well. Folds that nothing is left to fit on are not judged.
    """
    found = []
    for out in folds:
        training = fitted_on(missions, recipe, out, judged_only)
        usual = [one for one in fitted_on(missions, RECIPES["scenes"], out, judged_only) if is_judged(one)]
        if not any(one.looks.is_target.any() for one in training) or not any(
            one.looks.is_target.any() for one in usual
        ):
            continue
        weights = fit_step(
            _without(pooled(training), step, without), step, n_trees, _without(pooled(usual), step, without)
        )
        found += [scored(one, weights, step) for one in missions if _is_of(one, out)]
    return found


def _is_of(mission: MissionLooks, domains: frozenset[str]) -> bool:
    return is_judged(mission) and mission.task.domain in domains


def dealt(missions: Sequence[MissionLooks], n_folds: int | None) -> list[frozenset[str]]:
    """Deal the domains that are judged into parts in turn; every domain is one if `n_folds` is None."""
    domains = tuple(dict.fromkeys(one.task.domain for one in missions if is_judged(one)))
    n_folds = min(n_folds or len(domains), len(domains))
    return [frozenset(domains[first::n_folds]) for first in range(n_folds)]


def comparison(
    missions: Sequence[MissionLooks],
    judged_only: frozenset[str],
    folds: Sequence[frozenset[str]],
    *,
    in_markdown: bool = False,
) -> str:
    """Lay out a row per domain and recipe, with all domains of a kind pooled, and differences from what ships."""
    weights = shipped_odds("cascade").shape
    by_recipe = {SHIPPED: [scored(one, weights) for out in folds for one in missions if _is_of(one, out)]}
    for name, recipe in RECIPES.items():
        by_recipe[name] = left_out_scores(missions, recipe, judged_only, folds)
    header = ["domain", "fitted on", "looks at targets", "km²"]
    header += [f"Pd at {limit:g} FA/km²" for limit in LIMITS_PER_KM2]
    header += ["calibration error", f"Pd at {_COMPARED_PER_KM2:g} less that of what ships"]
    rows = [
        _row(group, name, [one for one in some if one.domain in of], by_recipe[SHIPPED])
        for group, of in _groups(missions).items()
        for name, some in by_recipe.items()
        if any(one.domain in of for one in some)
    ]
    return (markdown if in_markdown else columns)(header, rows)


def ablation(
    missions: Sequence[MissionLooks],
    judged_only: frozenset[str],
    folds: Sequence[frozenset[str]],
    *,
    in_markdown: bool = False,
) -> str:
    """Lay out what Pd loses on left-out domains without each group of measurements, and with fewer steps.

    Last what ships loses with fewer steps, which was fitted on the scenes, but for other seeds.
    """
    recipe = RECIPES[WHOLE]
    whole = left_out_scores(missions, recipe, judged_only, folds)
    variants: dict[str, list[Scored]] = {"nothing": whole}
    for name, measurements in GROUPS.items():
        variants[name] = left_out_scores(missions, recipe, judged_only, folds, frozenset(measurements))
    variants["trees"] = left_out_scores(missions, recipe, judged_only, folds, n_trees=0)
    variants[_LATER_STEPS] = left_out_scores(missions, recipe, judged_only, folds, step="contours")
    variants[_ALL_STEPS] = left_out_scores(missions, recipe, judged_only, folds, step="detector")
    groups = {name: of for name, of in _groups(missions).items() if name.startswith("all ")}
    header = ["without"]
    for name in groups:
        header += [f"{name}: Pd at {_COMPARED_PER_KM2:g} FA/km²", "lost"]
    rows = [_lost_row(title, some, whole, groups) for title, some in variants.items()]
    return (markdown if in_markdown else columns)(header, rows + _shipped_rows(missions, groups))


def _shipped_rows(missions: Sequence[MissionLooks], groups: Mapping[str, frozenset[str]]) -> list[list[str]]:
    """Judge each step of what ships."""
    odds = shipped_odds("cascade")
    of_step = {step: [scored(one, getattr(odds, step), step) for one in missions if is_judged(one)] for step in STEPS}
    steps: dict[str, LookStep] = {"nothing": "shape", _LATER_STEPS: "contours", _ALL_STEPS: "detector"}
    return [_lost_row(f"{SHIPPED}: {name}", of_step[step], of_step["shape"], groups) for name, step in steps.items()]


def _lost_row(
    title: str, some: Sequence[Scored], whole: Sequence[Scored], groups: Mapping[str, frozenset[str]]
) -> list[str]:
    row = [title]
    for of in groups.values():
        own, full = ([one for one in scores if one.domain in of] for scores in (some, whole))
        row.append(f"{pd_at(own, _COMPARED_PER_KM2):.3f}" if own else "-")
        row.append("-" if some is whole or not own else _difference_cell(difference(full, own)))
    return row


def _groups(missions: Sequence[MissionLooks]) -> dict[str, frozenset[str]]:
    """Return the domains of each row: every one alone, all of a kind, and all."""
    kinds = {one.task.domain: kind_of(one.task) for one in missions if is_judged(one)}
    groups = {domain: frozenset({domain}) for domain in kinds}
    for kind in KINDS:
        if of := frozenset(domain for domain, its in kinds.items() if its == kind):
            groups[f"all {kind}"] = of
    return groups | {"all domains": frozenset(kinds)}


def _row(group: str, name: str, missions: Sequence[Scored], shipped: Sequence[Scored]) -> list[str]:
    n_targets = sum(one.n_targets for one in missions)
    error = error_of(missions)
    domains = {one.domain for one in missions}
    compared = "-"
    if group.startswith("all ") and name != SHIPPED:
        compared = _difference_cell(difference(missions, [one for one in shipped if one.domain in domains]))
    pds = [proportion(round(pd_at(missions, limit) * n_targets), n_targets) for limit in LIMITS_PER_KM2]
    return [
        group,
        name,
        str(n_targets),
        f"{sum(one.area_km2 for one in missions):.3f}",
        *map(share_cell, pds),
        "-" if error is None else f"{error:.3f}",
        compared,
    ]


def _difference_cell(found: tuple[float, float, float]) -> str:
    value, low, high = found
    return f"{value:+.3f} ({low:+.3f} to {high:+.3f})"


def _without(looks: LookTable, step: LookStep, names: frozenset[str]) -> LookTable:
    table: StepTable = looks.steps[step].without(names)
    return looks._replace(steps={**looks.steps, step: table})


def _show(done: int, of: int) -> None:
    print(f"\r{done} of {of} missions flown", end="" if done < of else "\n", file=sys.stderr, flush=True)
