"""Poles, the antimeridian, odd numbers: geodesy raises no floating-point flag and loses no micrometre."""

from __future__ import annotations

import numpy as np
import pytest

from auv_mcm.geometry.geodesy import LocalFrame, ecef_to_geodetic, geodetic_to_ecef, wrap_longitude_deg


def test_a_dense_sweep_of_the_globe_round_trips() -> None:
    latitude, longitude, height = np.meshgrid(
        np.concatenate((np.linspace(-90.0, 90.0, 61), [-89.9999, 89.9999, -1e-12, 1e-12])),
        np.concatenate((np.linspace(-180.0, 180.0, 49), [-179.999999999, 179.999999999])),
        [-11_000.0, -50.0, 0.0, 1_000.0],
        indexing="ij",
    )
    with np.errstate(all="raise", under="ignore"):
        there = geodetic_to_ecef(latitude, longitude, height)
        back = ecef_to_geodetic(there)
    assert np.linalg.norm(geodetic_to_ecef(*back) - there, axis=-1).max() < 1e-6
    assert np.abs(back[2] - height).max() < 1e-6
    assert back[1].min() >= -180.0
    assert back[1].max() < 180.0


@pytest.mark.parametrize("latitude", [89.9999, -89.9999, 90.0, -90.0, 89.0])
def test_a_survey_across_a_pole_keeps_its_shape(latitude: float) -> None:
    """A 2 km square around the frame's origin, which encloses the pole: sides and diagonals survive latitude and
    longitude."""
    frame = LocalFrame(latitude_deg=latitude, longitude_deg=123.0)
    square = np.array(
        [
            [-1000.0, -1000.0, 0.0],
            [1000.0, -1000.0, 0.0],
            [1000.0, 1000.0, 0.0],
            [-1000.0, 1000.0, 0.0],
            [0.0, 0.0, 0.0],
        ]
    )
    with np.errstate(all="raise", under="ignore"):
        ecef = geodetic_to_ecef(*frame.to_geodetic(square))
    for i in range(5):
        for j in range(i):
            expected = np.linalg.norm(square[i] - square[j])
            assert np.linalg.norm(ecef[i] - ecef[j]) == pytest.approx(expected, abs=1e-6)


def test_rounding_of_a_survey_is_far_below_single_precision() -> None:
    """In single precision, steps of 1 mm at the far side of the Earth vanish; here they stay to the micrometre."""
    frame = LocalFrame(latitude_deg=-89.0, longitude_deg=-179.999, height_m=-4000.0)
    steps = np.stack((np.arange(1000) * 1e-3, np.arange(1000) * -1e-3, np.zeros(1000)), axis=-1)
    np.testing.assert_allclose(
        np.diff(frame.to_enu(*frame.to_geodetic(steps)), axis=0), np.diff(steps, axis=0), rtol=0, atol=1e-8
    )


def test_nan_stays_nan_and_spoils_no_neighbour() -> None:
    latitude = np.array([10.0, np.nan, 10.0])
    with np.errstate(all="raise", under="ignore"):
        ecef = geodetic_to_ecef(latitude, 20.0, -5.0)
        back = ecef_to_geodetic(ecef)
    assert np.isnan(back[0]).tolist() == [False, True, False]
    np.testing.assert_allclose(back[0][[0, 2]], 10.0)
    assert np.isnan(wrap_longitude_deg(np.nan))
