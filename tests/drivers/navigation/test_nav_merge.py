"""Check the merging of several units: the best healthy one serves, nothing is repeated, implausible units are
rejected."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from msgspec import structs

from auv_mcm.clock import Stamp
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.navigation import NavBuffer
from auv_mcm.records import NAN, NavSample, Notice
from auv_mcm.settings.config import NavigationConfig
from auv_mcm.settings.port_settings import QUANTITIES, NavUnitSettings
from drivers.navigation.corrections import Readings, arm_north_east_down, moved, offset_m, readings_of
from drivers.navigation.merge import Event, NavMerge
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nav_settings import NavMergeSettings
from tests.drivers.navigation.merged_units import (
    DVL,
    GPS,
    dvl_and_compass,
    fix,
    merge,
    place,
    run,
    seconds,
    survey,
    track,
)
from tests.drivers.navigation.nav_damage import T0, at


def test_readings_are_in_the_order_of_the_quantities() -> None:
    assert Readings._fields == QUANTITIES


def test_one_unit_goes_through_as_it_is() -> None:
    fixes = [
        fix(
            "ins",
            t,
            **place(east, north),
            heading_rad=heading,
            pitch_rad=0.1,
            roll_rad=-0.1,
            depth_m=5.0,
            altitude_m=8.0,
            speed_mps=1.5,
            position_sigma_m=0.5,
        )
        for t, east, north, heading in survey(20)
    ]
    merged = merge(ins=NavUnitSettings())
    samples, notices = run(merged, fixes)
    assert notices == []
    assert not merged.counters
    measured = [name for name in NavSample.__struct_fields__ if name not in ("time_s", "position_leaps")]
    assert [[getattr(sample, name) for name in measured] for sample in samples] == [
        [pytest.approx(getattr(one, name)) for name in measured] for one in fixes
    ]
    assert not any(sample.position_leaps for sample in samples)
    assert [seconds(sample) for sample in samples] == pytest.approx([t for t, *_ in survey(20)], abs=1e-5)
    buffer = NavBuffer(NavigationConfig())
    for sample in samples:
        buffer.add(sample)
    assert not buffer.counters


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("field", "offset_deg"), [("heading", 10.0), ("pitch", -3.0), ("roll", 180.0)])
def test_signs_come_before_offsets(field: str, sign: int, offset_deg: float) -> None:
    unit = NavUnitSettings(**{f"{field}_sign": sign, f"{field}_offset_deg": offset_deg})  # type: ignore[arg-type]  # by name
    reported = {"heading_rad": 0.3, "pitch_rad": 0.2, "roll_rad": 0.1}
    [sample], _ = run(merge(u=unit), [fix("u", 0.0, **reported)])
    for name, value in reported.items():
        expected = sign * value + math.radians(offset_deg) if name == f"{field}_rad" else value
        expected = expected % (2 * math.pi) if name == "heading_rad" else expected
        assert getattr(sample, name) == pytest.approx(expected)


def test_a_lever_arm_is_taken_off_with_heading_and_attitude() -> None:
    heading, pitch, roll, arm = math.radians(120.0), math.radians(20.0), math.radians(-15.0), (2.0, -0.5, -0.8)
    yaw_matrix = np.array(
        [[math.cos(heading), -math.sin(heading), 0], [math.sin(heading), math.cos(heading), 0], [0, 0, 1]]
    )
    pitch_matrix = np.array([[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]])
    roll_matrix = np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]])
    north, east, down = yaw_matrix @ pitch_matrix @ roll_matrix @ np.array(arm)
    assert arm_north_east_down(arm, heading, pitch, roll) == pytest.approx((north, east, down))
    reported = {
        "heading_rad": heading,
        "pitch_rad": pitch,
        "roll_rad": roll,
        "depth_m": 10.0,
        "altitude_m": 5.0,
        **place(0.0, 0.0),
    }
    samples, _ = run(merge(u=NavUnitSettings(lever_arm_m=arm)), [fix("u", 0.0, **reported)])
    assert track(samples)[0][1:] == pytest.approx((-east, -north), abs=1e-6)
    assert samples[0].depth_m == pytest.approx(10.0 - down)
    assert samples[0].altitude_m == pytest.approx(5.0 + down)


@pytest.mark.parametrize("stated_m", [NAN, 1.0])
def test_a_lever_arm_that_cannot_be_taken_off_for_want_of_a_heading_is_in_the_sigma(stated_m: float) -> None:
    unit = NavUnitSettings(lever_arm_m=(4.0, -3.0, 9.0), position_sigma_m=1.0)
    fixes = [fix("u", 0.1 * n, position_sigma_m=stated_m, **place(0.0, 0.0)) for n in range(3)]
    fixes.append(fix("u", 0.3, heading_rad=0.0, position_sigma_m=stated_m, **place(0.0, 0.0)))
    samples, _ = run(merge(u=unit), fixes)
    assert [sample.position_sigma_m for sample in samples] == pytest.approx(
        [math.hypot(1.0, 5.0)] * 3 + [stated_m], nan_ok=True
    )


@given(st.floats(-85.0, 85.0), st.floats(-180.0, 180.0), st.floats(-500.0, 500.0), st.floats(-500.0, 500.0))
@example(10.0, 179.999, 300.0, 0.0)
@example(10.0, -179.999, -300.0, 0.0)
def test_steps_on_the_ellipsoid_are_those_of_the_local_frame(
    latitude_deg: float, longitude_deg: float, east_m: float, north_m: float
) -> None:
    there = moved(latitude_deg, longitude_deg, east_m, north_m)
    assert abs(there[1]) <= 180.0
    east, north, _ = LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg).to_enu(*there, 0.0)
    assert (float(east), float(north)) == pytest.approx(
        (east_m, north_m), abs=0.5
    )  # meridians converge towards the poles
    assert offset_m((latitude_deg, longitude_deg), there) == pytest.approx((east_m, north_m), abs=1e-6)


def test_impossible_values_are_refused_and_counted() -> None:
    merged = merge(u=NavUnitSettings())
    reported = {
        "heading_rad": 9.0,
        "pitch_rad": 2.0,
        "roll_rad": 0.0,
        "depth_m": 1e6,
        "altitude_m": -1.0,
        "speed_mps": 99.0,
    }
    samples, _ = run(merged, [fix("u", 0.0, latitude_deg=0.0, longitude_deg=0.0, **reported)])
    assert samples == []
    assert merged.counters == {f"nav.impossible.{quantity}.u": 1 for quantity in QUANTITIES}


@pytest.mark.parametrize(("sigma", "is_used"), [(0.25, True), (0.0, True), (-0.25, False), (1e9, False)])
def test_the_errors_that_a_unit_reports_count_before_those_configured_if_they_can_be(
    sigma: float, is_used: bool
) -> None:
    sigmas = {"position_sigma_m": sigma, "heading_sigma_rad": sigma, "speed_sigma_mps": sigma}
    unit = NavUnitSettings(position_sigma_m=7.0, heading_sigma_deg=8.0, speed_sigma_mps=9.0)
    readings, _ = readings_of(fix("u", 0.0, heading_rad=1.0, speed_mps=1.5, **place(0.0, 0.0), **sigmas), unit)
    wanted = (sigma, sigma, sigma) if is_used else (7.0, math.radians(8.0), 9.0)
    assert readings.position == (*place(0.0, 0.0).values(), wanted[0], is_used)
    assert readings.heading == (1.0, wanted[1])
    assert readings.speed == pytest.approx((1.5, NAN, NAN, wanted[2]), nan_ok=True)


def test_what_only_looks_impossible_is_taken() -> None:
    """A pressure sensor's zero at the surface, and a course that was never filled beside a speed."""
    reported = {"depth_m": -0.3, "speed_mps": 1.25, "water_speed_mps": 1.5, "course_rad": 655.35}
    readings, impossible = readings_of(fix("u", 0.0, **reported), NavUnitSettings())
    assert impossible == []
    assert readings.depth == -0.3
    assert readings.speed == pytest.approx((1.25, NAN, NAN, NavUnitSettings().speed_sigma_mps), nan_ok=True)


