"""Refuse commands that lead out of the fence, too low or too deep, or that are too old.

Current and the vehicle's way of turning are not known here; `fence_margin_m` is there for both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from auv_mcm.errors import UsageError
from auv_mcm.settings.vehicle_settings import VehicleConfig
from drivers.vehicle.dialect import Command, GoTo, ReportedState, Steer, Vertical
from drivers.vehicle.plane import LocalPlane, Point, distance_m, distance_to_line_m

MAX_FENCE_RADIUS_M: Final = 50_000.0  # farther out a flat chart bends straight lines
_ROUNDING_M: Final = 1e-3  # m: places on a border count as inside whatever the rounding
_TOUCH_M: Final = 1e-6  # a way through a corner may be out of the fence behind it
_TURN: Final = 2.0 * math.pi


class Refusal(NamedTuple):
    """Hold why a command is not sent. code: one word for counters; text: for people."""

    code: str
    text: str


class Fence:
    """Hold a polygon on the sea surface, its corners in either order; edges are the shortest lines between corners.

    Raises UsageError for corners that form no polygon: fewer than three, edges that cross, no area, more than 50 km
    from their middle.
    """

    def __init__(self, corners_deg: Sequence[tuple[float, float]]) -> None:
        self._plane = LocalPlane(*_middle_deg(corners_deg))
        corners = [self._plane.point(*corner) for corner in corners_deg]
        if not all(math.hypot(*corner) <= MAX_FENCE_RADIUS_M for corner in corners):
            raise UsageError(
                f"vehicle: fence_deg has corners more than {MAX_FENCE_RADIUS_M / 1e3:g} km from its middle; fence the "
                "area of this mission"
            )
        ring = [
            corner
            for before, corner in zip([corners[-1], *corners], corners, strict=False)
            if distance_m(before, corner) > _ROUNDING_M
        ]
        self._edges = list(zip(ring, [*ring[1:], *ring[:1]], strict=True))
        if len(ring) < 3 or _cross_themselves(self._edges) or abs(_area_m2(ring)) < 1.0:
            raise UsageError("vehicle: fence_deg encloses no area; give its corners in order, edges must not cross")

    def point(self, latitude_deg: float, longitude_deg: float) -> Point:
        return self._plane.point(latitude_deg, longitude_deg)

    def ahead(self, latitude_deg: float, longitude_deg: float, heading_rad: float, reach_m: float) -> Point:
        """Return where a course along a true heading leads."""
        here, step = (
            self._plane.point(latitude_deg, longitude_deg),
            self._plane.direction(latitude_deg, longitude_deg, heading_rad),
        )
        return Point(here.east_m + reach_m * step.east_m, here.north_m + reach_m * step.north_m)

    def clearance_m(self, start: Point, end: Point) -> float:
        """Return the minimum distance of a straight leg to the fence, in m.

        -inf if it leaves the fence or the chart.
        """
        if not (self.inside(start) and self.inside(end)):
            return -math.inf
        if any(_cross(start, end, *edge) for edge in self._edges):
            return -math.inf
        return min(
            min(
                distance_to_line_m(start, *edge),
                distance_to_line_m(end, *edge),
                distance_to_line_m(edge[0], start, end),
                distance_to_line_m(edge[1], start, end),
            )
            for edge in self._edges
        )

    def inside(self, point: Point) -> bool:
        """Return whether a point is inside, by the even-odd rule; points on an edge may count as either."""
        east_m, north_m = point
        inside = False
        for a, b in self._edges:
            if (a.north_m > north_m) != (b.north_m > north_m):
                share = (north_m - a.north_m) / (b.north_m - a.north_m)
                inside ^= east_m < a.east_m + share * (b.east_m - a.east_m)
        return inside


class Guard:
    """Check commands against the configured bounds. Without a fence everything is refused.

    Raises UsageError for a fence that encloses no area.
    """

    def __init__(self, config: VehicleConfig) -> None:
        self._config = config
        self._fence = Fence(config.fence_deg) if config.fence_deg else None

    def plan(self, places_deg: Sequence[tuple[float, float]], slack_m: float) -> Refusal | None:
        """Return why straight legs from place to place must not be flown, wherever the vehicle is.

        slack_m: they keep so much farther inside the fence, for a vehicle that wanders about them.
        """
        if self._fence is None:
            return _NO_FENCE
        points = [self._fence.point(*place) for place in places_deg]
        min_clearance_m = self._config.fence_margin_m + slack_m
        for number, (start, end) in enumerate(pairwise([*points[:1], *points]), start=1):
            if not (clearance_m := self._fence.clearance_m(start, end)) >= max(min_clearance_m - _ROUNDING_M, _TOUCH_M):
                where = f"way-point {number} of {len(points)}, or the way to it, "
                what = (
                    "lies outside the fence"
                    if clearance_m < 0.0
                    else f"is {clearance_m:.1f} m from the fence, less than {min_clearance_m:g} m"
                )
                return Refusal("plan_outside_fence", where + what)
        return None

    def state(self, state: ReportedState | None) -> Refusal | None:
        """Return why a vehicle in this state must not be commanded. Unknown quantities are refused."""
        if self._fence is None:
            return _NO_FENCE
        if state is None or not math.isfinite(state.latitude_deg + state.longitude_deg):
            return Refusal("position_unknown", "the vehicle's position is not known")
        if not math.isfinite(state.depth_m):
            return Refusal("depth_unknown", "the vehicle's depth is not known")
        if not math.isfinite(state.altitude_m):
            return Refusal("altitude_unknown", "the vehicle's altitude is not known")
        if state.altitude_m < self._config.min_altitude_m:
            return Refusal(
                "too_low",
                f"altitude {state.altitude_m:.1f} m is below min_altitude_m ({self._config.min_altitude_m:g})",
            )
        if state.depth_m > self._config.max_depth_m:
            return Refusal(
                "too_deep", f"depth {state.depth_m:.1f} m is beyond max_depth_m ({self._config.max_depth_m:g})"
            )
        here = self._fence.point(state.latitude_deg, state.longitude_deg)
        if not self._fence.inside(here):
            return Refusal("outside_fence", "the vehicle is outside the fence")
        return None

    def age(self, age_s: float) -> Refusal | None:
        """Return why a command that the payload confirmed so long ago is void. NaN is too old."""
        if not age_s <= self._config.command_valid_s:
            return Refusal(
                "expired",
                f"commands were not confirmed for {age_s:.1f} s, command_valid_s is {self._config.command_valid_s:g}",
            )
        return None

    def plan_age(self, age_s: float) -> Refusal | None:
        """Return why a plan proposed so long ago is void."""
        if not age_s <= self._config.plan_valid_s:
            return Refusal(
                "plan_expired", f"the plan is {age_s:.0f} s old, plan_valid_s is {self._config.plan_valid_s:g}"
            )
        return None

    def command(self, command: Command, state: ReportedState | None) -> Refusal | None:
        """Return why a command must not be sent to a vehicle in this state."""
        if (refusal := self.state(state)) is not None:
            return refusal
        assert state is not None  # else refused above
        assert self._fence is not None
        return (
            self._speed(command)
            or self._vertical(command.vertical, state)
            or (
                self._steer(command, state, self._fence)
                if isinstance(command, Steer)
                else self._go_to(command, state, self._fence)
            )
        )

    def _speed(self, command: Command) -> Refusal | None:
        if not 0.0 < command.speed_mps <= self._config.speed_mps:
            return Refusal(
                "speed", f"speed {command.speed_mps:g} m/s is not within 0 and speed_mps ({self._config.speed_mps:g})"
            )
        return None

    def _vertical(self, vertical: Vertical, state: ReportedState) -> Refusal | None:
        """Check a depth or an altitude against both bounds, over the sea floor below the vehicle."""
        if not 0.0 <= vertical.value_m < math.inf:
            return Refusal("vertical", f"{vertical.reference} {vertical.value_m:g} m is not valid")
        floor_m = state.depth_m + state.altitude_m
        altitude_m = vertical.value_m if vertical.reference == "altitude" else floor_m - vertical.value_m
        depth_m = vertical.value_m if vertical.reference == "depth" else floor_m - vertical.value_m
        if not altitude_m >= self._config.min_altitude_m:
            return Refusal(
                "commands_too_low",
                f"altitude {altitude_m:.1f} m would be below min_altitude_m ({self._config.min_altitude_m:g})",
            )
        if not depth_m <= self._config.max_depth_m:
            return Refusal(
                "commands_too_deep", f"depth {depth_m:.1f} m would be beyond max_depth_m ({self._config.max_depth_m:g})"
            )
        return None

    def _go_to(self, command: GoTo, state: ReportedState, fence: Fence) -> Refusal | None:
        if not 0.0 < command.radius_m < math.inf:
            return Refusal("radius", f"radius {command.radius_m:g} m is not valid")
        here, there = (
            fence.point(state.latitude_deg, state.longitude_deg),
            fence.point(command.latitude_deg, command.longitude_deg),
        )
        if (refusal := self._way(here, there, fence)) is not None:
            return refusal
        if not fence.clearance_m(there, there) >= self._config.fence_margin_m - _ROUNDING_M:
            return Refusal(
                "target_near_fence", f"the place to go to is not {self._config.fence_margin_m:g} m inside the fence"
            )
        return None

    def _steer(self, command: Steer, state: ReportedState, fence: Fence) -> Refusal | None:
        if not math.isfinite(state.heading_rad):
            return Refusal("heading_unknown", "the vehicle's heading is not known")
        if not 0.0 <= command.heading_rad < _TURN:
            return Refusal("heading", f"heading {command.heading_rad:g} rad is not within 0 and 2 pi")
        here = fence.point(state.latitude_deg, state.longitude_deg)
        reach_m = command.speed_mps * self._config.command_valid_s
        return self._way(
            here, fence.ahead(state.latitude_deg, state.longitude_deg, command.heading_rad, reach_m), fence
        )

    def _way(self, here: Point, there: Point, fence: Fence) -> Refusal | None:
        """Return why a heading must not be held. A vehicle within the margin may leave it, but not approach the
        fence."""
        clearance_m = fence.clearance_m(here, there)
        if clearance_m >= max(self._config.fence_margin_m, _TOUCH_M):
            return None
        min_clearance_m = min(self._config.fence_margin_m, fence.clearance_m(here, here))
        if not clearance_m >= max(min_clearance_m - _ROUNDING_M, _TOUCH_M):
            return Refusal(
                "leads_out", f"the straight line leaves the fence, or comes nearer to it than {min_clearance_m:.1f} m"
            )
        return None


_NO_FENCE: Final = Refusal("no_fence", "no fence is configured: set vehicle.fence_deg")


def _middle_deg(corners_deg: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the mean of directions from the Earth's centre, so that neither poles nor the antimeridian matter."""
    angles = [(math.radians(latitude_deg), math.radians(longitude_deg)) for latitude_deg, longitude_deg in corners_deg]
    x = math.fsum(math.cos(latitude) * math.cos(longitude) for latitude, longitude in angles)
    y = math.fsum(math.cos(latitude) * math.sin(longitude) for latitude, longitude in angles)
    z = math.fsum(math.sin(latitude) for latitude, _ in angles)
    return math.degrees(math.atan2(z, math.hypot(x, y))), math.degrees(math.atan2(y, x))


def _turn_m2(a: Point, b: Point, c: Point) -> float:
    """Return twice the area of a triangle, positive counter-clockwise."""
    return (b.east_m - a.east_m) * (c.north_m - a.north_m) - (b.north_m - a.north_m) * (c.east_m - a.east_m)


def _cross(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Return whether two lines cross, not merely touch; True if rounding leaves it open."""
    if _turn_m2(a, b, c) * _turn_m2(a, b, d) >= 0.0:
        return False
    return not _turn_m2(c, d, a) * _turn_m2(c, d, b) >= 0.0


def _cross_themselves(edges: Sequence[tuple[Point, Point]]) -> bool:
    return any(_cross(*edge, *other) for index, edge in enumerate(edges) for other in edges[index + 2 :])


def _area_m2(ring: Sequence[Point]) -> float:
    return math.fsum(_turn_m2(ring[0], a, b) for a, b in pairwise(ring[1:])) / 2.0
