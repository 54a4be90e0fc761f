"""Coverage comes back in the order of the file that it is written to, without its cells, whatever the disk takes."""

from __future__ import annotations

import os
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.contacts.coverage_store import CoverageStore, store_patch
from auv_mcm.records import CoveragePatch, Side
from tests.auv_mcm.contacts.temporary_records import temporary_record_file
from tests.auv_mcm.contacts.whole_exports import coverage_geojson
from tests.make.disks import full
from tests.make.records import patch_of
from tests.make.results import write_results


def patch(tile_index: int, side: Side) -> CoveragePatch:
    ring = np.array([[179.9, 43.0], [-179.9, 43.0], [-179.9, 43.1], [179.9, 43.0]])
    return patch_of(
        side=side, tile_index=tile_index, rings_deg=(ring,), covered_m2=float(tile_index), lost_m2={"turn": 1.0}
    )


@settings(max_examples=30, deadline=None)
@given(tiles=st.lists(st.tuples(st.integers(0, 6), st.sampled_from(["port", "starboard"]), st.booleans()), max_size=12))
def test_the_file_is_that_of_all_patches_held_at_once(
    tmp_path_factory: pytest.TempPathFactory, tiles: list[tuple[int, Side, bool]]
) -> None:
    folder, write = tmp_path_factory.mktemp("results"), os.pwrite
    patches = [patch(tile_index, side) for tile_index, side, _ in tiles]

    with closing(temporary_record_file(folder)) as records, pytest.MonkeyPatch.context() as disk:
        coverage = CoverageStore(records)
        for each, (_, _, is_full) in zip(patches, tiles, strict=True):
            disk.setattr("auv_mcm.contacts.record_file.os.pwrite", full if is_full else write)
            coverage.keep(store_patch(records, each))
        disk.setattr("auv_mcm.contacts.record_file.os.pwrite", write)
        assert coverage.n_in_memory == sum(is_full for _, _, is_full in tiles)
        write_results(folder, (), coverage.in_order(), (), "name")
    assert (folder / "coverage.geojson").read_bytes() == coverage_geojson(patches)
