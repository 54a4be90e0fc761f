"""Measure what a list of the mines expected is worth, right, wrong, and incomplete: `confirm.targets`.

auv-mcm bench library                               flies, judges and prints

The named scenes are flown with targets of three types alone, and every mission is judged without a list, with the right
one, with one whose sizes are all 20 % too large, and with one that lacks the truncated cone. All see the same pings.
False alarms are all contacts on no target, rocks among them.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.targets import MIN_NOT_LISTED, NOT_LISTED
from auv_mcm.contacts.export import contacts_geojson
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
from sim_replay.missions import config_for
from sim_replay.scoring.inputs import ScoredMission, parse_contacts, parse_truth
from sim_replay.scoring.intervals import Proportion, proportion
from sim_replay.scoring.layout import lay_out
from sim_replay.scoring.score import GATE_M
from sim_replay.scoring.thresholds import called_at, threshold_at
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import TARGET_KINDS, Scatter, Scene
from sim_replay.simulator.scene_file import read_scene
from sim_replay.text_tables import NOTHING

Floats = NDArray[np.float64]

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
_SCENE_SIZE: Final = {"diameter_m": "width_m", "base_diameter_m": "width_m"}  # of a list, as a scene names it
_NONE: Final = -math.inf  # p_mine of what has no contact


class Judged(NamedTuple):
    """Hold what one list makes of one mission.

    targets, rocks: p_mine of the best contact on each that was seen, -inf for none. false_alarms: p_mine of contacts on
    no target. n_called, n_right: targets called by the payload itself, and those of them with the right class.
    """

    targets: Floats
    rocks: Floats
    false_alarms: Floats
    area_km2: float
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
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    scene = with_types(msgspec.structs.replace(read_scene(task.scene), seed=task.seed))
    mission, config = Mission(scene), config_for(scene)
    not_listed = task.options["not_listed"]
    texts = (
        None,
        list_text(not_listed=not_listed),
        list_text(TOO_LARGE, not_listed=not_listed),
        list_text(without="truncated_cone", not_listed=not_listed),
    )
    pipelines: dict[str, Pipeline] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, text in zip(LISTS, texts, strict=True):
            place = SHIPPED
            if text is not None:
                path = Path(folder) / f"{len(pipelines)}.yaml"
                path.write_text(text, "utf-8")
                place = str(path)
            confirm = msgspec.structs.replace(config.confirm, targets=place)
            pipelines[name] = Pipeline(msgspec.structs.replace(config, confirm=confirm))
    for event in mission.events():
        for pipeline in pipelines.values():
            pipeline.feed(event)
    for pipeline in pipelines.values():
        pipeline.finish()
    truth = parse_truth(mission.truth(), task.scene)
    judged = {}
    for name, pipeline in pipelines.items():
        contacts = parse_contacts(json.loads(contacts_geojson(pipeline.contacts)), task.scene)
        judged[name] = judge(ScoredMission(contacts, truth, task.scene))
    return judged


def judge(mission: ScoredMission) -> Judged:
    """Place contacts on objects, on targets before others, and take the best of each."""
    layout = lay_out(mission, GATE_M)
    best = np.full(len(layout.objects), _NONE)
    holder = np.full(len(layout.objects), -1)
    false_alarms = []
    for index, p_mine in enumerate(layout.p_mine.tolist()):
        near = np.flatnonzero(layout.near[index])
        away = np.hypot(*layout.offset_m[index][near].T)
        order = np.lexsort((away, ~layout.is_target[near]))
        on = int(near[order[0]]) if near.size else -1
        if on >= 0 and p_mine > best[on]:
            best[on], holder[on] = p_mine, index
        if on < 0 or not layout.is_target[on]:
            false_alarms.append(p_mine)
    is_rock = np.array([one.kind == "rock" for one in layout.objects], dtype=np.bool_)
    called = [k for k in np.flatnonzero(layout.is_target) if holder[k] >= 0 and layout.contacts[holder[k]].called]
    return Judged(
        targets=best[layout.is_target & layout.is_seen],
        rocks=best[is_rock & layout.is_seen],
        false_alarms=np.array(false_alarms),
        area_km2=mission.truth.area_km2,
        n_called=len(called),
        n_right=sum(layout.contacts[holder[k]].classification == layout.objects[k].kind for k in called),
    )


def n_targets(missions: Sequence[Judged]) -> int:
    """Count the targets that were seen."""
    return sum(len(one.targets) for one in missions)


def found_at(missions: Sequence[Judged], limit_per_km2: float) -> Proportion:
    """Find the share of targets above the lowest threshold of p_mine with so many false alarms per km² or fewer."""
    n_allowed = limit_per_km2 * sum(one.area_km2 for one in missions)
    above = threshold_at(np.concatenate([one.false_alarms for one in missions]), n_allowed)
    return proportion(sum(int(np.count_nonzero(one.targets > above)) for one in missions), n_targets(missions))


def _reported(missions: Sequence[Judged]) -> Cell:
    return share(proportion(sum(int(np.count_nonzero(one.targets > _NONE)) for one in missions), n_targets(missions)))


def _rocks_called(missions: Sequence[Judged]) -> Cell:
    targets, rocks = (np.concatenate([getattr(one, part) for one in missions]) for part in ("targets", "rocks"))
    called = called_at(targets, rocks, ROCKS_PD)
    return Cell(NOTHING) if called is None else share(called)


def _right(missions: Sequence[Judged]) -> Cell:
    return share(proportion(sum(one.n_right for one in missions), sum(one.n_called for one in missions)))


def _pd(missions: Sequence[Judged], limit_per_km2: float) -> Cell:
    return share(found_at(missions, limit_per_km2))


EXPERIMENT: Final = Experiment(
    name="library",
    scenes=("flat", "ripple", "mixed", "rough"),
    first_seed=92_101,  # on seeds from here on nothing was fitted or tried before this bench
    n_seeds=2,
    variant_title="list",
    variants=LISTS,
    fly=fly,
    columns=(
        Column("targets", lambda missions: number(n_targets(missions))),
        Column("km²", lambda missions: number(sum(one.area_km2 for one in missions), 3)),
        Column("reported", _reported),
        *(Column(f"Pd at {limit:g} FA/km²", partial(_pd, limit_per_km2=limit)) for limit in LIMITS_PER_KM2),
        PairedColumn(
            "more at 100 than without a list", lambda missions: found_at(missions, LIMITS_PER_KM2[-1]).value or 0.0
        ),
        Column(f"rocks called at Pd {ROCKS_PD:g}", _rocks_called),
        Column("class of called mines right", _right),
    ),
    add_options=add_options,
    own_options=("not_listed",),
)
add_arguments = partial(add_experiment_arguments, EXPERIMENT)
run = partial(run_experiment, EXPERIMENT)
