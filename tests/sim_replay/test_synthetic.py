"""Synthetic missions obey geometry and statistics that are known in closed form."""

from __future__ import annotations

import json
import math
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.config import SonarConfig
from auv_mcm.errors import UsageError
from auv_mcm.records import EchoTrace, NavSample, Ping
from sim_replay import synthetic
from sim_replay.synthetic import Leg, SceneObject, SyntheticScene, demo_scene, lawnmower, synthetic_mission, truth
from sim_replay.synthetic_echo import Pose, Solid, mean_intensity
from sim_replay.xtf import XtfLog

PLAIN = SyntheticScene(
    legs=(Leg(latitude_deg=43.0, longitude_deg=5.5, heading_deg=0.0, length_m=6.0),),
    ring_down_m=0.0,
    samples="amplitude_float32",
    n_samples=512,
    full_scale=1 << 40,
)
AHEAD = Pose(0.0, 0.0, 0.0, 0.0, 5.0)


def events(scene: SyntheticScene) -> tuple[list[NavSample], list[Ping]]:
    everything = list(synthetic_mission(scene))
    return [e for e in everything if isinstance(e, NavSample)], [e for e in everything if isinstance(e, Ping)]


def echo(ping: Ping, side: str) -> EchoTrace:
    trace: EchoTrace | None = getattr(ping, side)
    assert trace is not None
    return trace


def intensities(pings: list[Ping], side: str = "starboard") -> NDArray[np.float64]:
    """(n_pings, n_samples) in units of the mean sea floor at 15 degrees grazing."""
    return np.stack([echo(p, side).samples for p in pings]).astype(np.float64) ** 2 / PLAIN.seabed_counts**2


def ecef(latitude_deg: float, longitude_deg: float, height_m: float = 0.0) -> NDArray[np.float64]:
    """The textbook formula, WGS 84."""
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    lat, lon = math.radians(latitude_deg), math.radians(longitude_deg)
    n = a / math.sqrt(1 - e2 * math.sin(lat) ** 2)
    return np.array(
        [
            (n + height_m) * math.cos(lat) * math.cos(lon),
            (n + height_m) * math.cos(lat) * math.sin(lon),
            (n * (1 - e2) + height_m) * math.sin(lat),
        ]
    )


def bearing_vector(latitude_deg: float, longitude_deg: float, heading_rad: float) -> NDArray[np.float64]:
    """Unit vector of a true heading in Earth-centred axes."""
    lat, lon = math.radians(latitude_deg), math.radians(longitude_deg)
    north = np.array([-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat)])
    east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    return math.cos(heading_rad) * north + math.sin(heading_rad) * east


# --- track and truth ---


@pytest.mark.parametrize(
    ("latitude", "longitude"), [(43.0, 5.5), (0.0, 179.9999), (-65.0, -180.0), (89.0, 10.0), (89.9999, -120.0), (-89.0, 100.0)]
)
@pytest.mark.parametrize("heading", [0.0, 77.0, 200.0])
def test_the_vehicle_moves_where_it_points_anywhere_on_the_globe(latitude: float, longitude: float, heading: float) -> None:
    legs = (Leg(latitude_deg=latitude, longitude_deg=longitude, heading_deg=heading, length_m=200.0),)
    scene = structs.replace(PLAIN, legs=legs, n_samples=32, ping_rate_hz=0.5)
    samples, _ = events(scene)
    assert ecef(samples[0].latitude_deg, samples[0].longitude_deg) == pytest.approx(ecef(latitude, longitude), abs=1e-6)
    assert math.degrees(samples[0].heading_rad) == pytest.approx(heading, abs=1e-6)
    for a, b in pairwise(samples):
        step = ecef(b.latitude_deg, b.longitude_deg) - ecef(a.latitude_deg, a.longitude_deg)
        assert np.linalg.norm(step) == pytest.approx(scene.speed_mps / scene.ping_rate_hz, abs=1e-3)
        ahead = bearing_vector(a.latitude_deg, a.longitude_deg, a.heading_rad)
        assert float(step @ ahead) / np.linalg.norm(step) == pytest.approx(1.0, abs=1e-8)
        assert -180.0 <= b.longitude_deg < 180.0


