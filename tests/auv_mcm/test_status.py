"""`auv-mcm status` shows the newest record, and says when it is too old to count on."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from auv_mcm.cli import main
from auv_mcm.commands import status
from auv_mcm.shell.health.files import HEALTH
from auv_mcm.shell.health.judge import Measured
from tests.auv_mcm.shell.health.measurements import LATER, record


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A session, of a computer where systemd runs no service."""
    monkeypatch.setattr(status, "_RUNTIME", tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "auv-mcm-out" / "latest"
    folder.mkdir(parents=True)
    return folder


def put(session: Path, now: Measured = LATER, age_s: float = 0.0) -> None:
    (session / HEALTH).write_bytes(record(now, utc_s=time.time() - age_s).to_json())


def test_the_last_session_is_shown_without_a_word(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    put(session)
    assert main(["status"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("auv-mcm 1.2.3  normal  0 s ago")
    assert "THIS IS OLD" not in shown


def test_the_service_of_systemd_comes_before_the_last_session(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    put(session)
    (tmp_path / "run").mkdir()
    put(tmp_path / "run", LATER._replace(has_kernels=False))
    assert main(["status"]) == 0
    assert capsys.readouterr().out.startswith("auv-mcm 1.2.3  degraded")


def test_json_is_the_record_with_its_state(session: Path, capsysbinary: pytest.CaptureFixture[bytes]) -> None:
    put(session)
    assert main(["status", "--json", str(session)]) == 0
    shown = json.loads(capsysbinary.readouterr().out)
    assert (shown["state"], shown["version"]) == ("normal", "1.2.3")


@pytest.mark.parametrize(
    ("now", "age_s", "said"),
    [
        (LATER._replace(pings=100), 0.0, "perception_stalled: pings wait"),
        (LATER, 60.0, "THIS IS OLD: "),
        (LATER, -60.0, "THIS IS OLD: "),
    ],
)
def test_a_fault_and_a_record_that_is_too_old_are_exit_code_4(
    now: Measured, age_s: float, said: str, session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    put(session, now, age_s)
    assert main(["status", str(session)]) == 4
    assert said in capsys.readouterr().out


def test_it_is_shown_again_and_again_until_interrupted(
    session: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    looks: list[float] = []

    def wait(seconds: float) -> None:
        looks.append(seconds)
        if len(looks) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(time, "sleep", wait)
    put(session)
    assert main(["status", "--watch"]) == 130
    assert capsys.readouterr().out.count("auv-mcm 1.2.3  normal") == 3


def test_a_session_without_a_record_is_said_in_a_line(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", str(session)]) == 2
    assert "Name a session's folder, or start the service" in capsys.readouterr().err
