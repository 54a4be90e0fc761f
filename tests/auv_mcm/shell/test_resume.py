"""A session that was cut off goes on at the next start: the same contacts, each announced once under its number."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from auv_mcm.records import SourceEvent
from auv_mcm.settings.config import Config, ServiceConfig
from auv_mcm.shell.checkpoint import Keeping, newest_checkpoint
from auv_mcm.shell.event_spool import EventSpool
from auv_mcm.shell.journal import Journal
from auv_mcm.shell.perception_chain import MakePipeline
from auv_mcm.shell.service import Service
from auv_mcm.shell.session import open_session
from tests.auv_mcm.shell import fake_pipelines as fake
from tests.auv_mcm.shell.service_runs import Ports, ids, journal, summary
from tests.manual_clock import ManualClock


class Run(NamedTuple):
    folder: Path
    said: list[str]


def events(first: int, stop: int) -> list[SourceEvent]:
    return [event for number in range(first, stop) for event in (fake.navigation(number), fake.ping(number))]


def service_of(
    folder: Path,
    given: Sequence[SourceEvent],
    say: Callable[[str], None],
    make: MakePipeline = fake.Base,
    *,
    mission: str = "",
    stop_within_s: float = 60.0,
) -> Service:
    config = Config(mission=mission, service=ServiceConfig(output_directory=str(folder), stop_within_s=stop_within_s))
    return Service(config, Ports(given), console=say, make_pipeline=make)


def serve(
    folder: Path, given: Sequence[SourceEvent], *, mission: str = "", say: Callable[[str], None] | None = None
) -> Run:
    """Serve given events and end in order once they are with perception."""
    said: list[str] = []

    async def run() -> Path:
        service = service_of(folder, given, say or said.append, mission=mission)
        asyncio.get_running_loop().call_later(0.3, service.stop)
        return await service.run()

    return Run(asyncio.run(run()), said)


PROGRAM = """
import asyncio, os, signal, sys
from pathlib import Path
from tests.auv_mcm.shell import fake_pipelines as fake, test_resume

def say(line):
    print(line, flush=True)
    if sys.argv[2] in line:
        os.killpg(0, signal.SIGKILL)

if __name__ == "__main__":
    test_resume.killed_in(Path(sys.argv[1]), say)
"""


def killed_in(folder: Path, say: Callable[[str], None]) -> None:
    """Serve 20 pings and end in order, unless `say` kills all processes."""

    async def run() -> None:
        service = service_of(folder, events(0, 20), say)
        asyncio.get_running_loop().call_later(0.3, service.stop)
        await service.run()

    asyncio.run(run())


def kill(folder: Path, at_line: str) -> list[str]:
    """Run a service and kill it, and its perception, as it says a line; return what it said."""
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(folder), at_line],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        check=False,
    )
    assert process.returncode == -signal.SIGKILL
    return process.stdout.splitlines()


def test_a_session_killed_on_the_way_goes_on_and_announces_each_contact_once(tmp_path: Path) -> None:
    before = kill(tmp_path, "C0009")
    after = serve(tmp_path, events(20, 40))
    assert len(list(tmp_path.glob("session-*"))) == 1
    expected = [f"C{number:04d}" for number in (*range(0, 40, 3), 9999)]
    assert ids(after.folder) == journal(after.folder) == expected
    lines = [line.split()[1] for line in (*before, *after.said) if line.startswith("contact")]
    assert lines == expected
    assert summary(after.folder)["pings"] == 40
    assert len(json.loads((after.folder / "coverage.geojson").read_bytes())["features"]) == 14
    assert not (after.folder / "state").exists()
    assert (after.folder / "recording-2").is_dir()


def cut_off(folder: Path, given: Sequence[SourceEvent], at_line: str, make: MakePipeline = fake.Base) -> Path:
    """Serve events and end at once, as after a second signal, when a line comes; return the session's folder."""

    async def run() -> None:
        def say(line: str) -> None:
            if at_line in line:
                running.cancel()

        running = asyncio.ensure_future(service_of(folder, given, say, make).run())
        await asyncio.wait({running})
        assert running.cancelled()

    asyncio.run(run())
    return (folder / "latest").resolve()


