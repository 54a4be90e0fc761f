from __future__ import annotations

import math
import tracemalloc
from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.geometry.bridging import MAX_HOLE_S
from auv_mcm.geometry.geodesy import LocalFrame, geodetic_to_ecef
from auv_mcm.geometry.navigation import NavBuffer
from auv_mcm.geometry.pose_track import interpolate_track
from auv_mcm.records import NAN, NavSample, PoseTrack
from auv_mcm.settings.config import NavigationConfig

START_S = 1_700_000_000.0
FRAME = LocalFrame(latitude_deg=43.7, longitude_deg=10.3)
HEADING_RAD = 1e-9  # a compass never reads exactly 0 for long: that is a field which was never filled
POSE_FIELDS = tuple(name for name in PoseTrack.__struct_fields__ if name != "time_s")


def filled(samples: Iterable[NavSample], config: NavigationConfig | None = None) -> NavBuffer:
    buffer = NavBuffer(config or NavigationConfig())
    for sample in samples:
        buffer.add(sample)
    return buffer


def at(buffer: NavBuffer, *seconds: float) -> PoseTrack:
    return buffer.interpolate(START_S + np.array(seconds))


def here(
    seconds: float, east: float = 0.0, north: float = 0.0, frame: LocalFrame = FRAME, **values: float
) -> NavSample:
    """A full sample `seconds` after the start at a local position."""
    latitude, longitude, _ = frame.to_geodetic(np.array([east, north, 0.0]))
    known: dict[str, Any] = {
        "heading_rad": HEADING_RAD,
        "pitch_rad": 0.0,
        "roll_rad": 0.0,
        "depth_m": 5.0,
        "altitude_m": 6.0,
        "speed_mps": 1.0,
        **values,
    }
    return NavSample(time_s=START_S + seconds, latitude_deg=float(latitude), longitude_deg=float(longitude), **known)


def without(sample: NavSample, *names: str) -> NavSample:
    return msgspec.structs.replace(sample, **dict.fromkeys(names, NAN))


def only(seconds: float, **values: Any) -> NavSample:
    return NavSample(time_s=START_S + seconds, **values)


def east_north(track: PoseTrack, frame: LocalFrame = FRAME) -> NDArray[np.float64]:
    return frame.to_enu(track.latitude_deg, track.longitude_deg, 0.0)[:, :2]


def assert_same(a: PoseTrack, b: PoseTrack) -> None:
    for name in POSE_FIELDS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


# --- interpolation ---------------------------------------------------------------------------------------------------


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
        is_sparse = any(config.max_gap_s < b - a for a, b in pairwise(fixes))
        if config.max_gap_s < gap_s <= MAX_HOLE_S or (is_sparse and query / 16 > fixes[-1]):
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


# --- what is missing -------------------------------------------------------------------------------------------------


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
    np.testing.assert_allclose(
        np.rad2deg(track.heading_rad), [95.0, 95.0, 90.0], atol=1e-3
    )  # meridians converge a little
    assert not track.stale.any()
    assert buffer.counters["navigation.heading_from_course"] == 1


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


def test_no_position_at_all_is_stale_not_zero() -> None:
    buffer = filled(only(0.1 * i, heading_rad=1.0) for i in range(10))
    track = at(buffer, 0.5)
    assert np.isnan(track.latitude_deg[0])
    assert track.stale[0]
    assert track.heading_rad[0] == 1.0


