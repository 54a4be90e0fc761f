"""The network of a theatre: flown over its own scenes, densely, and not trained on too little."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from auv_mcm.classify.chips import N_COLUMNS, N_HEIGHTS, N_PLACE, N_ROWS
from auv_mcm.classify.odds import shipped_odds
from auv_mcm.classify.verifier import CLASSES
from auv_mcm.cli import main
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.looks import LookTask
from sim_replay.fitting.theatre import Theatre
from sim_replay.fitting.verifier import own
from sim_replay.fitting.verifier.train import ChipTable

THEATRE = Theatre(scenes=("flat", "ripple"), lines=(("train", "line"), ("test", "other")))


def chips_with(n_each: int) -> ChipTable:
    label = np.repeat(np.arange(len(CLASSES), dtype=np.int8), n_each)
    metres, heights = (np.zeros((len(label), N_ROWS, n), dtype=np.float16) for n in (N_COLUMNS, N_HEIGHTS))
    return ChipTable(metres, heights, np.zeros((len(label), N_PLACE), dtype=np.float32), label)


@pytest.mark.parametrize(("n_each", "is_written"), [(100, False), (500, True)])
def test_a_network_is_trained_on_own_missions_where_they_show_enough(
    n_each: int, is_written: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flown: list[LookTask] = []
    given: list[Any] = []

    def fly_all(tasks: list[LookTask], folder: Path, *_: object) -> list[Path]:
        flown.extend(tasks)
        assert folder == tmp_path / "looks" / "network"
        return []

    def train(chips: ChipTable, *_: object, start: str) -> str:
        given.append(chips)
        return f"{start}, trained"

    chips = chips_with(n_each)
    monkeypatch.setattr(own, "fly_all", fly_all)
    monkeypatch.setattr(own, "chips_of", lambda places: chips)
    monkeypatch.setattr(own, "train", train)
    monkeypatch.setattr(own, "started_from", lambda onnx: hashlib.sha256(onnx).hexdigest())
    monkeypatch.setattr(own, "written_as_onnx", lambda network: f"{network}, written".encode())
    out = tmp_path / "verifier.onnx"
    own.own_network(THEATRE, out, Farm(1), lambda done, of: None)
    assert len(flown) == 25, "12 of either scene, and the line to train on"
    assert {(task.source, task.times) for task in flown} == {("flat", 5), ("ripple", 5), ("line", 1)}
    assert all(task.theatre == THEATRE for task in flown)
    assert out.exists() == is_written
    if is_written:
        digest = shipped_odds("cascade").verifier.digest  # type: ignore[union-attr]
        assert (given, out.read_text()) == ([chips], f"{digest}, trained, written")
    else:
        assert "500 mines, 100 other objects and 100 places of sea floor are too few" in capsys.readouterr().err


def test_without_pytorch_the_verifier_says_so_before_it_flies_for_hours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.setattr("sim_replay.fitting.verifier.build.fly_all", Mock(side_effect=AssertionError("it flew")))
    assert main(["calibrate", "verifier", "--looks", str(tmp_path / "looks"), "--out", str(tmp_path / "made")]) == 2
    assert "auv-mcm[verifier]" in capsys.readouterr().err
