"""However the service, its source or perception ends: what was found is kept, and what is left undone is reported."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from auv_mcm.errors import AuvMcmError, BadInputError, HardwareError
from auv_mcm.settings.config import Config, ServiceConfig
from auv_mcm.shell.journal import Journal
from auv_mcm.shell.perception_chain import MakePipeline
from auv_mcm.shell.perception_messages import PerceptionError
from auv_mcm.shell.service import Service
from sim_replay.logs.session_parts import recordings_of
from sim_replay.logs.session_reader import Session
from tests.auv_mcm.shell import fake_pipelines as fake
from tests.auv_mcm.shell.service_runs import RESULTS, Events, Ports, ids, journal, mission, serve, serve_ports, summary

ROOT = Path(__file__).resolve().parents[3]


def test_stop_works_off_what_is_queued_and_loses_no_contact(tmp_path: Path) -> None:
    async def run() -> Path:
        config = Config(service=ServiceConfig(output_directory=str(tmp_path)))

        def console(line: str) -> None:
            if "C0009" in line:
                service.stop()

        service = Service(config, Events(mission(30), endless=True), console=console, make_pipeline=fake.Base)
        return await service.run()

    results = asyncio.run(run())
    pings = summary(results)["pings"]
    assert ids(results) == [f"C{number:04d}" for number in (*range(0, pings, 3), 9999)]
    assert pings >= 10


@pytest.mark.parametrize(
    ("error", "raised"), [(BadInputError("bad log"), BadInputError), (ValueError("defect"), HardwareError)]
)
def test_what_came_before_a_source_failed_is_worked_off(
    tmp_path: Path, error: Exception, raised: type[AuvMcmError]
) -> None:
    with pytest.raises(raised, match=str(error)):
        serve(tmp_path, Events([*mission(10), error]))
    assert len(ids(tmp_path / "latest")) == 5


@pytest.mark.parametrize("make", [fake.Dying, fake.Failing])
def test_contacts_announced_before_perception_failed_are_kept(
    tmp_path: Path, make: MakePipeline, capfd: pytest.CaptureFixture[str]
) -> None:
    lines: list[str] = []
    with pytest.raises(PerceptionError) as caught:
        serve(tmp_path, Events(mission(300)), make, lines.append)
    assert caught.value.exit_code == 4
    announced = [line.split()[1] for line in lines]
    assert announced == ids(tmp_path / "latest") == journal(tmp_path / "latest") == ["C0000", "C0003"]
    files = {path.name for path in (tmp_path / "latest").iterdir()}
    assert files <= RESULTS, "no other file"


def test_contacts_lost_with_perception_are_reported_to_be_in_the_recording(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    lines: list[str] = []
    config = Config(service=ServiceConfig(output_directory=str(tmp_path)))
    with pytest.raises(PerceptionError):
        asyncio.run(Service(config, Ports(mission(300)), console=lines.append, make_pipeline=fake.Dying).run())
    (line,) = [line for line in lines if line.startswith("notice contacts_in_recording")]
    command = shlex.split(line.partition("run: ")[2])
    assert command[:2] == ["auv-mcm", "report"]
    (recording,) = recordings_of(Path(command[2]))
    assert len(list(Session(recording))) > 5
    assert "contacts_in_recording" in [notice["code"] for notice in summary(tmp_path / "latest")["notices"]]
    assert not [line for line in started_again(tmp_path) if "contacts_in_recording" in line], "it was already reported"


def test_a_restart_after_a_kill_says_how_to_get_what_was_not_announced(tmp_path: Path) -> None:
    killed = serve_ports(tmp_path, Ports(mission(10)))
    (killed / "summary.json").unlink()
    with contextlib.closing(Journal(killed / "contacts.jsonl")):
        assert not [line for line in started_again(tmp_path) if "contacts_in_recording" in line], "it still runs"
    (tmp_path / "latest").unlink()
    (tmp_path / "latest").symlink_to(killed.name)
    (line,) = [line for line in started_again(tmp_path) if line.startswith("notice contacts_in_recording")]
    assert line.endswith(f"To get them run: auv-mcm report {killed}")
    assert not [line for line in started_again(tmp_path) if "contacts_in_recording" in line], "once is enough"


def started_again(folder: Path) -> list[str]:
    lines: list[str] = []
    serve(folder, Events(mission(1)), console=lines.append)
    return lines


# A program that serves an endless mission: python -c PROGRAM FOLDER PIPELINE
PROGRAM = """
import logging, sys
from tests.auv_mcm.shell import fake_pipelines as fake
from tests.auv_mcm.shell import service_runs as t
from auv_mcm.shell import serve
from auv_mcm.settings.config import Config, ServiceConfig

