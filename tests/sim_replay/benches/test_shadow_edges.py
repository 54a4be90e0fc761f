"""Edges of shadows, found in pixels of which they are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from auv_mcm.records import SIDES, Side
from sim_replay.benches.shadow_edges import clearest_shadow, shadow_edges
from sim_replay.view.places import WaterfallPoint
from sim_replay.view.waterfall_store import WaterfallStore
from tests.sim_replay.view.shown_missions import COLUMN_M, tile

N_ROWS, N_COLUMNS = 256, 400
ROW, HIGHLIGHT_M = 130.5, 12.0  # over two picture tiles' border there would be one more read, in no other order


def store_of(shadow_m: float, *, top_m: float = 0.0, side: Side = "starboard") -> WaterfallStore:
    """Speckle with a bright edge at HIGHLIGHT_M, 16 rows long, a dim top of -8 dB and a shadow of -20 dB."""
    store, speckle = WaterfallStore(), np.random.default_rng(5)
    bright = round(HIGHLIGHT_M / COLUMN_M)
    top, end = bright + round(top_m / COLUMN_M), bright + round((top_m + shadow_m) / COLUMN_M)
    for first_row in range(0, N_ROWS, 64):
        for of_side in SIDES:
            pixels = speckle.exponential(1.0, (64, N_COLUMNS)).astype(np.float32)
            if of_side == side and first_row == 128:
                pixels[:16, bright - 5 : bright] = 20.0
                pixels[:16, bright:top] *= 0.16
                pixels[:16, top:end] *= 0.01
            store.add(tile(of_side, first_row, pixels))
    return store


@pytest.mark.parametrize("side", SIDES)
def test_a_shadow_is_found_from_the_highlight_to_the_lit_floor(side: Side) -> None:
    sign = -1.0 if side == "port" else 1.0
    edges = shadow_edges(store_of(2.4, side=side), WaterfallPoint(ROW + 6.0, sign * HIGHLIGHT_M))
    assert edges is not None
    assert edges.begin.across_m * sign == pytest.approx(HIGHLIGHT_M, abs=2.0 * COLUMN_M)
    assert edges.length_m == pytest.approx(2.4, abs=3.0 * COLUMN_M)
    assert edges.level_db < -10.0


def test_a_dim_top_is_not_taken_for_shadow() -> None:
    edges = shadow_edges(store_of(2.4, top_m=0.9), WaterfallPoint(ROW + 6.0, HIGHLIGHT_M))
    assert edges is not None
    assert edges.length_m == pytest.approx(2.4, abs=0.3)


def test_what_is_too_short_or_out_of_place_is_no_shadow() -> None:
    store = store_of(0.3)
    assert shadow_edges(store, WaterfallPoint(ROW + 6.0, HIGHLIGHT_M)) is None
    assert shadow_edges(store_of(2.4), WaterfallPoint(30.0, HIGHLIGHT_M)) is None
    assert shadow_edges(store, WaterfallPoint(math.nan, HIGHLIGHT_M)) is None


def test_the_clearest_view_is_measured_about_the_middle_of_its_shadow() -> None:
    store = store_of(2.4)
    elsewhere, beyond = WaterfallPoint(40.0, 9.0), WaterfallPoint(ROW + 6.0, 0.95 * N_COLUMNS * COLUMN_M)
    view, edges = clearest_shadow(store, [elsewhere, beyond, WaterfallPoint(ROW + 4.0, HIGHLIGHT_M)])
    assert view == 2
    assert 3 <= len(edges) <= 5
    assert np.median([one.length_m for one in edges]) == pytest.approx(2.4, abs=3.0 * COLUMN_M)
    assert all(128.0 <= one.begin.row <= 144.0 for one in edges)
    assert clearest_shadow(store, [elsewhere, beyond]) == (-1, [])