# --- what cannot be true ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bad", "counter"),
    [
        ({"latitude_deg": 0.0, "longitude_deg": 0.0}, "navigation.position_zero"),
        ({"latitude_deg": math.inf}, "navigation.not_finite"),
        ({"latitude_deg": NAN}, "navigation.not_finite"),
        ({"latitude_deg": 90.001}, "navigation.position_out_of_range"),
        ({"longitude_deg": -180.5}, "navigation.position_out_of_range"),
        ({"longitude_deg": 361.0}, "navigation.position_out_of_range"),
        ({"latitude_deg": 43.71}, "navigation.position_jump"),
        ({"heading_rad": math.inf}, "navigation.not_finite"),
        ({"heading_rad": 300.0}, "navigation.heading_out_of_range"),
        ({"pitch_rad": 2.0}, "navigation.pitch_out_of_range"),
        ({"roll_rad": -4.0}, "navigation.roll_out_of_range"),
        ({"depth_m": 1e5}, "navigation.depth_out_of_range"),
        ({"depth_m": -math.inf}, "navigation.not_finite"),
        ({"altitude_m": 0.0}, "navigation.altitude_out_of_range"),
        ({"speed_mps": 900.0}, "navigation.speed_out_of_range"),
    ],
)
def test_an_impossible_quantity_is_refused_alone_and_counted(bad: dict[str, float], counter: str) -> None:
    good = [here(i, east=i) for i in range(3)]
    buffer = filled([good[0], msgspec.structs.replace(good[1], **bad), good[2]])
    track, reference = at(buffer, 0.3, 1.0, 1.8), at(filled(good), 0.3, 1.0, 1.8)
    assert {name: n for name, n in buffer.counters.items() if name != "navigation.zero_with_position"} == {counter: 1}
    np.testing.assert_allclose(east_north(track), east_north(reference), atol=1e-6)
    for name in POSE_FIELDS:
        np.testing.assert_allclose(getattr(track, name), getattr(reference, name), atol=1e-9, err_msg=name)


def test_an_all_zero_record_measures_nothing() -> None:
    """The first record of some logs: position, heading and altitude zero, the rest filled."""
    empty = only(0.0, latitude_deg=0.0, longitude_deg=0.0, heading_rad=0.0, altitude_m=0.0, pitch_rad=0.02)
    buffer = filled([empty, here(0.1, heading_rad=2.0)])
    track = at(buffer, 0.0)
    assert track.heading_rad[0] == 2.0
    assert east_north(track)[0] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert track.altitude_m[0] == 6.0
    assert track.pitch_rad[0] == 0.02
    assert not track.stale[0]
    assert buffer.counters == {"navigation.position_zero": 1, "navigation.zero_with_position": 2}


def test_longitudes_counted_eastward_to_360_are_understood() -> None:
    sample = msgspec.structs.replace(here(0.0), longitude_deg=350.0)
    assert at(filled([sample]), 0.0).longitude_deg[0] == pytest.approx(-10.0, abs=1e-9)


def test_a_sample_from_the_past_changes_nothing() -> None:
    good = [here(i, east=i) for i in range(5)]
    buffer = filled([*good[:4], here(1.5, east=99.0, heading_rad=3.0), here(2.9, east=-50.0), good[4]])
    assert buffer.counters == {"navigation.time_backwards": 2}
    assert_same(at(buffer, 0.5, 1.5, 3.9), at(filled(good), 0.5, 1.5, 3.9))


@pytest.mark.parametrize("stamp", [NAN, math.inf, -math.inf])
def test_a_sample_without_a_time_is_refused(stamp: float) -> None:
    buffer = filled([here(0.0), NavSample(time_s=stamp, heading_rad=1.0), here(1.0)])
    assert buffer.counters == {"navigation.time_not_finite": 1}
    assert at(buffer, 0.5).heading_rad[0] == HEADING_RAD


@pytest.mark.parametrize("position", [0, 1, 5])
@pytest.mark.parametrize("leap_s", [3600.0, 5e8])
def test_one_time_stamp_from_the_future_does_not_silence_the_source(position: int, leap_s: float) -> None:
    good = [here(0.5 * i, east=i) for i in range(10)]
    dirty = list(good)
    dirty.insert(position, msgspec.structs.replace(here(leap_s), depth_m=77.0))
    buffer = filled(dirty)
    assert buffer.counters == {"navigation.time_leap": 1}
    assert_same(at(buffer, 0.2, 2.2, 4.4), at(filled(good), 0.2, 2.2, 4.4))


