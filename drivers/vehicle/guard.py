"""Refuse commands that lead out of the fence, too low or too deep, or that are too old.

What is judged are the numbers that a command has on the wire, see `dialect.ReadsBack`. Current and the vehicle's way of
turning are not known here; `fence_margin_m` is there for both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from auv_mcm.errors import UsageError
from auv_mcm.settings.vehicle_settings import VehicleConfig
from drivers.vehicle.dialect import ReportedState, Vertical, WireCommand
from drivers.vehicle.plane import LocalPlane, Point, distance_m, distance_to_line_m
from drivers.vehicle.sea_floor import SeaFloor

MAX_FENCE_RADIUS_M: Final = 50_000.0  # farther out a flat chart bends straight lines
_ROUNDING_M: Final = 1e-2  # m: places on a border count as inside; a place in steps of 1e-7 degrees is 8 mm off
_SAME_CORNER_M: Final = 1e-3  # m between corners of a fence: nearer ones are one
_VERTICAL_ROUNDING_M: Final = 1e-3  # m: a depth or an altitude on its bound is within, whatever feet make of it
_SPEED_ROUNDING: Final = 1e-9  # of a speed: one on its bound is within, whatever knots make of it
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
            if distance_m(before, corner) > _SAME_CORNER_M
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
        if (refusal := self._position(state)) is not None or state is None:
            return refusal
        return self._height(state) or self._outside(state)

    def _position(self, state: ReportedState | None) -> Refusal | None:
        if self._fence is None:
            return _NO_FENCE
        if state is None or not math.isfinite(state.latitude_deg + state.longitude_deg):
            return Refusal("position_unknown", "the vehicle's position is not known")
        return None

    def _outside(self, state: ReportedState) -> Refusal | None:
        assert self._fence is not None  # else the position was refused
        if not self._fence.inside(self._fence.point(state.latitude_deg, state.longitude_deg)):
            return Refusal("outside_fence", "the vehicle is outside the fence")
        return None

    def _height(self, state: ReportedState) -> Refusal | None:
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

    def command(self, command: WireCommand, state: ReportedState | None, floor: SeaFloor) -> Refusal | None:
        """Return why a command must not be sent to a vehicle in this state, over this floor."""
        if (refusal := self.state(state)) is not None:
            return refusal
        assert state is not None  # else refused above
        return (
            self._readable(command)
            or self._speed(command.speed_mps)
            or self.vertical(command.vertical, floor)
            or self._horizontal(command, state)
        )

    def ascent(self, command: WireCommand, state: ReportedState | None, safe_depth_m: float) -> Refusal | None:
        """Return why a command that is to lead up, before control goes back, must not be sent.

        It need not be known how deep the vehicle is, nor how high.
        """
        if (refusal := self._position(state)) is not None or state is None:
            return refusal
        vertical = command.vertical
        if vertical is not None and not (
            vertical.reference == "depth" and 0.0 <= vertical.value_m <= safe_depth_m + _VERTICAL_ROUNDING_M
        ):
            return Refusal("commands_too_low", f"{vertical.reference} {vertical.value_m:g} m does not lead up")
        return (
            self._outside(state)
            or self._readable(command)
            or self._speed(command.speed_mps)
            or self._horizontal(command, state)
        )

    def _readable(self, command: WireCommand) -> Refusal | None:
        if command == WireCommand():
            return Refusal("unreadable", "a message to the vehicle cannot be read, and might command it")
        return None

    def _speed(self, speed_mps: float | None) -> Refusal | None:
        max_mps = self._config.speed_mps
        if speed_mps is None or 0.0 < speed_mps <= max_mps * (1.0 + _SPEED_ROUNDING):
            return None
        return Refusal("speed", f"speed {speed_mps:g} m/s is not within 0 and speed_mps ({max_mps:g})")

    def vertical(self, vertical: Vertical | None, floor: SeaFloor) -> Refusal | None:
        """Return why a depth or an altitude must not be sent: it is held against both bounds.

        The floor is the one that the command is nearer to: a depth has to clear the shallowest, and an altitude must
        not lead too deep over the deepest.
        """
        if vertical is None:
            return None
        is_depth = vertical.reference == "depth"
        floor_m = floor.shallowest_m if is_depth else floor.deepest_m
        if not math.isfinite(floor_m):
            return Refusal(
                "floor_unknown",
                "the sea floor below the vehicle is not known: its depth and altitude are not of one moment, change "
                "faster than they can, or the altitude stands still while the depth changes: look after its altimeter",
            )
        if not 0.0 <= vertical.value_m < math.inf:
            return Refusal("vertical", f"{vertical.reference} {vertical.value_m:g} m is not valid")
        altitude_m = floor_m - vertical.value_m if is_depth else vertical.value_m
        depth_m = vertical.value_m if is_depth else floor_m - vertical.value_m
        if not altitude_m >= self._config.min_altitude_m - _VERTICAL_ROUNDING_M:
            return Refusal(
                "commands_too_low",
                f"altitude {altitude_m:.1f} m would be below min_altitude_m ({self._config.min_altitude_m:g})",
            )
        if not depth_m <= self._config.max_depth_m + _VERTICAL_ROUNDING_M:
            return Refusal(
                "commands_too_deep", f"depth {depth_m:.1f} m would be beyond max_depth_m ({self._config.max_depth_m:g})"
            )
        return None

    def _horizontal(self, command: WireCommand, state: ReportedState) -> Refusal | None:
        assert self._fence is not None  # else the state was refused
        if command.radius_m is not None and not 0.0 < command.radius_m < math.inf:
            return Refusal("radius", f"radius {command.radius_m:g} m is not valid")
        if command.place_deg is not None:
            return self._go_to(command.place_deg, state, self._fence)
        if command.heading_rad is not None:
            return self._steer(command.heading_rad, command, state, self._fence)
        return None

    def _go_to(self, place_deg: tuple[float, float], state: ReportedState, fence: Fence) -> Refusal | None:
        here, there = fence.point(state.latitude_deg, state.longitude_deg), fence.point(*place_deg)
        if (refusal := self._way(here, there, fence)) is not None:
            return refusal
        if not fence.clearance_m(there, there) >= self._config.fence_margin_m - _ROUNDING_M:
            return Refusal(
                "target_near_fence", f"the place to go to is not {self._config.fence_margin_m:g} m inside the fence"
            )
        return None

    def _steer(self, heading_rad: float, command: WireCommand, state: ReportedState, fence: Fence) -> Refusal | None:
        """Check where a heading leads, at the speed and for as long as the vehicle may hold it."""
        if not math.isfinite(state.heading_rad):
            return Refusal("heading_unknown", "the vehicle's heading is not known")
        if not 0.0 <= heading_rad < _TURN:
            return Refusal("heading", f"heading {heading_rad:g} rad is not within 0 and 2 pi")
        here = fence.point(state.latitude_deg, state.longitude_deg)
        speed_mps = self._config.speed_mps if command.speed_mps is None else command.speed_mps
        reach_m = speed_mps * max(self._config.command_valid_s, command.holds_s or 0.0)
        return self._way(here, fence.ahead(state.latitude_deg, state.longitude_deg, heading_rad, reach_m), fence)

    def _way(self, here: Point, there: Point, fence: Fence) -> Refusal | None:
        """Return why a heading must not be held. A vehicle within the margin may leave it, but not approach the
        fence."""
        min_clearance_m = min(self._config.fence_margin_m, fence.clearance_m(here, here))
        if not fence.clearance_m(here, there) >= max(min_clearance_m - _ROUNDING_M, _TOUCH_M):
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
