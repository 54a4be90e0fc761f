"""What counts as found and what as a false alarm where the source paper's figures are flown again."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_replay.fitting.cascade.tiles import LabelledTile, TileObject
from sim_replay.simulator.objects import place_objects
from sim_replay.studies.figure9 import (
    EXPERIMENTS,
    Image,
    Place,
    Sighting,
    image_scene,
    image_tasks,
    odds_of_share,
    sighted,
    table,
    training_lines,
)

ALTITUDE_M = 6.0


def _tile(*objects: tuple[str, float, float]) -> LabelledTile:
    shape = 200, 600
    everywhere = np.ones(shape, dtype=np.bool_)
    return LabelledTile(
        codes=np.full(shape, 1024, dtype=np.uint16),
        valid=everywhere,
        usable=everywhere,
        core_start=0,
        core_stop=shape[0],
        first_return_m=np.full(shape[0], ALTITUDE_M),
        row_spacing_m=0.12,
        column_spacing_m=0.06,
        side="port",
        objects=tuple(
            TileObject(
                row=row,
                column=column,
                kind=kind,
                is_target=True,
                seabed="sand",
                ground_range_m=column * 0.06,
                aspect_deg=0.0,
                length_m=1.0,
                width_m=1.0,
                height_m=0.4,
            )
            for kind, row, column in objects
        ),
        background="made up",
        origin="simulated",
    )


def test_an_object_is_sighted_once_at_its_best_with_its_shadow_and_the_floor_once_per_place() -> None:
    tile = _tile(("wedge", 50.0, 200.0), ("rock", 150.0, 200.0))
    shadow = 200.0 + 1.0 / 0.06
    places = [
        Place(50, 201, 2.0),
        Place(52, 199, 3.0),
        Place(50, shadow, 5.0),
        Place(150, 200, 1.0),
        Place(100, 400, 0.5),
        Place(103, 402, 0.2),
        Place(120, 400, -1.0),
    ]
    assert sighted(tile, places, math.nan) == [
        Sighting("wedge", 5.0),
        Sighting("rock", 1.0),
        Sighting("floor", 0.5),
        Sighting("floor", -1.0),
    ]


def test_echoes_at_the_slant_range_of_the_surface_are_separated() -> None:
    column = round(math.sqrt(18.0**2 - ALTITUDE_M**2) / 0.06)
    assert [s.what for s in sighted(_tile(), [Place(20, column, 1.0), Place(20, column + 60, 0.0)], 18.0)] == [
        "surface",
        "floor",
    ]


@pytest.mark.parametrize(("share", "odds"), [(0.25, 3.0), (0.5, 2.0), (0.9, -1.0), (1.0, -1.0)])
def test_the_threshold_is_the_odds_of_the_last_object_needed(share: float, odds: float) -> None:
    assert odds_of_share([3.0, 2.0, 0.0, -1.0], 4, share) == odds


def test_objects_never_seen_have_no_threshold_that_finds_them() -> None:
    assert odds_of_share([3.0], 2, 1.0) == -math.inf


def test_the_table_counts_objects_and_false_alarms_of_all_images() -> None:
    seen = (
        Sighting("wedge", 2.0),
        Sighting("cylinder", -0.5),
        Sighting("rock", 1.0),
        Sighting("floor", 0.1),
        Sighting("surface", -2.0),
    )
    image = Image(
        {"central filters": seen, "all features": seen},
        {"wedge": 1, "cylinder": 1, "rock": 1, "truncated_cone": 1},
        0.01,
    )
    even, _, _, every = [line.split() for line in table(EXPERIMENTS[0], [image, image]).splitlines()[2:6]]
    assert " ".join(even) == "central filters even odds 0 of 2 2 of 2 0 of 2 2 of 2 0 2 2.0 200"
    assert " ".join(every) == "central filters all learned 0 of 2 2 of 2 2 of 2 2 of 2 0 2 2.0 200"


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=["first", "second"])
def test_images_hold_the_objects_of_the_paper(experiment: object) -> None:
    chosen = next(one for one in EXPERIMENTS if one is experiment)
    placed = place_objects(image_scene(chosen, 9100))
    targets = [scene_object.kind for scene_object in placed if scene_object.is_target]
    wanted = {kind: n for kind, n in chosen.objects.items() if kind not in chosen.not_targets}
    assert {kind: targets.count(kind) for kind in wanted} == wanted
    assert len(targets) == sum(wanted.values())


def test_images_are_never_learned_from() -> None:
    learned = {line.scene.seed for line in training_lines(2)}
    assert learned.isdisjoint(task.line.scene.seed for task in image_tasks(EXPERIMENTS[0], {}, 3))
