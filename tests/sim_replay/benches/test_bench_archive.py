"""The archive that a batch is killed on: its damage, and what counts as a difference."""

from __future__ import annotations

from pathlib import Path

import pytest

from auv_mcm.errors import BadInputError
from auv_mcm.settings.config import Config
from sim_replay.benches.archive import differences, make_archive
from sim_replay.logs.open_log import open_log


def test_so_many_logs_are_damaged_as_were_asked_for(tmp_path: Path) -> None:
    make_archive(tmp_path, 6, 3)
    logs = sorted(tmp_path.iterdir())
    unusable = []
    for log in logs:
        try:
            open_log(log, Config())
        except BadInputError:
            unusable.append(log.name)
    assert len(logs) == 6
    assert unusable == ["00001.xtf", "00003.xtf", "00005.xtf"]


@pytest.mark.parametrize("name", ["contacts.geojson", "a/.80a0f70f6dc685af.new"])
def test_a_file_that_is_missing_left_over_or_other_differs(name: str, tmp_path: Path) -> None:
    calm, killed = tmp_path / "calm", tmp_path / "killed"
    for folder in (calm, killed):
        (folder / "a").mkdir(parents=True)
        (folder / "a" / "contacts.csv").write_text("same")
        (folder / "a" / "summary.json").write_text(folder.name)
    assert differences(calm, killed) == []
    (killed / name).write_text("left")
    assert differences(calm, killed) == [name]
    (calm / name).write_text("other")
    assert differences(calm, killed) == [name]
