"""Recorded lines drawn beside what their floor is taken for."""

from __future__ import annotations

from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from auv_mcm.clearance.clearance_picture import KIND_COLOURS
from auv_mcm.cli import main
from sim_replay.fitting.seabed.seabed_missions import mission_scene
from sim_replay.simulate import simulate
from sim_replay.simulator.scene import Lawnmower, Seabed


@pytest.fixture(scope="module")
def sandy_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sand alone, seen for half a minute."""
    scene = mission_scene(11)
    world = msgspec.structs.replace(scene.world, seabeds=(Seabed(type="sand"),))
    track = msgspec.structs.replace(scene.track, plan=Lawnmower(n_legs=1, leg_m=45.0, spacing_m=50.0))
    sonar = msgspec.structs.replace(scene.sonar, range_m=25.0, n_samples=500, ping_rate_hz=8.0)
    plain = msgspec.structs.replace(scene, world=world, track=track, sonar=sonar, scatter=())
    return simulate(plain, tmp_path_factory.mktemp("sandy") / "log").log


def test_sand_is_drawn_twice_the_second_time_in_the_colour_of_a_flat_floor(sandy_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "floor.png"
    assert main(["bench", "seabed", "--picture", str(out), "--log", str(sandy_log), "--tiles", "1"]) == 0
    picture = np.asarray(cv2.imread(str(out)), dtype=np.float64)
    n_rows, n_columns = picture.shape[0] - 30, (picture.shape[1] - 32) // 2  # but for the legend and the gaps
    plain, tinted = picture[:n_rows, :n_columns], picture[:n_rows, n_columns + 8 : 2 * n_columns + 8]
    assert np.ptp(plain, axis=2).max() == 0.0, "grey"
    middle = (slice(n_rows // 4, 3 * n_rows // 4), slice(n_columns // 4, 3 * n_columns // 4))
    blue, _, red = tinted[middle].reshape(-1, 3).mean(axis=0)
    flat_blue, _, flat_red = KIND_COLOURS["flat"]
    assert red - blue == pytest.approx(
        0.5 * (flat_red - flat_blue) * (0.4 + 0.6 * plain[middle].mean() / 255.0), abs=4.0
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--picture", "floor.png"], "--picture draws what --log names: give both, or neither to score"),
        (["--log", "line.xtf"], "--picture draws what --log names: give both, or neither to score"),
        (["--picture", "floor.gif", "--log", "line.xtf"], "name a file that ends in .png or .jpg"),
        (["--picture", "floor.png", "--log", "line.xtf"], "line.xtf"),
    ],
)
def test_what_cannot_be_drawn_is_reported(
    options: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["bench", "seabed", *options]) != 0
    err = capsys.readouterr().err
    assert words in err
    assert "Traceback" not in err
