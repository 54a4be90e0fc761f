"""The newest record is whole in its files at any moment; the history has what changed."""

from __future__ import annotations

import logging
import resource
from pathlib import Path

import pytest

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.shell.health.files import HEALTH, HISTORY, HealthFiles, read_health
from tests.auv_mcm.shell.health.measurements import LATER, WELL, record

ILL = LATER._replace(has_kernels=False)


def test_the_newest_record_is_in_the_session_and_where_systemd_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, runtime = tmp_path / "session", tmp_path / "run"
    session.mkdir()
    runtime.mkdir()
    monkeypatch.setenv("RUNTIME_DIRECTORY", f"{runtime}:/run/other")
    files = HealthFiles(session)
    files.write(record(ILL), 0.0)
    files.write(record(), 5.0)
    assert read_health(session / HEALTH) == read_health(runtime / HEALTH) == record()
    assert (runtime / HEALTH).stat().st_mode & 0o777 == 0o644
    files.close()
    assert list(runtime.iterdir()) == []
    assert (session / HEALTH).exists()


def test_the_history_has_each_change_and_one_record_a_minute(tmp_path: Path) -> None:
    files = HealthFiles(tmp_path)
    for second in range(0, 180, 5):
        files.write(record(ILL if 100 <= second < 110 else LATER, utc_s=float(second)), float(second))
    kept = [line.count(b"no_kernels") for line in (tmp_path / HISTORY).read_bytes().splitlines()]
    assert kept == [0, 0, 1, 0, 0]  # at 0, 60, 100, 110 and 170 s


def test_a_record_that_a_kill_or_a_full_disk_cut_off_spoils_no_other(tmp_path: Path) -> None:
    whole, history = record().to_json() + b"\n", tmp_path / HISTORY
    history.write_bytes(whole + whole[:100])
    files = HealthFiles(tmp_path)
    files.write(record(), 0.0)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2 * len(whole) + 100, limits[1]))
    try:
        files.write(record(), 60.0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    files.write(record(), 65.0)
    assert history.read_bytes() == 3 * whole


def test_a_disk_that_takes_nothing_costs_one_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    files = HealthFiles(tmp_path / "gone")
    with caplog.at_level(logging.WARNING):
        files.write(record(), 0.0)
        files.write(record(), 5.0)
    assert [entry.message.partition(":")[0] for entry in caplog.records] == ["health is not on disk"]


def test_a_full_disk_keeps_no_record_from_monitors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    HealthFiles(tmp_path / "gone").write(record(), 0.0)
    assert read_health(tmp_path / HEALTH) == record()


def test_what_is_no_record_is_refused_with_its_place(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"health\.json: No such file or directory\. Name a session's folder"):
        read_health(tmp_path / HEALTH)
    for text in (b"", b"{", b"[]", record(WELL, WELL).to_json().replace(b'"boot"', b"1").replace(b'"normal"', b"1")):
        (tmp_path / HEALTH).write_bytes(text)
        with pytest.raises(BadInputError, match=r"health\.json holds no record of health"):
            read_health(tmp_path / HEALTH)
