"""What cannot be true is refused alone and counted; jumps of position and time are judged."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from auv_mcm.records import NAN, NavSample
from tests.auv_mcm.geometry.nav_samples import (
    HEADING_RAD,
    POSE_FIELDS,
    START_S,
    assert_same,
    at,
    east_north,
    filled,
    here,
    only,
)


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
    buffer = filled([here(0.0), NavSample(time_s=stamp, heading_rad=1.0), here(1.0, east=2.0)])
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
    assert buffer.span_s == (START_S, START_S + 4.5)
    assert_same(at(buffer, 0.2, 2.2, 4.4), at(filled(good), 0.2, 2.2, 4.4))


def test_a_pause_of_an_hour_is_accepted_when_a_second_sample_confirms_it() -> None:
    buffer = filled([here(0.0), here(1.0, east=2.0), here(3600.0, east=500.0), here(3601.0, east=502.0)])
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


@pytest.mark.parametrize("off_m", [4.0, 9.0, 25.0])
def test_the_fix_that_ends_dead_reckoning_is_taken_at_once_and_is_no_motion(off_m: float) -> None:
    reckoned = [here(0.1 * n, north=0.2 * n + off_m, speed_mps=2.0, position_sigma_m=15.0) for n in range(300)]
    buffer = filled(reckoned + [here(30.0 + 0.2 * n, north=60.0 + 0.4 * n, speed_mps=2.0) for n in range(100)])
    poses = at(buffer, 29.8, 30.1, 32.0, 34.0, 45.0)
    assert east_north(poses)[:, 1] == pytest.approx([59.6 + off_m, 60.2, 64.0, 68.0, 90.0], abs=0.05)
    assert poses.position_sigma_m == pytest.approx([math.sqrt(224.0), 0.0, 0.0, 0.0, 0.0])
    assert poses.speed_mps == pytest.approx(2.0, abs=0.01)
    assert not poses.stale.any()
    assert not buffer.counters
    assert buffer.take_notices() == []


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
