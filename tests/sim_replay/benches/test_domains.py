"""p_mine on whole domains: counts at given false alarms, calibration, and the tables."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from sim_replay.benches.domains import EXPERIMENT, OWN, grouped, n_found_at, reliability
from sim_replay.benches.experiment import experiment_rows
from sim_replay.fitting.recorders import RECORDED_SCENES, RECORDERS, recorded_by
from sim_replay.simulator.scene_file import check_scene, read_scene
from tests.sim_replay.fitting.test_background_fit import drawn_mission


def test_targets_are_counted_above_the_threshold_that_lets_so_many_false_alarms_pass() -> None:
    missions = [drawn_mission(1), drawn_mission(2)]
    background = np.concatenate([one.background for one in missions])
    mines = np.concatenate([one.mines for one in missions])
    area_km2 = sum(one.truth_km2 for one in missions)
    for limit in (0.0, 30.0, 300.0, 1e9):
        best = max(
            (np.count_nonzero(mines >= at) for at in mines if np.count_nonzero(background >= at) <= limit * area_km2),
            default=0,
        )
        assert n_found_at(missions, limit) == best


def test_reliability_counts_every_contact_once() -> None:
    missions = [drawn_mission(1), drawn_mission(2)]
    found = reliability(missions)
    assert sum(one.on_mines.of for one in found.bins) == sum(len(one.background) + len(one.mines) for one in missions)
    assert sum(one.on_mines.count for one in found.bins) == sum(len(one.mines) for one in missions)


def test_domains_are_pooled_by_kind() -> None:
    recorder = next(iter(RECORDERS))
    names = ("flat", "rough", recorder, "reef", "river")
    groups = grouped([drawn_mission(number, name) for number, name in enumerate(names, 1)])
    assert [len(groups[name]) for name in ("all scenes", "all recorded lines")] == [2, 2]
    assert "all recorders" not in groups


@pytest.mark.parametrize("name", RECORDED_SCENES)
@pytest.mark.parametrize("recorder", list(RECORDERS))
def test_a_scene_with_another_recorder_is_valid_and_else_the_same(name: str, recorder: str) -> None:
    scene = read_scene(name)
    other = recorded_by(scene, RECORDERS[recorder])
    check_scene(other)
    assert other.sonar != scene.sonar
    assert msgspec.structs.replace(other, sonar=scene.sonar) == scene


def test_every_scene_and_line_has_a_row_for_each_recorder_that_it_was_flown_with() -> None:
    recorder = next(iter(RECORDERS))
    flown = [
        {OWN: drawn_mission(1, "flat"), recorder: drawn_mission(2, recorder)},
        {OWN: drawn_mission(3, "rough")},
        {OWN: drawn_mission(4, "reef")},
    ]
    rows = experiment_rows(EXPERIMENT, ["flat", "rough", "reef"], flown)
    assert [(row.missions, row.variant) for row in rows] == [
        *(("flat", OWN), ("flat", recorder), ("rough", OWN), ("reef", OWN)),
        *(("all simulated", OWN), ("all simulated", recorder), ("all recorded", OWN)),
    ]
    assert all(row.cells["calibration error"].value is not None for row in rows)
    assert "reef" in EXPERIMENT.words(flown[2:])
