"""The area covered, overlap counted once."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.contacts.seen_area import SeenArea
from auv_mcm.frozen_state import freeze, thaw
from auv_mcm.records import CoveragePatch
from tests.make.records import cells_of, patch_of

CELLS = st.dictionaries(
    st.tuples(st.integers(-70, 70), st.integers(-70, 70)), st.sampled_from([0.25, 0.5, 1.0]), max_size=20
)


def patch(cells: dict[tuple[int, int], float] | None, covered_m2: float = 0.0, cell_m: float = 4.0) -> CoveragePatch:
    return patch_of(covered_m2=covered_m2, cells=None if cells is None else cells_of(cells, cell_m=cell_m))


@given(st.lists(CELLS, max_size=5), st.sampled_from([2.0, 4.0]))
def test_of_each_cell_no_more_than_all_of_it_counts(patches: list[dict[tuple[int, int], float]], cell_m: float) -> None:
    area, total = SeenArea(), dict[tuple[int, int], float]()
    for cells in patches:
        area.add(patch(cells, cell_m=cell_m))
        for place, fraction in cells.items():
            total[place] = min(total.get(place, 0.0) + fraction, 1.0)
    assert area.km2 == pytest.approx(1e-6 * cell_m**2 * sum(total.values()))


def test_what_has_no_place_counts_in_full() -> None:
    area = SeenArea()
    area.add(patch(None, covered_m2=500.0))
    area.add(patch(None, covered_m2=500.0))
    assert area.km2 == pytest.approx(1e-3)


def test_an_area_goes_on_where_it_was_frozen_and_takes_a_quarter_of_a_number_per_cell() -> None:
    """A strip of 100 m by 8 km: 50,000 cells, and 50,000 more in blocks that it touches."""
    area = SeenArea()
    area.add(patch({(east, north): 0.5 if east in (0, 24) else 1.0 for east in range(25) for north in range(2000)}))
    frozen = freeze(area, {})
    assert len(frozen) < 50_000
    again = thaw(frozen, {})
    for each in (area, again):
        each.add(patch({(0, 0): 0.75, (1, 0): 1.0, (99, 0): 1.0}))
    assert again.km2 == area.km2 == pytest.approx(16e-6 * (23 + 2 * 0.5) * 2000 + 16e-6 * 1.5)
