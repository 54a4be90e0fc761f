"""Judge the odds of a mine on domains that nothing was fitted on, and what each group of measurements is worth there.

auv-mcm bench left-out --looks FOLDER                       flies, fits, judges and prints
auv-mcm bench left-out --looks FOLDER --log LINE.xtf        recorded lines with embedded targets as further domains
auv-mcm bench left-out --looks FOLDER --ablate              fits anew without each group of measurements
auv-mcm bench left-out --shipped                            prints what the file of the weights that ship says

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
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.odds import shipped_odds
from auv_mcm.errors import UsageError
from auv_mcm.records import MeasuredStep
from sim_replay.arguments import count
from sim_replay.augment.recorded_line import check_lines
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.fit_odds import STEPS
from sim_replay.fitting.left_out import (
    COMPARED_PER_KM2,
    FIRST_SEED,
    LIMITS_PER_KM2,
    RECIPES,
    Scored,
    dealt,
    difference,
    error_of,
    groups_of,
    is_judged,
    is_of,
    left_out_scores,
    left_out_table,
    left_out_tasks,
    pd_at,
    scored,
)
from sim_replay.fitting.looks import MissionLooks, all_looks
from sim_replay.fitting.recorders import RECORDERS
from sim_replay.missions import SCENES
from sim_replay.scoring.intervals import proportion
from sim_replay.simulator.scene_file import named_scenes
from sim_replay.text_tables import columns, markdown, share_cell

Array = NDArray[np.float64]

SHIPPED: Final = "shipped"
WHOLE: Final = "scenes and drawn"
"""Of RECIPES, the one that groups of measurements are taken from."""
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench left-out`."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--looks", type=Path, metavar="FOLDER", help="folder that keeps what looks measured")
    source.add_argument(
        "--shipped", action="store_true", help="print what the file of the weights that ship says, and fly nothing"
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
    if arguments.shipped:
        odds = shipped_odds("cascade")
        print(f"{odds.fitted_on}\n{odds.made_by}\n\n{left_out_table(odds, in_markdown=arguments.markdown)}")
        return 0
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


def comparison(
    missions: Sequence[MissionLooks],
    judged_only: frozenset[str],
    folds: Sequence[frozenset[str]],
    *,
    in_markdown: bool = False,
) -> str:
    """Lay out a row per domain and recipe, with all domains of a kind pooled, and differences from what ships."""
    weights = shipped_odds("cascade").shape
    by_recipe = {SHIPPED: [scored(one, weights) for out in folds for one in missions if is_of(one, out)]}
    for name, recipe in RECIPES.items():
        by_recipe[name] = left_out_scores(missions, recipe, judged_only, folds)
    header = ["domain", "fitted on", "looks at targets", "km²"]
    header += [f"Pd at {limit:g} FA/km²" for limit in LIMITS_PER_KM2]
    header += ["calibration error", f"Pd at {COMPARED_PER_KM2:g} less that of what ships"]
    rows = [
        _row(group, name, [one for one in some if one.domain in of], by_recipe[SHIPPED])
        for group, of in groups_of(missions).items()
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
    groups = {name: of for name, of in groups_of(missions).items() if name.startswith("all ")}
    header = ["without"]
    for name in groups:
        header += [f"{name}: Pd at {COMPARED_PER_KM2:g} FA/km²", "lost"]
    rows = [_lost_row(title, some, whole, groups) for title, some in variants.items()]
    return (markdown if in_markdown else columns)(header, rows + _shipped_rows(missions, groups))


def _shipped_rows(missions: Sequence[MissionLooks], groups: Mapping[str, frozenset[str]]) -> list[list[str]]:
    """Judge each step of what ships."""
    odds = shipped_odds("cascade")
    of_step = {step: [scored(one, getattr(odds, step), step) for one in missions if is_judged(one)] for step in STEPS}
    steps: dict[str, MeasuredStep] = {"nothing": "shape", _LATER_STEPS: "contours", _ALL_STEPS: "detector"}
    return [_lost_row(f"{SHIPPED}: {name}", of_step[step], of_step["shape"], groups) for name, step in steps.items()]


def _lost_row(
    title: str, some: Sequence[Scored], whole: Sequence[Scored], groups: Mapping[str, frozenset[str]]
) -> list[str]:
    row = [title]
    for of in groups.values():
        own, full = ([one for one in scores if one.domain in of] for scores in (some, whole))
        row.append(f"{pd_at(own, COMPARED_PER_KM2):.3f}" if own else "-")
        row.append("-" if some is whole or not own else _difference_cell(difference(full, own)))
    return row


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


def _show(done: int, of: int) -> None:
    print(f"\r{done} of {of} missions flown", end="" if done < of else "\n", file=sys.stderr, flush=True)
