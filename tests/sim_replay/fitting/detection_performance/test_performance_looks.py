"""Looks at targets against the simulator's record of the flight, and passes against their definition."""

from __future__ import annotations

import math
from datetime import datetime

import numpy as np
import pytest

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import CoveragePatch, Side
from sim_replay.fitting.detection_performance.looks import Part, cell_passes, looks_of, seen_parts
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import EXACT, Lawnmower, Scene, SceneObject, Seabed, Sonar, Track, World
from tests.make.records import cells_of, patch_of

ORIGIN = (43.0, 5.0)


def part(start_s: float, look_deg: float, side: Side = "port") -> Part:
    return Part(side, start_s, start_s + 10.0, 0.5, 20.0, 6.0, math.radians(look_deg), 2.0)


def patch(start_s: float, cells: list[tuple[int, int, float]]) -> CoveragePatch:
    places = {(east, north): fraction for east, north, fraction in cells}
    seen = cells_of(
        places, origin_latitude_deg=ORIGIN[0], origin_longitude_deg=ORIGIN[1], ground_range_m=20.0, altitude_m=6.0
    )
    return patch_of(start_s=start_s, stop_s=start_s + 10.0, cells=seen)


def test_a_pass_ends_where_a_minute_goes_by_or_the_look_turns() -> None:
    parts = [part(0.0, 350.0), part(10.0, 2.0), part(75.0, 5.0), part(150.0, 5.0), part(160.0, 25.0)]
    assert [[each.start_s for each in group] for group in cell_passes(parts)] == [[0.0, 10.0, 75.0], [150.0], [160.0]]
    assert cell_passes([]) == []


def test_a_place_is_seen_by_the_patches_that_hold_its_cell_in_order_of_time() -> None:
    patches = [patch(50.0, [(0, 0, 0.5), (1, 0, 1.0)]), patch(0.0, [(0, 0, 0.25)]), patch(90.0, [(-1, -1, 0.75)])]
    frame = LocalFrame(latitude_deg=ORIGIN[0], longitude_deg=ORIGIN[1])
    found = seen_parts(np.array([[1.0, 3.0], [7.9, 0.1], [-0.1, -0.1], [100.0, 0.0]]), patches, frame)
    assert [[(each.start_s, each.fraction) for each in parts] for parts in found] == [
        [(0.0, 0.25), (50.0, 0.5)],
        [(50.0, 1.0)],
        [(90.0, 0.75)],
        [],
    ]


def test_looks_are_those_that_were_flown_and_strong_targets_on_even_sand_are_found() -> None:
    places = [(14.0, 30.0), (-18.0, 45.0), (22.0, 62.0), (-10.0, 75.0)]
    scene = Scene(
        seed=5,
        world=World(depth_m=20.0, seabeds=(Seabed(type="sand"),), relief_rms_m=0.0),
        objects=tuple(
            SceneObject(kind="cylinder", east_m=east, north_m=north, azimuth_deg=0.0, strength_db=-10.0)
            for east, north in places
        ),
        sonar=Sonar(range_m=30.0, n_samples=640),
        track=Track(plan=Lawnmower(n_legs=1, leg_m=100.0), altitude_m=5.0),
        navigation_error=EXACT,
    )
    looks = looks_of(scene)
    assert [look.target for look in looks] == [0, 1, 2, 3]
    mission = Mission(scene)
    for _ in mission.events():
        pass
    for look, truth in zip(looks, mission.truth()["objects"], strict=True):
        (flown,) = truth["looks"]
        assert look.ground_range_m == pytest.approx(flown["ground_range_m"], abs=2.5)  # the middle of its cell
        assert math.sin(look.look_rad) == pytest.approx(1.0 if flown["side"] == "starboard" else -1.0, abs=0.1)
        moment_s = datetime.fromisoformat(flown["time"]).timestamp() - scene.track.start_time_s
        assert look.time_s <= moment_s + 2.0
        assert look.seabed == 0
        assert look.ripple_rad is None
    assert sum(look.p_mine >= 0.2 for look in looks) >= 3
