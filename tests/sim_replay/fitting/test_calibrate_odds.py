"""`auv-mcm calibrate odds` over made-up missions: what is flown, what is written, and what is refused."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, get_args
from unittest.mock import Mock

import msgspec
import numpy as np
import pytest

from auv_mcm.classify.odds import MineOdds, parse_odds, shipped_odds
from auv_mcm.cli import main
from auv_mcm.records import Detector
from sim_replay.fitting import calibrate_odds, looks
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.fit_odds import CROWD, FIRST_SEED, STEPS, LookTable, StepTable
from sim_replay.fitting.looks import DRAWN, LookTask, MissionLooks
from sim_replay.missions import HELD_OUT, SCENES

N_LOOKS = 80
SLOPE, OFFSET = 2.0, -1.5  # of the logistic model that the looks follow


class Flown:
    """Stands in for flying: looks of a logistic model, other ones for every mission."""

    def __init__(self) -> None:
        self.missions: list[LookTask] = []
        self.has_targets = True

    def __call__(self, task: LookTask) -> MissionLooks:
        self.missions.append(task)
        random = np.random.Generator(np.random.PCG64([task.seed, *map(ord, repr(task))]))
        values = random.normal(0.0, 1.0, (N_LOOKS, 2))
        is_target = random.random(N_LOOKS) < 1.0 / (1.0 + np.exp(-(OFFSET + SLOPE * values[:, 0])))
        is_target &= self.has_targets
        usual = np.full(N_LOOKS, task.times == 1 and task.source != DRAWN)
        steps = dict.fromkeys(STEPS, StepTable(("a", "b"), 2, values))
        table = LookTable(usual, is_target, np.ones(N_LOOKS), steps)
        return MissionLooks(task, table)


@pytest.fixture
def flown(monkeypatch: pytest.MonkeyPatch) -> Flown:
    stand_in = Flown()
    monkeypatch.setattr(looks, "fly_looks", stand_in)
    monkeypatch.setattr(looks, "run_tasks", lambda fly, tasks, farm: map(fly, tasks))
    monkeypatch.setattr(calibrate_odds, "N_TREES", 2)
    verifier = shipped_odds("cascade").verifier
    monkeypatch.setattr(
        calibrate_odds, "beside_network", lambda odds, *_: msgspec.structs.replace(odds, verifier=verifier)
    )
    return stand_in


def fitted(out: Path, *options: str) -> MineOdds:
    assert main(["calibrate", "odds", *options, "--out", str(out)]) == 0
    return parse_odds(out.read_bytes(), out.name)


@pytest.mark.parametrize(
    ("detector", "scenes"), [("contrast", SCENES), ("cascade", tuple(name for name in SCENES if name not in HELD_OUT))]
)
def test_every_scene_is_flown_with_every_seed_and_weights_are_written(
    flown: Flown, tmp_path: Path, detector: Detector, scenes: tuple[str, ...]
) -> None:
    odds = fitted(tmp_path / "odds.json", "--detector", detector, "--seeds", "2", "--first-seed", "7")
    assert flown.missions == [LookTask(name, seed, detector=detector) for seed in (7, 8) for name in scenes]
    n = 2 * N_LOOKS * len(scenes)
    assert odds.fitted_on == f"{n} detections of simulated missions: {', '.join(scenes)}; seeds 7 to 8"
    if detector == "contrast":
        assert odds.shape is not None
        assert odds.shape.weights["a"] == pytest.approx(SLOPE, abs=0.4)
    else:
        assert (odds.contours, odds.shape) == (None, None)
        assert odds.verifier is not None
    assert len(odds.detector.trees) == (2 if detector == "cascade" else 0)


def test_crowded_and_drawn_missions_are_flown_over_other_floors_and_teach_no_rarity(
    flown: Flown, tmp_path: Path
) -> None:
    plain = fitted(tmp_path / "plain.json", "--seeds", "1", "--first-seed", "7")
    n = len(flown.missions)
    odds = fitted(tmp_path / "odds.json", *(["--seeds", "1", "--crowded", "2", "--drawn", "3", "--first-seed", "7"]))
    more = flown.missions[2 * n :]
    assert {(task.seed, task.times) for task in more[: 2 * n]} == {(57, CROWD), (58, CROWD)}
    assert more[2 * n :] == [LookTask(DRAWN, seed) for seed in (10007, 10008, 10009)]
    assert odds.fitted_on.endswith(
        "seeds 7 to 7, and 57 to 58 with 3 times as many mines and rocks; 3 drawn from the wide world"
    )
    assert odds.prior == plain.prior


def test_what_is_written_names_the_command_that_makes_it_again(flown: Flown, tmp_path: Path) -> None:
    looks = ("--looks", str(tmp_path / "looks"))
    odds = fitted(tmp_path / "odds.json", "--seeds", "1", "--drawn", "2", *looks)
    n = len(flown.missions)
    command = odds.made_by.partition(", ")[2].split()
    assert command[:3] == ["auv-mcm", "calibrate", "odds"]
    assert fitted(tmp_path / "kept.json", *command[3:], *looks) == odds
    assert len(flown.missions) == n, "the folder holds them"
    assert fitted(tmp_path / "again.json", *command[3:]) == odds


@pytest.mark.parametrize(("seeds", "known"), [((1, 2, 3), [{2, 3}, {1, 3}, {1, 2}]), ((1,), [None])])
def test_a_network_is_weighed_beside_odds_that_never_saw_the_mission(
    seeds: tuple[int, ...], known: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    odds = shipped_odds("cascade")
    monkeypatch.setattr(calibrate_odds, "fitted_odds", lambda _, flown: {one.task.seed for one in flown})
    monkeypatch.setattr(calibrate_odds, "fly_all", lambda tasks, *_: tasks)
    monkeypatch.setattr(calibrate_odds, "looks_of", lambda *asked: None if asked[-1] is odds else asked[-1])
    monkeypatch.setattr(calibrate_odds, "weighed", weigh := Mock(return_value=odds.verifier))
    flown = list(map(Flown(), [LookTask("flat", seed) for seed in seeds]))
    calibrate_odds.beside_network(odds, calibrate_odds.Missions(), flown, tmp_path, Farm(), lambda done, of: None)
    assert weigh.call_args.args[0] == known


@pytest.mark.parametrize(
    ("arguments", "printed"),
    [
        ([], "--out"),
        (["--out"], "--out"),
        (["--out", "x", "--seeds", "0"], "'0' is not a whole number from 1 to "),
        (["--out", "x", "--seeds", "many"], "--seeds"),
        (["--out", "x", "--workers", "-1"], "--workers"),
        (["--out", "x", "--first-seed", "9" * 30], "from 1 to 1000000"),
        (["--out", "x", "--first-seed", "1.5"], "'1.5' is not a whole number"),
        (["--out", "x", "--scenes", "flat"], "--scenes"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(
    flown: Flown, capsys: pytest.CaptureFixture[str], arguments: list[str], printed: str
) -> None:
    with pytest.raises(SystemExit) as refused:
        main(["calibrate", "odds", *arguments])
    assert refused.value.code == 2
    assert printed in capsys.readouterr().err
    assert flown.missions == []


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("missing/odds.json", r"auv-mcm: --out .*: there is no folder .*missing\. Make it first"),
        (".", r"auv-mcm: --out .* exists and is not overwritten"),
        ("/proc/odds.json", "auv-mcm: cannot write to the output directory /proc"),
    ],
)
def test_weights_that_could_not_be_written_are_refused_before_flying(
    flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str, message: str
) -> None:
    assert main(["calibrate", "odds", "--seeds", "1", "--out", str(tmp_path / place)]) == 2
    assert re.match(message, capsys.readouterr().err)
    assert flown.missions == []


def test_the_help_names_the_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["calibrate", "odds", "--help"])
    printed = " ".join(capsys.readouterr().out.split())
    assert f"(default {FIRST_SEED})" in printed
    assert f"with {CROWD} times as many mines and rocks" in printed
    assert f"{{{','.join(get_args(Detector))}}}" in printed


def test_too_few_targets_end_the_command_with_advice(
    flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flown.has_targets = False
    assert main(["calibrate", "odds", "--seeds", "1", "--out", str(tmp_path / "odds.json")]) == 2
    assert "0 targets in 720 detections" in capsys.readouterr().err
    assert not (tmp_path / "odds.json").exists()
