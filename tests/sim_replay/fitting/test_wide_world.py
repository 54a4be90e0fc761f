"""Drawn missions are valid, differ in everything, and are the same for the same seed."""

from __future__ import annotations

import pytest

from sim_replay.fitting.wide_world import wide_scene
from sim_replay.simulator.objects import place_objects
from sim_replay.simulator.scene import TARGET_KINDS
from sim_replay.simulator.scene_file import check_scene

SEEDS = range(40)


def test_the_same_seed_draws_the_same_mission() -> None:
    assert wide_scene(7) == wide_scene(7)


def test_no_two_missions_share_sonar_floor_motion_or_objects() -> None:
    scenes = [wide_scene(seed) for seed in SEEDS]
    for part in ("sonar", "world", "track", "scatter"):
        assert len({repr(getattr(scene, part)) for scene in scenes}) == len(scenes)


def test_every_mission_is_valid_and_has_targets_of_every_kind() -> None:
    for seed in SEEDS:
        scene = wide_scene(seed)
        check_scene(scene)
        assert {group.kind for group in scene.scatter if group.kind in TARGET_KINDS} == TARGET_KINDS


@pytest.mark.parametrize("seed", range(0, 40, 5))
def test_there_is_room_for_every_object(seed: int) -> None:
    scene = wide_scene(seed)
    assert len(place_objects(scene)) == sum(group.count for group in scene.scatter)


def test_all_recorder_laws_are_drawn_and_ranges_span_a_factor_of_four() -> None:
    scenes = [wide_scene(seed) for seed in range(200)]
    stores = {scene.sonar.recorder.samples for scene in scenes}
    assert {"log_uint8", "amplitude_uint8", "amplitude_uint16", "amplitude_float32"} <= stores
    ranges_m = [scene.sonar.range_m for scene in scenes]
    assert max(ranges_m) > 4.0 * min(ranges_m)
    assert max(scene.sonar.looks for scene in scenes) >= 6
