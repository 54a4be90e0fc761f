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
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.targets import MIN_NOT_LISTED, NOT_LISTED
from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.model_file import SHIPPED
from auv_mcm.pipeline import Pipeline
from sim_replay.arguments import count
from sim_replay.benches.mission_options import chosen_scenes, chosen_seeds
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.missions import config_for
from sim_replay.scoring.inputs import ScoredMission, parse_contacts, parse_truth
from sim_replay.scoring.intervals import proportion
from sim_replay.scoring.layout import lay_out
from sim_replay.scoring.score import GATE_M
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import TARGET_KINDS, Scatter, Scene
from sim_replay.simulator.scene_file import read_scene
from sim_replay.text_tables import NOTHING, columns, markdown, share_cell

Floats = NDArray[np.float64]

FIRST_SEED: Final = 92_101  # on seeds from here on nothing was fitted or tried before this bench
SCENES: Final = ("flat", "ripple", "mixed", "rough")
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
_N_RESAMPLES: Final = 2000  # of missions, for the interval of a difference
_HEADER: Final = (
    *("missions", "list", "targets", "km²", "reported"),
    *(f"Pd at {limit:g} FA/km²" for limit in LIMITS_PER_KM2),
    "more at 100 than without a list",
    f"rocks called at Pd {ROCKS_PD:g}",
    "class of called mines right",
)


class Task(NamedTuple):
    """Name a scene and a seed, and the share of mines on no line that the lists state."""

    scene: str
    seed: int
    not_listed: float = NOT_LISTED


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


