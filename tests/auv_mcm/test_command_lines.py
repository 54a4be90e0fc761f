"""Every command line in the README, the docs, the scripts and `--help` does what it says.

Lines that are cheap run as they stand, in a folder that holds what they read. Those that need minutes or hours run up
to the first step of their work, which a stand-in then ends with `Reached`: the line was understood, and what it names
was found.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import json
import os
import re
import shlex
import shutil
import sys
import time
import tomllib
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import pytest

from auv_mcm.cli import _parser, main
from auv_mcm.clock import Stamp
from auv_mcm.settings.budget_settings import BudgetConfig
from auv_mcm.settings.config import config_yaml, parse_config
from auv_mcm.shell.health.record import Health
from drivers.recording.start_recording import start_recording
from sim_replay.commands.bench import BENCHES
from sim_replay.fitting.measure_prices import PriceList
from sim_replay.simulate import simulate
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene_file import parse_scene
from sim_replay.verdicts import Verdict, append_verdict
from sim_replay.wire_logs import played, write_jsf
from tests.manual_clock import ManualClock
from tests.sim_replay.logs.image_writer import write_images
from tests.sim_replay.logs.sonar_logs import mission, run_of

ROOT = Path(__file__).parents[2]
PAGES = [
    *(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY")),
    *sorted((ROOT / "auv_mcm" / "docs").rglob("*.md")),
]
SCRIPTS = sorted((ROOT / "deploy").glob("*.sh"))
PROGRAMS = ("auv-mcm ", "python -m ", "sh deploy/")

SCENE = """
world: {depth_m: 12, seabeds: [{type: sand}]}
sonar: {frequency_khz: 450, range_m: 25, n_samples: 400, ping_rate_hz: 10}
track: {altitude_m: 5, plan: {pattern: lawnmower, n_legs: 1, leg_m: 16, spacing_m: 40}}
objects: [{kind: cylinder, leg: 0, along_m: 8, across_m: 12, azimuth_deg: 30}]
"""
PORTS = """
ports:
  - name: sonar
    link: 'udp://127.0.0.1:0?peer=127.0.0.1:9'
    device: ping_protocol
    sonar: {range_m: 25, n_samples: 400}
  - {name: nav, link: 'udp://127.0.0.1:0?peer=127.0.0.1:8', device: nmea0183}
"""
TARGETS = "targets: [{kind: cylinder, side: port, ping: 60, ground_range_m: 12}]\n"
TRAINING = "scenes: [flat]\nseeds: {train: {first: 600, count: 1}, validate: {first: 700, count: 1}}\n"
PLACEHOLDERS = {
    "LOG": "mission.xtf",
    "QUIET": "mission.xtf",
    "BUSY": "leg1.xtf",
    "SPEC": "targets.yaml",
    "SCENE": "my-scene.yaml",
    "NAME": "demo",
    "SCENARIO": "clean",
    "CONTACTS": "results/contacts.geojson",
    "TRUTH": "sim/truth.json",
    "DIR": "made",
    "FOLDER": "made",
    "FILE": "made.json",
}
WRITTEN = {"--out", "--write", "--json", "--plot"}  # options that name what a line makes


class Line(NamedTuple):
    """One command line. place: where it stands."""

    place: str
    text: str

    @property
    def words(self) -> list[str]:
        """Its words, with file names for placeholders, and without a comment or where its output goes."""
        aligned = re.split(r"\s{3,}(?!#)", self.text)[0]  # help has what a line does in a column of its own
        words = shlex.split(aligned, comments=True)
        if ">" in words:
            words = words[: words.index(">")]
        read = [
            "vehicle.yaml" if before == "--config" else PLACEHOLDERS.get(word, word) for before, word in pairwise(words)
        ]
        return [*words[:1], *read]


class Reached(Exception):  # noqa: N818 (no error: the work that was asked for would begin here)
    """The first step of a long work."""


def lines_of(page: str, text: str) -> list[Line]:
    """The command lines of a page: those in fenced blocks of shell, and those between backticks."""
    blocks = re.findall(r"^```sh\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    fenced = [line.strip() for block in blocks for line in block.splitlines()]
    inline = re.findall(r"(?<!`)`([^`\n]+)`(?!`)", re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE))
    return [Line(page, line) for line in [*fenced, *inline] if line.startswith(PROGRAMS)]


def parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """A parser and those of all its subcommands."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from parsers(below)


