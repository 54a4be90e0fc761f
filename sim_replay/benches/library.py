"""Measure what a list of the mines expected is worth, right, wrong, and incomplete: `confirm.targets`.

auv-mcm bench library                               flies, judges and prints

The named scenes are flown with targets of three types alone, and every mission is judged without a list, with the right
one, with one whose sizes are all 20 % too large, and with one that lacks the truncated cone. All see the same pings.
False alarms are all contacts on no target, rocks among them.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm.classify.targets import MIN_NOT_LISTED, NOT_LISTED
from auv_mcm.model_file import SHIPPED
from auv_mcm.pipeline import Pipeline
from sim_replay.benches.experiment import (
    Cell,
    Column,
    Experiment,
    PairedColumn,
    Task,
    add_experiment_arguments,
    number,
    run_experiment,
    share,
)
from sim_replay.benches.mission_source import fly_through, mission_source
from sim_replay.scoring.inputs import ScoredMission, as_reported
from sim_replay.scoring.intervals import proportion
from sim_replay.scoring.layout import lay_out
from sim_replay.scoring.score import GATE_M
from sim_replay.scoring.thresholds import BestScores, best_scores, found_at, objects_under, rocks_called_at
from sim_replay.simulator.scene import TARGET_KINDS, Scatter, Scene
from sim_replay.text_tables import NOTHING

LIMITS_PER_KM2: Final = (10.0, 30.0, 100.0)  # false alarms per km² at which Pd is printed
ROCKS_PD: Final = 0.9  # Pd at which the share of rocks that are called is printed
TOO_LARGE: Final = 1.2  # factor of all sizes of the wrong list
TYPES: Final = {
    "cylinder": {"length_m": 1.6, "diameter_m": 0.45},
    "sphere": {"diameter_m": 0.9},
    "truncated_cone": {"base_diameter_m": 0.98, "height_m": 0.47},
}
"""The types of mines that are laid, of sizes within those that odds were fitted on."""
LISTS: Final = ("no list", "right", "sizes 20 % too large", "without the cone")
_ANY_PER_KM2: Final = 1e12  # more than any mission has contacts
_SCENE_SIZE: Final = {"diameter_m": "width_m", "base_diameter_m": "width_m"}  # of a list, as a scene names it


class Judged(NamedTuple):
    """Hold what one list makes of one mission.

    n_called, n_right: targets called by the payload itself, and those of them with the right class.
    """

    best: BestScores
    n_called: int
    n_right: int


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the lists state of mines on no line."""
    parser.add_argument(
        "--not-listed",
        type=_share,
        default=NOT_LISTED,
        metavar="SHARE",
        help=f"of mines on no line, as lists state it (default {NOT_LISTED})",
    )


def _share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not MIN_NOT_LISTED <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a share from {MIN_NOT_LISTED} to 1")
    return value


def list_text(factor: float = 1.0, without: str = "", not_listed: float = NOT_LISTED) -> str:
    """Write the list of TYPES as YAML, with all sizes times a factor, and without one kind."""
    mines = [
        {"kind": kind} | {name: round(factor * size_m, 3) for name, size_m in sizes.items()}
        for kind, sizes in TYPES.items()
        if kind != without
    ]
    return json.dumps({"not_listed": not_listed, "mines": mines})  # JSON is YAML


def with_types(scene: Scene, types: Mapping[str, Mapping[str, float]] = TYPES) -> Scene:
    """Lay targets of these types alone, as many as the scene has, each as its kind lies there.

    types: sizes by kind, m, each named as a list or as a scene names it.
    """
    groups = [group for group in scene.scatter if group.kind in TARGET_KINDS]
    n_laid = sum(group.count for group in groups)
    own = [group for group in groups if group.kind in types]
    laid: list[Scatter] = []
    for place, group in enumerate(own):
        sizes = {_SCENE_SIZE.get(name, name): (size_m, size_m) for name, size_m in types[group.kind].items()}
        bare = msgspec.structs.replace(group, length_m=None, width_m=None, height_m=None)
        n = n_laid // len(own) + (place < n_laid % len(own))
        laid.append(msgspec.structs.replace(bare, count=n, **sizes))
    others = [group for group in scene.scatter if group.kind not in TARGET_KINDS]
    return msgspec.structs.replace(scene, scatter=(*laid, *others))


