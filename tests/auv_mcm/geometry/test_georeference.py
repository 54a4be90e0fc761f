from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.georeference import EchoGeometry, aspect_deg, locate, position_covariance
from auv_mcm.records import NAN, PoseTrack, Side
from auv_mcm.settings.config import NavigationConfig, SonarConfig

HOME = {"latitude_deg": 43.7, "longitude_deg": 10.3, "depth_m": 20.0}


def a_pose(n: int, /, **values: float) -> PoseTrack:
    columns = {
        "time_s": 0.0,
        "heading_rad": 0.0,
        "pitch_rad": 0.0,
        "roll_rad": 0.0,
        "speed_mps": 0.0,
        "altitude_m": NAN,
        **HOME,
        **values,
    }
    arrays: dict[str, Any] = {name: np.full(n, value) for name, value in columns.items()}
    return PoseTrack(stale=np.zeros(n, dtype=np.bool_), **arrays)


def one_echo(
    side: Side, slant_range_m: float, first_return_m: float, sound_speed_mps: float = 1500.0, **pose: float
) -> EchoGeometry:
    return EchoGeometry(
        side=side,
        pose=a_pose(1, **pose),
        slant_range_m=np.array([slant_range_m]),
        first_return_m=np.array([first_return_m]),
        sound_speed_mps=np.array([sound_speed_mps]),
    )


def enu_from_vehicle(echoes: EchoGeometry, sonar: SonarConfig) -> NDArray[np.float64]:
    """(n, 3) east, north, up of each located echo from its own vehicle."""
    found = np.stack(locate(echoes, sonar), axis=-1)
    pose = echoes.pose
    depth = np.nan_to_num(pose.depth_m)
    frames = [
        LocalFrame(latitude_deg=float(lat), longitude_deg=float(lon), height_m=-float(d))
        for lat, lon, d in zip(pose.latitude_deg, pose.longitude_deg, depth, strict=True)
    ]
    return np.stack([frame.to_enu(*point) for frame, point in zip(frames, found, strict=True)])


def oracle_enu(
    side: Side,
    heading: float,
    pitch: float,
    roll: float,
    slant_range: float,
    altitude: float,
    sonar: SonarConfig,
    advance: float,
) -> tuple[NDArray[np.float64], float]:
    """Echo from vehicle, found by walking round the circle where the sphere of radius r cuts the bottom until the
    array's axis is square to the echo; and the first bottom return.
    """
    body = Rotation.from_euler("ZYX", [heading, pitch, roll])  # to north, east, down
    mount = Rotation.from_euler("ZYX", [sonar.heading_offset_deg, sonar.pitch_offset_deg, 0.0], degrees=True)
    axis = (body * mount).apply([1.0, 0.0, 0.0])
    array = body.apply(sonar.lever_arm_m) + advance * np.array([math.cos(heading), math.sin(heading), 0.0])
    ground_range = math.sqrt(slant_range**2 - altitude**2)

    def echo(bearing: float) -> NDArray[np.float64]:
        return np.array([ground_range * math.cos(bearing), ground_range * math.sin(bearing), altitude])

    forward = math.atan2(axis[1], axis[0])
    behind, ahead = (forward + math.pi, forward) if side == "starboard" else (forward - math.pi, forward)
    bearing = brentq(lambda angle: float(axis @ echo(angle)), behind, ahead, xtol=1e-14, rtol=1e-14)
    north, east, down = array + echo(bearing)
    return np.array([east, north, -down]), altitude / math.cos(math.asin(axis[2]))


