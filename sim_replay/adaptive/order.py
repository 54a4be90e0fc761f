"""Draw an order and its world: an area of mixed sea floor with mines and stones in it, all from a seed."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.plan.limits import Limits
from auv_mcm.settings.config import Config, WaterfallConfig
from sim_replay.simulator.plan import swath_m
from sim_replay.simulator.scene import (
    Lawnmower,
    Motion,
    NavigationError,
    ObjectKind,
    Ripples,
    SampleRecorder,
    Scene,
    SceneObject,
    Seabed,
    Sonar,
    Track,
    World,
)

SIDE_M: Final = 120.0  # m: side of the square searched; one flight takes minutes of processor time
REQUIRED: Final = 0.6  # probability that a mine lying there would have been found

_MARGIN_M: Final = 60.0  # of sea room around the area
_BUDGET_M: Final = 4000.0  # m of track
_APART_M: Final = 8.0  # m between objects, minimum: no contact can belong to two
_MINES_PER_KIND_M2: Final = 1.0 / 2400.0  # per m²: six of each kind in the usual square
_TURN_RATE_DEG_S: Final = 12.0  # degrees per second, of a usual survey vehicle
_RUN_IN_M: Final = 30.0  # before the area, where the vehicle starts
_FIRST_LEG_M: Final = 18.0  # inside the area's western edge
_TRIES: Final = 20_000  # places drawn before the square counts as full
_STREAM: Final = 0x41444150  # "ADAP": its own stream of random numbers
_UNCLIPPED: Final = SampleRecorder(samples="amplitude_float32")  # levels differ by 20 dB from one sea floor to the next
_MINE_KINDS: Final[tuple[ObjectKind, ...]] = ("cylinder", "sphere", "truncated_cone", "wedge", "box")


class Order(NamedTuple):
    """Order a square to be cleared until mines in it are found with probability `required`.

    It reaches from 0 to side_m east and north of the scene's origin.

    budget_m: length of track at most. fence: (n, 2) corners, east and north, which the vehicle never leaves.
    """

    side_m: float
    required: float
    budget_m: float
    fence: NDArray[np.float64]


def usual_order(side_m: float = SIDE_M, required: float = REQUIRED, budget_m: float = _BUDGET_M) -> Order:
    """Return an area with sea room around it."""
    low, high = -_MARGIN_M, side_m + _MARGIN_M
    return Order(side_m, required, budget_m, np.array([(low, low), (high, low), (high, high), (low, high)]))


def drawn_scene(seed: int, side_m: float = SIDE_M) -> Scene:
    """Draw a world around the ordered area, with the vehicle about to enter it northwards near its western edge.

    A mine of each kind per 2400 square metres and as many rocks as mines lie in the area, sizes, strengths and burial
    as in the scenes that rates are taken on. The shares of the kinds of sea floor differ from seed to seed (Dirichlet
    with parameter 1 of four groups). The track's own plan, a lawnmower, is there to be replaced. Raises UsageError if
    the area has no room for them.
    """
    rng = np.random.Generator(np.random.PCG64([seed, _STREAM]))
    wavelength_m = float(rng.uniform(0.7, 1.5))
    ripples = Ripples(
        wavelength_m=wavelength_m,
        height_m=float(rng.uniform(0.09, 0.15)) * wavelength_m,
        direction_deg=float(rng.uniform(0.0, 180.0)),
        defects=float(rng.uniform(0.1, 0.5)),
    )
    flat, rippled, rough, grown = (0.05 + rng.dirichlet(np.ones(4))).tolist()
    seabeds = (
        Seabed(type="sand", share=0.6 * flat),
        Seabed(type="mud", share=0.4 * flat),
        Seabed(type="rippled_sand", share=rippled, ripples=ripples),
        Seabed(type="boulder_field", share=0.3 * rough, stones_per_ha=300.0),
        Seabed(type="gravel", share=0.7 * rough),
        Seabed(type="seagrass", share=grown),
    )
    return Scene(
        name=f"adaptive {seed}",
        seed=seed,
        world=World(depth_m=25.0, seabeds=seabeds, patch_m=50.0, relief_rms_m=0.1),
        objects=_objects(rng, side_m),
        sonar=Sonar(
            range_m=40.0,
            n_samples=800,
            ping_rate_hz=10.0,
            range_resolution_m=0.07,
            speckle_along_track_m=0.15,
            recorder=_UNCLIPPED,
        ),
        track=Track(
            plan=Lawnmower(
                start_east_m=_FIRST_LEG_M,
                start_north_m=-_RUN_IN_M,
                leg_m=side_m + _RUN_IN_M,
                spacing_m=2.0 * _FIRST_LEG_M,
                n_legs=math.ceil(side_m / (2.0 * _FIRST_LEG_M)),
            ),
            speed_mps=1.8,
            altitude_m=5.0,
            turn_rate_deg_s=_TURN_RATE_DEG_S,
            motion=Motion(current_mps=float(rng.uniform(0.0, 0.3)), current_towards_deg=float(rng.uniform(0.0, 360.0))),
        ),
        navigation_error=NavigationError(),
    )


def limits_of(scene: Scene, order: Order, config: WaterfallConfig | None = None) -> Limits:
    """Return the limits on plans at the start of a mission; the fence is in the scene's plane.

    The radius is that of the scene's vehicle over ground with the current from astern.
    """
    track, motion, seen = scene.track, scene.track.motion, config or Config().waterfall
    speed = track.speed_mps
    return Limits(
        turn_radius_m=(speed + motion.current_mps) ** 2 / (speed * math.radians(track.turn_rate_deg_s)),
        budget_m=order.budget_m,
        fence=order.fence,
        altitude_m=track.altitude_m,
        min_altitude_m=0.5 * track.altitude_m,
        swath=(track.altitude_m / math.tan(math.radians(seen.max_grazing_deg)), swath_m(scene)),
    )


def _objects(rng: np.random.Generator, side_m: float) -> tuple[SceneObject, ...]:
    """Draw mines and rocks anywhere in the area, apart from each other."""
    per_kind = max(1, round(_MINES_PER_KIND_M2 * side_m**2))
    mines: list[ObjectKind] = [kind for kind in _MINE_KINDS for _ in range(per_kind)]
    rocks: list[ObjectKind] = ["rock"] * len(mines)
    kinds = mines + rocks
    places: list[tuple[float, float]] = []
    for _ in range(_TRIES):
        east, north = rng.uniform(1.0, side_m - 1.0, 2).tolist()
        if all(math.hypot(east - e, north - n) >= _APART_M for e, n in places):
            places.append((east, north))
        if len(places) == len(kinds):
            break
    else:
        raise UsageError(
            f"no room for {len(kinds)} objects {_APART_M:g} m apart in a square of {side_m:g} m: take a larger one"
        )
    return tuple(_object(rng, kind, *place) for kind, place in zip(kinds, places, strict=True))


def _object(rng: np.random.Generator, kind: ObjectKind, east_m: float, north_m: float) -> SceneObject:
    azimuth_deg, tilt_deg = float(rng.uniform(0.0, 360.0)), float(rng.uniform(-6.0, 6.0))
    burial_m, strength_db = float(rng.uniform(0.0, 0.15)), float(rng.uniform(-24.0, -10.0))
    if kind == "rock":
        scale = float(rng.uniform(0.6, 1.8))
        return SceneObject(
            kind=kind,
            east_m=east_m,
            north_m=north_m,
            azimuth_deg=azimuth_deg,
            burial_m=0.5 * burial_m,
            strength_db=strength_db,
            length_m=0.9 * scale,
            width_m=0.7 * scale,
            height_m=0.4 * min(scale, 1.5),
        )
    return SceneObject(
        kind=kind,
        east_m=east_m,
        north_m=north_m,
        azimuth_deg=azimuth_deg,
        tilt_deg=tilt_deg if kind == "wedge" else 0.0,
        burial_m=burial_m,
        strength_db=strength_db,
        width_m=float(rng.uniform(0.6, 1.0)) if kind == "sphere" else None,
    )