def help_lines() -> list[Line]:
    """The examples that `--help` of every subcommand prints."""
    found = []
    for parser in parsers(_parser()):
        text = parser.format_help()
        examples = text.partition("\nexamples:\n")[2].partition("\n\n")[0].splitlines()
        found += [
            Line(f"{parser.prog} --help", line.strip()) for line in examples if line.strip().startswith("auv-mcm")
        ]
    return found


def script_lines(path: Path) -> list[Line]:
    lines = [line.strip().removeprefix(".venv/bin/") for line in path.read_text("utf-8").splitlines()]
    return [Line(path.name, line) for line in lines if line.startswith("auv-mcm ") and "$" not in line]


def all_lines() -> list[Line]:
    """Every line once. Raises AssertionError where a source that has lines gives none."""
    sources = {path.name: lines_of(path.name, path.read_text("utf-8")) for path in PAGES}
    sources |= {path.name: script_lines(path) for path in SCRIPTS} | {"--help": help_lines()}
    for name in ("README.md", "demo.sh", "test.sh", "--help", "wires.md", "cascade.md", "seabed.md"):
        assert sources[name], f"no command line was found in {name}"
    return list({tuple(line.words): line for lines in sources.values() for line in lines}.values())


LINES = all_lines()


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with everything that lines read."""
    folder = tmp_path_factory.mktemp("prepared")
    (folder / "my-scene.yaml").write_text(SCENE)
    (folder / "targets.yaml").write_text(TARGETS)
    (folder / "theatre.yaml").write_text(TRAINING)
    shutil.copy(ROOT / "sim_replay" / "hil" / "scenarios" / "clean.yaml", folder / "my-scenario.yaml")
    text = (folder / "my-scenario.yaml").read_text().replace("../scenes/lane.yaml", "my-scene.yaml")
    (folder / "my-scenario.yaml").write_text(text)
    assert main(["simulate", str(folder / "my-scene.yaml"), "--out", str(folder / "sim")]) == 0
    copies = ("mission.xtf", "leg1.xtf", "augmented/mission.xtf", "out-demo/sim/mission.xtf")
    for name in (*copies, "surveys/day1.xtf", "surveys/day2.xtf"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / "sim" / "mission.xtf", folder / name)
    (folder / "logs.txt").write_text("surveys/day1.xtf\nsurveys/day2.xtf\n")
    write_jsf(run_of("jsf"), folder / "survey.jsf")
    for image in write_images(folder, mission()[:240], place="tags"):
        for path in (image, image.with_suffix(".yaml")):
            shutil.copy(path, folder / f"survey{path.suffix}")
            path.rename(folder / f"{image.stem.removeprefix('run0-')}{path.suffix}")
    later = parse_scene(SCENE.replace("{altitude_m: 5", "{altitude_m: 5, start_time_s: 1800000000"), "later")
    shutil.copy(simulate(later, folder / "later").log, folder / "leg2.xtf")
    (folder / "vehicle.yaml").write_text(f"service: {{source: 'replay://{folder}/mission.xtf?speed=max'}}\n{PORTS}")
    assert main(["replay", str(folder / "mission.xtf"), "--out", str(folder / "results")]) == 0
    first = json.loads((folder / "results" / "contacts.geojson").read_bytes())["features"][0]
    longitude, latitude = first["geometry"]["coordinates"]
    one = Verdict(
        object="V0001",
        time="2026-05-04T10:00:00Z",
        by="kim",
        latitude_deg=latitude,
        longitude_deg=longitude,
        call="mine_like",
    )
    append_verdict(folder / "results", one)
    for name in ("r1", "r2", "out-demo/results", "monday", "tuesday", "wednesday", "thursday"):
        shutil.copytree(folder / "results", folder / name)
        if name.endswith("day"):
            judged = "2026-05-04T10:00:00Z"
            verdict = Verdict(object="V0002", time=judged, by="kim", latitude_deg=0.0, longitude_deg=0.0)
            append_verdict(folder / name, verdict)
    for name in ("s1", "s2", "augmented", "out-demo/sim"):
        (folder / name).mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / "sim" / "truth.json", folder / name / "truth.json")
    for name in ("auv-mcm-out/latest/recording", "out-demo/hil/clean/results/latest/recording"):
        (folder / name).parent.mkdir(parents=True)
        record(folder / name)
    health = Health(version="1", session="here", utc_s=time.time(), period_s=600.0, parts=())
    (folder / "auv-mcm-out" / "latest" / "health.json").write_bytes(health.to_json())
    return folder


def record(folder: Path) -> None:
    """Record the scene's mission as the service would, from a sonar and a navigation unit."""
    config = parse_config(PORTS, "ports")
    events = list(Mission(parse_scene(SCENE, "scene")).events())
    run = played(events, config, Stamp(100_000_000_000_000_000, 1_700_000_000_000_000_000))
    recorder = start_recording(folder, config, ManualClock(1_700_000_000.0))
    for recorded in run.recorded:
        recorder.record(*recorded)
    recorder.close()


