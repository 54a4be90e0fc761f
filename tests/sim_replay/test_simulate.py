"""The simulate and score commands, as a person runs them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from auv_mcm.cli import main
from auv_mcm.errors import UsageError
from auv_mcm.records import NavSample, Ping
from auv_mcm.settings.config import SonarConfig
from sim_replay.logs.xtf import XtfLog
from sim_replay.simulate import simulate
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Fault, Scene
from sim_replay.simulator.scene_file import parse_scene

TEXT = """
name: a short leg
world: {cell_m: 0.1}
sonar: {range_m: 20, n_samples: 200, beam_lines: 1}
track: {plan: {pattern: lawnmower, n_legs: 1, leg_m: 20}, altitude_m: 4}
objects: [{kind: sphere, leg: 0, along_m: 10, across_m: 9}]
"""


@pytest.fixture
def scene() -> Scene:
    return parse_scene(TEXT, "test")


def test_the_log_holds_what_the_mission_emitted(scene: Scene, tmp_path: Path) -> None:
    done = simulate(scene, tmp_path)
    emitted = [event for event in Mission(scene).events() if isinstance(event, Ping)]
    read = list(XtfLog(done.log, SonarConfig()))
    pings = [event for event in read if isinstance(event, Ping)]
    assert len(pings) == done.n_pings == len(emitted)
    for ping, original in zip(pings, emitted, strict=True):
        assert ping.time_s == pytest.approx(original.time_s, abs=0.006)
        assert ping.starboard is not None
        assert original.starboard is not None
        assert np.array_equal(ping.starboard.samples, original.starboard.samples)
    assert any(isinstance(event, NavSample) for event in read)
    facts = json.loads(done.truth.read_text("utf-8"))
    assert [one["kind"] for one in facts["objects"]] == ["sphere"]
    assert done.n_targets == 1


def test_equal_scenes_give_equal_bytes(scene: Scene, tmp_path: Path) -> None:
    first, second = simulate(scene, tmp_path / "a"), simulate(scene, tmp_path / "b", threads=2)
    assert first.log.read_bytes() == second.log.read_bytes()
    assert first.truth.read_bytes() == second.truth.read_bytes()


def test_a_recording_of_the_same_name_is_never_overwritten(scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "mission.xtf").write_bytes(b"recorded")
    with pytest.raises(UsageError, match="never overwritten"):
        simulate(scene, tmp_path)
    assert (tmp_path / "mission.xtf").read_bytes() == b"recorded"


def test_simulate_replay_and_score_follow_one_another(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(TEXT, "utf-8")
    assert main(["simulate", str(path), "--out", str(tmp_path / "sim"), "--seed", "5"]) == 0
    assert "1 objects, 1 of them targets" in capsys.readouterr().out
    assert main(["replay", str(tmp_path / "sim" / "mission.xtf"), "--out", str(tmp_path / "results")]) == 0
    capsys.readouterr()
    files = [str(tmp_path / "results" / "contacts.geojson"), str(tmp_path / "sim" / "truth.json")]
    assert main(["score", *files, "--json", str(tmp_path / "score.json"), "--plot", str(tmp_path / "froc.png")]) == 0
    assert "1 target" in capsys.readouterr().out
    assert json.loads((tmp_path / "score.json").read_text("utf-8"))
    assert (tmp_path / "froc.png").read_bytes().startswith(b"\x89PNG")
    assert main(["score", *files, "--json", str(tmp_path / "nowhere" / "score.json")]) == 2
    assert "--json" in capsys.readouterr().err


def test_a_score_never_overwrites_what_it_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    contacts, truth = tmp_path / "contacts.geojson", tmp_path / "truth.json"
    contacts.write_text('{"type": "FeatureCollection", "features": []}')
    truth.write_text('{"area_km2": 1.0, "objects": []}')
    before = truth.read_bytes()
    (tmp_path / "link.json").symlink_to(truth)
    assert main(["score", str(contacts), str(truth), "--json", str(tmp_path / "link.json")]) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert truth.read_bytes() == before
    with pytest.raises(SystemExit, match="2"):
        main(["score", str(contacts), str(truth), "--plot", str(tmp_path / "nowhere" / "froc.png")])
    assert "there is no folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["simulate"], "SCENE and --out"),
        (["simulate", "nowhere.yaml", "--out", "x"], "no such scene file"),
        (["score", "contacts.geojson"], "pair"),
        (["score", "nowhere.geojson", "truth.json"], "nowhere.geojson"),
    ],
)
def test_mistakes_are_refused_with_a_reason(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) in (2, 3)
    assert message in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_a_bad_scene_file_is_refused_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(TEXT.replace("altitude_m: 4", "altitude_m: 40"), "utf-8")
    assert main(["simulate", str(path), "--out", str(tmp_path / "x")]) == 2
    assert "track.altitude_m" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_a_mission_that_breaks_off_leaves_no_piece_of_a_log(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("sim_replay.simulator.sea.Sea.sound", broken)
    with pytest.raises(KeyboardInterrupt):
        simulate(scene, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_log_never_has_the_truth_of_the_mission_before_beside_it(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise OSError(28, "No space left on device", "truth.json")

    before = simulate(scene, tmp_path).log.read_bytes()
    monkeypatch.setattr("sim_replay.simulate.write_json", broken)
    with pytest.raises(OSError, match="No space left"):
        simulate(replace(scene, seed=2), tmp_path)
    assert (tmp_path / "mission.xtf").read_bytes() != before
    assert not (tmp_path / "truth.json").exists()


def test_a_mission_lasts_as_long_whatever_its_clock_does(scene: Scene, tmp_path: Path) -> None:
    steps = (Fault(kind="clock_step", at_ping=20, step_s=-3600.0), Fault(kind="clock_step", at_ping=40, step_s=60.0))
    sound, stepped = simulate(scene, tmp_path / "a"), simulate(replace(scene, faults=steps), tmp_path / "b")
    assert stepped.duration_s == pytest.approx(sound.duration_s, abs=1e-3)


def test_the_scenes_that_ship_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--list"]) == 0
    assert "flat" in capsys.readouterr().out.split()
