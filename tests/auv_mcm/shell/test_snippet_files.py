"""Pictures of contacts are whole, and nobody else's files are touched."""

from __future__ import annotations

from pathlib import Path

import pytest

from auv_mcm.errors import UsageError
from auv_mcm.shell.snippet_files import Snippets, make_results_directory, write_snippets
from tests.make.disks import full


def test_snippets_of_an_earlier_replay_go_and_other_files_stay(tmp_path: Path) -> None:
    write_snippets(tmp_path, {"C1": b"1", "C2": b"2"})
    (tmp_path / "snippets" / "notes.txt").write_bytes(b"mine")
    write_snippets(tmp_path, {"C2": b"3"})
    assert {path.name: path.read_bytes() for path in (tmp_path / "snippets").iterdir()} == {
        "C2.png": b"3",
        "notes.txt": b"mine",
    }


def test_files_that_are_no_pictures_of_contacts_stay_among_the_snippets(tmp_path: Path) -> None:
    write_snippets(tmp_path, {"C1": b"1"})
    snippets = tmp_path / "snippets"
    (snippets / "C9photo.png").write_bytes(b"mine")
    (snippets / "C8.png").symlink_to("C9photo.png")
    (snippets / "C7.png").mkdir()
    write_snippets(tmp_path, {"C2": b"2"})
    assert {path.name for path in snippets.iterdir()} == {"C2.png", "C9photo.png", "C8.png", "C7.png"}
    assert (snippets / "C9photo.png").read_bytes() == b"mine"


def test_a_link_in_the_place_of_snippets_is_refused_and_nothing_behind_it_is_touched(tmp_path: Path) -> None:
    other, folder = tmp_path / "other", tmp_path / "out"
    other.mkdir()
    folder.mkdir()
    (other / "C9.png").write_bytes(b"mine")
    (folder / "snippets").symlink_to(other)
    with pytest.raises(UsageError, match="snippets is a link"):
        make_results_directory(folder)
    with pytest.raises(OSError, match="Not a directory"):
        write_snippets(folder, {"C1": b"1"})
    with pytest.raises(OSError, match="Not a directory"):
        Snippets(folder).write({"C1": b"1"})
    assert {path.name: path.read_bytes() for path in other.iterdir()} == {"C9.png": b"mine"}


def test_pictures_that_a_full_disk_does_not_take_are_written_later_and_none_is_left_in_pieces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    snippets = Snippets(tmp_path)
    snippets.write({"C1": b"one"})

    with monkeypatch.context() as disk:
        disk.setattr("auv_mcm.safe_files.os.replace", full)
        for pictures in ({"C2": b"two", "C3": b"three"}, {"C2": b"again"}):
            with pytest.raises(OSError, match="No space"):
                snippets.write(pictures)
        assert [path.name for path in (tmp_path / "snippets").iterdir()] == ["C1.png"]
    snippets.write()
    assert {path.name: path.read_bytes() for path in (tmp_path / "snippets").iterdir()} == {
        "C1.png": b"one",
        "C2.png": b"again",
        "C3.png": b"three",
    }