def copied(source: str, target: str) -> None:
    """Link what no line writes into, as logs and pictures; copy the others."""
    if source.endswith((".xtf", ".jsf", ".mcap", ".png", ".tif")):
        os.link(source, target)
    else:
        shutil.copy(source, target)


@pytest.fixture
def folder(prepared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, without_perception: None) -> Path:
    """A copy of the prepared folder to run in, with the first step of every long work ended by `Reached`."""
    shutil.copytree(prepared, tmp_path / "here", copy_function=copied)
    monkeypatch.chdir(tmp_path / "here")
    # Before anything is replaced, or they would keep the stand-ins.
    benches = [importlib.import_module(f"sim_replay.{module}") for module, _ in BENCHES.values()]

    def reached(*_: Any, **__: Any) -> NoReturn:
        raise Reached

    for place in (
        "auv_mcm.commands.status._watch",
        "sim_replay.fitting.cascade.train_cascade.render_set",
        "sim_replay.fitting.detection_performance.calibrate_performance.fly_all",
        "sim_replay.fitting.cascade.farm.run_tasks",
        "sim_replay.batch.missions.run_tasks",
        "sim_replay.hil.run.run_scenario",
        "sim_replay.view.show._serve",
        "sim_replay.fitting.fit_background.run_tasks",
        "sim_replay.fitting.fit_gate.run_tasks",
        "sim_replay.fitting.fit_sizes.run_tasks",
        "sim_replay.fitting.looks.run_tasks",
        "sim_replay.fitting.recalibrate.refit",
        "sim_replay.fitting.verifier.build.fly_all",
        "sim_replay.fitting.verifier.own.fly_all",
        "sim_replay.benches.experiment.Experiment.run",
        *(f"{bench.__name__}.run" for bench in benches if hasattr(bench, "run")),
    ):
        monkeypatch.setattr(place, reached)
    monkeypatch.setattr("sim_replay.fitting.fit_theatre.can_train", lambda: True)
    monkeypatch.setattr("sim_replay.fitting.verifier.build.needs_packages", lambda: None)
    monkeypatch.setattr(
        "sim_replay.fitting.measure_prices.measure_prices", lambda *_, **__: PriceList(BudgetConfig(), {})
    )
    return tmp_path / "here"


