"""Draw the mean pictures of mines and of rocks of a mine's size, alone on flat sand, from two aspects."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_replay.simulator.aperture import Aperture
from sim_replay.simulator.objects import USUAL, PlacedObject
from sim_replay.simulator.plan import planned_legs
from sim_replay.simulator.scene import (
    STEADY,
    Lawnmower,
    ObjectKind,
    Scene,
    SceneObject,
    Seabed,
    Sonar,
    SyntheticAperture,
    Track,
    World,
)
from sim_replay.simulator.sea import Sea

Floats = NDArray[np.float64]

MINES: Final[tuple[ObjectKind, ...]] = ("cylinder", "sphere", "truncated_cone", "wedge")
FINE_M: Final = 0.015  # m: the finest pixel asked about
ASPECTS_DEG: Final = (0.0, 90.0)
"""Turns of an object between the two pictures, degrees."""

_RANGE_M: Final = 18.0  # m, ground range of objects
_PLACE: Final[dict[str, Any]] = {"east_m": _RANGE_M, "north_m": 2.5}  # m: the middle of the track
_ALTITUDE_M: Final = 9.0  # m above the floor: 27 degrees of grazing, a shadow twice as long as an object is high
_LEG_M: Final = 5.0  # m of track: the longest object and floor on both sides
_REACH_M: Final = 24.0  # m, slant: beyond the longest shadow
_BEFORE_M: Final = 1.6  # m of slant range that a picture begins before its object
_KHZ: Final = 2500.0  # takes 1.1 degrees of integration for FINE_M, so that shadows are sharp
_SCALE: Final = (0.75, 1.25)  # of the usual sizes of mines
_ROCK_LENGTH_M: Final = (0.6, 2.2)  # m: from the smallest sphere to the longest cylinder
_ROCK_WIDTH_M: Final = (0.4, 1.1)  # m, likewise
_ROCK_HEIGHT_M: Final = (0.3, 0.9)  # m, likewise


class Pictured(NamedTuple):
    """Hold an object and its mean pictures, (2 aspects, rows, columns), the floor's echo midway in range being 1."""

    kind: ObjectKind
    means: Floats


class Floor:
    """Know a flat floor of sand, and draw what lies on it: the same floor each time."""

    def __init__(self) -> None:
        scene = Scene(
            seed=1,
            world=World(depth_m=30.0, relief_rms_m=0.0, seabeds=(Seabed(type="sand", relief_rms_m=0.0),), cell_m=0.02),
            objects=tuple(SceneObject(kind=kind, **_PLACE) for kind in (*MINES, "rock")),
            sonar=Sonar(
                frequency_khz=_KHZ,
                range_m=_REACH_M,
                n_samples=round(_REACH_M / FINE_M),
                absorption_db_per_km=70.0,  # of 300 kHz: it must not decide on the noise
                noise_db=-15.0,
                synthetic_aperture=SyntheticAperture(
                    along_track_resolution_m=FINE_M,
                    range_resolution_m=FINE_M,
                    pixels_per_resolution=1.0,
                    sub_apertures=1,
                ),
            ),
            track=Track(plan=Lawnmower(n_legs=1, leg_m=_LEG_M), altitude_m=_ALTITUDE_M, motion=STEADY),
        )
        self._sea = Sea(scene)
        self._usual = {one.kind: one for one in self._sea.objects}

    def bare(self) -> Floats:
        """Draw the mean picture of the floor, (rows, columns)."""
        return self._mean(())

    def pictured(self, kind: ObjectKind, strength_db: float, seed: int) -> Pictured:
        """Draw one object from both aspects; the seed decides on its size, shape and direction."""
        random = np.random.Generator(np.random.PCG64(seed))
        sizes = _sizes(kind, random)
        azimuth_rad = float(random.uniform(0.0, 2.0 * math.pi))
        one = self._usual[kind]._replace(**sizes, strength_db=strength_db, seed=seed)
        views = [
            self._mean((one._replace(azimuth_rad=azimuth_rad + math.radians(turn_deg)),)) for turn_deg in ASPECTS_DEG
        ]
        return Pictured(kind, np.stack(views))

    def _mean(self, objects: tuple[PlacedObject, ...]) -> Floats:
        sea = self._sea.with_objects(objects)
        aperture = Aperture(sea)
        strip = aperture.strip(planned_legs(sea.scene.track.plan)[0], 0)
        whole = (aperture.mean_intensity(strip, 0, strip.n_lines, "full") + sea.noise)[:, 1] / sea.reference
        first = round((math.hypot(_RANGE_M, _ALTITUDE_M) - _BEFORE_M) / FINE_M)
        return np.asarray(whole[:, first:], dtype=np.float64)


def _sizes(kind: ObjectKind, random: np.random.Generator) -> dict[str, Any]:
    """Draw length, width and height, m, as an object of the simulator has them."""
    if kind == "rock":
        limits = {"length_m": _ROCK_LENGTH_M, "width_m": _ROCK_WIDTH_M, "height_m": _ROCK_HEIGHT_M}
        return {name: float(random.uniform(*between)) for name, between in limits.items()}
    usual = USUAL[kind]
    scale, length_scale = random.uniform(*_SCALE, 2).tolist()
    return {
        "length_m": usual.length_m * (length_scale if kind == "cylinder" else scale),
        "width_m": usual.width_m * scale,
        "height_m": usual.height_m * scale,
        "top_m": usual.top_m * scale,
    }
