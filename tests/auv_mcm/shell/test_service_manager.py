"""What the service reports to the service manager that started it, as systemd does with `Type=notify`."""

from __future__ import annotations

import os
import secrets
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from auv_mcm.shell.service_manager import report, watchdog_s
from tests.auv_mcm.shell.test_service_ends import PROGRAM, ROOT

LONGEST_WAIT_S = 60.0


@contextmanager
def manager(address: str) -> Iterator[socket.socket]:
    """The manager's end of the socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(address)
        heard.settimeout(LONGEST_WAIT_S)
        yield heard


def states(heard: socket.socket) -> list[str]:
    return heard.recv(4096).decode().split("\n")


def states_until(heard: socket.socket, wanted: str) -> list[str]:
    found: list[str] = []
    while wanted not in found:
        found += states(heard)
    return found


def test_the_service_reports_that_it_is_ready_alive_and_stopping(tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NOTIFY_SOCKET": address, "WATCHDOG_USEC": "300000"}
    environment.pop("WATCHDOG_PID", None)
    command = [sys.executable, "-c", PROGRAM, str(tmp_path / "results"), "Base"]
    with manager(address) as heard, subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL) as process:
        before = states_until(heard, "READY=1")
        assert "WATCHDOG=1" not in before, "the watchdog runs from readiness on"
        assert f"STATUS=results in {(tmp_path / 'results' / 'latest').resolve()}" in before
        for _ in range(3):
            states_until(heard, "WATCHDOG=1")
        process.send_signal(signal.SIGTERM)
        states_until(heard, "STOPPING=1")
        assert process.wait(LONGEST_WAIT_S) == 0
    assert (tmp_path / "results" / "latest" / "summary.json").is_file()


def test_an_abstract_socket_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"auv-mcm-{secrets.token_hex(8)}"
    monkeypatch.setenv("NOTIFY_SOCKET", f"@{name}")
    with manager(f"\0{name}") as heard:
        report("READY=1", "STATUS=sound")
        assert states(heard) == ["READY=1", "STATUS=sound"]


def test_a_manager_that_is_gone_costs_a_warning_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    report("WATCHDOG=1")
    assert f"takes no state at {tmp_path}/gone" in caplog.text


@pytest.mark.parametrize("address", ["", "relative/path"])
def test_nothing_is_sent_without_a_manager(
    address: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    report("READY=1")
    assert not caplog.text


OURS = "ours"


@pytest.mark.parametrize(
    ("period", "watched", "expected"),
    [
        ("2000000", OURS, 2.0),
        ("2000000", "", None),
        ("2000000", "1", None),
        ("", OURS, None),
        ("soon", OURS, None),
        ("0", OURS, None),
    ],
)
def test_the_watchdog_is_fed_only_where_it_watches_this_process(
    period: str, watched: str, expected: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", period)
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()) if watched == OURS else watched)
    assert watchdog_s() == expected
