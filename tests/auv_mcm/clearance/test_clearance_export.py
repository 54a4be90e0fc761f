"""The map of clearance as a file that others read."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_export import BANDS, band_of, clearance_geojson, rectangles
from auv_mcm.geometry.geodesy import LocalFrame
from tests.make.records import clearance_of


@given(values=arrays(np.int64, array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.integers(-1, 2)))
def test_rectangles_hold_every_cell_once_and_nothing_else(values: NDArray[np.int64]) -> None:
    n_held = np.zeros(values.shape, dtype=int)
    for row, column, height, width in rectangles(values):
        part = values[row : row + height, column : column + width]
        assert part.shape == (height, width)
        assert (part == part[0, 0]).all()
        n_held[row : row + height, column : column + width] += 1
    assert np.array_equal(n_held, values >= 0)


def test_the_map_shows_where_what_was_found_with_which_probability() -> None:
    reported = json.loads(clearance_geojson(clearance_of([[0.1, 0.1, 0.93]] * 2, first_east=-2, first_north=3)))
    low, high = reported["features"]
    assert low["properties"] == {"seabed": "flat", "p_low": 0.0, "p_high": 0.25, "p_mean": 0.1, "cells": 4, "m2": 64.0}
    assert high["properties"]["p_low"] == 0.9
    ring = np.array(low["geometry"]["coordinates"][0])
    place = LocalFrame(latitude_deg=43.0, longitude_deg=5.0).to_enu(ring[:, 1], ring[:, 0], 0.0)[:, :2]
    assert place == pytest.approx(np.array([[-8, 12], [0, 12], [0, 20], [-8, 20], [-8, 12]], dtype=float), abs=1e-3)


def test_what_was_not_seen_is_left_out() -> None:
    assert json.loads(clearance_geojson(None))["features"] == []
    half = clearance_of([[0.5] * 3], cell_m=2.0, looks=np.array([[1, 0, 2]], dtype=np.uint8))
    reported = json.loads(clearance_geojson(half))
    assert [(each["properties"]["cells"], each["properties"]["m2"]) for each in reported["features"]] == [(1, 4.0)] * 2


def test_a_map_across_the_antimeridian_is_cut_there() -> None:
    reported = json.loads(
        clearance_geojson(clearance_of(np.full((2, 9), 0.5), first_east=-2, origin_longitude_deg=180.0))
    )
    assert reported["features"][0]["geometry"]["type"] == "MultiPolygon"


def test_every_probability_has_its_band() -> None:
    assert band_of(np.array([0.0, 0.25, 0.8999, 0.9, 0.98, 1.0])).tolist() == [0, 1, 3, 4, 5, 5]
    assert BANDS[0] == 0.0