logging.basicConfig(stream=sys.stdout, format="%(message)s", level=logging.INFO)
serve.open_source = lambda uri, config, clock: t.Events(t.mission(30), endless=True)
config = Config(service=ServiceConfig(output_directory=sys.argv[1], source="replay:///none", health_period_s=3600))
try:
    serve.serve(config, make_pipeline=getattr(fake, sys.argv[2]))
except KeyboardInterrupt:
    sys.exit(130)
"""


def program(folder: Path, pipeline: str, wrapper: Sequence[str] = ()) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [*wrapper, sys.executable, "-u", "-c", PROGRAM, str(folder), pipeline]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


def read_until(process: subprocess.Popen[str], word: str) -> None:
    assert process.stdout is not None
    seen = []
    for line in process.stdout:
        seen.append(line)
        if word in line:
            return
    pytest.fail(f"'{word}' never came:\n{''.join(seen)}")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_to_the_whole_process_group_ends_in_order(tmp_path: Path, number: signal.Signals) -> None:
    with program(tmp_path, "Base") as process:
        read_until(process, "C0027")
        os.killpg(process.pid, number)  # as a terminal and a service manager do: the worker gets it too
        output, _ = process.communicate(timeout=60)
    assert process.returncode == 0, output
    assert ids(tmp_path / "latest") == [f"C{number:04d}" for number in (*range(0, 30, 3), 9999)]
    assert "leaked" not in output


def test_a_service_started_by_nohup_outlives_its_terminal(tmp_path: Path) -> None:
    with program(tmp_path, "Base", ["nohup"]) as process:
        read_until(process, "C0027")
        process.send_signal(signal.SIGHUP)
        process.send_signal(signal.SIGTERM)
        output, _ = process.communicate(timeout=60)
    assert process.returncode == 0, output
    assert "SIGTERM: finishing" in output, "the first signal that it heeds"


def test_killing_all_processes_at_once_leaves_no_shared_memory_and_no_other_file_behind(tmp_path: Path) -> None:
    with program(tmp_path, "Stuck") as process:
        read_until(process, "C0027")
        assert len(group(process.pid)) >= 2, "perception is a process of its own"
        shared = shared_memory(process.pid)
        # as a supervisor that kills a control group does, and a shortage of memory
        os.killpg(process.pid, signal.SIGKILL)
        output, _ = process.communicate(timeout=60)
    assert [path for path in shared if path.exists()] == []
    assert {path.name for path in (tmp_path / "latest").iterdir()} <= {
        *("contacts.jsonl", "snippets", "state", "health.json", "health.jsonl")
    }
    assert "leaked" not in output


def test_killing_the_service_alone_ends_perception_and_is_no_news_of_leaks(tmp_path: Path) -> None:
    with program(tmp_path, "Base") as process:
        read_until(process, "C0027")
        shared = shared_memory(process.pid)
        process.kill()
        output, _ = process.communicate(timeout=60)  # ends with the last process that holds the pipe
    assert [path for path in shared if path.exists()] == []
    assert "leaked" not in output
    while group(process.pid):  # on their way out, as they let go of the pipe
        time.sleep(0.01)


def shared_memory(leader: int) -> set[Path]:
    """Where the shared memory of a process group lies, or lay."""
    lines = [
        line
        for pid in group(leader)
        for line in Path(f"/proc/{pid}/maps").read_text().splitlines()
        if "/dev/shm/" in line
    ]
    return {Path(line[line.index("/dev/shm/") :].removesuffix(" (deleted)")) for line in lines}


def group(leader: int) -> list[int]:
    """Processes of a group that still run."""
    members = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, process_group = status.read_text().rpartition(")")[2].split()[:3]
            if int(process_group) == leader and state != "Z":
                members.append(int(status.parent.name))
    return members


def test_a_second_signal_ends_at_once_with_the_journal_whole(tmp_path: Path) -> None:
    with program(tmp_path, "Stuck") as process:
        read_until(process, "C0027")
        os.killpg(process.pid, signal.SIGTERM)
        read_until(process, "stopping")
        os.killpg(process.pid, signal.SIGTERM)
        output, _ = process.communicate(timeout=60)
    assert process.returncode == 130, output
    assert journal(tmp_path / "latest") == [f"C{number:04d}" for number in range(0, 30, 3)]