def test_a_lawnmower_is_flown_with_turns_of_constant_speed() -> None:
    legs = lawnmower(60.0, 11.0, 250.0, n_legs=3, length_m=40.0, spacing_m=12.0)
    scene = structs.replace(PLAIN, legs=legs, turns=True, n_samples=32, ping_rate_hz=5.0)
    samples, pings = events(scene)
    assert len(pings) == math.ceil((3 * 40.0 + 2 * math.pi * 6.0) / scene.speed_mps * scene.ping_rate_hz)
    positions = np.array([ecef(s.latitude_deg, s.longitude_deg) for s in samples])
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert steps == pytest.approx(scene.speed_mps / scene.ping_rate_hz, rel=1e-2)
    headings = np.unwrap([s.heading_rad for s in samples])
    assert np.abs(np.diff(headings)).max() == pytest.approx(steps.mean() / 6.0, rel=1e-2)
    assert math.degrees(headings[-1] - headings[0]) == pytest.approx(0.0, abs=0.01)  # to starboard, then to port
    assert math.degrees(np.ptp(headings)) == pytest.approx(180.0, abs=0.01)
    assert np.diff([p.time_s for p in pings]) == pytest.approx(0.2)


def test_without_turns_pings_fall_silent_between_legs() -> None:
    legs = lawnmower(60.0, 11.0, 250.0, n_legs=2, length_m=9.0, spacing_m=100.0)
    _, pings = events(structs.replace(PLAIN, legs=legs, n_samples=32, ping_rate_hz=5.0))
    gaps = np.diff([p.time_s for p in pings])
    assert len(pings) == 50
    assert np.sort(gaps)[-2:] == pytest.approx([0.2, 10.2])


def test_altitude_and_depth_follow_their_profile() -> None:
    legs = (structs.replace(PLAIN.legs[0], length_m=50.0),)
    scene = structs.replace(PLAIN, legs=legs, n_samples=32, ping_rate_hz=5.0, altitude_wave_m=1.0, altitude_wavelength_m=20.0)
    samples, pings = events(scene)
    way = np.arange(len(pings)) * 0.36
    assert [p.altitude_m for p in pings] == pytest.approx(5.0 + np.sin(2 * np.pi * way / 20.0))
    assert np.array([s.depth_m + s.altitude_m for s in samples]) == pytest.approx(20.0)


def test_truth_tells_where_objects_are_whichever_way_they_were_placed() -> None:
    by_leg = SceneObject(kind="cylinder", leg=0, along_m=3.0, across_m=-7.0, length_m=2.0, height_m=0.5, azimuth_deg=30.0, is_target=False)
    (told,) = truth(structs.replace(PLAIN, objects=(by_leg,)))["objects"]
    assert told["kind"] == "cylinder"
    assert told["is_target"] is False
    assert (told["length_m"], told["width_m"], told["height_m"], told["azimuth_deg"]) == (2.0, 0.5, 0.5, 30.0)
    start, there = ecef(43.0, 5.5), ecef(told["lat"], told["lon"])
    north, east = bearing_vector(43.0, 5.5, 0.0), bearing_vector(43.0, 5.5, math.pi / 2)
    assert (there - start) @ north == pytest.approx(3.0, abs=1e-4)
    assert (there - start) @ east == pytest.approx(-7.0, abs=1e-4)
    by_position = SceneObject(kind="cylinder", latitude_deg=told["lat"], longitude_deg=told["lon"], length_m=2.0, height_m=0.5)
    (again,) = truth(structs.replace(PLAIN, objects=(by_position,)))["objects"]
    assert (again["lat"], again["lon"]) == pytest.approx((told["lat"], told["lon"]), abs=1e-12)


