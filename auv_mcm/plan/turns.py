"""Find the turns from leg to leg that a vehicle can sail."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.fence import runs_inside
from auv_mcm.plan.dubins import Array, DubinsPath, Flags, PlanePose, dubins_paths, sample_path
from auv_mcm.plan.limits import Limits, turns_inside
from auv_mcm.plan.tracks import Tracks

ARC_STEP_RAD: Final = math.radians(15.0)
_CHECK_STEP_RAD: Final = math.radians(7.5)
_ROOM: Final = 1.01  # circles that turns need, so that points sampled from a turn are well inside


class Turns:
    """Find ways between legs, each computed once."""

    def __init__(self, pose: PlanePose, limits: Limits) -> None:
        self._pose, self._limits = pose, limits
        self._known: dict[tuple[PlanePose, PlanePose], DubinsPath | None] = {}

    @property
    def radius_m(self) -> float:
        """Widen the vehicle's turn radius a little.

        Circles that touch the way-point polygon from inside are then not tighter than it.
        """
        return self._limits.turn_radius_m / math.cos(ARC_STEP_RAD / 2.0)

    def room(self, poses: Array) -> Flags | None:
        """Check whether poses have room for full circles to the left and right, (..., 2); None without a fence."""
        return None if self._limits.fence is None else turns_inside(poses, _ROOM * self.radius_m, self._limits)

    def between(self, start: PlanePose, end: PlanePose) -> DubinsPath | None:
        """Find the shortest way whose whole turning circles stay inside the fence; None if there is none."""
        return self.all_between([(start, end)])[0]

    def all_between(self, ends: Sequence[tuple[PlanePose, PlanePose]]) -> list[DubinsPath | None]:
        """Apply `between` to each start and end at once, which is faster."""
        unknown = [pair for pair in dict.fromkeys(ends) if pair not in self._known]
        if unknown:
            self._known.update(zip(unknown, self._found(unknown), strict=True))
        return [self._known[pair] for pair in ends]

    def _found(self, ends: list[tuple[PlanePose, PlanePose]]) -> list[DubinsPath | None]:
        places = np.array(ends)
        room = self.room(places)
        if room is None:
            return dubins_paths(places, self.radius_m)
        leave, arrive = room[:, 0], room[:, 1]
        # The vehicle is where it is: perhaps a part of a circle fits though the whole does not.
        here = np.array([start == self._pose for start, _ in ends])
        paths = self._inside(dubins_paths(places, self.radius_m, leave | here[:, np.newaxis], arrive))
        again = [number for number in np.flatnonzero(here).tolist() if paths[number] is None]
        if again:
            whole = self._inside(dubins_paths(places[again], self.radius_m, leave[again], arrive[again]))
            for number, path in zip(again, whole, strict=True):
                paths[number] = path
        return paths

    def _inside(self, paths: list[DubinsPath | None]) -> list[DubinsPath | None]:
        inside = iter(paths_inside([path for path in paths if path is not None], self._limits).tolist())
        return [path if path is not None and next(inside) else None for path in paths]


def paths_inside(paths: list[DubinsPath], limits: Limits) -> NDArray[np.bool_]:
    """Check whether paths of one radius, their arcs between samples included, stay inside the fence, (n,)."""
    if limits.fence is None or not paths:
        return np.ones(len(paths), dtype=np.bool_)
    places = [sample_path(path, _CHECK_STEP_RAD)[:, :2] for path in paths]
    first = np.cumsum([0, *(len(each) - 1 for each in places[:-1])])
    starts, ends = (np.concatenate([each[part] for each in places]) for part in (slice(-1), slice(1, None)))
    bulge_m = paths[0].turn_radius_m * (1.0 - math.cos(_CHECK_STEP_RAD / 2.0))
    inside = runs_inside(starts, ends, limits.fence, limits.fence_margin_m + bulge_m)
    return np.asarray(np.logical_and.reduceat(inside, first))


def ends_of(tracks: Tracks, way: int) -> tuple[PlanePose, PlanePose]:
    """Give entry and exit, with the heading sailed."""
    entry, leave = tracks.run[way // 2]
    if way % 2:
        entry, leave = reverse_poses(np.stack([leave, entry]))
    return PlanePose(*entry.tolist()), PlanePose(*leave.tolist())


def reverse_poses(poses: Array) -> Array:
    """Turn poses, (..., 3), round."""
    return np.asarray(poses + np.array([0.0, 0.0, math.pi]))


def rough_way_m(exits: Array, ends: Array, radius_m: float) -> Array:
    """Estimate the way from the nearest of (m, 3) exits to the nearer end of every leg, (n,) m.

    ends: (2 n, 3) as entered.
    """
    east = ends[:, 0] - exits[:, :1]
    north = ends[:, 1] - exits[:, 1:2]
    bearing = np.arctan2(east, north)
    turn = np.abs(_wrapped(bearing - exits[:, 2:])) + np.abs(_wrapped(ends[:, 2] - bearing))
    return np.asarray((np.hypot(east, north) + radius_m * turn).min(axis=0).reshape(2, -1).min(axis=0))


def _wrapped(angle: Array) -> Array:
    return np.asarray(np.mod(angle + math.pi, 2.0 * math.pi) - math.pi)
