"""Scenes from YAML: what is left out is usual, what cannot be is refused by key and reason."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.errors import UsageError
from sim_replay.simulator.scene import Lawnmower, Scene
from sim_replay.simulator.scene_file import named_scenes, parse_scene, read_scene

PLAN = "track: {plan: {pattern: lawnmower}}\n"


def test_a_plan_is_all_that_a_scene_needs() -> None:
    scene = parse_scene("track: {plan: {pattern: lawnmower, n_legs: 3}}", "scene.yaml")
    assert isinstance(scene.track.plan, Lawnmower)
    assert scene.track.plan.n_legs == 3
    assert scene == Scene(track=scene.track)


@pytest.mark.parametrize(
    ("text", "key", "reason"),
    [
        ("", "track", "missing"),
        ("- 1", "list", "track"),
        ("track: {plan: {pattern: zigzag}}", "track.plan", "zigzag"),
        ("track: {plan: {pattern: lawnmower}, altitud_m: 5}", "track", "altitud_m"),
        (PLAN + "sonar: {ping_rate_hz: 0}", "sonar.ping_rate_hz", "> 0"),
        (PLAN + "sonar: {ping_rate_hz: 40}", "sonar.ping_rate_hz", "at most 15.0 Hz"),
        (PLAN + "sonar: {n_samples: .nan}", "sonar.n_samples", "finite"),
        (PLAN + "sonar: {recorder: {samples: int24}}", "sonar.recorder.samples", "int24"),
        (PLAN + "sonar: {recorder: {samples: log_uint8, full_scale: 256}}", "recorder.full_scale", "at most 255"),
        (PLAN + "sonar: {range_resolution_m: 2, n_samples: 20000}", "sonar.range_resolution_m", "at most 0.637"),
        (PLAN + "sonar: {speckle_along_track_m: 5, ping_rate_hz: 99, range_m: 7}", "speckle_along", "at most 4.636"),
        (PLAN + "sonar: {frequency_khz: 3000, range_m: 150, ping_rate_hz: 3}", "sonar.range_m", "482 dB"),
        (
            PLAN + "sonar: {synthetic_aperture: {sub_apertures: 3, view: 3}}",
            "sonar.synthetic_aperture.view",
            "3 sub-apertures",
        ),
        (
            "track: {plan: {pattern: lawnmower}, altitude_m: 60}\nworld: {depth_m: 100}",
            "track.altitude_m",
            "does not reach the floor",
        ),
        ("track: {plan: {pattern: lawnmower}, altitude_m: 25}", "track.altitude_m", "above the surface"),
        ("track: {plan: {pattern: lawnmower}, motion: {current_mps: 1.7}}", "track.motion.current_mps", "1.44"),
        (
            "track: {plan: {pattern: lawnmower}, motion: {pitch_offset_deg: -3, pitch_sigma_deg: 20}}",
            "motion",
            "83 deg",
        ),
        ("track: {plan: {pattern: waypoints, points_m: [[0, 0], [0, 0]]}}", "track.plan", "leg 0"),
        ("track: {plan: {pattern: waypoints, points_m: [[0, 0]]}}", "track.plan.points_m", "length >= 2"),
        ("track: {plan: {pattern: waypoints, points_m: [[0, 0], [0, 1e6]]}}", "track.plan.points_m[1][1]", "<= 50000"),
        ("track: {plan: {pattern: lawnmower, start_north_m: -1e6}}", "track.plan.start_north_m", ">= -50000"),
        (PLAN + "world: {slope_deg: 20}", "world.slope_deg", "leaves"),
        (PLAN + "world: {seabeds: []}", "world.seabeds", "length >= 1"),
        (PLAN + "world: {seabeds: [{type: lava}]}", "world.seabeds[0].type", "lava"),
        (
            PLAN + "world: {seabeds: [{type: sand, texture_shape: 0.01}]}",
            "world.seabeds[0].texture_shape",
            "at least 0.1",
        ),
        (PLAN + "objects: [{kind: rock}]", "objects[0]", "give its place once"),
        (PLAN + "objects: [{kind: rock, east_m: 1}]", "objects[0]", "give its place once"),
        (PLAN + "objects: [{kind: rock, east_m: 1, north_m: 2, leg: 0}]", "objects[0]", "give its place once"),
        (PLAN + "objects: [{kind: sphere, leg: 2, along_m: 5, across_m: 9}]", "objects[0]", "2 legs"),
        (PLAN + "objects: [{kind: sphere, east_m: 900, north_m: 0}]", "objects[0]", "840.0 m from the nearest leg"),
        (PLAN + "objects: [{kind: box, height_m: 5, east_m: 20, north_m: 10}]", "objects[0]", "at most 0.8"),
        (PLAN + "objects: [{kind: sphere, width_m: 5, east_m: 20, north_m: 10}]", "objects[0]", "`width_m` is 5 m"),
        (
            PLAN + "objects: [{kind: truncated_cone, top_m: 2, east_m: 20, north_m: 10}]",
            "objects[0]",
            "wider than its base",
        ),
        (PLAN + "objects: [{kind: fish_school, above_m: 5, east_m: 20, north_m: 10}]", "objects[0]", "above_m"),
        (PLAN + "scatter: [{kind: rock, count: 3, ground_range_m: [10, 80]}]", "scatter[0].ground_range_m", "49.6 m"),
        (PLAN + "scatter: [{kind: rock, count: 3, height_m: [0.5, 0.2]}]", "scatter[0].height_m", "lowest comes first"),
        (PLAN + "objects: [{kind: truncated_cone, height_m: 0, east_m: 1, north_m: 9}]", "objects", "`height_m` is 0"),
        (PLAN + "objects: [{kind: slab, width_m: 0, east_m: 20, north_m: 10}]", "objects[0]", "`width_m` is 0"),
        (PLAN + "scatter: [{kind: box, count: 3, length_m: [0, 1]}]", "scatter[0].length_m", "size above 0"),
        (PLAN + "scatter: [{kind: cylinder, count: 3, width_m: [1, 5]}]", "scatter[0].width_m", "at most 0.8"),
        (PLAN + "scatter: [{kind: cylinder, count: 3, tilt_deg: [0, 100]}]", "scatter[0].tilt_deg[1]", "<= 45"),
        (PLAN + "scatter: [{kind: point, count: 3, natural_sizes: true}]", "scatter[0].natural_sizes", "no size"),
        (PLAN + "scatter: [{kind: rock, count: 0}]", "scatter[0].count", ">= 1"),
        (PLAN + "seed: -1", "seed", ">= 0"),
        (PLAN + PLAN, "track", "twice"),
        ("track: [", "scene.yaml", "not valid YAML"),
    ],
)
def test_what_cannot_be_is_refused_by_key_and_reason(text: str, key: str, reason: str) -> None:
    with pytest.raises(UsageError, match=re.escape(reason)) as refusal:
        parse_scene(text, "scene.yaml")
    assert "scene.yaml" in str(refusal.value)
    assert key in str(refusal.value)


def test_how_deep_a_scar_is_dug_is_no_height_over_the_floor() -> None:
    scene = parse_scene(PLAN + "objects: [{kind: anchor_scar, height_m: 5.5, east_m: 20, north_m: 10}]", "scene.yaml")
    assert scene.objects[0].height_m == 5.5


@given(st.text(max_size=200))
def test_no_text_raises_anything_else(text: str) -> None:
    with pytest.raises(UsageError):
        parse_scene(text, "scene.yaml")


def test_an_unknown_name_lists_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such scene file") as refusal:
        read_scene(str(tmp_path / "flatt.yaml"))
    assert all(name in str(refusal.value) for name in named_scenes())


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_bytes(b"track: \xff\xfe")
    with pytest.raises(UsageError, match="not UTF-8"):
        read_scene(str(path))
    with pytest.raises(UsageError, match="cannot be read"):
        read_scene(str(tmp_path))
