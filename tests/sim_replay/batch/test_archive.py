"""Logs found in folders and lists, and what is wrong with a source that holds none."""

from __future__ import annotations

from pathlib import Path

import pytest

from auv_mcm.errors import BadInputError, UsageError
from sim_replay.logs.archive import logs_of


def touch(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"{}")
    return path


def test_logs_of_all_folders_are_found_by_suffix_in_the_order_of_their_names(tmp_path: Path) -> None:
    for name in ("b/2.XTF", "a/1.jsf", "a/notes.pdf", "c.svlog", "d/e/f.mcap", "g.tif", "g.yaml", "picture.png"):
        touch(tmp_path / name)
    found = [log.name for log in logs_of(tmp_path, tmp_path / "out")]
    assert found == ["a/1.jsf", "b/2.XTF", "c.svlog", "d/e/f.mcap", "g.tif"]


def test_results_in_the_archive_itself_are_no_logs(tmp_path: Path) -> None:
    touch(tmp_path / "line.xtf")
    touch(tmp_path / "out" / "missions" / "line.xtf" / "part.mcap")
    assert [log.name for log in logs_of(tmp_path, tmp_path / "out")] == ["line.xtf"]


def test_folders_that_are_links_are_gone_through_once(tmp_path: Path) -> None:
    archive, disk = tmp_path / "archive", tmp_path / "disk"
    for folder in (archive / "day1", disk / "deep"):
        folder.mkdir(parents=True)
    (archive / "day1" / "a.xtf").touch()
    (disk / "deep" / "b.xtf").touch()
    (archive / "day2").symlink_to(disk)
    for link, target in (("again", disk), ("latest", archive / "day1"), ("up", tmp_path), ("deep", disk / "deep")):
        (archive / f"x-{link}").symlink_to(target)
    (disk / "back").symlink_to(archive)
    assert [log.name for log in logs_of(archive, tmp_path / "out")] == ["day1/a.xtf", "day2/deep/b.xtf"]


def test_a_list_names_logs_from_its_own_folder_whatever_their_suffix(tmp_path: Path) -> None:
    touch(tmp_path / "day1" / "line")
    listed = tmp_path / "lists" / "all.txt"
    listed.parent.mkdir()
    listed.write_text("\ufeff../day1/line\n# spring\n\n ../day1/missing.xtf \n")  # with the mark of Windows' editors
    logs = logs_of(listed, tmp_path / "out")
    assert [(log.name, log.path) for log in logs] == [
        ("line", tmp_path / "day1" / "line"),
        ("missing.xtf", tmp_path / "day1" / "missing.xtf"),
    ]


def test_a_source_without_logs_is_rejected_with_what_to_give(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="No such file"):
        logs_of(tmp_path / "missing", tmp_path / "out")
    with pytest.raises(
        BadInputError, match=r"holds no log \(\.jsf, \.mcap, \.sdf, \.sl2, \.sl3, \.son, \.svlog, \.xtf\)"
    ):
        logs_of(tmp_path, tmp_path / "out")
    picture = tmp_path / "photo.jpg"
    picture.write_bytes(b"\xff\xd8\xff\xe0")
    with pytest.raises(UsageError, match="not text in UTF-8"):
        logs_of(picture, tmp_path / "out")
    twice = tmp_path / "twice.txt"
    twice.write_text("a.xtf\n./a.xtf\n")
    with pytest.raises(UsageError, match=r"a\.xtf twice"):
        logs_of(twice, tmp_path / "out")