def test_a_pause_of_an_hour_is_accepted_when_a_second_sample_confirms_it() -> None:
    buffer = filled([here(0.0), here(1.0), here(3600.0, east=500.0), here(3601.0, east=502.0)])
    assert not buffer.counters
    assert east_north(at(buffer, 3600.5))[0, 0] == pytest.approx(501.0, abs=1e-5)


def test_a_clock_set_back_an_hour_gives_stale_poses_not_wrong_ones() -> None:
    samples = [here(3600.0 + i, east=i) for i in range(5)] + [here(5.0 + i, east=5.0 + i) for i in range(5)]
    buffer = filled(samples)
    assert buffer.counters == {"navigation.time_backwards": 5}
    assert at(buffer, 6.0, 8.0).stale.all()


def steady(n: int, *, first: int = 0, period_s: float = 0.5, east: float = 0.0, north: float = 0.0) -> list[NavSample]:
    """Fixes of a vehicle going east at 1 m/s, displaced."""
    return [here(period_s * i, east=period_s * i + east, north=north) for i in range(first, first + n)]


def test_a_jump_is_refused_until_fixes_agree_long_enough() -> None:
    before, after = steady(20), steady(10, first=20, east=1000.0)
    buffer = filled(before + after[:9])
    assert buffer.counters == {}
    assert buffer.take_notices() == []
    assert buffer.ready_until_s < after[0].time_s
    buffer.add(after[9])
    assert buffer.counters == {"navigation.position_refix": 1}
    (notice,) = buffer.take_notices()
    assert notice.code == "nav_position_jump"
    assert "1000 m" in notice.text or "1001 m" in notice.text
    assert notice.place == "2023-11-14 22:13:30 UTC"
    track = at(buffer, 9.5, 9.7, 9.8, 10.0, 12.25)
    np.testing.assert_allclose(east_north(track)[:, 0], [9.5, 9.5, 1010.0, 1010.0, 1012.25], atol=1e-6)
    assert not track.stale.any()
    assert buffer.n_steps_before(track.time_s).tolist() == [0, 0, 1, 1, 1]
    assert track.position_sigma_m[0] == 0.0
    assert track.position_sigma_m[-1] == pytest.approx(1000.0, abs=10.0), (
        "which of the two places is right is not known yet"
    )
    for sample in steady(40, first=30, east=1000.0):
        buffer.add(sample)
    assert at(buffer, 34.0).position_sigma_m[0] == 0.0


@pytest.mark.parametrize("displacement_m", [50.0, 1_000.0, 55_000.0, 5_000_000.0])
@pytest.mark.parametrize("n_wrong", [1, 3, 20])
def test_an_excursion_that_comes_back_is_never_accepted(displacement_m: float, n_wrong: int) -> None:
    good = steady(200, period_s=0.1)
    dirty = list(good)
    dirty[100 : 100 + n_wrong] = steady(n_wrong, first=100, period_s=0.1, north=displacement_m)
    buffer = filled(dirty)
    assert buffer.counters == {"navigation.position_jump": n_wrong}
    places = east_north(at(buffer, *np.arange(5.0, 18.0, 0.07)))
    np.testing.assert_allclose(places[:, 1], 0.0, atol=1e-3)
    codes = [notice.code for notice in buffer.take_notices()]
    assert codes == (["navigation.positions_rejected"] if n_wrong == 20 else [])


@pytest.mark.parametrize("n_wrong", [1, 5])
def test_wrong_first_fixes_do_not_outvote_the_later_ones(n_wrong: int) -> None:
    """460 of 461 good fixes were refused after one wrong one."""
    samples = steady(n_wrong, north=8e6) + steady(40, first=n_wrong)
    buffer = filled(samples)
    assert buffer.counters == {"navigation.position_jump": n_wrong}
    track = at(buffer, *np.arange(3.0, 20.0, 0.3))
    np.testing.assert_allclose(east_north(track)[:, 1], 0.0, atol=1e-3)
    assert not track.stale.any()
    assert (track.position_sigma_m == 0.0).all()


