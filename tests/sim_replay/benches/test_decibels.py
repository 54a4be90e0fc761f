"""What wrong decibels per count cost: every reading of one mission is scored, and a right figure is one of them."""

from __future__ import annotations

import pytest

from sim_replay.benches import mission_source
from sim_replay.benches.decibels import ESTIMATED, EXPERIMENT, FACTORS, fly
from sim_replay.benches.experiment import Task, experiment_rows
from sim_replay.simulator.scene_file import parse_scene

SCENE = """
world: {depth_m: 12, seabeds: [{type: sand, stones_per_ha: 0}], relief_rms_m: 0}
sonar: {frequency_khz: 450, range_m: 25, n_samples: 500, ping_rate_hz: 10}
track: {altitude_m: 5, plan: {pattern: lawnmower, n_legs: 1, leg_m: 40}}
objects: [{kind: cylinder, leg: 0, along_m: 20, across_m: 12, azimuth_deg: 0, length_m: 2, width_m: 0.5}]
"""


def test_a_mission_is_read_with_right_wrong_and_estimated_decibels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mission_source, "read_scene", lambda name: parse_scene(SCENE, name))
    monkeypatch.setattr(mission_source, "named_scenes", lambda: ("one-target",))
    flown = fly(Task("one-target", 3))
    assert list(flown) == [*FACTORS, ESTIMATED]
    rows = {row.variant: row.cells for row in experiment_rows(EXPERIMENT, ["one-target"], [flown])}
    assert list(rows) == ["right", "-27%", "-15%", "+15%", "+44%", "estimated"]
    assert rows["right"]["Pd at 100 FA/km²"].text.startswith("1.00")
