"""A real service between real kills: what it comes to is what an undisturbed one does."""

from __future__ import annotations

from pathlib import Path

from sim_replay.benches.restarts import cut_off, keep_mission
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene, SceneObject, Sonar, Track


def test_a_session_that_is_cut_off_comes_to_the_contacts_of_an_undisturbed_one(tmp_path: Path) -> None:
    objects = tuple(SceneObject(kind="sphere", leg=0, along_m=12.0 * number, across_m=10.0) for number in range(1, 8))
    scene = Scene(
        sonar=Sonar(range_m=30.0, ping_rate_hz=15.0, beam_lines=3),
        track=Track(plan=Lawnmower(n_legs=1, leg_m=90.0), altitude_m=5.0, speed_mps=3.0),
        objects=objects,
    )
    log = tmp_path / "mission.xtf"
    write_xtf(log, Mission(scene).events())
    mission = tmp_path / "mission"
    n_events = keep_mission(log, mission)
    session = cut_off(mission, n_events, 2, 5, tmp_path / "session")
    assert session.problems == ()
    assert len(session.cuts) == 2
    assert session.n_contacts >= 3
