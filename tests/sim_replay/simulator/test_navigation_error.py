"""The reported pose differs from the true one by the scene's errors alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NavSample
from sim_replay.simulator.navigation_error import NavigationModel
from sim_replay.simulator.scene import EXACT, NavigationError, Origin
from sim_replay.simulator.vehicle import SonarPose

ORIGIN = Origin(latitude_deg=43.0, longitude_deg=5.0)
FRAME = LocalFrame(latitude_deg=43.0, longitude_deg=5.0)
POSE = SonarPose(1_700_000_000.0, 30.0, -20.0, 14.0, 1.0, 0.05, -0.02, 1.1, 1.8, 0)
N = 1000
SURE = 4.5  # standard deviations


def reported(error: NavigationError, poses: list[SonarPose], seed: int = 1, altitude_m: float = 6.0) -> list[NavSample]:
    model = NavigationModel(error, ORIGIN, seed)
    return [model.reported(pose, altitude_m) for pose in poses]


def straight(n: int, interval_s: float = 1.0) -> list[SonarPose]:
    """Northwards at 2 m/s."""
    return [SonarPose(interval_s * i, 0.0, 2.0 * interval_s * i, 14.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0) for i in range(n)]


def off_m(samples: list[NavSample], poses: list[SonarPose]) -> NDArray[np.float64]:
    """(n, 2) error to the east and north."""
    latitude, longitude = np.array([(sample.latitude_deg, sample.longitude_deg) for sample in samples]).T
    there = FRAME.to_enu(latitude, longitude, np.zeros(len(samples)))
    return np.asarray(there[:, :2] - np.array([(pose.east_m, pose.north_m) for pose in poses]))


@settings(max_examples=60, deadline=None)
@given(
    st.floats(-88.0, 88.0), st.floats(-180.0, 180.0), st.floats(-8e3, 8e3), st.floats(-8e3, 8e3), st.floats(-7.0, 14.0)
)
def test_an_exact_system_reports_the_truth(
    latitude: float, longitude: float, east_m: float, north_m: float, heading_rad: float
) -> None:
    pose = POSE._replace(east_m=east_m, north_m=north_m, heading_rad=heading_rad)
    frame = LocalFrame(latitude_deg=latitude, longitude_deg=longitude)
    sample = NavigationModel(EXACT, Origin(latitude_deg=latitude, longitude_deg=longitude), 1).reported(pose, 6.25)
    here = frame.to_geodetic([east_m, north_m, 0.0])
    assert sample.latitude_deg == pytest.approx(float(here[0]), abs=1e-11)
    assert math.remainder(sample.longitude_deg - float(here[1]), 360.0) == pytest.approx(0.0, abs=1e-9)
    ahead = frame.to_geodetic([east_m + 10.0 * math.sin(heading_rad), north_m + 10.0 * math.cos(heading_rad), 0.0])
    there = LocalFrame(latitude_deg=float(here[0]), longitude_deg=float(here[1]), height_m=float(here[2])).to_enu(
        *ahead
    )
    assert math.remainder(sample.heading_rad - math.atan2(there[0], there[1]), 2.0 * math.pi) == pytest.approx(
        0.0, abs=1e-8
    )
    assert 0.0 <= sample.heading_rad < 2.0 * math.pi
    assert (sample.time_s, sample.depth_m, sample.altitude_m) == (pose.time_s, pose.depth_m, 6.25)
    assert (sample.pitch_rad, sample.roll_rad, sample.speed_mps) == (pose.pitch_rad, pose.roll_rad, pose.speed_mps)


def test_each_error_leaves_everything_else_alone() -> None:
    exact = reported(EXACT, [POSE, POSE._replace(time_s=POSE.time_s + 10.0)])[1]
    touches = {
        "position_sigma_m": {"latitude_deg", "longitude_deg"},
        "drift_percent": {"latitude_deg", "longitude_deg"},
        "heading_bias_sigma_deg": {"heading_rad"},
        "attitude_noise_deg": {"heading_rad", "pitch_rad", "roll_rad"},
        "altitude_bias_percent": {"altitude_m"},
        "altitude_noise_m": {"altitude_m"},
        "speed_bias_percent": {"speed_mps"},
        "sound_speed_bias_mps": set(),
    }
    for name, fields in touches.items():
        sample = reported(structs.replace(EXACT, **{name: 1.0}), [POSE, POSE._replace(time_s=POSE.time_s + 10.0)])[1]
        differing = {
            field for field in NavSample.__struct_fields__ if abs(getattr(sample, field) - getattr(exact, field)) > 0.0
        }
        assert differing == fields, name


def test_the_position_wanders_by_its_sigma_over_its_period() -> None:
    error = structs.replace(EXACT, position_sigma_m=0.4, position_period_s=100.0)
    poses = straight(3, 10.0)
    off = np.array([off_m(reported(error, poses, seed), poses) for seed in range(N)])
    for tick in range(3):
        assert np.mean(off[:, tick] ** 2, axis=0) == pytest.approx(0.4**2, rel=SURE * math.sqrt(2.0 / N))
    assert np.mean(off[:, 0, 0] * off[:, 0, 1]) == pytest.approx(0.0, abs=SURE * 0.4**2 / math.sqrt(N))
    omega = 2.0 * math.pi / 100.0
    damped = omega * math.sqrt(0.75)
    for tick in (1, 2):
        lag = 10.0 * tick
        expected = math.exp(-omega * lag / 2.0) * (
            math.cos(damped * lag) + omega / 2.0 / damped * math.sin(damped * lag)
        )
        assert np.mean(off[:, 0] * off[:, tick], axis=0) / 0.4**2 == pytest.approx(
            expected, abs=SURE * math.sqrt(2.0 / N)
        )


def test_the_drift_grows_with_the_way_in_one_direction_of_the_mission() -> None:
    error = structs.replace(EXACT, drift_percent=0.5)
    poses = straight(501)
    directions = []
    for seed in range(40):
        off = off_m(reported(error, poses, seed), poses)
        np.testing.assert_allclose(np.hypot(*off.T), 0.005 * np.arange(501) * 2.0, atol=1e-4)
        direction = np.arctan2(off[-1, 0], off[-1, 1])
        np.testing.assert_allclose(np.arctan2(off[10:, 0], off[10:, 1]), direction, atol=1e-3)
        directions.append(direction)
    assert abs(np.mean(np.exp(1j * np.array(directions)))) < 3.0 / math.sqrt(40.0)


def test_the_drift_counts_the_way_there_and_back() -> None:
    error = structs.replace(EXACT, drift_percent=1.0)
    there = straight(101)
    back = [pose._replace(time_s=200.0 - pose.time_s) for pose in reversed(there)]
    poses = there + back[1:]
    assert np.hypot(*off_m(reported(error, poses), poses)[-1]) == pytest.approx(4.0, abs=1e-4)


def test_biases_are_drawn_once_per_mission_with_their_standard_deviations() -> None:
    error = structs.replace(EXACT, heading_bias_sigma_deg=2.0, altitude_bias_percent=3.0, speed_bias_percent=1.5)
    poses = [POSE._replace(east_m=0.0, north_m=0.0, time_s=POSE.time_s + tick) for tick in (0.0, 500.0)]
    missions = np.array(
        [[(s.heading_rad, s.altitude_m, s.speed_mps) for s in reported(error, poses, seed)] for seed in range(N)]
    )
    assert np.array_equal(missions[:, 0], missions[:, 1])
    heading, altitude, speed = missions[:, 0].T
    drawn = np.array([np.degrees(heading - 1.0) / 2.0, (altitude / 6.0 - 1.0) / 0.03, (speed / 1.8 - 1.0) / 0.015])
    assert np.mean(drawn**2, axis=1) == pytest.approx(1.0, rel=SURE * math.sqrt(2.0 / N))
    assert np.mean(drawn, axis=1) == pytest.approx(0.0, abs=SURE / math.sqrt(N))
    assert np.abs(np.corrcoef(drawn) - np.eye(3)).max() < SURE / math.sqrt(N)


def test_noise_is_new_in_every_sample() -> None:
    error = structs.replace(EXACT, attitude_noise_deg=0.2, altitude_noise_m=0.05)
    samples = reported(error, [POSE._replace(east_m=0.0, north_m=0.0, time_s=float(tick)) for tick in range(N)])
    rows = np.array(
        [(s.heading_rad - 1.0, s.pitch_rad - 0.05, s.roll_rad + 0.02, s.altitude_m - 6.0) for s in samples]
    ).T
    noise = rows / np.array([math.radians(0.2), math.radians(0.2), math.radians(0.2), 0.05])[:, np.newaxis]
    assert np.mean(noise**2, axis=1) == pytest.approx(1.0, rel=SURE * math.sqrt(2.0 / N))
    assert np.mean(noise[:, 1:] * noise[:, :-1], axis=1) == pytest.approx(0.0, abs=SURE / math.sqrt(N))
    assert np.abs(np.corrcoef(noise) - np.eye(4)).max() < SURE / math.sqrt(N)


def test_no_altitude_is_below_zero_and_no_heading_out_of_the_circle() -> None:
    error = NavigationError(altitude_noise_m=5.0, attitude_noise_deg=5.0)
    samples = reported(
        error, [POSE._replace(heading_rad=0.0, time_s=float(tick)) for tick in range(300)], altitude_m=1.0
    )
    assert min(sample.altitude_m for sample in samples) == 0.0
    assert all(0.0 <= sample.heading_rad < 2.0 * math.pi for sample in samples)
