"""The map of the sea floor against the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import SEABED_TYPES
from sim_replay.benches.experiment import experiment_rows
from sim_replay.benches.seabed import EXPERIMENT, MAP, Scored
from sim_replay.fitting.seabed.seabed_score import confusion_m2, shares
from sim_replay.scoring.seabed_map import NOT_SWEPT, SeabedMap, encode
from tests.make.records import clearance_of

FLAT, RIPPLE, ROUGH, VEGETATION, UNKNOWN = range(len(SEABED_TYPES))
AT_DEG = (43.0, 5.0)


def mapped(
    seabed: list[list[int]], first_east: int = 0, first_north: int = 0, unseen: tuple[int, int] | None = None
) -> Clearance:
    """Four by four metres a cell."""
    kind = np.array(seabed, dtype=np.uint8)
    looks = np.ones(kind.shape, dtype=np.uint8)
    if unseen is not None:
        looks[unseen] = 0
    return clearance_of(
        np.ones(kind.shape) * 0.5, first_east=first_east, first_north=first_north, looks=looks, seabed=kind
    )


def true_map(cells: NDArray[np.int64], types: tuple[str, ...], east_m: float = 0.0, north_m: float = 0.0) -> SeabedMap:
    """One by one metre a cell, its corner so far from the map's origin."""
    latitude_deg, longitude_deg, _ = LocalFrame(latitude_deg=AT_DEG[0], longitude_deg=AT_DEG[1]).to_geodetic(
        [east_m, north_m, 0.0]
    )
    return encode(cells, types=types, cell_m=1.0, latitude_deg=float(latitude_deg), longitude_deg=float(longitude_deg))


def test_every_square_metre_that_was_swept_and_seen_counts() -> None:
    cells = np.zeros((8, 8), dtype=np.int64)
    cells[:, 5:] = 1  # the border of seagrass runs through the eastern cells
    cells[7, :] = NOT_SWEPT
    reported = confusion_m2(mapped([[FLAT, VEGETATION], [FLAT, UNKNOWN]]), true_map(cells, ("mud", "seagrass")))
    expected = np.zeros((5, 5))
    expected[FLAT, FLAT] = 4 * 7  # the western cells, less the row that was not swept
    expected[FLAT, VEGETATION], expected[VEGETATION, VEGETATION] = 4, 3 * 4
    expected[FLAT, UNKNOWN], expected[VEGETATION, UNKNOWN] = 3, 3 * 3
    assert reported == pytest.approx(expected)


def test_cells_that_the_map_has_not_seen_do_not_count() -> None:
    cells = np.zeros((8, 8), dtype=np.int64)
    assert confusion_m2(mapped([[FLAT, FLAT], [FLAT, FLAT]], unseen=(0, 1)), true_map(cells, ("sand",))).sum() == 48.0


def test_maps_with_corners_of_their_own_are_laid_over_each_other() -> None:
    cells = np.full((4, 4), 0, dtype=np.int64)
    cells[:, 2:] = 1
    reported = confusion_m2(
        mapped([[ROUGH, RIPPLE]], first_east=-2, first_north=25),
        true_map(cells, ("gravel", "rippled_sand"), east_m=-6.0, north_m=100.0),
    )
    assert reported[ROUGH, ROUGH] == 8.0
    assert reported[RIPPLE, RIPPLE] == 8.0
    assert reported.sum() == 16.0


def test_unknown_is_not_a_way_to_look_good() -> None:
    area_m2 = np.zeros((5, 5))
    area_m2[FLAT, FLAT], area_m2[FLAT, ROUGH], area_m2[ROUGH, UNKNOWN] = 60.0, 20.0, 20.0
    reported = shares(area_m2)
    assert reported == pytest.approx((0.6, 0.2, 0.75))
    assert all(math.isnan(share) for share in shares(np.zeros((5, 5))))


def test_a_report_has_each_scene_and_all_of_them_together() -> None:
    area_m2 = np.zeros((5, 5))
    area_m2[FLAT, FLAT] = 3e4
    other_m2 = np.zeros((5, 5))
    other_m2[RIPPLE, FLAT] = 1e4
    flown = [{MAP: Scored(one, 0.0)} for one in (area_m2, other_m2)]
    rows = experiment_rows(EXPERIMENT, ["one", "two"], flown)
    assert [(row.missions, row.cells["right"].value) for row in rows] == [("one", 1.0), ("two", 0.0), ("all", 0.75)]
