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
        (
            PLAN + "objects: [{kind: truncated_cone, width_m: 1, top_m: 2, east_m: 20, north_m: 10}]",
            "objects[0]",
            "wider than its base",
        ),
        (PLAN + "objects: [{kind: fish_school, above_m: 5, east_m: 20, north_m: 10}]", "objects[0]", "above_m"),
        (PLAN + "scatter: [{kind: rock, count: 3, ground_range_m: [10, 80]}]", "scatter[0].ground_range_m", "49.6 m"),
        (PLAN + "scatter: [{kind: rock, count: 3, height_m: [0.5, 0.2]}]", "scatter[0].height_m", "lowest comes first"),
        (PLAN + "objects: [{kind: slab, width_m: 0, east_m: 20, north_m: 10}]", "objects[0]", "`width_m` is 0"),
        (PLAN + "scatter: [{kind: box, count: 3, length_m: [0, 1]}]", "scatter[0].length_m", "size above 0"),
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
