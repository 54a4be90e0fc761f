"""Points of the waterfall lie where plain geometry puts them, and sizes are those of the scene."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from auv_mcm.geometry.shadow import shadow_height_m
from auv_mcm.settings.config import SonarConfig
from sim_replay.view.places import WaterfallPoint, measure_length, measure_shadow, place_points
from sim_replay.view.waterfall_store import WaterfallStore
from tests.sim_replay.view.shown_missions import ALTITUDE_M, DEPTH_M, HOME, ROW_M, filled_store, tile

SONAR = SonarConfig()
STORE = filled_store(256, 64)


@given(row=st.floats(1.0, 255.0), across_m=st.floats(-60.0, 60.0))
def test_a_point_abeam_of_a_northbound_vehicle_lies_east_or_west_of_it(row: float, across_m: float) -> None:
    places = place_points(STORE, SONAR, [WaterfallPoint(row, across_m)])
    east_m, north_m, _ = HOME.to_enu(places.latitude_deg, places.longitude_deg, 0.0)[0]
    assert east_m == pytest.approx(across_m, abs=0.01)
    assert north_m == pytest.approx(row * ROW_M, abs=0.01)
    assert places.depth_m[0] == pytest.approx(DEPTH_M + ALTITUDE_M, abs=0.01)
    assert places.slant_range_m[0] == pytest.approx(math.hypot(across_m, ALTITUDE_M))
    assert places.altitude_m[0] == pytest.approx(ALTITUDE_M)


def test_a_length_is_the_distance_over_the_sea_floor() -> None:
    ends = [WaterfallPoint(100.0, 20.0), WaterfallPoint(110.0, 20.9)]
    measured = measure_length(STORE, SONAR, ends)
    assert measured.length_m == pytest.approx(math.hypot(10.0 * ROW_M, 0.9), abs=0.005)
    assert math.isnan(measured.height_m)


@given(height_m=st.floats(0.05, 2.0), top_m=st.floats(2.0, 40.0), port=st.booleans())
def test_a_shadow_gives_the_height_that_threw_it(height_m: float, top_m: float, port: bool) -> None:
    # Oracle: the ray from the sonar over an edge at ground range y and height h meets the floor at y H / (H - h); the
    # edge itself appears at the ground range of its slant range.
    edge_m = top_m
    slant_m = math.hypot(edge_m, ALTITUDE_M - height_m)
    if slant_m <= ALTITUDE_M:
        return
    shown_m = math.sqrt(slant_m**2 - ALTITUDE_M**2)
    end_m = edge_m * ALTITUDE_M / (ALTITUDE_M - height_m)
    sign = -1.0 if port else 1.0
    measured = measure_shadow(STORE, [WaterfallPoint(90.0, sign * end_m), WaterfallPoint(90.0, sign * shown_m)])
    assert measured.height_m == pytest.approx(height_m, abs=1e-6)
    assert measured.length_m == pytest.approx(end_m - shown_m)


def test_a_point_goes_by_the_first_return_of_its_own_row_and_a_shadow_by_that_half_way() -> None:
    store, returns_m = WaterfallStore(), 5.0 + 0.02 * np.arange(256)
    returns_m[200] = np.nan
    flat = tile("port", 0, np.ones((256, 64), dtype=np.float32))
    store.add(structs.replace(flat, first_return_m=returns_m))
    points = [WaterfallPoint(100.25, -7.0), WaterfallPoint(200.75, -7.0)]
    places = place_points(store, SonarConfig(pitch_offset_deg=10.0), points)
    expected_m = np.array([5.0 + 0.02 * 99.75, returns_m[201]])
    assert places.slant_range_m == pytest.approx(np.hypot(7.0, expected_m))
    assert places.altitude_m == pytest.approx(expected_m * math.cos(math.radians(10.0)))
    ends = [WaterfallPoint(10.0, -8.0), WaterfallPoint(90.0, -12.0)]
    assert measure_shadow(store, ends).height_m == pytest.approx(shadow_height_m(returns_m[50], 8.0, 12.0))


def test_a_shadow_does_not_cross_the_track() -> None:
    measured = measure_shadow(STORE, [WaterfallPoint(90.0, -5.0), WaterfallPoint(90.0, 7.0)])
    assert math.isnan(measured.height_m)


def test_no_shadow_means_no_height() -> None:
    assert shadow_height_m(5.0, 10.0, 10.0) == 0.0
    assert shadow_height_m(5.0, 11.0, 10.0) < 0.0
    assert math.isnan(shadow_height_m(math.nan, 10.0, 11.0))


def test_rows_without_pings_have_no_place() -> None:
    store = WaterfallStore()
    for first_row in (0, 640):
        store.add(tile("starboard", first_row, np.ones((64, 64), dtype=np.float32)))
    places = place_points(store, SONAR, [WaterfallPoint(300.0, 5.0), WaterfallPoint(20.0, 5.0)])
    assert np.isnan(places.latitude_deg[0])
    assert places.stale.tolist() == [True, False]
    assert np.isfinite(places.latitude_deg[1])
