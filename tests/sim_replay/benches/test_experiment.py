"""An experiment's rows, files and comparison say what its columns say of the missions of each variant."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from auv_mcm.errors import BadInputError, UsageError
from sim_replay.benches import experiment
from sim_replay.benches.experiment import (
    Column,
    Experiment,
    PairedColumn,
    Task,
    experiment_rows,
    moved_figures,
    read_experiment,
    share,
)
from sim_replay.scoring.intervals import proportion

FOUND = {("flat", 5): (3, 4), ("flat", 6): (1, 3), ("ripple", 5): (0, 2), ("ripple", 6): (0, 2)}
"""Targets found of four, without and with what is tried, by scene and seed."""


def fly(task: Task) -> Mapping[str, int]:
    more = int(task.options["more"])
    without, tried = FOUND[task.scene, task.seed]
    return {"without": without, "with": tried + more}


def pd(missions: Sequence[int]) -> float:
    return sum(missions) / (4 * len(missions))


EXPERIMENT = Experiment(
    name="made-up",
    scenes=("flat", "ripple"),
    first_seed=5,
    n_seeds=2,
    n_draws=1,
    variant_title="what",
    variants=("without", "with"),
    fly=fly,
    columns=(
        Column("Pd", lambda missions: share(proportion(sum(missions), 4 * len(missions)))),
        PairedColumn("more", pd),
    ),
    add_options=lambda parser: parser.add_argument("--more", type=int, default=0),  # type: ignore[arg-type]
    own_options=("more",),
)


def run(*words: str) -> int:
    parser = argparse.ArgumentParser()
    EXPERIMENT.add_arguments(parser)
    return EXPERIMENT.run(parser.parse_args(["--workers", "1", *words]))


def test_rows_are_of_each_scene_and_of_all_and_differences_are_paired() -> None:
    tasks = [Task(scene, seed, {"more": 0}) for scene, seed in FOUND]
    rows = experiment_rows(EXPERIMENT, [task.scene for task in tasks], [fly(task) for task in tasks])
    assert [(row.missions, row.variant) for row in rows] == [
        (title, variant) for title in ("flat", "ripple", "all") for variant in ("without", "with")
    ]
    cells = {(row.missions, row.variant): row.cells for row in rows}
    assert cells["flat", "with"]["Pd"].value == 7 / 8
    assert cells["all", "with"]["more"].value == pytest.approx(7 / 16)
    assert cells["flat", "with"]["more"].low == pytest.approx(1 / 4)  # of its two missions, each drawn twice
    assert cells["flat", "with"]["more"].high == pytest.approx(1 / 2)
    assert cells["ripple", "with"]["more"].low == cells["ripple", "with"]["more"].high == 0.5
    assert cells["all", "without"]["more"].text == "-"


def test_a_run_is_written_and_compared_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "old.json"
    assert run("--json", str(file)) == 0
    assert json.loads(file.read_text())["rows"][0]["cells"]["Pd"]["value"] == 0.5
    assert run("--compare", str(file)) == 0
    assert capsys.readouterr().out.endswith("moved:\nnothing\n")
    assert run("--compare", str(file), "--more", "-2") == 0
    said = capsys.readouterr().out.partition("moved:\n")[2]
    assert "flat, with, Pd: 0.88 (0.53-0.98) -> 0.38 (0.14-0.69) (beyond its interval)" in said
    assert "without" not in said


def test_scenes_are_chosen_and_other_missions_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "old.json"
    assert run("--json", str(file), "--scene", "flat", "--markdown") == 0
    assert capsys.readouterr().out.startswith("| missions | what | Pd | more |")
    assert run("--compare", str(file), "--scenes", "flat", "--seeds", "1") == 0
    assert "other missions: scenes or seeds differ" in capsys.readouterr().out
    with pytest.raises(UsageError, match="both choose scenes"):
        run("--scene", "flat", "--scenes", "ripple")
    with pytest.raises(UsageError, match="there is no 'nowhere'"):
        run("--scenes", "nowhere")


def test_a_log_that_cannot_be_read_is_rejected_before_any_mission_is_flown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (empty := tmp_path / "empty.xtf").touch()
    monkeypatch.setattr(experiment, "run_tasks", lambda *_: pytest.fail("a mission is flown"))
    with pytest.raises(BadInputError, match="is empty"):
        run("--log", str(empty))


def test_a_file_of_another_experiment_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "old.json"
    assert run("--json", str(file)) == 0
    with pytest.raises(UsageError, match="is of 'made-up'"):
        read_experiment(file, "library")
    results = read_experiment(file, "made-up")
    assert moved_figures(results, results) == []