EXPECTED = [f"C{number:04d}" for number in (*range(0, 24, 3), 9999)]


def test_a_session_cut_off_twice_goes_on_from_its_checkpoints_with_all_that_was_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("auv_mcm.shell.service.Keeping", partial(Keeping, every_s=0.0))
    let_go: list[tuple[int, int]] = []  # the events up to which the spool forgets, and those in the checkpoint before

    def forget(spool: EventSpool, number: int, forget: Callable[[EventSpool, int], None] = EventSpool.forget) -> None:
        names = sorted(path.stem for path in (tmp_path / "latest" / "state").glob("checkpoint-*"))
        let_go.append((number, int(names[-2][-12:]) if len(names) > 1 else 0))
        forget(spool, number)

    monkeypatch.setattr(EventSpool, "forget", forget)

    async def run(given: Sequence[SourceEvent], n_contacts: int) -> None:
        running = asyncio.ensure_future(service_of(tmp_path, given, lambda line: None, fake.Unlikely).run())
        state = tmp_path / "latest" / "state"
        before = newest_checkpoint(state)
        async with asyncio.timeout(60.0):
            while newest_checkpoint(state) <= before or len(journal(tmp_path / "latest")) < n_contacts:
                await asyncio.wait({running}, timeout=0.01)
        running.cancel()
        await asyncio.wait({running})

    asyncio.run(run(events(0, 12), 4))
    asyncio.run(run(events(12, 18), 6))
    newest = max((tmp_path / "latest" / "state").glob("checkpoint-*"))
    assert all(forgotten <= before for forgotten, before in let_go)
    newest.write_bytes(b"torn: the one before serves")
    after = serve(tmp_path, events(18, 24))
    assert ids(after.folder) == journal(after.folder) == EXPECTED
    covered = json.loads((after.folder / "coverage.geojson").read_bytes())["features"]
    assert [feature["properties"]["tile"] for feature in covered] == [*range(0, 24, 3)]
    totals = summary(after.folder)
    assert (totals["pings"], totals["navigation_samples"], totals["duration_s"]) == (24, 24, 23.0)
    assert "contacts_in_journal" not in [notice["code"] for notice in totals["notices"]]


def test_what_a_power_cut_left_of_the_files_is_gone_on_with(tmp_path: Path) -> None:
    folder = cut_off(tmp_path, events(0, 12), "C0006")
    with (folder / "contacts.jsonl").open("ab") as file:
        file.write(b'{"time":"2026-')
    for name in ("events-000001.bin", "records.bin"):
        with (folder / "state" / name).open("ab") as file:
            file.write(b"\x07" * 100)
    after = serve(tmp_path, events(12, 24))
    assert (after.folder.resolve(), ids(after.folder), journal(after.folder)) == (folder, EXPECTED, EXPECTED)


def test_a_session_on_a_memory_card_without_links_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(link: Path, target: str) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted", str(link))  # as FAT does

    monkeypatch.setattr(Path, "symlink_to", refuse)
    for folder in ("session-19990101T000000Z", "session-of-yesterday"):
        (tmp_path / folder).mkdir()
    cut_off(tmp_path, events(0, 12), "C0006")
    assert not (tmp_path / "latest").exists()
    (session,) = tmp_path.glob("session-20*Z")
    session.with_suffix(".zip").write_bytes(b"an archive of it")
    after = serve(tmp_path, events(12, 24))
    assert after.folder == session
    assert ids(after.folder) == journal(after.folder) == EXPECTED
    assert [path.name for path in tmp_path.glob(".*")] == []