def test_swept_area_counts_overlap_once() -> None:
    swath = 2 * math.sqrt(30.0**2 - 5.0**2)
    one = structs.replace(PLAIN, legs=lawnmower(43.0, 5.5, 20.0, n_legs=1, length_m=100.0, spacing_m=20.0))
    two = structs.replace(PLAIN, legs=lawnmower(43.0, 5.5, 20.0, n_legs=2, length_m=100.0, spacing_m=20.0))
    assert truth(one)["area_km2"] * 1e6 == pytest.approx(100.0 * swath, rel=0.01)
    assert truth(two)["area_km2"] * 1e6 == pytest.approx(100.0 * (swath + 20.0), rel=0.01)


# --- echoes ---


@pytest.mark.parametrize("altitude", [2.0, 5.0, 12.0])
@pytest.mark.parametrize("pitch", [0.0, 8.0])
def test_flat_sea_floor_follows_the_sonar_equation(altitude: float, pitch: float) -> None:
    scene = structs.replace(PLAIN, pitch_deg=pitch)
    got = mean_intensity(scene, [], None, AHEAD._replace(altitude_m=altitude), 1.0)
    slant = (np.arange(scene.n_samples) + 0.5) * scene.range_m / scene.n_samples
    nadir = altitude / math.cos(math.radians(pitch))
    seen = slant > 1.2 * nadir
    sine = nadir / slant[seen]
    reference = math.sin(math.radians(15.0)) ** 2 / math.cos(math.radians(15.0))
    expected = sine**2 / np.sqrt(1 - sine**2) / reference
    assert 10 * np.abs(np.log10(got[seen] / expected)).max() < 0.1
    assert np.all(got[slant < nadir - 0.1] == 0.0)


@given(
    height=st.floats(0.2, 1.2),
    across=st.floats(6.0, 20.0),
    altitude=st.floats(3.0, 8.0),
    side=st.sampled_from([-1.0, 1.0]),
    pitch=st.sampled_from([0.0, -7.0]),
)
@settings(max_examples=40)
def test_a_box_casts_the_shadow_of_similar_triangles(height: float, across: float, altitude: float, side: float, pitch: float) -> None:
    scene = structs.replace(PLAIN, n_samples=2048, pitch_deg=pitch)
    ahead = altitude * math.tan(math.radians(pitch))
    width = 0.8
    box = Solid("box", side * across, ahead, 0.0, 6.0, width, height, 3.0)
    got = mean_intensity(scene, [box], None, AHEAD._replace(altitude_m=altitude), side)
    secant = 1 / math.cos(math.radians(pitch))
    far = across + width / 2
    shadow_end = far * altitude / (altitude - height)
    spacing = scene.range_m / scene.n_samples
    begins = max(math.hypot(far, (altitude - height) * secant), math.hypot(far - width, altitude * secant))  # top's end, face's foot
    ends = math.hypot(shadow_end, altitude * secant)
    dark = np.flatnonzero(got[: int(29.0 / spacing)] == 0.0)
    dark = dark[dark * spacing > 1.05 * altitude * secant]
    if ends > 28.9:
        return
    assert dark.size
    assert dark[0] * spacing == pytest.approx(begins, abs=3 * spacing)
    assert (dark[-1] + 1) * spacing == pytest.approx(ends, abs=3 * spacing)
    near_face = math.hypot(across - width / 2, (altitude - height) * secant)  # its top edge comes first: layover
    bright = np.flatnonzero(got > 1.5 * mean_intensity(scene, [], None, AHEAD._replace(altitude_m=altitude), side))
    assert bright[0] * spacing == pytest.approx(near_face, abs=3 * spacing)


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "rock"])
def test_round_objects_shadow_as_far_as_their_tangent_ray(kind: str) -> None:
    scene = structs.replace(PLAIN, n_samples=2048)
    solid = Solid(kind, 12.0, 0.0, 0.0, 0.9 if kind == "sphere" else 4.0, 0.9, 0.9, 3.0)  # type: ignore[arg-type]  # one of its literals
    got = mean_intensity(scene, [solid], None, AHEAD, 1.0)
    y = np.linspace(11.55, 12.45, 100_001)
    root = np.sqrt(np.maximum(0.0, 1 - ((y - 12.0) / 0.45) ** 2))
    z = 0.9 * root if kind == "rock" else 0.45 * (1 + root)
    z[root == 0.0] = 0.0
    end = math.hypot(float((y * 5.0 / (5.0 - z)).max()), 5.0)
    dark = np.flatnonzero(got == 0.0)
    spacing = scene.range_m / scene.n_samples
    dark = dark[(dark * spacing > 6.0) & (dark * spacing < 29.0)]
    assert (dark[-1] + 1) * spacing == pytest.approx(end, abs=0.05)