def fly(task: Task) -> dict[str, Judged]:
    """Fly one mission with every list."""
    not_listed = task.options["not_listed"]
    texts = (
        None,
        list_text(not_listed=not_listed),
        list_text(TOO_LARGE, not_listed=not_listed),
        list_text(without="truncated_cone", not_listed=not_listed),
    )
    pipelines: dict[str, Pipeline] = {}
    with mission_source(task, with_types) as source, tempfile.TemporaryDirectory() as folder:
        for name, text in zip(LISTS, texts, strict=True):
            place = SHIPPED
            if text is not None:
                path = Path(folder) / f"{len(pipelines)}.yaml"
                path.write_text(text, "utf-8")
                place = str(path)
            confirm = msgspec.structs.replace(source.config.confirm, targets=place)
            pipelines[name] = Pipeline(msgspec.structs.replace(source.config, confirm=confirm))
        fly_through(source.events, pipelines)
        truth = source.truth()
    return {
        name: judge(ScoredMission(as_reported(pipeline.contacts, task.scene), truth, task.scene))
        for name, pipeline in pipelines.items()
    }


def judge(mission: ScoredMission) -> Judged:
    """Take the best contact of each object, and count the targets that it calls, and calls by their kind."""
    layout = lay_out(mission, GATE_M)
    on, called = objects_under(layout), []
    for k in np.flatnonzero(layout.is_target):
        held = np.flatnonzero(on == k)
        best = layout.contacts[held[np.argmax(layout.p_mine[held])]] if held.size else None
        if best is not None and best.called:
            called.append(best.classification == layout.objects[k].kind)
    return Judged(best_scores(mission), len(called), sum(called))


def _best(missions: Sequence[Judged]) -> list[BestScores]:
    return [one.best for one in missions]


def _reported(missions: Sequence[Judged]) -> Cell:
    return share(found_at(_best(missions), _ANY_PER_KM2))


def _rocks_called(missions: Sequence[Judged]) -> Cell:
    called = rocks_called_at(_best(missions), ROCKS_PD)
    return Cell(NOTHING) if called is None else share(called)


def _right(missions: Sequence[Judged]) -> Cell:
    return share(proportion(sum(one.n_right for one in missions), sum(one.n_called for one in missions)))


def _pd(missions: Sequence[Judged], limit_per_km2: float) -> Cell:
    return share(found_at(_best(missions), limit_per_km2))


EXPERIMENT: Final = Experiment(
    name="library",
    scenes=("flat", "ripple", "mixed", "rough"),
    first_seed=92_101,  # on seeds from here on nothing was fitted or tried before this bench
    n_seeds=2,
    variant_title="list",
    variants=LISTS,
    fly=fly,
    columns=(
        Column("targets", lambda missions: number(found_at(_best(missions), 0.0).of)),
        Column("km²", lambda missions: number(sum(one.best.area_km2 for one in missions), 3)),
        Column("reported", _reported),
        *(Column(f"Pd at {limit:g} FA/km²", partial(_pd, limit_per_km2=limit)) for limit in LIMITS_PER_KM2),
        PairedColumn(
            "more at 100 than without a list",
            lambda missions: found_at(_best(missions), LIMITS_PER_KM2[-1]).value or 0.0,
        ),
        Column(f"rocks called at Pd {ROCKS_PD:g}", _rocks_called),
        Column("class of called mines right", _right),
    ),
    add_options=add_options,
    own_options=("not_listed",),
)
add_arguments = partial(add_experiment_arguments, EXPERIMENT)
run = partial(run_experiment, EXPERIMENT)
