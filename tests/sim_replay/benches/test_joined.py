"""The bench of joined replays cuts sessions as it says, and sees what differs from the undisturbed twin."""

from __future__ import annotations

from pathlib import Path

import pytest

from auv_mcm.cli import main
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Ping, SourceEvent
from sim_replay.hil import joined_twin
from tests.sim_replay.logs.sonar_logs import run_of, write_session


class Counting(Pipeline):
    """A chain that counts pings and looks at nothing: the bench's own work is what is tested."""

    n_pings = 0

    def feed(self, event: SourceEvent) -> list[object]:  # type: ignore[override]
        type(self).n_pings += isinstance(event, Ping)
        return []


def test_kills_and_power_cuts_are_joined_and_every_difference_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(joined_twin, "Pipeline", Counting)
    write_session(run_of("jsf"), tmp_path / "session" / "recording")
    command = ["bench", "soak", "--joined", "12", "--recording", str(tmp_path / "session"), "--seed", "3"]
    assert main(command) == 0
    assert Counting.n_pings > 2 * 200
    assert "10 kills and 2 power cuts in 2 sessions, 0 not as undisturbed" in capsys.readouterr().out
    twin = joined_twin._twin
    monkeypatch.setattr(joined_twin, "_twin", lambda *args: list(twin(*args))[:-1])
    assert main(command) == 5
    assert "events differ" in capsys.readouterr().out


def test_a_recording_has_to_be_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "soak", "--joined", "3"]) == 2
    assert "--recording" in capsys.readouterr().err
