"""Cells against placing every covered pixel by itself."""

from __future__ import annotations

import math
import tracemalloc
from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.clearance.coverage import CoverageGrid, cover_tile
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.georeference import EchoGeometry, locate
from auv_mcm.geometry.pose_track import interpolate_track
from auv_mcm.records import SEABED_TYPES, TURN, VALID, SeabedCells, Side, SurveyedCells, Tile
from auv_mcm.settings.config import SonarConfig
from tests.auv_mcm.clearance.covered_tiles import COLUMN_M, FIRST_RETURN_M, ROW_M, plain, tile_of, track

CELL_M = 4.0
GRID = CoverageGrid(LocalFrame(latitude_deg=43.7, longitude_deg=10.3), CELL_M)


def cells_of(tile: Tile, *, fraction: float = 1.0, seabed: SeabedCells | None = None) -> SurveyedCells:
    cells = cover_tile(tile, SonarConfig(), fraction, GRID, seabed).cells
    assert cells is not None
    return cells


def by_pixels(tile: Tile) -> dict[tuple[int, int], tuple[float, float]]:
    """Area in m² and mean ground range per cell, pixel by pixel."""
    core = slice(tile.core_start, tile.core_stop)
    rows, columns = np.nonzero(tile.mask[core] == VALID)
    position = (rows + tile.core_start).astype(np.float64)
    ground_m = (columns + 0.5) * tile.column_spacing_m
    echoes = EchoGeometry(
        side=tile.side,
        pose=interpolate_track(tile.pose, position),
        slant_range_m=np.hypot(ground_m, FIRST_RETURN_M),
        first_return_m=np.full(len(rows), FIRST_RETURN_M),
        sound_speed_mps=np.full(len(rows), 1500.0),
    )
    place = GRID.frame.to_enu(*locate(echoes, SonarConfig()))[:, :2]
    areas: dict[tuple[int, int], list[float]] = defaultdict(list)
    for (east, north), ground in zip(np.floor(place / CELL_M).astype(int).tolist(), ground_m, strict=True):
        areas[east, north].append(float(ground))
    return {cell: (len(grounds) * ROW_M * COLUMN_M, float(np.mean(grounds))) for cell, grounds in areas.items()}


def seabed_of(tile: Tile, kind: NDArray[np.uint8], ripple_rad: float = math.nan) -> SeabedCells:
    shape = kind.shape
    return SeabedCells(
        cell_m=(5.0, 5.0),
        kind=kind,
        confidence=np.full(shape, 0.75, dtype=np.float32),
        ripple_rad=np.full(shape, ripple_rad, dtype=np.float32),
        wavelength_m=np.full(shape, 0.8, dtype=np.float32),
        unevenness_db=2.0 + kind.astype(np.float32),
    )


@settings(max_examples=15, deadline=None)
@given(
    heading_deg=st.floats(0.0, 360.0),
    seed=st.integers(0, 1000),
    side=st.sampled_from(["port", "starboard"]),
    core=st.booleans(),
)
def test_cells_hold_what_pixels_hold(heading_deg: float, seed: int, side: Side, core: bool) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    mask = plain()
    first, near = int(rng.integers(0, 150)), int(rng.integers(8, 60))
    mask[first : first + 40, near:] = VALID | TURN
    tile = tile_of(mask, track(200, heading_deg=heading_deg), side, (20, 170) if core else None)
    cells, expected = cells_of(tile), by_pixels(tile)
    reported = {
        (int(east), int(north)): (float(fraction) * CELL_M**2, float(ground))
        for east, north, fraction, ground in zip(
            cells.east_index, cells.north_index, cells.fraction, cells.ground_range_m, strict=True
        )
    }
    seen_m2 = sum(area for area, _ in expected.values())
    # Whole blocks in a cell that does not hold a whole number of them make it fuller than full, which is cut off.
    assert 0.94 * seen_m2 <= sum(area for area, _ in reported.values()) <= 1.001 * seen_m2
    for cell, (area, ground) in expected.items():
        area_reported, ground_reported = reported.get(cell, (0.0, ground))
        # A block of half a metre lies in one cell as a whole: at most a strip of half a block along the cell's edges is
        # misplaced.
        assert area_reported == pytest.approx(area, abs=2.5)
        if area > 0.5 * CELL_M**2:
            assert ground_reported == pytest.approx(ground, abs=0.5)


@pytest.mark.parametrize(
    ("side", "heading_deg", "look_deg"), [("starboard", 0.0, 90.0), ("port", 0.0, 270.0), ("starboard", 300.0, 30.0)]
)
def test_cells_show_the_direction_looked_in(side: Side, heading_deg: float, look_deg: float) -> None:
    cells = cells_of(tile_of(plain(), track(200, heading_deg=heading_deg), side))
    assert np.rad2deg(cells.look_rad) == pytest.approx(look_deg, abs=0.01)
    assert cells.altitude_m == pytest.approx(FIRST_RETURN_M)


def test_what_the_budget_left_out_is_not_surveyed() -> None:
    tile = tile_of(plain())
    assert cells_of(tile, fraction=0.25).fraction == pytest.approx(0.25 * cells_of(tile).fraction)


