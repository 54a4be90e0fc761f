"""The chart for single points is the same projection as the arrays' local frame, everywhere on Earth."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.geometry.geodesy import LocalFrame
from drivers.vehicle.plane import LocalPlane, Point, distance_to_line_m

LATITUDES = st.floats(-90.0, 90.0)
LONGITUDES = st.floats(-180.0, 180.0)
OFFSETS_M = st.floats(-20_000.0, 20_000.0)


@given(LATITUDES, LONGITUDES, OFFSETS_M, OFFSETS_M)
def test_points_are_those_of_the_local_frame(
    latitude_deg: float, longitude_deg: float, east_m: float, north_m: float
) -> None:
    frame = LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    latitude, longitude, _ = frame.to_geodetic([east_m, north_m, 0.0])
    wanted = frame.to_enu(latitude, longitude, 0.0)[:2].tolist()
    assert LocalPlane(latitude_deg, longitude_deg).point(float(latitude), float(longitude)) == pytest.approx(
        wanted, abs=1e-6
    )


@given(LATITUDES, LONGITUDES, OFFSETS_M, OFFSETS_M, st.floats(0.0, 2.0 * math.pi, exclude_max=True))
def test_a_true_heading_is_a_step_on_the_chart_and_back(
    latitude_deg: float, longitude_deg: float, east_m: float, north_m: float, heading_rad: float
) -> None:
    frame = LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    latitude, longitude, _ = (float(value) for value in frame.to_geodetic([east_m, north_m, 0.0]))
    plane = LocalPlane(latitude_deg, longitude_deg)
    step = plane.direction(latitude, longitude, heading_rad)
    ahead = LocalFrame(latitude_deg=latitude, longitude_deg=longitude).to_geodetic(
        [math.sin(heading_rad), math.cos(heading_rad), 0.0]
    )
    there, here = plane.point(float(ahead[0]), float(ahead[1])), plane.point(latitude, longitude)
    assert step == pytest.approx((there.east_m - here.east_m, there.north_m - here.north_m), abs=1e-5)
    back_rad = plane.true_heading_rad(latitude, longitude, math.atan2(*step))
    assert 0.0 <= back_rad < 2.0 * math.pi
    assert abs(math.remainder(back_rad - heading_rad, 2.0 * math.pi)) < 1e-4


def test_what_is_far_away_has_no_place_on_the_chart() -> None:
    assert all(map(math.isnan, LocalPlane(45.0, 10.0).point(-45.0, -170.0)))
    assert all(map(math.isnan, LocalPlane(45.0, 10.0).point(math.nan, 10.0)))
    assert all(map(math.isnan, LocalPlane(45.0, 10.0).point(10.0, math.inf)))


def test_a_line_of_no_length_is_its_point() -> None:
    assert distance_to_line_m(Point(3.0, 4.0), Point(0.0, 0.0), Point(0.0, 0.0)) == 5.0
    assert distance_to_line_m(Point(3.0, 4.0), Point(0.0, 0.0), Point(10.0, 0.0)) == 4.0
