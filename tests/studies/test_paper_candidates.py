"""What counts as found and what as a false alarm where the source paper's figures are flown again."""

from __future__ import annotations

import math

import numpy as np

from auv_mcm.settings.config import Config
from sim_replay.fitting.cascade.tiles import LabelledTile, TileObject
from sim_replay.studies.paper_candidates import (
    NORMALISED,
    CutChips,
    ImageCandidates,
    Sighting,
    TileCandidates,
    kept_places,
    scored_image,
    sightings,
    tile_candidates,
)

ALTITUDE_M = 6.0
ROW_M, COLUMN_M = 0.12, 0.06
SHAPE = 200, 600
SHADOW_PX = 25


def _made_up(kind: str, row: float, column: float) -> TileObject:
    return TileObject(
        row=row,
        column=column,
        kind=kind,
        is_target=kind != "rock",
        seabed="sand",
        ground_range_m=column * COLUMN_M,
        aspect_deg=0.0,
        length_m=1.0,
        width_m=1.0,
        height_m=0.4,
    )


def _tile(*objects: tuple[str, float, float]) -> LabelledTile:
    """Draw a speckled floor with a bright spot before a dark one at each object."""
    random = np.random.Generator(np.random.PCG64(4))
    echo = random.exponential(1024.0, SHAPE)
    for _, row, column in objects:
        rows = slice(round(row) - 4, round(row) + 5)
        echo[rows, round(column) - 5 : round(column) + 6] = 12_000.0
        echo[rows, round(column) + 6 : round(column) + 6 + SHADOW_PX] = 20.0
    everywhere = np.ones(SHAPE, dtype=np.bool_)
    return LabelledTile(
        codes=np.minimum(echo, 16_384.0).astype(np.uint16),
        valid=everywhere,
        usable=everywhere,
        core_start=0,
        core_stop=SHAPE[0],
        first_return_m=np.full(SHAPE[0], ALTITUDE_M),
        row_spacing_m=ROW_M,
        column_spacing_m=COLUMN_M,
        side="port",
        objects=tuple(_made_up(*one) for one in objects),
        background="made up",
        origin="simulated",
    )


def _candidates(object_index: list[int], covers: list[tuple[int, int]]) -> TileCandidates:
    n = len(object_index)
    covered = np.eye(n, dtype=np.bool_)
    for first, second in covers:
        covered[first, second] = True
    return TileCandidates(
        rows=np.zeros(n, dtype=np.int32),
        columns=np.zeros(n, dtype=np.int32),
        chips={},
        detector_odds=np.zeros(n),
        ground_range_m=10.0 * np.arange(n, dtype=np.float64),
        object_index=np.array(object_index),
        covers=covered,
        on_surface=np.arange(n) == n - 1,
        kinds=("wedge", "rock"),
        is_target=(True, False),
        object_range_m=(5.0, 25.0),
        usable_m2=np.full(100, 10.0),
        column_m=1.0,
    )


def test_an_object_is_sighted_once_at_its_best_and_the_floor_once_per_place() -> None:
    tile = _candidates([0, 0, 1, -1, -1, -1, -2], [(3, 4), (4, 3)])
    odds = np.array([2.0, 5.0, 1.0, 0.2, 0.5, -1.0, 9.0])
    assert sightings([tile], lambda _: odds) == [
        Sighting("wedge", True, 5.0),
        Sighting("rock", False, 1.0),
        Sighting("floor", False, 0.5),
        Sighting("floor", False, -1.0),
    ]


def test_a_place_in_the_shadow_of_a_better_one_is_left_out_and_not_the_other_way_round() -> None:
    tile = _candidates([-1, -1], [(0, 1)])
    assert kept_places(tile, np.array([2.0, 1.0])) == [0]
    assert kept_places(tile, np.array([1.0, 2.0])) == [1, 0]


def test_what_cannot_be_judged_is_neither_found_nor_a_false_alarm() -> None:
    tile = _candidates([0, -1], [])
    assert sightings([tile], lambda _: np.full(2, -math.inf)) == []
    assert scored_image(ImageCandidates("flat", (tile,)), lambda _: np.full(2, -math.inf)).n_targets == 1


def test_a_band_of_ranges_holds_its_own_objects_places_and_area() -> None:
    image = ImageCandidates("flat", (_candidates([0, -1, 1, -1], []),))
    far = scored_image(image, lambda _: np.arange(4.0), (20.0, 50.0))
    assert far.n_targets == 0
    assert far.log_odds.tolist() == [2.0, 3.0]
    assert math.isclose(far.area_km2, 300e-6)


def test_candidates_lie_on_objects_and_in_their_shadows() -> None:
    found = tile_candidates(_tile(("wedge", 50.0, 200.0), ("rock", 150.0, 400.0)), Config())
    assert found.kinds == ("wedge", "rock")
    assert {0, 1} <= set(found.object_index.tolist())
    on = found.object_index == 0
    assert (np.abs(found.rows[on] - 50.0) * ROW_M < 1.6).all()
    chips = found.chips[NORMALISED]
    assert isinstance(chips, CutChips)
    assert len(chips.contrast) == len(chips.known) == len(found.rows) == len(found.detector_odds)
    assert found.covers.diagonal().all()


def test_echoes_at_the_slant_range_of_the_surface_are_separated() -> None:
    column = 300.0
    surface_m = math.hypot(column * COLUMN_M, ALTITUDE_M)
    found = tile_candidates(_tile(("rock", 100.0, column)), Config(), surface_m)
    on = found.object_index == 0
    assert found.on_surface[on].any()
    assert not found.on_surface[np.abs(found.ground_range_m - column * COLUMN_M) > 5.0].any()


def test_chips_are_cut_in_every_way_asked_for() -> None:
    found = tile_candidates(_tile(("rock", 100.0, 500.0)), Config(), cuts={"shares": None, "metres": 0.4})
    assert set(found.chips) == {"shares", "metres"}
    assert not np.array_equal(found.chips["shares"].contrast, found.chips["metres"].contrast)
