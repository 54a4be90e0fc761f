"""Export clearance as GeoJSON: rectangles of equal cells, so that a map of thousands of cells stays small."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.contacts.antimeridian import split_ring
from auv_mcm.contacts.geojson import PROBABILITY_DIGITS, Json, collection, feature, one_or_multi, positions_of, rounded
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import SEABED_TYPES

BANDS: Final = (0.0, 0.25, 0.5, 0.75, 0.9, 0.95, 1.0)
"""Edges of the bands of probability that cells are reported in."""


def band_of(p_detected: NDArray[np.float64]) -> NDArray[np.int64]:
    """Find the band of each probability; band i is [BANDS[i], BANDS[i + 1]), the last one with its end."""
    return np.clip(np.searchsorted(BANDS, p_detected, side="right") - 1, 0, len(BANDS) - 2)


def clearance_geojson(clearance: Clearance | None) -> bytes:
    """Write a FeatureCollection of rectangles of seen cells.

    The cells of a rectangle have the same kind of sea floor and lie in the same band of `p_detected`.

    Properties: seabed; p_low and p_high, the band's ends; p_mean over its cells; cells, their number; m2. From
    south-west to north-east.
    """
    if clearance is None:
        return collection([])
    p, band = clearance.p_detected, band_of(clearance.p_detected)
    alike = np.where(clearance.seen, band * len(SEABED_TYPES) + clearance.seabed, -1)
    frame = LocalFrame(latitude_deg=clearance.origin_latitude_deg, longitude_deg=clearance.origin_longitude_deg)
    features = []
    for north, east, n_north, n_east in rectangles(alike):
        part = slice(north, north + n_north), slice(east, east + n_east)
        ring = _ring(clearance, frame, north, east, n_north, n_east)
        polygons: list[Json] = [[positions_of(piece)] for piece in split_ring(ring)]
        number = int(band[north, east])
        properties: dict[str, Json] = {
            "seabed": SEABED_TYPES[int(clearance.seabed[north, east])],
            "p_low": BANDS[number],
            "p_high": BANDS[number + 1],
            "p_mean": rounded(float(p[part].mean()), PROBABILITY_DIGITS),
            "cells": n_north * n_east,
            "m2": rounded(n_north * n_east * clearance.cell_m**2, 1),
        }
        features.append(feature(one_or_multi("Polygon", polygons), properties))
    return collection(features)


def rectangles(values: NDArray[np.int64]) -> list[tuple[int, int, int, int]]:
    """Cover every cell with a value of 0 or more once by rectangles of equal values.

    A rectangle is (first row, first column, rows, columns).

    Each is grown from its first cell along the row, then as many rows up as are alike over its whole width.
    """
    left = values >= 0
    found = []
    for row, column in zip(*np.nonzero(left), strict=True):
        if not left[row, column]:
            continue
        ahead = (values[row, column:] == values[row, column]) & left[row, column:]
        width = len(ahead) if ahead.all() else int(np.argmin(ahead))
        above = (
            (values[row:, column : column + width] == values[row, column]) & left[row:, column : column + width]
        ).all(axis=1)
        height = len(above) if above.all() else int(np.argmin(above))
        left[row : row + height, column : column + width] = False
        found.append((int(row), int(column), height, width))
    return found


def _ring(
    clearance: Clearance, frame: LocalFrame, north: int, east: int, n_north: int, n_east: int
) -> NDArray[np.float64]:
    """Give longitude and latitude of a rectangle's corners, closed, counter-clockwise."""
    low = np.array([east + clearance.first_east, north + clearance.first_north]) * clearance.cell_m
    high = low + np.array([n_east, n_north]) * clearance.cell_m
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1]), (low[0], low[1])]
    latitude, longitude, _ = frame.to_geodetic([(*corner, 0.0) for corner in corners])
    return np.column_stack([longitude, latitude])
