"""What is fitted for a sonar of one's own: flown by it, step after step on what was fitted before, and judged."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from auv_mcm.classify.odds import shipped_odds
from auv_mcm.classify.verifier import CLASSES, FILE
from auv_mcm.clearance.detection_performance import shipped_performance
from auv_mcm.cli import main
from auv_mcm.contacts.background import shipped_background
from auv_mcm.detect.cascade.choose import shipped_model
from auv_mcm.detect.cascade.model import encode_model
from auv_mcm.detect.gate import shipped_gate
from auv_mcm.errors import UsageError
from auv_mcm.records import Ping
from auv_mcm.settings.config import Config, parse_config
from sim_replay.commands.calibrate import FITS
from sim_replay.fitting import calibrate_odds, fit_theatre
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.cascade.spec import SonarVariant
from sim_replay.fitting.detection_performance.performance_missions import target_scene
from sim_replay.fitting.fit_odds import written
from sim_replay.fitting.looks import LookTask, all_looks, flight_of
from sim_replay.fitting.theatre import USUAL, Theatre, read_theatre
from sim_replay.fitting.verifier.weigh import Looks
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.missions import served_by
from sim_replay.scoring.thresholds import BestScores
from sim_replay.simulator.scene_file import check_scene, read_scene
from tests.sim_replay.fitting.test_calibrate_odds import Flown, flown
from tests.sim_replay.logs import sonar_logs

__all__ = ["flown"]

SCENE = """
name: pond
world: {depth_m: 15, seabeds: [{type: sand, share: 1}]}
objects: [{kind: cylinder, east_m: 9, north_m: 12, strength_db: -8}]
sonar: {range_m: 20, n_samples: 400}
track: {plan: {pattern: lawnmower, n_legs: 1, leg_m: 24}, altitude_m: 4}
"""
SPEC = """
scenes: [pond.yaml, flat]
seeds: {train: {first: 600, count: 1}, test: {first: 800, count: 1}}
sonars: [{frequency_khz: 700, range_m: 100, row_spacing_m: 0.2, column_spacing_m: 0.1}, {}]
augmented: [{folder: line, split: validate}, {folder: other, split: train}]
"""
CONFIG = """
detect: {suppression_m: 1.5}
sonar: {transfer: log, lever_arm_m: [2, -1, 0]}
confirm: {targets: listed.yaml}
"""


@pytest.fixture
def theatre(tmp_path: Path) -> Theatre:
    (tmp_path / "pond.yaml").write_text(SCENE)
    (tmp_path / "theatre.yaml").write_text(SPEC)
    for name in ("line", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}.xtf").touch()
        (tmp_path / name / "truth.json").write_text(json.dumps({"background": f"{name}.xtf", "objects": []}))
    return read_theatre(tmp_path / "theatre.yaml", parse_config(CONFIG, "own.yaml"), "")


def test_missions_carry_the_sonars_in_turn_and_show_the_picture_configured(theatre: Theatre, tmp_path: Path) -> None:
    assert theatre.flown == (str(tmp_path / "pond.yaml"), "flat")
    scene = read_scene(theatre.flown[0])
    flown, config = theatre.carried(scene, 2)
    assert (flown.sonar.frequency_khz, flown.sonar.range_m) == (700.0, 100.0)
    assert flown.sonar.ping_rate_hz < 7.5  # sound takes 133 ms to 100 m and back
    assert (config.waterfall.row_spacing_m, config.waterfall.column_spacing_m) == (0.2, 0.1)
    assert config.detect.suppression_m == 1.5
    assert (config.sonar.transfer, config.sonar.lever_arm_m) == ("auto", (0.0, 0.0, 0.0)), "the scene has its own"
    assert config.confirm.targets == "shipped", "of a vehicle, not of its models"
    assert theatre.carried(scene, 1)[0] == scene
    assert USUAL.carried(scene, 0)[0] == scene
    by_cascade = theatre.with_files(model="own.json", odds="odds.json").config
    assert served_by("cascade", by_cascade) == by_cascade
    assert served_by("contrast", by_cascade).confirm.odds == "shipped", "those are the cascade's"


def test_tables_hold_for_the_mean_beam_of_the_sonars_and_for_the_usual_one_at_least() -> None:
    wide, narrow, unsaid = (SonarVariant(beam_width_deg=width) for width in (2.5, 0.2, None))
    assert USUAL.beam_width_deg == Theatre(sonars=(narrow,)).beam_width_deg == 0.5
    assert Theatre(sonars=(wide, unsaid)).beam_width_deg == 1.5


def test_missions_show_nothing_beyond_the_reach_of_the_sonar_carried(theatre: Theatre) -> None:
    near = theatre._replace(sonars=(SonarVariant(range_m=40.0),))
    check_scene(near.carried(read_scene("flat"), 0)[0], "flat")  # whose objects lie up to 46 m away
    wide = next(scene for seed in range(9) if (scene := target_scene(seed)).sonar.range_m == 75.0)
    seen = near.carried(wide, 0)[0]
    check_scene(seen, "of detection performance")
    assert len(wide.objects) / 3 < len(seen.objects) < len(wide.objects)


def test_a_line_with_targets_is_flown_as_it_lies_there(theatre: Theatre, tmp_path: Path) -> None:
    write_xtf(tmp_path / "line" / "reef.xtf", sonar_logs.mission())
    truth = {"background": "reef.xtf", "area_km2": 0.1, "objects": []}
    (tmp_path / "line" / "truth.json").write_text(json.dumps(truth))
    (folder,) = theatre.lines_of("validate")
    with flight_of(LookTask(folder, 0, theatre=theatre)) as flight:
        assert flight.truth() == truth
        assert flight.config.waterfall.row_spacing_m == 0.2
        assert flight.config.sonar.lever_arm_m == (2.0, -1.0, 0.0), "as where its targets were put in"
        assert any(isinstance(event, Ping) for event in flight.events)


def test_what_can_be_calibrated_is_named_and_what_a_theatre_is_to_each_is_said(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["calibrate"])
    named = capsys.readouterr().err
    for fit in FITS:
        assert fit.name in named
        with pytest.raises(SystemExit, match="0"):
            main(["calibrate", fit.name, "--help"])
        helped = capsys.readouterr().out
        if "--theatre" in helped:
            assert ("its scenes are flown" in " ".join(helped.split())) == (fit.name not in ("performance", "seabed"))


def test_odds_are_fitted_on_the_own_scenes_and_lines_and_the_network_weighed_beside_them(
    flown: Flown, theatre: Theatre, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.yaml").write_text(CONFIG)
    random = np.random.Generator(np.random.PCG64(1))
    label = np.repeat(np.arange(3, dtype=np.int8), 20)
    weighed = Looks(
        "scenes", random.normal(size=60), random.normal(size=(60, len(CLASSES))), label, label, label >= 0, 20, 1
    )
    monkeypatch.setattr(calibrate_odds, "fly_all", lambda tasks, *_: [one.source for one in tasks])
    monkeypatch.setattr(calibrate_odds, "looks_of", lambda *_: weighed)
    options = ["--config", str(tmp_path / "own.yaml"), "--theatre", str(tmp_path / "theatre.yaml")]
    out = tmp_path / "odds.json"
    assert main(["calibrate", "odds", "--seeds", "1", *options, "--out", str(out)]) == 0
    assert [task.source for task in flown.missions] == [*theatre.flown, str(tmp_path / "line")]
    assert {task.theatre.config for task in flown.missions} == {theatre.config}
    odds = json.loads(out.read_bytes())
    assert odds["made_by"].endswith(" ".join(options))
    assert odds["fitted_for"] == "cascade"
    assert odds["verifier"]["digest"] == shipped_odds("cascade").verifier.digest  # type: ignore[union-attr]


@pytest.mark.parametrize("changed", ["pond.yaml", "model.json", "line/truth.json"])
def test_missions_are_flown_again_after_what_they_go_by_has_changed(
    flown: Flown, theatre: Theatre, tmp_path: Path, changed: str
) -> None:
    for name in ("model.json", "line/truth.json"):
        (tmp_path / name).write_text("{}")
    task = LookTask(theatre.flown[0], 500, theatre=theatre.with_files(model=str(tmp_path / "model.json")))
    all_looks([task], tmp_path / "looks", Farm(1))
    all_looks([task], tmp_path / "looks", Farm(1))
    assert len(flown.missions) == 1
    (tmp_path / changed).write_text("other")
    all_looks([task], tmp_path / "looks", Farm(1))
    assert len(flown.missions) == 2


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[str]]:
    """Give the files of detector, odds, gate and background that each step went by; nothing is fitted or flown."""
    seen: dict[str, list[str]] = {}

    def note(step: str, one: Theatre, found: Any = None) -> Any:
        detect, own = one.config.detect, [one.config.confirm.odds, one.config.contacts.background]
        seen[step] = [Path(name).name for name in (detect.model, own[0], detect.gate, own[1])]
        return found

    def network(one: Theatre, out: Path, *_: object) -> None:
        note("network", one)
        out.write_bytes(resources.files("auv_mcm.classify").joinpath(FILE).read_bytes())

    def odds(out: Path, missions: calibrate_odds.Missions, *others: Any) -> None:
        note("odds", missions.theatre)
        assert others[-1].digest == shipped_odds("cascade").verifier.digest  # type: ignore[union-attr]  # the own one
        out.write_bytes(written(msgspec.structs.replace(shipped_odds("cascade"), fitted_for="cascade")))

    monkeypatch.setattr(fit_theatre, "can_train", lambda: True)
    monkeypatch.setattr(fit_theatre, "own_network", network)
    monkeypatch.setattr(fit_theatre, "fit_from_missions", odds)
    monkeypatch.setattr(fit_theatre, "calibrate_gate", lambda *a: note("gate", a[-1], shipped_gate()))
    monkeypatch.setattr(fit_theatre, "calibrate_background", lambda *a: note("background", a[-1], shipped_background()))
    monkeypatch.setattr(
        fit_theatre, "run_tasks", lambda fly, tasks, *_: [found_by(fly.keywords["config"])] * len(tasks)
    )
    return seen


def test_each_step_goes_by_the_files_before_it_and_an_interrupted_run_goes_on(
    theatre: Theatre, tmp_path: Path, seen: dict[str, list[str]]
) -> None:
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "performance.json").write_bytes(msgspec.json.encode(shipped_performance()))
    vehicle = parse_config(CONFIG, "own.yaml")
    farm, train = Farm(1), lambda out: out.write_bytes(encode_model(shipped_model()))
    said = fit_theatre.fit_theatre(theatre, vehicle, b"a", folder, train, farm, watched)
    assert seen == {
        "network": ["model.json", "shipped", "none", "shipped"],
        "odds": ["model.json", "shipped", "none", "shipped"],
        "gate": ["model.json", "odds.json", "shipped", "shipped"],
        "background": ["model.json", "odds.json", "gate.json", "shipped"],
    }
    own = parse_config((folder / "vehicle.yaml").read_text(), "vehicle.yaml")
    named = (own.detect.model, own.confirm.odds, own.detect.gate, own.contacts.background, own.detect.performance)
    assert [Path(name).name for name in named] == [*seen["background"][:3], "background.json", "performance.json"]
    assert all(Path(name).is_file() for name in named)
    assert (own.sonar.transfer, own.confirm.targets, own.waterfall.row_spacing_m) == ("log", "listed.yaml", 0.2)
    assert re.search(r"^shipped +0\.00 .* 0\.00 .* 0\.50 \(", said, re.M)
    assert re.search(r"^own +0\.00 .* 0\.00 .* 1\.00 \(", said, re.M)
    assert said.endswith("2 missions left out, 4 targets, 0.060 km²")
    seen.clear()
    alone = theatre._replace(test_seeds=())
    assert "nothing was judged" in fit_theatre.fit_theatre(alone, vehicle, b"a", folder, train, farm, watched)
    assert seen == {}
    with pytest.raises(UsageError, match="for another spec"):
        fit_theatre.fit_theatre(alone, vehicle, b"b", folder, train, farm, watched)


@pytest.mark.parametrize("change", ["configuration", "scene", "line"])
def test_a_run_goes_on_only_with_what_it_began_with(
    theatre: Theatre, tmp_path: Path, seen: dict[str, list[str]], change: str
) -> None:
    def fit(theatre: Theatre) -> None:
        out, train = tmp_path / "own", lambda out: None
        fit_theatre.fit_theatre(theatre, Config(), b"a", out, train, Farm(1), watched, network_alone=True)

    fit(theatre)
    if change == "configuration":
        theatre = theatre._replace(config=Config())
    elif change == "scene":
        (tmp_path / "pond.yaml").write_text(SCENE.replace("sand", "mud"))
    else:
        (tmp_path / "line" / "truth.json").write_text('{"background": "line.xtf", "objects": [], "seed": 2}')
    with pytest.raises(UsageError, match="fitted otherwise"):
        fit(theatre)


def test_sea_floor_that_is_fitted_on_is_not_judged_by(theatre: Theatre, tmp_path: Path) -> None:
    def refusal(theatre: Theatre) -> str:
        out = tmp_path / "own"
        with pytest.raises(UsageError) as raised:
            fit_theatre.fit_theatre(theatre, Config(), b"a", out, print, Farm(1), watched, network_alone=True)
        assert not out.exists()
        return str(raised.value)

    for seed, step in ((504, "odds"), (1510, "background")):
        assert f"holds {seed}, a mission that {step}" in refusal(theatre._replace(test_seeds=(800, seed)))
    twice = theatre._replace(lines=(*theatre.lines, ("test", str(tmp_path / "line"))))
    assert "'line.xtf' is in the set twice, for validate and for test" in refusal(twice)


def test_a_network_alone_leaves_detector_and_performance_as_they_ship(
    theatre: Theatre, tmp_path: Path, seen: dict[str, list[str]]
) -> None:
    def fit(folder: Path, *, alone: bool) -> None:
        fit_theatre.fit_theatre(
            theatre._replace(test_seeds=()),
            parse_config(CONFIG, "own.yaml"),
            b"a",
            folder,
            lambda out: pytest.fail("the detector was trained"),
            Farm(1),
            watched,
            network_alone=alone,
        )

    fit(tmp_path / "network", alone=True)
    assert seen == {
        "network": ["shipped", "shipped", "shipped", "shipped"],
        "odds": ["shipped", "shipped", "shipped", "shipped"],
        "gate": ["shipped", "odds.json", "shipped", "shipped"],
        "background": ["shipped", "odds.json", "gate.json", "shipped"],
    }
    own = parse_config((tmp_path / "network" / "vehicle.yaml").read_text(), "vehicle.yaml")
    assert Path(own.contacts.background).parent == tmp_path / "network"
    assert (own.detect.model, own.detect.performance) == ("shipped", "shipped")
    with pytest.raises(UsageError, match="fitted otherwise"):
        fit(tmp_path / "network", alone=False)


def test_a_network_alone_needs_pytorch(theatre: Theatre, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit_theatre, "can_train", lambda: False)
    with pytest.raises(UsageError, match="needs PyTorch"):
        fit_theatre.fit_theatre(
            theatre, theatre.config, b"a", tmp_path / "own", lambda out: None, Farm(1), watched, network_alone=True
        )


def watched(step: str) -> AbstractContextManager[Callable[[int, int], None]]:
    return nullcontext(lambda done, of: None)


def found_by(config: Config) -> BestScores:
    worse = config.detect.model == "shipped"
    alarms = np.array([9.0, 7.0, 5.0, 3.0, 1.0])
    targets = np.array([4.0, 0.0]) if worse else np.array([8.0, 6.0])
    return BestScores(targets, alarms, 0.03)
