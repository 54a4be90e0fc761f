"""Poses between samples; what is missing is derived, or stays unknown and counted."""

from __future__ import annotations

import math
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.navigation import NavBuffer
from auv_mcm.records import NAN, NavSample
from auv_mcm.settings.config import NavigationConfig
from tests.auv_mcm.geometry.nav_samples import FRAME, HEADING_RAD, START_S, at, east_north, filled, here, only, without


def slow_value(times: list[float], values: list[float], t: float, config: NavigationConfig) -> tuple[float, bool]:
    """One quantity at one instant by looking at every sample; its value and whether it is stale."""
    before = [(t - s, v) for s, v in zip(times, values, strict=True) if s <= t]
    window = max(config.max_gap_s, config.max_extrapolation_s)
    after = [(s - t, v) for s, v in zip(times, values, strict=True) if t < s <= t + window]
    left, right = min(before, default=None), min(after, default=None)
    if left and right and left[0] + right[0] <= config.max_gap_s:
        return left[1] + (right[1] - left[1]) * left[0] / (left[0] + right[0]), False
    nearest = min((side for side in (left, right) if side), key=lambda side: side[0], default=None)
    return (nearest[1], nearest[0] > config.max_extrapolation_s) if nearest else (NAN, True)


@settings(max_examples=150, deadline=None)
@given(
    steps=st.lists(
        st.tuples(st.integers(1, 60), st.booleans(), st.booleans(), st.floats(-0.4, 0.4)), min_size=1, max_size=25
    ),
    queries=st.lists(st.integers(-100, 800), min_size=1, max_size=20),
    config=st.sampled_from([NavigationConfig(), NavigationConfig(max_extrapolation_s=1.5, max_gap_s=0.25)]),
)
def test_interpolation_equals_a_slow_one(
    steps: list[tuple[int, bool, bool, float]], queries: list[int], config: NavigationConfig
) -> None:
    """Times in sixteenths of a second, exact in binary, so that limits are met exactly too."""
    samples, fixes, headings, second, heading = [], [], [], 0.0, 3.0
    for step, has_fix, has_heading, turn in steps:
        second += step / 16
        heading += turn
        sample = here(
            second, east=2.0 * second, north=math.sin(second), heading_rad=math.remainder(heading, 2 * math.pi)
        )
        missing = (() if has_fix else ("latitude_deg", "longitude_deg")) + (() if has_heading else ("heading_rad",))
        samples.append(without(sample, *missing))
        if has_fix:
            fixes.append(second)
        if has_heading:
            headings.append((second, heading))
    track = at(filled(samples, config), *(query / 16 for query in queries))
    measured = east_north(track)
    for i, query in enumerate(queries):
        east, fix_stale = slow_value(fixes, [2.0 * s for s in fixes], query / 16, config)
        north, _ = slow_value(fixes, [math.sin(s) for s in fixes], query / 16, config)
        gap_s = min((b - a for a, b in pairwise(fixes) if a <= query / 16 < b), default=0.0)
        is_carried = bool(fixes) and second > fixes[-1] and query / 16 > fixes[-1]
        if config.max_gap_s < gap_s or is_carried:
            continue  # heading and speed may carry the position over it, tested below
        np.testing.assert_allclose(measured[i], [east, north], rtol=0, atol=1e-6)
        true_heading, heading_stale = slow_value([s for s, _ in headings], [h for _, h in headings], query / 16, config)
        if not heading_stale:  # otherwise course may stand in, tested below
            assert math.remainder(track.heading_rad[i] - true_heading, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
            assert bool(track.stale[i]) == fix_stale
        elif fix_stale:
            assert track.stale[i]


def test_every_quantity_is_linear_between_samples() -> None:
    second = here(
        1.0, east=4.0, pitch_rad=0.1, roll_rad=-0.2, depth_m=20.0, altitude_m=4.0, speed_mps=2.0, heading_rad=0.5
    )
    track = at(filled([here(0.0), second]), 0.0, 0.25, 1.0)
    np.testing.assert_allclose(track.pitch_rad, [0.0, 0.025, 0.1])
    np.testing.assert_allclose(track.roll_rad, [0.0, -0.05, -0.2])
    np.testing.assert_allclose(track.depth_m, [5.0, 8.75, 20.0])
    np.testing.assert_allclose(track.altitude_m, [6.0, 5.5, 4.0])
    np.testing.assert_allclose(track.speed_mps, [1.0, 1.25, 2.0])
    np.testing.assert_allclose(track.heading_rad, [0.0, 0.125, 0.5], atol=2e-9)
    np.testing.assert_allclose(east_north(track), [[0.0, 0.0], [1.0, 0.0], [4.0, 0.0]], atol=1e-6)
    assert not track.stale.any()


@pytest.mark.parametrize("turn_deg", [7.0, -7.0])
def test_heading_goes_through_north_without_a_jump(turn_deg: float) -> None:
    samples = [here(0.1 * i, heading_rad=math.radians(turn_deg * i) % (2 * math.pi)) for i in range(200)]
    track = filled(samples).interpolate(START_S + np.linspace(0.0, 19.9, 777))
    np.testing.assert_allclose(np.diff(track.heading_rad), math.radians(turn_deg) * 10 * 19.9 / 776, rtol=1e-5)


@pytest.mark.parametrize(
    "frame",
    [FRAME, LocalFrame(latitude_deg=-17.0, longitude_deg=179.9999), LocalFrame(latitude_deg=90.0, longitude_deg=0.0)],
)
def test_a_straight_run_stays_straight_anywhere(frame: LocalFrame) -> None:
    """Over the antimeridian and over the pole itself, fixes a second apart."""
    track = filled([here(i, east=2.0 * i - 40.0, north=1.0, frame=frame) for i in range(41)]).interpolate(
        START_S + np.linspace(0, 40, 401)
    )
    expected = np.stack((2.0 * np.linspace(0, 40, 401) - 40.0, np.ones(401)), axis=-1)
    np.testing.assert_allclose(east_north(track, frame), expected, rtol=0, atol=1e-6)
    assert track.longitude_deg.min() >= -180.0
    assert track.longitude_deg.max() < 180.0


def arc(seconds: float) -> NavSample:
    """A sample on a circle of 60 m at 1.5 m/s."""
    turned = 1.5 * seconds / 60.0
    return here(seconds, 60.0 * (1.0 - math.cos(turned)), 60.0 * math.sin(turned), heading_rad=turned, speed_mps=1.5)


def test_heading_and_speed_carry_the_position_while_no_fix_comes_and_no_longer() -> None:
    whole = [arc(0.1 * i) for i in range(500)]
    lost = [
        without(sample, "latitude_deg", "longitude_deg") if 100 < i < 350 else sample for i, sample in enumerate(whole)
    ]
    seconds = np.arange(0.0, 49.9, 0.05)
    track, reference = at(filled(lost), *seconds), at(filled(whole), *seconds)
    error_m = np.linalg.norm(east_north(track) - east_north(reference), axis=1)
    assert error_m[seconds < 25.0].max() < 1e-3
    assert seconds[track.stale].min() == pytest.approx(25.0, abs=0.1)
    assert seconds[track.stale].max() < 35.0
    assert (track.position_sigma_m[~track.stale] < 2.0).all()


@pytest.mark.parametrize("wrong", [{"heading_rad": 0.0}, {"speed_mps": 3.9}, {"speed_mps": 1.0}])
def test_a_heading_or_speed_that_positions_refute_carries_no_position(wrong: dict[str, float]) -> None:
    sound = (here(0.1 * i, east=0.2 * i, heading_rad=1.57, speed_mps=2.0) for i in range(700))
    samples = [msgspec.structs.replace(sample, **wrong) for sample in sound]
    seconds = np.arange(55.0, 69.0)
    lost = [without(sample, "latitude_deg", "longitude_deg") for sample in samples[601:]]
    track = at(filled([*samples[:601], *lost]), *seconds)
    off_m = np.abs(east_north(track)[:, 0] - 2.0 * seconds)
    assert (off_m <= track.position_sigma_m + 0.01).all()
    assert track.stale.tolist() == (seconds > 60.0).tolist()


@pytest.mark.parametrize(("held_s", "is_astern"), [(1.0, False), (3.0, False), (5.0, False), (3.0, True)])
def test_a_position_that_is_repeated_until_the_next_fix_is_measured_once(held_s: float, is_astern: bool) -> None:
    whole = [arc(0.1 * i) for i in range(500)]
    if is_astern:
        whole = [
            msgspec.structs.replace(sample, heading_rad=sample.heading_rad + math.pi, speed_mps=-1.5)
            for sample in whole
        ]
    step = round(held_s / 0.1)
    held = [
        msgspec.structs.replace(
            sample,
            latitude_deg=whole[i // step * step].latitude_deg,
            longitude_deg=whole[i // step * step].longitude_deg,
        )
        for i, sample in enumerate(whole)
    ]
    buffer = filled(held)
    seconds = np.arange(0.0, 44.9, 0.05)
    track = at(buffer, *seconds)
    assert np.abs(east_north(track) - east_north(at(filled(whole), *seconds))).max() < 0.1
    assert not track.stale.any()
    assert buffer.counters["navigation.position_repeated"] > 300


def test_a_position_in_coarse_steps_is_not_pushed_ahead_by_half_a_step() -> None:
    """Rounded to 1e-5 degrees, 1.1 and 0.8 m: where a step begins the true place is half of it behind."""
    whole = [here(0.1 * i, 0.05 * i, 0.12 * i, heading_rad=math.atan2(5, 12), speed_mps=1.3) for i in range(1000)]
    rounded = [
        msgspec.structs.replace(
            sample, latitude_deg=round(sample.latitude_deg, 5), longitude_deg=round(sample.longitude_deg, 5)
        )
        for sample in whole
    ]
    seconds = np.arange(20.0, 90.0, 0.05)
    error_m = east_north(at(filled(rounded), *seconds)) - east_north(at(filled(whole), *seconds))
    assert np.abs(error_m.mean(axis=0)).max() < 0.1


def test_a_vehicle_that_stands_has_a_position_all_the_time() -> None:
    buffer = filled([here(0.1 * i, speed_mps=0.1) for i in range(300)])
    track = at(buffer, *np.arange(0.0, 29.0, 0.5))
    assert not track.stale.any()
    assert not buffer.counters["navigation.position_repeated"]


def test_a_vehicle_that_stops_after_its_speed_is_lost_has_a_position() -> None:
    moving = [here(0.5 * i, east=0.5 * i) for i in range(60)]
    still = [without(here(0.5 * i, east=30.0), "speed_mps") for i in range(60, 160)]
    assert not at(filled(moving + still), *np.arange(50.0, 75.0, 0.5)).stale.any()


def test_stale_begins_just_beyond_half_a_second() -> None:
    buffer = filled([here(0.0), here(10.0, east=10.0)])
    track = at(buffer, -0.5001, -0.5, 0.5, 0.5001, 9.4999, 9.5, 10.5, 10.5001)
    assert track.stale.tolist() == [True, False, False, True, True, False, False, True]
    np.testing.assert_allclose(east_north(track)[:, 0], [0, 0, 0, 0, 10, 10, 10, 10], atol=1e-6)


def test_a_gap_is_bridged_up_to_two_seconds() -> None:
    assert not at(filled([here(0.0), here(2.0, east=4.0)]), 1.0).stale[0]
    assert east_north(at(filled([here(0.0), here(2.0, east=4.0)]), 1.0))[0, 0] == pytest.approx(2.0, abs=1e-6)
    longer = at(filled([here(0.0), here(2.01, east=4.0)]), 0.9, 1.1)
    assert longer.stale.all()
    np.testing.assert_allclose(east_north(longer)[:, 0], [0.0, 4.0], atol=1e-6)


def test_halfway_through_a_hole_the_earlier_value_counts() -> None:
    assert east_north(at(filled([here(0.0), here(3.0, east=4.0)]), 1.5))[0, 0] == pytest.approx(0.0, abs=1e-6)


def test_nothing_is_extrapolated() -> None:
    track = at(filled([here(0.0), here(1.0, east=1.0, heading_rad=0.1, depth_m=6.0)]), 1.4, 30.0, -1.0)
    np.testing.assert_allclose(east_north(track)[:, 0], [1.0, 1.0, 0.0], atol=1e-6)
    assert track.heading_rad.tolist() == [0.1, 0.1, HEADING_RAD]
    assert track.depth_m.tolist() == [6.0, 6.0, 5.0]
    assert track.stale.tolist() == [False, True, True]


def test_an_empty_buffer_holds_nothing() -> None:
    buffer = NavBuffer(NavigationConfig())
    track = at(buffer, 0.0, 1.0)
    for name in ("latitude_deg", "longitude_deg", "heading_rad", "depth_m", "speed_mps", "altitude_m"):
        assert np.isnan(getattr(track, name)).all(), name
    assert track.pitch_rad.tolist() == track.roll_rad.tolist() == [0.0, 0.0]
    assert track.stale.all()
    assert buffer.ready_until_s == -math.inf
    assert len(buffer.interpolate(np.empty(0))) == 0


def test_quantities_measured_at_different_rates_are_interpolated_each_by_itself() -> None:
    samples = []
    for i in range(21):
        sample = here(0.1 * i, east=0.2 * i, heading_rad=0.01 * i)
        samples.append(sample if i % 10 == 0 else without(sample, "latitude_deg", "longitude_deg", "depth_m"))
    track = at(filled(samples), 0.55, 1.73)
    np.testing.assert_allclose(track.heading_rad, [0.055, 0.173], rtol=1e-5)
    np.testing.assert_allclose(east_north(track)[:, 0], [1.1, 3.46], atol=2e-6)
    assert not track.stale.any()


def test_samples_at_the_same_instant_are_merged_and_the_first_value_stays() -> None:
    buffer = filled([only(0.0, heading_rad=1.0), here(0.0, east=3.0, heading_rad=2.0)])
    track = at(buffer, 0.0)
    assert track.heading_rad[0] == 1.0
    assert east_north(track)[0, 0] == pytest.approx(3.0, abs=1e-6)
    assert buffer.counters["navigation.time_repeated"] == 1


def test_missing_attitude_is_level_and_reported_once() -> None:
    buffer = filled(without(here(i, east=i), "pitch_rad", "roll_rad", "depth_m") for i in range(5))
    for _ in range(3):
        track = at(buffer, 1.0, 2.0)
    assert track.pitch_rad.tolist() == track.roll_rad.tolist() == [0.0, 0.0]
    assert np.isnan(track.depth_m).all()
    assert buffer.counters == {"navigation.pitch_absent": 1, "navigation.roll_absent": 1}


@pytest.mark.parametrize("heading_deg", [0.0, 45.0, 179.9, 270.0])
@pytest.mark.parametrize("frame", [FRAME, LocalFrame(latitude_deg=70.0, longitude_deg=-179.9999)])
def test_missing_heading_and_speed_come_from_the_fixes(heading_deg: float, frame: LocalFrame) -> None:
    """1.5 m/s, ten fixes a second, rounded to 1e-6 degree as recorders do (0.1 m)."""
    sine, cosine = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
    samples = []
    for i in range(300):
        fix = without(
            here(0.1 * i, east=0.15 * i * sine, north=0.15 * i * cosine, frame=frame), "heading_rad", "speed_mps"
        )
        rounded = {name: round(getattr(fix, name), 6) for name in ("latitude_deg", "longitude_deg")}
        samples.append(msgspec.structs.replace(fix, **rounded))
    buffer = filled(samples)
    track = buffer.interpolate(START_S + np.linspace(0.0, 29.9, 100))
    error = [math.remainder(heading - math.radians(heading_deg), 2 * math.pi) for heading in track.heading_rad]
    assert np.abs(error).max() < math.radians(6.0)
    assert abs(np.mean(error)) < math.radians(0.6)
    assert np.abs(np.diff(track.heading_rad)).max() < math.radians(10.0)
    np.testing.assert_allclose(track.speed_mps, 1.5, rtol=0.1)
    assert np.mean(track.speed_mps) == pytest.approx(1.5, rel=0.01)
    assert not track.stale.any()
    assert buffer.counters["navigation.heading_from_course"] == 100
    assert buffer.counters["navigation.speed_from_fixes"] == 100


def test_course_follows_a_circle_without_lag_and_without_jumps() -> None:
    radius, speed = 20.0, 1.5
    angle = speed / radius * 0.2 * np.arange(700)  # more than one turn
    samples = [
        without(here(0.2 * i, east=radius * math.sin(a), north=radius * math.cos(a)), "heading_rad")
        for i, a in enumerate(angle)
    ]
    track = filled(samples).interpolate(START_S + np.linspace(5.0, 130.0, 500))
    expected = math.pi / 2 + speed / radius * np.linspace(5.0, 130.0, 500)
    np.testing.assert_allclose(track.heading_rad - track.heading_rad[0], expected - expected[0], atol=math.radians(1.0))
    assert math.remainder(track.heading_rad[0] - expected[0], 2 * math.pi) == pytest.approx(0.0, abs=math.radians(1.0))


def test_a_vehicle_that_stands_has_no_course_but_a_speed() -> None:
    buffer = filled(without(here(0.5 * i), "heading_rad", "speed_mps") for i in range(60))
    track = at(buffer, 10.0)
    assert np.isnan(track.heading_rad[0])
    assert track.stale[0]
    assert track.speed_mps[0] == pytest.approx(0.0, abs=1e-9)


def test_a_compass_that_fails_is_replaced_by_the_course_and_counted() -> None:
    samples = [here(0.2 * i, east=0.3 * i, heading_rad=math.radians(95.0)) for i in range(100)]
    samples += [without(here(20.0 + 0.2 * i, east=30.0 + 0.3 * i), "heading_rad") for i in range(100)]
    buffer = filled(samples)
    track = at(buffer, 10.0, 19.9, 30.0)
    # meridians converge a little
    np.testing.assert_allclose(np.rad2deg(track.heading_rad), [95.0, 95.0, 90.0], atol=1e-3)
    assert not track.stale.any()
    assert buffer.counters["navigation.heading_from_course"] == 1
    # A current of 0.25 m/s from the side turns a track of 1.5 m/s.
    np.testing.assert_allclose(track.heading_sigma_rad, [0.0, 0.0, math.atan(0.25 / 1.5)], atol=1e-6)


def test_heading_stays_continuous_when_the_compass_fails_for_some_turns_and_comes_back() -> None:
    radius, speed = 20.0, 1.5
    samples = []
    for i in range(2000):
        angle = speed / radius * 0.2 * i
        sample = here(
            0.2 * i,
            east=radius * math.sin(angle),
            north=radius * math.cos(angle),
            heading_rad=(angle + math.pi / 2) % (2 * math.pi),
        )
        samples.append(without(sample, "heading_rad") if 1000 <= i < 1700 else sample)
    track = filled(samples).interpolate(START_S + np.linspace(0.0, 390.0, 2000))
    np.testing.assert_allclose(np.diff(track.heading_rad), speed / radius * 390.0 / 1999, atol=math.radians(3.0))


def test_heading_of_a_vehicle_that_drifts_astern_does_not_spin() -> None:
    samples = [here(0.5 * i, north=-0.5 * i, heading_rad=0.1 * math.sin(i)) for i in range(100)]
    assert np.abs(filled(samples).interpolate(START_S + np.linspace(0.0, 49.5, 300)).heading_rad).max() <= 0.1


def test_fixes_that_scatter_make_no_great_speed() -> None:
    samples = [without(here(0.02 * i, east=2.8 * (i % 2)), "heading_rad", "speed_mps") for i in range(200)]
    assert filled(samples).interpolate(START_S + np.linspace(0.0, 3.9, 50)).speed_mps.max() < 6.0


def test_a_new_place_makes_no_speed() -> None:
    samples = [without(here(0.5 * i, east=0.5 * i + 1000.0 * (i >= 20)), "heading_rad", "speed_mps") for i in range(40)]
    track = filled(samples).interpolate(START_S + np.linspace(0.0, 19.5, 100))
    np.testing.assert_allclose(track.speed_mps, 1.0, atol=1e-3)
    np.testing.assert_allclose(track.heading_rad, math.pi / 2, atol=1e-3)


@pytest.mark.parametrize(("stated_m", "added_m"), [(NAN, 0.0), (0.8, 0.0), (1.25, 0.75), (20.0, math.sqrt(399.0))])
def test_a_sigma_that_a_source_states_counts_where_it_is_more_than_the_configured_one(
    stated_m: float, added_m: float
) -> None:
    buffer = filled(here(t, north=t, position_sigma_m=stated_m) for t in range(20))
    assert at(buffer, 9.5).position_sigma_m == pytest.approx([added_m])


def test_no_position_at_all_is_stale_not_zero() -> None:
    buffer = filled(only(0.1 * i, heading_rad=1.0) for i in range(10))
    track = at(buffer, 0.5)
    assert np.isnan(track.latitude_deg[0])
    assert track.stale[0]
    assert track.heading_rad[0] == 1.0
