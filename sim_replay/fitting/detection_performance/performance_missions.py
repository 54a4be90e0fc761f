"""Draw missions over floors densely strewn with targets, each from its seed.

As dense as they can be without one disturbing another.

Floors, water, sonar and altitude differ from one mission to the next. The track goes round a rectangle, so that targets
are seen from the same direction again, from the opposite one and from the side.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim_replay.simulator.scene import (
    Motion,
    NavigationError,
    Ripples,
    Scene,
    SceneObject,
    Seabed,
    SizeRange,
    Sonar,
    TargetKind,
    Track,
    Waypoints,
    World,
)

_STREAM: Final = 0x504C4F4F  # "PLOO": its own stream of random numbers
_APART_M: Final = 12.0  # m between targets, minimum
_PITCH_M: Final = 13.0  # m of the lattice that they are shifted from
_LEG_M: Final = 150.0  # m
_EDGE_M: Final = 1.0  # of the swath that stays free
_MAX_PING_RATE: Final = 0.95  # of those that the way of sound to the end of the range and back allows

MIX: Final[dict[TargetKind, tuple[float, SizeRange, SizeRange, float]]] = {
    "cylinder": (0.25, (0.0, 0.2), (0.0, 0.1), 0.0),
    "sphere": (0.21, (0.0, 0.25), (0.0, 0.1), 0.0),
    "truncated_cone": (0.21, (0.0, 0.13), (0.0, 0.06), 0.0),
    "wedge": (0.21, (0.0, 0.09), (0.0, 0.0), 6.0),
    "box": (0.12, (0.0, 0.12), (0.0, 0.0), 0.0),
}
"""The usual mix of mines, as in the named scenes: share, burial and scour (m), greatest tilt (degrees)."""
_STRENGTH_DB: Final = (-24.0, -10.0)  # dB of target strength, from and to
_RELIEF_M: Final = (0.02, 0.2, 1.6)  # m rms: two in three missions from the first to the second, others beyond
_SPHERE_M: Final = (0.6, 1.0)  # m of diameter, from and to


def target_scene(seed: int, flight: int = 0) -> Scene:
    """Build a scene with all kinds of sea floor in patches and targets everywhere.

    flight: each has a world of its own.
    """
    sequence = np.random.SeedSequence([seed, flight, _STREAM])
    rng = np.random.Generator(np.random.PCG64(sequence))
    range_m = float(rng.choice([40.0, 50.0, 60.0, 75.0]))
    altitude_m = float(rng.uniform(4.0, 9.0))
    apart_m = 0.8 * range_m
    heading = float(rng.uniform(0.0, 2.0 * math.pi))
    corners = [
        (0.0, 0.0),
        (_LEG_M, 0.0),
        (_LEG_M, apart_m),
        (0.0, apart_m),
        (0.0, -0.5 * apart_m),
    ]  # along and across the first leg
    sine, cosine = math.sin(heading), math.cos(heading)
    points = tuple((along * sine + across * cosine, along * cosine - across * sine) for along, across in corners)
    return Scene(
        name=f"performance {seed}, flight {flight}",
        seed=int(sequence.generate_state(1)[0]),
        world=World(depth_m=25.0, seabeds=_seabeds(rng), patch_m=60.0, relief_rms_m=_relief_m(float(rng.uniform()))),
        objects=_targets(rng, points, math.sqrt(range_m**2 - altitude_m**2) - _EDGE_M),
        sonar=Sonar(
            frequency_khz=float(rng.choice([400.0, 450.0, 600.0])),
            range_m=range_m,
            n_samples=math.ceil(range_m / 0.045),
            ping_rate_hz=min(12.0, _MAX_PING_RATE * 1500.0 / (2.0 * range_m)),
            range_resolution_m=float(rng.uniform(0.04, 0.09)),
            speckle_along_track_m=float(rng.uniform(0.0, 0.25)),
            noise_db=float(rng.uniform(-28.0, -16.0)),
        ),
        track=Track(
            plan=Waypoints(points_m=points),
            speed_mps=float(rng.uniform(1.7, 2.2)),
            altitude_m=altitude_m,
            pings_in_turns=False,
            motion=Motion(current_mps=float(rng.uniform(0.0, 0.3)), current_towards_deg=float(rng.uniform(0.0, 360.0))),
        ),
        navigation_error=NavigationError(),
    )


def _seabeds(rng: np.random.Generator) -> tuple[Seabed, ...]:
    """Return the payload's seabed types in about equal shares; two fields of ripples with directions of their own."""

    def level_db() -> float:
        return float(rng.uniform(-2.0, 2.0))

    rough = (
        Seabed(type="gravel", share=0.12, stones_per_ha=float(rng.uniform(150.0, 500.0)), level_db=level_db()),
        Seabed(type="rock_outcrop", share=0.12, relief_rms_m=float(rng.uniform(0.2, 0.4)), level_db=level_db()),
        Seabed(type="boulder_field", share=0.12, stones_per_ha=float(rng.uniform(800.0, 2500.0)), level_db=level_db()),
    )
    left_out = int(rng.integers(len(rough)))
    return (
        Seabed(type="mud", share=0.1, level_db=level_db()),
        Seabed(type="sand", share=0.14, texture_shape=float(rng.uniform(6.0, 20.0)), level_db=level_db()),
        Seabed(type="rippled_sand", share=0.15, ripples=_ripples(rng), level_db=level_db()),
        Seabed(type="rippled_sand", share=0.15, ripples=_ripples(rng), level_db=level_db()),
        *(seabed for index, seabed in enumerate(rough) if index != left_out),
        Seabed(type="seagrass", share=0.22, relief_rms_m=float(rng.uniform(0.08, 0.16)), level_db=level_db()),
    )


