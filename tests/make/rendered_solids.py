"""Render solids to starboard with real beam and speckle, two views of each, and class them from either or both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from auv_mcm.classify.evidence import TEMPERATURE
from auv_mcm.classify.fit import SOLIDS, ShapeFit, ShapeFits
from auv_mcm.confirm.region import Region
from auv_mcm.kernels.shape import Solid
from sim_replay.simulator.echo import absorption_db_per_km, bin_ranges_m, flat_floor_intensity, floor_tables
from sim_replay.simulator.scene import STEADY, Lawnmower, Scene, SceneObject, Sonar, Track, World
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.speckle import gaussian_taps, row_keys, speckle_rows
from sim_replay.simulator.vehicle import SonarPose

CORRELATION_AREA: Final = 1.8  # pixels, of regions rendered here (measured)
_N_ROWS: Final = 61  # pings, 9 m along the track: twice the longest object and its surroundings
_COLUMN_M: Final = 0.06  # m, of the default grid
_BEFORE_M: Final = 3.0  # m of sea floor before the object
_SPEED_MPS, _PING_RATE_HZ = 1.8, 12.0  # usual of a survey: a ping every 15 cm
_SONAR: Final = Sonar(range_m=60.0, n_samples=1229, ping_rate_hz=_PING_RATE_HZ)
"""5 cm samples out to 60 m."""
_ALTITUDE_M: Final = 6.0  # m, usual of a survey
_ALTITUDE_ERROR: Final = 0.1  # relative, the largest: what an altimeter over soft floor errs by (chosen)
_SHADOW: Final = 0.1  # of the floor: -10 dB


class DrawnSolid(NamedTuple):
    """Hold one object and its views 90 degrees apart."""

    solid: Solid
    ground_range_m: float
    views: tuple[Region, Region]


def best_class(views: Sequence[ShapeFits]) -> Solid | None:
    """Return the class of minimum cost over all views, sizes weighed as beliefs do.

    A class that some view does not show at all is out. None if none is left.
    """
    total = {
        solid: math.fsum(
            min((_weighed(fit) for fit in fits.fits if fit.solid == solid), default=math.inf) for fits in views
        )
        for solid in SOLIDS
    }
    best = min(total, key=lambda solid: total[solid])
    return best if total[best] < math.inf else None


def _weighed(fit: ShapeFit) -> float:
    return fit.best.cost - TEMPERATURE * math.log(max(fit.plausibility, 1e-9))


def draw_object(solid: Solid, seed: int) -> DrawnSolid:
    """Draw an object of usual size, scaled by up to 15 %, at 10 to 45 m, and render it from two sides.

    The altitudes of its views are up to 10 % wrong.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    range_m, azimuth_deg = float(random.uniform(10.0, 45.0)), float(random.uniform(0.0, 360.0))
    scale, long, error = (
        float(random.uniform(0.85, 1.15)),
        float(random.uniform(0.8, 1.2)),
        float(random.uniform(-1.0, 1.0)),
    )
    size: dict[str, Any]
    match solid:
        case "sphere":
            size = {"width_m": 0.8 * scale}
        case "cylinder":
            size = {"width_m": 0.53 * scale, "length_m": 2.0 * long}
        case "truncated_cone":
            size = {"width_m": 0.98 * scale, "height_m": 0.47 * scale}
        case "wedge":
            size = {"length_m": 1.02 * scale, "width_m": 0.8 * scale, "height_m": 0.385 * scale}
    scene_object = SceneObject(kind=solid, east_m=range_m, north_m=0.0, azimuth_deg=azimuth_deg, **size)
    turned = SceneObject(kind=solid, east_m=range_m, north_m=0.0, azimuth_deg=azimuth_deg + 90.0, **size)
    views = (
        rendered_region(scene_object, 2 * seed, altitude_error=_ALTITUDE_ERROR * error),
        rendered_region(turned, 2 * seed + 1, altitude_error=-_ALTITUDE_ERROR * error),
    )
    return DrawnSolid(solid, range_m, views)


def rendered_region(scene_object: SceneObject, seed: int, *, altitude_error: float = 0.0) -> Region:
    """Render an object to starboard with real beam and speckle, shadows at -10 dB of the floor.

    altitude_error: of the altitude with which ground range is made, relative.
    """
    assert scene_object.east_m is not None
    world = World(relief_rms_m=0.02)
    track = Track(plan=Lawnmower(), speed_mps=_SPEED_MPS, altitude_m=_ALTITUDE_M, motion=STEADY)
    sea = Sea(Scene(seed=seed, world=world, sonar=_SONAR, track=track, objects=(scene_object,)))
    row_m = _SPEED_MPS / _PING_RATE_HZ
    ahead = 0.618 * seed % 1.0 - 0.5  # pings do not fall on the object's middle
    depth_m = world.depth_m - sea.world.floor_m(scene_object.east_m, 0.0) - _ALTITUDE_M
    poses = [
        SonarPose(
            i / _PING_RATE_HZ, 0.0, (i - _N_ROWS // 2 + ahead) * row_m, depth_m, 0.0, 0.0, 0.0, 0.0, _SPEED_MPS, 0
        )
        for i in range(_N_ROWS)
    ]
    absorption = absorption_db_per_km(_SONAR, world.depth_m)
    table = floor_tables(sea.scene, sea.world.covers)[0]
    floor = flat_floor_intensity(bin_ranges_m(_SONAR), _ALTITUDE_M, table, _SONAR, absorption)
    energy = sea.mean_intensity(poses)[:, 1] / np.maximum(floor, 1e-6 * floor.max()) + _SHADOW
    bin_m = _SONAR.range_m / _SONAR.n_samples
    speckled = speckle_rows(energy, row_keys(seed, [1], 0, _N_ROWS), gaussian_taps(_SONAR.range_resolution_m / bin_m))
    reported_m = _ALTITUDE_M * (1.0 + altitude_error)
    first_m = scene_object.east_m - _BEFORE_M
    n_columns = round((_BEFORE_M + 4.0 + 0.13 * scene_object.east_m) / _COLUMN_M)
    edges = np.hypot(first_m + _COLUMN_M * np.arange(n_columns + 1), reported_m) / bin_m
    sums = np.concatenate((np.zeros((_N_ROWS, 1)), np.cumsum(speckled, axis=1, dtype=np.float64)), axis=1)
    left = edges.astype(np.intp)
    up_to = sums[:, left] + (sums[:, left + 1] - sums[:, left]) * (edges - left)
    foremost_m = scene_object.east_m - 0.2 - 0.3 * _ALTITUDE_M / scene_object.east_m
    intensity = np.diff(up_to, axis=1) / np.diff(edges)
    return Region(
        intensity=intensity,
        valid=np.ones(intensity.shape, dtype=np.bool_),
        row_spacing_m=row_m,
        column_spacing_m=_COLUMN_M,
        first_ground_range_m=first_m,
        altitude_m=reported_m,
        row=0.5 * _N_ROWS - ahead,
        column=(foremost_m - first_m) / _COLUMN_M,
        beam_width_rad=math.radians(_SONAR.beam_width_deg),
    )
