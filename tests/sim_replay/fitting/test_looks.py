"""What is kept of missions that odds are fitted on."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.settings.config import Config
from sim_replay.fitting import looks
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.fit_odds import STEPS, LookTable, StepTable
from sim_replay.fitting.looks import DRAWN, LookTask, MissionLooks, all_looks, fly_looks, read_looks, write_looks
from sim_replay.fitting.recorders import RECORDERS
from sim_replay.flights import Flight

LOG_RECORDER = "log 0.3 dB"
LINE = "somewhere/reef.xtf"
N_LOOKS = 60
NAMES = ("cascade_score", "highlight_db", "range")


def drawn_mission(task: LookTask) -> MissionLooks:
    random = np.random.Generator(np.random.PCG64(task.seed))
    is_target = np.arange(N_LOOKS) % 4 == 0
    steps = {}
    for step in STEPS:
        values = random.normal(0.0, 1.0, (N_LOOKS, len(NAMES)))
        steps[step] = StepTable(NAMES, len(NAMES), values)
    usual = np.full(N_LOOKS, task.times == 1 and task.source != DRAWN)
    table = LookTable(usual, is_target, np.where(is_target, 1.0, 2.0), steps)
    return MissionLooks(task, table)


def same(one: MissionLooks, other: MissionLooks) -> bool:
    assert one.task == other.task
    for step in STEPS:
        assert one.looks.steps[step].names == other.looks.steps[step].names
        assert one.looks.steps[step].n_summed == other.looks.steps[step].n_summed
        assert np.array_equal(one.looks.steps[step].values, other.looks.steps[step].values)
    return all(np.array_equal(a, b) for a, b in zip(one.looks[:3], other.looks[:3], strict=True))


@pytest.mark.parametrize(
    "task", [LookTask("flat", 3, 3), LookTask("flat", 3, 1, LOG_RECORDER), LookTask(DRAWN, 4), LookTask(LINE, 5)]
)
def test_a_mission_comes_back_from_its_file_as_it_was(tmp_path: Path, task: LookTask) -> None:
    mission = drawn_mission(task)
    write_looks(mission, tmp_path)
    assert same(read_looks(task, tmp_path), mission)


def test_missions_in_the_folder_are_not_flown_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tasks = [LookTask("flat", 1), LookTask("flat", 2), LookTask("flat", 1, 1, next(iter(RECORDERS)))]
    flown: list[LookTask] = []

    def fly(task: LookTask) -> MissionLooks:
        flown.append(task)
        return drawn_mission(task)

    monkeypatch.setattr(looks, "fly_looks", fly)
    write_looks(drawn_mission(tasks[1]), tmp_path)
    assert [one.task for one in all_looks(tasks, tmp_path, Farm())] == tasks
    assert flown == [tasks[0], tasks[2]]


def test_a_folder_of_the_name_of_a_scene_changes_no_mission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "flat").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(looks, "flight_of", lambda task: nullcontext(Flight("", Config(), iter(()), dict)))
    monkeypatch.setattr(looks, "examples_along", lambda *_, usual, **how: [usual])
    monkeypatch.setattr(looks, "look_table", list)
    tasks = LookTask("flat", 1), LookTask(LINE, 5), LookTask(str(tmp_path / "flat"), 0), LookTask("flat", 1, 3)
    usual: list[Any] = [fly_looks(task).looks for task in tasks]
    assert usual == [[True], [True], [False], [False]]


def test_a_file_that_holds_no_looks_is_named(tmp_path: Path) -> None:
    task = LookTask("flat", 1)
    write_looks(drawn_mission(task), tmp_path)
    (place,) = tmp_path.iterdir()
    place.write_bytes(place.read_bytes()[:200])
    with pytest.raises(BadInputError, match=r"flat-x1-1\.npz holds no looks"):
        read_looks(task, tmp_path)


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="cannot be made"):
        all_looks([LookTask("flat", 1)], tmp_path / "file" / "looks", Farm())