@given(
    heading=st.floats(0.0, 360.0),
    across=st.floats(8.0, 25.0),
    side=st.sampled_from([-1.0, 1.0]),
    altitude=st.floats(2.0, 7.0),
    pitch=st.floats(-10.0, 10.0),
    place=st.sampled_from([(43.0, 5.5), (89.0, 0.0), (-20.0, 179.99999)]),
)
@settings(max_examples=25)
def test_a_point_is_seen_when_abeam_at_its_slant_range(
    heading: float, across: float, side: float, altitude: float, pitch: float, place: tuple[float, float]
) -> None:
    leg = Leg(latitude_deg=place[0], longitude_deg=place[1], heading_deg=heading, length_m=8.0)
    point = SceneObject(kind="point", leg=0, along_m=4.0, across_m=side * across, highlight_db=50.0)
    scene = structs.replace(PLAIN, legs=(leg,), objects=(point,), altitude_m=altitude, pitch_deg=pitch, looks=400, noise_db=-40.0)
    (told,) = truth(scene)["objects"]
    samples, pings = events(scene)
    target = ecef(told["lat"], told["lon"])
    name = "starboard" if side > 0 else "port"
    expected = []
    for sample in samples:
        vehicle = ecef(sample.latitude_deg, sample.longitude_deg, altitude)
        down = -bearing_vector_up(sample.latitude_deg, sample.longitude_deg)
        axis = (
            math.cos(sample.pitch_rad) * bearing_vector(sample.latitude_deg, sample.longitude_deg, sample.heading_rad)
            - math.sin(sample.pitch_rad) * down
        )
        travelled = scene.speed_mps * np.linalg.norm(target - vehicle) / scene.sound_speed_mps
        expected.append(float((target - vehicle) @ axis) / math.cos(sample.pitch_rad) - travelled)
    miss = np.array(expected)
    if not miss[0] > 0.5 > -0.5 > miss[-1]:
        return  # the fan looks so far ahead that the leg is too short
    energy = intensities(pings, name)
    row = int(np.argmax(energy.max(axis=1)))
    slant = (int(np.argmax(energy[row])) + 0.5) * echo(pings[row], name).spacing_m
    assert abs(miss[row]) <= 0.5 * scene.speed_mps / scene.ping_rate_hz + 0.01
    vehicle = ecef(samples[row].latitude_deg, samples[row].longitude_deg, altitude)
    assert slant == pytest.approx(np.linalg.norm(target - vehicle), abs=0.06)
    assert energy[row].max() > 30.0 * np.median(energy)


def bearing_vector_up(latitude_deg: float, longitude_deg: float) -> NDArray[np.float64]:
    lat, lon = math.radians(latitude_deg), math.radians(longitude_deg)
    return np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])


