from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.geometry.geodesy import (
    LocalFrame,
    ecef_to_geodetic,
    geodetic_to_ecef,
    local_to_ecef_rotation,
    wrap_longitude_deg,
)

latitudes = st.one_of(st.floats(-90.0, 90.0), st.sampled_from([-90.0, -89.9999999, 0.0, 89.9999999, 90.0]))
longitudes = st.one_of(st.floats(-180.0, 180.0), st.sampled_from([-180.0, -179.9999999, 0.0, 179.9999999, 180.0]))
heights = st.floats(-11_000.0, 1_000.0)


@given(latitudes, longitudes, heights)
def test_earth_centred_round_trip_is_better_than_a_micrometre(latitude: float, longitude: float, height: float) -> None:
    there = geodetic_to_ecef(latitude, longitude, height)
    back = ecef_to_geodetic(there)
    assert np.linalg.norm(geodetic_to_ecef(*back) - there) < 1e-6
    assert abs(back[2] - height) < 1e-6
    assert abs(back[0] - latitude) * 111_000.0 < 1e-6
    assert -180.0 <= back[1] < 180.0


def test_known_points() -> None:
    np.testing.assert_allclose(geodetic_to_ecef(0.0, 0.0, 0.0), [6378137.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(geodetic_to_ecef(90.0, 0.0, 0.0), [0.0, 0.0, 6356752.314245], atol=1e-6)
    # Equator to pole along the meridian of 90 degrees east, and a height of 1 km added outward.
    np.testing.assert_allclose(geodetic_to_ecef(0.0, 90.0, 1000.0), [0.0, 6379137.0, 0.0], atol=1e-9)
    # Defining relation of the ellipsoid, at a place with no symmetry.
    x, y, z = geodetic_to_ecef(47.3, 12.9, 0.0)
    assert (x * x + y * y) / 6378137.0**2 + z * z / 6356752.314245179**2 == pytest.approx(1.0, abs=1e-14)


@given(latitudes, longitudes)
def test_up_is_the_outward_normal_and_axes_are_right_handed(latitude: float, longitude: float) -> None:
    rotation = local_to_ecef_rotation(latitude, longitude)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    rise = geodetic_to_ecef(latitude, longitude, 100.0) - geodetic_to_ecef(latitude, longitude, 0.0)
    np.testing.assert_allclose(rotation[:, 2], rise / 100.0, atol=1e-9)
    assert rotation[2, 0] == 0.0  # east is level with the equator
    assert rotation[2, 1] >= 0.0  # north rises towards the pole


def test_a_degree_of_latitude_is_as_long_as_the_meridian_says() -> None:
    """Meridian radius a (1 - e^2) / (1 - e^2 sin^2 lat)^1.5 against a metre-sized step."""
    for latitude in (0.0, 30.0, 60.0, 85.0):
        step_deg = 1e-5
        e2 = 6.69437999014e-3
        radius = 6378137.0 * (1 - e2) / (1 - e2 * math.sin(math.radians(latitude)) ** 2) ** 1.5
        east, north, up = LocalFrame(latitude_deg=latitude, longitude_deg=7.0).to_enu(latitude + step_deg, 7.0, 0.0)
        assert north == pytest.approx(radius * math.radians(step_deg), rel=1e-6)
        assert abs(east) < 1e-9
        assert abs(up) < 1e-6


@given(latitudes, longitudes, st.floats(-5000.0, 5000.0), st.floats(-5000.0, 5000.0), st.floats(-500.0, 500.0))
def test_local_round_trip(latitude: float, longitude: float, east: float, north: float, up: float) -> None:
    frame = LocalFrame(latitude_deg=latitude, longitude_deg=longitude, height_m=-30.0)
    enu = np.array([east, north, up])
    np.testing.assert_allclose(frame.to_enu(*frame.to_geodetic(enu)), enu, rtol=0, atol=1e-6)


def test_local_coordinates_are_continuous_over_the_antimeridian() -> None:
    frame = LocalFrame(latitude_deg=-17.0, longitude_deg=179.99)
    enu = np.stack((np.linspace(-5000.0, 5000.0, 101), np.zeros(101), np.zeros(101)), axis=-1)
    latitude, longitude, height = frame.to_geodetic(enu)
    assert longitude.min() < -179.0
    assert longitude.max() > 179.0
    np.testing.assert_allclose(frame.to_enu(latitude, longitude, height), enu, rtol=0, atol=1e-6)
    np.testing.assert_allclose(frame.to_enu(latitude, longitude + 360.0, height), enu, rtol=0, atol=1e-6)


def test_shapes_broadcast() -> None:
    assert geodetic_to_ecef(np.zeros((4, 1)), np.zeros(5), 0.0).shape == (4, 5, 3)
    assert local_to_ecef_rotation(np.zeros((4, 1)), np.zeros(5)).shape == (4, 5, 3, 3)
    assert ecef_to_geodetic(np.ones((2, 3, 3)) * 4e6)[0].shape == (2, 3)


@pytest.mark.parametrize(
    ("longitude", "expected"),
    [(180.0, -180.0), (-180.0, -180.0), (360.0, 0.0), (539.5, 179.5), (-180.5, 179.5), (0.1, 0.1), (-1e-17, -1e-17)],
)
def test_longitudes_wrap(longitude: float, expected: float) -> None:
    assert wrap_longitude_deg(longitude) == expected


@given(st.floats(-1e6, 1e6))
def test_wrapped_longitudes_stay_inside_and_on_the_same_meridian(longitude: float) -> None:
    wrapped = float(wrap_longitude_deg(longitude))
    assert -180.0 <= wrapped < 180.0
    assert math.remainder(wrapped - longitude, 360.0) == pytest.approx(0.0, abs=1e-9)
