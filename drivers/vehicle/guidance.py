"""Guide along way-points by headings: line of sight on straight legs, for vehicles that hold a heading and no track.

The course aims at a point on the leg one look-ahead distance in front of the vehicle's foot on it (Fossen, "Handbook of
Marine Craft Hydrodynamics and Motion Control", 2011, sec. 10.3). Against current the cross-track integral of Borhaug,
Pavlov and Pettersen ("Integral LOS control for path following of underactuated marine surface vessels in the presence
of constant ocean currents", CDC 2008) has to settle anew on every leg, which takes longer than a re-inspection leg is;
so the current itself is estimated as a vector that all legs share, and the heading is crabbed against it (Fossen and
Lekkas, "Direct and indirect adaptive integral line-of-sight path-following controllers for marine craft exposed to
ocean currents", 2017, the indirect form). What is estimated is whatever drives the vehicle off: current, a compass that
is wrong, another speed than was commanded.

Every leg has its own chart, so neither poles nor the antimeridian matter.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from drivers.vehicle.plane import LocalPlane, Point, distance_to_line_m

CURRENT_SETTLES_S: Final = 8.0  # both poles of the observer: noise of positions is not to be seen, a turn's length is
MAX_CURRENT_SHARE: Final = 0.95  # of the speed: beyond, no heading holds a track
LARGEST_JUMP_M: Final = (
    10.0  # between where the vehicle was expected and is: a correction of its navigation, no current
)
MAX_LEAD_RAD: Final = math.radians(
    60.0
)  # of the commanded heading before the vehicle's: far from where it would turn the other way
_LONGEST_STEP_S: Final = 5.0  # after a longer silence the observer starts anew, but keeps the current
_MAX_CUT_RADII: Final = 1.5  # turning radii before a corner where the turn begins, maximum
_CHART_M: Final = 10_000.0  # from its origin: farther, the estimate's chart is laid anew
_HERE: Final = Point(0.0, 0.0)
_TURN: Final = 2.0 * math.pi


class OffTrack(NamedTuple):
    """Hold the place on a leg. to_go_m: along the leg to its end. cross_m: to starboard of it."""

    to_go_m: float
    cross_m: float


class WaypointTrack:
    """Follow way-points in order on the straight legs between them.

    places_deg: latitude, longitude; the first is where the way begins and is not flown to. radius_m: as near counts as
    there. A way-point is also behind the vehicle once it has passed it abeam, however far off: it would circle one that
    it cannot reach. cut_radius_m: turn this tight before a corner so as to come out on the next leg; 0 for vehicles
    that turn by themselves.
    """

    def __init__(
        self, places_deg: tuple[tuple[float, float], ...], *, radius_m: float, cut_radius_m: float = 0.0
    ) -> None:
        self._places_deg = places_deg
        self._radius_m = radius_m
        self._cut_radius_m = cut_radius_m
        self._index = 1
        self._from_deg = places_deg[0]
        self._lay_leg()

    @property
    def index(self) -> int:
        """Return the index of the place that is flown to."""
        return self._index

    @property
    def finished(self) -> bool:
        """Find whether all places were reached."""
        return self._index >= len(self._places_deg)

    @property
    def target_deg(self) -> tuple[float, float]:
        """Return latitude and longitude of the next place, degrees."""
        return self._places_deg[self._index]

    def nearest(self, position_deg: tuple[float, float], first: int, last: int) -> int:
        """Return the place of `first` to `last` to continue to: the end of the nearest leg, of several the last."""
        chart = LocalPlane(*position_deg)
        best, nearest_m = first, math.inf
        for index in range(first, last + 1):
            start, end = chart.point(*self._places_deg[index - 1]), chart.point(*self._places_deg[index])
            if (apart_m := distance_to_line_m(_HERE, start, end)) <= nearest_m:
                best, nearest_m = index, apart_m
        return best

    def join(self, position_deg: tuple[float, float], index: int) -> None:
        """Continue from a position, straight to a place."""
        self._index, self._from_deg = index, position_deg
        self._lay_leg()

    def advance(self, position_deg: tuple[float, float]) -> None:
        """Drop the places that are reached or passed."""
        while not self.finished and self._done(position_deg):
            self.arrive()

    def arrive(self) -> None:
        """Note that the vehicle has arrived."""
        self._from_deg = self._places_deg[self._index]
        self._index += 1
        self._lay_leg()

    def off_track(self, position_deg: tuple[float, float]) -> OffTrack:
        """Return the place on the leg; NaN for an unknown position."""
        east_m, north_m = self._chart.point(*position_deg)
        along_east, along_north = self._along
        return OffTrack(-(east_m * along_east + north_m * along_north), east_m * along_north - north_m * along_east)

    def true_heading_rad(self, position_deg: tuple[float, float], right_of_leg_rad: float) -> float:
        """Return the true heading at a position of a direction so far to the right of the leg's."""
        return self._chart.true_heading_rad(*position_deg, math.atan2(*self._along) + right_of_leg_rad)

    def _lay_leg(self) -> None:
        """Lay the chart of the leg, its origin the place to go to; `_along` points down the leg."""
        if self.finished:
            return
        self._chart = LocalPlane(*self.target_deg)
        start = self._chart.point(*self._from_deg)
        length_m = math.hypot(*start)
        self._length_m = length_m
        self._along = (-start.east_m / length_m, -start.north_m / length_m) if length_m > 0.0 else (0.0, 1.0)
        self._cut_m = self._corner_cut_m()

    def _corner_cut_m(self) -> float:
        """Return the distance before the corner, in m, at which a circle that touches both legs begins."""
        if self._index + 1 >= len(self._places_deg) or self._cut_radius_m == 0.0:
            return 0.0
        after = self._chart.point(*self._places_deg[self._index + 1])
        along_m, length_m = after.east_m * self._along[0] + after.north_m * self._along[1], math.hypot(*after)
        if not length_m > 0.0:
            return 0.0
        half_turn_rad = math.acos(min(max(along_m / length_m, -1.0), 1.0)) / 2.0
        return min(self._cut_radius_m * min(math.tan(half_turn_rad), _MAX_CUT_RADII), self._length_m)

    def _done(self, position_deg: tuple[float, float]) -> bool:
        off = self.off_track(position_deg)
        near = math.hypot(*off) <= self._radius_m
        cutting = off.to_go_m <= self._cut_m and abs(off.cross_m) <= self._cut_radius_m
        return near or cutting or off.to_go_m <= 0.0


