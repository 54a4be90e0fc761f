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
    found = rectangles(alike)
    features = []
    for (north, east, n_north, n_east), ring in zip(found, _rings(clearance, frame, found), strict=True):
        part = slice(north, north + n_north), slice(east, east + n_east)
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

    A rectangle is (first row, first column, rows, columns). Each is grown from its first cell along the row, then as
    many rows up as are alike over its whole width.
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


def _rings(clearance: Clearance, frame: LocalFrame, found: list[tuple[int, int, int, int]]) -> NDArray[np.float64]:
    """Give longitude and latitude of the corners of n rectangles, (n, 5, 2), closed, counter-clockwise."""
    north, east, n_north, n_east = np.array(found, dtype=np.float64).reshape(-1, 4).T
    west, south = (east + clearance.first_east) * clearance.cell_m, (north + clearance.first_north) * clearance.cell_m
    right, top = west + n_east * clearance.cell_m, south + n_north * clearance.cell_m
    corners = [(west, south), (right, south), (right, top), (west, top), (west, south)]
    flat = np.zeros_like(west)
    latitude, longitude, _ = frame.to_geodetic(
        np.stack([np.stack([*corner, flat], axis=-1) for corner in corners], axis=1)
    )
    return np.stack([longitude, latitude], axis=-1)