def test_a_link_that_does_not_get_its_name_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(new: Path, old: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("auv_mcm.shell.latest_session.os.replace", full)
    session = open_session(tmp_path, Config(), ManualClock(), may_resume=False)
    assert list(tmp_path.iterdir()) == [session.folder]


def take_nothing(disk: pytest.MonkeyPatch, folder: Path, number: int) -> None:
    """Have the disk of a folder refuse new folders, and files to be written."""
    error = OSError(number, os.strerror(number))

    def mkdir(path: Path, *mode: int) -> None:
        raise error

    def open_(path: str | Path, flags: int, *rest: int, really: Callable[..., int] = os.open, **of: int | None) -> int:
        if flags & (os.O_WRONLY | os.O_RDWR) and str(path).startswith(str(folder)):
            raise error
        return really(path, flags, *rest, **of)

    disk.setattr("os.mkdir", mkdir)
    disk.setattr("os.open", open_)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS])
def test_a_session_goes_on_while_its_disk_takes_nothing_and_has_all_its_results_once_it_does(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut off before, or, on a full disk, a new one."""
    said: list[str] = []
    is_cut_off = number == errno.EROFS
    if is_cut_off:
        with (cut_off(tmp_path, events(0, 12), "C0006") / "contacts.jsonl").open("ab") as file:
            file.write(b'{"time":"2026-')
    with monkeypatch.context() as disk:

        def say(line: str) -> None:
            said.append(line)
            if "C0018" in line:
                disk.undo()

        take_nothing(disk, tmp_path, number)
        after = serve(tmp_path, events(12 if is_cut_off else 0, 24), say=say)
    assert ids(after.folder) == journal(after.folder) == EXPECTED
    assert len(list(tmp_path.glob("session-*"))) == 1
    counters = summary(after.folder)["counters"]
    assert counters["service.journal_failed"] > 0
    assert counters["service.not_spooled"] > 0
    assert any("session_stopped" in line for line in said), "the recording"
    assert is_cut_off or said[0].startswith("notice session_not_kept: ")


@pytest.mark.parametrize("has_room_for_names", [False, True])
def test_a_session_begun_on_a_full_disk_is_kept_once_there_is_room(
    has_room_for_names: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("auv_mcm.shell.service._REMEMBER_S", 0.01)

    async def run() -> None:
        def say(line: str) -> None:
            if "C0009" in line:
                disk.undo()

        running = asyncio.ensure_future(service_of(tmp_path, events(0, 12), say).run())
        async with asyncio.timeout(20.0):
            while not [*tmp_path.glob("latest/state/service.json")]:
                await asyncio.wait({running}, timeout=0.01)
        assert journal(tmp_path / "latest") == EXPECTED[:4], "numbers that a restart must not give to others"
        running.cancel()
        await asyncio.wait({running})

    with monkeypatch.context() as disk:
        if has_room_for_names:
            disk.setattr("os.fsync", full)
        else:
            take_nothing(disk, tmp_path, errno.ENOSPC)
        asyncio.run(run())
    after = serve(tmp_path, events(12, 24))
    assert len(list(tmp_path.glob("session-*"))) == 1
    assert any("session_resumed" in notice["code"] for notice in summary(after.folder)["remarks"])
    assert ids(after.folder) == journal(after.folder) == EXPECTED, "no number is another contact's"


def test_a_session_on_a_full_disk_leaves_one_that_began_at_the_same_time_of_the_clock_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A computer without a battery begins at the same time again."""
    before = open_session(tmp_path, Config(), ManualClock(), may_resume=False)
    take_nothing(monkeypatch, tmp_path, errno.ENOSPC)
    session = open_session(tmp_path, Config(), ManualClock(), may_resume=True)
    assert session.notices[-1].code == "session_not_kept"
    assert session.folder != before.folder
    assert session.memory.started_s != before.memory.started_s


def test_contacts_whose_events_are_lost_keep_their_numbers_to_themselves(tmp_path: Path) -> None:
    folder = cut_off(tmp_path, events(0, 12), "C0006")
    (folder / "state" / "events-000001.bin").write_bytes(b"")
    after = serve(tmp_path, events(12, 24))
    assert summary(after.folder)["counters"]["fake.reserved"] == 6
    assert [notice["code"] for notice in summary(after.folder)["notices"]] == ["contacts_in_journal"]
    assert "C0000, C0003, C0006" in summary(after.folder)["notices"][0]["text"]


def test_announced_contacts_whose_record_is_damaged_come_from_the_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bad block in the records, and another one in a line of the journal."""
    folder = cut_off(tmp_path, events(0, 12), "C0009")
    journal_path = folder / "contacts.jsonl"
    data = journal_path.read_bytes()
    at = data.index(b'"coordinates"', data.index(b'"C0003"'))
    journal_path.write_bytes(data[:at] + bytes(4) + data[at + 4 :])
    monkeypatch.setattr("auv_mcm.contacts.contact_store.ContactStore.unreadable", lambda store: [0, 6])
    after = serve(tmp_path, events(12, 24))
    assert after.folder.resolve() == folder
    assert ids(after.folder) == EXPECTED
    features = json.loads((after.folder / "contacts.geojson").read_bytes())["features"]
    journalled = {
        feature["properties"]["id"]: feature["properties"]["p_mine"]
        for feature in features
        if "journalled" in feature["properties"]["reasons"]
    }
    assert journalled == {"C0000": 0.25, "C0006": 0.25}
    (notice,) = summary(after.folder)["notices"]
    assert notice["code"] == "contacts_in_journal"
    assert notice["text"].startswith("C0000, C0006 were announced")


@pytest.mark.parametrize("why", ["it is 13 h old", "its configuration is another one"])
def test_a_session_that_cannot_go_on_is_left_and_that_is_said(why: str, tmp_path: Path) -> None:
    folder = cut_off(tmp_path, events(0, 9), "C0006")
    if why.startswith("it is"):
        for path in (folder / "state").iterdir():
            os.utime(path, (path.stat().st_mtime - 13 * 3600 - 60,) * 2)
    after = serve(tmp_path, events(12, 24), mission="another" if "configuration" in why else "")
    assert after.folder.resolve() != folder
    said = " ".join(after.said)
    assert why in said
    assert "auv-mcm report" in said


def test_a_stop_that_comes_before_all_is_worked_off_leaves_the_rest_to_the_next_start(tmp_path: Path) -> None:
    """Perception has much to do at its end, so that the stop cannot wait for it."""
    said: list[str] = []

    async def run() -> Path:
        def say(line: str) -> None:
            said.append(line)
            if "C0009" in line:
                service.stop()

        service = service_of(tmp_path, events(0, 12), say, fake.BusyAtItsEnd, stop_within_s=3.0)
        return await service.run()

    folder = asyncio.run(run())
    assert ids(folder) == journal(folder) == EXPECTED[:4]
    assert "The next start goes on with the session" in said[-1]
    assert ids(serve(tmp_path, events(12, 24)).folder) == EXPECTED


def test_a_session_that_goes_on_is_not_taken_for_one_that_has_ended(tmp_path: Path) -> None:
    """Its first run was stopped and wrote results; those who read them would miss what came since."""
    folder = cut_off(tmp_path, events(0, 12), "C0006")
    assert (folder / "summary.json").exists()
    kill(tmp_path, "C0012")
    assert (tmp_path / "latest").resolve() == folder
    assert not (folder / "summary.json").exists()


def test_a_contact_that_goes_to_the_journal_as_the_stop_ends_the_mission_is_announced_and_among_the_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    service: Service
    loop: asyncio.AbstractEventLoop
    said: list[str] = []
    is_closing = threading.Event()

    def append(journal: Journal, records: Iterable[Any], append: Callable[..., None] = Journal.append) -> None:
        records = list(records)
        if "C0009" in str(records):
            loop.call_soon_threadsafe(service.stop)
            is_closing.wait()
        append(journal, records)

    def report(*states: str) -> None:
        if "STOPPING=1" in states:
            is_closing.set()

    async def run() -> Path:
        nonlocal service, loop
        service = service_of(tmp_path, events(0, 12), said.append, stop_within_s=3.0)
        loop = asyncio.get_running_loop()
        return await service.run()

    monkeypatch.setattr(Journal, "append", append)
    monkeypatch.setattr("auv_mcm.shell.service.report", report)
    folder = asyncio.run(run())
    assert ids(folder) == journal(folder) == EXPECTED[:4]
    assert sum("C0009 new" in line for line in said) == 1


def test_a_session_killed_once_its_last_contacts_are_announced_is_over(tmp_path: Path) -> None:
    """What lies in the last tile would otherwise be a second contact of the longer session."""
    kill(tmp_path, "C9999")
    folder = (tmp_path / "latest").resolve()
    assert journal(folder)[-2:] == ["C0018", "C9999"]
    after = serve(tmp_path, events(20, 40))
    assert after.folder.resolve() != folder
    assert f"auv-mcm report {folder}" in " ".join(after.said)


def test_a_stop_while_perception_hangs_at_its_start_does_not_wait_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAILED_ONCE", str(tmp_path / "failed"))

    async def run() -> Path:
        service = service_of(tmp_path, events(0, 12), print, fake.HangingAtItsStartOnce, stop_within_s=3.0)
        service.stop()
        return await service.run()

    folder = asyncio.run(run())
    assert "perception.restarted" not in summary(folder)["counters"]
    assert ids(folder) == []
    assert ids(serve(tmp_path, events(12, 24)).folder) == EXPECTED


def test_sessions_that_begin_as_a_clock_shows_the_same_have_numbers_of_their_own(tmp_path: Path) -> None:
    """The vehicle would take contacts of the second session for those of the first."""
    sessions = [open_session(tmp_path, Config(), ManualClock(), may_resume=False) for _ in range(3)]
    assert len({int(session.memory.started_s) for session in sessions}) == len({each.folder for each in sessions}) == 3
    assert (tmp_path / "latest").resolve() == sessions[-1].folder


def test_what_a_kill_left_half_written_is_gone_when_the_session_goes_on(tmp_path: Path) -> None:
    folder = cut_off(tmp_path, events(0, 12), "C0006")
    left = [folder / name / f".{number:016x}.new" for number, name in enumerate((".", "snippets", "state"))]
    for path in left:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"the first ha")
    after = serve(tmp_path, events(12, 24))
    assert (after.folder.resolve(), ids(after.folder)) == (folder, EXPECTED)
    assert [path for path in left if path.exists()] == []


def test_results_outlast_a_power_cut_while_the_state_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file system may give up the rest of it before what says that there is one."""

    def remove_most(state: Path) -> None:
        for path in state.iterdir():
            if path.name != "service.json":
                path.unlink()
        raise OSError(errno.EIO, "Input/output error")

    with monkeypatch.context() as at_the_end:
        at_the_end.setattr("auv_mcm.shell.recovery.shutil.rmtree", remove_most)
        before = serve(tmp_path, events(0, 24)).folder.resolve()
    results = {name: (before / name).read_bytes() for name in ("contacts.geojson", "coverage.geojson", "summary.json")}
    after = serve(tmp_path, events(24, 36))
    assert after.folder.resolve() != before
    assert {name: (before / name).read_bytes() for name in results} == results
    assert [line for line in after.said if "cut off" in line] == []


def test_a_session_with_all_its_results_is_not_said_to_be_cut_off(tmp_path: Path) -> None:
    """A kill came behind the summary, before its state was removed."""
    kill(tmp_path, "C9999")
    folder = (tmp_path / "latest").resolve()
    (folder / "summary.json").write_text("{}")
    after = serve(tmp_path, events(20, 40))
    assert after.folder.resolve() != folder
    assert [line for line in after.said if "cut off" in line] == []
