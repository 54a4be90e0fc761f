"""The sea's levels against the sonar equation, and its speckle against its laws."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.special import kolmogorov

from sim_replay.simulator.backscatter import SEDIMENTS, backscatter
from sim_replay.simulator.scene import STEADY, Lawnmower, SampleRecorder, Scene, Seabed, SeabedType, Sonar, Track, World
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.seabeds import USUAL
from sim_replay.simulator.vehicle import SonarPose

Floats = NDArray[np.float64]
DEPTH_M = 40.0


def even(kind: SeabedType) -> World:
    bare = Seabed(type=kind, relief_rms_m=0.0, texture_shape=0.0, stones_per_ha=0.0)
    return World(depth_m=DEPTH_M, seabeds=(replace(bare, ripples=None),), relief_rms_m=0.0)


def pose(altitude_m: float, roll_rad: float = 0.0, pitch_rad: float = 0.0) -> SonarPose:
    return SonarPose(0.0, 3.0, -7.0, DEPTH_M - altitude_m, 0.4, pitch_rad, roll_rad, 0.4, 1.8, 0)


def level_floor(altitude_m: float, kind: SeabedType = "sand", sonar: Sonar | None = None) -> Scene:
    track = Track(plan=Lawnmower(n_legs=1), altitude_m=altitude_m, motion=STEADY)
    return Scene(world=even(kind), sonar=sonar or Sonar(absorption_db_per_km=90.0), track=track)


def sonar_equation(scene: Scene, at: SonarPose, starboard: bool, kind: SeabedType) -> Floats:
    """Of every bin: sigma B^2 10^(-2 a r / 10) r^-4 over the floor that lies in it, (n_samples,).

    The fan's plane is tilted by the pitch; where it meets the floor, the strip within the beam is r theta / cos(pitch)
    wide.
    """
    sonar = scene.sonar
    altitude_m = DEPTH_M - at.depth_m
    in_plane_m = altitude_m / math.cos(at.pitch_rad)
    edges = np.arange(sonar.n_samples + 1) * (sonar.range_m / sonar.n_samples)
    ground = np.sqrt(np.maximum(edges**2 - in_plane_m**2, 0.0))
    inside = ground[:-1, None] + np.diff(ground)[:, None] * ((np.arange(50) + 0.5) / 50)
    r = np.hypot(inside, in_plane_m)
    sigma = backscatter(
        SEDIMENTS[USUAL[kind].sediment], 1e3 * sonar.frequency_khz, np.arcsin(altitude_m / r), sonar.sound_speed_mps
    )
    off_axis = (
        np.arctan2(in_plane_m, inside) - math.radians(sonar.tilt_deg) - (at.roll_rad if starboard else -at.roll_rad)
    )
    phase = 1.0019127 * np.sin(off_axis) / math.sin(math.radians(0.5 * sonar.vertical_beam_width_deg))
    pattern = (np.sin(phase) / phase) ** 4
    middle = 0.5 * (edges[1:] + edges[:-1])
    width = math.radians(sonar.beam_width_deg) * middle / math.cos(at.pitch_rad)
    loss = 10.0 ** (-2.0 * (sonar.absorption_db_per_km or 0.0) * middle / 1e4) / middle**4
    return np.asarray((sigma * pattern).mean(axis=1) * np.diff(ground) * width * loss)


@pytest.mark.parametrize("kind", ["sand", "gravel", "mud", "rock_outcrop"])
@pytest.mark.parametrize(
    ("frequency_khz", "altitude_m", "tilt_deg", "roll_rad", "pitch_rad"),
    [
        (450.0, 6.0, 25.0, 0.0, 0.0),
        (100.0, 15.0, 40.0, -0.1, 0.02),
        (900.0, 3.0, 30.0, 0.05, -0.2),
        (300.0, 2.0, 20.0, 0.0, 0.5),
    ],
)
def test_a_level_floor_has_the_level_of_the_sonar_equation_in_every_bin(
    kind: SeabedType, frequency_khz: float, altitude_m: float, tilt_deg: float, roll_rad: float, pitch_rad: float
) -> None:
    sonar = Sonar(frequency_khz=frequency_khz, tilt_deg=tilt_deg, absorption_db_per_km=90.0)
    scene, at = level_floor(altitude_m, kind, sonar), pose(altitude_m, roll_rad, pitch_rad)
    found = Sea(scene).mean_intensity([at])[0]
    bin_m = sonar.range_m / sonar.n_samples
    r = (np.arange(sonar.n_samples) + 0.5) * bin_m
    heard = r > altitude_m / math.cos(pitch_rad) + 2.0 * bin_m
    for side in range(2):
        expected = sonar_equation(scene, at, side == 1, kind)
        off_db = 10.0 * np.log10(found[side, heard] / expected[heard])
        assert np.abs(off_db).max() < 0.05
        assert abs(off_db.mean()) < 0.005
        assert np.all(found[side, r < altitude_m / math.cos(pitch_rad) - bin_m] == 0.0)


def test_the_reference_is_the_echo_of_the_floor_at_half_range() -> None:
    scene = level_floor(6.0)
    sea = Sea(scene)
    at_half = sea.mean_intensity([pose(6.0)])[0, 1, 573:575].mean()  # half of 6 m and 50 m
    assert sea.reference == pytest.approx(at_half, rel=0.01)
    assert sea.noise == pytest.approx(sea.reference * 10.0 ** (0.1 * scene.sonar.noise_db))


def intensity(sea: Sea, poses: list[SonarPose]) -> Floats:
    """Of both sides of pings over its mean, (2 n, n_samples), from the samples that are recorded as amplitudes."""
    pings = sea.sound(poses, 11)
    counts = sea.recorder.seabed_counts
    assert counts is not None
    traces = [
        trace.samples.astype(np.float64) / counts
        for ping in pings
        for trace in (ping.port, ping.starboard)
        if trace is not None
    ]
    mean = (sea.mean_intensity(poses) + sea.noise) / sea.reference
    sonar = sea.scene.sonar
    r = (np.arange(sonar.n_samples) + 0.5) * (sonar.range_m / sonar.n_samples)
    middle = 0.5 * (sea.scene.track.altitude_m + sonar.range_m)
    gain = (r / middle) ** 3 * 10.0 ** (2e-4 * (sonar.absorption_db_per_km or 0.0) * (r - middle))
    return np.asarray(np.square(traces) / (mean.reshape(-1, sonar.n_samples) * gain))


@pytest.mark.parametrize(("looks", "resolution_m"), [(1, 0.0), (3, 0.0), (1, 0.12)])
def test_speckle_is_exponential_about_the_mean_and_correlated_over_the_resolution(
    looks: int, resolution_m: float
) -> None:
    recorder = SampleRecorder(samples="amplitude_float32", seabed_counts=1.0)
    sonar = Sonar(absorption_db_per_km=90.0, looks=looks, range_resolution_m=resolution_m, recorder=recorder)
    speckle = intensity(Sea(level_floor(6.0, "sand", sonar)), [pose(6.0)] * 100)[:, 200:]
    assert speckle.mean() == pytest.approx(1.0, abs=0.01)
    assert speckle.var() == pytest.approx(1.0 / looks, rel=0.04)
    excess = speckle - 1.0
    bin_m = sonar.range_m / sonar.n_samples
    for lag in (1, 2, 3, 5):
        correlation = float((excess[:, lag:] * excess[:, :-lag]).mean() / excess.var())
        expected = 0.25 ** ((lag * bin_m / resolution_m) ** 2) if resolution_m else 0.0
        assert correlation == pytest.approx(expected, abs=0.015)
    if looks == 1:
        apart = np.sort(speckle[:, ::12].ravel())
        law = -np.expm1(-apart)
        steps = np.arange(len(apart) + 1) / len(apart)
        distance = float(np.maximum(np.abs(law - steps[1:]), np.abs(law - steps[:-1])).max())
        assert kolmogorov(math.sqrt(len(apart)) * distance) > 0.01


@pytest.mark.parametrize("noise_db", [-60.0, 0.0, 40.0])
def test_echoes_are_correlated_along_the_track_as_asked_for_and_noise_is_not(noise_db: float) -> None:
    recorder = SampleRecorder(samples="amplitude_float32", seabed_counts=1.0)
    sonar = Sonar(absorption_db_per_km=90.0, noise_db=noise_db, speckle_along_track_m=0.45, recorder=recorder)
    sea = Sea(level_floor(6.0, "sand", sonar))
    assert sea.scene.track.speed_mps / sonar.ping_rate_hz == pytest.approx(0.15)
    excess = intensity(sea, [pose(6.0)] * 400)[::2, 200::4] - 1.0
    assert excess.mean() == pytest.approx(0.0, abs=0.03)
    echo = sea.mean_intensity([pose(6.0)])[0, 0, 200::4]
    of_echoes = float(np.mean((echo / (echo + sea.noise)) ** 2))
    for lag in (1, 2):
        correlation = float((excess[lag:] * excess[:-lag]).mean() / excess.var())
        assert correlation == pytest.approx(of_echoes * 0.25 ** ((lag / 3.0) ** 2), abs=0.03)
