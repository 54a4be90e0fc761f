"""What systemd itself finds in the unit and in the files beside it; skipped where its tools are not installed."""

from __future__ import annotations

import shutil
import subprocess
import sys
from configparser import RawConfigParser
from pathlib import Path

import pytest

SYSTEMD = Path(__file__).parents[2] / "deploy" / "systemd"
UNIT = SYSTEMD / "auv-mcm.service"
LARGEST_EXPOSURE = 3.0  # of 10, as 'systemd-analyze security' counts


def tool(name: str) -> str:
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed here")
    return path


def run(*command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.fixture(params=["", "real-time.conf"], ids=["alone", "with real-time.conf"])
def unit(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The unit, by itself and with the drop-in; it starts a program that is there, for systemd looks."""
    path = tmp_path / UNIT.name
    path.write_text(UNIT.read_text().replace("/opt/auv-mcm/current/bin/auv-mcm", sys.executable))
    if request.param:
        (tmp_path / f"{UNIT.name}.d").mkdir()
        shutil.copy(SYSTEMD / request.param, tmp_path / f"{UNIT.name}.d")
    return path


def test_systemd_finds_nothing_wrong_in_the_unit(unit: Path) -> None:
    found = run(tool("systemd-analyze"), "verify", unit)
    about_it = [line for line in found.stderr.splitlines() if "auv-mcm" in line or str(unit.parent) in line]
    assert (found.returncode, about_it) == (0, [])


def test_systemd_finds_nothing_wrong_in_the_unit_of_a_serial_can_adapter(tmp_path: Path) -> None:
    text = (SYSTEMD.parent / "can" / "auv-mcm-slcan@.service").read_text()
    for program in ("/usr/bin/slcand", "/usr/sbin/ip"):  # systemd looks whether they are there
        text = text.replace(program, sys.executable)
    path = tmp_path / "auv-mcm-slcan@ttyACM0.service"
    path.write_text(text)
    found = run(tool("systemd-analyze"), "verify", path)
    assert (found.returncode, [line for line in found.stderr.splitlines() if "slcan" in line]) == (0, [])


def test_the_unit_exposes_the_vehicle_little(unit: Path) -> None:
    threshold = str(round(LARGEST_EXPOSURE * 10.0))
    found = run(tool("systemd-analyze"), "security", "--offline=true", f"--threshold={threshold}", unit)
    assert found.returncode == 0, found.stdout


def test_the_unit_runs_without_root_is_watched_and_started_again_but_not_for_ever() -> None:
    unit = RawConfigParser(strict=False)
    unit.optionxform = str  # type: ignore[assignment,method-assign]  # its own way to keep capitals
    unit.read(UNIT)
    service = unit["Service"]
    assert (service["Type"], service["User"], service["Restart"]) == ("notify", "auvmcm", "on-failure")
    assert float(service["WatchdogSec"]) > 0.0
    assert int(unit["Unit"]["StartLimitBurst"]) > 0
    assert service["RestartPreventExitStatus"] == "2", "a configuration that is rejected stays so"


def test_the_user_of_the_unit_is_made_in_the_group_of_serial_ports(tmp_path: Path) -> None:
    (tmp_path / "etc").mkdir()
    done = run(tool("systemd-sysusers"), f"--root={tmp_path}", SYSTEMD / "auv-mcm.sysusers.conf")
    assert done.returncode == 0, done.stderr
    name, _, _, _, _, home, shell = (tmp_path / "etc" / "passwd").read_text().splitlines()[0].split(":")
    assert (name, home, Path(shell).name) == ("auvmcm", "/var/lib/auv-mcm", "nologin")
    groups = [line.split(":") for line in (tmp_path / "etc" / "group").read_text().splitlines()]
    assert [members for group, _, _, members in groups if group == "dialout"] == ["auvmcm"]


@pytest.mark.parametrize(("age", "kept"), [("30d", ["latest", "session-1"]), ("0", ["latest"])])
def test_old_sessions_are_removed_and_young_ones_stay(age: str, kept: list[str], tmp_path: Path) -> None:
    results = tmp_path / "var" / "lib" / "auv-mcm" / "results"
    (results / "session-1" / "recording").mkdir(parents=True)
    (results / "session-1" / "recording" / "sonar.mcap").touch()
    (results / "session-1" / "summary.json").touch()
    (results / "latest").symlink_to("session-1")
    rules = tmp_path / "rules.conf"
    rules.write_text((SYSTEMD / "auv-mcm.tmpfiles.conf").read_text().replace("30d", age))
    done = run(tool("systemd-tmpfiles"), "--clean", f"--root={tmp_path}", rules)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in results.iterdir()) == kept