def test_after_a_wrong_first_fix_and_two_places_in_turn_the_position_is_disputed() -> None:
    """A log whose first fix is far off and of whose others every second one is 1.1 km off."""
    samples = [here(0.0, east=8e6), *(here(0.5 * i, east=0.5 * i, north=1100.0 * (i % 2)) for i in range(1, 100))]
    buffer = filled(samples)
    assert buffer.counters["navigation.position_jump"] >= 49
    track = at(buffer, *np.arange(6.0, 45.0, 0.3))
    assert (np.abs(east_north(track)[:, 0]) < 60.0).all(), "never at the first fix, never half-way"
    assert len(set(np.round(east_north(track)[:, 1]).tolist()) & {0.0, 1100.0}) == 1, "at one of the places throughout"
    assert track.stale.all()
    assert (track.position_sigma_m > 1000.0).all()
    assert [notice.code for notice in buffer.take_notices()] == [
        "navigation.position_disputed",
        "navigation.positions_rejected",
    ]


@pytest.mark.parametrize("seed", range(5))
def test_half_of_all_fixes_wrong_is_reported_and_shows_in_the_sigma(seed: int) -> None:
    wrong = np.random.default_rng(seed).random(200) < 0.5
    buffer = filled(here(0.5 * i, east=0.5 * i, north=1100.0 * wrong[i]) for i in range(200))
    track = at(buffer, *np.arange(10.0, 95.0, 0.3))
    north = east_north(track)[:, 1]
    off = np.minimum(np.abs(north), np.abs(north - 1100.0))
    assert off.max() < 1.0, "at one of the two places, never between them"
    assert (track.position_sigma_m > 1000.0).mean() > 0.9
    codes = {notice.code for notice in buffer.take_notices()}
    assert {"navigation.position_disputed", "navigation.positions_rejected"} <= codes


def test_a_better_track_takes_over_although_the_worse_one_goes_on() -> None:
    samples = steady(40) + [here(0.5 * i, east=0.5 * i, north=0.0 if i % 4 == 0 else 800.0) for i in range(40, 160)]
    buffer = filled(samples)
    assert buffer.counters["navigation.position_refix"] == 1
    assert east_north(at(buffer, 75.1))[0, 1] == pytest.approx(800.0, abs=1e-3)


def test_the_age_of_a_position_shows_in_its_sigma() -> None:
    buffer = filled([*steady(20), *(only(10.0 + i, heading_rad=0.0, speed_mps=2.0) for i in range(100))])
    track = at(buffer, 9.0, 60.0, 105.0)
    assert track.stale.tolist() == [False, True, True]
    np.testing.assert_allclose(track.position_sigma_m, [0.0, 2.0 * 50.5, 2.0 * 95.5])


def test_sparse_fixes_are_followed_to_another_place_too() -> None:
    samples = [here(20.0 * i, east=20.0 * i + (5000.0 if i >= 10 else 0.0)) for i in range(20)]
    buffer = filled(samples)
    assert buffer.counters["navigation.position_refix"] == 1
    assert east_north(at(buffer, 300.0))[0, 0] == pytest.approx(5300.0, abs=0.01)


def test_a_jump_within_the_bridging_time_is_never_interpolated() -> None:
    samples = steady(20, period_s=0.3) + steady(20, first=20, period_s=0.3, east=500.0)
    east = east_north(filled(samples).interpolate(START_S + np.linspace(0.0, 11.0, 300)))[:, 0] - np.linspace(
        0.0, 11.0, 300
    )
    assert ((np.abs(east) < 0.3) | (np.abs(east - 500.0) < 0.3)).all()


