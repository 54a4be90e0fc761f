"""Measure plans of survey and second views: how near to the optimum, and in what time.

Tours of few contacts are held to the exact optimum under a budget, survey plans to their own upper bound. Times are
processor time of this process, medians over drawn worlds; on a shared machine they move by half, so each is given as
well in multiples of multiplying two matrices of 400 rows, measured in the same run.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import clearance_over, unsearched
from auv_mcm.clearance.detection_performance import shipped_performance
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.contact_legs import contact_legs
from auv_mcm.plan.dubins import PlanePose, dubins_lengths
from auv_mcm.plan.limits import Limits
from auv_mcm.plan.survey import Plan, SurveyState, replan
from auv_mcm.plan.tour import richest_tour
from auv_mcm.records import SEABED_TYPES, Contact
from sim_replay.arguments import count

_CELL_M: Final = 4.0  # m: side of a cell
_SIDE_CELLS: Final = 45  # 2025 cells
_ORIGIN: Final = LocalFrame(latitude_deg=43.0, longitude_deg=5.0)
START: Final = PlanePose(-20.0, -20.0, 0.3)
_FENCE: Final = np.array([[-80.0, -80.0], [-80.0, 260.0], [260.0, 260.0], [260.0, -80.0]])
LIMITS: Final = Limits(10.0, 6000.0, _FENCE, 6.5, 2.0, (5.0, 40.0))
SEED: Final = 9500  # of the worlds drawn
_REQUIRED: Final = 0.7  # probability of finding a mine in a cell


class _Timed(NamedTuple):
    plan: Plan
    ms: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench tours`."""
    parser.add_argument("--worlds", type=count, default=12, help="worlds drawn per row (default 12)")


def run(arguments: argparse.Namespace) -> int:
    """Print both tables; returns the exit code."""
    yardstick_ms = _yardstick_ms()
    print(f"yardstick: {yardstick_ms:.1f} ms processor time")
    print("\n".join(_tour_rows(arguments.worlds)))
    print()
    print("\n".join(_survey_rows(arguments.worlds, yardstick_ms)))
    return 0


def _tour_rows(n_worlds: int) -> list[str]:
    rows = [
        "second views under a budget, gain as a share of the exact optimum",
        f"{'contacts':>9}{'median':>9}{'worst':>9}{'bound / optimum':>17}",
    ]
    for n_contacts in (3, 5, 7, 9):
        shares, bounds = [], []
        for number in range(n_worlds):
            generator = np.random.Generator(np.random.PCG64([SEED, n_contacts, number]))
            world = drawn_world(generator, n_contacts, is_open=False)
            limits = LIMITS._replace(budget_m=float(generator.uniform(300.0, 2000.0)), fence=None)
            best = optimum_m2(world, limits)
            if best > 0.0:
                plan = replan(world, START, limits, None, _always)
                shares.append(plan.gain_m2 / best)
                bounds.append(plan.bound_m2 / best)
        rows.append(
            f"{n_contacts:>9}{statistics.median(shares):>9.3f}{min(shares):>9.3f}{statistics.median(bounds):>17.2f}"
        )
    return rows


def _survey_rows(n_worlds: int, yardstick_ms: float) -> list[str]:
    rows = [
        (
            f"{_SIDE_CELLS**2} open cells of mixed sea floor in a fence, required {_REQUIRED}; gain as a share of the "
            "upper bound"
        ),
        f"{'contacts':>9}{'time':>9}{'gain':>8}{'track':>9}{'ms':>8}{'yardsticks':>12}",
    ]
    for n_contacts in (0, 10, 40):
        for limit_ms in (0.0, 20.0, 200.0, 1000.0):
            timed = []
            for number in range(n_worlds):
                generator = np.random.Generator(np.random.PCG64([SEED, n_contacts, number]))
                world = drawn_world(generator, n_contacts, is_open=True)
                begun = time.process_time()
                plan = replan(world, START, LIMITS, None, _until(begun + 1e-3 * limit_ms))
                timed.append(_Timed(plan, 1e3 * (time.process_time() - begun)))
            gain = statistics.median(found.plan.gain_m2 / found.plan.bound_m2 for found in timed)
            track_m = statistics.median(found.plan.length_m for found in timed)
            ms = statistics.median(found.ms for found in timed)
            rows.append(
                f"{n_contacts:>9}{limit_ms:>6.0f} ms{gain:>8.3f}{track_m:>7.0f} m{ms:>8.0f}{ms / yardstick_ms:>12.1f}"
            )
    return rows


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


def _yardstick_ms() -> float:
    matrix = np.random.Generator(np.random.PCG64(1)).random((400, 400))
    times = []
    for _ in range(20):
        begun = time.process_time()
        _ = matrix @ matrix
        times.append(1e3 * (time.process_time() - begun))
    return statistics.median(times)


def _until(end_s: float) -> Callable[[], bool]:
    return lambda: time.process_time() < end_s


def _always() -> bool:
    return True
