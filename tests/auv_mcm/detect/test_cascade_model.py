"""Model files: what is written is read back, and what cannot be run is refused in words."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.detect.cascade.model import MAX_STUMPS, Calibration, check_model, encode_model, fits_sonar, parse_model
from auv_mcm.errors import BadInputError
from tests.auv_mcm.detect.drawn_cascades import draw_model

Change = Callable[[dict[str, Any]], object]


def changed(change: Change) -> bytes:
    fields = json.loads(encode_model(draw_model(1)))
    change(fields)
    return json.dumps(fields).encode()


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(["soft", "stages"]))
@settings(deadline=None, max_examples=20)
def test_models_are_read_back_as_written(seed: int, kind: str) -> None:
    model = draw_model(seed, kind=kind)
    text = encode_model(model)
    assert parse_model(text, "model.json") == model
    assert max(len(line) for line in text.splitlines()) < 400, "a person reads it line by line"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m.pop("format_version"), "format_version"),
        (lambda m: m.update(format_version=2), "format_version 2, but this program reads 1"),
        (lambda m: m.update(kind="tree"), "Invalid enum value 'tree'"),
        (lambda m: m.update(boost=1), "unknown field `boost`"),
        (lambda m: m.update(groups=[], reject=[]), "one group or more"),
        (lambda m: m["groups"].__setitem__(1, []), "every group one stump"),
        (lambda m: m["reject"].pop(), "reject has 4 thresholds for 5 groups"),
        (lambda m: m.update(row_spacing_m=[0.2, 0.1]), "row_spacing_m goes from 0.2 to 0.1"),
        (lambda m: m.update(column_spacing_m=[0.0, 0.1]), "> 0.0"),
        (lambda m: m["calibration"].update(score=[1]), "calibration has 1 scores and 2 log_odds"),
        (lambda m: m["calibration"].update(score=[5, 5]), "calibration.score must rise"),
        (lambda m: m["calibration"].update(log_odds=[1.0, 0.5]), "calibration.log_odds must not fall"),
        (
            lambda m: m["groups"][2][0].update(a=[0.5, 0.5, 0, 0, 0.5, 0]),
            r"groups[2][0]: box a: top_m must be less than bottom_m",
        ),
        (
            lambda m: m["groups"][2][0].update(b=[-0.5, 0.5, 0, 0, 0.5, 1.3]),
            "box b: with a shadow of 6.0 m it goes from 0 to 8.3 m",
        ),
        (lambda m: m["groups"][2][0].update(b=[-0.5, 0.5, 0.9, 0, 0.5, 0.1]), "box b: with a shadow of 0.4 m"),
        (lambda m: m["groups"][2][0].update(b=[-0.5, 0.5, 0.9]), "array"),
        (lambda m: m["groups"][0][0].update(kind="ratio", w=None, threshold=0.0), "at least 0.0001"),
        (lambda m: m["groups"][0][0].update(kind="contrast", w=None), "a contrast needs a third box w"),
        (
            lambda m: m["groups"][0][0].update(kind="ratio", w=[-1, 1, -1, 0, 1, 1]),
            "a ratio must not have a third box w",
        ),
        (lambda m: m["groups"][0][0].update(below=10**6), "<= 65536"),
        (lambda m: m["groups"][0].extend(m["groups"][0][:1] * MAX_STUMPS), f"maximum of {MAX_STUMPS}"),
        (
            lambda m: m.update(expected_pd=[{"seabed": "sand", "near_m": 5, "far_m": 5, "n_targets": 1, "pd": 1}]),
            "expected_pd[0]",
        ),
        (
            lambda m: m.update(expected_pd=[{"seabed": "sand", "near_m": 5, "far_m": 9, "n_targets": 1, "pd": 1.1}]),
            "<= 1.0",
        ),
    ],
)
def test_what_cannot_be_run_is_refused_naming_the_file_and_what_to_do(change: Change, words: str) -> None:
    with pytest.raises(BadInputError, match=re.escape(words)) as caught:
        parse_model(changed(change), "mine.json")
    assert str(caught.value).startswith("mine.json: ")
    assert str(caught.value).endswith("Train the model anew or take the one that ships with the package")


@pytest.mark.parametrize("data", [b"", b"[]", b"\xff\xfe", b'{"format_version": 1}', b'{"format_version": 1e400}'])
def test_other_files_are_refused(data: bytes) -> None:
    with pytest.raises(BadInputError, match=r"mine\.json"):
        parse_model(data, "mine.json")


def test_numbers_that_json_has_no_words_for_are_refused_in_models_made_in_memory() -> None:
    model = draw_model(1)
    stump = msgspec.structs.replace(model.groups[0][0], threshold=float("nan"))
    with pytest.raises(BadInputError, match="must be finite"):
        check_model(msgspec.structs.replace(model, groups=((stump,), *model.groups[1:])), "trained")
    box = msgspec.structs.replace(model.groups[0][0].a, far_m=float("inf"))
    stump = msgspec.structs.replace(model.groups[0][0], a=box)
    with pytest.raises(BadInputError, match="box a: its edges must be finite"):
        check_model(msgspec.structs.replace(model, groups=((stump,), *model.groups[1:])), "trained")


def test_calibration_is_linear_between_its_points_and_constant_beyond() -> None:
    calibration = Calibration(score=(0, 100, 200), log_odds=(-2.0, 0.0, 0.0))
    scores = np.array([-50, 0, 25, 100, 150, 999])
    np.testing.assert_allclose(calibration.log_odds_of(scores), [-2.0, -2.0, -1.5, 0.0, 0.0, 0.0])


def test_a_model_fits_pixels_within_what_it_was_trained_for() -> None:
    model = msgspec.structs.replace(draw_model(1), row_spacing_m=(0.1, 0.2), column_spacing_m=(0.04, 0.06))
    assert fits_sonar(model, 0.1, 0.06)
    assert not fits_sonar(model, 0.09, 0.05)
    assert not fits_sonar(model, 0.15, 0.061)
