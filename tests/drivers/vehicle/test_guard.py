"""Nothing that leads out of the fence, too low or too deep is let through, whatever the shape of the fence and wherever
on Earth."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.clock import Stamp
from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.settings.vehicle_settings import VehicleConfig
from drivers.navigation.corrections import moved
from drivers.vehicle.dialect import GoTo, ReportedState, Steer, Vertical, WireCommand, numbers_of
from drivers.vehicle.guard import Fence, Guard
from drivers.vehicle.sea_floor import SeaFloor

HOME_DEG = (54.0, 8.0)
SQUARE_M = ((-100.0, -100.0), (100.0, -100.0), (100.0, 100.0), (-100.0, 100.0))
# Open to the north: two arms and nothing between them above north 0.
HORSESHOE_M = (
    (-100.0, -100.0),
    (100.0, -100.0),
    (100.0, 100.0),
    (50.0, 100.0),
    (50.0, 0.0),
    (-50.0, 0.0),
    (-50.0, 100.0),
    (-100.0, 100.0),
)
# Of both the first edge crosses the opposite one, and the lobes are not alike.
BOW_M = ((-100.0, -100.0), (100.0, 100.0), (100.0, -100.0), (-100.0, 50.0))
EIGHT_M = ((-100.0, -50.0), (100.0, 50.0), (190.0, 0.0), (100.0, -50.0), (-100.0, 50.0), (-150.0, 0.0))
Metres = tuple[float, float]
PLACES = st.tuples(st.floats(-150.0, 150.0), st.floats(-150.0, 150.0))
IN_ARMS = st.tuples(st.sampled_from([-75.0, 75.0]), st.floats(10.0, 90.0))  # of the horseshoe
HOMES = st.sampled_from([HOME_DEG, (0.0, 180.0), (-70.0, -179.9999), (89.999, 30.0), (-89.9995, 100.0)])


def place_deg(place_m: Metres, home_deg: Metres = HOME_DEG) -> Metres:
    latitude, longitude, _ = LocalFrame(latitude_deg=home_deg[0], longitude_deg=home_deg[1]).to_geodetic(
        [*place_m, 0.0]
    )
    return float(latitude), float(longitude)


def config(
    corners_m: tuple[Metres, ...] = SQUARE_M, home_deg: Metres = HOME_DEG, margin_m: float = 5.0
) -> VehicleConfig:
    corners_deg = tuple(place_deg(corner, home_deg) for corner in corners_m)
    return VehicleConfig(command=True, fence_deg=corners_deg, fence_margin_m=margin_m, max_depth_m=40.0)


def state(
    place_m: Metres, home_deg: Metres = HOME_DEG, *, depth_m: float = 20.0, altitude_m: float = 8.0
) -> ReportedState:
    return ReportedState(
        Stamp(0, 0), *place_deg(place_m, home_deg), heading_rad=0.0, depth_m=depth_m, altitude_m=altitude_m
    )


def go_to(place_m: Metres, home_deg: Metres = HOME_DEG) -> GoTo:
    return GoTo(*place_deg(place_m, home_deg), Vertical("altitude", 5.0), 1.5, 3.0)


def code(
    guard: Guard, command: GoTo | Steer | WireCommand, vehicle: ReportedState | None, floor: SeaFloor | None = None
) -> str | None:
    """Judge a command over the floor that depth and altitude give, unless another one is known."""
    floor_m = math.nan if vehicle is None else vehicle.depth_m + vehicle.altitude_m
    numbers = command if isinstance(command, WireCommand) else numbers_of(command)
    refusal = guard.command(numbers, vehicle, floor or SeaFloor(floor_m, floor_m))
    return None if refusal is None else refusal.code


def inside(points_m: NDArray[np.float64], corners_m: tuple[Metres, ...]) -> NDArray[np.bool_]:
    """Winding number of (n, 2) points, the long way: by the angles under which the edges are seen."""
    corners = np.array(corners_m)[np.newaxis] - points_m[:, np.newaxis]
    bearing = np.arctan2(corners[..., 0], corners[..., 1])
    turned = np.angle(np.exp(1j * np.diff(np.concatenate([bearing, bearing[:, :1]], axis=1), axis=1)))
    return np.asarray(np.abs(turned.sum(axis=1)) > math.pi)


def nearest_m(points_m: NDArray[np.float64], corners_m: tuple[Metres, ...]) -> float:
    """Return the minimum distance of any of the points to the fence, by walking along both."""
    ring = np.array([*corners_m, corners_m[0]])
    walk = np.concatenate([a + np.linspace(0.0, 1.0, 201)[:, np.newaxis] * (b - a) for a, b in pairwise(ring)])
    return float(np.sqrt(((points_m[:, np.newaxis] - walk[np.newaxis]) ** 2).sum(axis=2).min()))


def walked(start_m: Metres, end_m: Metres) -> NDArray[np.float64]:
    return np.asarray(
        np.array(start_m) + np.linspace(0.0, 1.0, 151)[:, np.newaxis] * (np.array(end_m) - np.array(start_m))
    )


@settings(max_examples=50, deadline=None)
@given(st.sampled_from([SQUARE_M, HORSESHOE_M, HORSESHOE_M[::-1]]), PLACES, PLACES, HOMES)
def test_clearance_of_a_way_is_that_of_walking_it(
    corners_m: tuple[Metres, ...], start_m: Metres, end_m: Metres, home_deg: Metres
) -> None:
    fence = Fence([place_deg(corner, home_deg) for corner in corners_m])
    got_m = fence.clearance_m(fence.point(*place_deg(start_m, home_deg)), fence.point(*place_deg(end_m, home_deg)))
    points_m = walked(start_m, end_m)
    wanted_m, outside_m = nearest_m(points_m, corners_m), points_m[~inside(points_m, corners_m)]
    # Nearer, the two walks are too coarse to decide.
    assume(max([nearest_m(point[np.newaxis], corners_m) for point in outside_m], default=wanted_m) > 1.5)
    assert got_m == (-math.inf if len(outside_m) else pytest.approx(wanted_m, abs=1.0))


@settings(max_examples=50, deadline=None)
@given(st.sampled_from([SQUARE_M, HORSESHOE_M]), PLACES | IN_ARMS, PLACES | IN_ARMS, HOMES)
def test_no_go_to_leads_out_of_the_fence(
    corners_m: tuple[Metres, ...], start_m: Metres, end_m: Metres, home_deg: Metres
) -> None:
    guard = Guard(config(corners_m, home_deg))
    if code(guard, go_to(end_m, home_deg), state(start_m, home_deg)) is None:
        assert inside(walked(start_m, end_m), corners_m).all()
        assert nearest_m(np.array([end_m]), corners_m) >= 4.9


@settings(max_examples=50, deadline=None)
@given(st.sampled_from([SQUARE_M, HORSESHOE_M]), PLACES, st.floats(0.0, 6.28), HOMES)
def test_no_steering_leads_out_of_the_fence_while_it_is_valid(
    corners_m: tuple[Metres, ...], start_m: Metres, heading_rad: float, home_deg: Metres
) -> None:
    bounds = config(corners_m, home_deg)
    here = state(start_m, home_deg)
    if code(Guard(bounds), Steer(heading_rad, Vertical("altitude", 5.0), 1.5), here) is None:
        reach_m = 1.5 * bounds.command_valid_s
        north = LocalFrame(latitude_deg=here.latitude_deg, longitude_deg=here.longitude_deg)
        there = north.to_geodetic([reach_m * math.sin(heading_rad), reach_m * math.cos(heading_rad), 0.0])
        end = LocalFrame(latitude_deg=home_deg[0], longitude_deg=home_deg[1]).to_enu(*there)
        assert inside(walked(start_m, (float(end[0]), float(end[1]))), corners_m).all()


def test_what_is_well_inside_passes() -> None:
    guard = Guard(config(HORSESHOE_M))
    assert code(guard, go_to((90.0, -50.0)), state((-80.0, -50.0))) is None
    assert code(guard, Steer(1.0, Vertical("altitude", 5.0), 1.5), state((0.0, -50.0))) is None
    assert (
        guard.plan([place_deg(place) for place in ((-75.0, 50.0), (-75.0, -50.0), (75.0, -50.0), (75.0, 50.0))], 3.0)
        is None
    )


def test_the_way_across_the_mouth_of_a_concave_fence_is_refused() -> None:
    guard = Guard(config(HORSESHOE_M))
    assert code(guard, go_to((75.0, 50.0)), state((-75.0, 50.0))) == "leads_out"
    refusal = guard.plan([place_deg(place) for place in ((-75.0, 50.0), (75.0, 50.0))], 0.0)
    assert refusal is not None
    assert refusal.code == "plan_outside_fence"
    assert refusal.text == "way-point 2 of 2, or the way to it, lies outside the fence"


def test_a_plan_keeps_its_slack_from_the_fence() -> None:
    guard = Guard(config())
    places = [place_deg((0.0, 0.0)), place_deg((93.0, 0.0))]
    assert guard.plan(places, 1.0) is None
    assert (refusal := guard.plan(places, 3.0)) is not None
    assert "is 7.0 m from the fence, less than 8 m" in refusal.text


def test_the_first_leg_from_outside_is_refused() -> None:
    assert code(Guard(config()), go_to((0.0, 0.0)), state((120.0, 0.0))) == "outside_fence"


def test_a_vehicle_within_the_margin_may_leave_it_and_come_no_nearer() -> None:
    guard = Guard(config(margin_m=20.0))
    here = state((90.0, 0.0))
    assert code(guard, go_to((0.0, 0.0)), here) is None
    assert code(guard, go_to((95.0, 0.0)), here) == "leads_out"
    assert code(guard, go_to((90.0, 10.0)), here) == "target_near_fence"
    assert code(guard, Steer(math.radians(270.0), Vertical("altitude", 5.0), 1.5), here) is None
    assert code(guard, Steer(math.radians(90.0), Vertical("altitude", 5.0), 1.5), here) == "leads_out"


def test_the_antipode_is_not_inside() -> None:
    far = ReportedState(Stamp(0, 0), -HOME_DEG[0], HOME_DEG[1] - 180.0, heading_rad=0.0, depth_m=20.0, altitude_m=8.0)
    assert code(Guard(config()), go_to((0.0, 0.0)), far) == "outside_fence"


@pytest.mark.parametrize(
    ("changes", "wanted"),
    [
        ({"latitude_deg": math.nan}, "position_unknown"),
        ({"depth_m": math.nan}, "depth_unknown"),
        ({"altitude_m": math.nan}, "altitude_unknown"),
        ({"altitude_m": 1.9}, "too_low"),
        ({"depth_m": 40.1}, "too_deep"),
        ({"depth_m": 39.0, "altitude_m": 8.0}, "commands_too_deep"),
    ],
)
def test_a_vehicle_that_must_not_be_commanded_is_not(changes: dict[str, Any], wanted: str) -> None:
    assert code(Guard(config()), go_to((10.0, 10.0)), state((0.0, 0.0))._replace(**changes)) == wanted


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused_wherever_it_stands(value: Any) -> None:
    guard, here = Guard(config()), state((0.0, 0.0))
    for name, why in {
        "latitude_deg": "leads_out",
        "longitude_deg": "leads_out",
        "speed_mps": "speed",
        "radius_m": "radius",
    }.items():
        assert code(guard, go_to((10.0, 10.0))._replace(**{name: value}), here) == why
    for name, why in {"heading_rad": "heading", "speed_mps": "speed"}.items():
        assert code(guard, Steer(1.0, Vertical("altitude", 5.0), 1.5)._replace(**{name: value}), here) == why
    for vertical in (Vertical("depth", value), Vertical("altitude", value)):
        assert code(guard, go_to((10.0, 10.0))._replace(vertical=vertical), here) == "vertical"


@pytest.mark.parametrize(
    ("vertical", "wanted"),
    [
        (Vertical("altitude", 1.9), "commands_too_low"),
        (Vertical("depth", 26.5), "commands_too_low"),  # 28 m of water, min_altitude_m is 2
        (Vertical("depth", 25.5), None),
        (Vertical("altitude", 2.1), None),
        (Vertical("depth", -0.1), "vertical"),
    ],
)
def test_depth_and_altitude_are_judged_by_the_same_floor(vertical: Vertical, wanted: str | None) -> None:
    assert code(Guard(config()), go_to((10.0, 10.0))._replace(vertical=vertical), state((0.0, 0.0))) == wanted


def test_a_depth_clears_the_shallowest_floor_and_an_altitude_is_not_too_deep_over_the_deepest() -> None:
    guard, here, floor = Guard(config()), state((0.0, 0.0)), SeaFloor(shallowest_m=20.0, deepest_m=48.0)
    assert code(guard, Steer(1.0, Vertical("depth", 18.0), 1.5), here, floor) is None
    assert code(guard, Steer(1.0, Vertical("depth", 18.1), 1.5), here, floor) == "commands_too_low"
    assert code(guard, Steer(1.0, Vertical("altitude", 8.0), 1.5), here, floor) is None
    assert code(guard, Steer(1.0, Vertical("altitude", 7.9), 1.5), here, floor) == "commands_too_deep"
    unknown = SeaFloor(math.nan, math.nan)
    assert code(guard, Steer(1.0, Vertical("depth", 1.0), 1.5), here, unknown) == "floor_unknown"
    assert code(guard, Steer(1.0, Vertical("altitude", 8.0), 1.5), here, unknown) == "floor_unknown"


def test_every_number_of_a_message_is_judged_also_alone() -> None:
    guard, here = Guard(config()), state((0.0, 0.0))
    assert code(guard, WireCommand(heading_rad=1.0), here) is None
    assert code(guard, WireCommand(heading_rad=0.0), here) is None
    assert code(guard, WireCommand(heading_rad=7.0), here) == "heading"
    assert code(guard, WireCommand(heading_rad=1.0), state((99.0, 0.0))) == "leads_out"
    assert code(guard, WireCommand(speed_mps=1.51), here) == "speed"
    assert code(guard, WireCommand(vertical=Vertical("depth", 27.0)), here) == "commands_too_low"
    assert code(guard, WireCommand(place_deg=place_deg((98.0, 0.0))), here) == "leads_out"
    assert code(guard, WireCommand(radius_m=0.0, speed_mps=1.0), here) == "radius"
    assert code(guard, WireCommand(radius_m=0.5, speed_mps=1.0), here) is None
    assert code(guard, WireCommand(), here) == "unreadable"


def test_a_heading_is_held_inside_the_fence_for_as_long_as_its_time_out() -> None:
    guard, here = Guard(config()), state((0.0, 0.0))
    east = WireCommand(heading_rad=math.pi / 2.0, speed_mps=1.5)
    assert code(guard, east._replace(holds_s=60.0), here) is None  # 90 m of 100
    assert code(guard, east._replace(holds_s=65.0), here) == "leads_out"
    assert code(guard, east._replace(holds_s=1.0), state((93.0, 0.0))) == "leads_out", "as long as a command is valid"


@pytest.mark.parametrize(
    ("changes", "wanted"),
    [
        ({}, None),
        ({"vertical": Vertical("depth", 9.1)}, "commands_too_low"),
        ({"vertical": Vertical("altitude", 9.0)}, "commands_too_low"),
        ({"vertical": Vertical("depth", math.nan)}, "commands_too_low"),
        ({"heading_rad": math.nan}, "heading"),
        ({"speed_mps": 1.6}, "speed"),
        ({"holds_s": 100.0}, "leads_out"),
        ({"heading_rad": None, "vertical": None, "speed_mps": None}, "unreadable"),
    ],
)
def test_an_ascent_is_let_through_without_depth_or_altitude_and_leads_up_alone(
    changes: dict[str, Any], wanted: str | None
) -> None:
    guard, here = Guard(config()), state((0.0, 0.0), depth_m=math.nan, altitude_m=math.nan)
    command = WireCommand(heading_rad=1.0, vertical=Vertical("depth", 9.0), speed_mps=1.5)._replace(**changes)
    refusal = guard.ascent(command, here, safe_depth_m=9.0)
    assert (None if refusal is None else refusal.code) == wanted
    assert guard.ascent(command, None, 9.0) is not None
    assert guard.ascent(command, state((120.0, 0.0)), 9.0) is not None


@pytest.mark.parametrize(
    ("heading_rad", "speed_mps"), [(-0.1, 1.0), (2.0 * math.pi, 1.0), (1.0, 0.0), (1.0, -1.0), (1.0, 1.6)]
)
def test_headings_and_speeds_out_of_range_are_refused(heading_rad: float, speed_mps: float) -> None:
    assert code(Guard(config()), Steer(heading_rad, Vertical("altitude", 5.0), speed_mps), state((0.0, 0.0))) in (
        "heading",
        "speed",
    )


def test_commands_and_plans_grow_old() -> None:
    guard = Guard(config())
    assert guard.age(5.0) is None
    assert (refusal := guard.age(5.1)) is not None
    assert refusal.code == "expired"
    assert guard.age(math.nan) is not None
    assert guard.plan_age(900.0) is None
    assert (refusal := guard.plan_age(901.0)) is not None
    assert refusal.code == "plan_expired"


def test_without_a_fence_nothing_is_let_through() -> None:
    guard = Guard(VehicleConfig())
    assert code(guard, go_to((0.0, 0.0)), state((0.0, 0.0))) == "no_fence"
    assert guard.plan([HOME_DEG], 0.0) is not None


@pytest.mark.parametrize(
    "corners_m",
    [
        *(shape[k:] + shape[:k] for shape in (BOW_M, EIGHT_M) for k in range(len(shape))),  # any corner may be first
        ((0.0, 0.0), (50.0, 50.0), (100.0, 100.0)),  # a line
        ((0.0, 0.0), (0.0, 0.0), (100.0, 100.0)),  # two corners
        ((-90_000.0, 0.0), (90_000.0, 0.0), (0.0, 90_000.0)),  # too wide
    ],
)
def test_a_fence_that_is_no_area_is_reported_to_the_user(corners_m: tuple[Metres, ...]) -> None:
    with pytest.raises(UsageError, match="fence_deg"):
        Guard(config(corners_m))


def test_a_fence_around_the_world_is_reported_to_the_user() -> None:
    with pytest.raises(UsageError, match="50 km"):
        Fence([(0.0, 0.0), (0.0, 120.0), (0.0, -120.0)])


def test_three_corners_make_a_fence() -> None:
    guard = Guard(config(SQUARE_M[:3]))
    assert code(guard, go_to((80.0, 0.0)), state((0.0, -80.0))) is None
    assert code(guard, go_to((0.0, 80.0)), state((0.0, -80.0))) == "leads_out"


def test_a_closed_ring_is_the_same_fence() -> None:
    corners_deg = [moved(*HOME_DEG, *corner) for corner in SQUARE_M]
    closed = Guard(msgspec.structs.replace(config(), fence_deg=(*corners_deg, corners_deg[0])))
    assert code(closed, go_to((90.0, 90.0)), state((-90.0, -90.0))) is None
    assert code(closed, go_to((99.0, 90.0)), state((-90.0, -90.0))) == "leads_out"
