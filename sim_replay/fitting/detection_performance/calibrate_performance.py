"""Make the tables of performance: missions flown over targets, the outcome of each look, the fit, and the tables in
print.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from auv_mcm.clearance.detection_performance import FLOORS, Band, Performance
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.detection_performance.looks import CellPass, looks_of
from sim_replay.fitting.detection_performance.performance_missions import target_scene
from sim_replay.fitting.theatre import USUAL, Theatre
from sim_replay.text_tables import columns

FIT_SEEDS: Final = range(800, 816)
FLIGHTS: Final = 3  # over each scene, on other tracks
_SWEEP_STEP_M: Final = 0.25  # m: step of the integral over range


class Flight(NamedTuple):
    """Name a mission by its seed and its number over the scene."""

    seed: int
    number: int


def fly_scene(flight: Flight, theatre: Theatre = USUAL) -> list[CellPass]:
    """Return every look of one mission."""
    return looks_of(target_scene(flight.seed, flight.number), theatre)


def fly_all(
    seeds: Iterable[int], flights: int, farm: Farm, progress: Callable[[int, int], None], theatre: Theatre = USUAL
) -> list[list[CellPass]]:
    """Return looks by mission, `flights` of each seed, in that order.

    Parameters
    ----------
    progress
        Takes the missions done and all there are.
    theatre
        Whose sonars and payload.
    """
    tasks = [Flight(seed, number) for seed in seeds for number in range(flights)]
    return list(run_tasks(partial(fly_scene, theatre=theatre), tasks, farm, lambda done: progress(done, len(tasks))))


def performance_fit_words(seeds: range, flights: int, looks: Sequence[CellPass]) -> str:
    """Describe the missions that tables were fitted on."""
    n_missions, n_targets = len({look.mission for look in looks}), len({(look.mission, look.target) for look in looks})
    return (
        f"{len(looks)} looks at {n_targets} targets in {n_missions} simulated missions: seeds {seeds[0]} to "
        f"{seeds[-1]}, {flights} each"
    )


def tables(performance: Performance) -> str:
    """Format probability, interval and looks per floor and band, and the sweep width of one side."""
    edges = performance.edges_m
    header = ["floor", *(f"{near:g}-{far:g} m" for near, far in pairwise(edges)), "sweep width"]
    rows = [
        [floor.replace("_", ", "), *(_cell(band) for band in performance.floors[floor]), f"{width_m:.1f} m"]
        for floor, width_m in zip(FLOORS, sweep_widths_m(performance), strict=True)
    ]
    return columns(header, rows)


def sweep_widths_m(performance: Performance) -> list[float]:
    """Return the sweep width per floor of FLOORS, of one side, at the reference altitude and over all bands."""
    range_m = np.arange(0.0, performance.edges_m[-1] + _SWEEP_STEP_M, _SWEEP_STEP_M)
    altitude_m = performance.altitude_m
    return [float(np.trapezoid(p, range_m)) for p in performance.p_by_floor(range_m, altitude_m)]


def _cell(band: Band) -> str:
    return f"{band.p:.2f} ({band.low:.2f}-{band.high:.2f}) {band.n_looks}"
