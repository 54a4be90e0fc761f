"""YAML that people write, whatever is in it: values, or an error with file and place; bounded in time and memory."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.cli import main
from auv_mcm.errors import UsageError
from auv_mcm.settings.strict_yaml import MAX_TEXT_BYTES, load_mapping, read_text


def loaded(text: str) -> dict[Any, Any]:
    return load_mapping(text, "vehicle.yaml", "expected keys")


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ('side: "\\ud800"', "`side`"),
        ('a: {b: [1, "x\\udfff"]}', "`a.b.1`"),
        ('"\\ud800": 1', "half a character"),
        ('a: "\\ud83d\\ude00"', "`a`"),
    ],
)
def test_half_a_surrogate_pair_is_an_error_with_its_place(text: str, place: str) -> None:
    with pytest.raises(UsageError, match=r"vehicle\.yaml: \\ud.* is half a character") as refusal:
        loaded(text)
    assert place in str(refusal.value)
    assert str(refusal.value).encode("utf-8")


@given(st.text(st.characters()), st.text(st.characters()))
def test_any_text_is_taken_as_it_is_or_refused_with_words_that_can_be_printed(key: str, value: str) -> None:
    """JSON is YAML, and escapes whatever Python can hold."""
    refusal, data = "", None
    try:
        data = loaded(json.dumps({key: [value]}))
    except UsageError as error:
        refusal = str(error)
    assert refusal.encode("utf-8") or data == {key: [value]}
    assert json.dumps(data, ensure_ascii=False).encode("utf-8")


@pytest.mark.parametrize(
    "text", ["a: " + "[" * 100_000, "a: " + "9" * 100_000, "- " * 50_000, "{" * 65], ids=["[", "9", "-", "{"]
)
def test_endless_nesting_and_numbers_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="not valid YAML"):
        loaded(text)


def test_a_repeated_key_among_thousands_is_found_without_comparing_all_with_all() -> None:
    """Compared with each before, these took minutes."""
    with pytest.raises(UsageError, match="key 'k29999' is given twice"):
        loaded("{" + ",".join(f"k{n}: 1" for n in range(30_000)) + ", k29999: 2}")


def test_a_pipe_a_device_and_a_file_that_is_too_large_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(MAX_TEXT_BYTES + 1)
    for path, why in ((tmp_path / "pipe", "a pipe"), (Path("/dev/zero"), "a device"), (tmp_path / "large", "larger")):
        with pytest.raises(UsageError, match=f"configuration {path} .*{why}"):
            read_text(path, "configuration")


@pytest.mark.parametrize("command", [["run", "--config"], ["simulate"]])
def test_commands_end_with_bad_usage_where_a_pipe_is_named(command: list[str], tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    assert main([*command, str(tmp_path / "pipe.yaml")]) == 2
