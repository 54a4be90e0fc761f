"""Nothing that only looks like a file is read from, and nothing is written through a link."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.errors import BadInputError
from auv_mcm.safe_files import (
    open_for_append,
    open_regular,
    own_directory,
    read_regular,
    remove_unfinished,
    replacing,
    sync_directory,
)


def test_a_regular_file_is_read_also_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"content")
    (tmp_path / "link").symlink_to("a")
    for name in ("a", "link"):
        with open_regular(tmp_path / name) as file:
            assert file.read() == b"content"


@pytest.mark.parametrize("kind", ["pipe", "link to a pipe", "device"])
def test_what_is_no_regular_file_is_refused_at_once(kind: str, tmp_path: Path) -> None:
    path = Path("/dev/null") if kind == "device" else tmp_path / "log"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "link to a pipe":
        os.mkfifo(tmp_path / "pipe")
        path.symlink_to("pipe")
    with pytest.raises(BadInputError, match=f"{path} is not a regular file"):
        open_regular(path)


@pytest.mark.parametrize("name", ["a\0b", "\ud800"])
def test_a_name_that_no_file_can_have_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="is not a name that a file can have"):
        open_regular(tmp_path / name)


@given(n_bytes=st.integers(0, 3000), max_bytes=st.integers(0, 3000))
def test_a_file_is_read_whole_or_refused_by_its_size(
    n_bytes: int, max_bytes: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "sized"
    path.write_bytes(b"x" * n_bytes)
    if n_bytes <= max_bytes:
        assert read_regular(path, max_bytes) == b"x" * n_bytes
    else:
        with pytest.raises(BadInputError, match="is larger than"):
            read_regular(path, max_bytes)


def test_a_huge_file_is_refused_without_taking_its_room(tmp_path: Path) -> None:
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(BadInputError, match="larger than 4 KiB"):
        read_regular(tmp_path / "huge", 4096)


def test_a_directory_is_an_error_of_the_system(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError, match="Is a directory"):
        open_regular(tmp_path)


def test_a_file_exchanged_for_a_pipe_while_it_is_opened_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "log").write_bytes(b"content")
    look = os.stat

    def exchanged(path: Path) -> os.stat_result:
        status = look(path)
        path.unlink()
        os.mkfifo(path)
        return status

    with monkeypatch.context() as racing:
        racing.setattr("auv_mcm.safe_files.os.stat", exchanged)
        with pytest.raises(BadInputError, match="not a regular file"):
            open_regular(tmp_path / "log")


def test_a_new_file_has_a_name_of_its_own_until_it_is_whole_and_failing_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"old")
    names: set[str] = set()

    def fail_on_the_way() -> None:
        with replacing(path) as file:
            file.write(b"a piece")
            names.update({entry.name for entry in tmp_path.iterdir()} - {"a"})
            raise RuntimeError

    for _ in range(3):
        with pytest.raises(RuntimeError):
            fail_on_the_way()
    assert len(names) == 3
    assert {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()} == {"a": b"old"}


def test_a_full_disk_names_the_file_that_it_does_not_take(tmp_path: Path) -> None:
    path = tmp_path / "contacts.csv"
    with pytest.raises(OSError, match="No space left") as full, replacing(path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert (full.value.errno, full.value.filename) == (errno.ENOSPC, str(path))


def test_a_file_that_cannot_take_its_place_is_named_by_the_name_that_was_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "contacts.csv"
    path.mkdir()
    with pytest.raises(IsADirectoryError) as taken, replacing(path) as file:
        file.write(b"whole")
    assert (taken.value.filename, [entry.name for entry in tmp_path.iterdir()]) == (str(path), ["contacts.csv"])


def test_a_directory_whose_names_cannot_be_kept_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(descriptor: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="Input/output") as lost:
        sync_directory(tmp_path)
    assert lost.value.filename == str(tmp_path)


def test_files_are_as_readable_as_the_umask_says(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        with replacing(tmp_path / "a") as file:
            file.write(b"x")
        open_for_append(tmp_path / "b").close()
    finally:
        os.umask(before)
    assert [(tmp_path / name).stat().st_mode & 0o777 for name in "ab"] == [0o640, 0o640]


def test_a_name_as_long_as_names_may_be_is_written(tmp_path: Path) -> None:
    with replacing(tmp_path / ("x" * 255)) as file:
        file.write(b"content")
    assert (tmp_path / ("x" * 255)).read_bytes() == b"content"


def test_a_directory_that_was_exchanged_after_it_was_opened_is_still_written_to(tmp_path: Path) -> None:
    with own_directory(tmp_path / "snippets") as directory:
        (tmp_path / "snippets").rename(tmp_path / "moved")
        (tmp_path / "other").mkdir()
        (tmp_path / "snippets").symlink_to("other")
        with replacing(Path("C1.png"), directory=directory) as file:
            file.write(b"picture")
    assert [path.name for path in (tmp_path / "other").iterdir()] == []
    assert (tmp_path / "moved" / "C1.png").read_bytes() == b"picture"


def test_a_journal_neither_follows_a_link_nor_waits_for_a_pipe(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("victim")
    os.mkfifo(tmp_path / "pipe")
    for name in ("link", "pipe"):
        with pytest.raises(OSError, match=name):
            open_for_append(tmp_path / name)
    assert not (tmp_path / "victim").exists()


def test_what_a_killed_process_left_unfinished_is_removed_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    (folder / "snippets").mkdir(parents=True)
    left = [folder / ".80a0f70f6dc685af.new", folder / "snippets" / ".00a0f70f6dc685a0.new"]
    own = [folder / "contacts.csv", folder / ".notes.new", folder / "80a0f70f6dc685af.new"]
    for path in (*left, *own):
        path.write_bytes(b"")
    remove_unfinished(folder)
    assert [path.exists() for path in (*left, *own)] == [False, False, True, True, True]