def test_scattered_wrong_fixes_never_count_as_agreement() -> None:
    samples = []
    for i in range(20):
        samples.append(here(i, east=i))
        samples.append(here(i + 0.5, east=1000.0 * (1 + i % 2), north=700.0 * i))
    buffer = filled(samples)
    assert buffer.counters == {"navigation.position_jump": 19}, "the last one may still find others that agree"
    np.testing.assert_allclose(east_north(at(buffer, 7.25, 11.5))[:, 0], [7.25, 11.5], atol=1e-6)


def test_rounded_fixes_milliseconds_apart_are_no_jump() -> None:
    buffer = filled(here(0.01 * i, east=1.1 * (i % 2)) for i in range(50))
    assert not buffer.counters


# --- finality, memory ------------------------------------------------------------------------------------------------

quantity = st.sampled_from(["position", "heading_rad", "pitch_rad", "roll_rad", "depth_m", "altitude_m", "speed_mps"])
streams = st.lists(
    st.tuples(
        st.sampled_from([0, 1, 1, 1, 2, 4, 7, 12, 30, 60, 130]),  # sixteenths of a second since the last sample
        st.sets(quantity, max_size=4),  # what it lacks
        st.sampled_from([0.0, 0.0, 0.0, 0.0, 0.0, 900.0]),  # displacement
        st.floats(-3.0, 3.0),
    ),
    min_size=1,
    max_size=40,
)


def a_stream(steps: list[tuple[int, set[str], float, float]], always_missing: set[str]) -> list[NavSample]:
    samples, second, east = [], 0.0, 0.0
    for step, missing, displacement, heading in steps:
        second += step / 16
        east += step / 16 * 1.2 + displacement
        gone = missing | always_missing
        names = [name for name in gone if name != "position"] + (
            ["latitude_deg", "longitude_deg"] if "position" in gone else []
        )
        samples.append(without(here(second, east=east, heading_rad=heading, depth_m=5.0 + heading), *names))
    return samples


@settings(max_examples=200, deadline=None)
@given(
    streams,
    st.sets(quantity, max_size=2),
    st.sampled_from([NavigationConfig(), NavigationConfig(max_extrapolation_s=3.0, max_gap_s=0.5)]),
)
def test_what_is_ready_never_changes(
    steps: list[tuple[int, set[str], float, float]], always_missing: set[str], config: NavigationConfig
) -> None:
    assert_final(a_stream(steps, always_missing), config)


def test_a_late_sample_of_the_same_instant_changes_nothing_that_is_ready() -> None:
    assert_final([here(0.0), *(only(i, heading_rad=1.0, speed_mps=1.0) for i in range(1, 12)), here(11.0, east=3.0)])


def test_a_vehicle_that_starts_to_move_changes_no_heading_that_is_ready() -> None:
    fixes = [here(0.5 * i, east=0.5 * i) for i in range(20)]
    fixes += [here(10.0 + 0.5 * i, east=9.5) for i in range(40)]
    fixes += [here(30.0 + 0.5 * i, east=9.5, north=0.3 * i) for i in range(40)]
    assert_final([without(fix, "heading_rad", "speed_mps") for fix in fixes])


def assert_final(samples: list[NavSample], config: NavigationConfig | None = None) -> None:
    """After each sample take every pose that is reported ready; at the end they must all be the same still."""
    times = START_S + np.arange(-32, 16 * 50) / 16.0
    buffer = NavBuffer(config or NavigationConfig())
    early: list[tuple[NDArray[np.float64], PoseTrack]] = []
    for sample in samples:
        buffer.add(sample)
        ready = times[times <= buffer.ready_until_s]
        early.append((ready, buffer.interpolate(ready)))
    for ready, track in early:
        assert_same(track, buffer.interpolate(ready))


