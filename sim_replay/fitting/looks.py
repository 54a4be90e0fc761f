"""Fly missions of many domains and keep what was measured of every detection, to fit and judge odds many times.

A mission is a file in a folder. Missions already there are not flown again.
"""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import Detector
from auv_mcm.safe_files import open_regular
from sim_replay.augment.augment_log import TRUTH_NAME
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.cascade.spec import on_grid
from sim_replay.fitting.cascade.training_images import augmented_truth
from sim_replay.fitting.fit_odds import STEPS, LookTable, StepTable, crowded, drawn_scene, examples_along, look_table
from sim_replay.fitting.recorders import RECORDERS, recorded_by
from sim_replay.fitting.theatre import USUAL, Theatre
from sim_replay.flights import Flight, flight_along, flight_through, flight_with_targets
from sim_replay.missions import served_by
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.scene_file import named_scenes, read_scene

DRAWN: Final = "drawn"
"""Source of missions of the wide world."""


class LookTask(NamedTuple):
    """Name a mission.

    source: a named scene, DRAWN, or the path of a recorded line. times: as many mines and rocks as the scene has.
    recorder: of RECORDERS, for named scenes alone. detector: whose detections are looked at. theatre: what is flown.
    A folder of `auv-mcm augment` is a recorded line too, with the targets that it has.
    """

    source: str
    seed: int
    times: int = 1
    recorder: str | None = None
    detector: Detector = "cascade"
    theatre: Theatre = USUAL

    @property
    def is_line(self) -> bool:
        """Check whether it is a recorded line."""
        return self.source not in (DRAWN, *named_scenes(), *self.theatre.scenes)

    @property
    def domain(self) -> str:
        """Return the name under which the mission is judged."""
        return self.recorder or (self.source if self.source in (DRAWN, *named_scenes()) else Path(self.source).stem)


class MissionLooks(NamedTuple):
    """Hold the looks of one mission."""

    task: LookTask
    looks: LookTable


def all_looks(
    tasks: Sequence[LookTask], folder: Path, farm: Farm, show: Callable[[int, int], None] = lambda done, of: None
) -> list[MissionLooks]:
    """Take the missions from the folder, and fly those that are not there.

    Raises UsageError for a folder that cannot be made, BadInputError for files in it that cannot be read, and as
    augment does for recorded lines.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder} cannot be made: {error.strerror}") from error
    missing = [task for task in tasks if not place_of(folder, task).exists()]
    for done, mission in enumerate(run_tasks(fly_looks, missing, farm), 1):
        write_looks(mission, folder)
        show(done, len(missing))
    return [read_looks(task, folder) for task in tasks]


def fly_looks(task: LookTask) -> MissionLooks:
    """Fly a mission and take every look as far as measurements decide.

    Raises BadInputError or UsageError for a recorded line, as augment does.
    """
    with flight_of(task) as flight:
        is_augmented = task.is_line and Path(task.source).is_dir()
        usual = task.times == 1 and task.source != DRAWN and not is_augmented
        examples = examples_along(flight.config, flight.events, flight.objects, usual=usual, detector=task.detector)
    return MissionLooks(task, look_table(examples))


@contextmanager
def flight_of(task: LookTask) -> Iterator[Flight]:
    """Prepare a mission. Raises BadInputError or UsageError for a recorded line, as augment does."""
    theatre, place = task.theatre, Path(task.source)
    found: AbstractContextManager[Flight]
    config = on_grid(theatre.config, theatre.sonars[0])
    if task.is_line and place.is_dir():
        log, _ = augmented_truth(place / TRUTH_NAME)
        found = nullcontext(flight_with_targets(place / log, place / TRUTH_NAME, config))
    elif task.is_line:
        found = flight_along(place, task.seed, config)
    else:
        found = nullcontext(flight_through(*theatre.carried(_scene_of(task), task.seed)))
    with found as flight:
        yield flight._replace(config=served_by(task.detector, flight.config))


def write_looks(mission: MissionLooks, folder: Path) -> None:
    """Write a mission into the folder, whole or not at all."""
    place = place_of(folder, mission.task)
    arrays: dict[str, Any] = {name: getattr(mission.looks, name) for name in _ROWS}
    for step, table in mission.looks.steps.items():
        arrays |= {f"{step}_names": np.array(table.names), f"{step}_values": table.values}
    n_summed = [mission.looks.steps[step].n_summed for step in STEPS]
    unfinished = place.with_suffix(".part")
    with unfinished.open("wb") as file:
        np.savez_compressed(file, n_summed=n_summed, **arrays)
    os.replace(unfinished, place)


def read_looks(task: LookTask, folder: Path) -> MissionLooks:
    """Read a mission from the folder. Raises BadInputError for a file that is not one of write_looks."""
    place = place_of(folder, task)
    try:
        with open_regular(place) as file, np.load(file) as stored:
            steps = {
                step: StepTable(tuple(stored[f"{step}_names"].tolist()), int(n), stored[f"{step}_values"])
                for step, n in zip(STEPS, stored["n_summed"], strict=True)
            }
            usual, is_target, weight = (stored[name] for name in _ROWS)
            return MissionLooks(task, LookTable(usual, is_target, weight, steps))
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise BadInputError(f"{place} holds no looks: {error}. Remove it, and it is flown anew") from error


_ROWS: Final = ("usual", "is_target", "weight")


def pooled(missions: Sequence[MissionLooks]) -> LookTable:
    """Join the looks of missions, of which at least one has any."""
    some = [mission.looks for mission in missions if len(mission.looks.weight)]
    usual, is_target, weight = (np.concatenate([getattr(one, name) for one in some]) for name in _ROWS)
    steps = {}
    for step in STEPS:
        first = some[0].steps[step]
        steps[step] = first._replace(values=np.concatenate([one.steps[step].values for one in some]))
    return LookTable(usual, is_target, weight, steps)


def place_of(folder: Path, task: LookTask) -> Path:
    """Name the file of a mission in a folder."""
    parts = [task.domain, *([task.source] if task.recorder else []), f"x{task.times}", str(task.seed)]
    if task.detector != "cascade":
        parts.append(task.detector)
    if task.theatre != USUAL:
        flown_with = repr((task.theatre, task.theatre.digest(), task.source))
        parts.append(f"{zlib.crc32(flown_with.encode()):08x}")
    return folder / ("-".join(parts).replace(" ", "_") + ".npz")


def _scene_of(task: LookTask) -> Scene:
    if task.source == DRAWN:
        return drawn_scene(task.seed)
    scene = crowded(msgspec.structs.replace(read_scene(task.source), seed=task.seed), task.times)
    return scene if task.recorder is None else recorded_by(scene, RECORDERS[task.recorder])
