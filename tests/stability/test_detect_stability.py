"""Extreme pictures through the detection stage: no floating-point flag, no NaN, the same result every time."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.config import Config
from auv_mcm.detect.stage import TileDetections, detect_tile
from auv_mcm.geodesy import LocalFrame
from auv_mcm.records import SATURATED, TURN, VALID, PoseTrack, Tile

SHAPE = (130, 220)
ROW_M, COLUMN_M = 0.12, 0.06


def tile_of(
    intensity: NDArray[Any],
    mask: NDArray[np.uint8] | None = None,
    *,
    row_m: float = ROW_M,
    column_m: float = COLUMN_M,
    first_return_m: float = 5.0,
) -> Tile:
    n_rows = intensity.shape[0]
    bits = np.full(intensity.shape, VALID, dtype=np.uint8) if mask is None else mask
    along_m = (np.arange(n_rows) + 0.5) * row_m
    latitude, longitude, _ = LocalFrame(latitude_deg=60.0, longitude_deg=5.0).to_geodetic(
        np.stack((np.zeros(n_rows), along_m, np.zeros(n_rows)), axis=-1)
    )
    columns: dict[str, Any] = dict.fromkeys(
        ("depth_m", "heading_rad", "pitch_rad", "roll_rad", "speed_mps", "altitude_m"), np.zeros(n_rows)
    )
    pose = PoseTrack(
        time_s=np.asarray(along_m / 1.5, dtype=np.float64),
        latitude_deg=latitude,
        longitude_deg=longitude,
        stale=np.zeros(n_rows, dtype=np.bool_),
        **columns,
    )
    return Tile(
        side="port",
        index=0,
        first_row=0,
        core_start=0,
        core_stop=n_rows,
        row_spacing_m=row_m,
        column_spacing_m=column_m,
        intensity=np.where((bits & VALID) != 0, intensity, 0.0).astype(np.float32),
        mask=bits,
        pose=pose,
        first_return_m=np.full(n_rows, first_return_m),
        first_return_sigma_m=np.full(n_rows, 0.1),
        ping_number=np.arange(n_rows, dtype=np.int64),
    )


def speckle(seed: int = 0, shape: tuple[int, int] = SHAPE) -> NDArray[np.float64]:
    return np.random.default_rng(seed).exponential(1.0, shape)


def with_object(floor: NDArray[np.float64], row: int = 60, column: int = 100) -> NDArray[np.float64]:
    drawn = floor.copy()
    drawn[row : row + 5, column : column + 6] *= 15.0
    drawn[row : row + 5, column + 6 : column + 26] *= 0.02
    return drawn


def looked_at(tile: Tile) -> TileDetections:
    """Detections with every floating-point flag but underflow an error."""
    with np.errstate(all="raise", under="ignore"):
        result = detect_tile(tile, Config())
    for d in result.detections:
        assert np.isfinite([d.row, d.column, d.score, d.p_mine, d.latitude_deg, d.longitude_deg, d.length_m, d.width_m]).all()
        assert np.isfinite(d.covariance_m2).all()
    return result


def holes(share: float) -> NDArray[np.uint8]:
    return np.where(np.random.default_rng(1).random(SHAPE) < share, 0, VALID).astype(np.uint8)


def ripples(direction_deg: float) -> NDArray[np.float64]:
    """Sand ripples 0.3 m from crest to crest, 6 dB deep."""
    row, column = np.indices(SHAPE)
    direction = np.deg2rad(direction_deg)
    phase = 2.0 * np.pi * (row * ROW_M * np.cos(direction) + column * COLUMN_M * np.sin(direction)) / 0.3
    return np.asarray(speckle() * (1.0 + 0.6 * np.sin(phase)))


ROWS, COLUMNS = np.indices(SHAPE)
PICTURES: dict[str, NDArray[Any]] = {
    "constant": np.ones(SHAPE),
    "zero": np.zeros(SHAPE),
    "checkerboard": ((ROWS + COLUMNS) % 2).astype(np.float64),
    "impulse": np.where((ROWS == 60) & (COLUMNS == 100), 1e6, 1.0),
    "one bit": (speckle() > 1.0).astype(np.float64),
    "gain ramp of 40 dB": speckle() * 10.0 ** (4.0 * COLUMNS / SHAPE[1] - 2.0),
    "gain ramp along track": speckle() * 10.0 ** (4.0 * ROWS / SHAPE[0] - 2.0),
    "smallest numbers": speckle() * 1e-44,
    "largest numbers": np.minimum(speckle() * 1e38, 3e38),
    "half zero": speckle() * (ROWS < 65),
    "half dark": np.where(COLUMNS < 110, speckle(), 1e-4 * speckle(1)),
    "single pixels of echo in nothing": (np.random.default_rng(2).random(SHAPE) < 0.01).astype(np.float64),
    "ripples along track": ripples(0.0),
    "ripples across track": ripples(90.0),
    "ripples aslant": ripples(45.0),
}


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
    def told(result: TileDetections) -> list[tuple[Any, ...]]:
        return [
            (d.row, d.column, d.score, d.p_mine, d.latitude_deg, d.covariance_m2.tolist(), d.snippet.tobytes()) for d in result.detections
        ]

    return told(a) == told(b) and a[1:] == b[1:]


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
