"""The list of the mines expected: what is read, what is refused, and what it is called."""

from __future__ import annotations

from pathlib import Path

import pytest

from auv_mcm.classify.targets import (
    NOT_LISTED,
    ExpectedCylinder,
    ExpectedSphere,
    TargetLibrary,
    configured_targets,
    mine_words,
    parse_targets,
    shipped_targets,
)
from auv_mcm.errors import UsageError


def test_a_list_is_read_with_its_defaults(tmp_path: Path) -> None:
    path = tmp_path / "mines.yaml"
    path.write_text("mines:\n  - {kind: sphere, diameter_m: 0.9}\n  - {kind: cylinder, length_m: 1.6, share: 2}\n")
    assert configured_targets(str(path)) == TargetLibrary(
        mines=(ExpectedSphere(diameter_m=0.9), ExpectedCylinder(length_m=1.6, share=2.0)), not_listed=NOT_LISTED
    )


def test_the_list_that_ships_holds_every_kind_of_any_size() -> None:
    assert configured_targets("shipped") is shipped_targets()
    assert [mine_words(mine) for mine in shipped_targets().mines] == [
        "cylinder of any size",
        "sphere of any size",
        "truncated cone of any size",
        "wedge of any size",
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mines: []", "`mines`"),
        ("mines: 3", "at `mines`"),
        ("mine:\n - {kind: sphere}", "did you mean `mines`"),
        ("mines:\n - {kind: sfere}", "did you mean sphere"),
        ("mines:\n - {kind: sphere}\n - {kind: sphere, diameter_m: 9}", r"<= 3.5 - at `mines\[1\].diameter_m`"),
        ("mines:\n - {kind: sphere, diametre_m: 0.9}", "did you mean `diameter_m`"),
        (
            "mines:\n - {kind: sphere, length_m: 0.9}",
            r"`length_m` - at `mines\[0\]` \(known there: kind, name, tolerance_percent, share, diameter_m\)",
        ),
        ("mines:\n - {kind: sphere, tolerance_percent: 0}", r"`mines\[0\].tolerance_percent`"),
        ("not_listed: 0\nmines:\n - {kind: sphere}", ">= 0.05 - at `not_listed`"),
        ("mines:\n - {diameter_m: 1}", "missing required field `kind`"),
        ("- sphere", "got list; expected"),
    ],
)
def test_what_is_wrong_with_a_list_is_said_with_file_and_key(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=r"^confirm.targets mines.yaml: .*" + words) as caught:
        parse_targets(text, "confirm.targets mines.yaml")
    assert "List the mines expected" in str(caught.value)


def test_text_that_is_no_yaml_is_refused_with_its_line() -> None:
    with pytest.raises(UsageError, match="line 3"):
        parse_targets("mines:\n - {kind: sphere}\n - {kind: [", "mines.yaml")


def test_a_list_that_is_not_there_is_named() -> None:
    with pytest.raises(UsageError, match=r"confirm.targets: the list /nowhere/mines.yaml cannot be read"):
        configured_targets("/nowhere/mines.yaml")