@settings(max_examples=100, deadline=None)
@given(streams, st.sets(quantity, max_size=2), st.integers(1, 9), st.integers(1, 9))
def test_poses_do_not_depend_on_the_size_of_the_pieces(
    steps: list[tuple[int, set[str], float, float]], always_missing: set[str], piece: int, other_piece: int
) -> None:
    """Feed `piece` samples, take the poses that are ready, forget what is past, go on; at the end take the rest."""

    def run(size: int) -> tuple[list[PoseTrack], NavBuffer]:
        buffer = NavBuffer(NavigationConfig())
        waiting = START_S + np.arange(-8, 160) / 8.0
        tracks = []
        for first in range(0, len(samples), size):
            for sample in samples[first : first + size]:
                buffer.add(sample)
            n_ready = int(np.searchsorted(waiting, buffer.ready_until_s, side="right"))
            tracks.append(buffer.interpolate(waiting[:n_ready]))
            waiting = waiting[n_ready:]
            if waiting.size:
                buffer.forget_before(waiting[0])
        return [*tracks, buffer.interpolate(waiting)], buffer

    samples = a_stream(steps, always_missing)
    (one, one_buffer), (other, other_buffer) = run(piece), run(other_piece)
    for name in POSE_FIELDS:
        np.testing.assert_array_equal(
            np.concatenate([getattr(track, name) for track in one]),
            np.concatenate([getattr(track, name) for track in other]),
            err_msg=name,
        )
    assert one_buffer.counters == other_buffer.counters


def test_waiting_ends_soon() -> None:
    """A full sample makes poses up to itself final; a position that stops delays them by 4 s only."""
    buffer = filled(here(0.1 * i, east=0.1 * i) for i in range(50))
    assert buffer.ready_until_s == START_S + 0.1 * 49
    for i in range(50, 200):
        buffer.add(only(0.1 * i, heading_rad=0.0, speed_mps=1.0))
    assert buffer.ready_until_s == pytest.approx(START_S + 19.9 - 4.0, abs=1e-3)
    for i in range(200, 40_000):
        buffer.add(only(0.1 * i, pitch_rad=0.0))
    assert buffer.ready_until_s == pytest.approx(START_S + 3999.9 - 6.0, abs=1e-3)
    silent_compass = filled(without(here(0.1 * i, east=0.1 * i), "heading_rad", "speed_mps") for i in range(200))
    assert silent_compass.ready_until_s > START_S + 19.9 - 5.0
    no_fix = filled(only(0.1 * i, heading_rad=0.0) for i in range(200))
    assert no_fix.ready_until_s > START_S + 19.9 - 10.0


def test_memory_does_not_grow_with_the_mission() -> None:
    buffer = NavBuffer(NavigationConfig())
    tracemalloc.start()
    try:
        peaks = []
        for lap in range(4):
            for i in range(700):  # one object kept of each would be 30 times what is allowed
                second = 70.0 * lap + 0.1 * i
                buffer.add(
                    only(second, latitude_deg=10.0 + 1e-6 * second, longitude_deg=5.0, heading_rad=0.1, depth_m=3.0)
                )
                buffer.forget_before(START_S + second - 3.0)
            peaks.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert peaks[-1] < peaks[0] + 4096


# --- between rows ----------------------------------------------------------------------------------------------------


def a_track(**columns: list[float]) -> PoseTrack:
    n = len(next(iter(columns.values())))
    arrays = {name: np.zeros(n) for name in (*POSE_FIELDS, "time_s") if name != "stale"}
    arrays.update({name: np.array(column) for name, column in columns.items()})
    return PoseTrack(**arrays, stale=np.zeros(n, dtype=np.bool_))


