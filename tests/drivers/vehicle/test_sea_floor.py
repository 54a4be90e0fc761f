"""A floor is believed only where depth and altitude are of one moment and go on from what was reported before."""

from __future__ import annotations

import math

import pytest

from drivers.vehicle.sea_floor import BELIEVED_S, FloorBelow

NAN = math.nan


def floor_after(*reports: tuple[float, float], every_s: float = 0.5) -> tuple[FloorBelow, float]:
    """Report depth and altitude in turn, after 18 m of water for 5 s."""
    floor, now_s = FloorBelow(speed_mps=1.5, valid_s=3.0), 100.0
    for depth_m, altitude_m in (*((10.0, 8.0),) * 11, *reports):
        floor.hear(depth_m, altitude_m, now_s)
        now_s += every_s
    return floor, now_s - every_s


def test_a_floor_is_believed_once_reports_have_followed_one_another_for_two_seconds() -> None:
    floor = FloorBelow(speed_mps=1.5, valid_s=3.0)
    known = []
    for i in range(6):
        floor.hear(10.0, 8.0, 0.5 * i)
        known.append(floor.at(0.5 * i).shallowest_m)
    assert known[:4] == [pytest.approx(NAN, nan_ok=True)] * 4
    assert known[4:] == [18.0, 18.0]
    assert floor.at(0.0).deepest_m == 18.0


def test_reports_that_do_not_follow_one_another_make_no_floor() -> None:
    floor = FloorBelow(speed_mps=1.5, valid_s=3.0)
    for i in range(20):
        floor.hear(10.0 + 40.0 * (i % 2), 8.0, 0.5 * i)
    assert math.isnan(floor.at(9.5).shallowest_m)
    assert floor.settles(5.0)
    assert not floor.settles(6.0)


def test_a_false_depth_or_one_long_echo_makes_no_deeper_floor() -> None:
    for wrong in ((90.0, 8.0), (10.0, 60.0), (5000.0, 8.0)):
        floor, now_s = floor_after(*(wrong,) * 6)
        assert floor.at(now_s).shallowest_m == 18.0
        assert floor.counters["vehicle.floors_rejected"] == 6
        assert floor.at(now_s).deepest_m == sum(wrong)
        assert math.isnan(floor.at(now_s + 0.1).shallowest_m), "nor any floor, once the last good one is old"


def test_a_false_depth_that_lasts_is_followed_no_faster_than_a_floor_can_fall() -> None:
    floor, now_s = floor_after()
    believed = []
    for step in range(300):
        floor.hear(90.0, 8.0 + 0.01 * (step % 2), now_s + 0.5 * step)
        believed.append(floor.at(now_s + 0.5 * step).shallowest_m)
    first_s = 0.5 * next(step for step, floor_m in enumerate(believed) if floor_m > 18.0)
    assert first_s == pytest.approx((98.0 - 18.0 - 1.0) / (0.5 * 1.5), abs=3.0)


def test_small_steps_do_not_add_up_to_a_leap() -> None:
    floor, now_s = floor_after()
    for step in range(100):
        now_s += 0.1
        floor.hear(10.0 + 0.9 * step, 8.0 + 0.01 * (step % 2), now_s)
        assert not floor.at(now_s).shallowest_m > 18.0 + 1.0 + 0.75 * 0.1 * (step + 1)


def test_a_shallower_floor_counts_at_once_and_one_short_echo_is_over_with_it() -> None:
    floor, now_s = floor_after((10.0, 3.0))
    assert floor.at(now_s).shallowest_m == 13.0
    floor, now_s = floor_after((10.0, 3.0), *((10.0, 8.0),) * 6)
    assert floor.at(now_s).shallowest_m == 13.0
    floor.hear(10.0, 8.0, now_s + 0.5)
    assert floor.at(now_s + 0.5).shallowest_m == 18.0


def test_a_wall_is_followed_up_and_a_slope_down() -> None:
    floor, now_s = floor_after(*((10.0, 3.0),) * 40)
    assert floor.at(now_s).shallowest_m == 13.0
    floor, now_s = floor_after(*((10.0, 8.0 + 0.3 * step) for step in range(40)))
    assert floor.at(now_s).shallowest_m == pytest.approx(18.0 + 0.3 * 39 - 0.3 * 6)


def test_depth_and_altitude_of_two_moments_make_no_floor() -> None:
    floor = FloorBelow(speed_mps=1.5, valid_s=3.0)
    for i in range(40):
        floor.hear(*((10.0, NAN) if i % 2 else (NAN, 8.0)), 0.6 * i)
    assert math.isnan(floor.at(23.4).shallowest_m)
    assert math.isnan(floor.at(23.4).deepest_m)
    together = FloorBelow(speed_mps=1.5, valid_s=3.0)
    for i in range(40):
        together.hear(*((10.0, NAN) if i % 2 else (NAN, 8.0)), 0.3 * i)
    assert together.at(11.7).shallowest_m == 18.0


def test_an_altitude_that_stands_still_while_the_depth_changes_makes_no_floor() -> None:
    floor, now_s = floor_after(*((10.0 + 0.3 * step, 8.0) for step in range(40)))
    assert math.isnan(floor.at(now_s).shallowest_m)
    assert floor.counters["vehicle.altitudes_frozen"] > 30
    floor, now_s = floor_after(*((10.0 + 0.3 * step, 8.0) for step in range(10)), *((10.0, 8.0),) * 9)
    assert math.isnan(floor.at(now_s).shallowest_m), "it is still the same altitude"
    for step in range(7):
        floor.hear(10.0, 7.9 + 0.01 * step, now_s + 0.5 * step)
    assert floor.at(now_s + 3.0).shallowest_m == pytest.approx(17.9)


