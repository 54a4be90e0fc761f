"""Records come back from disk as they were, in the process that wrote them and in one that shares the file."""

from __future__ import annotations

import math
import multiprocessing
import os
from contextlib import closing
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.contacts.record_file import RecordFile, RecordPlace, record_decoder
from auv_mcm.records import NAN, Contact, CoveragePatch, Detection
from tests.auv_mcm.classify import drawn_looks
from tests.auv_mcm.contacts.temporary_records import temporary_record_file
from tests.make.records import patch_of

CONTACT = record_decoder(Contact)
PWRITE = "auv_mcm.contacts.record_file.os.pwrite"


def contact(number: int, text: str = "") -> Contact:
    return drawn_looks.contact(id=f"C{number:05d}", reasons=(text,))


def taken(place: RecordPlace | None) -> RecordPlace:
    assert place is not None
    return place


@settings(max_examples=30, deadline=None)
@given(
    steps=st.lists(st.tuples(st.sampled_from(["takes", "takes half", "is full"]), st.text(max_size=40)), max_size=30)
)
def test_what_a_disk_took_is_what_comes_back(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[str, str]]
) -> None:
    write, how = os.pwrite, ""

    def written(descriptor: int, data: bytes, start: int) -> int:
        if how == "takes half":
            write(descriptor, data[: len(data) // 2], start)
        if how != "takes":
            raise OSError(28, "No space left on device")
        return write(descriptor, data[:100], start)  # as much as a disk takes at once

    expected: list[tuple[RecordPlace, str]] = []
    with (
        closing(temporary_record_file(tmp_path_factory.getbasetemp())) as records,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr(PWRITE, written)
        for how, text in steps:
            place = records.append(contact(1, text))
            assert (place is not None) == (how == "takes")
            if place is not None:
                expected.append((place, text))
        assert [records.read(place, CONTACT).reasons for place, _ in expected] == [(text,) for _, text in expected]
        assert records.end == sum(place.size for place, _ in expected)


def test_numbers_and_arrays_come_back_to_the_bit_and_with_their_kind(records: RecordFile) -> None:
    snippet = np.arange(6, dtype=np.uint8).reshape(2, 3)
    view = drawn_looks.detection(
        snippet=snippet, height_m=NAN, p_mine=np.float64(0.1), score=-0.0, confirmation=drawn_looks.confirmation(-2.5)
    )
    covariance = np.array([[0.1, NAN], [math.inf, -0.0]])
    back = records.read(taken(records.append(view)), record_decoder(Detection))
    assert (back.snippet.dtype, back.snippet.tolist()) == (snippet.dtype, snippet.tolist())
    assert (math.isnan(back.height_m), back.p_mine, math.copysign(1.0, back.score)) == (True, 0.1, -1.0)
    assert back.confirmation is not None
    assert (back.confirmation.highlight.shape, back.confirmation.labels.shape) == ((0, 2), (0, 0))
    placed = records.read(taken(records.append(drawn_looks.contact(covariance_m2=covariance))), CONTACT)
    assert placed.covariance_m2.tobytes() == covariance.tobytes()


def test_a_patch_keeps_its_rings(records: RecordFile) -> None:
    ring = np.array([[5.0, 43.0], [5.1, 43.0], [5.0, 43.1], [5.0, 43.0]])
    patch = patch_of(rings_deg=(ring,), covered_m2=9.5, lost_m2={"turn": 0.5})
    back = records.read(taken(records.append(patch)), record_decoder(CoveragePatch))
    assert [ring.tolist() for ring in back.rings_deg] == [ring.tolist()]
    assert (back.side, back.lost_m2) == ("port", {"turn": 0.5})


def test_a_file_has_no_name(tmp_path: Path) -> None:
    with closing(temporary_record_file(tmp_path)) as records:
        records.append(contact(1))
        assert list(tmp_path.iterdir()) == []
    assert list(tmp_path.iterdir()) == []


def test_where_no_file_can_be_opened_nothing_is_taken(tmp_path: Path) -> None:
    with closing(temporary_record_file(tmp_path / "missing")) as records:
        assert records.append(contact(7)) is None
        with pytest.raises(OSError, match="cannot be read back"):
            records.read(RecordPlace(0, 10), CONTACT)


def test_what_the_disk_does_not_give_back_is_an_error_and_counted(
    records: RecordFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = [taken(records.append(contact(number))) for number in range(2)]
    with monkeypatch.context() as patch:
        patch.setattr("auv_mcm.contacts.record_file.os.pread", lambda file, size, start: bytes(size))
        with pytest.raises(OSError, match=f"the record at byte {places[1].start} cannot be read back"):
            records.read(places[1], CONTACT)
    assert records.n_unreadable == 1
    assert records.read(places[1], CONTACT).id == "C00001"


def append_three(records: RecordFile, connection: Connection) -> None:
    """Write in a process of its own."""
    connection.send([records.append(contact(number)) for number in range(3)])
    records.close()


@pytest.mark.parametrize("is_there", [True, False])
def test_a_spawned_process_writes_what_its_parent_reads_after_its_end(tmp_path: Path, is_there: bool) -> None:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with closing(temporary_record_file(tmp_path if is_there else tmp_path / "missing")) as records, ours, theirs:
        process = context.Process(target=append_three, args=(records, theirs))
        process.start()
        places = ours.recv()
        process.join()
        if is_there:
            assert [records.read(place, CONTACT).id for place in places] == ["C00000", "C00001", "C00002"]
        else:
            assert places == [None] * 3
