"""Events come back from the disk as they were, up to where a power cut tore the file."""

from __future__ import annotations

import os
import random
from pathlib import Path

import pytest

from auv_mcm.records import Notice, SourceEvent
from auv_mcm.shell.checkpoint import commit_checkpoint, newest_checkpoint, read_checkpoints, write_checkpoint
from auv_mcm.shell.event_spool import EventSpool, read_events
from tests.auv_mcm.shell import fake_pipelines as fake

EVENTS: list[SourceEvent] = [
    Notice(code="x", text="y"),
    *(event for number in range(20) for event in (fake.navigation(number), fake.ping(number))),
]


def spooled(folder: Path, events: list[SourceEvent]) -> EventSpool:
    spool = EventSpool(folder)
    for event in events:
        spool.append(event)
    spool.flush()
    return spool


def ends_of_entries(folder: Path, n_events: int) -> list[int]:
    """Spool events; give the size of the file after each."""
    spool = EventSpool(folder)
    ends = []
    for event in EVENTS[:n_events]:
        spool.append(event)
        spool.flush()
        ends.append((folder / "events-000001.bin").stat().st_size)
    spool.close()
    return ends


def read(folder: Path, after: int = 0, until: int | None = None) -> list[tuple[int, str]]:
    return [(each.number, fake.digest(each.event)) for each in read_events(folder, after, until)]


def expected(numbers: range) -> list[tuple[int, str]]:
    return [(number, fake.digest(EVENTS[number - 1])) for number in numbers]


def test_events_come_back_to_the_bit_by_number(tmp_path: Path) -> None:
    spool = spooled(tmp_path, EVENTS)
    spool.close()
    assert read(tmp_path) == expected(range(1, 42))
    assert read(tmp_path, 10, 15) == expected(range(11, 16))


def test_how_events_were_fed_comes_back_too(tmp_path: Path) -> None:
    spool = spooled(tmp_path, EVENTS[:10])
    spool.mark_dropped(4, 6)
    spool.mark_room(3, 0.25)
    spool.mark_reserved(9, 12)
    spool.close()
    assert {each.number: each.room for each in spool.read(2, 10)} == {3: 0.25, 6: 1.0, 7: 1.0, 8: 1.0, 9: 1.0, 10: 1.0}
    assert spool.reservations() == {9: 12}


def test_what_a_tear_leaves_is_read_and_what_follows_is_numbered_behind_it(tmp_path: Path) -> None:
    path, ends = tmp_path / "events-000001.bin", ends_of_entries(tmp_path, 30)
    whole = path.read_bytes()
    for size in random.Random(1).sample(range(len(whole)), 20):
        os.truncate(path, size)
        n_left = sum(end <= size for end in ends)
        assert read(tmp_path) == expected(range(1, n_left + 1))
        path.write_bytes(whole)
    os.truncate(path, ends[11] + 3)
    spool = EventSpool(tmp_path)
    assert spool.append(EVENTS[12]) == 13
    spool.close()
    assert read(tmp_path) == expected(range(1, 14))


def test_what_a_killed_run_left_outlives_a_power_cut_before_it_is_fed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the run before wrote and did not sync is on the disk before contacts that come of it are announced."""
    left = tmp_path / "events-000001.bin"
    spooled(tmp_path, EVENTS[:10]).close()
    synced = []
    sync = os.fsync

    def noting(descriptor: int) -> None:
        sync(descriptor)
        synced.append(os.readlink(f"/proc/self/fd/{descriptor}"))

    monkeypatch.setattr(os, "fsync", noting)
    spool = EventSpool(tmp_path)
    spool.flush()
    spool.close()
    assert str(left) in synced


def test_a_flipped_bit_ends_a_file(tmp_path: Path) -> None:
    path, ends = tmp_path / "events-000001.bin", ends_of_entries(tmp_path, 10)
    data = bytearray(path.read_bytes())
    data[ends[3] + 30] ^= 4
    path.write_bytes(data)
    assert read(tmp_path) == expected(range(1, 5))


def test_files_whose_events_are_no_longer_needed_go(tmp_path: Path) -> None:
    spool = spooled(tmp_path, EVENTS[:10])
    spool.forget(5)
    spool.flush()
    for event in EVENTS[10:]:
        spool.append(event)
    spool.flush()
    spool.forget(10)
    spool.close()
    assert read(tmp_path) == expected(range(11, 42))
    for after, last in ((0, 41), (50, 50)):
        spool = EventSpool(tmp_path, after)
        assert spool.last == last
        spool.close()


def test_a_file_that_cannot_be_removed_ends_nothing(tmp_path: Path) -> None:
    (tmp_path / "events-000000.bin").mkdir()
    spool = spooled(tmp_path, EVENTS[:5])
    spool.forget(0)
    spool.flush()
    spool.append(EVENTS[5])
    spool.close()
    assert read(tmp_path) == expected(range(1, 7))


def test_behind_what_a_slow_disk_did_not_take_nothing_is_kept_until_the_next_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spool = spooled(tmp_path, EVENTS[:3])
    with monkeypatch.context() as slow:
        slow.setattr("auv_mcm.shell.event_spool.QUEUE_BYTES", 0)
        spool.append(EVENTS[3])
    spool.append(EVENTS[4])
    assert spool.n_lost == 2
    spool.forget(0)
    spool.flush()
    spool.append(EVENTS[5])
    spool.close()
    assert read(tmp_path) == expected(range(1, 4)) + expected(range(6, 7))


def test_a_disk_that_takes_nothing_costs_what_is_kept_and_no_event(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    spool = spooled(tmp_path / "absent", EVENTS)
    spool.close()
    assert spool.last == len(EVENTS)
    assert spool.n_lost > 0
    assert caplog.text.count("not kept for a restart") == 1


def test_the_newest_sound_checkpoint_counts_once_it_is_committed(tmp_path: Path) -> None:
    for number in (10, 20, 25, 30, 40):
        write_checkpoint(tmp_path, number, b"state %d" % number)
    for number in (10, 20, 30):
        commit_checkpoint(tmp_path, number)
    assert [path.name for path in tmp_path.glob("pending-*")] == ["pending-000000000040.bin"]
    assert list(read_checkpoints(tmp_path)) == [(30, b"state 30"), (20, b"state 20")]
    newest = tmp_path / "checkpoint-000000000030.bin"
    for damaged in (newest.read_bytes()[:-1] + b"1", b"auv-mcm checkpoint 1\n torn"):
        newest.write_bytes(damaged)
        assert list(read_checkpoints(tmp_path)) == [(20, b"state 20")]
    assert newest_checkpoint(tmp_path) == 30, "its number is taken"