@settings(max_examples=300, deadline=None)
@given(
    side=st.sampled_from(["port", "starboard"]),
    heading=st.floats(-7.0, 7.0),
    pitch=st.floats(-10.0, 10.0),
    roll=st.floats(-20.0, 20.0),
    slant_range=st.floats(10.0, 75.0),
    fraction=st.floats(0.0, 1.0),
    lever=st.tuples(st.floats(-3.0, 3.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
    offsets=st.tuples(st.floats(-5.0, 5.0), st.floats(-3.0, 3.0)),
    speed=st.floats(0.0, 3.0),
)
def test_an_echo_lies_where_beam_plane_sphere_and_bottom_meet(
    side: Side,
    heading: float,
    pitch: float,
    roll: float,
    slant_range: float,
    fraction: float,
    lever: tuple[float, float, float],
    offsets: tuple[float, float],
    speed: float,
) -> None:
    altitude = 2.0 + fraction * (min(20.0, 0.9 * slant_range) - 2.0)
    sonar = SonarConfig(lever_arm_m=lever, heading_offset_deg=offsets[0], pitch_offset_deg=offsets[1])
    pitch, roll = math.radians(pitch), math.radians(roll)
    expected, first_return = oracle_enu(
        side, heading, pitch, roll, slant_range, altitude, sonar, speed * slant_range / 1480.0
    )
    echoes = one_echo(
        side, slant_range, first_return, 1480.0, heading_rad=heading, pitch_rad=pitch, roll_rad=roll, speed_mps=speed
    )
    np.testing.assert_allclose(enu_from_vehicle(echoes, sonar)[0], expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("side", "heading_deg", "east", "north"),
    [
        ("starboard", 0.0, 12.0, 0.0),
        ("port", 0.0, -12.0, 0.0),
        ("starboard", 90.0, 0.0, -12.0),
        ("port", 180.0, 12.0, 0.0),
    ],
)
def test_starboard_is_to_the_right_of_the_heading(side: Side, heading_deg: float, east: float, north: float) -> None:
    echoes = one_echo(side, 13.0, 5.0, heading_rad=math.radians(heading_deg))
    np.testing.assert_allclose(enu_from_vehicle(echoes, SonarConfig())[0], [east, north, -5.0], rtol=0, atol=1e-6)
    assert aspect_deg(echoes, SonarConfig())[0] == pytest.approx(
        math.degrees(math.atan2(east, north)) % 360.0, abs=1e-9
    )


@pytest.mark.parametrize(("side", "expected_deg"), [("port", 285.0), ("starboard", 75.0)])
def test_a_sub_aperture_that_looks_ahead_hears_echoes_from_ahead_of_abeam(side: Side, expected_deg: float) -> None:
    echoes = one_echo(side, 13.0, 5.0, heading_rad=0.0)
    assert aspect_deg(echoes, SonarConfig(), math.radians(15.0))[0] == pytest.approx(expected_deg)


@settings(max_examples=60, deadline=None)
@given(
    place=st.sampled_from(
        [(89.0, 12.0), (-89.0, 100.0), (12.0, 179.99999), (-33.0, -179.99999), (90.0, 0.0), (60.0, -5.0)]
    ),
    turn=st.floats(0.0, 6.3),
)
def test_the_geometry_is_the_same_anywhere_and_turned_any_way(place: tuple[float, float], turn: float) -> None:
    sonar = SonarConfig(lever_arm_m=(1.0, 0.2, 0.3))
    shape = {"pitch_rad": 0.05, "roll_rad": -0.1, "speed_mps": 1.5}
    here = enu_from_vehicle(one_echo("starboard", 60.0, 7.0, heading_rad=0.3, **shape), sonar)[0]
    there = one_echo(
        "starboard", 60.0, 7.0, heading_rad=0.3 + turn, latitude_deg=place[0], longitude_deg=place[1], **shape
    )
    cosine, sine = math.cos(turn), math.sin(turn)
    turned = [cosine * here[0] + sine * here[1], cosine * here[1] - sine * here[0], here[2]]
    np.testing.assert_allclose(enu_from_vehicle(there, sonar)[0], turned, rtol=0, atol=1e-6)
    assert -180.0 <= locate(there, sonar)[1][0] < 180.0


def test_many_echoes_at_once_equal_one_by_one() -> None:
    rng = np.random.default_rng(4)
    n = 50
    pose = a_pose(n)
    for name, low, high in (
        ("heading_rad", -9.0, 9.0),
        ("pitch_rad", -0.2, 0.2),
        ("roll_rad", -0.3, 0.3),
        ("latitude_deg", -90.0, 90.0),
    ):
        getattr(pose, name)[:] = rng.uniform(low, high, n)
    many = EchoGeometry(
        side="port",
        pose=pose,
        slant_range_m=rng.uniform(10.0, 75.0, n),
        first_return_m=rng.uniform(2.0, 9.0, n),
        sound_speed_mps=rng.uniform(1400.0, 1600.0, n),
    )
    sonar = SonarConfig(lever_arm_m=(0.4, 0.1, 0.2), heading_offset_deg=2.0)
    found = np.stack(locate(many, sonar), axis=-1)
    for i in range(n):
        names = ("heading_rad", "pitch_rad", "roll_rad", "latitude_deg")
        single = one_echo(
            "port",
            many.slant_range_m[i],
            many.first_return_m[i],
            many.sound_speed_mps[i],
            **{name: float(getattr(pose, name)[i]) for name in names},
        )
        np.testing.assert_allclose(np.stack(locate(single, sonar), axis=-1)[0], found[i], rtol=1e-14)


def test_without_depth_the_vehicle_is_at_the_surface_and_without_speed_it_stands() -> None:
    known = one_echo("port", 20.0, 5.0, depth_m=0.0, speed_mps=0.0)
    unknown = one_echo("port", 20.0, 5.0, depth_m=NAN, speed_mps=NAN)
    np.testing.assert_array_equal(locate(unknown, SonarConfig()), locate(known, SonarConfig()))
    # the Earth curves away by 30 micrometres in 20 m
    assert locate(known, SonarConfig())[2][0] == pytest.approx(-5.0, abs=1e-4)


def test_a_range_inside_the_water_column_is_the_point_below() -> None:
    np.testing.assert_allclose(
        enu_from_vehicle(one_echo("port", 4.0, 5.0), SonarConfig())[0], [0.0, 0.0, -5.0], atol=1e-6
    )


@pytest.mark.parametrize("missing", ["latitude_deg", "heading_rad"])
def test_an_unknown_place_or_heading_gives_no_position(missing: str) -> None:
    with np.errstate(all="raise", under="ignore"):
        latitude, longitude, _ = locate(one_echo("port", 20.0, 5.0, **{missing: NAN}), SonarConfig())
    assert np.isnan(latitude[0])
    assert np.isnan(longitude[0])


NO_ERROR = NavigationConfig(position_sigma_m=0.0, heading_sigma_deg=0.0, pitch_sigma_deg=0.0, sound_speed_sigma_mps=0.0)


def test_covariance_of_a_perfect_measurement_is_the_fix_alone() -> None:
    config = msgspec.structs.replace(NO_ERROR, position_sigma_m=1.5)
    covariance = position_covariance(one_echo("port", 40.0, 6.0), SonarConfig(), config, np.zeros(1))
    np.testing.assert_allclose(covariance[0], 2.25 * np.eye(2), atol=1e-12)


LEVEL_R, LEVEL_H = 40.0, 8.0
LEVEL_Y = math.sqrt(LEVEL_R**2 - LEVEL_H**2)


@pytest.mark.parametrize(
    ("error", "first_return_sigma_m", "pitch_rad", "east_m", "north_m"),
    [
        ({"heading_sigma_deg": 1.0}, 0.0, 0.0, 0.0, LEVEL_Y * math.radians(1.0)),
        ({"pitch_sigma_deg": 1.0}, 0.0, 0.0, 0.0, LEVEL_H * math.radians(1.0)),
        ({}, 0.2, 0.0, 0.2 * LEVEL_H / LEVEL_Y, 0.0),
        ({}, 0.2, 0.3, 0.2 * LEVEL_H / LEVEL_Y, 0.2 * math.sin(0.3)),
        ({"sound_speed_sigma_mps": 7.5}, 0.0, 0.0, LEVEL_R / LEVEL_Y * LEVEL_R * 0.005, 0.0),
    ],
    ids=["heading", "pitch", "first return", "first return of a pitched array", "sound speed"],
)
def test_each_error_moves_the_echo_its_own_way(
    error: dict[str, float], first_return_sigma_m: float, pitch_rad: float, east_m: float, north_m: float
) -> None:
    """Heading north, level: heading and pitch errors act along track, those of first return and range across (dy =
    -h/y dh, r/y dr)."""
    config = msgspec.structs.replace(NO_ERROR, **error)
    echo = one_echo("starboard", LEVEL_R, LEVEL_H, pitch_rad=pitch_rad)
    covariance = position_covariance(echo, SonarConfig(), config, np.array([first_return_sigma_m]))[0]
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [east_m, north_m], rtol=1e-3, atol=1e-9)


def test_a_course_in_place_of_a_heading_moves_the_echo_along_the_track() -> None:
    config = msgspec.structs.replace(NO_ERROR, heading_sigma_deg=3.0)
    echo = one_echo("starboard", LEVEL_R, LEVEL_H, heading_sigma_rad=math.radians(4.0))
    covariance = position_covariance(echo, SonarConfig(), config, np.zeros(1))[0]
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [0.0, LEVEL_Y * math.sin(math.radians(5.0))], atol=0.02)


