"""Lay out the area that is to be cleared as cells of the mission's plane, and state how its search stands.

Its clearance is the mean over its cells of the probability that a mine there would have been found: the expected share
of mines found where they may lie anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import Clearance, clearance_over, unsearched
from auv_mcm.geometry.fence import circles_inside
from auv_mcm.geometry.geodesy import LocalFrame


class Area(NamedTuple):
    """Hold an area in cells.

    ground: the clearance over a box around the area. cells: bool, of its shape, those whose middles lie in the area;
    one or more.
    """

    ground: Clearance
    cells: NDArray[np.bool_]

    @property
    def frame(self) -> LocalFrame:
        """Give the plane that the cells lie in."""
        return frame_of(self.ground)


class AreaState(NamedTuple):
    """Hold how the search of the area stands.

    p_detected: its clearance. share: of its cells, those with `required` or more each.

    verdict: "" while it is under way; else "done: ...", "cannot, because ...", or "not yet, because ...".
    """

    km2: float
    required: float
    p_detected: float
    share: float
    verdict: str = ""

    @property
    def is_reached(self) -> bool:
        """Find whether the clearance is as required."""
        return self.p_detected >= self.required

    def words(self) -> str:
        """State the clearance in a few words, rounded down so that it never reads as reached when it is not."""
        required = required_words(self.required)
        n_digits = len(required.partition(".")[2])
        p_detected = math.floor(10.0**n_digits * self.p_detected + 1e-9) / 10.0**n_digits
        return f"clearance {p_detected:.{n_digits}f} of {required}" + " reached" * self.is_reached


def required_words(required: float) -> str:
    """Write a required clearance with all its digits, two or more."""
    return max(f"{required:.2f}", f"{required:g}", key=len)


def frame_of(clearance: Clearance) -> LocalFrame:
    """Give the plane that a clearance's cells lie in."""
    return LocalFrame(latitude_deg=clearance.origin_latitude_deg, longitude_deg=clearance.origin_longitude_deg)


def in_plane(places_deg: Sequence[tuple[float, float]], plane: LocalFrame) -> NDArray[np.float64]:
    """Project n latitudes and longitudes to (n, 2) east and north, m."""
    latitude_deg, longitude_deg = np.array(places_deg, dtype=np.float64).reshape(-1, 2).T
    return plane.to_enu(latitude_deg, longitude_deg, np.zeros_like(latitude_deg))[:, :2]


def over_area(clearance: Clearance | None, corners_deg: Sequence[tuple[float, float]], cell_m: float) -> Area:
    """Lay out the area in cells.

    Before any survey (None) the cells lie in a plane of the area's own, cell_m wide.

    corners_deg: three or more latitudes and longitudes in order.
    """
    known = clearance or unsearched(*corners_deg[0], cell_m)
    corners = in_plane(corners_deg, frame_of(known))
    first = np.floor(corners.min(axis=0) / known.cell_m).astype(int)
    n_east, n_north = (np.floor(corners.max(axis=0) / known.cell_m).astype(int) - first + 1).tolist()
    ground = clearance_over(known, int(first[0]), int(first[1]), (n_north, n_east))
    cells = circles_inside(middles_m(ground), 0.0, corners, 0.0)
    if not cells.any():  # smaller than a cell: the one that its middle lies in
        column, row = (np.floor(corners.mean(axis=0) / known.cell_m).astype(int) - first).tolist()
        cells[row, column] = True
    return Area(ground, cells)


def middles_m(ground: Clearance) -> NDArray[np.float64]:
    """Compute east and north of the middles of cells, (n_north, n_east, 2), m."""
    n_north, n_east = ground.looks.shape
    east = (ground.first_east + np.arange(n_east) + 0.5) * ground.cell_m
    north = (ground.first_north + np.arange(n_north) + 0.5) * ground.cell_m
    return np.stack(np.meshgrid(east, north), axis=-1)


def area_state(area: Area, required: float) -> AreaState:
    """Summarise how the search of the area stands."""
    p = area.ground.p_detected[area.cells]
    return AreaState(
        km2=p.size * area.ground.cell_m**2 * 1e-6,
        required=required,
        p_detected=float(p.mean()),
        share=float(np.mean(p >= required)),
    )
