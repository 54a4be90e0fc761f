"""What a ping hears lies where geometry puts it, from the place in the scene to the reported place on the globe."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray

from auv_mcm.records import NavSample, Ping
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import (
    EXACT,
    STEADY,
    Lawnmower,
    Origin,
    SampleRecorder,
    Scene,
    SceneObject,
    Seabed,
    Sonar,
    Track,
    World,
)
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.vehicle import SonarPose

Floats = NDArray[np.float64]
Side = Literal["port", "starboard"]

BARE = Seabed(type="sand", relief_rms_m=0.0, texture_shape=0.0, stones_per_ha=0.0)
DEPTH_M = 20.0
SOUND_MPS = 1500.0
PLAIN = Scene(
    world=World(depth_m=DEPTH_M, seabeds=(BARE,), relief_rms_m=0.0, backscatter="lambert", cell_m=0.02),
    sonar=Sonar(
        range_m=30.0,
        n_samples=2048,
        sound_speed_mps=SOUND_MPS,
        absorption_db_per_km=0.0,
        range_resolution_m=0.0,
        ring_down_m=0.0,
        noise_db=-100.0,
        beam_lines=1,
        recorder=SampleRecorder(samples="amplitude_float32"),
    ),
    track=Track(plan=Lawnmower(n_legs=1, leg_m=10.0), altitude_m=5.0, motion=STEADY),
    navigation_error=EXACT,
)
BIN_M = PLAIN.sonar.range_m / PLAIN.sonar.n_samples


RANGE_M = (np.arange(2048) + 0.5) * BIN_M


def pose(altitude_m: float = 5.0, heading_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> SonarPose:
    """Over the origin of the scene, at 1.8 m/s."""
    heading, pitch, roll = math.radians(heading_deg), math.radians(pitch_deg), math.radians(roll_deg)
    return SonarPose(0.0, 0.0, 0.0, DEPTH_M - altitude_m, heading, pitch, roll, heading, 1.8, 0)


def heard(scene: Scene, at: SonarPose, side: Side = "starboard") -> Floats:
    """Mean intensity, (n_samples,)."""
    return np.asarray(Sea(scene).mean_intensity([at])[0, ("port", "starboard").index(side)])


def abeam(at: SonarPose, across_m: float, scene_object: SceneObject) -> SceneObject:
    """Return the object, turned with the vehicle, where the fan meets the floor `across_m` to starboard: pitched
    forwards, and carried on by the vehicle while the echo travels.
    """
    below = DEPTH_M - at.depth_m
    slant = math.hypot(across_m, below / math.cos(at.pitch_rad))
    ahead = below * math.tan(at.pitch_rad) + at.speed_mps * slant / SOUND_MPS
    sine, cosine = math.sin(at.heading_rad), math.cos(at.heading_rad)
    east, north = ahead * sine + across_m * cosine, ahead * cosine - across_m * sine
    return replace(scene_object, east_m=east, north_m=north, azimuth_deg=math.degrees(at.heading_rad))


def flown(scene: Scene) -> tuple[list[NavSample], list[Ping]]:
    everything = list(Mission(scene).events())
    return [e for e in everything if isinstance(e, NavSample)], [e for e in everything if isinstance(e, Ping)]


def intensities(pings: list[Ping], side: Side = "starboard") -> Floats:
    """Squared amplitudes, (n_pings, n_samples)."""
    return np.stack([trace.samples for p in pings if (trace := getattr(p, side)) is not None]).astype(np.float64) ** 2


# --- floor ---


@pytest.mark.parametrize(
    ("recorder", "decibel_per_count"),
    [
        (SampleRecorder(samples="amplitude_uint8", seabed_counts=40.0), None),
        (SampleRecorder(samples="amplitude_uint16"), None),
        (SampleRecorder(samples="amplitude_float32", seabed_counts=0.3), None),
        (SampleRecorder(samples="log_uint8"), 0.35),
        (SampleRecorder(samples="log_uint16", seabed_counts=30_000.0, db_per_count=0.01), 0.01),
    ],
)
def test_the_floor_midway_is_stored_as_what_the_recorder_has_for_it(
    recorder: SampleRecorder, decibel_per_count: float | None
) -> None:
    scene = replace(PLAIN, sonar=replace(PLAIN.sonar, recorder=recorder, looks=8))
    mission = Mission(scene)
    pings = [event for event in mission.events() if isinstance(event, Ping)]
    midway = abs(RANGE_M - 0.5 * (5.0 + 30.0)) < 0.3
    stored = np.stack([p.starboard.samples for p in pings if p.starboard is not None])[:, midway].astype(np.float64)
    counts = mission.sea.recorder.seabed_counts
    assert counts is not None
    intensity = (
        (stored / counts) ** 2 if decibel_per_count is None else 10.0 ** (0.1 * decibel_per_count * (stored - counts))
    )
    assert np.mean(intensity) == pytest.approx(1.0, abs=0.02)


def test_texture_lies_fixed_on_the_floor() -> None:
    seabed = replace(BARE, texture_shape=2.0, texture_m=1.0)
    sonar = replace(PLAIN.sonar, n_samples=512, looks=64)
    scene = replace(PLAIN, world=replace(PLAIN.world, seabeds=(seabed,)), sonar=sonar)
    _, pings = flown(scene)
    gain = ((np.arange(512) + 0.5) / 512) ** 3
    flat = (heard(replace(PLAIN, sonar=sonar), pose()) * gain)[200:480]
    texture = intensities(pings)[:, 200:480] / flat
    a_ping_m = scene.track.speed_mps / sonar.ping_rate_hz
    alike = [float(np.corrcoef(texture[0], texture[round(way_m / a_ping_m)])[0, 1]) for way_m in (0.15, 0.6, 4.8)]
    assert alike[0] > 0.85
    assert alike[0] > alike[1] > alike[2]
    assert abs(alike[2]) < 0.4


# --- bodies ---


@given(
    height=st.floats(0.2, 1.2),
    across=st.floats(6.0, 20.0),
    altitude=st.floats(3.0, 8.0),
    side=st.sampled_from(["port", "starboard"]),
    pitch=st.sampled_from([0.0, -7.0]),
    heading=st.floats(0.0, 360.0),
)
@settings(max_examples=40)
def test_a_box_casts_the_shadow_of_similar_triangles(
    height: float, across: float, altitude: float, side: Side, pitch: float, heading: float
) -> None:
    at = pose(altitude, heading, pitch)
    width = 0.8
    box = abeam(
        at,
        across if side == "starboard" else -across,
        SceneObject(kind="box", length_m=6.0, width_m=width, height_m=height),
    )
    scene = replace(PLAIN, track=replace(PLAIN.track, altitude_m=altitude))
    got, bare = heard(replace(scene, objects=(box,)), at, side), heard(scene, at, side)
    secant = 1.0 / math.cos(math.radians(pitch))
    far = across + width / 2
    shadow_end = far * altitude / (altitude - height)
    begins = max(
        math.hypot(far, (altitude - height) * secant), math.hypot(far - width, altitude * secant)
    )  # top's end, face's foot
    ends = math.hypot(shadow_end, altitude * secant)
    if ends > 28.9:
        return
    dark = np.flatnonzero(got[: int(29.0 / BIN_M)] == 0.0)
    dark = dark[dark * BIN_M > 1.05 * altitude * secant]
    assert dark.size
    assert dark[0] * BIN_M == pytest.approx(begins, abs=0.045)
    assert (dark[-1] + 1) * BIN_M == pytest.approx(ends, abs=0.045)
    near_face = math.hypot(across - width / 2, (altitude - height) * secant)  # its top edge comes first: layover
    bright = np.flatnonzero(got > 1.5 * bare)
    assert bright[0] * BIN_M == pytest.approx(near_face, abs=0.045)


def profile(kind: str, y: Floats) -> Floats:
    """Height of a slice through the middle, 0.9 m wide, seen from above."""
    round_top = np.sqrt(np.maximum(0.0, 1.0 - (y / 0.45) ** 2))
    if kind == "truncated_cone":
        return np.asarray(np.clip(0.5 * (0.45 - np.abs(y)) / 0.2, 0.0, 0.5))
    return np.asarray(np.where(round_top > 0.0, 0.45 * (1.0 + round_top), 0.0))


@pytest.mark.parametrize(
    "scene_object",
    [
        SceneObject(kind="sphere", width_m=0.9),
        SceneObject(kind="cylinder", width_m=0.9, length_m=4.0),
        SceneObject(kind="truncated_cone", width_m=0.9, height_m=0.5, top_m=0.5),
    ],
)
@pytest.mark.parametrize("heading_deg", [0.0, 133.0])
def test_other_shapes_shadow_as_far_as_their_tangent_ray(scene_object: SceneObject, heading_deg: float) -> None:
    at = pose(heading_deg=heading_deg)
    got = heard(replace(PLAIN, objects=(abeam(at, 12.0, scene_object),)), at)
    y = np.linspace(-0.45, 0.45, 100_001)
    end = math.hypot(float(((12.0 + y) * 5.0 / (5.0 - profile(scene_object.kind, y))).max()), 5.0)
    dark = np.flatnonzero(got == 0.0)
    dark = dark[(dark * BIN_M > 6.0) & (dark * BIN_M < 29.0)]
    assert (dark[-1] + 1) * BIN_M == pytest.approx(end, abs=0.05)


# --- places ---


def ecef(latitude_deg: float, longitude_deg: float, height_m: float = 0.0) -> Floats:
    """The textbook formula, WGS 84."""
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    lat, lon = math.radians(latitude_deg), math.radians(longitude_deg)
    n = a / math.sqrt(1 - e2 * math.sin(lat) ** 2)
    away = (n + height_m) * math.cos(lat)
    return np.array([away * math.cos(lon), away * math.sin(lon), (n * (1 - e2) + height_m) * math.sin(lat)])


def up(latitude_deg: float, longitude_deg: float) -> Floats:
    lat, lon = math.radians(latitude_deg), math.radians(longitude_deg)
    return np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])


def towards(latitude_deg: float, longitude_deg: float, heading_rad: float) -> Floats:
    """Unit vector of a true heading in Earth-centred axes."""
    lat, lon = math.radians(latitude_deg), math.radians(longitude_deg)
    north = np.array([-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat)])
    east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    return math.cos(heading_rad) * north + math.sin(heading_rad) * east


@pytest.mark.parametrize("place", [(43.0, 5.5), (0.0, 179.9999), (-65.0, -180.0), (89.0, 10.0), (-89.0, 100.0)])
@pytest.mark.parametrize("heading_deg", [0.0, 77.0, 200.0])
def test_the_vehicle_moves_where_it_points_anywhere_on_the_globe(
    place: tuple[float, float], heading_deg: float
) -> None:
    scene = replace(
        PLAIN,
        origin=Origin(latitude_deg=place[0], longitude_deg=place[1]),
        track=replace(PLAIN.track, plan=Lawnmower(heading_deg=heading_deg, n_legs=1, leg_m=200.0)),
        sonar=replace(PLAIN.sonar, n_samples=64, ping_rate_hz=0.5),
        world=replace(PLAIN.world, cell_m=0.5),
    )
    samples, _ = flown(scene)
    assert ecef(samples[0].latitude_deg, samples[0].longitude_deg) == pytest.approx(ecef(*place), abs=1e-6)
    assert math.remainder(samples[0].heading_rad - math.radians(heading_deg), 2.0 * math.pi) == pytest.approx(
        0.0, abs=1e-8
    )
    for a, b in pairwise(samples):
        step = ecef(b.latitude_deg, b.longitude_deg) - ecef(a.latitude_deg, a.longitude_deg)
        assert np.linalg.norm(step) == pytest.approx(scene.track.speed_mps / scene.sonar.ping_rate_hz, abs=1e-3)
        ahead = towards(a.latitude_deg, a.longitude_deg, a.heading_rad)
        assert float(step @ ahead) / np.linalg.norm(step) == pytest.approx(1.0, abs=1e-8)
        assert -180.0 <= b.longitude_deg <= 180.0


def test_reported_depth_and_altitude_add_up_to_the_depth_of_the_floor() -> None:
    sloping = replace(PLAIN.world, slope_deg=3.0, slope_towards_deg=0.0, cell_m=0.5)
    scene = replace(
        PLAIN,
        world=sloping,
        sonar=replace(PLAIN.sonar, n_samples=64),
        track=replace(PLAIN.track, plan=Lawnmower(leg_m=30.0)),
    )
    samples, pings = flown(scene)
    north = np.array([ecef(s.latitude_deg, s.longitude_deg) - ecef(43.0931, 5.8872) for s in samples]) @ towards(
        43.0931, 5.8872, 0.0
    )
    floor = DEPTH_M - math.tan(math.radians(3.0)) * north
    assert np.array([s.depth_m + s.altitude_m for s in samples]) == pytest.approx(floor, abs=2e-3)
    assert [p.altitude_m for p in pings] == [s.altitude_m for s in samples]
    assert np.array([s.altitude_m for s in samples]) == pytest.approx(5.0, abs=1e-3)


@given(
    kind=st.sampled_from(["point", "sphere"]),
    heading=st.floats(0.0, 360.0),
    across=st.floats(8.0, 25.0),
    side=st.sampled_from(["port", "starboard"]),
    altitude=st.floats(2.0, 7.0),
    pitch=st.floats(-10.0, 10.0),
    place=st.sampled_from([(43.0, 5.5), (89.0, 0.0), (-20.0, 179.99999)]),
)
@settings(max_examples=18)
def test_a_small_object_is_seen_when_abeam_at_its_slant_range(
    kind: Any, heading: float, across: float, side: Side, altitude: float, pitch: float, place: tuple[float, float]
) -> None:
    """Abeam is where its place from truth.json lies in the plane square to the sonar's axis, reported navigation being
    exact."""
    radius = 0.15 if kind == "sphere" else 0.0
    scene_object = SceneObject(
        kind=kind,
        leg=0,
        along_m=5.0,
        across_m=across if side == "starboard" else -across,
        width_m=2.0 * radius or None,
        strength_db=30.0,
    )
    sonar = replace(
        PLAIN.sonar, n_samples=1024, ping_rate_hz=15.0, looks=16, beam_width_deg=0.5, beam_lines=5 if radius else 1
    )
    track = replace(
        PLAIN.track,
        plan=Lawnmower(heading_deg=heading, n_legs=1, leg_m=10.0),
        altitude_m=altitude,
        motion=replace(STEADY, pitch_offset_deg=pitch),
    )
    origin = Origin(latitude_deg=place[0], longitude_deg=place[1])
    mission = Mission(replace(PLAIN, origin=origin, objects=(scene_object,), sonar=sonar, track=track))
    events = list(mission.events())
    samples, pings = [e for e in events if isinstance(e, NavSample)], [e for e in events if isinstance(e, Ping)]
    (reported,) = mission.truth()["objects"]
    target = ecef(reported["lat"], reported["lon"], radius)
    ahead, slant = [], []
    for sample in samples:
        vehicle = ecef(sample.latitude_deg, sample.longitude_deg, altitude)
        vertical = up(sample.latitude_deg, sample.longitude_deg)
        level = towards(sample.latitude_deg, sample.longitude_deg, sample.heading_rad)
        axis = math.cos(sample.pitch_rad) * level + math.sin(sample.pitch_rad) * vertical
        slant.append(float(np.linalg.norm(target - vehicle)))
        travelled = track.speed_mps * slant[-1] / SOUND_MPS
        ahead.append(float((target - vehicle) @ axis) / math.cos(sample.pitch_rad) - travelled)
    assert ahead[0] > 0.5 > -0.5 > ahead[-1]
    energy = intensities(pings, side)
    loudest = energy.max(axis=1)
    a_ping_m = track.speed_mps / sonar.ping_rate_hz
    row = int(np.argmax(loudest))
    near = slice(max(row - 5, 0), row + 6)
    weight = np.maximum(loudest[near] - np.median(loudest), 0.0)
    abeam_m = float(np.average(ahead[near], weights=weight))
    assert abs(abeam_m) <= 0.5 * a_ping_m + 0.01
    bin_m = sonar.range_m / sonar.n_samples
    echo = energy[row] > 0.1 * energy[row].max()
    assert np.argmax(echo) * bin_m == pytest.approx(slant[row] - radius, abs=0.06)
    assert energy[row].max() > 30.0 * np.median(energy)


# --- what does not come from the floor ---


def test_other_paths_begin_where_their_way_is_as_long() -> None:
    silent = replace(PLAIN, sonar=replace(PLAIN.sonar, vertical_beam_width_deg=180.0))
    at = pose()  # 15 m below the surface, 5 m above the floor
    direct = heard(silent, at)

    def added(**level_db: float) -> Floats:
        return heard(replace(silent, sonar=replace(silent.sonar, **level_db)), at) - direct

    def first_m(echo: Floats) -> float:
        return float(np.flatnonzero(echo > 0.0)[0] * BIN_M)

    assert first_m(added(surface_echo_db=0.0)) == pytest.approx(15.0, abs=2 * BIN_M)
    assert first_m(added(second_bottom_db=0.0)) == pytest.approx(25.0, abs=2 * BIN_M)
    assert added(surface_echo_db=-10.0) == pytest.approx(0.1 * added(surface_echo_db=0.0))


def test_crosstalk_is_the_other_sides_echo() -> None:
    scene_object = SceneObject(kind="sphere", east_m=12.0, north_m=0.0, strength_db=20.0)
    scene = replace(PLAIN, objects=(scene_object,))
    port, starboard = heard(scene, pose(), "port"), heard(scene, pose())
    leaking = replace(scene, sonar=replace(scene.sonar, crosstalk_db=-20.0))
    assert heard(leaking, pose(), "port") == pytest.approx(port + 0.01 * starboard)
    assert heard(leaking, pose()) == pytest.approx(starboard + 0.01 * port)
