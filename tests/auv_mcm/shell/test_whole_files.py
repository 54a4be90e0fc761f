"""Files are whole or absent, and no link stands in for them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from auv_mcm.records import NAN
from auv_mcm.shell.journal import Journal
from auv_mcm.shell.snippet_files import make_results_directory, write_snippets
from auv_mcm.shell.whole_files import make_directory, write_file, write_json
from tests.make.disks import full


def test_a_file_is_replaced_whole_and_leaves_nothing_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.bin"
    write_file(path, b"old")
    write_file(path, b"new")
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.bin"]
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_file(path, b"newer")
    assert path.read_bytes() == b"new"


def test_json_holds_null_for_what_is_not_a_number(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"a": NAN, "b": [1.0, math.inf], "c": {"d": (2, "é")}})
    text = (tmp_path / "a.json").read_text("utf-8")
    assert json.loads(text) == {"a": None, "b": [1.0, None], "c": {"d": [2, "é"]}}


def test_a_directory_is_made_with_its_parents_and_probed(tmp_path: Path) -> None:
    folder = make_directory(tmp_path / "a" / "b")
    assert folder.is_dir()
    assert list(folder.iterdir()) == []


def test_no_link_in_the_directory_of_the_results_is_followed(tmp_path: Path) -> None:
    victims, folder = tmp_path / "victims", tmp_path / "out"
    victims.mkdir()
    make_results_directory(folder)
    for name in (".writable", ".contacts.csv.new", "contacts.csv", "j.jsonl", "snippets/C1.png"):
        victim = victims / name.replace("/", "-")
        victim.write_bytes(b"precious")
        (folder / name).symlink_to(victim)
    make_results_directory(folder)
    write_file(folder / "contacts.csv", b"new")
    write_snippets(folder, {"C1": b"picture"})
    with pytest.raises(OSError, match="symbolic links"):
        Journal(folder / "j.jsonl")
    assert {path.read_bytes() for path in victims.iterdir()} == {b"precious"}
    assert (folder / "contacts.csv").read_bytes() == b"new"
    assert not (folder / "contacts.csv").is_symlink()
    assert (folder / "snippets" / "C1.png").read_bytes() == b"picture"
