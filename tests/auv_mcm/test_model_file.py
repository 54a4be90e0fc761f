"""What `calibrate` writes can be loaded: the configuration names it, and a file that is wrong is refused by key and
name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from auv_mcm.classify.targets import configured_targets
from auv_mcm.clearance.detection_performance import configured_performance, shipped_performance
from auv_mcm.cli import main
from auv_mcm.commands import read_config
from auv_mcm.errors import BadInputError
from auv_mcm.seabed.seabed_model import configured_seabed_model, shipped_seabed_model
from auv_mcm.settings.config import Config, DetectConfig
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene, Sonar, Track
from sim_replay.text_tables import json_lines


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "leg.xtf"
    track = Track(plan=Lawnmower(n_legs=1, leg_m=16.0), altitude_m=5.0)
    write_xtf(path, Mission(Scene(sonar=Sonar(range_m=30.0, ping_rate_hz=15.0, beam_lines=3), track=track)).events())
    return path


def test_files_that_a_configuration_names_are_looked_for_from_its_own_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The service starts in another folder than a person who checks its configuration."""
    (tmp_path / "vehicle.yaml").write_text(
        "confirm: {targets: mines.yaml}\ndetect: {model: none, gate: /models/gate.json}\n"
    )
    (tmp_path / "mines.yaml").write_text("mines: [{kind: sphere}]")
    (tmp_path / "elsewhere").mkdir()
    for folder, path in ((tmp_path, "vehicle.yaml"), (tmp_path / "elsewhere", "../vehicle.yaml")):
        monkeypatch.chdir(folder)
        config = read_config(Path(path))
        assert len(configured_targets(config.confirm.targets).mines) == 1
        assert Path(config.confirm.targets).is_absolute()
        assert (config.detect.model, config.detect.gate, config.confirm.odds) == (
            "none",
            "/models/gate.json",
            "shipped",
        )


def blind_tables(path: Path) -> Path:
    """Tables, as calibrate writes them, of a sonar that never finds anything."""
    tables: dict[str, Any] = json.loads(json_lines(shipped_performance()))
    for bands in tables["floors"].values():
        for band in bands:
            band.update(p=0.0, low=0.0)
    path.write_text(json.dumps(tables))
    return path


def searched(log: Path, folder: Path, config: str) -> dict[str, Any]:
    (folder / "c.yaml").write_text(config)
    assert main(["replay", str(log), "--out", str(folder / "out"), "--config", str(folder / "c.yaml")]) == 0
    totals: dict[str, Any] = json.loads((folder / "out" / "summary.json").read_text())["searched"]
    return totals


def test_tables_that_calibrate_performance_wrote_are_used_for_what_was_searched(log: Path, tmp_path: Path) -> None:
    assert searched(log, tmp_path, "")["p_detected_mean"] > 0.1
    tables = blind_tables(tmp_path / "performance.json")
    assert searched(log, tmp_path, f"detect: {{performance: '{tables}'}}")["p_detected_mean"] == 0.0


def test_a_model_as_calibrate_seabed_writes_it_is_used_for_the_sea_floor(tmp_path: Path) -> None:
    shipped = json.loads(Path("auv_mcm/seabed/model.json").read_text())
    path = tmp_path / "seabed.json"
    path.write_text(json.dumps({**shipped, "fitted_on": "our own recorder"}))
    config = Config(detect=DetectConfig(seabed_model=str(path)))
    assert configured_seabed_model(config).fitted_on == "our own recorder"
    assert configured_seabed_model(Config()) == shipped_seabed_model()


@pytest.mark.parametrize("key", ["seabed_model", "performance"])
@pytest.mark.parametrize("content", [None, b"", b"{}", b"\xff\xfe", b'{"fitted_on": 3}'])
def test_a_file_that_is_none_is_refused_by_key_and_name_before_any_output(
    key: str, content: bytes | None, log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "model.json"
    if content is not None:
        path.write_bytes(content)
    (tmp_path / "c.yaml").write_text(f"detect: {{{key}: '{path}'}}")
    assert main(["replay", str(log), "--out", str(tmp_path / "out"), "--config", str(tmp_path / "c.yaml")]) == 3
    assert f"detect.{key} {path}: " in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_folder_is_no_model_file(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="or 'shipped' for the one of the package"):
        configured_performance(Config(detect=DetectConfig(performance=str(tmp_path))))