def test_rows_are_blended_linearly_and_held_at_the_ends() -> None:
    track = a_track(time_s=[10.0, 11.0, 13.0], heading_rad=[6.2, 6.4, 6.4], depth_m=[1.0, 2.0, 4.0])
    blended = interpolate_track(track, np.array([-1.0, 0.0, 0.25, 1.5, 2.0, 9.0]))
    np.testing.assert_allclose(blended.time_s, [10.0, 10.0, 10.25, 12.0, 13.0, 13.0])
    np.testing.assert_allclose(blended.heading_rad, [6.2, 6.2, 6.25, 6.4, 6.4, 6.4])
    np.testing.assert_allclose(blended.depth_m, [1.0, 1.0, 1.25, 3.0, 4.0, 4.0])


@pytest.mark.parametrize(("latitude", "longitude"), [(10.0, 179.99999), (89.99999, 45.0), (-89.0, -180.0)])
def test_positions_between_rows_lie_on_the_line_anywhere(latitude: float, longitude: float) -> None:
    frame = LocalFrame(latitude_deg=latitude, longitude_deg=longitude)
    enu = np.array([[-3.0, 1.0, 0.0], [3.0, 1.0, 0.0], [5.0, 7.0, 0.0]])
    lat, lon, _ = frame.to_geodetic(enu)
    blended = interpolate_track(
        a_track(latitude_deg=list(lat), longitude_deg=list(lon)), np.array([0.0, 0.5, 0.75, 1.5])
    )
    np.testing.assert_allclose(
        east_north(blended, frame), np.array([[-3.0, 1.0], [0.0, 1.0], [1.5, 1.0], [4.0, 4.0]]), rtol=0, atol=1e-6
    )
    assert (blended.longitude_deg < 180.0).all()


def test_an_unknown_row_does_not_spoil_its_neighbour() -> None:
    track = a_track(latitude_deg=[1.0, NAN, 3.0], longitude_deg=[4.0, NAN, 6.0], depth_m=[NAN, 2.0, NAN])
    with np.errstate(all="raise", under="ignore"):
        blended = interpolate_track(track, np.array([0.0, 0.7, 1.0, 1.2]))
    np.testing.assert_allclose(blended.latitude_deg, [1.0, 1.0, 3.0, 3.0])
    np.testing.assert_allclose(blended.depth_m, [2.0, 2.0, 2.0, 2.0])


def test_a_blend_with_a_stale_row_is_stale() -> None:
    track = a_track(time_s=[0.0, 1.0, 2.0])
    track.stale[1] = True
    assert interpolate_track(track, np.array([0.0, 0.1, 1.0, 1.9, 2.0])).stale.tolist() == [
        False,
        True,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize("rows", [[NAN], [math.inf]])
def test_rows_that_are_not_numbers_are_refused(rows: list[float]) -> None:
    with pytest.raises(ValueError, match="finite row indices"):
        interpolate_track(a_track(time_s=[0.0, 1.0]), np.array(rows))
    with pytest.raises(ValueError, match="at least one row"):
        interpolate_track(a_track(time_s=[]), np.array([0.0]))


def test_bad_numbers_raise_no_floating_point_flag() -> None:
    rng = np.random.default_rng(2)
    buffer = NavBuffer(NavigationConfig())
    with np.errstate(all="raise", under="ignore"):
        for i in range(300):
            values = dict.fromkeys(
                ("latitude_deg", "longitude_deg", "heading_rad", "pitch_rad", "depth_m", "speed_mps"), 0.5
            )
            values = {
                name: value if rng.random() > 0.2 else float(rng.choice([NAN, math.inf, 0.0, 1e308]))
                for name, value in values.items()
            }
            buffer.add(only(0.1 * i, **values))
        track = buffer.interpolate(START_S + np.array([-math.inf, -5.0, 0.0, 3.0, 29.0, 99.0, math.inf, NAN]))
    assert track.stale[[0, 1, 5, 6, 7]].all()
    inside = geodetic_to_ecef(track.latitude_deg[2:5], track.longitude_deg[2:5], 0.0) - geodetic_to_ecef(0.5, 0.5, 0.0)
    assert np.abs(inside).max() < 1e-6
