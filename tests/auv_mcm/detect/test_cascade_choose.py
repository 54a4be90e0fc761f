"""Which cascade serves: by configuration, by pixel size, and what is reported when none does."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import pytest

from auv_mcm.detect.cascade.choose import configured_model, fitting, shipped_model
from auv_mcm.detect.cascade.model import encode_model
from auv_mcm.errors import BadInputError
from auv_mcm.settings.config import Config, ConfirmConfig, DetectConfig, WaterfallConfig
from tests.auv_mcm.detect.drawn_cascade import MODEL


def with_model(name: str) -> Config:
    return Config(detect=DetectConfig(model=name))


def test_a_model_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_bytes(encode_model(MODEL))
    assert configured_model(with_model(str(path))) == MODEL


def test_none_means_contrasts_alone() -> None:
    assert configured_model(with_model("none")) is None
    model, notice = fitting(None, Config())
    assert model is None
    assert notice.code == "detect.contrast"
    assert notice.for_the_record


@pytest.mark.parametrize("data", [None, b"", b"{}", b'{"format_version": 99}', b"\xff\xfe", encode_model(MODEL)[:-200]])
def test_a_file_that_is_no_model_is_refused_by_name(tmp_path: Path, data: bytes | None) -> None:
    path = tmp_path / "model.json"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(BadInputError, match=r"model\.json"):
        configured_model(with_model(str(path)))


def test_a_pipe_is_refused_without_waiting_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "model.json")
    with pytest.raises(BadInputError, match=r"model\.json is not a regular file"):
        configured_model(with_model(str(tmp_path / "model.json")))


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="or 'shipped' for the one of the package"):
        configured_model(with_model(str(tmp_path)))


def test_the_model_serves_for_pixels_that_it_was_trained_for_and_for_no_others() -> None:
    model, notice = fitting(MODEL, Config())
    assert model is MODEL
    assert notice.code == "detect.cascade"
    assert notice.for_the_record
    model, notice = fitting(MODEL, Config(waterfall=WaterfallConfig(column_spacing_m=0.5)))
    assert model is None
    assert notice.code == "detect.model_does_not_fit"
    assert not notice.for_the_record
    assert "0.12 x 0.5 m" in notice.text
    assert "train a model" in notice.text


@pytest.mark.parametrize(("odds", "code"), [("shipped", "detect.odds_of_another"), ("own/odds.json", "detect.cascade")])
def test_a_model_of_ones_own_with_odds_of_the_shipped_one_asks_to_fit_odds(odds: str, code: str) -> None:
    model, notice = fitting(MODEL, msgspec.structs.replace(with_model("own.json"), confirm=ConfirmConfig(odds=odds)))
    assert model is MODEL
    assert notice.code == code
    assert notice.for_the_record == (odds != "shipped")
    assert fitting(shipped_model(), with_model("a/copy.json"))[1].code == "detect.cascade"
