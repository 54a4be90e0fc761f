"""Fly missions for chips, and keep them beside the looks of the same missions."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.safe_files import open_regular
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.fit_odds import labelled_regions
from sim_replay.fitting.looks import LookTask, MissionLooks, flight_of, place_of
from sim_replay.fitting.verifier.chips import N_COLUMNS, N_PLANES, N_ROWS, chip_of

Chips = NDArray[np.float16]


class MissionChips(NamedTuple):
    """Hold the chips of a mission's looks, in their order: (n, N_PLANES, N_ROWS, N_COLUMNS); is_target: (n,) bool."""

    task: LookTask
    chips: Chips
    is_target: NDArray[np.bool_]


def all_chips(
    missions: Sequence[MissionLooks],
    folder: Path,
    farm: Farm,
    show: Callable[[int, int], None] = lambda done, of: None,
) -> list[Chips]:
    """Take the chips of missions from the folder of their looks, and fly those that are not there.

    Raises BadInputError for chips that are not those of the looks, and as fly_looks does.
    """
    missing = [one.task for one in missions if not _place(folder, one.task).exists()]
    for done, flown in enumerate(run_tasks(fly_chips, missing, farm), 1):
        _write(flown, folder)
        show(done, len(missing))
    return [_read(mission, folder) for mission in missions]


def fly_chips(task: LookTask) -> MissionChips:
    """Fly a mission and cut a chip for every look."""
    with flight_of(task) as flight:
        found = [
            (chip_of(region), label.is_target)
            for _, region, label in labelled_regions(flight.config, flight.events, flight.objects)
        ]
    chips = np.array([chip for chip, _ in found], dtype=np.float16).reshape(-1, N_PLANES, N_ROWS, N_COLUMNS)
    return MissionChips(task, chips, np.array([is_target for _, is_target in found], dtype=np.bool_))


def _place(folder: Path, task: LookTask) -> Path:
    return place_of(folder, task).with_suffix(".chips.npz")


def _write(flown: MissionChips, folder: Path) -> None:
    place = _place(folder, flown.task)
    unfinished = place.with_suffix(".part")
    with unfinished.open("wb") as file:
        np.savez_compressed(file, chips=flown.chips, is_target=flown.is_target)
    os.replace(unfinished, place)


def _read(mission: MissionLooks, folder: Path) -> Chips:
    place = _place(folder, mission.task)
    try:
        with open_regular(place) as file, np.load(file) as stored:
            chips, is_target = np.asarray(stored["chips"], dtype=np.float16), stored["is_target"]
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise BadInputError(f"{place} holds no chips: {error}. Remove it, and it is flown anew") from error
    if not np.array_equal(is_target, mission.looks.is_target):
        raise BadInputError(f"{place} holds the chips of other looks. Remove it, and the mission's looks beside it")
    return chips