@pytest.mark.parametrize("n_rows", [1, 2, 3, 5, 197, 250])
def test_tiles_of_any_length_have_cells(n_rows: int) -> None:
    cells = cells_of(tile_of(plain(n_rows)))
    assert cells.altitude_m == pytest.approx(FIRST_RETURN_M)


def test_no_cell_is_more_than_whole() -> None:
    assert float(cells_of(tile_of(plain())).fraction.max()) <= 1.0


@pytest.mark.parametrize(("n_pixels", "n_cells"), [(0, 0), (5, 0), (6, 1)])
def test_a_cell_of_which_less_than_a_hundredth_was_seen_is_left_out(n_pixels: int, n_cells: int) -> None:
    """A cell has 16 m², a pixel 0.03."""
    mask = np.zeros((100, 80), dtype=np.uint8)
    mask[:3, 40:42].flat[:n_pixels] = VALID
    cells = cover_tile(tile_of(mask), SonarConfig(), 1.0, GRID).cells
    assert (0 if cells is None else len(cells.fraction)) == n_cells


def test_cells_take_the_kind_that_most_of_them_is() -> None:
    tile = tile_of(plain())
    kind = np.full((5, 4), SEABED_TYPES.index("flat"), dtype=np.uint8)
    kind[:, 2:] = SEABED_TYPES.index("ripple")
    cells = cells_of(tile, seabed=seabed_of(tile, kind, math.radians(179.0)))
    far = cells.ground_range_m > 13.0
    near = cells.ground_range_m < 8.0
    assert set(cells.seabed[far].tolist()) == {SEABED_TYPES.index("ripple")}
    assert set(cells.seabed[near].tolist()) == {SEABED_TYPES.index("flat")}
    assert cells.confidence == pytest.approx(0.75, abs=1e-6)
    assert np.rad2deg(cells.ripple_rad[far]) == pytest.approx(179.0, abs=0.01)
    assert cells.wavelength_m[far] == pytest.approx(0.8, abs=1e-6)
    assert cells.unevenness_db[far] == pytest.approx(2.0 + SEABED_TYPES.index("ripple"), abs=1e-6)


def test_the_map_of_the_sea_floor_begins_where_the_core_of_its_tile_does() -> None:
    """The core begins 4.8 m from where cells do, and its first 5 m are flat: of the third cell 1.8 m of 4 are."""
    tile = tile_of(plain(), core=(40, 180))
    flat, ripple = SEABED_TYPES.index("flat"), SEABED_TYPES.index("ripple")
    kind = np.full((4, 4), ripple, dtype=np.uint8)
    kind[0] = flat
    cells = cells_of(tile, seabed=seabed_of(tile, kind))
    for north, commonest, unevenness_db in ((1, flat, 2.0 + flat), (2, ripple, 2.55), (3, ripple, 2.0 + ripple)):
        there = cells.north_index == north
        assert set(cells.seabed[there].tolist()) == {commonest}
        assert cells.unevenness_db[there] == pytest.approx(unevenness_db, abs=0.1), "of all that was seen"


def test_rows_that_cannot_be_placed_put_no_cell_anywhere_else() -> None:
    tile = tile_of(plain())
    latitude = tile.pose.latitude_deg.copy()
    latitude[[81, 82, 133]] = math.nan  # within blocks of rows that are placed
    cells = cells_of(structs.replace(tile, pose=structs.replace(tile.pose, latitude_deg=latitude)))
    whole = cells_of(tile)
    assert set(zip(cells.east_index, cells.north_index, strict=True)) == set(
        zip(whole.east_index, whole.north_index, strict=True)
    )
    assert 0.9 < cells.fraction.sum() / whole.fraction.sum() < 1.0


def test_without_a_map_of_the_sea_floor_it_is_unknown() -> None:
    cells = cells_of(tile_of(plain()))
    assert set(cells.seabed.tolist()) == {SEABED_TYPES.index("unknown")}
    assert not cells.confidence.any()
    assert np.isnan(cells.ripple_rad).all()
    assert np.isnan(cells.unevenness_db).all()


def displaced(tile: Tile, degrees: float, rows: slice) -> Tile:
    """The same tile with some rows placed elsewhere on Earth."""
    latitude, longitude = tile.pose.latitude_deg.copy(), tile.pose.longitude_deg.copy()
    latitude[rows] += degrees
    longitude[rows] += degrees
    return structs.replace(tile, pose=structs.replace(tile.pose, latitude_deg=latitude, longitude_deg=longitude))


@pytest.mark.parametrize("degrees", [0.001, 0.5, 30.0])
def test_a_tile_with_a_position_far_off_costs_no_memory_for_what_lies_between(degrees: float) -> None:
    tile = displaced(tile_of(plain()), degrees, slice(100, 140))
    cells_of(tile_of(plain()))  # what is allocated once
    tracemalloc.start()
    try:
        cells = cells_of(tile)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak_bytes < 20e6
    # A few blocks lie between the two places: they straddle the step. Nothing is lost or counted twice.
    assert cells.fraction.sum() * CELL_M**2 == pytest.approx(
        cells_of(tile_of(plain())).fraction.sum() * CELL_M**2, rel=0.05
    )
