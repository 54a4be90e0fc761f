"""Recording beside an event loop: nothing lost without a word, whatever the disk does and whenever the process dies."""

from __future__ import annotations

import errno
import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from auv_mcm.clock import Stamp
from auv_mcm.errors import UsageError
from drivers.recording.session_layout import Recorded, file_name
from drivers.recording.session_recorder import SessionRecorder
from drivers.recording.session_writer import DurableFile, SessionWriter
from sim_replay.logs.session_reader import Session
from tests.drivers.recording.session_samples import FullDisk, description, traffic

RECORD_FOR_EVER = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from tests.drivers.recording.session_samples import description, traffic
from drivers.recording.session_recorder import SessionRecorder
recorder = SessionRecorder(Path(sys.argv[1]), description(), file_bytes=40_000)
for chunk in traffic(1, 5_000):
    recorder.record(*chunk)
    print(recorder.counters["session.chunks_recorded"], flush=True)
    time.sleep(0.001)
"""


def n_bytes(chunks: list[Recorded]) -> int:
    return sum(len(chunk.data) for chunk in chunks)


def test_what_was_handed_over_is_recorded(tmp_path: Path) -> None:
    chunks = traffic(1, 500)
    recorder = SessionRecorder(tmp_path / "new" / "folder", description())
    for chunk in chunks:
        recorder.record(*chunk)
    recorder.close()
    assert list(session := Session(tmp_path / "new" / "folder")) == chunks
    assert session.description == description()
    assert recorder.counters == {"session.chunks_recorded": 500, "session.bytes_recorded": n_bytes(chunks)}
    assert recorder.take_notices() == []
    assert recorder.queued_bytes == 0


def test_a_file_of_little_ends_as_well_since_its_index_is_kept_in_memory(tmp_path: Path) -> None:
    chunks = traffic(1, 50)
    writer = SessionWriter(tmp_path, description(), file_flushes=7)
    for chunk in chunks:
        writer.add(chunk)
        writer.flush()
    writer.close()
    assert len((session := Session(tmp_path)).sizes_bytes) == 50 // 7 + 1
    assert list(session) == chunks
    assert not session.counters


def test_ports_that_were_not_foreseen_are_recorded_too(tmp_path: Path) -> None:
    chunks = [Recorded("bus", "in", Stamp(1, 2), b"abc")]
    recorder = SessionRecorder(tmp_path, description())
    recorder.record(*chunks[0])
    recorder.close()
    assert list(Session(tmp_path)) == chunks


def test_a_full_disk_stops_the_recording_and_nothing_else(tmp_path: Path) -> None:
    class Disk(FullDisk):
        room_bytes = 9000

    chunks = traffic(1, 400)
    recorder = SessionRecorder(tmp_path, description(), open_file=Disk)
    for chunk in chunks:
        recorder.record(*chunk)
    recorder.close()
    counters = recorder.counters
    assert counters["session.chunks_lost"] == 400
    assert counters["session.bytes_lost"] == n_bytes(chunks)
    assert [notice.code for notice in recorder.take_notices()] == ["session_stopped"]
    recorder.record(*chunks[0])  # the mission goes on
    assert recorder.counters["session.chunks_lost"] == 401
    read = list(session := Session(tmp_path))
    assert read == chunks[: len(read)]
    assert session.counters["session.files_unfinished"] == 1


@pytest.mark.parametrize("operation", ["write_some", "sync"])
@pytest.mark.parametrize(("behind", "n_good"), [(0, 0), (0, 3), (150, 0), (150, 1)])
def test_after_a_failure_of_the_disk_everything_is_recorded_once(
    operation: str, behind: int, n_good: int, tmp_path: Path
) -> None:
    left = [math.inf]

    class FailingOnce(DurableFile):
        def _count(self, name: str) -> None:
            left[0] -= name == operation
            if name == operation and left[0] == -1:
                raise OSError(errno.EIO, "Input/output error")

        def write_some(self, data: memoryview) -> int:
            self._count("write_some")
            return super().write_some(data)

        def sync(self) -> None:
            self._count("sync")
            super().sync()

    chunks = traffic(1, 300)
    recorder = SessionRecorder(tmp_path, description(), retry_s=0.0, file_bytes=9000, open_file=FailingOnce)
    for first in range(0, 300, 150):
        if first == behind:  # chunks that are recorded
            left[0] = n_good
        for chunk in chunks[first : first + 150]:
            recorder.record(*chunk)
        while recorder.counters["session.chunks_recorded"] < first + 150:
            threading.Event().wait(0.01)
    recorder.close()
    assert recorder.counters == {"session.chunks_recorded": 300, "session.bytes_recorded": n_bytes(chunks)}
    assert [notice.code for notice in recorder.take_notices()] == ["session_stopped", "recording_resumed"]
    assert recorder.queued_bytes == 0
    assert list(session := Session(tmp_path)) == chunks
    assert set(session.counters) <= {"session.files_unfinished", "session.bytes_torn"}


def test_a_disk_that_is_full_from_the_start_and_then_has_room_takes_what_waits(tmp_path: Path) -> None:
    room = threading.Event()
    recorder = SessionRecorder(
        tmp_path, description(), retry_s=0.01, free_bytes=lambda folder: 10**12 if room.is_set() else 0
    )
    assert [notice.code for notice in recorder.take_notices()] == ["session_stopped"]
    chunks = traffic(1, 50)
    for chunk in chunks:
        recorder.record(*chunk)
    room.set()
    recorder.close()
    assert list(Session(tmp_path)) == chunks
    assert [notice.code for notice in recorder.take_notices()] == ["recording_resumed"]


@pytest.mark.parametrize("n_good", [0, 1])
def test_a_file_whose_name_a_failing_disk_did_not_keep_does_not_end_the_recording(
    n_good: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the start, as when a restart meets it, or when the second file begins."""
    left = [n_good]

    def fsync(descriptor: int, fsync: Callable[[int], None] = os.fsync) -> None:
        if os.path.isdir(f"/proc/self/fd/{descriptor}"):
            left[0] -= 1
            if left[0] == -1:
                raise OSError(errno.EIO, "Input/output error")
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    chunks = traffic(1, 300)
    recorder = SessionRecorder(tmp_path, description(), retry_s=0.0, file_bytes=9000)
    for first in range(0, 300, 150):
        for chunk in chunks[first : first + 150]:
            recorder.record(*chunk)
        n_waits = 0
        while recorder.counters["session.chunks_recorded"] < first + 150 and n_waits < 1000:
            n_waits += 1
            threading.Event().wait(0.01)
    recorder.close()
    assert [notice.code for notice in recorder.take_notices()] == ["session_stopped", "recording_resumed"]
    assert list(Session(tmp_path)) == chunks