class _Sailed(NamedTuple):
    """Hold the expected position on the observer's chart, and the heading as a direction there."""

    time_s: float
    east_m: float
    north_m: float
    ahead: Point


class CurrentEstimate:
    """Estimate the current from track and heading, by a Luenberger observer of position and current."""

    def __init__(self) -> None:
        self._east_mps = 0.0
        self._north_mps = 0.0
        self._chart = LocalPlane(0.0, 0.0)
        self._last: _Sailed | None = None

    def restart(self) -> None:
        """Forget the position after a gap; keep the current."""
        self._last = None

    def to_starboard_mps(self, position_deg: tuple[float, float], course_rad: float) -> float:
        """Return the current across a true course, in m/s, at a position near those observed."""
        ahead = self._chart.direction(*position_deg, course_rad)
        return self._east_mps * ahead.north_m - self._north_mps * ahead.east_m

    def observe(self, position_deg: tuple[float, float], heading_rad: float, speed_mps: float, time_s: float) -> None:
        """Take a new position.

        Parameters
        ----------
        heading_rad, speed_mps
            Through the water.
        """
        if not math.hypot(*self._chart.point(*position_deg)) <= _CHART_M:
            self._move_chart(position_deg)
        here = self._chart.point(*position_deg)
        ahead = self._chart.direction(*position_deg, heading_rad)
        last, self._last = self._last, _Sailed(time_s, *here, ahead)
        if last is None or not 0.0 < (step_s := time_s - last.time_s) <= _LONGEST_STEP_S:
            return
        sailed_m = step_s * speed_mps / 2.0
        east_m = last.east_m + sailed_m * (last.ahead.east_m + ahead.east_m) + step_s * self._east_mps
        north_m = last.north_m + sailed_m * (last.ahead.north_m + ahead.north_m) + step_s * self._north_mps
        miss_east_m, miss_north_m = here.east_m - east_m, here.north_m - north_m
        if math.hypot(miss_east_m, miss_north_m) > LARGEST_JUMP_M:
            return
        # Both poles at exp(-step / T), exactly for any step, so that seldom positions do not make it unstable.
        pole = math.exp(-step_s / CURRENT_SETTLES_S)
        of_position, of_current = 1.0 - pole * pole, (1.0 - pole) ** 2 / step_s
        self._last = _Sailed(time_s, east_m + of_position * miss_east_m, north_m + of_position * miss_north_m, ahead)
        east_mps, north_mps = self._east_mps + of_current * miss_east_m, self._north_mps + of_current * miss_north_m
        # No more than can be crabbed against: what is beyond would only have to be unlearned again.
        too_much = max(math.hypot(east_mps, north_mps) / (MAX_CURRENT_SHARE * speed_mps), 1.0)
        self._east_mps, self._north_mps = east_mps / too_much, north_mps / too_much

    def _move_chart(self, position_deg: tuple[float, float]) -> None:
        """Lay a new chart; the current keeps its direction over ground."""
        north = self._chart.direction(*position_deg, 0.0)
        east_mps, north_mps = self._east_mps, self._north_mps
        self._east_mps = east_mps * north.north_m - north_mps * north.east_m
        self._north_mps = east_mps * north.east_m + north_mps * north.north_m
        self._chart, self._last = LocalPlane(*position_deg), None