def test_only_what_a_unit_may_deliver_is_taken() -> None:
    [sample], _ = run(merge(u=NavUnitSettings(delivers=("depth",))), [fix("u", 0.0, heading_rad=1.0, depth_m=3.0)])
    assert sample.depth_m == 3.0
    assert math.isnan(sample.heading_rad)


def test_the_better_unit_serves_and_the_other_takes_over_when_it_is_silent() -> None:
    good = [fix("good", t * 0.1, heading_rad=1.0) for t in range(300) if not 100 <= t < 150]
    poor = [fix("poor", t * 0.1 + 0.01, heading_rad=1.02) for t in range(300)]
    samples, notices = run(merge(good=NavUnitSettings(priority=1), poor=NavUnitSettings(priority=2)), good + poor)
    served = [(seconds(sample), sample.heading_rad) for sample in samples]
    assert all(value == 1.0 for t, value in served if t < 9.95 or t > 20.0)
    assert all(value == 1.02 for t, value in served if 11.45 < t < 19.9), (
        "a good unit that is back has to stay for 5 s first"
    )
    assert [notice.code for notice in notices] == ["nav_source_changed"] * 2
    assert [notice.for_the_record for notice in notices] == [False, True], (
        "that the better unit is back asks nothing of anybody"
    )
    assert "Check its cable" in notices[0].text