@pytest.mark.parametrize(("looks", "sigma"), [(1, 0.0), (4, 0.0), (1, 1.5), (2, 1.0)])
def test_speckle_has_its_moments_and_correlation(looks: int, sigma: float) -> None:
    scene = structs.replace(PLAIN, looks=looks, psf_sigma_samples=sigma)
    _, pings = events(scene)
    mean = mean_intensity(scene, [], None, AHEAD, 1.0)
    mean += 10 ** (scene.noise_db / 10)
    speckle = intensities(pings) / mean
    assert speckle.mean() == pytest.approx(1.0, abs=0.03)
    assert speckle.var() == pytest.approx(1.0 / looks, rel=0.1)
    deviation = speckle - 1.0
    neighbours = float(np.mean(deviation[:, 1:] * deviation[:, :-1]) / np.mean(deviation**2))
    expected = math.exp(-1 / (2 * sigma**2)) if sigma else 0.0  # squared correlation of the Gaussian-filtered field
    assert neighbours == pytest.approx(expected, abs=0.04)
    assert abs(float(np.mean(deviation[1:] * deviation[:-1]) / np.mean(deviation**2))) < 0.04


def test_texture_lies_fixed_on_the_sea_floor() -> None:
    scene = structs.replace(PLAIN, texture_nu=2.0, texture_m=1.0, looks=1000, noise_db=-60.0)
    _, pings = events(scene)
    flat = mean_intensity(structs.replace(scene, texture_nu=0.0), [], None, AHEAD, 1.0)
    texture = intensities(pings)[:, 200:480] / flat[200:480]
    assert np.corrcoef(texture[0], texture[3])[0, 1] > 0.9  # 0.36 m on
    assert abs(np.corrcoef(texture[0], texture[40])[0, 1]) < 0.6  # 4.8 m on
    assert texture.var() == pytest.approx(0.5, rel=0.6)


def test_amplitudes_saturate_and_ring_down_is_clipped() -> None:
    scene = structs.replace(PLAIN, samples="amplitude_uint16", seabed_counts=20000.0, full_scale=32767, ring_down_m=0.5)
    _, pings = events(scene)
    samples = np.stack([echo(p, "port").samples for p in pings])
    assert samples.dtype == np.uint16
    assert samples.max() == 32767
    assert np.all(samples[:, :8] == 32767)
    assert samples[:, 10:70].max() < 10000  # open water


def test_log_samples_are_decibels() -> None:
    scene = structs.replace(PLAIN, samples="log_uint8")
    linear = intensities(events(PLAIN)[1])
    _, pings = events(scene)
    samples = np.stack([echo(p, "starboard").samples for p in pings])
    assert samples.dtype == np.uint8
    inside = (samples > 0) & (samples < 255)
    decibels = (samples[inside] - 150.0) * scene.db_per_count
    assert np.abs(decibels - 10 * np.log10(linear[inside])).max() <= 0.5 * scene.db_per_count + 1e-3
    assert np.std(10 * np.log10(linear[:, 300:])) == pytest.approx(5.6, abs=0.4)


# --- reproducibility, files, errors ---


def test_equal_scenes_give_equal_bytes_and_other_seeds_do_not() -> None:
    def digest(scene: SyntheticScene) -> list[bytes]:
        return [echo(p, side).samples.tobytes() for p in events(scene)[1] for side in ("port", "starboard")]

    scene = structs.replace(PLAIN, texture_nu=3.0)
    assert digest(scene) == digest(structs.replace(scene))
    assert digest(scene)[0] != digest(structs.replace(scene, seed=1))[0]
    assert len(set(digest(scene))) == len(digest(scene))


def test_a_ping_does_not_depend_on_how_much_is_drawn() -> None:
    some = [e for e in islice(synthetic_mission(demo_scene()), 40) if isinstance(e, Ping)]
    longer = [e for e in islice(synthetic_mission(demo_scene(n_legs=3)), 40) if isinstance(e, Ping)]
    assert all(np.array_equal(echo(a, "port").samples, echo(b, "port").samples) for a, b in zip(some, longer, strict=True))


