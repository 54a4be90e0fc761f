"""Extreme pictures through the detection stage: no floating-point flag, no NaN, the same result every time."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from auv_mcm.detect.detect_tile import TileDetections, detect_tile
from auv_mcm.records import SATURATED, TURN, VALID, Tile
from auv_mcm.settings.config import Config
from tests.stability.tile_pictures import COLUMN_M, PICTURES, ROW_M, SHAPE, holes, speckle, tile_of, with_object


def looked_at(tile: Tile) -> TileDetections:
    """Detections with every floating-point flag but underflow an error."""
    with np.errstate(all="raise", under="ignore"):
        result = detect_tile(tile, Config())
    for d in result.detections:
        assert np.isfinite(
            [d.row, d.column, d.score, d.p_mine, d.latitude_deg, d.longitude_deg, d.length_m, d.width_m]
        ).all()
        assert np.isfinite(d.covariance_m2).all()
    return result


@pytest.mark.parametrize("name", PICTURES)
def test_no_picture_raises_a_floating_point_flag(name: str) -> None:
    looked_at(tile_of(PICTURES[name]))


@pytest.mark.parametrize("share", [0.001, 0.1, 0.5, 0.95, 1.0])
def test_no_mask_raises_a_floating_point_flag(share: float) -> None:
    looked_at(tile_of(with_object(speckle()), holes(share)))


@pytest.mark.parametrize("bit", [SATURATED, TURN])
def test_flags_on_half_the_picture_raise_none(bit: int) -> None:
    mask = np.full(SHAPE, VALID, dtype=np.uint8)
    mask[:, 110:] |= np.uint8(bit)
    looked_at(tile_of(with_object(speckle()), mask))


@pytest.mark.parametrize("first_return_m", [0.0, 1e-9, 0.05, 0.3, 1.0, 30.0, 190.0])
@pytest.mark.parametrize("spacing", [(0.01, 0.005), (0.12, 0.06), (2.0, 2.0), (0.01, 2.0), (2.0, 0.02)])
def test_no_altitude_and_no_grid_raises_a_flag(first_return_m: float, spacing: tuple[float, float]) -> None:
    shape = (60, 90)
    looked_at(tile_of(speckle(3, shape), row_m=spacing[0], column_m=spacing[1], first_return_m=first_return_m))


@pytest.mark.parametrize("shape", [(1, 1), (1, 400), (2, 3), (400, 1), (7, 7)])
def test_no_shape_raises_a_flag(shape: tuple[int, int]) -> None:
    looked_at(tile_of(speckle(4, shape)))


def same(a: TileDetections, b: TileDetections) -> bool:
    def fields_of(result: TileDetections) -> list[tuple[Any, ...]]:
        return [
            (d.row, d.column, d.score, d.p_mine, d.latitude_deg, d.covariance_m2.tolist(), d.snippet.tobytes())
            for d in result.detections
        ]

    faint = all(map(np.array_equal, a.faint, b.faint))
    return (
        fields_of(a) == fields_of(b) and faint and a._replace(detections=(), faint=b.faint) == b._replace(detections=())
    )


def test_the_same_tile_gives_the_same_bits_alone_and_among_threads() -> None:
    tiles = [tile_of(with_object(speckle(k))) for k in range(4)]
    alone = [detect_tile(tile, Config()) for tile in tiles]
    with ThreadPoolExecutor(2) as threads:
        together = list(threads.map(lambda tile: detect_tile(tile, Config()), tiles))
    assert all(map(same, alone, together))
    assert any(result.detections for result in alone)


def test_reversing_the_track_finds_the_same_object() -> None:
    plane = with_object(speckle(5))
    there, back = (looked_at(tile_of(p)).detections[0] for p in (plane, plane[::-1]))
    assert SHAPE[0] - back.row == pytest.approx(there.row, abs=1.0)
    assert back.column == pytest.approx(there.column, abs=1.0)
    assert back.score == pytest.approx(there.score, abs=1e-3)


def test_every_pixel_doubled_finds_the_same_object() -> None:
    plane = with_object(speckle(6))
    finer = np.repeat(np.repeat(plane, 2, axis=0), 2, axis=1)
    coarse = looked_at(tile_of(plane)).detections[0]
    fine = looked_at(tile_of(finer, row_m=0.5 * ROW_M, column_m=0.5 * COLUMN_M)).detections[0]
    assert fine.row * 0.5 == pytest.approx(coarse.row, abs=1.0)
    assert fine.column * 0.5 == pytest.approx(coarse.column, abs=1.5)
    assert fine.p_mine == pytest.approx(coarse.p_mine, abs=0.2)


def test_one_pixel_missing_in_a_hundred_does_not_lose_an_object() -> None:
    for seed in range(5):
        found = looked_at(tile_of(with_object(speckle(seed)), holes(0.01))).detections[0]
        assert abs(found.row - 62.5) < 2.0
        assert abs(found.column - 103.0) < 4.0
