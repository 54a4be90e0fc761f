from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from auv_mcm.cli import main
from auv_mcm.detect.cascade.model import parse_model
from sim_replay.fitting.cascade.spec import read_training_spec
from tests.sim_replay.fitting.cascade.training_tiles import write_drawn_set

SPEC = "scenes: [flat]\nseeds: {train: {first: 600, count: 1}, validate: {first: 700, count: 1}}\n"


def test_tiles_already_rendered_from_the_spec_are_trained_on_as_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec, tiles, out = tmp_path / "spec.yaml", tmp_path / "tiles", tmp_path / "model.json"
    spec.write_text(SPEC)
    manifest = write_drawn_set(tiles, 3, 1, 1, made_from=msgspec.to_builtins(read_training_spec(spec)[0]))
    assert main(["train", str(spec), "--tiles", str(tiles), "--out", str(out), "--stumps", "4", "--workers", "1"]) == 0
    assert parse_model(out.read_bytes(), "the model").training_sha256 == manifest.sha256
    assert "targets" in capsys.readouterr().err


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
