"""What is said of a contact contradicts itself for no contact of any named scene, flown whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from sim_replay.missions import SCENES, config_for
from sim_replay.replay import replay
from sim_replay.simulate import simulate
from sim_replay.simulator.scene_file import read_scene
from tests.contradictions import all_contradictions


@pytest.mark.parametrize("name", SCENES)
def test_no_contact_of_a_scene_is_contradicted(name: str, tmp_path: Path) -> None:
    scene = read_scene(name)
    simulated = simulate(scene, tmp_path)
    replay([simulated.log], tmp_path / "results", config_for(scene))
    assert all_contradictions(tmp_path / "results" / "contacts.geojson") == []