class FlownWithLists(NamedTuple):
    """Hold one mission as each of LISTS makes it."""

    scene: str
    judged: dict[str, Judged]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench library`."""
    parser.add_argument("--seeds", type=count, default=2, help="missions per scene (default 2)")
    parser.add_argument(
        "--first-seed", type=count, default=FIRST_SEED, help=f"seed of each first mission (default {FIRST_SEED})"
    )
    parser.add_argument(
        "--not-listed",
        type=_share,
        default=NOT_LISTED,
        metavar="SHARE",
        help=f"of mines on no line, as lists state it (default {NOT_LISTED})",
    )
    parser.add_argument("--scenes", default=",".join(SCENES), help=f"by name (default {','.join(SCENES)})")
    parser.add_argument("--workers", type=count, default=2, help="missions flown at once (default 2)")
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")


def run(arguments: argparse.Namespace) -> int:
    """Fly, judge and print; returns the exit code. Raises UsageError for scenes that are not there."""
    names, seeds = chosen_scenes(arguments.scenes), chosen_seeds(arguments)
    tasks = [Task(name, seed, arguments.not_listed) for name in names for seed in seeds]

    def progress(done: int) -> None:
        print(f"\r{done} of {len(tasks)} missions flown", end="", file=sys.stderr, flush=True)

    flown = list(run_tasks(fly, tasks, Farm(arguments.workers), progress))
    print(file=sys.stderr)
    print(report(flown, in_markdown=arguments.markdown))
    return 0


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
    n_targets = sum(group.count for group in groups)
    own = [group for group in groups if group.kind in types]
    laid: list[Scatter] = []
    for number, group in enumerate(own):
        sizes = {_SCENE_SIZE.get(name, name): (size_m, size_m) for name, size_m in types[group.kind].items()}
        bare = msgspec.structs.replace(group, length_m=None, width_m=None, height_m=None)
        n = n_targets // len(own) + (number < n_targets % len(own))
        laid.append(msgspec.structs.replace(bare, count=n, **sizes))
    others = [group for group in scene.scatter if group.kind not in TARGET_KINDS]
    return msgspec.structs.replace(scene, scatter=(*laid, *others))


def fly(task: Task) -> FlownWithLists:
    """Fly one mission with every list."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    scene = with_types(msgspec.structs.replace(read_scene(task.scene), seed=task.seed))
    mission, config = Mission(scene), config_for(scene)
    texts = (
        None,
        list_text(not_listed=task.not_listed),
        list_text(TOO_LARGE, not_listed=task.not_listed),
        list_text(without="truncated_cone", not_listed=task.not_listed),
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
    return FlownWithLists(task.scene, judged)


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


def n_found(missions: Sequence[Judged], limit_per_km2: float) -> int:
    """Count the targets above the lowest threshold of p_mine with so many false alarms per km² or fewer."""
    allowed = math.floor(limit_per_km2 * sum(one.area_km2 for one in missions))
    false_alarms = np.sort(np.concatenate([one.false_alarms for one in missions]))[::-1]
    above = false_alarms[allowed] if allowed < len(false_alarms) else _NONE
    return sum(int(np.count_nonzero(one.targets > above)) for one in missions)


def rocks_called(missions: Sequence[Judged]) -> tuple[int, int] | None:
    """Count the rocks called at the threshold that ROCKS_PD of the targets reach, and all rocks.

    None if fewer targets have a contact.
    """
    targets = np.sort(np.concatenate([one.targets for one in missions]))[::-1]
    rocks = np.concatenate([one.rocks for one in missions])
    threshold = targets[math.ceil(ROCKS_PD * len(targets)) - 1] if len(targets) else _NONE
    return None if threshold == _NONE else (int(np.count_nonzero(rocks >= threshold)), len(rocks))


def gain(
    missions: Sequence[FlownWithLists], name: str, limit_per_km2: float, n_resamples: int = _N_RESAMPLES
) -> tuple[float, float, float]:
    """Compute how much more Pd a list gives than none, with the interval that holds 95 % of resampled missions."""
    random = np.random.Generator(np.random.PCG64(1))
    none, own = ([one.judged[which] for one in missions] for which in (LISTS[0], name))

    def difference(chosen: Sequence[int]) -> float:
        n_targets = sum(len(own[k].targets) for k in chosen)
        found = (n_found([some[k] for k in chosen], limit_per_km2) for some in (none, own))
        without, with_it = found
        return (with_it - without) / n_targets if n_targets else 0.0

    drawn = random.integers(0, len(missions), (n_resamples, len(missions)))
    low, high = np.quantile([difference(row) for row in drawn.tolist()], (0.025, 0.975))
    return difference(range(len(missions))), float(low), float(high)


def report(flown: Sequence[FlownWithLists], *, in_markdown: bool = False) -> str:
    """Lay out every scene, and all together."""
    groups = {name: [one for one in flown if one.scene == name] for name in dict.fromkeys(one.scene for one in flown)}
    if len(groups) > 1:
        groups["all"] = list(flown)
    rows = [_row(title, some, name) for title, some in groups.items() for name in LISTS]
    return (markdown if in_markdown else columns)(_HEADER, rows)


def _row(title: str, flown: Sequence[FlownWithLists], name: str) -> list[str]:
    missions = [one.judged[name] for one in flown]
    n_targets = sum(len(one.targets) for one in missions)
    n_reported = sum(int(np.count_nonzero(one.targets > _NONE)) for one in missions)
    more = NOTHING
    if name != LISTS[0] and len(flown) > 1:
        middle, low, high = gain(flown, name, LIMITS_PER_KM2[-1])
        more = f"{middle:+.2f} ({low:+.2f} to {high:+.2f})"
    rocks = rocks_called(missions)
    return [
        title,
        name,
        str(n_targets),
        f"{sum(one.area_km2 for one in missions):.3f}",
        share_cell(proportion(n_reported, n_targets)),
        *(share_cell(proportion(n_found(missions, limit), n_targets)) for limit in LIMITS_PER_KM2),
        more,
        NOTHING if rocks is None else share_cell(proportion(*rocks)),
        share_cell(proportion(sum(one.n_right for one in missions), sum(one.n_called for one in missions))),
    ]
