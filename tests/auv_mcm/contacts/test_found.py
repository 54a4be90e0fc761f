"""What was told of a mission comes back in the order of the files that it is written to, as it was told last."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.contacts.found import Found
from auv_mcm.records import Contact, CoveragePatch, Side, contact_id
from auv_mcm.shell.results import write_results
from tests.auv_mcm.classify import drawn_looks
from tests.auv_mcm.contacts.whole_exports import contacts_csv, contacts_kml, coverage_geojson


@pytest.fixture
def found(tmp_path: Path) -> Iterator[Found]:
    with closing(Found(tmp_path)) as found:
        yield found


def contact(number: int, p_mine: float) -> Contact:
    view = drawn_looks.detection(time_s=float(number), score=p_mine)
    return drawn_looks.contact(id=contact_id(number), p_mine=p_mine, views=(view,), aspects_deg=(12.345678,))


def patch(tile_index: int, side: Side) -> CoveragePatch:
    ring = np.array([[179.9, 43.0], [-179.9, 43.0], [-179.9, 43.1], [179.9, 43.0]])
    return CoveragePatch(
        side=side, tile_index=tile_index, start_s=0.0, stop_s=1.0, rings_deg=(ring,), covered_m2=float(tile_index), lost_m2={"turn": 1.0}
    )


@settings(max_examples=30, deadline=None)
@given(
    told=st.lists(st.tuples(st.integers(1, 12) | st.integers(99_990, 100_020), st.floats(0.0, 1.0)), max_size=25),
    tiles=st.lists(st.tuples(st.integers(0, 6), st.sampled_from(["port", "starboard"])), max_size=12),
)
def test_files_are_those_of_all_records_held_at_once(
    tmp_path_factory: pytest.TempPathFactory, told: list[tuple[int, float]], tiles: list[tuple[int, Side]]
) -> None:
    folder = tmp_path_factory.mktemp("results")
    known: dict[str, Contact] = {}
    patches = [patch(*tile) for tile in tiles]
    with closing(Found(folder)) as found:
        for number, p_mine in told:
            known[contact_id(number)] = contact(number, p_mine)
            found.keep([known[contact_id(number)]])
        found.keep(coverage=patches)
        assert [told.id for told in found.contacts] == sorted(known)
        write_results(folder, found.contacts, found.coverage, (), "name")
    assert (folder / "contacts.geojson").read_bytes() == contacts_geojson(known.values())
    assert (folder / "contacts.csv").read_bytes() == contacts_csv(known.values()).encode()
    assert (folder / "contacts.kml").read_bytes() == contacts_kml(known.values(), "name").encode()
    assert (folder / "coverage.geojson").read_bytes() == coverage_geojson(patches)


def test_what_the_disk_takes_and_gives_is_counted_over_contacts_and_coverage(found: Found, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> int:
        raise OSError(28, "No space left on device")

    found.keep([contact(1, 0.5)], [patch(0, "port")])
    with monkeypatch.context() as disk:
        disk.setattr("auv_mcm.contacts.shelf.os.pwrite", broken)
        found.keep([contact(2, 0.5)], [patch(1, "port")])
    assert found.n_in_memory == 2
    with monkeypatch.context() as disk:
        disk.setattr("auv_mcm.contacts.shelf.os.pread", broken)
        assert [told.id for told in found.contacts] == ["C00002"]
        assert [told.tile_index for told in found.coverage] == [1]
    assert found.n_unreadable == 2


def test_an_id_that_is_no_number_is_refused(found: Found) -> None:
    with pytest.raises(ValueError, match="C and a number"):
        found.keep([drawn_looks.contact(id="X1")])
