"""Outlines of a known object in recorded side-scan tiles, and no mines on recorded bare sea floor."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from auv_mcm.classify.odds import shipped_odds
from auv_mcm.confirm.mrf import segment
from auv_mcm.confirm.region import Region
from auv_mcm.confirm.snake import converge, start_from_detection, start_from_labels
from auv_mcm.confirm.snake_rules import contour_mask
from auv_mcm.confirm.speckle import grain_area
from auv_mcm.confirmation import confirm_detection, labels_near, region_of
from tests.real.recorded_pictures import SAS, SIDE_SCAN, Mask, detections_of, read_picture, tile_of_picture

SharedData = Callable[[str], Path]

TILES = "sdvd_20240429/images"
CLEAR = {
    "right_20240429112817L_sample_2_tile_5": 0.65,
    "left_20240429102030L_sample_1_tile_1": 0.63,
    "left_20240429094643L_sample_1_tile_17": 0.55,
    "left_20240429102030L_sample_2_tile_5": 0.65,
}
"""Tiles of good contrast, and what the snake's overlap with the mask must reach: about a sixth less than it was found
to be."""
NEAR_M = 0.5  # from the mask, for a detection to be of the object
QUIET = ("image_2_orig", "image_6_orig", "image_8_orig", "image_9_orig", "image_10_orig", "image_11_orig")


def outlined(region: Region) -> Mask:
    """The highlight as confirmation outlines it: by the better of two starts."""
    area = grain_area(region.intensity, region.valid)
    snake = converge(region, start_from_detection(region), correlation_px=area)
    own = labels_near(segment(region).labels, region)
    again = snake if own is None else converge(region, start_from_labels(region, own), correlation_px=area)
    best = again if again.criterion < snake.criterion else snake
    return contour_mask(best.highlight, region.intensity.shape)


@pytest.mark.parametrize("name", CLEAR)
def test_snakes_outline_the_effigy_where_it_stands_out(name: str, shared_data: SharedData) -> None:
    path = shared_data(f"{TILES}/{name}.png")
    mask = np.pad(read_picture(path.parents[1] / "masks" / path.name) > 127, ((0, 0), (SIDE_SCAN.n_columns_before, 0)))
    rows, columns = np.nonzero(mask)
    config = SIDE_SCAN.config
    near = [
        detection
        for detection in detections_of(tile_of_picture(read_picture(path), SIDE_SCAN), config)
        if np.hypot(rows + 0.5 - detection.row, columns + 0.5 - detection.column).min() * SIDE_SCAN.pixel_m <= NEAR_M
    ]
    found = max(near, key=lambda detection: detection.p_mine)
    assert found.surroundings is not None
    region = region_of(found, found.surroundings, math.radians(SIDE_SCAN.beam_width_deg))
    n_rows, n_columns = region.intensity.shape
    top, left = round(found.row - found.surroundings.row), round(found.column - found.surroundings.column)
    inside, contour = mask[top : top + n_rows, left : left + n_columns], outlined(region)
    both = int((contour & inside).sum())
    assert both / (int(contour.sum()) + int(mask.sum()) - both) >= CLEAR[name]


@pytest.mark.parametrize("name", QUIET)
def test_quiet_sea_floor_holds_no_mine(name: str, shared_data: SharedData) -> None:
    config, odds = SAS.config, shipped_odds("contrast")
    tile = tile_of_picture(read_picture(shared_data(f"sas/{name}.png")), SAS)
    looked_at = [
        confirm_detection(detection, math.radians(SAS.beam_width_deg), odds, config.confirm)
        for detection in detections_of(tile, config)
    ]
    called = [one for one in looked_at if one.p_mine >= 0.5]
    assert all(one.confirmation is not None and one.confirmation.rejected for one in called)
