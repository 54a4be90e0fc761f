"""Results without a named folder get one of their own, and find their logs again wherever both were moved together."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from sim_replay.results_folder import default_results, resolved_log


def write_results(folder: Path, *logs: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "summary.json").write_text(json.dumps({"logs": [{"path": str(log)} for log in logs]}))
    return folder


def test_a_folder_is_named_after_the_first_log(tmp_path: Path) -> None:
    assert default_results([Path("surveys/line 7.xtf"), Path("b.xtf")], tmp_path) == tmp_path / "line 7-results"


def test_a_recording_is_named_after_its_session(tmp_path: Path) -> None:
    recording = tmp_path / "session-20260504" / "recording-2"
    recording.mkdir(parents=True)
    assert default_results([recording], tmp_path).name == "session-20260504-results"


def test_results_of_the_same_log_are_taken_again_and_nothing_else_is_touched(tmp_path: Path) -> None:
    log, other = tmp_path / "a.xtf", tmp_path / "far" / "a.xtf"
    other.parent.mkdir()
    log.touch()
    other.touch()
    first = write_results(tmp_path / "a-results", log)
    assert default_results([log], tmp_path) == first
    assert default_results([other], tmp_path).name == "a-results-2"
    (tmp_path / "a-results-2").mkdir()
    assert default_results([other], tmp_path).name == "a-results-2", "it is empty"
    (tmp_path / "a-results-2" / "notes.txt").touch()
    assert default_results([other], tmp_path).name == "a-results-3"


def test_a_log_is_found_after_log_and_results_moved_together(tmp_path: Path) -> None:
    log = tmp_path / "old" / "logs" / "a.xtf"
    log.parent.mkdir(parents=True)
    log.touch()
    results = tmp_path / "old" / "out" / "results"
    results.mkdir(parents=True)
    entry = {"path": str(log), "relative": "../../logs/a.xtf"}
    assert resolved_log(entry, results) == log
    shutil.move(tmp_path / "old", tmp_path / "new")
    found = resolved_log(entry, tmp_path / "new" / "out" / "results")
    assert found.samefile(tmp_path / "new" / "logs" / "a.xtf")
    with pytest.raises(FileNotFoundError):  # another mission's, of the same name
        resolved_log({**entry, "bytes": 1}, tmp_path / "new" / "out" / "results")
    (tmp_path / "new" / "logs" / "a.xtf").unlink()
    with pytest.raises(FileNotFoundError, match=r"a\.xtf"):
        resolved_log(entry, tmp_path / "new" / "out" / "results")
    for damaged in ({}, None, {"path": 3, "relative": 4}):
        with pytest.raises(FileNotFoundError):
            resolved_log(damaged, results)
