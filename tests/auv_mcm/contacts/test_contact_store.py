"""Contacts come back as they last were, each view is stored once, and a disk that fails loses nothing that it did not
take."""

from __future__ import annotations

import os
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.contacts.contact_store import ContactStore
from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.contacts.ledger import contact_from_views
from auv_mcm.contacts.record_file import RecordFile
from auv_mcm.records import Contact, Detection, contact_id, contact_number
from tests.auv_mcm.classify import drawn_looks
from tests.auv_mcm.contacts.temporary_records import temporary_record_file
from tests.auv_mcm.contacts.whole_exports import contacts_csv, contacts_kml
from tests.make.disks import full
from tests.make.results import write_results

PWRITE = "auv_mcm.contacts.record_file.os.pwrite"
PRIOR = -4.0
PICTURE = np.zeros((60, 80), dtype=np.uint8)


def view(time_s: float) -> Detection:
    return drawn_looks.detection(time_s=time_s, score=time_s, snippet=PICTURE)


def contact(number: int, *times_s: float) -> Contact:
    return contact_from_views(contact_id(number), tuple(view(time_s) for time_s in times_s), PRIOR)


def seen_again(before: Contact, time_s: float) -> tuple[Contact, Detection]:
    """A contact with one more view, in its place by time, and that view."""
    new = view(time_s)
    return contact_from_views(before.id, tuple(sorted([*before.views, new], key=lambda each: each.time_s)), PRIOR), new


def times_s(contact: Contact) -> list[float]:
    return [view.time_s for view in contact.views]


@settings(max_examples=60, deadline=None)
@given(steps=st.lists(st.tuples(st.integers(1, 4), st.sampled_from([None, 0, 1]), st.floats(0.0, 1e3)), max_size=30))
def test_contacts_are_what_they_were_when_they_last_changed_whatever_the_disk_takes(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[int, int | None, float]]
) -> None:
    """A step: the number of a contact seen, how many records the disk takes (None: all), and when it was seen."""
    write, expected, room = os.pwrite, dict[int, list[float]](), [0]

    def limited(descriptor: int, data: bytes, start: int) -> int:
        if room[0] == 0:
            full()
        room[0] -= 1
        return write(descriptor, data, start)

    with (
        closing(temporary_record_file(tmp_path_factory.getbasetemp())) as records,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr(PWRITE, limited)
        store, reader, known, in_memory = ContactStore(records), ContactStore(records), dict[int, Contact](), set[int]()
        for number, n_taken, time_s in steps:
            room[0] = -1 if n_taken is None else n_taken
            if number in known:
                known[number], new = seen_again(store[number], time_s)
                store.add_view(known[number], new)
            else:
                known[number] = contact(number, time_s)
                store.add(known[number])
            reader.keep(known[number], store.place(number))
            expected[number] = sorted([*expected.get(number, []), time_s])
            in_memory = in_memory - {number} if n_taken is None else in_memory | {number}
        for end in (store, reader):
            assert {number: times_s(end[number]) for number in known} == expected
            assert end.n_in_memory == len(in_memory)
        assert {number for number in known if store.place(number) is None} == in_memory


def test_a_view_is_written_once_and_a_change_costs_its_head_alone(records: RecordFile) -> None:
    """A contact seen twenty times takes a tenth more than its views."""
    store = ContactStore(records)
    known = contact(1, 0.0)
    store.add(known)
    picture_bytes = PICTURE.nbytes
    for time_s in range(1, 20):
        known, new = seen_again(store[1], float(-time_s if time_s % 2 else time_s))
        before = records.end
        store.add_view(known, new)
        head = store.place(1)
        assert head is not None
        assert head.size < 700 + 40 * len(known.views)
        assert picture_bytes < records.end - before - head.size < picture_bytes + 1000
    assert times_s(store[1]) == sorted(times_s(known))
    assert len(known.views) == 20


def test_versions_that_a_nearly_full_disk_does_not_take_use_none_of_its_space(
    records: RecordFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a contact that is tried again and again would take what is left from the journal."""
    store, write = ContactStore(records), os.pwrite
    store.add(contact(1, 1.0))
    before = records.end
    with monkeypatch.context() as disk:
        disk.setattr(
            PWRITE, lambda file, data, start: write(file, data, start) if len(data) > PICTURE.nbytes else full()
        )
        for n_views in range(2, 6):
            store.add(contact(1, *map(float, range(n_views))))
            assert records.end == before
    assert (len(store[1].views), store.n_in_memory) == (5, 1)


@settings(max_examples=30, deadline=None)
@given(numbers=st.lists(st.integers(1, 12) | st.integers(99_990, 100_020), max_size=25))
def test_files_are_those_of_all_contacts_held_at_once(
    tmp_path_factory: pytest.TempPathFactory, numbers: list[int]
) -> None:
    folder = tmp_path_factory.mktemp("results")
    known: dict[str, Contact] = {}
    with closing(temporary_record_file(folder)) as records:
        store = ContactStore(records)
        for order, number in enumerate(numbers):
            known[contact_id(number)] = contact(number, float(order))
            store.add(known[contact_id(number)])
        assert [contact.id for contact in store.in_order()] == sorted(known)
        write_results(folder, store.in_order(), (), (), "name")
    assert (folder / "contacts.geojson").read_bytes() == contacts_geojson(known.values())
    assert (folder / "contacts.csv").read_bytes() == contacts_csv(known.values()).encode()
    assert (folder / "contacts.kml").read_bytes() == contacts_kml(known.values(), "name").encode()


def test_a_contact_of_which_a_view_cannot_be_read_is_left_out_and_counted_once(
    records: RecordFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, read = ContactStore(records), os.pread
    for number in range(1, 4):
        store.add(contact(number, 1.0, 2.0))
    with monkeypatch.context() as disk:
        # The first record in the file is the first view of the first contact.
        disk.setattr(
            "auv_mcm.contacts.record_file.os.pread",
            lambda file, size, start: read(file, size, start) if start else bytes(size),
        )
        assert [contact_number(contact.id) for contact in store.in_order()] == [2, 3]
        assert records.n_unreadable == 1
        assert store.unreadable() == [1]
    assert store.unreadable() == []
    assert [contact_number(contact.id) for contact in store.in_order()] == [1, 2, 3]


def test_an_id_that_is_no_number_is_refused(records: RecordFile) -> None:
    with pytest.raises(ValueError, match="C and a number"):
        ContactStore(records).add(drawn_looks.contact(id="X1"))
