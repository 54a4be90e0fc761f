"""Outlines of a known object in recorded side-scan tiles, and no mines on recorded bare sea floor."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from auv_mcm.classify.odds import shipped_odds
from auv_mcm.records import VALID
from tests.real.pictures.picture_speckle import picture_speckle
from tests.real.pictures.real_calls import call
from tests.real.pictures.real_outlines import judge_outlines
from tests.real.pictures.real_pictures import EFFIGY_M, Picture, effigies, length_px, read_picture
from tests.real.pictures.real_tiles import SAS, SIDE_SCAN, tile_of_picture

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
QUIET = ("image_2_orig", "image_6_orig", "image_8_orig", "image_9_orig", "image_10_orig", "image_11_orig")


@pytest.fixture(scope="module")
def pictures(shared_data: SharedData) -> dict[str, Picture]:
    return {picture.name: picture for picture in effigies(shared_data(TILES).parents[1])}


def test_counts_are_amplitudes_of_speckle_once_inverted_tiles_are_turned_back(pictures: dict[str, Picture]) -> None:
    assert {name[5:20] for name, picture in pictures.items() if picture.inverted} == {
        "20240429102455H",
        "20240429102644H",
    }
    # Logarithms would be skewed to the other side.
    skewed = [picture_speckle(picture.amplitude).skewness > 0.0 for picture in pictures.values()]
    assert skewed.count(True) >= 0.85 * len(skewed)
    # The low frequency has single looks: a Rayleigh amplitude deviates by 0.52 of its mean, and is skewed by 0.63.
    evidence = [picture_speckle(picture.amplitude) for name, picture in pictures.items() if "L_" in name]
    assert statistics.median(e.relative_std for e in evidence) == pytest.approx(0.52, abs=0.08)
    assert statistics.median(e.skewness for e in evidence) == pytest.approx(0.63, abs=0.3)


def test_shadows_lie_to_the_right_whichever_side_the_tile_is_of(pictures: dict[str, Picture]) -> None:
    darker: dict[str, list[bool]] = {"left": [], "right": []}
    for name, picture in pictures.items():
        if picture.mask is None or picture.cut:
            continue
        levelled = tile_of_picture(picture, SIDE_SCAN).intensity[:, SIDE_SCAN.n_columns_before :]
        before, behind = [], []
        for row in np.flatnonzero(picture.mask.any(axis=1)).tolist():
            columns = np.flatnonzero(picture.mask[row])
            before.append(levelled[row, max(columns[0] - 20, 0) : columns[0] - 2])
            behind.append(levelled[row, columns[-1] + 3 : columns[-1] + 21])
        dark = [float((np.concatenate(strip) < 0.1).mean()) for strip in (before, behind)]
        darker[name.split("_")[0]].append(dark[0] < dark[1])
    for side, found in darker.items():
        assert sum(found) >= 0.8 * len(found) > 0, side


def test_effigy_is_as_long_as_it_is_at_the_assumed_pixel_size(pictures: dict[str, Picture]) -> None:
    lengths = [length_px(picture.mask) for picture in pictures.values() if picture.mask is not None and not picture.cut]
    assert statistics.median(lengths) * SIDE_SCAN.pixel_m == pytest.approx(EFFIGY_M, rel=0.1)


def test_range_marks_and_fill_are_not_sea_floor(shared_data: SharedData) -> None:
    name = "left_20240429102030L_sample_1_tile_1.png"
    picture = read_picture(shared_data(f"{TILES}/{name}"))
    assert not picture.measured[120:198, 204:218].any()
    assert picture.measured[:, :190].all()
    filled = read_picture(shared_data(f"{TILES}/left_20240429102455H_sample_2_tile_9.png"))
    assert not filled.measured[150:].any()


def test_a_tile_has_its_sea_floor_at_one_and_nothing_before_the_picture(pictures: dict[str, Picture]) -> None:
    tile = tile_of_picture(pictures["right_20240429112817L_sample_2_tile_5"], SIDE_SCAN)
    valid = (tile.mask & VALID) != 0
    assert not valid[:, : SIDE_SCAN.n_columns_before].any()
    assert tile.intensity[valid].mean() == pytest.approx(1.0, abs=0.1)


def test_snakes_outline_the_effigy_where_it_stands_out(pictures: dict[str, Picture]) -> None:
    for name, bound in CLEAR.items():
        judged = judge_outlines(pictures[name], SIDE_SCAN, shipped_odds("contrast"))
        assert judged.detected, name
        assert judged.given.iou.best_start >= bound, name
        assert judged.found is not None
        assert judged.found.iou.best_start >= bound - 0.05, name


@pytest.mark.parametrize("name", QUIET)
def test_quiet_sea_floor_holds_no_mine(name: str, shared_data: SharedData) -> None:
    called = call(read_picture(shared_data(f"sas/{name}.png")), SAS, shipped_odds("contrast"))
    assert called.n_confirmed(0.5) == 0