def test_what_a_failed_disk_leaves_no_room_for_is_lost_and_marked(tmp_path: Path) -> None:
    room = threading.Event()
    recorder = SessionRecorder(
        tmp_path,
        description(),
        retry_s=0.01,
        queue_bytes=3000,
        free_bytes=lambda folder: 10**12 if room.is_set() else 0,
    )
    chunks = traffic(1, 50)
    for chunk in chunks:
        recorder.record(*chunk)
    room.set()
    recorder.close()
    read = list(session := Session(tmp_path))
    assert 0 < len(read) < 50
    assert read == chunks[: len(read)]
    assert recorder.counters["session.chunks_lost"] == session.counters["session.chunks_lost"] == 50 - len(read)
    assert [notice.code for notice in recorder.take_notices()] == ["session_stopped", "recording_resumed"]


def test_a_file_that_could_not_be_begun_leaves_its_name_to_the_next(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No space left"):
        SessionWriter(tmp_path, description(), open_file=FullDisk)
    SessionWriter(tmp_path, description()).close()


def test_a_session_goes_on_where_the_numbers_of_its_messages_begin_again(tmp_path: Path) -> None:
    chunks = traffic(1, 5)
    writer = SessionWriter(tmp_path, description())
    writer.go_on(2**32 - 2)
    for chunk in chunks:
        writer.add(chunk)
    writer.close()
    assert list(session := Session(tmp_path / file_name(1))) == chunks
    assert not session.counters


def test_a_reserve_of_the_disk_is_kept(tmp_path: Path) -> None:
    free = [10_000_000]
    recorder = SessionRecorder(tmp_path, description(), reserve_bytes=5_000_000, free_bytes=lambda folder: free[0])
    recorder.record("gps", "in", Stamp(1, 1), b"before")
    while not recorder.counters["session.chunks_recorded"]:
        threading.Event().wait(0.01)
    free[0] = 5_000_010
    recorder.record("gps", "in", Stamp(2, 2), b"after")
    recorder.close()
    assert [chunk.data for chunk in Session(tmp_path)] == [b"before"]
    assert recorder.counters == {
        "session.chunks_recorded": 1,
        "session.bytes_recorded": 6,
        "session.chunks_lost": 1,
        "session.bytes_lost": 5,
    }
    (notice,) = recorder.take_notices()
    assert "reserved for results" in notice.text


@pytest.mark.parametrize(
    ("free", "stamp"), [({"free_bytes": lambda folder: 0}, Stamp(1, 1)), ({}, Stamp(-1, -1))], ids=["full", "defect"]
)
def test_a_full_disk_and_a_defect_of_the_recorder_itself_are_reported_and_end_no_mission(
    free: dict[str, Any], stamp: Stamp, tmp_path: Path
) -> None:
    recorder = SessionRecorder(tmp_path, description(), **free)
    recorder.record("gps", "in", stamp, b"abc")  # no clock reads -1
    recorder.close()
    assert recorder.counters == {"session.chunks_lost": 1, "session.bytes_lost": 3}
    assert [notice.code for notice in recorder.take_notices()] == ["session_stopped"]


def test_a_disk_that_is_too_slow_loses_what_does_not_fit_and_marks_the_place(tmp_path: Path) -> None:
    stalled, go_on = threading.Event(), threading.Event()

    class SlowFile(DurableFile):
        n_syncs = 0

        def sync(self) -> None:
            self.n_syncs += 1
            if self.n_syncs == 2:  # the first is that of the file's head
                stalled.set()
                assert go_on.wait(30.0)
            super().sync()

    chunks = traffic(1, 300)
    chunks[200] = chunks[200]._replace(data=bytes(40_000))  # leaves room for smaller ones, which are lost as well
    recorder = SessionRecorder(tmp_path, description(), queue_bytes=80_000, open_file=SlowFile)
    recorder.record(*chunks[0])
    assert stalled.wait(30.0)
    for chunk in chunks[1:]:
        recorder.record(*chunk)
    n_lost, bytes_lost = recorder.counters["session.chunks_lost"], recorder.counters["session.bytes_lost"]
    assert n_lost == 100
    go_on.set()
    while recorder.counters["session.chunks_recorded"] < len(chunks) - n_lost:
        threading.Event().wait(0.01)
    recorder.record(*chunks[0])
    recorder.close()
    assert recorder.counters["session.chunks_lost"] == n_lost
    assert [notice.code for notice in recorder.take_notices()] == ["session_bytes_lost"]
    assert list(session := Session(tmp_path)) == [*chunks[: len(chunks) - n_lost], chunks[0]]
    assert session.counters == {"session.chunks_lost": n_lost, "session.bytes_lost": bytes_lost}
    assert [notice.code for notice in session.notices] == ["session_bytes_lost"]


def test_a_folder_that_cannot_serve_is_refused_in_words(tmp_path: Path) -> None:
    SessionRecorder(tmp_path, description()).close()
    with pytest.raises(UsageError, match="already holds a recorded session"):
        SessionRecorder(tmp_path, description())
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot record into"):
        SessionRecorder(tmp_path / "file" / "below", description())


@pytest.mark.parametrize("n_seen", [3, 700])
def test_a_killed_process_leaves_all_that_it_called_recorded(tmp_path: Path, n_seen: int) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", RECORD_FOR_EVER, str(tmp_path), str(Path(__file__).resolve().parents[3])],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    n_reported = 0
    for n_lines, line in enumerate(process.stdout):
        n_reported = int(line)
        if n_lines >= n_seen:
            break
    process.send_signal(signal.SIGKILL)
    n_reported = max([n_reported, *(int(line) for line in process.stdout.read().splitlines())])
    process.stdout.close()
    process.wait()
    read = list(session := Session(tmp_path))
    assert len(read) >= n_reported
    assert read == traffic(1, 5_000)[: len(read)]
    assert not session.counters["session.messages_missing"]
    assert file_name(0) in {path.name for path in session.sizes_bytes}
