"""Measure every stage's time against its error, and that of what a user would take instead."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from auv_mcm.plan.survey import replan
from auv_mcm.waterfall.bottom import BottomTracker
from auv_mcm.waterfall.ground import make_traces, mean_between
from sim_replay.augment.floor import recover_floor
from sim_replay.benches.every_stage.cascade_rows import cascade_rows
from sim_replay.benches.every_stage.confirmation_stages import contour_rows, field_rows, random_of, solid_rows
from sim_replay.benches.every_stage.drawn_worlds import LIMITS, SEED, START, drawn_world, optimum_m2
from sim_replay.benches.every_stage.framer_rows import framer_rows
from sim_replay.benches.every_stage.log_reading import log_rows
from sim_replay.benches.every_stage.rows import Other, Row
from sim_replay.benches.every_stage.sea_floor import sea_floor_rows
from sim_replay.benches.every_stage.shadow_ends import shadow_errors_m
from sim_replay.benches.stability.back_rows import back_rows
from sim_replay.benches.stability.confirmation_rows import confirmation_rows
from sim_replay.benches.stability.front_rows import front_rows
from sim_replay.benches.stability.rows import NumberRow

Plane = NDArray[np.float64]


def resampling_rows(n: int) -> list[Row]:
    """Resample pings to ground range: against sums of extended precision; instead, points of np.interp."""
    n_samples, spacing_m = 2000, 0.025
    edges_m = np.hypot(0.12 * np.arange(401), 6.0)
    intensity = random_of(1).exponential(size=(32, n_samples)).astype(np.float32)
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

    def error(found: Plane) -> float:
        return float(np.sqrt(np.mean(np.square(np.asarray(found / truth - 1.0, dtype=np.float64)))))

    setting, unit = "32 pings of 2000 samples to 400 columns", "root mean square over the true mean"
    return [Row("waterfall", setting, ours, error, unit, 1e-9, Other("numpy interp", points))]


def bottom_rows(n: int) -> list[Row]:
    """Track the bottom under faint water; instead, take the first half metre above three times the water column."""
    rows = []
    for floor_db in (20.0, 8.0):
        n_pings, n_samples, spacing_m = 64, 500, 0.04
        random = random_of(2)
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

        setting = f"{n_pings} pings, floor {floor_db:g} dB over the water"
        other = Other("first half metre over 3 times the water", first)
        rows.append(Row("bottom tracking", setting, ours, partial(_off_m, altitude_m), "m, 95 % quantile", 0.3, other))
    return rows


def _off_m(wanted_m: Any, found_m: Any) -> float:
    return float(np.quantile(np.abs(found_m - wanted_m), 0.95))


def simulator_rows(n: int) -> list[Row]:
    """Cast shadows on cells of several sizes; the reference is the closed form."""
    unit = "m, 95 % quantile of shadows' ends"
    return [
        Row(
            "simulator",
            f"cells of {100 * cell_m:g} cm, shadows of 205 objects",
            partial(shadow_errors_m, cell_m),
            partial(_off_m, 0.0),
            unit,
            1.1 * cell_m,
        )
        for cell_m in ((0.1,) if n < 4 else (0.2, 0.1, 0.05))
    ]


def lambert_image(relief_m: Plane, reflectivity: Plane, altitude_m: Plane, row_m: float, column_m: float) -> Plane:
    """Render a floor's mean echo, (n_pings, n_columns): reflectivity times the cosine of incidence, 0 in shadow."""
    ground_m = (np.arange(relief_m.shape[1]) + 0.5) * column_m
    depth_m = altitude_m[:, None] - relief_m
    along, across = np.gradient(relief_m, row_m, column_m)
    facing = np.maximum(depth_m + ground_m * across, 0.0)
    cosine = facing / np.sqrt((ground_m**2 + depth_m**2) * (1.0 + across**2 + along**2))
    sight = -depth_m / ground_m
    return np.asarray(np.where(sight < np.maximum.accumulate(sight, axis=1), 0.0, reflectivity * cosine))


def inversion_rows(n: int) -> list[Row]:
    """Recover relief from an image; the reference is the relief that it was rendered from."""
    shape, column_m = (128, 256), 0.1
    relief = 3.75 * ndimage.gaussian_filter(random_of(9).normal(size=shape), (6, 8), mode="wrap")
    along_m = 0.2 * np.arange(shape[0], dtype=np.float64)
    valid, altitude_m = np.ones(shape, dtype=np.bool_), np.full(shape[0], 6.0)

    def unlike(found: Plane) -> float:
        one, other = (plane - ndimage.uniform_filter1d(plane, 101, axis=1) for plane in (found, relief))
        return 1.0 - float(np.corrcoef(one[:, 50:-50].ravel(), other[:, 50:-50].ravel())[0, 1])

    rows = []
    for floor, spread in (("one reflectivity", 0.0), ("patches of reflectivity", 0.35)):
        patches = ndimage.gaussian_filter(random_of(10).normal(size=shape), 16, mode="wrap")
        mean = lambert_image(relief, np.exp(spread * patches / patches.std()), altitude_m, 0.2, column_m)
        image = mean * random_of(11).gamma(3.0, 1.0 / 3.0, shape)

        def ours(image: Plane = image) -> Plane:
            return recover_floor(image, valid, altitude_m, along_m, column_m).elevation_m

        rows.append(
            Row("inversion", f"128 pings of 256 columns, {floor}", ours, unlike, "1 - correlation of heights", 0.5)
        )
    return rows


def planner_rows(n: int) -> list[Row]:
    """Plan second views under a budget; instead, try every set and order."""
    rows = []
    for n_contacts in (3,) if n < 4 else (3, 5, 7, 9):
        worlds = []
        for number in range(n):
            random = np.random.Generator(np.random.PCG64([SEED, n_contacts, number]))
            world = drawn_world(random, n_contacts, is_open=False)
            worlds.append((world, LIMITS._replace(budget_m=float(random.uniform(300.0, 2000.0)), fence=None)))

        def ours(worlds: list[Any] = worlds) -> list[float]:
            return [replan(world, START, limits, None, lambda: True).gain_m2 for world, limits in worlds]

        def exact(worlds: list[Any] = worlds) -> list[float]:
            return [optimum_m2(world, limits) for world, limits in worlds]

        rows.append(
            Row(
                "planner",
                f"{n_contacts} contacts, {n} worlds",
                ours,
                partial(_not_gained, exact()),
                "of the optimum not gained, worst",
                1e-9,  # rounding
                Other("exact enumeration", exact),
            )
        )
    return rows


def _not_gained(best_m2: list[float], gains_m2: list[float]) -> float:
    return max((1.0 - gain / most for gain, most in zip(gains_m2, best_m2, strict=True) if most > 0.0), default=0.0)


STAGES: Final[dict[str, Callable[[int], list[Row]]]] = {
    "logs": log_rows,
    "waterfall": resampling_rows,
    "bottom": bottom_rows,
    "cascade": cascade_rows,
    "field": field_rows,
    "contours": contour_rows,
    "solids": solid_rows,
    "simulator": simulator_rows,
    "inversion": inversion_rows,
    "sea-floor": sea_floor_rows,
    "planner": planner_rows,
    "framers": framer_rows,
}
"""What declares each stage's rows for a number of inputs, in the order of the chain."""


def every_row() -> list[NumberRow]:
    """List the rows of every numerical stage under stress, in the order of the chain."""
    return [*front_rows(), *confirmation_rows(), *back_rows()]
