"""What counts as called, missed and false in the complex scene, and where it is marked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from auv_mcm.errors import UsageError
from sim_replay.report.pictures import PictureCollector
from sim_replay.scoring.inputs import ObjectPass, ReportedContact, Truth, TruthObject
from sim_replay.simulator.objects import place_objects
from sim_replay.studies.figure13 import FIRST_SEED, KIND, complex_scene, judge, report
from sim_replay.studies.marked_waterfall import Mark, save_waterfall, waterfall
from tests.sim_replay.report_samples import tile

DEG_PER_M = 1.0 / 111_320.0


def _object(kind: str, north_m: float, *, is_target: bool) -> TruthObject:
    return TruthObject(
        kind=kind,
        latitude_deg=north_m * DEG_PER_M,
        longitude_deg=0.0,
        is_target=is_target,
        seabed="sand",
        looks=(ObjectPass(ground_range_m=20.0),),
    )


def _contact(north_m: float, *, called: bool, classification: str = KIND) -> ReportedContact:
    return ReportedContact(north_m * DEG_PER_M, 0.0, 0.5, classification=classification, called=called)


TRUTH = Truth(
    area_km2=0.01,
    objects=(
        *(_object(KIND, north_m, is_target=True) for north_m in (0.0, 50.0, 100.0)),
        _object("rock", 150.0, is_target=False),
    ),
)
CONTACTS = (
    _contact(0.5, called=True),
    _contact(50.5, called=False),
    _contact(150.5, called=True),
    _contact(200.0, called=True),
    _contact(250.0, called=False),
)


def test_cones_are_called_reported_or_missed_and_other_calls_are_false() -> None:
    image = judge(CONTACTS, TRUTH)
    assert [(one.found, one.called, one.classification) for one in image.cones] == [
        (True, True, KIND),
        (True, False, ""),
        (False, False, ""),
    ]
    assert [one.on for one in image.alarms] == ["rock", ""]
    assert [one.contact for one in image.alarms] == list(CONTACTS[2:4])


def test_the_table_counts_them() -> None:
    last = report([judge(CONTACTS, TRUTH)]).split("\n\n")[0].splitlines()[-1].split()
    assert last[:3] == ["all", "0.010", "3"]
    assert [last[3], last[5], last[7], last[9]] == ["0.67", "0.33", "1.00", "2"]


def test_the_scene_has_cones_of_the_papers_size_on_four_kinds_of_floor() -> None:
    scene = complex_scene(FIRST_SEED)
    cones = [one for one in place_objects(scene) if one.is_target]
    assert {(one.kind, one.width_m, one.height_m) for one in cones} == {(KIND, 0.98, 0.44)}
    assert {one.type for one in scene.world.seabeds} == {"sand", "rippled_sand", "boulder_field", "seagrass"}


def _pictures() -> PictureCollector:
    pictures = PictureCollector()
    for index in range(3):
        pictures.add_tile(tile(index, "port"))
        pictures.add_tile(tile(index, "starboard"))
    return pictures


def test_marks_lie_where_their_places_are() -> None:
    bare, circled = waterfall(_pictures(), []), waterfall(_pictures(), [Mark(15.0, 6.0, "false alarm")])
    picture = slice(0, -30)  # the legend below counts marks
    rows, columns = np.nonzero((bare != circled)[picture].any(axis=2))
    per_m = bare.shape[1] / 24.0  # two sides of 12 m
    height_m = (len(bare) - 30) / per_m
    assert rows.mean() / per_m == pytest.approx(height_m - 15.0, abs=0.2)
    assert columns.mean() / per_m == pytest.approx(12.0 + 6.0, abs=0.2)


def test_a_picture_of_another_format_is_an_error(tmp_path: Path) -> None:
    save_waterfall(_pictures(), [], tmp_path / "one.webp")
    assert (tmp_path / "one.webp").stat().st_size > 0
    with pytest.raises(UsageError, match="Choose one of them"):
        save_waterfall(_pictures(), [], tmp_path / "one.doc")
