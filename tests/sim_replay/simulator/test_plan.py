"""Planned legs and places relative to them."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_replay.simulator.plan import Leg, local_frame, place_in_plane, planned_legs, swath_m
from sim_replay.simulator.scene import Lawnmower, Origin, Scene, SceneObject, Spiral, Track, Waypoints

metres = st.floats(-1000.0, 1000.0)


@given(metres, metres, st.floats(-10.0, 10.0), st.floats(1.0, 1000.0), metres, metres)
def test_along_and_across_invert_at(
    east: float, north: float, direction: float, length: float, along: float, across: float
) -> None:
    leg = Leg(east, north, direction, length)
    assert leg.along_across(*leg.at(along, across)) == pytest.approx((along, across), abs=1e-9)


def test_lawnmower_legs_go_there_and_back_to_starboard_of_the_first() -> None:
    legs = planned_legs(Lawnmower(heading_deg=90.0, n_legs=3, leg_m=100.0, spacing_m=30.0))
    starts = [(0.0, 0.0), (100.0, -30.0), (0.0, -60.0)]
    ends = [(100.0, 0.0), (0.0, -30.0), (100.0, -60.0)]
    for leg, start, end in zip(legs, starts, ends, strict=True):
        assert (leg.east_m, leg.north_m) == pytest.approx(start, abs=1e-9)
        assert leg.end == pytest.approx(end, abs=1e-9)


def test_spiral_legs_join_and_grow() -> None:
    legs = planned_legs(Spiral(n_legs=6, first_leg_m=40.0, spacing_m=25.0))
    assert [leg.length_m for leg in legs] == [40.0, 40.0, 65.0, 65.0, 90.0, 90.0]
    for before, after in pairwise(legs):
        assert (after.east_m, after.north_m) == pytest.approx(before.end, abs=1e-9)
        assert after.direction_rad - before.direction_rad == pytest.approx(0.5 * math.pi)


def test_waypoints_are_joined_by_straight_legs() -> None:
    (first, second) = planned_legs(Waypoints(points_m=((0.0, 0.0), (30.0, 40.0), (30.0, -10.0))))
    assert (first.length_m, second.length_m) == (50.0, 50.0)
    assert first.direction_rad == pytest.approx(math.atan2(3.0, 4.0))
    assert abs(second.direction_rad) == pytest.approx(math.pi)


@given(st.floats(-80.0, 80.0), st.floats(-180.0, 180.0), st.floats(-100.0, 100.0), st.floats(5.0, 45.0))
def test_a_place_is_the_same_by_plane_by_leg_and_by_latitude(
    latitude: float, longitude: float, along: float, across: float
) -> None:
    plan = Lawnmower(heading_deg=30.0, n_legs=1, leg_m=200.0)
    scene = Scene(track=Track(plan=plan), origin=Origin(latitude_deg=latitude, longitude_deg=longitude))
    east, north = place_in_plane(scene, SceneObject(kind="rock", leg=0, along_m=along, across_m=across))
    assert place_in_plane(scene, SceneObject(kind="rock", east_m=east, north_m=north)) == (east, north)
    lat, lon, _ = local_frame(scene.origin).to_geodetic([east, north, 0.0])
    by_latitude = place_in_plane(scene, SceneObject(kind="rock", latitude_deg=float(lat), longitude_deg=float(lon)))
    assert by_latitude == pytest.approx((east, north), abs=1e-4)


def test_the_swath_is_the_ground_range_of_the_sonars_reach() -> None:
    assert swath_m(Scene(track=Track(plan=Lawnmower(), altitude_m=30.0))) == pytest.approx(40.0)
