"""A recording is followed while it is written, over several files, to the session's end."""

from __future__ import annotations

import threading
from pathlib import Path

from auv_mcm.clock import Stamp
from drivers.recording.session_layout import PartEnd, PortDescription, Recorded, SessionDescription
from drivers.recording.session_writer import SessionWriter
from sim_replay.view.growing_session import GrowingSession

SESSION = SessionDescription(
    version="1",
    started=Stamp(0, 0),
    config_yaml="",
    ports=(PortDescription(name="sonar", uri="tcp://127.0.0.1:1", device="jsf"),),
)


def chunk(number: int) -> Recorded:
    return Recorded("sonar", "in", Stamp(number, number), b"%d" % number)


def follow(folder: Path) -> tuple[threading.Thread, list[Recorded | PartEnd], threading.Event, threading.Semaphore]:
    stop, came = threading.Event(), threading.Semaphore(0)
    session, found = GrowingSession(folder, stop), list[Recorded | PartEnd]()

    def run() -> None:
        for recorded in session:
            found.append(recorded)
            came.release()

    thread = threading.Thread(target=run)
    thread.start()
    return thread, found, stop, came


def test_what_is_written_comes_and_the_summary_ends_it(tmp_path: Path) -> None:
    thread, found, _, came = follow(tmp_path)
    writer = SessionWriter(tmp_path / "recording", SESSION, file_flushes=2, reserve_bytes=0)
    for number in range(6):
        writer.add(chunk(number))
        writer.flush()  # every second one begins a new file
        assert came.acquire(timeout=20)
    assert len(list((tmp_path / "recording").iterdir())) > 1
    writer.close()
    (tmp_path / "summary.json").write_text("{}")
    thread.join(20)
    assert not thread.is_alive()
    assert found == [chunk(number) for number in range(6)]


def test_a_session_that_was_gone_on_with_is_followed_into_its_next_recording(tmp_path: Path) -> None:
    first = SessionWriter(tmp_path / "recording", SESSION, reserve_bytes=0)
    first.add(chunk(0))
    first.flush()
    first.abandon()  # as a power cut leaves it
    thread, found, _, came = follow(tmp_path)
    assert came.acquire(timeout=20)
    second = SessionWriter(tmp_path / "recording-2", SESSION, reserve_bytes=0)
    second.add(chunk(1))
    second.flush()
    assert came.acquire(timeout=20)
    assert came.acquire(timeout=20)
    second.close()
    (tmp_path / "summary.json").write_text("{}")
    thread.join(20)
    assert found == [chunk(0), PartEnd(is_cut_off=True), chunk(1)]


def test_what_a_failing_disk_had_recorded_twice_comes_once(tmp_path: Path) -> None:
    writer = SessionWriter(tmp_path / "recording", SESSION, reserve_bytes=0)
    for number in (0, 1, 2):
        writer.add(chunk(number))
    writer.flush()
    writer.go_on(1)  # the disk did not say that it has the last two
    for number in (1, 2, 3):
        writer.add(chunk(number))
    writer.close()
    (tmp_path / "summary.json").write_text("{}")
    thread, found, _, _ = follow(tmp_path)
    thread.join(20)
    assert found == [chunk(number) for number in range(4)]


def test_following_ends_when_nobody_wants_it(tmp_path: Path) -> None:
    thread, found, stop, _ = follow(tmp_path)
    stop.set()
    thread.join(20)
    assert not thread.is_alive()
    assert found == []