def test_an_altitude_that_stands_still_makes_no_deeper_floor_than_at_first() -> None:
    floor, now_s = floor_after(*((10.0 + 0.15 * step, 8.0) for step in range(7)), *((10.9, 8.0),) * 20)
    assert floor.at(now_s).shallowest_m == 18.0
    assert floor.at(now_s).deepest_m == pytest.approx(18.9)
    floor.hear(9.5, 8.0, now_s + 0.5)
    assert floor.at(now_s + 0.5).shallowest_m == 17.5


def test_a_depth_that_stands_still_makes_no_deeper_floor_for_six_seconds() -> None:
    floor, now_s = floor_after((10.1, 7.9), *((10.1, 7.9 + 0.2 * step) for step in range(1, 12)))
    assert floor.at(now_s).shallowest_m == pytest.approx(18.0)
    floor, now_s = floor_after((10.1, 7.9), *((10.1, 7.9 + 0.1 * step) for step in range(1, 25)))
    assert floor.at(now_s).shallowest_m > 19.0


def test_an_altitude_that_may_be_the_last_one_makes_no_deeper_floor() -> None:
    floor, now_s = floor_after((10.0, 8.5), *((10.0 + 0.02 * step, 8.5) for step in range(8)))
    assert floor.at(now_s).shallowest_m == pytest.approx(18.0)
    floor.hear(10.16, 8.4, now_s + 0.5)
    assert floor.at(now_s + 0.5).shallowest_m == pytest.approx(18.0)


def test_a_frozen_altitude_stays_frozen_after_a_spike_until_others_were_believed() -> None:
    frozen = tuple((10.0 + 0.3 * step, 8.0) for step in range(10))
    floor, now_s = floor_after(*frozen, (12.7, 6.0), *((12.7 + 0.1 * step, 8.0) for step in range(8)))
    assert math.isnan(floor.at(now_s).shallowest_m)
    alive = tuple((12.7 - 0.1 * step, 5.3 + 0.1 * step) for step in range(8))
    floor, now_s = floor_after(*frozen, *alive, (10.0, 8.0))
    assert floor.at(now_s).shallowest_m == pytest.approx(18.0), "the number alone is nothing"


def test_what_is_not_known_changes_nothing() -> None:
    floor, now_s = floor_after(*((NAN, NAN), (NAN, 5.0), (math.inf, 8.0), (-math.inf, 8.0)))
    assert floor.at(now_s).shallowest_m == 18.0, "an altitude of a second after the last depth is of another moment"


@pytest.mark.parametrize(("since_s", "holds_s", "wanted_m"), [(0.0, 0.0, 13.0), (4.0, 4.0, 7.0), (60.0, 5.0, 0.0)])
def test_a_safe_depth_stays_above_what_the_floor_can_have_risen_to(
    since_s: float, holds_s: float, wanted_m: float
) -> None:
    floor, now_s = floor_after()
    assert floor.safe_depth_m(5.0, now_s + since_s, holds_s) == pytest.approx(wanted_m)
    assert FloorBelow(speed_mps=1.5, valid_s=3.0).safe_depth_m(5.0, 0.0, 0.0) == 0.0
    assert BELIEVED_S < 4.0


def frozen(for_s: float, *, depth_m: float = 10.0, is_commanded: bool = True) -> tuple[FloorBelow, float]:
    """Report an altitude of 8 m to the digit, twice a second."""
    floor, now_s = FloorBelow(speed_mps=1.5, valid_s=3.0), 100.0
    for step in range(round(2.0 * for_s) + 1):
        now_s = 100.0 + 0.5 * step
        floor.hear(depth_m + 0.05 * (step % 2), 8.0, now_s, is_commanded=is_commanded)
    return floor, now_s


@pytest.mark.parametrize(("for_s", "doubt_m"), [(3.0, 0.0), (3.5, 0.5), (5.0, 1.5), (18.0, 11.5)])
def test_under_command_the_floor_rises_as_a_slope_allows_while_the_altitude_stands_still(
    for_s: float, doubt_m: float
) -> None:
    floor, now_s = frozen(for_s)
    assert floor.doubt_m == doubt_m
    assert floor.at(now_s).shallowest_m == 18.0 - doubt_m
    assert floor.at(now_s).deepest_m == pytest.approx(18.0, abs=0.1)
    assert floor.counters["vehicle.altitudes_doubted"] == (doubt_m > 0.0)
    assert floor.safe_depth_m(5.0, now_s, 0.0) == pytest.approx(max(13.0 - doubt_m, 0.0))


def test_another_digit_ends_the_doubt_and_15_s_of_it_the_floor() -> None:
    floor, now_s = frozen(18.0)
    floor.hear(10.0, 8.1, now_s + 0.5, is_commanded=True)
    assert (floor.doubt_m, floor.at(now_s + 0.5).shallowest_m) == (0.0, 18.0)
    floor, now_s = frozen(19.0)
    assert all(map(math.isnan, floor.at(now_s)))


def test_a_vehicle_that_is_not_commanded_may_hold_its_altitude_for_long_but_is_led_no_lower() -> None:
    floor, now_s = frozen(600.0, is_commanded=False)
    assert (floor.doubt_m, floor.at(now_s).shallowest_m) == (0.0, 18.0)
    assert floor.altitude_to_keep_m(5.0) == 8.0
    assert floor.altitude_to_keep_m(9.0) == 9.0
    floor.hear(10.0, 8.1, now_s + 0.5)
    assert floor.altitude_to_keep_m(5.0) == 5.0
