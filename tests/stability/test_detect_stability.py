"""Extreme pictures through the detection stage: no floating-point flag, no NaN, the same result every time."""

from __future__ import annotations

import numpy as np
import pytest

from auv_mcm.detect.detect_tile import TileDetections, detect_tile
from auv_mcm.records import Tile
from auv_mcm.settings.config import Config
from tests.stability.tile_pictures import SHAPE, speckle, tile_of, with_object


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


@pytest.mark.parametrize("first_return_m", [0.0, 1e-9, 0.05, 0.3, 1.0, 30.0, 190.0])
@pytest.mark.parametrize("spacing", [(0.01, 0.005), (0.12, 0.06), (2.0, 2.0), (0.01, 2.0), (2.0, 0.02)])
def test_no_altitude_and_no_grid_raises_a_flag(first_return_m: float, spacing: tuple[float, float]) -> None:
    shape = (60, 90)
    looked_at(tile_of(speckle(3, shape), row_m=spacing[0], column_m=spacing[1], first_return_m=first_return_m))


@pytest.mark.parametrize("shape", [(1, 1), (1, 400), (2, 3), (400, 1), (7, 7)])
def test_no_shape_raises_a_flag(shape: tuple[int, int]) -> None:
    looked_at(tile_of(speckle(4, shape)))


def test_reversing_the_track_finds_the_same_object() -> None:
    plane = with_object(speckle(5))
    there, back = (looked_at(tile_of(p)).detections[0] for p in (plane, plane[::-1]))
    assert SHAPE[0] - back.row == pytest.approx(there.row, abs=1.0)
    assert back.column == pytest.approx(there.column, abs=1.0)
    assert back.score == pytest.approx(there.score, abs=1e-3)
