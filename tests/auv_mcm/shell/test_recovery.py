"""Disk space held for the results is there, gets smaller on a small disk, and leaves nothing behind.

A session goes on where its state fits."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from auv_mcm.settings.config import parse_config
from auv_mcm.shell.recovery import Ballast, read_announced, session_kind
from auv_mcm.source import AnnouncedContact


def test_ballast_is_space_on_the_disk_without_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[int] = []

    def allocate(descriptor: int, start: int, n_bytes: int, really: object = os.posix_fallocate) -> None:
        assert callable(really)
        really(descriptor, start, n_bytes)
        taken.append(os.fstat(descriptor).st_blocks * 512)

    monkeypatch.setattr("auv_mcm.shell.recovery.os.posix_fallocate", allocate)
    ballast = Ballast(tmp_path, 1 << 20)
    assert ballast.n_bytes == 1 << 20 <= taken[0]
    assert list(tmp_path.iterdir()) == []
    ballast.release()
    ballast.release()


def test_a_small_disk_gives_what_it_has_and_a_full_one_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def of_free(free_bytes: int) -> int:
        def allocate(descriptor: int, start: int, n_bytes: int) -> None:
            if n_bytes > free_bytes:
                raise OSError(28, "No space left on device")

        monkeypatch.setattr("auv_mcm.shell.recovery.os.posix_fallocate", allocate)
        ballast = Ballast(tmp_path, 1 << 20)
        ballast.release()
        return ballast.n_bytes

    assert [of_free(1 << 20), of_free(300_000), of_free(10_000)] == [1 << 20, 1 << 18, 0]
    assert Ballast(tmp_path / "not there").n_bytes == 0


PORTS = """
ports:
  - {name: sonar, link: "tcp://192.168.2.92:51200", device: ping_protocol, sonar: {range_m: 30}}
  - {name: nav, link: "udp://0.0.0.0:6001?peer=192.168.2.10:6002", device: nmea0183, navigation: {priority: 1}}
"""


@pytest.mark.parametrize(
    ("was", "is_now", "goes_on"),
    [
        ("peer=192.168.2.10:6002", "peer=192.168.2.11:7002", True),
        ("udp://0.0.0.0:6001?peer=192.168.2.10:6002", "serial:///dev/ttyUSB0?baud=38400", True),
        ("range_m: 30", "range_m: 40", False),
        ("priority: 1", "priority: 1, lever_arm_m: [1, 0, 0]", False),
        ("nmea0183", "pd6", False),
    ],
)
def test_a_changed_address_does_not_end_a_session(was: str, is_now: str, goes_on: bool) -> None:
    before, after = parse_config(PORTS, "vehicle.yaml"), parse_config(PORTS.replace(was, is_now), "vehicle.yaml")
    assert before != after
    assert (session_kind(before) == session_kind(after)) == goes_on


@pytest.mark.parametrize(("line", "goes_on"), [("# another build", False), ("", True)])
def test_a_session_of_another_build_of_the_same_version_is_not_gone_on_with(
    line: str, goes_on: bool, tmp_path: Path
) -> None:
    ask = "from auv_mcm.shell.recovery import session_kind as k; from auv_mcm.settings.config import Config as C; "
    for package in ("auv_mcm", "drivers", "sim_replay"):
        leave_out = shutil.ignore_patterns("docs", "__pycache__")
        shutil.copytree(Path(__file__).parents[3] / package, tmp_path / package, ignore=leave_out)
    with (tmp_path / "auv_mcm/detect/suppress.py").open("a") as module:
        module.write(line)
    command = [sys.executable, "-c", ask + "print(k(C()))"]
    kind = subprocess.run(command, cwd=tmp_path, env={}, capture_output=True, text=True, check=True).stdout.strip()
    assert (kind == session_kind(parse_config("", "vehicle.yaml"))) == goes_on


def test_a_model_that_was_fitted_again_under_its_name_ends_a_session(tmp_path: Path) -> None:
    path = tmp_path / "odds.json"
    config = parse_config(f"confirm: {{odds: {path}}}", "vehicle.yaml")
    kinds = []
    for content in ("of yesterday", "of today", "of yesterday"):
        path.write_text(content)
        kinds.append(session_kind(config))
    path.unlink()
    assert kinds[0] == kinds[2]
    assert len({*kinds, session_kind(config)}) == 3


def test_what_was_announced_is_read_back_whatever_a_power_cut_or_a_bad_block_left_of_a_line(tmp_path: Path) -> None:
    def line(name: str, p_mine: float) -> str:
        contact = {"properties": {"id": name, "class": "clutter", "p_mine": p_mine}}
        return json.dumps({"event": 7, "contact": contact}, separators=(",", ":")) + "\n"

    journal = tmp_path / "contacts.jsonl"
    whole = line("C00001", 0.6) + line("C00001", 0.1) + line("C00003", 0.1).replace('"class":', '"class:')
    journal.write_text(whole + line("C00004", 0.9)[:-9])
    announced = read_announced(tmp_path)
    assert announced.contacts == {1: AnnouncedContact(2, 0.6), 3: AnnouncedContact(1, 1.0)}
    assert announced.is_clutter == {"C00001": True, "C00003": False}
    assert journal.read_text() == whole