@pytest.mark.parametrize(("first_s", "taken_s"), [(0.3, 0.3), (4.0, 4.0), (8.0, 13.0)])
def test_a_better_unit_that_starts_soon_after_another_serves_at_once(first_s: float, taken_s: float) -> None:
    good = [fix("good", first_s + t * 0.1, heading_rad=1.0) for t in range(100)]
    poor = [fix("poor", t * 0.1 + 0.01, heading_rad=1.02) for t in range(200)]
    samples, notices = run(merge(good=NavUnitSettings(priority=1), poor=NavUnitSettings(priority=2)), good + poor)
    changed_s = next(seconds(sample) for sample in samples if sample.heading_rad == 1.0)
    assert changed_s == pytest.approx(taken_s, abs=0.11)
    reported = [notice for notice in notices if notice.text.startswith("heading now comes from 'good'")]
    assert len(reported) == (taken_s > first_s), "that units start one after the other is no news"
    assert {
        sample.heading_rad
        for sample in samples
        if seconds(sample) > changed_s + 0.01 and seconds(sample) < first_s + 9.0
    } == {1.0}


def test_a_unit_that_fails_at_the_start_has_to_stay_healthy_before_it_serves_again() -> None:
    good = [fix("good", t * 0.1, heading_rad=1.0) for t in range(100) if not 5 <= t < 30]
    poor = [fix("poor", t * 0.1 + 0.01, heading_rad=1.02) for t in range(120)]
    samples, _ = run(merge(good=NavUnitSettings(priority=1), poor=NavUnitSettings(priority=2)), good + poor)
    assert {sample.heading_rad for sample in samples if 2.0 < seconds(sample) < 7.9} == {1.02}
    assert {sample.heading_rad for sample in samples if 8.2 < seconds(sample) < 9.8} == {1.0}


def test_a_loose_contact_does_not_make_units_alternate() -> None:
    good = [fix("good", t * 0.1, heading_rad=1.0) for t in range(600) if t < 50 or t % 30 < 10]
    poor = [fix("poor", t * 0.1 + 0.01, heading_rad=1.02) for t in range(600)]
    _, notices = run(merge(good=NavUnitSettings(priority=1), poor=NavUnitSettings(priority=2)), good + poor)
    assert len(notices) == 1


