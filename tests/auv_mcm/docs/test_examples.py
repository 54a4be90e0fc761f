"""The examples of the docs run, as their page says, and do what it says."""

from __future__ import annotations

import json
import re
import runpy
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest

from sim_replay.simulate import simulate
from sim_replay.simulator.scene_file import parse_scene
from sim_replay.wire_logs import write_session
from tests.sim_replay.logs.sonar_logs import run_of

ROOT: Final = Path(__file__).parents[3]
PAGE: Final = ROOT / "auv_mcm" / "docs" / "examples.md"
FILES: Final = sorted((ROOT / "auv_mcm" / "docs" / "examples").glob("*.py"))
SCENE: Final = """
seed: 3
world: {depth_m: 14, seabeds: [{type: sand, stones_per_ha: 0}]}
sonar: {range_m: 22, n_samples: 400, ping_rate_hz: 12}
track: {altitude_m: 4, plan: {pattern: lawnmower, n_legs: 1, leg_m: 36}}
objects:
  - {kind: cylinder, leg: 0, along_m: 12, across_m: 11, azimuth_deg: 20, length_m: 2.0, width_m: 0.53}
  - {kind: sphere, leg: 0, along_m: 24, across_m: -12, width_m: 0.8}
"""
"""As small as a mission with two targets can be."""


@pytest.fixture(scope="module")
def missions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make what the page's commands read: a simulated mission and a recording of the service."""
    folder = tmp_path_factory.mktemp("missions")
    simulate(parse_scene(SCENE, "the test's scene"), folder / "sim")
    write_session(run_of("ping_protocol"), folder / "auv-mcm-out" / "latest" / "recording")
    return folder


@pytest.fixture
def run_example(
    missions: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[str], str]:
    """Run the page's command for an example in a folder with its input; return what it prints."""
    shutil.copytree(missions, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)

    def run(name: str) -> str:
        (command,) = re.findall(rf"^python (auv_mcm/docs/examples/{name}\.py .*)$", PAGE.read_text(), re.MULTILINE)
        script, *arguments = shlex.split(command)
        monkeypatch.setattr("sys.argv", [script, *arguments])
        runpy.run_path(str(ROOT / script), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_every_example_is_on_the_page_and_tested_here() -> None:
    names = re.findall(r"\]\(examples/(\w+)\.py\)", PAGE.read_text())
    assert sorted(names) == [path.stem for path in FILES]
    tested = re.findall(r'run_example\("(\w+)"\)', Path(__file__).read_text())
    assert sorted(tested) == sorted(names)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_an_example_says_how_to_run_it(path: Path) -> None:
    assert re.match(rf'"""[A-Z][^\n]*\.\n\n    python {path.name}( [A-Z]+)+\n', path.read_text())


def test_replay_and_plot(run_example: Callable[[str], str]) -> None:
    printed = run_example("replay_and_plot")
    assert re.search(r"^\d+ pings, \d+ contacts, 0\.\d+ km² covered$", printed, re.MULTILINE)
    assert Path("results/map.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads(Path("results/contacts.geojson").read_text())["features"]


def test_own_driver(run_example: Callable[[str], str]) -> None:
    printed = run_example("own_driver")
    found = re.match(r"(\d+) of (\d+) pings decoded; counters: .*'lab_sonar.refused.checksum': (\d+)", printed)
    assert found is not None, printed
    n_decoded, n_pings, n_refused = map(int, found.groups())
    assert n_pings > 200
    assert n_decoded + n_refused == n_pings


def test_test_your_driver(run_example: Callable[[str], str]) -> None:
    printed = run_example("test_your_driver")
    found = re.match(r"(\d+) pings decoded, in any pieces; (\d+) damaged, (\d+) lost; ([1-9]) mine-like$", printed)
    assert found is not None, printed
    assert found[2] == found[3]


def test_own_log_reader(run_example: Callable[[str], str]) -> None:
    printed = run_example("own_log_reader")
    found = re.match(r"mine-like contacts: (\d+) in mission.xtf, (\d+) in the archive$", printed)
    assert found is not None, printed
    assert found[1] == found[2] != "0"


def test_own_training_set(run_example: Callable[[str], str]) -> None:
    printed = run_example("own_training_set")
    assert re.search(r"^train-.*\.npz: [1-9]\d* tiles, [1-9]\d* views of targets", printed, re.MULTILINE)
    assert re.search(r"model\.json: [1-9]\d* stumps; to use it", printed)


def test_read_a_recording(run_example: Callable[[str], str]) -> None:
    printed = run_example("read_a_recording")
    assert re.search(r"^  sonar in: \d+ bytes$", printed, re.MULTILINE)
    found = re.search(r"^(\d+) pings with (\d+) samples, (\d+) navigation samples$", printed, re.MULTILINE)
    assert found is not None, printed
    assert min(map(int, found.groups())) > 100
    assert "rejected by the decoders: nothing" in printed


def test_score_against_truth(run_example: Callable[[str], str]) -> None:
    printed = run_example("score_against_truth")
    assert re.search(r"^2 targets on 0\.\d+ km²$", printed, re.MULTILINE)
    assert re.search(r"^[12] of them are called \(95 % interval of Pd", printed, re.MULTILINE)
    assert Path("scored/froc.png").stat().st_size > 0
    assert json.loads(Path("scored/score.json").read_text())["n_targets"] == 2
