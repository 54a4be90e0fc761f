"""Simulated missions from end to end: the same bytes from the same seed, a truth that fits, a course that can
change."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from auv_mcm.errors import UsageError
from auv_mcm.records import NavSample, Ping
from sim_replay.scoring.seabed_map import SeabedMap, decode
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.plan import Leg, local_frame
from sim_replay.simulator.scene import (
    EXACT,
    STEADY,
    Fault,
    Lawnmower,
    ObjectKind,
    Scene,
    SceneObject,
    Seabed,
    Sonar,
    SyntheticAperture,
    Track,
    World,
)

SCENE = Scene(
    seed=3,
    world=World(seabeds=(Seabed(type="sand"), Seabed(type="rippled_sand")), cell_m=0.1, patch_m=20.0),
    sonar=Sonar(range_m=25.0, n_samples=256, beam_lines=3),
    track=Track(plan=Lawnmower(heading_deg=75.0, n_legs=2, leg_m=24.0, spacing_m=20.0), altitude_m=4.0),
    objects=(
        SceneObject(kind="cylinder", leg=0, along_m=12.0, across_m=10.0, azimuth_deg=30.0),
        SceneObject(kind="rock", leg=0, along_m=6.0, across_m=-12.0, burial_m=0.1),
        SceneObject(kind="sphere", leg=0, along_m=18.0, across_m=0.5),
    ),
)


def flown(scene: Scene, **keys: Any) -> tuple[Mission, list[NavSample | Ping]]:
    mission = Mission(scene, **keys)
    return mission, list(mission.events())


def bytes_of(events: list[NavSample | Ping]) -> bytes:
    parts = []
    for event in events:
        if isinstance(event, Ping):
            sides = [side.samples.tobytes() for side in (event.port, event.starboard) if side is not None]
            parts.append(b"".join([msgspec.json.encode((event.number, event.time_s, event.altitude_m)), *sides]))
        else:
            parts.append(msgspec.json.encode(event))
    return b"".join(parts)


@pytest.fixture(scope="module")
def reference() -> tuple[Mission, list[NavSample | Ping]]:
    return flown(SCENE)


def test_threads_blocks_and_kernels_do_not_change_a_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds: tuple[ObjectKind, ...] = ("wedge", "tyre", "anchor_scar", "fish_school", "debris")
    others = [SceneObject(kind=kind, leg=1, along_m=4.0 + 3.0 * k, across_m=9.0) for k, kind in enumerate(kinds)]
    sonar = msgspec.structs.replace(SCENE.sonar, crosstalk_db=-40.0, looks=2, range_resolution_m=0.15)
    scene = msgspec.structs.replace(SCENE, sonar=sonar, objects=(*SCENE.objects, *others))
    expected = bytes_of(flown(scene)[1])
    assert bytes_of(flown(scene, threads=2)[1]) == expected
    assert bytes_of(flown(scene, block_pings=7)[1]) == expected
    monkeypatch.setattr("sim_replay.simulator.backend.library", lambda: None)
    assert bytes_of(flown(scene)[1]) == expected


def test_another_seed_is_another_sea(reference: tuple[Mission, list[NavSample | Ping]]) -> None:
    assert bytes_of(flown(msgspec.structs.replace(SCENE, seed=4))[1]) != bytes_of(reference[1])


def test_every_ping_follows_its_navigation(reference: tuple[Mission, list[NavSample | Ping]]) -> None:
    events = reference[1]
    assert len(events) > 200
    for sample, ping in zip(events[::2], events[1::2], strict=True):
        assert isinstance(sample, NavSample)
        assert isinstance(ping, Ping)
        assert sample.time_s == ping.time_s
    assert [ping.number for ping in events[1::2] if isinstance(ping, Ping)] == list(range(len(events) // 2))


def test_truth_lists_the_objects_places_and_the_passes_that_saw_them(
    reference: tuple[Mission, list[NavSample | Ping]],
) -> None:
    facts = reference[0].truth()
    frame = local_frame(SCENE.origin)
    cylinder, rock, sphere = facts["objects"]
    leg = Leg(0.0, 0.0, math.radians(75.0), 24.0)
    for scene_object, place in ((cylinder, leg.at(12.0, 10.0)), (rock, leg.at(6.0, -12.0))):
        assert frame.to_enu(scene_object["lat"], scene_object["lon"], 0.0)[:2] == pytest.approx(place, abs=1e-3)
    assert (cylinder["is_target"], rock["is_target"]) == (True, False)
    assert rock["rise_m"] == pytest.approx(0.3)
    # The second leg lies 20 m to starboard of the first and runs the other way: the cylinder is 10 m to starboard of
    # both.
    assert [look["side"] for look in cylinder["looks"]] == ["starboard", "starboard"]
    assert [look["ground_range_m"] for look in cylinder["looks"]] == pytest.approx([10.0, 10.0], abs=0.5)
    assert [look["side"] for look in rock["looks"]] == ["port"]
    assert [look["ground_range_m"] for look in sphere["looks"]] == pytest.approx(
        [19.5], abs=0.5
    )  # below the first leg it is not seen


def test_the_swept_area_is_that_of_the_legs(reference: tuple[Mission, list[NavSample | Ping]]) -> None:
    facts = reference[0].truth()
    swept = decode(msgspec.convert(facts["seabed_map"], SeabedMap))
    cells = np.count_nonzero(swept >= 0)
    assert facts["area_km2"] == pytest.approx(cells * 1e-6)
    reach = math.sqrt(25.0**2 - 4.0**2)
    # Both legs, 20 m apart: what one leaves out below itself the other sees; cells at the rim count whole.
    assert facts["area_km2"] == pytest.approx(24.0 * (20.0 + 2.0 * reach) * 1e-6, rel=0.08)
    assert set(facts["seabed_map"]["types"]) == {"sand", "rippled_sand"}
    world = reference[0].sea.world
    corner = local_frame(SCENE.origin).to_enu(
        facts["seabed_map"]["latitude_deg"], facts["seabed_map"]["longitude_deg"], 0.0
    )
    rows, columns = np.nonzero(swept >= 0)
    labels = world.seabed_at(corner[0] + columns + 0.5, corner[1] + rows + 0.5)
    assert np.mean(labels == swept[rows, columns]) > 0.999  # the map's plane touches elsewhere than the scene's


def test_exact_navigation_reports_the_sonars_place() -> None:
    scene = msgspec.structs.replace(
        SCENE, navigation_error=EXACT, track=msgspec.structs.replace(SCENE.track, motion=STEADY, pings_in_turns=False)
    )
    mission, events = flown(scene)
    frame = local_frame(scene.origin)
    leg = Leg(0.0, 0.0, math.radians(75.0), 24.0)
    start_s = scene.track.start_time_s
    for event in events[: 2 * 150]:
        if isinstance(event, NavSample):
            east, north, _ = frame.to_enu(event.latitude_deg, event.longitude_deg, 0.0)
            assert (east, north) == pytest.approx(leg.at(1.8 * (event.time_s - start_s), 0.0), abs=1e-3)
            assert event.altitude_m == pytest.approx(4.0, abs=0.2)
    assert mission.vehicle.done


def test_a_new_plan_changes_the_course_and_the_world_stays_the_same() -> None:
    scene = msgspec.structs.replace(
        SCENE, track=msgspec.structs.replace(SCENE.track, motion=STEADY, pings_in_turns=False)
    )
    mission = Mission(scene, block_pings=8)
    heard = []
    turned = False
    for event in mission.events():
        if isinstance(event, Ping):
            heard.append(event)
        if len(heard) == 40 and not turned:
            turned = True
            mission.follow([Leg(60.0, 0.0, 0.0, 10.0)])
    straight = [event for event in flown(scene)[1] if isinstance(event, Ping)]
    same = [
        np.array_equal(a.port.samples, b.port.samples)
        for a, b in zip(heard, straight, strict=False)
        if a.port and b.port
    ]
    assert all(same[:40])
    assert len(heard) < len(straight)
    assert mission.vehicle.legs[-1] == Leg(60.0, 0.0, 0.0, 10.0)
    assert mission.truth()["area_km2"] > 0.0


def test_faults_strike_reported_data_and_leave_the_truth_alone(
    reference: tuple[Mission, list[NavSample | Ping]],
) -> None:
    gap = Fault(kind="gap", at_ping=10, n_pings=5)
    mission, events = flown(msgspec.structs.replace(SCENE, faults=(gap,)))
    numbers = [event.number for event in events if isinstance(event, Ping)]
    assert 9 in numbers
    assert not set(range(10, 15)) & set(numbers)
    assert mission.truth() == reference[0].truth()


def test_before_anything_is_flown_nothing_was_swept() -> None:
    facts = Mission(SCENE).truth()
    assert facts["area_km2"] == 0.0
    assert all(not scene_object["looks"] for scene_object in facts["objects"])


def test_a_scene_that_cannot_be_is_refused() -> None:
    with pytest.raises(UsageError, match="altitude_m"):
        Mission(msgspec.structs.replace(SCENE, track=msgspec.structs.replace(SCENE.track, altitude_m=30.0)))


def test_a_synthetic_aperture_delivers_lines_leg_by_leg_and_takes_a_new_plan_after_a_leg() -> None:
    aperture = SyntheticAperture(along_track_resolution_m=0.2, range_resolution_m=0.2, sub_apertures=1)
    scene = msgspec.structs.replace(
        SCENE, sonar=msgspec.structs.replace(SCENE.sonar, synthetic_aperture=aperture), navigation_error=EXACT
    )
    mission = Mission(scene)
    pings: list[Ping] = []
    for event in mission.events():
        if isinstance(event, Ping):
            if not pings:
                mission.follow([Leg(5.0, 5.0, 1.0, 8.0)])
            pings.append(event)
    line_m = 0.2 / 1.25
    first, second = math.floor(24.0 / line_m) + 1, math.floor(8.0 / line_m) + 1
    assert abs(len(pings) - first - second) <= 2
    assert [ping.number for ping in pings] == list(range(len(pings)))
    spacing_s = np.diff([ping.time_s for ping in pings[:first]])
    assert spacing_s == pytest.approx(line_m / 1.8, abs=1e-6)
    assert pings[0].altitude_m == pytest.approx(4.0, abs=0.5)
    assert mission.truth()["area_km2"] > 0.0


def test_a_floor_that_rises_out_of_the_water_is_refused_where_it_does() -> None:
    world = msgspec.structs.replace(SCENE.world, depth_m=5.0, relief_rms_m=5.0, relief_outer_m=10.0)
    with pytest.raises(UsageError, match=r"`world.depth_m` 5 leaves the sonar above the surface at .* m east"):
        flown(msgspec.structs.replace(SCENE, world=world))