def test_a_lost_quantity_is_reported_once_and_its_return_too() -> None:
    merged = merge(u=NavUnitSettings())
    events = [*merged.feed(fix("u", 0.0, depth_m=1.0))]
    for t in range(1, 10):
        events += merged.advance(at(float(t)))
    assert merged.health()["depth"].serving is None
    assert merged.health()["depth"].age_s == {"u": pytest.approx(9.0)}
    events += merged.feed(fix("u", 10.0, depth_m=1.0))
    assert [event.code for event in events if isinstance(event, Notice)] == ["nav_quantity_lost", "nav_quantity_back"]
    assert merged.health()["depth"].serving == "u"


def test_a_unit_that_hangs_on_one_instant_is_not_repeated_and_goes_stale() -> None:
    fixes = [fix("u", t * 0.1, time_utc_s=1e9 + min(t, 20) * 0.1, depth_m=5.0) for t in range(100)]
    merged = merge(u=NavUnitSettings())
    samples, notices = run(merged, fixes)
    assert len(samples) == 21
    assert merged.counters["nav.same_instant.depth.u"] == 79
    assert [notice.code for notice in notices] == ["nav_quantity_lost"]


def test_two_sentences_of_one_epoch_are_one_position_and_no_frozen_one() -> None:
    fixes = []
    for t, east, north, _ in survey(60, circle=False)[::10]:
        fixes += [
            fix("gps", t + 0.2, time_utc_s=1e9 + t, **place(east, north)),
            fix("gps", t + 0.25, time_utc_s=1e9 + t, **place(east, north)),
        ]
    merged = merge(gps=GPS, dvl=DVL)
    samples, notices = run(merged, fixes + dvl_and_compass(60, circle=False))
    assert len(track(samples)) == 60
    assert notices == []


def test_slow_units_are_stamped_when_they_measured_and_come_in_the_order_of_time() -> None:
    fixes = [fix("fast", t * 0.1, heading_rad=1.0) for t in range(100)] + [
        fix("slow", t * 0.2 + 0.31, depth_m=5.0) for t in range(50)
    ]
    samples, _ = run(merge(fast=NavUnitSettings(), slow=NavUnitSettings(latency_s=0.3)), fixes)
    times = [seconds(sample) for sample in samples]
    assert times == sorted(times)
    assert len(samples) == 150
    assert [t for t, sample in zip(times, samples, strict=True) if sample.depth_m == 5.0] == pytest.approx(
        [t * 0.2 + 0.01 for t in range(50)], abs=1e-5
    )


def test_what_comes_too_late_for_the_order_of_time_is_counted() -> None:
    merged = merge(u=NavUnitSettings())
    late = fix("u", 5.05, depth_m=2.0, age_s=4.0)
    samples, _ = run(merged, [late, *(fix("u", 0.1 * t, heading_rad=1.0) for t in range(100))])
    assert merged.counters == {"nav.too_late": 1}
    assert all(math.isnan(sample.depth_m) for sample in samples)


def test_the_time_on_a_serial_wire_is_taken_off() -> None:
    unit = NavUnitSettings(baud=4800)
    [sample], _ = run(merge(u=unit), [structs.replace(fix("u", 1.0, heading_rad=1.0, age_s=0.05), n_bytes=48)])
    assert seconds(sample) == pytest.approx(1.0 - 0.1 - 0.05, abs=1e-5)


def test_what_is_old_when_it_is_sent_is_dated_back_by_the_units_clock_too() -> None:
    old = [fix("dvl", t, time_utc_s=5e8 + t - 0.2, heading_rad=1.0, age_s=0.2) for t in (0.0, 0.5, 1.0)]
    samples, _ = run(merge(dvl=NavUnitSettings(use_unit_time=True)), old)
    assert [seconds(sample) for sample in samples] == pytest.approx([-0.2, 0.3, 0.8], abs=1e-5)


def test_the_units_clock_takes_the_links_delays_off() -> None:
    random = np.random.Generator(np.random.PCG64(9))
    sent_s = np.arange(400) * 0.1
    arrived_s = np.maximum.accumulate(sent_s + random.exponential(0.03, 400))  # a link keeps the order
    fixes = [
        fix("ins", float(arrived), time_utc_s=5e8 + float(sent), heading_rad=1.0)
        for sent, arrived in zip(sent_s, arrived_s, strict=True)
    ]
    samples, _ = run(merge(ins=NavUnitSettings(use_unit_time=True)), fixes)
    errors = [seconds(sample) - t * 0.1 for t, sample in enumerate(samples)]
    assert max(map(abs, errors[20:])) < 0.02
    assert np.std(arrived_s - sent_s) > 0.02


