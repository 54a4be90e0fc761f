"""A side that hears noise alone: known ping by ping, reported once, and never for a block or two."""

from __future__ import annotations

from collections import Counter

import numpy as np
from msgspec import structs

from auv_mcm.records import Notice
from auv_mcm.waterfall.floor_watch import FloorWatch
from tests.auv_mcm.clearance.covered_tiles import plain, tile_of


def fed(rises: list[float]) -> tuple[FloorWatch, list[Notice], Counter[str]]:
    """Blocks of 32 pings a second, each with its rise."""
    counters: Counter[str] = Counter()
    watch = FloorWatch("port", counters)
    raised = [watch.add(np.full(32, rise), block + np.arange(32) / 32.0) for block, rise in enumerate(rises)]
    return watch, [notice for some in raised for notice in some], counters


def test_many_pings_without_a_floor_are_reported_once_and_fewer_are_counted() -> None:
    assert [notice.code for notice in fed([0.0] * 30)[1]] == ["quality.floor_not_heard"]
    _, notices, counters = fed(([0.0] * 7 + [1.0]) * 4)
    assert not notices
    assert counters == {"quality.port_floor_not_heard": 4 * 7 * 32}


def test_rows_are_those_of_pings_without_a_floor_also_where_the_clock_is_set_back() -> None:
    watch = fed([1.0, 0.0, np.nan, 0.1, 0.3, 1.0])[0]
    tile = tile_of(plain())
    at_s = np.linspace(0.0, 6.0, len(tile.pose))
    tile = structs.replace(tile, pose=structs.replace(tile.pose, time_s=at_s))
    unheard = watch.unheard_rows(tile)
    assert unheard[(at_s > 1.0) & (at_s < 1.9)].all()
    assert unheard[(at_s > 3.0) & (at_s < 4.9)].all()  # 0.3 alone would be a floor, behind silence it is none yet
    assert not unheard[(at_s < 1.0) | ((at_s > 2.0) & (at_s < 3.0)) | (at_s > 5.0)].any()
    for back_s in (50.0, 0.0):
        watch.add(np.zeros(32), back_s + np.arange(32) / 32.0)
    assert watch.unheard_rows(tile)[at_s < 0.9].all()