class LineOfSight:
    """Compute the heading to hold.

    The commanded heading turns no faster than on a circle of `turn_radius_m` through the water.

    A vehicle that follows its heading within a second or two is half a metre from a long leg once it has settled, in
    currents up to 0.8 of the speed. On a leg that begins one turn radius after the tightest turn it is within 0.3 m in
    still water, 2.5 m in a current of 0.3 and 5 m in one of 0.5 of the speed: a following current makes the turn itself
    wider than planned.
    """

    def __init__(self, *, turn_radius_m: float, speed_mps: float) -> None:
        self._look_ahead_m = turn_radius_m
        self._speed_mps = speed_mps
        self._max_turn_radps = speed_mps / turn_radius_m
        self._current = CurrentEstimate()
        self._heading_rad = 0.0
        self._turned_s = -math.inf
        self._position_s = -math.inf

    def start(self) -> None:
        """Begin to command, from whatever heading the vehicle has."""
        self._turned_s = -math.inf
        self._current.restart()

    def heading_rad(
        self,
        track: WaypointTrack,
        position_deg: tuple[float, float],
        position_s: float,
        heading_rad: float,
        now_s: float,
    ) -> float:
        """Return the true heading to command, [0, 2 pi).

        Parameters
        ----------
        position_s
            When the position was reported.
        heading_rad
            Of the vehicle.
        """
        if position_s > self._position_s:
            self._current.observe(position_deg, heading_rad, self._speed_mps, position_s)
            self._position_s = position_s
        off = track.off_track(position_deg)
        aim_rad = -math.atan2(off.cross_m, self._look_ahead_m)
        course_rad = track.true_heading_rad(position_deg, aim_rad)
        crab_rad = math.asin(self._current.to_starboard_mps(position_deg, course_rad) / self._speed_mps)
        return self._turn_towards(course_rad - crab_rad, heading_rad, now_s)

    def _turn_towards(self, wanted_rad: float, heading_rad: float, now_s: float) -> float:
        if self._turned_s == -math.inf:
            self._heading_rad, self._turned_s = heading_rad, now_s
        max_step_rad = self._max_turn_radps * min(max(now_s - self._turned_s, 0.0), 1.0)
        turn_rad = math.remainder(wanted_rad - self._heading_rad, _TURN)
        turned_rad = self._heading_rad + min(max(turn_rad, -max_step_rad), max_step_rad)
        lead_rad = math.remainder(turned_rad - heading_rad, _TURN)
        self._heading_rad = (heading_rad + min(max(lead_rad, -MAX_LEAD_RAD), MAX_LEAD_RAD)) % _TURN % _TURN
        self._turned_s = now_s
        return self._heading_rad
