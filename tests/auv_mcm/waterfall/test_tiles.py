"""Tiles: cores partition the rows, and the content of a core does not depend on where the cuts lie."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.records import SATURATED, SIDES, TURN, VALID, Side, Tile
from auv_mcm.settings.config import WaterfallConfig
from auv_mcm.waterfall.grid import SideImage, Swath, slice_swath
from auv_mcm.waterfall.radiometry import LOCAL_MEAN_REACH_M
from auv_mcm.waterfall.tiles import TileCutter
from tests.auv_mcm.waterfall.simulated_pings import straight_poses

SPACING_M = 0.25
OVERLAP_M = LOCAL_MEAN_REACH_M + 1.0
OVERLAP_ROWS = 34


def config(tile_rows: int) -> WaterfallConfig:
    return WaterfallConfig(row_spacing_m=SPACING_M, column_spacing_m=SPACING_M, tile_rows=tile_rows)


def swath(n_rows: int, first_row: int, *, sides: tuple[Side, ...] = SIDES, n_columns: int = 40, seed: int = 0) -> Swath:
    random = np.random.default_rng(seed)
    images: dict[Side, SideImage] = {}
    for side in sides:
        mask = np.where(random.random((n_rows, n_columns)) < 0.9, VALID, 0).astype(np.uint8)
        mask |= np.where((random.random(mask.shape) < 0.02) & (mask != 0), np.uint8(SATURATED), np.uint8(0))
        mask |= np.where(random.random(mask.shape) < 0.02, np.uint8(TURN), np.uint8(0))
        images[side] = SideImage(
            np.where(mask & VALID, random.exponential(size=mask.shape), 0.0).astype(np.float32), mask
        )
    rows = np.arange(first_row, first_row + n_rows)
    distance = rows.astype(np.float64)
    along_m = (distance + 0.5) * SPACING_M
    return Swath(
        along_m, straight_poses(n_rows, first_row), 6.0 + 0.001 * distance, np.full(n_rows, 0.1), rows + 1000, images
    )


def cut(
    rows: Swath, first_row: int, tile_rows: int, *, origin_row: int = 0, piece: int = 50, overlap_m: float = OVERLAP_M
) -> tuple[list[Tile], TileCutter]:
    cutter = TileCutter(config(tile_rows), overlap_m, origin_row)
    tiles: list[Tile] = []
    for start in range(0, rows.n_rows, piece):
        tiles += cutter.add(first_row + start, slice_swath(rows, slice(start, start + piece)))
    return tiles + cutter.close(), cutter


def core_rows(tile: Tile) -> range:
    return range(tile.first_row + tile.core_start, tile.first_row + tile.core_stop)


def stitched(tiles: list[Tile], side: Side) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    mine = [tile for tile in tiles if tile.side == side]
    return (
        np.concatenate([tile.intensity[tile.core_start : tile.core_stop] for tile in mine]),
        np.concatenate([tile.mask[tile.core_start : tile.core_stop] for tile in mine]),
    )


@given(
    n_rows=st.integers(1, 400),
    first_row=st.integers(0, 300),
    tile_rows=st.integers(64, 150),
    origin_row=st.integers(0, 149),
    piece=st.integers(1, 200),
)
@settings(max_examples=25)
def test_cores_hold_every_row_exactly_once_in_order(
    n_rows: int, first_row: int, tile_rows: int, origin_row: int, piece: int
) -> None:
    rows = swath(n_rows, first_row, n_columns=4)
    tiles, _ = cut(rows, first_row, tile_rows, origin_row=origin_row % tile_rows, piece=piece)
    for side in SIDES:
        mine = [tile for tile in tiles if tile.side == side]
        assert [row for tile in mine for row in core_rows(tile)] == list(range(first_row, first_row + n_rows))
        assert [tile.index for tile in mine] == sorted({tile.index for tile in mine})
    for tile in tiles:
        assert {(row - origin_row % tile_rows) // tile_rows for row in core_rows(tile)} == {tile.index}
        n = tile.intensity.shape[0]
        assert 0 <= tile.core_start < tile.core_stop <= n
        assert tile.core_start == min(OVERLAP_ROWS, core_rows(tile).start - first_row)
        assert n - tile.core_stop == min(OVERLAP_ROWS, first_row + n_rows - core_rows(tile).stop)
        assert tile.mask.shape == tile.intensity.shape
        here = np.arange(tile.first_row, tile.first_row + n)
        np.testing.assert_array_equal(tile.ping_number, here + 1000)
        np.testing.assert_array_equal(tile.first_return_m, 6.0 + 0.001 * here)
        np.testing.assert_array_equal(tile.pose.time_s, straight_poses(n, tile.first_row).time_s)
        assert len(tile.pose) == tile.first_return_sigma_m.shape[0] == n


@pytest.mark.parametrize("origin_row", [0, 1, 17, 63, 200])
@pytest.mark.parametrize("tile_rows", [64, 97, 512])
def test_a_core_pixel_does_not_depend_on_where_tiles_are_cut(tile_rows: int, origin_row: int) -> None:
    rows = swath(500, 130)
    reference, reference_mask = stitched(cut(rows, 130, 4096)[0], "port")
    intensity, mask = stitched(cut(rows, 130, tile_rows, origin_row=origin_row)[0], "port")
    np.testing.assert_array_equal(mask, reference_mask)
    np.testing.assert_allclose(intensity, reference, rtol=1e-6)


def test_tiles_do_not_depend_on_how_the_rows_came() -> None:
    rows = swath(400, 10)
    expected, _ = cut(rows, 10, 128)
    for piece in (1, 7, 400):
        tiles, _ = cut(rows, 10, 128, piece=piece)
        assert [(tile.side, tile.index, tile.first_row, tile.core_start, tile.core_stop) for tile in tiles] == [
            (tile.side, tile.index, tile.first_row, tile.core_start, tile.core_stop) for tile in expected
        ]
        for one, other in zip(tiles, expected, strict=True):
            np.testing.assert_array_equal(one.intensity, other.intensity)


def test_a_tile_comes_as_soon_as_its_overlap_is_there() -> None:
    rows = swath(400, 0)
    cutter = TileCutter(config(128), OVERLAP_M)
    for row in range(400):
        tiles = cutter.add(row, slice_swath(rows, slice(row, row + 1)))
        assert [tile.index for tile in tiles] == (
            [row // 128 - 1] * 2 if row >= 128 and row % 128 == OVERLAP_ROWS - 1 else []
        )


def test_the_newest_rows_are_tiles_with_overlap_at_both_ends() -> None:
    cutter, rows = TileCutter(config(256), OVERLAP_M), swath(90, 100)
    for start in (0, 45):
        cutter.add(100 + start, slice_swath(rows, slice(start, start + 45)))
    for tile in cutter.newest(150, 32, 20, 8):
        assert core_rows(tile) == range(150, 182)
        assert tile.ping_number.tolist() == list(range(1130, 1190))
    assert cutter.newest(150, 33, 20, 8) == []


def test_the_local_mean_of_the_sea_floor_is_one_and_saturated_pixels_have_no_say() -> None:
    plain = swath(200, 0)
    image = plain.sides["port"]
    clipped = (image.mask & SATURATED) != 0
    usable = (image.mask & (VALID | SATURATED)) == VALID
    quiet = SideImage(
        np.where(usable, image.intensity, 0.0).astype(np.float32), np.where(usable, image.mask, 0).astype(np.uint8)
    )
    tiles, _ = cut(plain._replace(sides={"port": quiet}), 0, 4096)
    assert tiles[0].intensity[usable].mean() == pytest.approx(1.0, abs=0.03)
    loud = SideImage(np.where(clipped, np.float32(1e6), image.intensity), image.mask)
    with_clipped, _ = cut(plain._replace(sides={"port": loud}), 0, 4096)
    np.testing.assert_array_equal(with_clipped[0].intensity[usable], tiles[0].intensity[usable])
    assert (with_clipped[0].intensity[clipped] > 1e4).all()


def test_where_too_little_is_known_nothing_is_valid() -> None:
    plain = swath(200, 0, sides=("port",), n_columns=200)
    image = plain.sides["port"]
    sparse = np.where(np.arange(200)[None, :] < 100, image.mask, np.uint8(0))
    sparse[::20, 150] = VALID
    tiles, _ = cut(
        plain._replace(sides={"port": SideImage(np.where(sparse, image.intensity, 0.0).astype(np.float32), sparse)}),
        0,
        4096,
    )
    assert not (tiles[0].mask[:, 130:] & VALID).any()
    assert not tiles[0].intensity[:, 130:].any()
    np.testing.assert_array_equal(tiles[0].mask[:, :80], image.mask[:, :80])


def test_a_side_without_rows_makes_no_tiles_until_it_appears() -> None:
    cutter = TileCutter(config(64), OVERLAP_M)
    tiles = cutter.add(0, swath(150, 0, sides=("port",)))
    tiles += cutter.add(150, swath(150, 150))
    tiles += cutter.close()
    assert [(tile.index, tile.side) for tile in tiles] == [
        (0, "port"),
        *((index, side) for index in range(1, 5) for side in SIDES),
    ]
    starboard = stitched(tiles, "starboard")[1]
    assert not starboard[: 150 - 64].any()
    assert starboard[150 - 64 :].any()


@given(
    lengths=st.lists(st.integers(1, 200), min_size=1, max_size=5),
    tile_rows=st.integers(64, 100),
    origin_row=st.integers(0, 63),
)
@settings(max_examples=25)
def test_segments_never_share_a_tile_index(lengths: list[int], tile_rows: int, origin_row: int) -> None:
    cutter = TileCutter(config(tile_rows), OVERLAP_M, origin_row)
    first_row, seen, last_stop = 0, set[int](), 0
    for n_rows in lengths:
        tiles = cutter.add(first_row, swath(n_rows, first_row, sides=("port",), n_columns=4)) + cutter.close()
        indices = {tile.index for tile in tiles}
        assert not indices & seen
        assert min(tile.first_row for tile in tiles) >= last_stop
        seen |= indices
        last_stop = first_row + n_rows
        first_row = cutter.next_segment_row()
        assert first_row >= last_stop
    assert cutter.close() == []
    assert cutter.next_segment_row() == first_row
