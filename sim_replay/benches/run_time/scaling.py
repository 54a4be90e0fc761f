"""Measure how the chain's cost grows with swath width, ping rate, objects, mission length and threads, with fitted
exponents."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from sim_replay.benches.run_time.lines import FIRST_SEED, BenchMission, fly_scene
from sim_replay.benches.run_time.measure import MissionCost, measure_settings
from sim_replay.benches.run_time.points import default_point
from sim_replay.simulator.scene import Lawnmower, Scatter, Scene
from sim_replay.simulator.scene_file import read_scene

SERIES_HEADER: Final = (
    "against",
    "values",
    "chain s",
    "exponent of processor time",
    "elapsed s",
    "exponent of elapsed time",
)
_SCENE: Final = "flat"
_RANGE_M: Final = 50.0  # m, while something else is varied
_SAMPLES_PER_M: Final = 20.0  # per trace
_PING_RATE_HZ: Final = 7.0  # the highest for a range of 100 m
_OBJECTS_PER_KM2: Final = 1000.0  # while something else is varied
_LEG_M: Final = 120.0  # m


class ScalingVariant(NamedTuple):
    """Describe one mission of a series. range_m: of the sonar to either side; leg_m: length of its only leg."""

    range_m: float = _RANGE_M
    ping_rate_hz: float = _PING_RATE_HZ
    objects_per_km2: float = _OBJECTS_PER_KM2
    leg_m: float = _LEG_M
    threads: int = 1


class ScalingStep(msgspec.Struct, frozen=True, kw_only=True):
    """Hold one value of a series, and medians of what it cost, s."""

    value: float
    chain_s: float
    elapsed_s: float


class ScalingSeries(msgspec.Struct, frozen=True, kw_only=True):
    """Hold how cost grows with one quantity."""

    against: str
    steps: tuple[ScalingStep, ...]


def scaling_variants() -> dict[str, list[tuple[float, ScalingVariant]]]:
    """List the missions of every series by the value of what they differ in."""
    return {
        "swath width, m": [(2.0 * range_m, ScalingVariant(range_m=range_m)) for range_m in (25.0, 50.0, 100.0)],
        "ping rate, Hz": [(rate_hz, ScalingVariant(ping_rate_hz=rate_hz)) for rate_hz in (3.5, 7.0, 14.0)],
        "objects per km²": [(per_km2, ScalingVariant(objects_per_km2=per_km2)) for per_km2 in (250.0, 1000.0, 4000.0)],
        "mission length, m": [(leg_m, ScalingVariant(leg_m=leg_m)) for leg_m in (60.0, 120.0, 240.0)],
        "threads": [(float(threads), ScalingVariant(threads=threads)) for threads in (1, 2, 4)],
    }


def scene_of(variant: ScalingVariant) -> Scene:
    """Change the flat scene to a variant: one leg, rocks of a mine's size as its only objects."""
    scene = read_scene(_SCENE)
    assert isinstance(scene.track.plan, Lawnmower)
    n_rocks = max(1, round(variant.objects_per_km2 * 2.0 * variant.range_m * variant.leg_m * 1e-6))
    return msgspec.structs.replace(
        scene,
        seed=FIRST_SEED,
        scatter=(Scatter(kind="rock", count=n_rocks, apart_m=2.0),),
        sonar=msgspec.structs.replace(
            scene.sonar,
            range_m=variant.range_m,
            n_samples=round(variant.range_m * _SAMPLES_PER_M),
            ping_rate_hz=variant.ping_rate_hz,
        ),
        track=msgspec.structs.replace(
            scene.track, plan=msgspec.structs.replace(scene.track.plan, n_legs=1, leg_m=variant.leg_m)
        ),
    )


def measure_series(repeat: int, folder: Path, progress: Callable[[str], None]) -> list[ScalingSeries]:
    """Fly every mission once and run the default operating point on it."""
    flown: dict[ScalingVariant, BenchMission] = {}
    costs: dict[ScalingVariant, MissionCost] = {}
    for some in scaling_variants().values():
        for _, variant in some:
            bare = variant._replace(threads=1)
            if bare not in flown:
                progress(f"flying {bare}")
                flown[bare] = fly_scene(scene_of(bare), f"variant {len(flown)}", _SCENE, folder)
            if variant not in costs:
                line = flown[bare]
                costs[variant] = measure_settings([default_point()], [line], repeat, folder, progress, variant.threads)[
                    0
                ].runs[line.name]
    return [
        ScalingSeries(
            against=against,
            steps=tuple(
                ScalingStep(
                    value=value,
                    chain_s=statistics.median(costs[variant].chain_s),
                    elapsed_s=statistics.median(costs[variant].elapsed_s),
                )
                for value, variant in some
            ),
        )
        for against, some in scaling_variants().items()
    ]


def fitted_exponent(values: Sequence[float], costs_s: Sequence[float]) -> tuple[float, float]:
    """Fit cost = constant * value ** exponent by least squares of logarithms; the exponent and its standard error."""
    x, y = np.log(values), np.log(costs_s)
    x = x - x.mean()
    slope = float(x @ y / (x @ x))
    residual = y - y.mean() - slope * x
    return slope, float(np.sqrt(residual @ residual / max(len(x) - 2, 1) / (x @ x)))


def series_rows(found: Sequence[ScalingSeries]) -> list[list[str]]:
    """Write a row of text per series."""
    rows = []
    for one in found:
        values = [step.value for step in one.steps]
        row = [one.against, ", ".join(f"{value:g}" for value in values)]
        for costs_s in ([step.chain_s for step in one.steps], [step.elapsed_s for step in one.steps]):
            slope, error = fitted_exponent(values, costs_s)
            row += [", ".join(f"{cost_s:.2f}" for cost_s in costs_s), f"{slope:.2f} ± {error:.2f}"]
        rows.append(row)
    return rows
