"""Poles, the antimeridian, odd numbers: geodesy raises no floating-point flag and loses no micrometre."""

from __future__ import annotations

import numpy as np

from auv_mcm.geometry.geodesy import ecef_to_geodetic, geodetic_to_ecef, wrap_longitude_deg


def test_nan_stays_nan_and_spoils_no_neighbour() -> None:
    latitude = np.array([10.0, np.nan, 10.0])
    with np.errstate(all="raise", under="ignore"):
        ecef = geodetic_to_ecef(latitude, 20.0, -5.0)
        back = ecef_to_geodetic(ecef)
    assert np.isnan(back[0]).tolist() == [False, True, False]
    np.testing.assert_allclose(back[0][[0, 2]], 10.0)
    assert np.isnan(wrap_longitude_deg(np.nan))
