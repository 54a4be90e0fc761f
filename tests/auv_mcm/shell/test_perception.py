"""Perception in its own process: everything arrives unchanged and in order, and no way of failing hangs."""

from __future__ import annotations

import asyncio
import errno
import multiprocessing
import os
from collections import deque
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.clean_text import is_clean
from auv_mcm.contacts.contact_store import ContactStore
from auv_mcm.contacts.coverage_store import CoverageStore, StoredPatch
from auv_mcm.contacts.record_file import RecordFile, RecordPlace
from auv_mcm.errors import BadInputError
from auv_mcm.records import Contact, CoveragePatch, EarlyContact, EchoTrace, Notice, Ping, SourceEvent
from auv_mcm.settings.config import Config
from auv_mcm.shell.checkpoint import Keeping
from auv_mcm.shell.perception import MAX_IN_FLIGHT, Perception
from auv_mcm.shell.perception_chain import MakePipeline
from auv_mcm.shell.perception_messages import Checkpointed, Fed, Finished, PerceptionError
from auv_mcm.shell.ping_ring import Ring
from tests.auv_mcm.contacts.temporary_records import temporary_record_file
from tests.auv_mcm.shell import fake_pipelines as fake

GENEROUS_S = 60.0


@given(st.lists(st.integers(0, 400) | st.none(), max_size=60))
def test_ring_never_hands_out_the_same_byte_twice(steps: list[int | None]) -> None:
    ring = Ring(1024)
    held: deque[range] = deque()
    for step in steps:
        if step is None:
            if held:
                ring.give_back()
                held.popleft()
            continue
        offset = ring.take(step)
        if offset is None:
            assert held, "an empty ring has room"
            continue
        piece = range(offset, offset + step)
        assert piece.stop <= 1024
        assert all(
            piece.stop <= other.start or other.stop <= piece.start for other in held if len(other) and len(piece)
        )
        held.append(piece)
    while held:
        ring.give_back()
        held.popleft()
    assert ring.take(1024) == 0


class Answered(NamedTuple):
    """All events and patches of a worker, in order, the last picture and place of each contact, and the last answer."""

    events: list[Contact | EarlyContact | Notice]
    snippets: dict[str, bytes]
    places: dict[int, RecordPlace]
    patches: list[StoredPatch]
    finished: Finished


async def answers(
    events: Sequence[SourceEvent], make: MakePipeline, ring_bytes: int = 1 << 16, records: RecordFile | None = None
) -> Answered:
    perception = Perception(Config(), make, ring_bytes, records)

    async def feed() -> None:
        for event in events:
            await perception.feed(event)
        await perception.finish()

    feeding: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    try:
        await perception.start()
        feeding = asyncio.ensure_future(feed())
        answered: list[Contact | EarlyContact | Notice] = []
        snippets: dict[str, bytes] = {}
        places: dict[int, RecordPlace] = {}
        patches: list[StoredPatch] = []
        while not isinstance(answer := await perception.answer(), Finished):
            assert isinstance(answer, Fed)
            answered += answer.events
            snippets |= answer.snippets
            places |= answer.places
            patches += answer.patches
        await feeding
        assert perception.in_flight == 0
        return Answered(answered, snippets, places, patches, answer)
    finally:
        feeding.cancel()
        await asyncio.gather(feeding, return_exceptions=True)
        perception.close()


def test_pings_arrive_to_the_bit_and_in_order_through_a_ring_smaller_than_they_are_together() -> None:
    backwards = np.arange(64, dtype="uint16")[::-1]
    pings: list[SourceEvent] = [
        fake.ping(0),
        fake.ping(1, port=fake.trace(1, 500, "uint8"), starboard=fake.trace(2, 700, "float32")),
        fake.navigation(1),
        msgspec.structs.replace(fake.ping(2), port=None),
        fake.ping(3, port=EchoTrace(samples=backwards, first_range_m=1.0, spacing_m=0.5)),
        fake.ping(4, port=fake.trace(1, 0), starboard=fake.trace(2, 33, ">u4")),
        Notice(code="x", text="y"),
        *(fake.ping(number, port=fake.trace(number, 7 * number)) for number in range(5, 200)),
    ]
    received = asyncio.run(answers(pings, fake.Digesting, ring_bytes=8192)).events
    assert [event.text for event in received if isinstance(event, Notice)] == [fake.digest(event) for event in pings]
    assert len(received) == len(pings) + 1, "no tiles, and the contact that finishing gave"


def test_contacts_come_without_what_their_pictures_were_made_of() -> None:
    answered = asyncio.run(answers([fake.ping(0)], fake.Seeing))
    (contact,) = (event for event in answered.events if isinstance(event, Contact))
    (view,) = contact.views
    assert view.confirmation is not None
    assert view.confirmation.model is not None
    outlines: list[NDArray[Any]] = [view.confirmation.highlight, view.confirmation.model.shadow]
    assert [array.size for array in (view.snippet, view.confirmation.labels, *outlines)] == [0, 0, 0, 0]
    assert (contact.id, view.score, view.confirmation.log_ratio) == ("C00001", 7.5, 2.0)
    assert answered.snippets["C00001"].startswith(b"\x89PNG")


def test_what_perception_stores_is_read_by_the_parent_with_what_pictures_are_made_of(tmp_path: Path) -> None:
    with closing(temporary_record_file(tmp_path)) as records:
        answered = asyncio.run(answers([fake.ping(0)], fake.Seeing, records=records))
        store = ContactStore(records)
        (contact,) = (event for event in answered.events if isinstance(event, Contact))
        store.keep(contact, answered.places[1])
        (view,) = store[1].views
    assert store.n_in_memory == 0
    assert (view.snippet.tolist(), view.score) == ([[100] * 6] * 4, 7.5)