def test_the_command_writes_a_log_and_its_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def short(seed: int, n_legs: int) -> SyntheticScene:
        scene = demo_scene(seed, n_legs)
        return structs.replace(scene, ping_rate_hz=1.0, n_samples=64)

    monkeypatch.setattr(synthetic, "demo_scene", short)
    path = tmp_path / "new" / "mission.xtf"
    assert synthetic.main(["--out", str(path), "--seed", "3", "--legs", "2"]) == 0
    log = XtfLog(path, SonarConfig())
    pings = [event for event in log if isinstance(event, Ping)]
    facts: dict[str, Any] = json.loads((tmp_path / "new" / "mission.truth.json").read_text())
    assert f"{len(pings)} pings" in capsys.readouterr().out
    assert 120 < len(pings) < 200
    assert 0.008 < facts["area_km2"] < 0.013
    assert sum(thing["is_target"] for thing in facts["objects"]) == 6
    assert len(facts["objects"]) >= 8


def test_the_command_reports_what_it_cannot_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert synthetic.main(["--out", str(tmp_path / "a.xtf"), "--legs", "0"]) == 2
    assert "scene.legs" in capsys.readouterr().err
    (tmp_path / "file").touch()
    assert synthetic.main(["--out", str(tmp_path / "file" / "a.xtf")]) == 2
    assert "cannot be written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"speed_mps": 0.0}, "scene.speed_mps"),
        ({"speed_mps": math.nan}, "scene.speed_mps"),
        ({"ping_rate_hz": 26.0}, "scene.ping_rate_hz"),
        ({"altitude_m": 31.0}, "scene.range_m"),
        ({"altitude_wave_m": 5.0}, "scene.altitude_wave_m"),
        ({"pitch_deg": 60.0}, "scene.pitch_deg"),
        ({"sound_speed_mps": 750.0}, "scene.sound_speed_mps"),
        ({"n_samples": 3}, "scene.n_samples"),
        ({"looks": 0}, "scene.looks"),
        ({"texture_nu": -1.0}, "scene.texture_nu"),
        ({"seed": -1}, "scene.seed"),
        ({"legs": ()}, "scene.legs"),
        ({"legs": (Leg(latitude_deg=91.0, longitude_deg=0.0, heading_deg=0.0, length_m=1.0),)}, r"scene.legs\[0\].latitude_deg"),
        ({"legs": (Leg(latitude_deg=1.0, longitude_deg=0.0, heading_deg=math.inf, length_m=1.0),)}, r"scene.legs\[0\].heading_deg"),
        ({"legs": (PLAIN.legs[0], PLAIN.legs[0]), "turns": True}, r"scene.legs\[1\]"),
        ({"objects": (SceneObject(kind="point"),)}, r"scene.objects\[0\]"),
        ({"objects": (SceneObject(kind="point", leg=4, along_m=1.0, across_m=1.0),)}, r"scene.objects\[0\].leg"),
        ({"objects": (SceneObject(kind="sphere", leg=0, along_m=1.0, across_m=1.0),)}, r"scene.objects\[0\].height_m"),
        (
            {"objects": (SceneObject(kind="box", leg=0, along_m=1.0, across_m=1.0, length_m=1.0, height_m=1.0),)},
            r"scene.objects\[0\].width_m",
        ),
    ],
)
def test_impossible_scenes_are_refused_by_field(change: dict[str, Any], named: str) -> None:
    scene = structs.replace(PLAIN, **change)
    for use in (lambda: list(synthetic_mission(scene)), lambda: truth(scene)):
        with pytest.raises(UsageError, match=named):
            use()


def test_a_scene_survives_json() -> None:
    scene = demo_scene()
    assert msgspec.json.decode(msgspec.json.encode(structs.replace(scene, objects=())), type=SyntheticScene) == structs.replace(
        scene, objects=()
    )
