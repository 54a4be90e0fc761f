"""The chain answers as it did, and every command's help says what it said.

Bytes are compared where the C kernels serve, on the platform that the answers were stored on; on another the contacts
are the same, of the same classes, within the documented tolerance. What moved on purpose is stored by
`python -m tests.golden --update`, and the commit says what it prints.
"""

from __future__ import annotations

import pytest

from auv_mcm import kernels
from tests.golden.answers import (
    LINES,
    Answer,
    help_answer,
    line_answer,
    line_names,
    read_stored,
    scenario_answer,
    scene_answer,
    scene_names,
)
from tests.golden.differences import OTHER_PLATFORM, mission_differences, text_differences

HOW = "If this is meant: python -m tests.golden --update, and what it prints goes into the commit."
needs_c = pytest.mark.skipif(
    kernels.backend() != "c", reason="stored answers are those of the C kernels; numpy's agree within a tolerance"
)


def same(name: str, new: Answer) -> None:
    assert new.get("contradictions", []) == [], "what is said of a contact contradicts itself"
    old = read_stored(name)
    assert old is not None, f"no answer is stored: {HOW}"
    if old["platform"] != new["platform"]:
        assert mission_differences(old, new, OTHER_PLATFORM) == [], HOW
        return
    assert mission_differences(old, new) == [], HOW
    assert old == new, f"changed by less than is put in words. {HOW}"


@needs_c
@pytest.mark.parametrize("name", scene_names())
def test_a_scene_is_answered_as_before(name: str) -> None:
    same(f"scene-{name}", scene_answer(name))


@needs_c
@pytest.mark.skipif(not LINES.is_dir(), reason="the folder shared/data/sidescan beside the checkout is absent")
@pytest.mark.parametrize("name", line_names())
def test_a_recorded_line_is_answered_as_before(name: str) -> None:
    same(f"line-{name}", line_answer(LINES / f"{name}.xtf"))


@pytest.mark.skipif(not LINES.is_dir(), reason="the folder shared/data/sidescan beside the checkout is absent")
def test_every_recorded_line_has_an_answer() -> None:
    assert {path.stem for path in LINES.glob("*.xtf")} == set(line_names())


def test_every_help_says_what_it_said() -> None:
    stored = read_stored("help")
    assert stored is not None
    assert text_differences(stored, help_answer()) == [], HOW


def test_every_scenario_expects_what_it_expected() -> None:
    stored = read_stored("scenarios")
    assert stored is not None
    assert text_differences(stored, scenario_answer()) == [], HOW
