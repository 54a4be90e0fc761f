"""Made-up states of a search, for the tests of the planner."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import clearance_over, unsearched
from auv_mcm.clearance.detection_performance import CellView
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.limits import Limits
from auv_mcm.plan.survey import SurveyState
from auv_mcm.records import SEABED_TYPES, Contact, SeabedType
from tests.auv_mcm.classify import drawn_looks

CELL_M = 4.0
ORIGIN = (43.0, 5.0)
LIMITS = Limits(
    turn_radius_m=10.0,
    budget_m=8000.0,
    fence=None,
    altitude_m=5.0,
    min_altitude_m=2.0,
    swath=(6.0, 50.0),
    settling_m=10.0,
)


class Sonar(NamedTuple):
    """Sure up to 25 m, then less and less; across crests as on flat floor, along them a third as good."""

    highest_p: float = 0.92
    same_look_correlation: float = 0.8
    other_look_correlation: float = 0.1

    def p_look(self, view: CellView) -> NDArray[np.float64]:
        falls = 1.0 - 0.5 * np.maximum(np.asarray(view.ground_range_m, dtype=np.float64) - 25.0, 0.0) / 25.0
        kind = np.array([1.0, 0.9, 0.7, 0.6, 0.8])[np.asarray(view.seabed)]
        ripple_rad = np.asarray(view.ripple_rad)
        towards = np.asarray(view.look_rad) - np.nan_to_num(ripple_rad)
        across = np.where(np.isfinite(ripple_rad), np.abs(np.cos(towards)), 1.0)
        return np.asarray(self.highest_p * falls * kind * (0.3 + 0.7 * across**2))


def world(
    n_north: int = 20,
    n_east: int = 20,
    *,
    seabed: SeabedType = "flat",
    ripple_deg: float = math.nan,
    required: float = 0.9,
    sonar: Sonar | None = None,
    contacts: tuple[Contact, ...] = (),
    first: tuple[int, int] = (0, 0),
    origin_deg: tuple[float, float] = ORIGIN,
) -> SurveyState:
    """An unsearched box, its south-western cell `first` (east, north), all of which must be cleared."""
    clearance = clearance_over(unsearched(*origin_deg, CELL_M), *first, (n_north, n_east))
    clearance.seabed[:] = SEABED_TYPES.index(seabed)
    clearance.ripple_rad[:] = math.radians(ripple_deg)
    return SurveyState(clearance, np.ones((n_north, n_east), dtype=np.bool_), required, sonar or Sonar(), contacts)


def contact(
    number: int,
    east_m: float,
    north_m: float,
    look_deg: float = 90.0,
    p_mine: float = 0.5,
    origin_deg: tuple[float, float] = ORIGIN,
) -> Contact:
    frame = LocalFrame(latitude_deg=origin_deg[0], longitude_deg=origin_deg[1])
    latitude, longitude, _ = frame.to_geodetic([east_m, north_m, 0.0])
    return drawn_looks.contact(
        id=f"C{number:05d}",
        latitude_deg=float(latitude),
        longitude_deg=float(longitude),
        p_mine=p_mine,
        aspects_deg=((look_deg + 90.0) % 360.0,),
        next_look_deg=(look_deg,),
    )
