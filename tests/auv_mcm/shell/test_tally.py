"""Totals that a jump of the navigation does not spoil."""

from __future__ import annotations

import math

import numpy as np
import pytest

from auv_mcm.records import NAN, EchoTrace, NavSample, Ping
from auv_mcm.shell.tally import Tally

METRE_DEG = 1.0 / 111_194.9  # of latitude, on the way north


def fix(time_s: float, north_m: float, heading_rad: float = NAN) -> NavSample:
    return NavSample(time_s=time_s, latitude_deg=north_m * METRE_DEG, longitude_deg=179.9999, heading_rad=heading_rad)


def sailed(*samples: NavSample) -> Tally:
    tally = Tally()
    for sample in samples:
        tally.add(sample)
    return tally


def test_distance_is_the_sum_of_steps_without_jumps_holes_and_absent_positions() -> None:
    assert sailed(fix(0, 10), fix(1, 12), fix(2, 15)).distance_m == pytest.approx(5.0, rel=0.01)
    assert sailed(fix(0, 10), fix(1, 5000), fix(2, 5002)).distance_m == pytest.approx(2.0, rel=0.01), "a jump"
    assert sailed(fix(0, 10), fix(1, 11), fix(2, 5000)).distance_m == pytest.approx(1.0, rel=0.01), "the way before it"
    assert sailed(fix(0, 10), fix(500, 60), fix(501, 62)).distance_m == pytest.approx(2.0, rel=0.01), "a hole"
    gap = NavSample(time_s=1.0)
    zero = NavSample(time_s=1.0, latitude_deg=0.0, longitude_deg=0.0)
    leap = NavSample(time_s=1.0, latitude_deg=30.0 * METRE_DEG, longitude_deg=179.9999, position_leaps=True)
    nowhere = [NavSample(time_s=1.5, latitude_deg=lat, longitude_deg=lon) for lat, lon in ((91.0, 0.0), (0.0, 361.0))]
    tally = sailed(fix(0, 10), gap, zero, leap, fix(2, 12), *nowhere)
    assert tally.distance_m == pytest.approx(2.0, rel=0.01)
    assert tally.longitude_deg == 179.9999


def test_steps_of_coarse_positions_are_no_way_sailed() -> None:
    """A recorder that keeps 0.8 m of north, and of east: 190 m of a line of 147 m (colorado-river-455k)."""
    tally, step_m, n = Tally(), 0.8, 300
    for k in range(n):
        north_m, east_m = (step_m * round(0.3 * k / step_m), step_m * round((0.3 * k + 0.4) / step_m))
        tally.add(NavSample(time_s=0.3 * k, latitude_deg=north_m * METRE_DEG, longitude_deg=east_m * METRE_DEG + 1.0))
    assert tally.distance_m == pytest.approx(math.hypot(0.3, 0.3) * n, rel=0.03)
    assert tally.direction_rad == pytest.approx(math.pi / 4.0, abs=0.25)


def test_direction_is_the_heading_or_else_the_course() -> None:
    assert sailed(fix(0, 10, 1.0), fix(1, 12)).direction_rad == 1.0
    assert sailed(fix(0, 10), fix(1, 12)).direction_rad == pytest.approx(0.0, abs=1e-6)
    assert math.isnan(sailed(fix(0, 10)).direction_rad)


def test_duration_leaves_out_holes_and_steps_back() -> None:
    tally = Tally()
    for time_s in (100.0, 101.0, 100.5, 101.5, 9000.0, 9001.0, NAN):
        tally.add(Ping(number=0, time_s=time_s, port=None, starboard=None))
    assert tally.pings == 7
    assert tally.duration_s == 1.0 + 1.0 + 1.0
    assert (tally.first_s, tally.last_s) == (100.0, 9001.0)


def test_sub_apertures_of_one_pass_count_its_time_and_its_way_once() -> None:
    tally = Tally()
    for part in range(3):
        for k in range(41):
            tally.add(fix(float(k), 2.0 * k))
            tally.add(Ping(number=k, time_s=float(k), port=None, starboard=None, squint_rad=0.03 * (part - 1)))
    assert tally.duration_s == 40.0
    assert tally.distance_m == pytest.approx(80.0, rel=0.01)
    tally.add(Ping(number=0, time_s=50.0, port=None, starboard=None, squint_rad=0.1))
    assert tally.duration_s == 50.0, "another image, later"


def test_sides_of_one_pass_in_logs_of_their_own_count_its_time_and_its_way_once() -> None:
    tally, trace = Tally(), EchoTrace(samples=np.ones(4), first_range_m=0.1, spacing_m=0.1)
    for port, starboard in ((trace, None), (None, trace)):
        for k in range(41):
            tally.add(fix(float(k), 2.0 * k))
            tally.add(Ping(number=k, time_s=float(k), port=port, starboard=starboard))
    assert (tally.pings, tally.duration_s) == (82, 40.0)
    assert tally.distance_m == pytest.approx(80.0, rel=0.01)


@pytest.mark.parametrize("wrong_by_s", [0.0, 1e6])
def test_sides_in_messages_of_their_own_count_time_and_way_once_whatever_one_stamp_is(wrong_by_s: float) -> None:
    tally, trace = Tally(), EchoTrace(samples=np.ones(4), first_range_m=0.1, spacing_m=0.1)
    for k in range(41):
        tally.add(fix(float(k), 2.0 * k))
        for port, starboard in ((trace, None), (None, trace)):
            tally.add(Ping(number=k, time_s=k + wrong_by_s * (k == 10), port=port, starboard=starboard))
    assert (tally.first_s, tally.last_s, tally.duration_s) == (0.0, 40.0, 40.0)
    assert tally.distance_m == pytest.approx(80.0, rel=0.01)
