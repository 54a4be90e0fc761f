"""Draw worlds with contacts to look at again, and the optimum of a plan through them."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import clearance_over, unsearched
from auv_mcm.clearance.detection_performance import shipped_performance
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.contact_legs import contact_legs
from auv_mcm.plan.dubins import PlanePose, dubins_lengths
from auv_mcm.plan.limits import Limits
from auv_mcm.plan.survey import SurveyState
from auv_mcm.plan.tour import richest_tour
from auv_mcm.records import SEABED_TYPES, Contact

_CELL_M: Final = 4.0  # m: side of a cell
_SIDE_CELLS: Final = 45  # 2025 cells
_ORIGIN: Final = LocalFrame(latitude_deg=43.0, longitude_deg=5.0)
START: Final = PlanePose(-20.0, -20.0, 0.3)
_FENCE: Final = np.array([[-80.0, -80.0], [-80.0, 260.0], [260.0, 260.0], [260.0, -80.0]])
LIMITS: Final = Limits(10.0, 6000.0, _FENCE, 6.5, 2.0, (5.0, 40.0))
SEED: Final = 9500  # of the worlds drawn
_REQUIRED: Final = 0.7  # probability of finding a mine in a cell


def drawn_world(generator: np.random.Generator, n_contacts: int, is_open: bool) -> SurveyState:
    """Draw a square whose eastern part is rippled, and contacts strewn over it."""
    clearance = clearance_over(
        unsearched(_ORIGIN.latitude_deg, _ORIGIN.longitude_deg, _CELL_M), 0, 0, (_SIDE_CELLS, _SIDE_CELLS)
    )
    clearance.seabed[:] = SEABED_TYPES.index("flat")
    edge = int(generator.integers(0, _SIDE_CELLS))
    clearance.seabed[:, edge:] = SEABED_TYPES.index("ripple")
    clearance.ripple_rad[:, edge:] = generator.uniform(0.0, math.pi)
    if not is_open:
        clearance.exponent[:] = math.inf
    places = generator.uniform(0.0, _SIDE_CELLS * _CELL_M, (n_contacts, 2))
    latitude, longitude, _ = _ORIGIN.to_geodetic(np.column_stack([places, np.zeros(n_contacts)]))
    contacts = tuple(
        _contact(
            f"C{k:05d}",
            float(latitude[k]),
            float(longitude[k]),
            generator.uniform(0.1, 0.9),
            generator.uniform(0.0, 180.0),
        )
        for k in range(n_contacts)
    )
    return SurveyState(
        clearance, np.ones(clearance.looks.shape, dtype=np.bool_), _REQUIRED, shipped_performance(), contacts
    )


def _contact(name: str, latitude_deg: float, longitude_deg: float, p_mine: float, look_deg: float) -> Contact:
    return Contact(
        id=name,
        time_s=0.0,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        covariance_m2=np.eye(2),
        p_mine=p_mine,
        classification="unknown",
        belief={},
        length_m=math.nan,
        width_m=math.nan,
        height_m=math.nan,
        aspects_deg=((look_deg + 90.0) % 360.0,),
        reasons=(),
        views=(),
        next_look_deg=(look_deg,),
    )


def optimum_m2(world: SurveyState, limits: Limits) -> float:
    """Compute the maximum that views can gain, by exact tours through every set of contacts."""
    looks = contact_legs(world.contacts, world.clearance, world.performance, limits)
    if not looks:
        return 0.0
    back = np.array([0.0, 0.0, math.pi])
    ways = [
        way for look in looks for entry, leave in look.runs for way in ((entry, leave), (leave + back, entry + back))
    ]
    entries, exits = np.array([entry for entry, _ in ways]), np.array([START, *(leave for _, leave in ways)])
    runs_m: NDArray[np.float64] = np.hypot(*(exits[1:] - entries)[:, :2].T)
    cost = dubins_lengths(exits[:, np.newaxis], entries[np.newaxis], limits.turn_radius_m / math.cos(math.radians(7.5)))
    worth = np.array([look.gain_m2 for look in looks])
    return float(sum(worth[way // 4] for way in richest_tour(cost, runs_m, worth, limits.budget_m)))
