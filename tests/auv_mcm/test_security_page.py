"""What auv_mcm/docs/security.md says of the whole source holds for every file of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from auv_mcm.settings.config import Config
from auv_mcm.shell.health import endpoint

ROOT = Path(__file__).resolve().parents[2]
ON_THE_VEHICLE = sorted(
    path
    for package in ("auv_mcm", "drivers")
    for path in (ROOT / package).rglob("*.py")
    if "docs" not in path.relative_to(ROOT).parts
)


@pytest.mark.parametrize(
    ("claim", "against"),
    [
        ("nothing that is read is executed", r"\beval\(|\bexec\(|\bmarshal\b|allow_pickle=True|unsafe_load|FullLoader"),
        ("there is no shell", r"shell=True|os\.system|os\.popen|\bsubprocess\b"),
    ],
)
def test_what_the_page_says_of_the_code_that_runs_on_the_vehicle(claim: str, against: str) -> None:
    guilty = [
        path.relative_to(ROOT).as_posix() for path in ON_THE_VEHICLE if re.search(against, path.read_text("utf-8"))
    ]
    assert guilty == [], claim


def test_only_the_state_of_a_session_is_unpickled_and_by_a_reader_that_refuses_what_is_no_state() -> None:
    """What that reader refuses is tested beside it."""
    names = [path.name for path in ON_THE_VEHICLE if re.search(r"\bpickle\b", path.read_text("utf-8"))]
    assert names == ["frozen_state.py"]
    text = (ROOT / "auv_mcm" / "frozen_state.py").read_text("utf-8")
    assert not re.search(r"pickle\.loads?\(", text)
    assert "def find_class" in text


def test_only_one_module_opens_files_for_writing() -> None:
    writing = re.compile(r"write_text\(|write_bytes\(|open\([^)]*[\"'][wax]b?[\"']|O_CREAT")
    names = [path.relative_to(ROOT).as_posix() for path in ON_THE_VEHICLE if writing.search(path.read_text("utf-8"))]
    # A file that a person names on the command line is made there, by `write_new`; the recorder appends to files of its
    # own folder.
    assert names == ["auv_mcm/commands/__init__.py", "auv_mcm/safe_files.py", "drivers/recording/session_writer.py"]


def test_the_one_tcp_port_that_is_listened_on_is_for_monitors_of_this_computer() -> None:
    listening = re.compile(r"\.listen\(|start_server|create_server|start_unix_server")
    (path,) = [path for path in ON_THE_VEHICLE if listening.search(path.read_text("utf-8"))]
    assert path.relative_to(ROOT).as_posix() == "auv_mcm/shell/health/endpoint.py"
    assert "start_server(self._serve, _HOST," in path.read_text("utf-8")
    assert endpoint._HOST == "127.0.0.1"
    assert Config().service.health_port == 0, "and only where a configuration asks for it"


def test_what_is_opened_at_the_end_of_a_wire_is_only_what_the_page_lists() -> None:
    binding = [path.name for path in ON_THE_VEHICLE if ".bind(" in path.read_text("utf-8")]
    assert binding == ["udp.py"]


def test_every_test_and_scenario_that_the_page_names_is_there() -> None:
    page = (ROOT / "auv_mcm" / "docs" / "security.md").read_text("utf-8")
    tests = {path.name: path.read_text("utf-8") for path in (ROOT / "tests").rglob("test_*.py")}
    files = set(re.findall(r"`(test_\w+\.py)`", page))
    assert files
    assert files <= set(tests)
    functions = set(re.findall(r"`(test_\w+)`", page))
    assert functions <= set(re.findall(r"^def (test_\w+)\(", "\n".join(tests.values()), re.MULTILINE))
    scenarios = {path.stem for path in (ROOT / "sim_replay" / "hil" / "scenarios").glob("*.yaml")}
    assert {name for names in re.findall(r"`auv-mcm hil ([\w ]+)`", page) for name in names.split()} <= scenarios


# What is read past the door, which names no file of a person: the kernel's, the service's own state, the package's own.
PAST_THE_DOOR = {
    "auv_mcm/program.py": "the sources of the package",
    "auv_mcm/shell/checkpoint.py": "the state of a session",
    "auv_mcm/shell/event_spool.py": "the state of a session",
    "auv_mcm/shell/journal_contacts.py": "the journal of a session",
    "auv_mcm/shell/recovery.py": "the state of a session and its journals",
    "auv_mcm/shell/health/measure.py": "the kernel",
    "auv_mcm/shell/perception.py": "the kernel",
    "drivers/port_check.py": "the kernel",
    "sim_replay/fitting/cascade/farm.py": "the sources of the package",
    "sim_replay/fitting/verifier/mill.py": "missions that it flew",
    "sim_replay/report/page.py": "a part of the package",
    "sim_replay/view/server.py": "a part of the package",
}


def test_one_module_opens_every_file_that_a_person_names() -> None:
    """Benches, studies, fakes and HIL read what they wrote into folders of their own."""
    reading = re.compile(
        r"""\.read_text\(|\.read_bytes\(|np\.fromfile|imread\(|open\([^)]*["']rb?["']|\.open\(newline"""
    )
    shipped = re.compile(r"resources\.files|_SHIPPED|_DEFAULT")
    own = ("docs", "benches", "studies", "fakes", "hil")
    names = {
        path.relative_to(ROOT).as_posix()
        for package in ("auv_mcm", "drivers", "sim_replay")
        for path in (ROOT / package).rglob("*.py")
        if not set(own) & set(path.relative_to(ROOT).parts)
        if any(reading.search(line) and not shipped.search(line) for line in path.read_text("utf-8").splitlines())
    }
    assert names - {"auv_mcm/safe_files.py"} == set(PAST_THE_DOOR)
