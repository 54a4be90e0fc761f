"""Records come back from disk as they were, in any order, and a disk that fails costs memory, never a record that it did not lose."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.contacts.shelf import Shelf
from auv_mcm.records import NAN, Contact, CoveragePatch
from tests.auv_mcm.classify import drawn_looks


@pytest.fixture
def shelf(tmp_path: Path) -> Iterator[Shelf[Contact]]:
    with closing(Shelf(tmp_path, Contact)) as shelf:
        yield shelf


def contact(number: int, text: str = "") -> Contact:
    return drawn_looks.contact(id=f"C{number:05d}", reasons=(text,))


def full(*_: object) -> int:
    raise OSError(28, "No space left on device")


@settings(max_examples=30, deadline=None)
@given(steps=st.lists(st.tuples(st.integers(0, 5), st.booleans(), st.text(max_size=40)), max_size=30))
def test_a_shelf_is_a_list_whatever_the_disk_takes(tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[int, bool, str]]) -> None:
    expected: list[str] = []
    with closing(Shelf(tmp_path_factory.getbasetemp(), Contact)) as shelf, pytest.MonkeyPatch.context() as patch:
        write = os.pwrite
        for number, is_full, text in steps:
            patch.setattr("auv_mcm.contacts.shelf.os.pwrite", full if is_full else write)
            if number < len(expected):
                expected[number] = text
                shelf[number] = contact(number, text)
            else:
                expected.append(text)
                shelf.append(contact(len(expected) - 1, text))
        assert len(shelf) == len(expected)
        assert [(told.id, told.reasons) for told in shelf.selected(range(len(shelf)))] == [
            (f"C{number:05d}", (text,)) for number, text in enumerate(expected)
        ]


def test_numbers_and_arrays_come_back_to_the_bit_and_with_their_kind(shelf: Shelf[Contact]) -> None:
    snippet = np.arange(6, dtype=np.uint8).reshape(2, 3)
    view = drawn_looks.detection(
        snippet=snippet, height_m=NAN, p_mine=np.float64(0.1), score=-0.0, confirmation=drawn_looks.confirmation(-2.5)
    )
    shelf.append(drawn_looks.contact(views=(view,), covariance_m2=np.array([[0.1, NAN], [math.inf, -0.0]])))
    (back,) = shelf[0].views
    assert (back.snippet.dtype, back.snippet.tolist()) == (snippet.dtype, snippet.tolist())
    assert (math.isnan(back.height_m), back.p_mine, math.copysign(1.0, back.score)) == (True, 0.1, -1.0)
    assert shelf[0].covariance_m2.tobytes() == np.array([[0.1, NAN], [math.inf, -0.0]]).tobytes()
    assert back.confirmation is not None
    assert (back.confirmation.highlight.shape, back.confirmation.labels.shape) == ((0, 2), (0, 0))


def test_a_shelf_leaves_nothing_in_its_folder(tmp_path: Path) -> None:
    with closing(Shelf(tmp_path, Contact)) as shelf:
        shelf.append(contact(1))
        assert list(tmp_path.iterdir()) == []
    assert list(tmp_path.iterdir()) == []


def test_a_record_that_grows_again_and_again_takes_a_few_times_its_space(shelf: Shelf[Contact], monkeypatch: pytest.MonkeyPatch) -> None:
    ends, write = [0], os.pwrite

    def noted(descriptor: int, data: bytes, start: int) -> int:
        ends.append(start + len(data))
        return write(descriptor, data, start)

    monkeypatch.setattr("auv_mcm.contacts.shelf.os.pwrite", noted)
    for n_signs in range(1, 1000):
        if len(shelf) == 0:
            shelf.append(contact(1))
        shelf[0] = contact(1, "x" * 100 * n_signs)
    assert shelf[0].reasons == ("x" * 99_900,)
    assert max(ends) < 4 * 100_000


def test_where_no_file_can_be_opened_everything_stays_in_memory(tmp_path: Path) -> None:
    with closing(Shelf(tmp_path / "missing", Contact)) as shelf:
        shelf.append(contact(7))
        assert (shelf[0].id, shelf.n_in_memory) == ("C00007", 1)


def test_what_the_disk_does_not_give_back_is_left_out_and_counted(shelf: Shelf[Contact], monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(3):
        shelf.append(contact(number))
    read = os.pread
    with monkeypatch.context() as patch:
        patch.setattr("auv_mcm.contacts.shelf.os.pread", lambda file, size, start: read(file, size, start) if start else bytes(size))
        assert [told.id for told in shelf.selected(range(3))] == ["C00001", "C00002"]
        with pytest.raises(OSError, match="record 0 cannot be read back"):
            shelf[0]
    assert shelf.n_unreadable == 2
    assert [told.id for told in shelf.selected([2, 0])] == ["C00002", "C00000"]


def test_a_patch_keeps_its_rings(tmp_path: Path) -> None:
    ring = np.array([[5.0, 43.0], [5.1, 43.0], [5.0, 43.1], [5.0, 43.0]])
    patch = CoveragePatch(side="port", tile_index=3, start_s=1.0, stop_s=2.0, rings_deg=(ring,), covered_m2=9.5, lost_m2={"turn": 0.5})
    with closing(Shelf(tmp_path, CoveragePatch)) as shelf:
        shelf.append(patch)
        assert [back.tolist() for back in shelf[0].rings_deg] == [ring.tolist()]
        assert (shelf[0].side, shelf[0].lost_m2) == ("port", {"turn": 0.5})