def test_covariance_equals_that_of_scattered_measurements() -> None:
    """Monte Carlo through the public position, with every error at once; sampling error of 40 000 draws is 0.7 %."""
    n = 40_000
    rng = np.random.default_rng(11)
    sonar = SonarConfig(lever_arm_m=(1.5, 0.3, 0.5), heading_offset_deg=1.0, pitch_offset_deg=-1.0)
    config = NavigationConfig(
        position_sigma_m=0.4, heading_sigma_deg=1.2, pitch_sigma_deg=0.8, sound_speed_sigma_mps=6.0
    )
    truth = {"heading_rad": 2.2, "pitch_rad": 0.08, "roll_rad": 0.1, "speed_mps": 1.5}
    echo = one_echo("port", 45.0, 9.0, **truth)
    predicted = position_covariance(echo, sonar, config, np.array([0.3]))[0]

    pose = a_pose(n, **truth)
    pose.heading_rad[:] += rng.normal(0.0, math.radians(1.2), n)
    pose.pitch_rad[:] += rng.normal(0.0, math.radians(0.8), n)
    scattered = EchoGeometry(
        side="port",
        pose=pose,
        slant_range_m=45.0 * (1.0 + rng.normal(0.0, 6.0 / 1500.0, n)),
        first_return_m=9.0 + rng.normal(0.0, 0.3, n),
        sound_speed_mps=np.full(n, 1500.0),
    )
    frame = LocalFrame(
        latitude_deg=HOME["latitude_deg"], longitude_deg=HOME["longitude_deg"], height_m=-HOME["depth_m"]
    )
    east_north = frame.to_enu(*locate(scattered, sonar))[:, :2] + rng.normal(0.0, 0.4, (n, 2))
    np.testing.assert_allclose(predicted, np.cov(east_north.T), rtol=0.03, atol=0.01)


