"""The paper's objects lie where they are said to, floors are counted once, and equal curves give equal drawings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from auv_mcm.errors import UsageError
from sim_replay.missions import SCENES
from sim_replay.scoring.roc import RankedMission
from sim_replay.simulator.objects import place_objects
from sim_replay.simulator.scene import TARGET_KINDS
from sim_replay.simulator.scene_file import read_scene
from sim_replay.studies.figure12 import Flown, floor_once_km2, panels, report
from sim_replay.studies.figure12_plot import draw
from sim_replay.studies.paper_mines import MINES, PER_LINE, embedded, with_mines


def _flown(group: str, best: float) -> Flown:
    def one(p: float) -> RankedMission:
        return RankedMission(group, {kind: np.array([p, 0.3]) for kind in MINES}, np.array([0.6, 0.2]), 0.05)

    return {"chain": one(best), "plain": one(0.1)}


MISSIONS = [_flown(group, best) for group in ("flat", "mixed", "river", "river") for best in (0.7, 0.9)]


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_has_as_many_targets_as_before_all_of_the_papers_sizes(name: str) -> None:
    before = [one for one in place_objects(read_scene(name)) if one.kind in TARGET_KINDS]
    after = [one for one in place_objects(with_mines(read_scene(name))) if one.kind in TARGET_KINDS]
    assert len(after) == len(before)
    assert {one.kind for one in after} == set(MINES)
    for one in after:
        sizes = next(mine.sizes_m for kind, mine in MINES.items() if kind == one.kind)
        assert {size: getattr(one, size) for size in sizes} == pytest.approx(sizes)


def test_a_recorded_line_gets_the_three_objects_and_no_rocks() -> None:
    spec = embedded(7)
    assert spec.seed == 7
    assert [group.kinds for group in spec.scatter] == [(kind,) for kind in MINES]
    assert {group.count for group in spec.scatter} == {PER_LINE}


def test_a_recorded_floor_counts_once_however_often_it_is_drawn_on() -> None:
    assert floor_once_km2(MISSIONS[4:]) == pytest.approx(0.05)
    assert floor_once_km2(MISSIONS[:4]) == pytest.approx(0.2)


def test_the_table_has_every_object_of_both_groups_and_every_scene_and_line() -> None:
    rows = [line.split("  ")[0] for line in report(MISSIONS).splitlines()[2:]]
    assert rows.count("recorded lines") == rows.count("simulated missions") == 8
    assert rows.count("river") == rows.count("flat") == 2


def test_equal_curves_give_the_same_drawing_small_enough_for_a_page(tmp_path: Path) -> None:
    curves = panels(MISSIONS)
    for name in ("one.svg", "two.svg"):
        draw(curves, tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
    assert (tmp_path / "one.svg").stat().st_size < 100_000


def test_a_drawing_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    curves = panels(MISSIONS)[:1]
    with pytest.raises(UsageError, match="not a picture format"):
        draw(curves, tmp_path / "curves.doc")
    with pytest.raises(UsageError, match="cannot be written"):
        draw(curves, tmp_path / "none" / "curves.svg")