def test_a_units_clock_that_is_set_is_reported_and_moves_no_sample() -> None:
    fixes = [
        fix("ins", t * 0.1, time_utc_s=5e8 + t * 0.1 + (3600.0 if t >= 100 else 0.0), heading_rad=1.0)
        for t in range(200)
    ]
    merged = merge(ins=NavUnitSettings(use_unit_time=True))
    samples, notices = run(merged, fixes)
    assert [seconds(sample) for sample in samples] == pytest.approx([t * 0.1 for t in range(200)], abs=0.01)
    assert [notice.code for notice in notices] == ["device_clock_anchored_anew"]


def test_units_of_one_bus_share_its_settings_unless_they_have_their_own() -> None:
    settings = NavMergeSettings(units={"can": NavUnitSettings(priority=2), "can.35": NavUnitSettings(priority=7)})
    assert [settings.unit(name).priority for name in ("can.3", "can.35")] == [2, 7]  # type: ignore[union-attr]  # they are there
    assert settings.unit("other.35") is None


def test_units_without_settings_are_reported_once_and_not_used() -> None:
    merged = merge(u=NavUnitSettings())
    samples, notices = run(merged, [fix(f"x.{t % 100}", t * 0.1, heading_rad=1.0) for t in range(500)])
    assert samples == []
    assert len(notices) == 32, "of the first ones, and no more"
    assert merged.counters["nav.unknown_source"] == 500


ANY_NUMBER = st.one_of(st.floats(-7.0, 7.0), st.floats(allow_nan=False))
ANY_FIX = st.builds(
    lambda source, received, utc_s, reported: NavFix(source=source, received=received, time_utc_s=utc_s, **reported),
    st.sampled_from(["gps", "dvl", "ins", "who"]),
    st.builds(Stamp, st.integers(0, 10**11), st.integers(0, 2 * 10**18)),
    st.one_of(st.none(), st.floats(0, 2e9)),
    st.dictionaries(st.sampled_from(NavFix.__struct_fields__[7:]), ANY_NUMBER, max_size=6),
)
UNITS = {
    "gps": NavUnitSettings(surface_only=True, priority=2),
    "dvl": NavUnitSettings(latency_s=0.2, lever_arm_m=(1, 0, 0.5)),
    "ins": NavUnitSettings(use_unit_time=True),
}


@given(st.lists(ANY_FIX, max_size=40))
def test_no_fixes_raise_and_nothing_comes_out_that_is_not_a_number(fixes: list[NavFix]) -> None:
    merged = NavMerge(NavMergeSettings(units=UNITS))
    events = [event for one in fixes for event in merged.feed(one)] + merged.finish()
    for event in events:
        if isinstance(event, NavSample):
            assert not any(math.isinf(value) for value in structs.astuple(event))


@given(st.data())
def test_asking_for_the_time_between_fixes_changes_no_sample(data: st.DataObject) -> None:
    fixes = dvl_and_compass(8) + [fix("gps", t + 0.05, **place(0.0, 1.5 * t)) for t in range(4)]
    fixes.sort(key=lambda one: one.received.mono_ns)
    silent = data.draw(st.sets(st.integers(0, len(fixes) - 1), max_size=60))
    fixes = [one for i, one in enumerate(fixes) if i not in silent]
    plain, _ = run(merge(gps=GPS, dvl=DVL), fixes)
    merged = merge(gps=GPS, dvl=DVL)
    events: list[Event] = []
    for one in fixes:
        before = one.received.mono_ns - T0.mono_ns - data.draw(st.integers(0, 40_000_000))
        events += merged.advance(at(before * 1e-9))
        events += merged.feed(one)
    events += merged.finish()
    assert [event for event in events if isinstance(event, NavSample)] == plain
