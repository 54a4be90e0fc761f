"""Measure every stage's time against its error, and that of what a user would take instead."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from auv_mcm.plan.survey import replan
from auv_mcm.waterfall.bottom import BottomTracker
from auv_mcm.waterfall.ground import make_traces, mean_between
from sim_replay.augment.direct import invert
from sim_replay.augment.forward import BeamPattern, SeafloorScene, render_image
from sim_replay.benches.every_stage.cascade_rows import cascade_rows
from sim_replay.benches.every_stage.confirmation_curves import contour_curve_rows, field_curve_rows, solid_curve_rows
from sim_replay.benches.every_stage.confirmation_stages import contour_rows, field_rows, solid_rows
from sim_replay.benches.every_stage.drawn_worlds import LIMITS, SEED, START, drawn_world, optimum_m2
from sim_replay.benches.every_stage.framer_rows import framer_rows
from sim_replay.benches.every_stage.log_reading import log_rows
from sim_replay.benches.every_stage.rows import Alternative, Amount, StageRow, timed
from sim_replay.benches.every_stage.sea_floor import sea_floor_rows
from sim_replay.benches.every_stage.shadow_ends import shadow_errors_m

Plane = NDArray[np.float64]


def _random(*seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(list(seed)))


def resampling_rows(amount: Amount) -> list[StageRow]:
    """Resample pings to ground range: against sums of extended precision; instead, points of np.interp."""
    n_samples, spacing_m = 2000, 0.025
    edges_m = np.hypot(0.12 * np.arange(401), 6.0)
    intensity = _random(1).exponential(size=(32, n_samples)).astype(np.float32)
    yes, no = np.ones(intensity.shape, dtype=np.bool_), np.zeros(intensity.shape, dtype=np.bool_)
    centre_m = (np.arange(n_samples) + 0.5) * spacing_m

    def ours() -> Plane:
        return mean_between(make_traces(intensity, yes, no, 0.5 * spacing_m, spacing_m), edges_m[np.newaxis]).intensity

    def points() -> Plane:
        return np.array([np.interp(0.5 * (edges_m[1:] + edges_m[:-1]), centre_m, ping) for ping in intensity])

    sums = np.concatenate([np.zeros((32, 1)), np.cumsum(intensity, axis=1, dtype=np.longdouble)], axis=1)
    place = np.clip(edges_m / spacing_m, 0.0, n_samples)
    whole = np.minimum(place.astype(np.intp), n_samples - 1)
    reached = sums[:, whole] + (place - whole) * (sums[:, whole + 1] - sums[:, whole])
    truth = np.diff(reached, axis=1) / np.diff(place)
    (mean, cost), (point, other) = timed(amount.repeat, ours, points)

    def error(found: Plane) -> float:
        return float(np.sqrt(np.mean(np.square(np.asarray(found / truth - 1.0, dtype=np.float64)))))

    return [
        StageRow(
            stage="waterfall",
            setting="32 pings of 2000 samples to 400 columns",
            cost=cost,
            error=error(mean),
            unit="root mean square over the true mean",
            limit=1e-9,
            alternative=Alternative(name="numpy interp", cost=other, error=error(point)),
        )
    ]


def bottom_rows(amount: Amount) -> list[StageRow]:
    """Track the bottom under faint water; instead, take the first half metre above three times the water column."""
    rows = []
    for floor_db in (20.0, 8.0):
        n_pings, n_samples, spacing_m = 64, 500, 0.04
        random = _random(2)
        altitude_m = 6.0 + np.sin(np.arange(n_pings) / 20.0)
        slant_m = (np.arange(n_samples) + 0.5) * spacing_m
        mean = np.where(slant_m < altitude_m[:, np.newaxis], 1.0, 10.0 ** (0.1 * floor_db) * (6.0 / slant_m) ** 2)
        intensity = (mean * random.exponential(size=mean.shape)).astype(np.float32)
        yes, no = np.ones(mean.shape, dtype=np.bool_), np.zeros(mean.shape, dtype=np.bool_)

        def ours(intensity: NDArray[np.float32] = intensity, yes: Any = yes, no: Any = no) -> Plane:
            tracker = BottomTracker(1.0)
            traces = make_traces(intensity, yes, no, 0.02, 0.04)
            tracker.add([traces, None], np.full(len(intensity), math.nan), 20.0)
            found = tracker.flush()
            assert found is not None
            return found.first_return_m

        def first(intensity: NDArray[np.float32] = intensity, slant_m: Any = slant_m) -> Plane:
            smooth = ndimage.uniform_filter1d(intensity, 12, axis=1)  # over half a metre
            water = smooth[:, 25:75].mean()  # 1 to 3 m
            return np.asarray(slant_m[25 + (smooth[:, 25:] > 3.0 * water).argmax(axis=1)])

        (tracked, cost), (crossed, other) = timed(amount.repeat, ours, first)
        rows.append(
            StageRow(
                stage="bottom tracking",
                setting=f"{n_pings} pings, floor {floor_db:g} dB over the water",
                cost=cost,
                error=float(np.quantile(np.abs(tracked - altitude_m), 0.95)),
                unit="m, 95 % quantile",
                limit=0.3,
                alternative=Alternative(
                    name="first half metre over 3 times the water",
                    cost=other,
                    error=float(np.quantile(np.abs(crossed - altitude_m), 0.95)),
                ),
            )
        )
    return rows


def simulator_rows(amount: Amount) -> list[StageRow]:
    """Cast shadows on cells of several sizes; the reference is the closed form."""
    rows = []
    for cell_m in (0.1,) if amount.n < 4 else (0.2, 0.1, 0.05):
        ((errors, cost),) = timed(amount.repeat, lambda cell_m=cell_m: shadow_errors_m(cell_m))  # type: ignore[misc]  # a default is its type
        rows.append(
            StageRow(
                stage="simulator",
                setting=f"cells of {100 * cell_m:g} cm, shadows of 205 objects",
                cost=cost,
                error=float(np.quantile(np.abs(errors), 0.95)),
                unit="m, 95 % quantile of shadows' ends",
                limit=1.1 * cell_m,
            )
        )
    return rows


def inversion_rows(amount: Amount) -> list[StageRow]:
    """Recover relief from an image; instead, add brightness up along each ping."""
    shape, column_m = (128, 256), 0.1
    relief = 3.75 * ndimage.gaussian_filter(_random(9).normal(size=shape), (6, 8), mode="wrap")
    along_m = 0.2 * np.arange(shape[0], dtype=np.float64)
    valid, altitude_m = np.ones(shape, dtype=np.bool_), np.full(shape[0], 6.0)

    def unlike(found: Plane) -> float:
        one, other = (plane - ndimage.uniform_filter1d(plane, 101, axis=1) for plane in (found, relief))
        return 1.0 - float(np.corrcoef(one[:, 50:-50].ravel(), other[:, 50:-50].ravel())[0, 1])

    rows = []
    for floor, spread in (("one reflectivity", 0.0), ("patches of reflectivity", 0.35)):
        patches = ndimage.gaussian_filter(_random(10).normal(size=shape), 16, mode="wrap")
        scene = SeafloorScene(
            elevation_m=relief,
            reflectivity=np.exp(spread * patches / patches.std()),
            beam=BeamPattern(depression_rad=np.array([0.05, 1.5]), gain=np.ones(2)),
            altitude_m=altitude_m,
            along_m=along_m,
            column_spacing_m=column_m,
            valid=valid,
        )
        image = render_image(scene).intensity * _random(11).gamma(3.0, 1.0 / 3.0, shape)

        def ours(image: Plane = image) -> Plane:
            return invert(image, valid, altitude_m, along_m, column_m).elevation_m

        def added(image: Plane = image) -> Plane:
            return np.cumsum(image / ndimage.uniform_filter(image, (1, 101)) - 1.0, axis=1) * column_m

        (heights, cost), (sums, other) = timed(amount.repeat, ours, added)
        rows.append(
            StageRow(
                stage="inversion",
                setting=f"128 pings of 256 columns, {floor}",
                cost=cost,
                error=unlike(heights),
                unit="1 - correlation of heights",
                limit=0.5,
                alternative=Alternative(name="brightness added up", cost=other, error=unlike(sums)),
            )
        )
    return rows


def planner_rows(amount: Amount) -> list[StageRow]:
    """Plan second views under a budget; instead, try every set and order."""
    rows = []
    for n_contacts in (3,) if amount.n < 4 else (3, 5, 7, 9):
        worlds = []
        for number in range(amount.n):
            random = np.random.Generator(np.random.PCG64([SEED, n_contacts, number]))
            world = drawn_world(random, n_contacts, is_open=False)
            worlds.append((world, LIMITS._replace(budget_m=float(random.uniform(300.0, 2000.0)), fence=None)))

        def ours(worlds: list[Any] = worlds) -> list[float]:
            return [replan(world, START, limits, None, lambda: True).gain_m2 for world, limits in worlds]

        def exact(worlds: list[Any] = worlds) -> list[float]:
            return [optimum_m2(world, limits) for world, limits in worlds]

        (gains, cost), (best, other) = timed(min(amount.repeat, 3), ours, exact)
        shares = [1.0 - gain / most for gain, most in zip(gains, best, strict=True) if most > 0.0]
        rows.append(
            StageRow(
                stage="planner",
                setting=f"{n_contacts} contacts, {amount.n} worlds",
                cost=cost,
                error=max(shares, default=0.0),
                unit="of the optimum not gained, worst",
                limit=1e-9,  # rounding
                alternative=Alternative(name="exact enumeration", cost=other, error=0.0),
            )
        )
    return rows


STAGES: Final[dict[str, Callable[[Amount], list[StageRow]]]] = {
    "logs": log_rows,
    "waterfall": resampling_rows,
    "bottom": bottom_rows,
    "cascade": cascade_rows,
    "field": lambda amount: [*field_rows(amount), *field_curve_rows(amount)],
    "contours": lambda amount: [*contour_rows(amount), *contour_curve_rows(amount)],
    "solids": lambda amount: [*solid_rows(amount), *solid_curve_rows(amount)],
    "simulator": simulator_rows,
    "inversion": inversion_rows,
    "sea-floor": sea_floor_rows,
    "planner": planner_rows,
    "framers": framer_rows,
}
"""What measures each stage, in the order of the chain."""
