from __future__ import annotations

from pathlib import Path

import pytest

from auv_mcm.cli import main
from auv_mcm.detect.cascade.choose import shipped_model
from auv_mcm.detect.cascade.model import parse_model
from auv_mcm.settings.config import SonarConfig
from sim_replay.fitting import fit_theatre
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.cascade.store import Manifest
from sim_replay.fitting.cascade.training_images import made_from
from tests.sim_replay.fitting.cascade.training_tiles import write_drawn_set

SPEC = "scenes: [flat]\nseeds: {train: {first: 600, count: 1}, validate: {first: 700, count: 1}}\n"


def test_tiles_already_rendered_from_the_spec_are_trained_on_as_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec, tiles, out = tmp_path / "spec.yaml", tmp_path / "tiles", tmp_path / "model.json"
    spec.write_text(SPEC)
    manifest = write_drawn_set(tiles, 3, 1, 1, made_from=made_from(spec))
    assert main(["train", str(spec), "--tiles", str(tiles), "--out", str(out), "--stumps", "4", "--workers", "1"]) == 0
    assert parse_model(out.read_bytes(), "the model").training_sha256 == manifest.sha256
    assert "targets" in capsys.readouterr().err


@pytest.mark.parametrize("changed", ["bay.yaml", "line/truth.json", "line/reef.xtf", "vehicle.yaml"])
def test_tiles_are_rendered_again_after_what_they_show_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: str
) -> None:
    (tmp_path / "line").mkdir()
    for name, text in {
        "spec.yaml": SPEC.replace("flat", "bay.yaml") + "augmented: [{folder: line, split: test}]",
        "bay.yaml": "name: bay",
        "line/truth.json": '{"background": "reef.xtf", "objects": []}',
        "line/reef.xtf": "",
        "vehicle.yaml": "sonar: {heading_offset_deg: 2}",
    }.items():
        (tmp_path / name).write_text(text)
    spec, tiles = tmp_path / "spec.yaml", tmp_path / "tiles"
    write_drawn_set(tiles, 3, 1, 1, made_from=made_from(spec, SonarConfig(heading_offset_deg=2.0)))
    rendered: list[SonarConfig] = []

    def render(spec: Path, folder: Path, farm: Farm, sonar: SonarConfig) -> Manifest:
        rendered.append(sonar)
        return write_drawn_set(folder, 3, 1, 1, made_from=made_from(spec, sonar))

    monkeypatch.setattr("sim_replay.fitting.cascade.train_cascade.render_set", render)
    monkeypatch.setattr("sim_replay.fitting.cascade.train_cascade.train", lambda *_: shipped_model())

    def train(out: str) -> int:
        options = ["--tiles", str(tiles), "--config", str(tmp_path / "vehicle.yaml"), "--out", str(tmp_path / out)]
        return main(["train", str(spec), *options])

    assert train("first.json") == 0
    assert not rendered
    place = tmp_path / changed
    place.write_text(place.read_text().replace("2}", "3}") + " ")
    assert train("second.json") == 0
    assert [one.heading_offset_deg for one in rendered] == [3.0 if changed == "vehicle.yaml" else 2.0]


def test_a_folder_of_other_stumps_is_not_gone_on_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(fit_theatre, "_steps", lambda *_: ())
    monkeypatch.setattr(fit_theatre, "judged", lambda *_: "")
    (spec := tmp_path / "spec.yaml").write_text(SPEC)
    all_of = ["train", str(spec), "--all", "--kind", "soft", "--out", str(tmp_path / "own"), "--stumps"]
    assert [main([*all_of, n]) for n in ("4", "4", "5")] == [0, 0, 2]
    assert "has files that were fitted otherwise, with other options" in capsys.readouterr().err


def test_a_place_that_cannot_be_written_to_is_refused_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", "--out", str(tmp_path / "nowhere" / "model.json")]) == 2
    assert "there is no folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "lacks"),
    [
        ("scenes: [flat]\nseeds: {train: {first: 600, count: 1}}\n", "validate"),
        ("augmented: [{folder: line, split: validate}]\n", "train"),
    ],
)
def test_a_set_without_a_split_that_training_needs_is_refused_before_any_of_it_is_rendered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], text: str, lacks: str
) -> None:
    monkeypatch.setattr("sim_replay.fitting.cascade.train_cascade.render_set", None)
    (spec := tmp_path / "spec.yaml").write_text(text)
    assert main(["train", str(spec), "--out", str(tmp_path / "model.json")]) == 2
    assert f"{spec}: training needs the split `{lacks}`" in capsys.readouterr().err
