"""Tests of heights by shadows whose edges are known."""

import pytest

from sim_replay.benches.exact_shadows import GROUND_RANGES_M, exact_heights
from sim_replay.simulator.scene_file import parse_scene

SCENE = """\
name: level
seed: 1
world: {depth_m: 12, relief_rms_m: 0, patch_m: 40, seabeds: [{type: sand, share: 1.0}]}
sonar: {frequency_khz: 450, range_m: 50, n_samples: 800, ping_rate_hz: 10}
track: {altitude_m: 5, plan: {pattern: lawnmower, heading_deg: 20, n_legs: 1, leg_m: 60, spacing_m: 40}}
objects:
  - {kind: box, leg: 0, along_m: 20, across_m: 20, height_m: 0.5}
  - {kind: cylinder, leg: 0, along_m: 35, across_m: -20, burial_m: 0.1}
  - {kind: sphere, leg: 0, along_m: 50, across_m: 20}
"""


def test_on_a_level_floor_heights_are_those_of_the_objects() -> None:
    measured_m, true_m = exact_heights(parse_scene(SCENE, "level")).T
    assert len(measured_m) == 3 * 2 * len(GROUND_RANGES_M)
    assert measured_m == pytest.approx(true_m, abs=0.03)