def test_coverage_crosses_as_its_place(tmp_path: Path) -> None:
    with closing(temporary_record_file(tmp_path)) as records:
        answered = asyncio.run(answers([fake.ping(number) for number in range(4)], fake.Base, records=records))
        coverage = CoverageStore(records)
        for patch in answered.patches:
            assert isinstance(patch.patch, RecordPlace)
            coverage.keep(patch)
        assert [patch.tile_index for patch in coverage.in_order()] == [0, 3]


def test_a_disk_that_takes_no_more_contacts_is_reported_once_and_counted_and_all_of_them_cross(tmp_path: Path) -> None:
    with closing(temporary_record_file(tmp_path)) as records:
        answered = asyncio.run(answers([fake.ping(number) for number in range(12)], fake.FullDisk, records=records))
    assert [event.code for event in answered.events if isinstance(event, Notice)] == ["perception.disk_full"]
    assert [event.id for event in answered.events if isinstance(event, Contact)] == [
        "C0000",
        "C0003",
        "C0006",
        "C0009",
        "C9999",
    ]
    assert answered.finished.counters == {"ping.received": 12, "perception.kept_in_memory": 4}
    assert list(answered.places) == [0]
    assert [isinstance(patch.patch, CoveragePatch) for patch in answered.patches] == [False, True, True, True]


async def test_a_ping_larger_than_the_ring_is_refused_and_the_rest_goes_on() -> None:
    perception = Perception(Config(), fake.Base, ring_bytes=4096)
    try:
        await perception.start()
        with pytest.raises(ValueError, match="does not fit"):
            await perception.feed(fake.ping(0, port=fake.trace(0, 10_000)))
        await perception.feed(fake.ping(3))
        answer = await perception.answer()
        assert isinstance(answer, Fed)
        assert [event.id for event in answer.events if isinstance(event, Contact)] == ["C0003"]
    finally:
        perception.close()


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (fake.Failing, PerceptionError, r"ping 5.*ZeroDivisionError.*defect"),
        (fake.Refusing, BadInputError, "no such sonar"),
        (fake.Unstartable, PerceptionError, "at its start.*no model file"),
        (fake.Dying, PerceptionError, "killed by SIGKILL"),
    ],
)
def test_a_worker_that_fails_is_an_error_with_its_reason_and_never_a_hang(
    make: MakePipeline, error: type[Exception], message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    pings: list[Ping] = [fake.ping(number) for number in range(300)]
    with pytest.raises(error, match=message):
        asyncio.run(answers(pings, make))


def test_words_of_a_device_in_a_traceback_forge_no_line_of_the_log(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(PerceptionError):
        asyncio.run(answers([fake.ping(0)], fake.Quoting))
    first, *others = capfd.readouterr().err.strip("\n").split("\n")
    assert first.startswith("Traceback")
    assert any("2026-01-01" in line for line in others)
    assert all(line.startswith("  ") and is_clean(line) for line in others)


async def test_answers_that_nobody_has_taken_yet_hold_up_no_ping() -> None:
    perception = Perception(Config(), fake.Base)
    try:
        await perception.start()
        async with asyncio.timeout(GENEROUS_S):
            for number in range(3 * MAX_IN_FLIGHT):
                await perception.feed(fake.ping(number), number=number)
            while perception.in_flight:
                await asyncio.sleep(0.0)
            for _ in range(3 * MAX_IN_FLIGHT):
                assert isinstance(await perception.answer(), Fed)
    finally:
        perception.close()


async def test_a_checkpoint_that_waits_for_the_disk_holds_up_no_ping(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISK_ANSWERS", str(tmp_path / "answers"))
    perception = Perception(Config(), fake.OnSlowDisk, keeping=Keeping(tmp_path, "kind", every_s=0.0))
    try:
        await perception.start()
        async with asyncio.timeout(GENEROUS_S):
            for number in range(12):
                await perception.feed(fake.ping(number), number=number)
            for _ in range(12):
                assert isinstance(await perception.answer(), Fed)
            (tmp_path / "answers").touch()
            assert await perception.answer() == Checkpointed(0)
    finally:
        perception.close()


async def test_a_process_whose_thread_waits_for_the_disk_does_not_hang(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(pipe := tmp_path / "pipe")
    monkeypatch.setenv("DISK_ANSWERS", str(pipe))
    perception = Perception(Config(), fake.WaitingForTheDiskBeside)

    def states() -> list[str]:
        (worker,) = (child for child in multiprocessing.active_children() if child.name == "perception")
        return [
            path.read_text().rpartition(")")[2].split()[0] for path in Path(f"/proc/{worker.pid}/task").glob("*/stat")
        ]

    try:
        await perception.start()
        await perception.feed(fake.ping(0))
        async with asyncio.timeout(GENEROUS_S):
            while "D" not in states():
                await asyncio.sleep(0.01)
            done = perception.work_done()
            assert done is not None
            assert not done.waits
            os.close(os.open(pipe, os.O_WRONLY))
            assert isinstance(await perception.answer(), Fed)
    finally:
        perception.close()


async def test_closing_what_never_started_or_still_works_ends_at_once() -> None:
    Perception(Config()).close()
    perception = Perception(Config(), fake.Stuck)
    await perception.start()
    await perception.finish()
    perception.close()


def test_a_limit_on_the_size_of_files_ends_the_start_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """The memory that both processes share is a file without a name, which 'ulimit -f' bounds too."""

    def too_large(*_: object) -> None:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))

    monkeypatch.setattr("multiprocessing.context.SpawnContext.RawArray", too_large)
    with pytest.raises(PerceptionError, match=r"File too large.*ulimit -f") as failed:
        asyncio.run(Perception(Config(), fake.Base).start())
    assert failed.value.exit_code == 4
