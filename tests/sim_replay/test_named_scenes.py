"""The scenes that rates are taken on."""

from __future__ import annotations

import math
from importlib import resources
from itertools import islice
from typing import get_args

import numpy as np
import pytest

from auv_mcm.detect.cascade.choose import configured_model, fitting
from auv_mcm.records import NavSample, Ping
from auv_mcm.settings.config import Config
from sim_replay.missions import SCENES, config_for, served_by
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.plan import planned_legs, swath_m
from sim_replay.simulator.recording import sample_type
from sim_replay.simulator.scene import TARGET_KINDS, SeabedType
from sim_replay.simulator.scene_file import named_scenes, read_scene


def test_scenes_have_the_names_of_their_files() -> None:
    assert len(SCENES) == 10
    assert set(SCENES) <= set(named_scenes())
    assert [read_scene(name).name for name in named_scenes()] == list(named_scenes())


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_says_what_it_is_for(name: str) -> None:
    text = (resources.files("sim_replay") / "scenes" / f"{name}.yaml").read_text("utf-8")
    assert text.startswith("# ")


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_has_every_kind_of_mine_and_as_many_rocks(name: str) -> None:
    scene = read_scene(name)
    targets = {group.kind: group.count for group in scene.scatter if group.kind in TARGET_KINDS}
    rocks = [group for group in scene.scatter if group.kind == "rock"]
    assert set(targets) == TARGET_KINDS
    assert 12 <= sum(targets.values()) <= 24
    assert sum(group.count for group in rocks) >= sum(targets.values())
    assert all(group.length_m == (0.5, 2.2) and group.height_m == (0.3, 0.6) for group in rocks)


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_is_a_mission_of_minutes_over_enough_floor_for_rates(name: str) -> None:
    scene = read_scene(name)
    legs = planned_legs(scene.track.plan)
    assert 2 <= len(legs) <= 4
    assert all(200.0 <= leg.length_m <= 300.0 for leg in legs)
    assert sum(leg.length_m for leg in legs) * 2e-6 * swath_m(scene) > 0.06


def test_together_they_have_every_kind_of_sea_floor_and_recorder() -> None:
    scenes = [read_scene(name) for name in SCENES]
    assert {seabed.type for scene in scenes for seabed in scene.world.seabeds} == set(get_args(SeabedType))
    assert {scene.sonar.recorder.samples for scene in scenes} == {"amplitude_uint8", "amplitude_uint16", "log_uint8"}


@pytest.mark.parametrize("name", SCENES)
def test_a_short_stretch_of_each_scene_flies(name: str) -> None:
    mission = Mission(read_scene(name))
    events = list(islice(mission.events(), 64))
    pings = [event for event in events if isinstance(event, Ping)]
    assert len(pings) == sum(isinstance(event, NavSample) for event in events) == 32
    for ping in pings:
        assert ping.port is not None
        assert ping.starboard is not None
        for trace in (ping.port, ping.starboard):
            assert trace.samples.dtype == np.dtype(sample_type(mission.sea.recorder))
            assert trace.samples.std() > 0.0


def test_contrasts_serve_as_for_a_sonar_without_a_model() -> None:
    model, notice = fitting(configured_model(served_by("contrast", Config())), Config())
    assert model is None
    assert notice.code == "detect.contrast"
    assert fitting(configured_model(served_by("cascade", Config())), Config())[0] is not None


def test_the_chain_is_given_the_beam_width_and_nothing_else() -> None:
    deep = config_for(read_scene("deep"))
    assert deep.sonar.beam_width_deg == read_scene("deep").sonar.beam_width_deg
    assert (deep.detect, deep.waterfall, deep.navigation) == (Config().detect, Config().waterfall, Config().navigation)


def test_a_synthetic_aperture_has_the_beam_of_its_resolution_at_half_range() -> None:
    scene = read_scene("sas")
    assert scene.sonar.synthetic_aperture is not None
    width_m = math.radians(config_for(scene).sonar.used_beam_width_deg) * 0.5 * scene.sonar.range_m
    assert width_m == pytest.approx(scene.sonar.synthetic_aperture.along_track_resolution_m)
