"""A disk that is full, broken or gone: every contact is still announced, and nothing is lost without a word."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from auv_mcm.errors import HardwareError
from auv_mcm.shell.perception_messages import PerceptionError
from auv_mcm.shell.recovery import BALLAST_BYTES, Ballast
from tests.auv_mcm.shell import fake_pipelines as fake
from tests.auv_mcm.shell.service_runs import RESULTS, Events, ids, journal, mission, serve, summary
from tests.make.disks import full


def test_contacts_are_announced_even_if_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    monkeypatch.setattr("auv_mcm.shell.journal.Journal.append", full)
    results = serve(tmp_path, Events(mission(4)), console=lines.append)
    assert [line.split()[1] for line in lines] == ids(results)
    assert summary(results)["counters"]["service.journal_failed"] == 3


def test_what_a_full_disk_does_not_take_is_counted_reported_and_still_among_the_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full_of_pictures(new: Path, old: Path, replace: Callable[..., None] = os.replace, **folders: int) -> None:
        if old.suffix == ".png":
            full()
        replace(new, old, **folders)

    with monkeypatch.context() as disk:
        disk.setattr("auv_mcm.safe_files.os.replace", full_of_pictures)
        results = serve(tmp_path, Events(mission(30)), fake.SeeingOnFullDisk)
    assert ids(results) == ["C00001"]
    counters = summary(results)["counters"]
    assert counters["service.kept_in_memory"] == counters["perception.kept_in_memory"] == 1
    assert counters["service.snippets_failed"] > 0
    assert any("pictures of contacts are missing" in record.getMessage() for record in caplog.records)


def test_a_disk_that_gives_nothing_back_is_counted_and_every_contact_is_announced_and_in_the_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> bytes:
        raise OSError(5, "Input/output error")

    lines: list[str] = []
    monkeypatch.setattr("auv_mcm.contacts.record_file.os.pread", broken)
    results = serve(tmp_path, Events(mission(4)), console=lines.append)
    announced = [line.split()[1] for line in lines if line.startswith("contact ")]
    assert announced == journal(results) == ["C0000", "C0003", "C9999"]
    assert ids(results) == announced, "from the journal, in place of the disk"
    assert any("contacts_in_journal" in line for line in lines)
    assert summary(results)["counters"]["service.unreadable"] > 0


def test_pictures_are_there_when_a_contact_is_announced_and_outlive_perception(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def console(line: str) -> None:
        if line.startswith("contact"):
            seen.append((tmp_path / "latest" / "snippets" / f"{line.split()[1]}.png").read_bytes()[:4])

    seen: list[bytes] = []
    with pytest.raises(PerceptionError):
        serve(tmp_path, Events(mission(30)), fake.SeeingThenDying, console)
    assert set(seen) == {b"\x89PNG"}
    assert [path.name for path in (tmp_path / "latest" / "snippets").iterdir()] == ["C00001.png"]


def test_a_disk_too_full_for_one_result_takes_the_others_and_the_error_names_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full_for_the_largest(new: Path, old: Path, replace: Callable[..., None] = os.replace, **folders: int) -> None:
        if old.name in ("contacts.geojson", "coverage.geojson"):
            full()
        replace(new, old, **folders)

    monkeypatch.setattr("auv_mcm.safe_files.os.replace", full_for_the_largest)
    with pytest.raises(
        HardwareError, match=r"contacts\.geojson, coverage\.geojson cannot be written.*No space.*contacts\.jsonl"
    ):
        serve(tmp_path, Events(mission(30)))
    results = tmp_path / "latest"
    assert len((results / "contacts.csv").read_text().splitlines()) == 12
    assert [notice["code"] for notice in summary(results)["notices"]] == ["results_missing"]
    assert not [path for path in results.iterdir() if path.suffix == ".new"]


def test_all_results_are_written_before_one_is_synced_and_the_summary_comes_when_all_are_on_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One by one a slow disk takes longer for them than a stop may."""
    done: list[str] = []

    def replace(new: Path, old: Path, replace: Callable[..., None] = os.replace, **folders: int) -> None:
        done.append(f"write {old.name}")
        replace(new, old, **folders)

    def sync(descriptor: int, sync: Callable[[int], None] = os.fsync) -> None:
        done.append(f"sync {Path(os.readlink(f'/proc/self/fd/{descriptor}')).name}")
        sync(descriptor)

    monkeypatch.setattr("auv_mcm.safe_files.os.replace", replace)
    monkeypatch.setattr("auv_mcm.safe_files.os.fsync", sync)
    serve(tmp_path, Events(mission(30)))
    written = {name for name in RESULTS if name.endswith((".geojson", ".csv", ".kml"))}
    last = max(done.index(f"write {name}") for name in written)
    summary_at = done.index("write summary.json")
    assert not {f"sync {name}" for name in written} & set(done[:last])
    assert {f"sync {name}" for name in (*written, (tmp_path / "latest").resolve().name)} <= set(done[last:summary_at])


def test_space_is_held_for_the_results_and_pictures_come_after_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    class Watched(Ballast):
        def release(self) -> None:
            done.append(f"release {self.n_bytes}")
            super().release()

    def replace(new: Path, old: Path, replace: Callable[..., None] = os.replace, **folders: int) -> None:
        if old.suffix == ".png" and not any(entry.startswith("release") for entry in done):
            raise OSError(28, "No space left on device")
        if old.name not in ("latest", "health.json") and old.parent.name != "state":
            done.append(old.name)
        replace(new, old, **folders)

    monkeypatch.setattr("auv_mcm.shell.service.Ballast", Watched)
    monkeypatch.setattr("auv_mcm.safe_files.os.replace", replace)
    serve(tmp_path, Events(mission(30)), fake.Seeing)
    assert done[:3] == [f"release {BALLAST_BYTES}", "contacts.geojson", "contacts.csv"]
    assert done[-1] == "C00001.png"


def test_results_are_written_although_their_folder_was_removed_on_the_way(tmp_path: Path) -> None:
    def remove(line: str) -> None:
        if "C0003" in line:
            shutil.rmtree((tmp_path / "latest").resolve())

    results = serve(tmp_path, Events(mission(30)), console=remove)
    assert len(ids(results)) == 11
    assert summary(results)["contacts"] == 11
