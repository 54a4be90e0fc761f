"""Two short simulated missions hold their probability of detection and their rate of false alarms, by replay and score
as shipped.

Measured with seeds 1 to 3 at THRESHOLD, 0.029 km2 each: 34, 34 and 33 of 38 targets on flat sand, with 3, 3 and 5 false
alarms; 27 of 40, 25 of 39 and 26 of 39 on ripples, with 3, 2 and 5. Both missions have a fixed seed, so that only a
change of the chain moves their figures. A floor leaves room for three targets of flat sand and two of ripples, and a
ceiling for three more false alarms or five: rounding and the order of sums move one contact or two across the
threshold, a stage that is worse or gone moves more.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest
from msgspec import structs

from auv_mcm.settings.config import Config
from sim_replay.replay import replay
from sim_replay.scoring import score_files
from sim_replay.simulate import simulate
from sim_replay.simulator.scene import TARGET_KINDS, Lawnmower, Scene
from sim_replay.simulator.scene_file import read_scene
from tests.contradictions import all_contradictions

THRESHOLD = 0.2  # of p_mine; far above what is kept at all
SEED = 1
LEG_M = 300.0
MORE_TARGETS = 2  # as many as the whole scene has, twice, on its only leg
FEWER_OTHERS = 3  # a third of its legs has a third of its rocks and debris


class Limits(NamedTuple):
    """Bounds of a mission's figures at THRESHOLD. false_alarms_per_km2: contacts on no target, rocks among them."""

    min_pd: float
    max_false_alarms_per_km2: float


LIMITS = {
    "flat": Limits(min_pd=31 / 38, max_false_alarms_per_km2=280.0),  # 34 of 38 and 3 false alarms, 103 per km2
    "ripple": Limits(min_pd=25 / 40, max_false_alarms_per_km2=210.0),  # 27 of 40 and 3 false alarms, 104 per km2
}


def short(scene: Scene) -> Scene:
    """One leg of a shipped scene, crowded with targets."""
    assert isinstance(scene.track.plan, Lawnmower)
    plan = structs.replace(scene.track.plan, n_legs=1, leg_m=LEG_M)
    scatter = tuple(
        structs.replace(
            each, count=each.count * MORE_TARGETS if each.kind in TARGET_KINDS else round(each.count / FEWER_OTHERS)
        )
        for each in scene.scatter
    )
    return structs.replace(scene, seed=SEED, scatter=scatter, track=structs.replace(scene.track, plan=plan))


@pytest.mark.parametrize("name", list(LIMITS))
def test_a_mission_is_as_accurate_as_it_was(name: str, tmp_path: Path) -> None:
    simulated = simulate(short(read_scene(name)), tmp_path)
    replay([simulated.log], tmp_path / "results", Config())
    assert all_contradictions(tmp_path / "results" / "contacts.geojson") == []
    point = score_files([tmp_path / "results" / "contacts.geojson", simulated.truth], threshold=THRESHOLD).at_threshold
    pd, per_km2 = point.pd.value, point.false_alarms.per_km2
    assert point.pd.of >= 35, "targets that could be seen"
    assert pd is not None
    assert per_km2 is not None
    assert pd >= LIMITS[name].min_pd
    assert per_km2 <= LIMITS[name].max_false_alarms_per_km2
