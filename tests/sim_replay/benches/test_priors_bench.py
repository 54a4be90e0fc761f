"""Check how a network of the scenes' own is set beside the odds that ship."""

from __future__ import annotations

import numpy as np
import pytest

from auv_mcm.classify.verifier import CLASSES
from auv_mcm.cli import main
from auv_mcm.errors import UsageError
from sim_replay.benches.priors import others_above, table
from sim_replay.fitting.verifier.mill import FLOOR, MINE, OTHER
from sim_replay.fitting.verifier.weigh import Looks


def looks(group: str) -> Looks:
    """Make eight looks on 0.01 km²: four mines, two other objects, two places of sea floor."""
    label = np.array([MINE] * 4 + [OTHER] * 2 + [FLOOR] * 2, dtype=np.int8)
    scores = np.zeros((8, len(CLASSES)))
    return Looks(group, np.zeros(8), scores, label, label, np.ones(8, dtype=np.bool_), 4, 0.01)


def test_other_objects_are_counted_above_the_weakest_of_the_mines_wanted() -> None:
    odds = np.array([4.0, 3.0, 2.0, -1.0, 2.5, -2.0, 9.0, 9.0])
    assert others_above(looks("flat"), odds, 0.5) == 0.5
    assert others_above(looks("flat"), odds, 0.9) == 0.5
    assert others_above(looks("flat"), odds, 1.0) == 0.5
    assert np.isnan(others_above(looks("flat")._replace(label=np.full(8, MINE, dtype=np.int8)), odds, 0.9))


def test_missions_count_alike_in_each_scene_and_in_all() -> None:
    good, bad = np.array([4.0, 4.0, 4.0, 4.0, 1.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 2.0, 2.0])
    text = table({"what ships": [(looks("flat"), bad), (looks("ripple"), good)]})
    flat, ripple, every = text.splitlines()[-3:]
    assert flat.split()[:3] == ["flat", "what", "ships"]
    assert flat.split()[3:5] == ["0.00", "0.00"]
    assert ripple.split()[3:5] == ["1.00", "1.00"]
    assert "0.50 (0.00-1.00)" in every


def test_a_scene_that_is_not_there_is_named(tmp_path: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "priors", "--scenes", "flat,moon", "--looks", str(tmp_path)]) == UsageError.exit_code
    assert "moon" in capsys.readouterr().err


def test_pytorch_is_asked_for_before_anything_is_flown(
    tmp_path: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sim_replay.benches.priors.can_train", lambda: False)
    assert main(["bench", "priors", "--looks", str(tmp_path)]) == UsageError.exit_code
    assert "needs PyTorch" in capsys.readouterr().err