def _ripples(rng: np.random.Generator) -> Ripples:
    wavelength_m = float(rng.uniform(0.6, 1.8))
    return Ripples(
        wavelength_m=wavelength_m,
        # Height over wavelength; ripples that waves make are near 0.17 (P. L. Wiberg and C. K. Harris, J. Geophysical
        # Research 99, 1994).
        height_m=float(rng.uniform(0.09, 0.16)) * wavelength_m,
        direction_deg=float(rng.uniform(0.0, 180.0)),
        defects=float(rng.uniform(0.1, 0.6)),
        skew=float(rng.uniform(0.0, 0.6)),
    )


def _targets(
    rng: np.random.Generator, points: tuple[tuple[float, float], ...], reach_m: float
) -> tuple[SceneObject, ...]:
    """Place targets on a hexagonal lattice of any direction, a little displaced, within reach_m of the track."""
    places = np.array(points)
    middle = places.mean(axis=0)
    radius = float(np.hypot(*(places - middle).T).max()) + reach_m
    n = math.ceil(radius / (_PITCH_M * math.sqrt(0.75))) + 1
    row, column = (index.ravel().astype(np.float64) for index in np.mgrid[-n : n + 1, -2 * n : 2 * n + 1])
    lattice = np.column_stack([column + 0.5 * np.mod(row, 2.0), row * math.sqrt(0.75)]) + rng.uniform(0.0, 1.0, 2)
    turn = float(rng.uniform(0.0, math.pi))
    lattice = lattice * _PITCH_M @ np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    angle = rng.uniform(0.0, 2.0 * math.pi, len(lattice))
    shift = 0.5 * (_PITCH_M - _APART_M) * np.sqrt(rng.uniform(0.0, 1.0, len(lattice)))
    lattice += middle + shift[:, np.newaxis] * np.column_stack([np.cos(angle), np.sin(angle)])
    kinds = list(MIX)
    chosen = rng.choice(len(kinds), size=len(lattice), p=[share for share, *_ in MIX.values()])
    drawn = rng.uniform(0.0, 1.0, (len(lattice), 6))
    placed = []
    for place, index, u in zip(lattice, chosen, drawn, strict=True):
        if _distance_m(place, places) > reach_m:
            continue
        kind = kinds[int(index)]
        _, burial_m, scour_m, tilt_deg = MIX[kind]
        placed.append(
            SceneObject(
                kind=kind,
                east_m=float(place[0]),
                north_m=float(place[1]),
                azimuth_deg=360.0 * float(u[0]),
                burial_m=_between(burial_m, u[1]),
                scour_m=_between(scour_m, u[2]),
                tilt_deg=_between((-tilt_deg, tilt_deg), u[3]),
                strength_db=_between(_STRENGTH_DB, u[4]),
                width_m=_between(_SPHERE_M, u[5]) if kind == "sphere" else None,
            )
        )
    return tuple(placed)


def _between(bounds: SizeRange, share: float) -> float:
    low, high = bounds
    return float(low + (high - low) * share)


def _relief_m(share: float) -> float:
    low, usual, high = _RELIEF_M
    beyond = 3.0 * share - 2.0
    return usual * (high / usual) ** beyond if beyond > 0.0 else _between((low, usual), 1.5 * share)


def _distance_m(place: NDArray[np.float64], points: NDArray[np.float64]) -> float:
    """Return the distance from a place to the nearest of the straight legs between points (n, 2)."""
    start, way = points[:-1], np.diff(points, axis=0)
    part = np.clip(((place - start) * way).sum(axis=1) / (way * way).sum(axis=1), 0.0, 1.0)
    return float(np.hypot(*(place - start - part[:, np.newaxis] * way).T).min())