@pytest.mark.parametrize("line", LINES, ids=lambda line: f"{line.place}: {' '.join(line.words)}")
def test_the_line_runs(
    line: Line, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = line.words
    for option, value in pairwise(words):
        if option in WRITTEN:
            remove(folder / value)
    program, *arguments = words
    if program == "sh":
        assert (ROOT / arguments[0]).is_file()  # its own lines are among those that run
    elif program == "python":
        run_module(arguments[1], arguments[2:], monkeypatch)
    elif (
        arguments[:1] == ["simulate"]
        and "--list" not in arguments
        and arguments[1:2] != ["my-scene.yaml"]
        and len(arguments) > 1
    ):
        monkeypatch.setattr("sim_replay.simulate.Mission", not_flown)
        with pytest.raises(Reached):  # the scenes that ship take half a minute
            main(arguments)
    else:
        run_command(arguments)
    said = capsys.readouterr()
    assert "Traceback" not in said.err


def not_flown(*_: object, **__: object) -> NoReturn:
    raise Reached


def run_command(arguments: Sequence[str]) -> None:
    """Run the program's command; a mere name of one, as `auv-mcm replay` in running text, is asked for its help."""
    try:
        code = main(arguments)
    except Reached:
        long = ("batch", "status", "train", "calibrate", "hil", "bench", "view")
        assert arguments[0] in long, "only what takes long may stop at its first step"
    except SystemExit as ended:
        if ended.code != 0:
            assert not any(word.startswith("-") or "." in word for word in arguments), (
                f"usage error: {' '.join(arguments)}"
            )
            with pytest.raises(SystemExit) as helped:
                main([*arguments, "--help"])
            assert helped.value.code == 0
    else:
        # mere names: these ask for what to run
        assert code == 0 or arguments in (["run"], ["hil"], ["simulate"], ["view"]), arguments


def run_module(name: str, arguments: Sequence[str], monkeypatch: pytest.MonkeyPatch) -> None:
    if name == "pytest":
        assert all((ROOT / path).exists() for path in arguments if not path.startswith("-"))
        return
    if name == "pip":
        extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
        assert set(re.findall(r"[\w]+(?=[\],])", arguments[-1])) <= set(extras)
        return
    module = importlib.import_module(name)
    if name.startswith("tests.") and arguments:  # takes minutes; its own tests run it
        return
    run = (module if hasattr(module, "main") else importlib.import_module(f"{name}.__main__")).main
    if not arguments:
        arguments = ["--help"]  # a mere name of it
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    expected = SystemExit if "--help" in arguments else Reached
    with pytest.raises(expected):
        run(*([arguments] if inspect.signature(run).parameters else []))


def remove(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True)
    path.unlink(missing_ok=True)


def test_every_subcommand_has_a_line_in_its_help() -> None:
    progs = {parser.prog for parser in parsers(_parser()) if parser.prog != "auv-mcm"}
    assert {line.place.removesuffix(" --help") for line in help_lines()} == progs


def test_lines_are_found_in_fences_and_between_backticks_and_nowhere_else() -> None:
    fences = (
        "```sh\nauv-mcm run --config FILE   # starts\nls\n```\nnot auv-mcm this, `x`\n```yaml\na: `auv-mcm no`\n```\n"
    )
    text = f"Say `auv-mcm check` or\n{fences}"
    found = lines_of("page", text)
    assert [line.words for line in found] == [["auv-mcm", "run", "--config", "vehicle.yaml"], ["auv-mcm", "check"]]
    assert Line("", "auv-mcm run --example > vehicle.yaml        begin with ports").words == [
        "auv-mcm",
        "run",
        "--example",
    ]
    assert lines_of("page", "nothing here") == []


def test_the_configuration_that_lines_read_is_valid(prepared: Path) -> None:
    config = parse_config((prepared / "vehicle.yaml").read_text(), "vehicle.yaml")
    assert parse_config(config_yaml(config), "again") == config
