"""Navigation that goes wrong slowly, or as a whole, is reported; sound navigation is not."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from auv_mcm.frozen_state import freeze, thaw
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.navigation_watch import NavigationWatch
from auv_mcm.records import NavSample

HERE = LocalFrame(latitude_deg=54.0, longitude_deg=10.0)
START_S = 1.7e9
RATE_HZ = 8.0


def line(
    n: int = 320, speed_mps: float = 1.5, course_deg: float = 20.0, noise_m: float = 0.0, seed: int = 1
) -> list[NavSample]:
    """A straight line at a steady speed."""
    random = np.random.Generator(np.random.PCG64(seed))
    samples = []
    for number in range(n):
        way_m = speed_mps * number / RATE_HZ
        east_m, north_m = (way_m * f(math.radians(course_deg)) for f in (math.sin, math.cos))
        east_m, north_m = np.array([east_m, north_m]) + noise_m * random.standard_normal(2)
        latitude_deg, longitude_deg, _ = HERE.to_geodetic([east_m, north_m, 0.0])
        samples.append(
            NavSample(
                time_s=START_S + number / RATE_HZ,
                latitude_deg=float(latitude_deg),
                longitude_deg=float(longitude_deg),
                heading_rad=math.radians(course_deg),
                speed_mps=speed_mps,
                depth_m=10.0,
                altitude_m=6.0,
            )
        )
    return samples


def codes(samples: list[NavSample]) -> list[str]:
    watch = NavigationWatch()
    return [notice.code for sample in samples for notice in watch.add(sample)]


def heading_drifts(number: int, sample: NavSample) -> NavSample:
    return structs.replace(sample, heading_rad=sample.heading_rad + math.radians(2.0 * number / RATE_HZ))


FROZEN = line()[100]
LIES: dict[str, Callable[[int, NavSample], NavSample]] = {
    "navigation.heading_drifts": heading_drifts,
    "navigation.position_frozen": lambda number, sample: (
        structs.replace(sample, latitude_deg=FROZEN.latitude_deg, longitude_deg=FROZEN.longitude_deg)
        if 100 <= number < 252
        else sample
    ),
    "navigation.time_leapt": lambda number, sample: structs.replace(
        sample, time_s=sample.time_s + (3600.0 if number >= 160 else 0.0)
    ),
    "navigation.altitude_negative": lambda number, sample: structs.replace(sample, altitude_m=-6.0),
    "navigation.heading_impossible": lambda number, sample: structs.replace(
        sample, heading_rad=math.degrees(sample.heading_rad)
    ),
    "navigation.depth_negative": lambda number, sample: structs.replace(sample, depth_m=-40.0),
}


@pytest.mark.parametrize("code", LIES)
@pytest.mark.parametrize("noise_m", [0.0, 0.1])
def test_what_goes_wrong_slowly_or_as_a_whole_is_reported_once(code: str, noise_m: float) -> None:
    if code == "navigation.position_frozen":
        noise_m = 0.0
    lying = [LIES[code](number, sample) for number, sample in enumerate(line(noise_m=noise_m))]
    assert codes(lying) == [code]


@pytest.mark.parametrize(("noise_m", "found"), [(0.0, []), (0.05, []), (0.3, ["navigation.course_scattered"])])
def test_positions_that_scatter_are_reported_where_the_course_stands_for_the_heading(
    noise_m: float, found: list[str]
) -> None:
    without = [structs.replace(sample, heading_rad=math.nan) for sample in line(noise_m=noise_m)]
    assert codes(without) == found
    assert codes(line(noise_m=noise_m)) == []


def test_a_position_that_stands_still_for_14_s_at_3_mps_is_reported_live() -> None:
    """Each quantity in a sample of its own, as a live merge gives them."""
    samples, on_line = [], line(n=200, speed_mps=3.0)
    for number, whole in enumerate(on_line):
        at = on_line[50] if 50 <= number < 50 + 14 * RATE_HZ else whole
        for fields in (("latitude_deg", "longitude_deg"), ("heading_rad",), ("speed_mps",)):
            samples.append(NavSample(time_s=whole.time_s, **{name: getattr(at, name) for name in fields}))
    assert codes(samples) == ["navigation.position_frozen"]


def test_a_position_that_stands_still_is_reported_though_a_compass_comes_more_often() -> None:
    samples = []
    for number, whole in enumerate(line(n=400, speed_mps=3.0)):
        if number % RATE_HZ == 0.0:
            place = FROZEN if 48 <= number < 48 + 30 * RATE_HZ else whole
            samples.append(structs.replace(place, time_s=whole.time_s, heading_rad=math.nan, speed_mps=math.nan))
        samples.append(NavSample(time_s=whole.time_s + 0.05, heading_rad=whole.heading_rad, speed_mps=whole.speed_mps))
    assert codes(samples) == ["navigation.position_frozen"]


@pytest.mark.parametrize("before_rad", [math.nan, 0.0])
def test_a_compass_that_comes_or_was_away_during_a_turn_does_not_drift(before_rad: float) -> None:
    samples = line(course_deg=35.0)
    silent = [structs.replace(sample, heading_rad=math.nan) for sample in samples[:120]]
    silent[0] = structs.replace(silent[0], heading_rad=before_rad)
    assert codes(silent + samples[120:]) == []


@given(
    st.floats(0.5, 3.0),
    st.floats(0.0, 360.0),
    st.floats(0.0, 0.2),
    st.floats(-30.0, 30.0),
    st.sampled_from(["line", "lawnmower", "circle", "sparse", "pause"]),
    st.integers(0, 1000),
)
@settings(max_examples=40)
def test_sound_navigation_is_never_reported(
    speed_mps: float, course_deg: float, noise_m: float, crab_deg: float, pattern: str, seed: int
) -> None:
    """Lines, turns in a current, fixes every 5 s, and a pause between two legs."""
    random = np.random.Generator(np.random.PCG64(seed))
    east_m = north_m = 0.0
    states, time_s = [], START_S
    current = np.array([math.sin(seed), math.cos(seed)]) * abs(crab_deg) / 60.0 * 0.5 * speed_mps
    given_m = np.zeros(2)
    for number in range(800):
        at_s = number / RATE_HZ
        turned_deg = {"lawnmower": min(max(at_s - 40.0, 0.0) * 9.0, 180.0), "circle": at_s * 4.0}.get(pattern, 0.0)
        heading_rad = math.radians(course_deg + turned_deg)
        velocity = speed_mps * np.array([math.sin(heading_rad), math.cos(heading_rad)]) + current
        east_m, north_m = np.array([east_m, north_m]) + velocity / RATE_HZ
        time_s += 1.0 / RATE_HZ
        if pattern == "pause" and number == 400:
            time_s, east_m = time_s + 1800.0, east_m + 300.0
        if pattern != "sparse" or number % 40 == 0:
            given_m = np.array([east_m, north_m]) + noise_m * random.standard_normal(2)
        states.append((time_s, *given_m, heading_rad, float(np.hypot(*velocity))))
    table = np.array(states)
    latitudes_deg, longitudes_deg, _ = HERE.to_geodetic(np.column_stack([table[:, 1:3], np.zeros(len(table))]))
    samples = [
        NavSample(
            time_s=float(state[0]),
            latitude_deg=float(latitude_deg),
            longitude_deg=float(longitude_deg),
            heading_rad=float(state[3]) % math.tau,
            speed_mps=float(state[4]),
            altitude_m=5.0,
            depth_m=-0.5,
        )
        for state, latitude_deg, longitude_deg in zip(table, latitudes_deg, longitudes_deg, strict=True)
    ]
    assert codes(samples) == []


def test_a_line_flown_back_after_a_turn_that_was_not_logged_is_no_clock_that_was_set() -> None:
    there = line(160)
    back = [
        structs.replace(
            sample, time_s=there[-1].time_s + 600.0 + number / RATE_HZ, heading_rad=sample.heading_rad + math.pi
        )
        for number, sample in enumerate(reversed(there))
    ]
    assert codes(there + back) == []


def test_a_restart_goes_on_watching() -> None:
    lying = [heading_drifts(number, sample) for number, sample in enumerate(line())]
    whole, first = NavigationWatch(), NavigationWatch()
    expected = [notice for sample in lying for notice in whole.add(sample)]
    found = [notice for sample in lying[:150] for notice in first.add(sample)]
    again = thaw(freeze(first, {}), {})
    found += [notice for sample in lying[150:] for notice in again.add(sample)]
    assert found == expected


def test_headings_without_positions_take_no_memory() -> None:
    watch = NavigationWatch()
    for sample in line(80):
        watch.add(sample)
    n_bytes = len(freeze(watch, {}))
    for number in range(5000):
        watch.add(NavSample(time_s=START_S + 10.0 + 0.01 * number, heading_rad=0.3 + 1e-5 * number))
    assert len(freeze(watch, {})) < n_bytes + 100
