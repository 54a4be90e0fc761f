"""Carry a position over a hole between two fixes, by heading and speed.

Between two fixes the way made by heading and speed gives the track's shape, and both fixes its ends: what they disagree
by is spread evenly over the time between.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import ecef_to_geodetic, local_to_ecef_rotation

MAX_HOLE_S: Final = 15.0  # s between two fixes: at 2 m/s and 5 % of the way, the middle of it is known to 0.8 m
SHARE_OF_WAY: Final = 0.05  # 1-sigma per way since the nearer fix: 3 degrees of heading, or 5 % of speed
UNSHAPED_SHARE: Final = 0.1  # the same where only the heading is known, so that the speed may have changed
STEADY_RAD: Final = math.radians(15.0)  # of heading between two fixes: the way is at most 2 % longer than the chord


class WayMade(NamedTuple):
    """Hold the way made since the start, by heading and speed: east, north and along, m.

    leg: two instants of one leg have a heading and a speed all the time between.
    """

    east_m: float = 0.0
    north_m: float = 0.0
    way_m: float = 0.0
    leg: float = 0.0


class Odometer:
    """Add up the way made from headings and speeds, sample by sample."""

    def __init__(self, hold_s: float) -> None:
        """hold_s: a heading or a speed is taken to go on for this long, no longer."""
        self._hold_s = hold_s
        self._made = WayMade()
        self._time_s = -math.inf
        self._velocity = (math.nan, math.nan, math.nan)  # east, north, along, m/s

    def go_to(self, time_s: float, heading_rad: float, speed_mps: float) -> WayMade:
        """Go on to a time, at which heading and speed are these (NaN: unknown), by the mean of both velocities."""
        velocity = (speed_mps * math.sin(heading_rad), speed_mps * math.cos(heading_rad), abs(speed_mps))
        elapsed_s = time_s - self._time_s
        east_m, north_m, way_m = (
            0.5 * (before + now) * elapsed_s for before, now in zip(self._velocity, velocity, strict=True)
        )
        made = self._made
        if elapsed_s > self._hold_s or math.isnan(way_m):
            self._made = made._replace(leg=made.leg + 1.0)
        elif math.isnan(east_m):
            self._made = made._replace(way_m=made.way_m + way_m, leg=made.leg + 1.0)
        else:
            self._made = WayMade(made.east_m + east_m, made.north_m + north_m, made.way_m + way_m, made.leg)
        self._time_s, self._velocity = time_s, velocity
        return self._made


class Hole(NamedTuple):
    """Hold n instants in holes between two fixes.

    from_m, to_m: (n, 3) Earth-centred fixes before and after. fraction: (n,) of the time between. made, made_until,
    made_before: (n, 4) the way made at the instants, at the fixes after and before them, as `WayMade`. is_steady: (n,)
    whether a heading is known that hardly changes between the fixes.
    """

    from_m: NDArray[np.float64]
    to_m: NDArray[np.float64]
    fraction: NDArray[np.float64]
    made: NDArray[np.float64]
    made_until: NDArray[np.float64]
    made_before: NDArray[np.float64]
    is_steady: NDArray[np.bool_]


def bridge(hole: Hole) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Place instants between fixes; return positions (n, 3) Earth-centred, their 1-sigma (n,), m, and which are known.

    Where heading and speed are known all the time, by the way made; where only a steady heading is, along the chord.
    """
    leg = hole.made[:, 3]
    is_shaped = (leg == hole.made_before[:, 3]) & (leg == hole.made_until[:, 3])
    shape = np.where(is_shaped[:, np.newaxis], 1.0, 0.0)
    latitude, longitude, _ = ecef_to_geodetic(hole.from_m)
    rotation = local_to_ecef_rotation(latitude, longitude)

    def run_m(made: NDArray[np.float64]) -> NDArray[np.float64]:
        run = shape * np.nan_to_num(made[:, :2] - hole.made_before[:, :2])
        return np.asarray(np.einsum("nij,nj->ni", rotation[:, :, :2], run))

    misclosure = hole.to_m - hole.from_m - run_m(hole.made_until)
    place = hole.from_m + run_m(hole.made) + hole.fraction[:, np.newaxis] * misclosure
    way_m = np.minimum(np.linalg.norm(place - hole.from_m, axis=1), np.linalg.norm(hole.to_m - place, axis=1))
    sigma_m = np.where(is_shaped, SHARE_OF_WAY, UNSHAPED_SHARE) * way_m
    return place, sigma_m, is_shaped | hole.is_steady
