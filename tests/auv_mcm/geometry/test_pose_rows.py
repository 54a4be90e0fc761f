"""Poses between the rows of a track."""

from __future__ import annotations

import math

import numpy as np
import pytest

from auv_mcm.geometry.geodesy import LocalFrame, geodetic_to_ecef
from auv_mcm.geometry.navigation import NavBuffer
from auv_mcm.geometry.pose_track import interpolate_track
from auv_mcm.records import NAN, PoseTrack
from auv_mcm.settings.config import NavigationConfig
from tests.auv_mcm.geometry.nav_samples import POSE_FIELDS, START_S, east_north, only


def a_track(**columns: list[float]) -> PoseTrack:
    n = len(next(iter(columns.values())))
    arrays = {name: np.zeros(n) for name in (*POSE_FIELDS, "time_s") if name != "stale"}
    arrays.update({name: np.array(column) for name, column in columns.items()})
    return PoseTrack(**arrays, stale=np.zeros(n, dtype=np.bool_))


def test_rows_are_blended_linearly_and_held_at_the_ends() -> None:
    plain = {name: [1.0, 2.0, 4.0] for name in POSE_FIELDS if name not in ("latitude_deg", "longitude_deg", "stale")}
    track = a_track(**{**plain, "time_s": [10.0, 11.0, 13.0], "heading_rad": [6.2, 6.4, 6.4]})
    blended = interpolate_track(track, np.array([-1.0, 0.0, 0.25, 1.5, 2.0, 9.0]))
    np.testing.assert_allclose(blended.time_s, [10.0, 10.0, 10.25, 12.0, 13.0, 13.0])
    np.testing.assert_allclose(blended.heading_rad, [6.2, 6.2, 6.25, 6.4, 6.4, 6.4])
    for name in plain.keys() - {"heading_rad"}:
        np.testing.assert_allclose(getattr(blended, name), [1.0, 1.0, 1.25, 3.0, 4.0, 4.0], err_msg=name)


@pytest.mark.parametrize(("latitude", "longitude"), [(10.0, 179.99999), (89.99999, 45.0), (-89.0, -180.0)])
def test_positions_between_rows_lie_on_the_line_anywhere(latitude: float, longitude: float) -> None:
    frame = LocalFrame(latitude_deg=latitude, longitude_deg=longitude)
    enu = np.array([[-3.0, 1.0, 0.0], [3.0, 1.0, 0.0], [5.0, 7.0, 0.0]])
    lat, lon, _ = frame.to_geodetic(enu)
    blended = interpolate_track(
        a_track(latitude_deg=list(lat), longitude_deg=list(lon)), np.array([0.0, 0.5, 0.75, 1.5])
    )
    np.testing.assert_allclose(
        east_north(blended, frame), np.array([[-3.0, 1.0], [0.0, 1.0], [1.5, 1.0], [4.0, 4.0]]), rtol=0, atol=1e-6
    )
    assert (blended.longitude_deg < 180.0).all()


def test_an_unknown_row_does_not_spoil_its_neighbour() -> None:
    track = a_track(latitude_deg=[1.0, NAN, 3.0], longitude_deg=[4.0, NAN, 6.0], depth_m=[NAN, 2.0, NAN])
    with np.errstate(all="raise", under="ignore"):
        blended = interpolate_track(track, np.array([0.0, 0.7, 1.0, 1.2]))
    np.testing.assert_allclose(blended.latitude_deg, [1.0, 1.0, 3.0, 3.0])
    np.testing.assert_allclose(blended.depth_m, [2.0, 2.0, 2.0, 2.0])


def test_a_blend_with_a_stale_row_is_stale() -> None:
    track = a_track(time_s=[0.0, 1.0, 2.0])
    track.stale[1] = True
    assert interpolate_track(track, np.array([0.0, 0.1, 1.0, 1.9, 2.0])).stale.tolist() == [
        False,
        True,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize("rows", [[NAN], [math.inf]])
def test_rows_that_are_not_numbers_are_refused(rows: list[float]) -> None:
    with pytest.raises(ValueError, match="finite row indices"):
        interpolate_track(a_track(time_s=[0.0, 1.0]), np.array(rows))
    with pytest.raises(ValueError, match="at least one row"):
        interpolate_track(a_track(time_s=[]), np.array([0.0]))


def test_bad_numbers_raise_no_floating_point_flag() -> None:
    rng = np.random.default_rng(2)
    buffer = NavBuffer(NavigationConfig())
    with np.errstate(all="raise", under="ignore"):
        for i in range(300):
            values = dict.fromkeys(("latitude_deg", "longitude_deg", "heading_rad", "pitch_rad", "depth_m"), 0.5)
            values["speed_mps"] = 0.2  # as of a vehicle that stands
            values = {
                name: value if rng.random() > 0.2 else float(rng.choice([NAN, math.inf, 0.0, 1e308]))
                for name, value in values.items()
            }
            buffer.add(only(0.1 * i, **values))
        track = buffer.interpolate(START_S + np.array([-math.inf, -5.0, 0.0, 3.0, 29.0, 99.0, math.inf, NAN]))
    assert track.stale[[0, 1, 5, 6, 7]].all()
    inside = geodetic_to_ecef(track.latitude_deg[2:5], track.longitude_deg[2:5], 0.0) - geodetic_to_ecef(0.5, 0.5, 0.0)
    assert np.abs(inside).max() < 1e-6
