"""Check a run of the real service between fake devices: its report, its exit code, and that no process outlives it."""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from auv_mcm.errors import HardwareError, SelfCheckError, UsageError
from sim_replay.commands import hil
from sim_replay.hil.mission_time import MissionTime
from sim_replay.results_folder import kept_alone
from tests.sim_replay.logs.xtf_logs import written

SHORT = """
about: a run that is hardly one
log: mission.xtf
run_s: 0.2
devices:
  nav: {device: pd6, link: serial}
service:
  service: {source: ports}
  ports:
    - {name: nav, link: '{nav}', device: pd6}
expectations:
  - {test: the service ends when requested to stop, expected: {is: exit_code}}
  - {test: pings come from nowhere, expected: {is: summary, key: pings, at_least: 1}}
"""
COMMAND = "import sys; from tests.hil import test_hil_runs as runs; sys.exit(runs.run(*sys.argv[1:]))"
PATIENCE_S = 60.0  # on a computer that has much else to do


def short(folder: Path, old: str = "", new: str = "") -> Path:
    """Write a scenario beside the log that it plays."""
    written(folder / "mission.xtf")
    path = folder / "short.yaml"
    path.write_text(SHORT.replace(old, new, 1), "utf-8")
    return path


def run(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    hil.add(parser.add_subparsers())
    parsed = parser.parse_args(["hil", *arguments])
    code: int = parsed.command(parsed)
    return code


def processes_with(text: str) -> list[int]:
    """Processes whose command line holds a text."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if text.encode() in path.read_bytes() and int(path.parent.name) != os.getpid():
                found.append(int(path.parent.name))
        except OSError:
            continue
    return found


def test_failed_expectations_are_printed_and_set_the_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SelfCheckError, match=r"short \(1 of 2; see .*short\)"):
        run(str(short(tmp_path)), "--out", str(tmp_path))
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[0] for row in rows if row.startswith(("passed", "FAILED"))] == ["passed", "FAILED"]
    verdicts = json.loads((tmp_path / "short" / "verdict.json").read_bytes())
    assert [verdict["passed"] for verdict in verdicts] == [True, False]
    suite = ElementTree.parse(tmp_path / "short" / "junit.xml").getroot()
    assert (suite.tag, suite.get("name"), suite.get("tests"), suite.get("failures")) == ("testsuite", "short", "2", "1")
    assert [case.get("name") for case in suite.iter("testcase")] == [verdict["test"] for verdict in verdicts]
    assert [failure.get("message") for failure in suite.iter("failure")] == [
        f"expected: {verdicts[1]['expected']}; found: {verdicts[1]['found']}"
    ]


def test_two_scenarios_of_one_name_would_overwrite_each_other(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    with pytest.raises(UsageError, match="'short' is given twice"):
        run(str(short(tmp_path)), str(short(tmp_path / "other")), "--out", str(tmp_path))


def test_a_folder_that_another_run_writes_to_is_refused(tmp_path: Path) -> None:
    (tmp_path / "short").mkdir()
    with kept_alone(tmp_path / "short"), pytest.raises(UsageError, match=r"another run writes to .*short"):
        run(str(short(tmp_path)), "--out", str(tmp_path))


def test_a_service_that_does_not_come_up_is_quoted_and_fails_its_scenario_and_no_other(tmp_path: Path) -> None:
    bad = short(tmp_path, "link: '{nav}', device: pd6", "link: '{nav}', device: nmea2000").rename(tmp_path / "bad.yaml")
    with pytest.raises(HardwareError, match=r"(?s)bad: the service ended before it was ready.*short \(1 of 2;"):
        run(str(bad), str(short(tmp_path)), "--out", str(tmp_path))
    assert not processes_with(str(tmp_path))
    (verdict,) = json.loads((tmp_path / "bad" / "verdict.json").read_bytes())
    assert re.search("ended before it was ready.*slcan", verdict["found"])
    (failure,) = ElementTree.parse(tmp_path / "bad" / "junit.xml").getroot().iter("failure")
    assert verdict["found"] in str(failure.get("message"))


def test_a_service_that_is_killed_on_the_way_is_started_again_and_goes_on_while_the_mission_waits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rule = "{is: line, matching: session_resumed, at_least: 1, at_most: 1}"
    path = short(tmp_path, "{is: summary, key: pings, at_least: 1}", rule)
    path.write_text(path.read_text("utf-8") + "restarts_s: [0.1]\nwaits: true\n", "utf-8")
    assert run(str(path), "--out", str(tmp_path)) == 0
    assert "FAILED" not in capsys.readouterr().out
    assert len(list((tmp_path / "short" / "results").glob("session-*"))) == 1


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_nothing_outlives_a_run_that_is_ended(number: signal.Signals, tmp_path: Path) -> None:
    path = short(tmp_path, "run_s: 0.2", "run_s: 600")
    arguments = [sys.executable, "-c", COMMAND, str(path), "--out", str(tmp_path)]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, (Path(__file__).resolve().parents[2], *filter(None, sys.path)))),
    }
    with subprocess.Popen(arguments, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        log = tmp_path / "short" / "service.log"
        wait_for(lambda: log.exists() and "ready: " in log.read_text("utf-8"))
        assert len(processes_with(str(tmp_path))) >= 3
        process.send_signal(number)
        process.wait(PATIENCE_S)
    wait_for(lambda: not processes_with(str(tmp_path)))
    assert not (tmp_path / "short" / "nav").is_symlink()


def wait_for(condition: Callable[[], bool]) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < until_s, "it took too long"
        time.sleep(0.1)


def test_mission_time_stands_still_while_the_computer_is_too_slow() -> None:
    time_of = MissionTime(100.0, [(105.0, 2.0), (110.0, 1.0)])
    assert [time_of.at(mono_s) for mono_s in (100.0, 103.0, 104.0, 105.0, 106.0, 109.5, 110.0, 112.0)] == [
        0,
        3,
        3,
        3,
        4,
        7,
        7,
        9,
    ]
