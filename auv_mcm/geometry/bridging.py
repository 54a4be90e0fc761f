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
from auv_mcm.geometry.timed_values import CLOCK_S, TimedValues, measured_or_derived
from auv_mcm.geometry.track_speed import Verdicts

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
        east_mps, north_mps, along_mps = self._velocity
        velocity = (speed_mps * math.sin(heading_rad), speed_mps * math.cos(heading_rad), abs(speed_mps))
        elapsed_s = time_s - self._time_s
        east_m = 0.5 * (east_mps + velocity[0]) * elapsed_s
        north_m = 0.5 * (north_mps + velocity[1]) * elapsed_s
        way_m = 0.5 * (along_mps + velocity[2]) * elapsed_s
        made = self._made
        if math.isnan(way_m):
            self._made = made._replace(leg=made.leg + 1.0)
        elif elapsed_s > self._hold_s or math.isnan(east_m):
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


class Bridged(NamedTuple):
    """Hold the places of n instants: (n, 3) Earth-centred, with the 1-sigma, m, of those that were bridged, (n,) each.

    n_left: instants in holes that nothing bridges; hole_s: the longest hole that any instant is in, s.
    """

    place: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    bridged: NDArray[np.bool_]
    n_left: int = 0
    hole_s: float = 0.0


class Dated(NamedTuple):
    """Hold what places instants: fixes (x, y, z, and in column 5 how far back a fix may serve, s), headings, ways.

    course: serves where no heading is known, or where heading_is_empty. There, and where speed_is_off, no way goes on
    from a fix.
    """

    position: TimedValues
    heading: TimedValues
    course: TimedValues
    heading_is_empty: Verdicts
    speed_is_off: Verdicts
    way: TimedValues

    def bridged(self, times: NDArray[np.float64], place: NDArray[np.float64]) -> Bridged:
        """Place instants in holes between fixes, and behind the last one, by the way made.

        Parameters
        ----------
        times
            Of the instants, (n,).
        place
            By the fixes alone, (n, 3), Earth-centred.
        """
        place, sigma_m = place.copy(), np.zeros(times.shape)
        bridged = np.zeros(times.shape, dtype=np.bool_)
        into = Bridged(place, sigma_m, bridged)
        last_s = self.position.last_s
        behind = np.flatnonzero(times > last_s)
        self._carry_on(times, behind, np.full(behind.size, last_s), into)
        hole = self.position.holes(times)
        if hole is None:
            return into
        rows, left_s, right_s, left, right, joined = hole
        self._carry_on(times, rows, left_s, into)
        usable = joined & (right_s - left_s <= MAX_HOLE_S + CLOCK_S) & (right_s - times[rows] < right[:, 5])
        steady = self._is_steady(left_s, right_s)
        made, until, before = map(self._made, (times[rows], right_s, left_s))
        fraction = (times[rows] - left_s) / (right_s - left_s)
        placed, placed_sigma_m, known = bridge(Hole(left[:, :3], right[:, :3], fraction, made, until, before, steady))
        chosen = known & usable
        place[rows[chosen]], sigma_m[rows[chosen]] = placed[chosen], placed_sigma_m[chosen]
        bridged[rows[chosen]] = True
        return Bridged(
            place, sigma_m, bridged, int(np.count_nonzero(usable & ~known)), float(np.max(joined * (right_s - left_s)))
        )

    def _made(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Give the way made until instants, (n, 4), NaN where it is not known."""
        made = self.way.at(times)
        return np.where(made.fresh[:, np.newaxis], made.values, math.nan)

    def _is_steady(self, left_s: NDArray[np.float64], right_s: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Check whether a heading or course is known that hardly changes from one instant to another, (n,)."""
        values, fresh = [], []
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            when_s = left_s + share * (right_s - left_s)
            is_empty = self.heading_is_empty.at(when_s)
            headings, known, _ = measured_or_derived(self.heading, self.course, is_empty, when_s)
            values.append(headings)
            fresh.append(known)
        return np.asarray(np.all(fresh, axis=0) & (np.ptp(values, axis=0) <= STEADY_RAD))

    def _carry_on(
        self, times: NDArray[np.float64], rows: NDArray[np.intp], left_s: NDArray[np.float64], into: Bridged
    ) -> None:
        """Place instants of these rows by the way made since the fixes before them, at left_s (n_rows,)."""
        is_near = times[rows] - left_s <= MAX_HOLE_S
        rows, left_s = rows[is_near], left_s[is_near]
        if not rows.size:
            return
        left = self.position.at(left_s).values[:, :3]
        made, before = map(self._made, (times[rows], left_s))
        placed, placed_sigma_m, known = bridge(
            Hole(left, left, np.zeros(rows.size), made, before, before, np.zeros(rows.size, dtype=np.bool_))
        )
        known &= ~(self.speed_is_off.at(times[rows]) | self.heading_is_empty.at(times[rows]))
        into.place[rows[known]], into.sigma_m[rows[known]] = placed[known], placed_sigma_m[known]
        into.bridged[rows[known]] = True