def test_covariance_turns_with_the_heading_and_mirrors_with_the_side() -> None:
    config = NavigationConfig()
    north = position_covariance(one_echo("starboard", 50.0, 6.0), SonarConfig(), config, np.array([0.2]))[0]
    turned = position_covariance(
        one_echo("starboard", 50.0, 6.0, heading_rad=0.7), SonarConfig(), config, np.array([0.2])
    )[0]
    mirrored = position_covariance(one_echo("port", 50.0, 6.0), SonarConfig(), config, np.array([0.2]))[0]
    turn = np.array([[math.cos(0.7), math.sin(0.7)], [-math.sin(0.7), math.cos(0.7)]])
    np.testing.assert_allclose(turned, turn @ north @ turn.T, atol=1e-9)
    np.testing.assert_allclose(mirrored, north * [[1.0, -1.0], [-1.0, 1.0]], atol=1e-9)


@pytest.mark.parametrize("slant_range", [5.0, 5.0 + 1e-9, 5.01, 5.5])
def test_covariance_stays_finite_and_positive_towards_nadir(slant_range: float) -> None:
    with np.errstate(all="raise", under="ignore"):
        covariance = position_covariance(
            one_echo("port", slant_range, 5.0), SonarConfig(), NavigationConfig(), np.array([0.1])
        )[0]
    assert np.isfinite(covariance).all()
    assert np.linalg.eigvalsh(covariance).min() >= 1.0 - 1e-12
    assert np.linalg.eigvalsh(covariance).max() < 5.0
