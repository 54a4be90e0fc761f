"""Every line of the journal is whole and durable, whatever the disk takes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from auv_mcm.records import NAN
from auv_mcm.shell.journal import Journal
from tests.make.disks import full


def test_journal_lines_survive_a_second_opening(tmp_path: Path) -> None:
    for number in range(2):
        journal = Journal(tmp_path / "j.jsonl")
        journal.append([{"n": number}, {"n": NAN}])
        journal.close()
    lines = (tmp_path / "j.jsonl").read_text("utf-8").splitlines()
    assert [json.loads(line)["n"] for line in lines] == [0, None, 1, None]


def lines_of(path: Path) -> list[Any]:
    return [json.loads(line) for line in path.read_bytes().decode().splitlines()]


@pytest.mark.parametrize("n_records", [1, 400])
def test_a_full_disk_tears_no_journal_line_and_loses_none(
    n_records: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "j.jsonl"
    path.write_text('{"number":0}\n')  # of a run before
    journal = Journal(path)
    with monkeypatch.context() as disk:
        disk.setattr("auv_mcm.shell.journal.os.fsync", full)
        with pytest.raises(OSError, match="No space"):
            journal.append([{"number": 1, "text": "x" * 50}] * n_records)
        assert lines_of(path) == [{"number": 0}]
    journal.append([{"number": 2}])
    journal.close()
    assert [line["number"] for line in lines_of(path)] == [0, *[1] * n_records, 2]
