"""Pictures of the waterfall at every scale are those that plain means of its pixels give."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.snippet import unpack_snippet
from sim_replay.view.waterfall_store import TILE_PX, WaterfallStore
from tests.sim_replay.view.shown_missions import filled_store, tile


def level_db(codes: NDArray[np.uint8]) -> NDArray[np.float64]:
    return 10.0 * np.log10(np.maximum(unpack_snippet(codes).astype(np.float64), 1e-4))


def whole(store: WaterfallStore, level: int, n_rows: int) -> NDArray[np.uint8]:
    """All pictures of a level side by side, two tiles to port and two to starboard."""
    rows = range(-(-(n_rows >> level) // TILE_PX))
    return np.vstack([np.hstack([store.picture(level, row, column) for column in (-2, -1, 0, 1)]) for row in rows])


def test_the_finest_picture_holds_every_pixel_where_it_was_seen() -> None:
    store = WaterfallStore()
    for first_row in (0, 64, 128, 192):
        rows, columns = np.mgrid[first_row : first_row + 64, 0:300]
        store.add(tile("starboard", first_row, (1.0 + rows + 0.01 * columns).astype(np.float32)))
        store.add(tile("port", first_row, (0.1 + rows + 0.01 * columns).astype(np.float32)))
    picture = unpack_snippet(whole(store, 0, 256))
    rows, columns = np.mgrid[0:256, 0:300]
    held = np.minimum(picture, 200.0)
    np.testing.assert_allclose(held[:, 512:812], np.minimum(1.0 + rows + 0.01 * columns, 200.0), rtol=0.03)
    np.testing.assert_allclose(held[:, 511:211:-1], np.minimum(0.1 + rows + 0.01 * columns, 200.0), rtol=0.03)
    assert not picture[:, 812:].any()
    assert not picture[:, :212].any()


@pytest.mark.parametrize("level", [1, 2, 3, 4, 5])
def test_a_coarser_picture_is_the_mean_of_the_finest(level: int) -> None:
    n_rows, factor = 1024, 2**level
    store = filled_store(n_rows, 512)
    fine = unpack_snippet(whole(store, 0, n_rows)).astype(np.float64)
    coarse = whole(store, level, n_rows)
    mean = fine.reshape(n_rows // factor, factor, -1, factor).mean(axis=(1, 3))
    n_columns = mean.shape[1] // 2
    shown = coarse[: n_rows // factor, 512 - n_columns : 512 + n_columns]
    # three packings of an eighth of a decibel each
    np.testing.assert_allclose(level_db(shown), 10.0 * np.log10(mean), atol=0.4)


def test_pixels_without_an_echo_do_not_darken_a_coarser_picture() -> None:
    store = WaterfallStore()
    some = np.zeros((64, 64), dtype=np.float32)
    some[::2] = 4.0
    store.add(tile("port", 0, some))
    np.testing.assert_allclose(level_db(store.picture(3, 0, -1)[:8, -8:]), 10.0 * np.log10(4.0), atol=0.3)


def test_a_gap_in_the_track_stays_empty_and_rows_after_it_have_their_place() -> None:
    store = WaterfallStore()
    for first_row in (0, 640):
        store.add(tile("starboard", first_row, np.ones((64, 64), dtype=np.float32)))
    picture = whole(store, 0, 768)
    assert picture[:64, 512:576].all()
    assert not picture[64:640].any()
    assert picture[640:704, 512:576].all()


def test_what_the_disk_is_not_given_to_is_left_out_and_said() -> None:
    store = WaterfallStore(max_bytes=5000)
    for first_row in (0, 64):
        store.add(tile("starboard", first_row, np.ones((64, 64), dtype=np.float32)))
    assert store.is_full
    assert store.picture(0, 0, 0)[:64, :64].all()
    assert not store.picture(0, 0, 0)[64:].any()
    assert store.stop_row == 128
