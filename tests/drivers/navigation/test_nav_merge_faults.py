"""Receivers that freeze, leap or lie, and units that disagree, are found out and reported."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from msgspec import structs

from auv_mcm.geometry.navigation import NavBuffer
from auv_mcm.records import NavSample, Notice
from auv_mcm.settings.config import NavigationConfig
from auv_mcm.settings.port_settings import NavUnitSettings, Quantity
from drivers.navigation import n2k_messages as n2k
from drivers.navigation.merge import NavMerge
from drivers.navigation.n2k_bus import N2kBus
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nav_settings import NavMergeSettings
from tests.drivers.navigation.merged_units import DVL, GPS, HOME, dvl_and_compass, fix, merge, place, run, survey, track
from tests.drivers.navigation.nav_damage import T0, at


def without(field: str, from_s: float, until_s: float, fixes: Sequence[NavFix]) -> list[NavFix]:
    """Take a quantity out of the fixes between two instants."""
    hole = range(at(from_s).mono_ns, at(until_s).mono_ns)
    return [structs.replace(one, **{field: math.nan}) if one.received.mono_ns in hole else one for one in fixes]


@pytest.mark.parametrize("circle", [False, True])
def test_a_receiver_that_freezes_under_water_is_found_out_and_the_way_is_reckoned(circle: bool) -> None:
    poses = survey(120, circle)
    gps = [
        fix("gps", t + 0.05, **place(*((east, north) if t < 30.0 else poses[300][1:3])))
        for t, east, north, _ in poses[::10]
    ]
    merged = merge(gps=GPS, dvl=DVL)
    samples, notices = run(merged, gps + dvl_and_compass(120, circle))
    assert merged.counters["nav.gnss_frozen.gps"] > 60
    assert notices[0].code == "nav_dead_reckoning"
    assert "gps: frozen" in notices[0].text
    truth = {round(t, 1): (east, north) for t, east, north, _ in poses}
    found = track(samples)
    late = [(t, math.dist((east, north), truth[round(t, 1)])) for t, east, north in found if t > 35.0]
    assert len(late) > 500
    # What was believed until it was found out stays as error: not more than the 4 m of way that it takes, and one fix.
    assert max(error for _, error in late) < 7.0
    assert merged.position_sigma_m > 3.0


def test_a_receiver_off_the_reference_that_freezes_is_found_out_though_the_vehicle_yaws() -> None:
    """The reference turns about the antenna, and so is never at the same place twice."""
    random = np.random.Generator(np.random.PCG64(6))
    gps = [fix("gps", t + 0.05, **place(0.0, min(t, 30.0))) for t in range(120)]
    yaw = [0.005 * random.standard_normal() % math.tau for _ in range(1200)]
    way = [fix("dvl", 0.1 * n, heading_rad=yaw[n], speed_mps=1.0, drift_rad=0.0) for n in range(1200)]
    merged = merge(gps=structs.replace(GPS, lever_arm_m=(1.5, 0.3, -0.5)), dvl=DVL)
    samples, _ = run(merged, gps + way)
    assert max(math.dist((east, north), (-0.3, t - 1.5)) for t, east, north in track(samples)) < 7.0


def test_a_diving_receiver_is_refused_at_once_by_depth_and_needs_three_good_fixes_afterwards() -> None:
    poses = survey(90, circle=False)
    gps = [fix("gps", t + 0.05, **place(east, north)) for t, east, north, _ in poses[::10]]
    depth = [fix("dvl", t, depth_m=3.0 if 30.0 <= t < 60.0 else 0.2) for t, *_ in poses]
    merged = merge(gps=GPS, dvl=DVL)
    samples, notices = run(
        merged, gps + depth + [structs.replace(one, source="dvl") for one in dvl_and_compass(90, circle=False)]
    )
    assert merged.counters["nav.gnss_submerged.gps"] == 30
    assert merged.counters["nav.gnss_recovering.gps"] == 2
    assert [notice.code for notice in notices] == ["nav_dead_reckoning", "nav_position_back"]
    truth = {round(t, 1): north for t, _, north, _ in poses}
    assert max(abs(north - truth[round(t, 1)]) for t, _, north in track(samples) if round(t, 1) in truth) < 0.3


def test_a_receiver_that_runs_straight_on_while_the_vehicle_turns_is_found_out() -> None:
    poses = survey(120)
    gps = [
        fix(
            "gps",
            t + 0.05,
            **place(
                *((east, north) if t < 30.0 else (poses[300][1] + 1.35 * (t - 30.0), poses[300][2] + 0.65 * (t - 30.0)))
            ),
        )
        for t, east, north, _ in poses[::10]
    ]
    merged = merge(gps=GPS, dvl=DVL)
    _, notices = run(merged, gps + dvl_and_compass(120))
    assert merged.counters["nav.gnss_not_the_way_made.gps"] > 30
    assert notices[0].code == "nav_dead_reckoning"


def test_a_good_receiver_with_noise_is_believed_throughout() -> None:
    random = np.random.Generator(np.random.PCG64(5))
    gps = [
        fix("gps", t + 0.05, **place(east + 2.0 * random.standard_normal(), north + 2.0 * random.standard_normal()))
        for t, east, north, _ in survey(300)[::10]
    ]
    merged = merge(gps=GPS, dvl=DVL)
    _, notices = run(merged, gps + dvl_and_compass(300))
    assert notices == []
    assert not merged.counters


def test_a_receiver_on_a_vehicle_that_lies_still_may_repeat_itself() -> None:
    still = [fix("dvl", t * 0.1, heading_rad=1.0, speed_mps=0.01) for t in range(1200)]
    merged = merge(gps=GPS, dvl=DVL)
    _, notices = run(merged, [fix("gps", float(t), **place(0.0, 0.0)) for t in range(120)] + still)
    assert notices == []
    assert not merged.counters


@pytest.mark.parametrize("silent", ["heading_rad", "speed_mps"])
def test_a_good_receiver_is_believed_while_heading_or_speed_is_lost(silent: str) -> None:
    gps = [fix("gps", t + 0.05, **place(east, north)) for t, east, north, _ in survey(120, circle=False)[::10]]
    merged = merge(gps=GPS, dvl=DVL)
    _, notices = run(merged, gps + without(silent, 30.0, 60.0, dvl_and_compass(120, circle=False)))
    assert not merged.counters
    assert [notice.code for notice in notices] == ["nav_quantity_lost", "nav_quantity_back"]


def test_a_speed_that_was_never_filled_casts_no_doubt_on_a_receiver() -> None:
    gps = [fix("gps", t + 0.05, **place(east, north)) for t, east, north, _ in survey(120, circle=False)[::10]]
    merged = merge(gps=GPS, dvl=DVL)
    _, notices = run(merged, gps + [structs.replace(one, speed_mps=0.0) for one in dvl_and_compass(120, circle=False)])
    assert not merged.counters
    assert notices == []


@pytest.mark.parametrize("off_rad", [math.pi, 0.8])
def test_reckoning_that_a_receiver_at_the_surface_contradicts_has_their_distance_for_its_sigma(off_rad: float) -> None:
    """A compass that is wrong leads away from the track: the receiver is doubted, and may be right."""
    poses = survey(150, circle=False)
    gps = [fix("gps", t + 0.05, **place(east, north)) for t, east, north, _ in poses[::10]]
    way = [
        structs.replace(one, heading_rad=(one.heading_rad + off_rad) % math.tau, depth_m=0.2)
        for one in dvl_and_compass(150, circle=False)
    ]
    merged = merge(gps=GPS, dvl=DVL)
    samples, _ = run(merged, gps + way)
    off_m = [math.hypot(east, north - 1.5 * t) for t, east, north in track(samples)]  # the survey goes north
    sigmas_m = [sample.position_sigma_m for sample in samples if not math.isnan(sample.latitude_deg)]
    assert merged.counters["nav.reckoned"] > 500
    assert max(off_m) > 60.0
    for off, sigma_m in zip(off_m, sigmas_m, strict=True):
        assert off < 3.0 * (1.0 if math.isnan(sigma_m) else sigma_m) + 3.0


def test_fixes_that_were_doubted_cast_no_doubt_on_good_ones() -> None:
    gps = [
        fix("gps", t + 0.05, **place(east + 40.0 * (30.0 <= t < 34.0), north))
        for t, east, north, _ in survey(120, circle=False)[::10]
    ]
    merged = merge(gps=GPS, dvl=DVL)
    _, notices = run(merged, gps + dvl_and_compass(120, circle=False))
    assert merged.counters["nav.gnss_not_the_way_made.gps"] == 4
    assert [notice.code for notice in notices] == ["nav_dead_reckoning", "nav_position_back"]


def test_no_way_is_reckoned_across_a_time_without_a_speed() -> None:
    gps = [fix("gps", t + 0.05, **place(east, north)) for t, east, north, _ in survey(40, circle=False)[::10]]
    samples, _ = run(
        merge(gps=GPS, dvl=DVL), gps + without("speed_mps", 30.0, 60.0, dvl_and_compass(120, circle=False))
    )
    assert max(math.dist((east, north), (0.0, 1.5 * t)) for t, east, north in track(samples)) < 0.1


def test_a_receiver_alone_is_used_again_after_it_was_elsewhere_for_a_while() -> None:
    gps = [
        fix("gps", float(t), speed_mps=3.0, course_rad=0.0, **place(60.0 if 30 <= t < 38 else 0.0, 3.0 * t))
        for t in range(120)
    ]
    merged = merge(gps=NavUnitSettings(delivers=("position", "speed"), surface_only=True))
    samples, _ = run(merged, gps)
    assert [round(t) for t, east, _ in track(samples) if t > 45.0 and abs(east) < 1.0] == list(range(46, 120))


def test_the_way_is_reckoned_from_where_a_late_fix_was_measured() -> None:
    gps = [fix("gps", t + 1.0, **place(east, north)) for t, east, north, _ in survey(30, circle=False)[::10]]
    samples, _ = run(merge(gps=structs.replace(GPS, latency_s=1.0), dvl=DVL), gps + dvl_and_compass(60, circle=False))
    assert max(math.dist((east, north), (0.0, 1.5 * t)) for t, east, north in track(samples)) < 0.1


def test_positions_reckoned_by_a_late_log_have_the_time_it_measured() -> None:
    gps = [fix("gps", t, **place(east, north)) for t, east, north, _ in survey(30, circle=False)[::10]]
    log = [fix("dvl", t + 0.4, heading_rad=0.0, speed_mps=1.5) for t, *_ in survey(60, circle=False)]
    samples, _ = run(merge(gps=GPS, dvl=structs.replace(DVL, latency_s=0.4)), gps + log)
    assert len(track(samples)) > 200
    assert max(math.dist((east, north), (0.0, 1.5 * t)) for t, east, north in track(samples)) < 0.1


@pytest.mark.parametrize("turned_deg", [0.0, 45.0])
def test_a_drift_to_starboard_reckons_to_starboard_of_the_heading(turned_deg: float) -> None:
    gps = [fix("gps", t, **place(east, north)) for t, east, north, _ in survey(10, circle=False)]
    drift_rad = math.tau - 6.0 - math.radians(turned_deg)
    log = [fix("log", t, drift_rad=drift_rad, speed_mps=1.5) for t, *_ in survey(40, circle=False)]
    compass = [fix("dvl", t, heading_rad=6.0) for t, *_ in survey(40, circle=False)]
    turned = NavUnitSettings(delivers=("speed",), heading_offset_deg=turned_deg)
    samples, _ = run(merge(gps=GPS, dvl=DVL, log=turned), gps + log + compass)
    assert len(track(samples)) > 200
    assert max(math.dist((east, north), (0.0, 1.5 * t)) for t, east, north in track(samples)) < 0.1


def test_speed_of_a_submerged_receiver_is_not_believed_either() -> None:
    merged = merge(gps=NavUnitSettings(surface_only=True), depth=NavUnitSettings())
    merged.feed(fix("depth", 0.0, depth_m=4.0))
    samples, _ = run(merged, [fix("gps", 0.5, speed_mps=3.0, **place(0.0, 0.0))])
    assert [(sample.depth_m, math.isnan(sample.speed_mps)) for sample in samples] == [(4.0, True)]


def test_a_single_leap_is_not_believed_and_a_new_place_is_the_third_time() -> None:
    positions = [(0.0, 1.5 * t) for t in range(40)]
    positions[10] = (500.0, 0.0)
    positions[30:] = [(300.0, north) for _, north in positions[30:]]
    merged = merge(ins=NavUnitSettings())
    samples, notices = run(merged, [fix("ins", float(t), **place(*position)) for t, position in enumerate(positions)])
    assert merged.counters == {"nav.jump.ins": 4, "nav.refix.ins": 1}
    believed = [round(east) for _, east, _ in track([sample for sample in samples if not sample.position_leaps])]
    assert believed == [0] * 29 + [300] * 8
    assert [round(east) for _, east, _ in track([sample for sample in samples if sample.position_leaps])] == [
        500,
        300,
        300,
    ]
    assert notices == [], "perception reports it when it follows, in the same words live and replayed"


def test_a_wrong_first_position_and_two_places_in_turn_do_not_silence_a_unit() -> None:
    """Every one of the later positions was refused against the wrong first one."""
    positions = [(90_000.0, 0.0)] + [(1100.0 * (t % 2), 1.5 * t) for t in range(1, 40)]
    merged = merge(ins=NavUnitSettings())
    samples, _ = run(merged, [fix("ins", float(t), **place(*position)) for t, position in enumerate(positions)])
    believed = track([sample for sample in samples if not sample.position_leaps])
    east = {round(east) for _, east, _ in believed[1:]}
    assert len(believed) >= 16
    assert len(east) == 1
    assert east <= {0, 1100}


@pytest.mark.parametrize("per_s", [1.0, 2.0, 10.0])
def test_half_of_all_fixes_wrong_live_shows_in_the_sigma_as_it_does_replayed(per_s: float) -> None:
    """The merge kept one place at a time from perception, so that at 2 Hz half of all poses looked sure."""
    wrong = np.random.default_rng(0).random(int(100 * per_s)) < 0.5
    merged = merge(gps=NavUnitSettings())
    positions = [place(t / per_s, 1100.0 * wrong[t]) for t in range(len(wrong))]
    samples, _ = run(merged, [fix("gps", t / per_s, **position) for t, position in enumerate(positions)])
    live, replayed = NavBuffer(NavigationConfig()), NavBuffer(NavigationConfig())
    for sample in samples:
        live.add(sample)
    for t, position in enumerate(positions):
        latitude_deg, longitude_deg = position.values()
        time_s = T0.utc_ns * 1e-9 + t / per_s
        replayed.add(NavSample(time_s=time_s, latitude_deg=latitude_deg, longitude_deg=longitude_deg))
    times = T0.utc_ns * 1e-9 + np.arange(10.0, 90.0, 0.3)
    assert (live.interpolate(times).position_sigma_m > 1000.0).mean() > 0.9
    assert (replayed.interpolate(times).position_sigma_m > 1000.0).mean() > 0.9
    codes = {notice.code for notice in live.take_notices()}
    assert codes == {notice.code for notice in replayed.take_notices()}
    assert {"navigation.position_disputed", "navigation.positions_rejected"} <= codes


def test_a_leap_within_the_reach_of_perception_stays_out() -> None:
    """At a fix per second 20 m are below 30 m/s, where perception begins to doubt; the merge doubts from 6 m/s on."""
    fixes = [fix("ins", float(t), position_sigma_m=0.1, **place(20.0 * (t == 10), 1.5 * t)) for t in range(20)]
    samples, _ = run(merge(ins=NavUnitSettings()), fixes)
    assert [round(east) for _, east, _ in track(samples)] == [0] * 19
    assert not any(sample.position_leaps for sample in samples)


def test_the_sigma_of_reckoned_positions_grows_and_steps_are_reported() -> None:
    merged = merge(gps=GPS, dvl=NavUnitSettings(delivers=("heading", "speed"), heading_sigma_deg=5.0))
    merged.feed(fix("gps", 0.0, position_sigma_m=1.0, **place(0.0, 0.0)))
    sigma, notices = [], []
    for one in dvl_and_compass(600, circle=False):
        notices += [event for event in merged.feed(one) if isinstance(event, Notice)]
        sigma.append(merged.position_sigma_m)
    assert all(b >= a for a, b in pairwise(sigma))
    assert sigma[-1] == pytest.approx(math.sqrt(1.0 + (math.radians(5.0) * 900.0) ** 2 + (0.05 * 600.0) ** 2), rel=0.01)
    assert [notice.code for notice in notices] == ["nav_dead_reckoning"] * 4, "at once, then at 10, 20 and 50 m"


def test_a_speed_through_the_water_reckons_with_the_error_of_a_current() -> None:
    """The current sets to the east with 0.4 m/s."""
    gps = [fix("gps", t + 0.05, **place(0.4 * t, north)) for t, _, north, _ in survey(60, circle=False)[::10]]
    way = [fix("dvl", t, heading_rad=0.0, water_speed_mps=1.5) for t, *_ in survey(200, circle=False)]
    merged = merge(gps=GPS, dvl=DVL)
    samples, _ = run(merged, gps + way)
    t, east, north = track(samples)[-1]
    assert math.dist((east, north), (0.4 * t, 1.5 * t)) < 2.0 * merged.position_sigma_m


def test_poses_by_dead_reckoning_carry_its_sigma() -> None:
    gps = [fix("gps", t + 0.05, **place(east, north)) for t, east, north, _ in survey(30, circle=False)[::10]]
    merged = merge(gps=GPS, dvl=DVL)
    samples, _ = run(merged, gps + dvl_and_compass(600, circle=False))
    buffer = NavBuffer(NavigationConfig())
    for sample in samples:
        buffer.add(sample)
    poses = buffer.interpolate(T0.utc_ns * 1e-9 + np.array([20.0, 599.0]))
    assert merged.position_sigma_m > 30.0
    assert poses.position_sigma_m == pytest.approx([0.0, merged.position_sigma_m], rel=0.01)


@pytest.mark.parametrize(("speed_mps", "n_notices"), [(1.5, 0), (2.3, 1)])
def test_only_an_end_beyond_both_errors_makes_dead_reckoning_off(speed_mps: float, n_notices: int) -> None:
    random = np.random.Generator(np.random.PCG64(1))
    usbl = [
        fix("usbl", t + 0.05, **place(east + 3.0 * random.standard_normal(), north + 3.0 * random.standard_normal()))
        for t, east, north, _ in survey(2000, circle=False)[::200]
    ]
    way = [structs.replace(one, speed_mps=speed_mps) for one in dvl_and_compass(2000, circle=False)]
    _, notices = run(merge(usbl=NavUnitSettings(delivers=("position",), position_sigma_m=3.0), dvl=DVL), usbl + way)
    assert [notice.code for notice in notices].count("nav_reckoning_off") == n_notices


def test_fixes_that_come_late_and_seldom_make_the_track_go_back_nowhere() -> None:
    """A place that was reckoned from the fix before stands behind the next one, which was measured earlier."""
    usbl = [fix("usbl", 4.0 * n + 1.0, **place(0.0, 6.0 * n + 5.0 * (n % 2))) for n in range(30)]
    unit = NavUnitSettings(delivers=("position",), latency_s=1.0)
    samples, _ = run(merge(usbl=unit, dvl=DVL), usbl + dvl_and_compass(120, circle=False))
    leaps_s = [after[0] for before, after in pairwise(track(samples)) if abs(after[2] - before[2]) > 4.0]
    assert leaps_s == pytest.approx([4.0 * n for n in range(1, 30)], abs=1e-3)


@pytest.mark.parametrize("silent", ["heading_rad", "speed_mps"])
def test_without_heading_or_speed_no_position_is_made_up(silent: str) -> None:
    fixes = [fix("gps", float(t), **place(0.0, 1.5 * t)) for t in range(10)]
    fixes += without(silent, 15.0, 60.0, dvl_and_compass(60, circle=False))
    samples, notices = run(merge(gps=GPS, dvl=DVL), fixes)
    assert max(t for t, _, _ in track(samples)) < 17.0
    assert {"nav_dead_reckoning", "nav_quantity_lost", "nav_position_lost"} == {notice.code for notice in notices}


def test_silence_of_everything_is_reported_by_time_alone() -> None:
    merged = merge(ins=NavUnitSettings())
    merged.feed(fix("ins", 0.0, **place(0.0, 0.0)))
    events = [event for t in range(1, 20) for event in merged.advance(at(float(t)))]
    assert [event.code for event in events if isinstance(event, Notice)] == ["nav_position_lost"]


@pytest.mark.parametrize(
    ("quantity", "one", "other"),
    [
        ("heading", {"heading_rad": 0.02}, {"heading_rad": 6.0}),
        ("attitude", {"pitch_rad": 0.1, "roll_rad": 0.3}, {"pitch_rad": 0.1, "roll_rad": -0.3}),
        ("depth", {"depth_m": 10.0}, {"depth_m": 25.0}),
        ("altitude", {"altitude_m": 10.0}, {"altitude_m": 25.0}),
        ("speed", {"speed_mps": 1.5}, {"speed_mps": 2.5}),
        ("position", place(0.0, 0.0), place(60.0, 0.0)),
    ],
)
def test_units_that_disagree_are_reported_once(
    quantity: Quantity, one: dict[str, float], other: dict[str, float]
) -> None:
    merged = merge(a=NavUnitSettings(priority=1), b=NavUnitSettings(priority=2))
    fixes = [fix("a", t * 0.1, **one) for t in range(50)] + [fix("b", t * 0.1 + 0.01, **other) for t in range(50)]
    _, notices = run(merged, fixes)
    assert [notice.code for notice in notices] == ["nav_disagreement"]
    assert "'a'" in notices[0].text
    assert "'b'" in notices[0].text
    assert merged.counters[f"nav.disagree.{quantity}.b"] == 50


def test_units_that_disagree_now_and_then_are_not_reported() -> None:
    merged = merge(a=NavUnitSettings(priority=1), b=NavUnitSettings(priority=2))
    fixes = [fix("a", t * 0.1, depth_m=10.0) for t in range(200)]
    fixes += [fix("b", t * 0.1 + 0.01, depth_m=25.0 if t % 10 == 0 else 10.0) for t in range(200)]
    assert run(merged, fixes)[1] == []
    assert merged.counters["nav.disagree.depth.b"] == 20


def test_units_that_agree_within_their_errors_are_not_reported() -> None:
    merged = merge(a=NavUnitSettings(priority=1), b=NavUnitSettings(priority=2))
    fixes = [fix("a", t * 0.1, heading_rad=6.27, depth_m=10.0, **place(0.0, 0.0)) for t in range(50)]
    fixes += [fix("b", t * 0.1 + 0.01, heading_rad=0.02, depth_m=10.5, **place(4.0, 4.0)) for t in range(50)]
    _, notices = run(merged, fixes)
    assert notices == []
    assert not merged.counters


def test_a_nmea_2000_latitude_beyond_90_degrees_is_counted_refused_and_reported_once() -> None:
    bus = N2kBus("can")
    merged = NavMerge(NavMergeSettings(units={"can.7": NavUnitSettings()}))
    fixes: list[NavFix] = []
    for t in range(60):
        pgn, data = n2k.encode(n2k.RapidPosition(91.0 + 0.001 * t, 10.0))
        fixes += bus.feed(n2k.can_id_of(n2k.Identifier(2, pgn, n2k.GLOBAL, 7)), data, at(float(t)))
    samples, notices = run(merged, fixes)
    assert bus.counters["n2k.impossible_position"] == 60
    assert merged.counters["nav.impossible.position.can.7"] == 60
    assert all(math.isnan(sample.latitude_deg) for sample in samples)
    (notice,) = notices
    assert notice.code == "nav_impossible"
    assert "latitude 91.019 degrees" in notice.text
    assert "Check" in notice.text


def test_an_altitude_of_zero_that_goes_on_is_reported_and_a_short_one_is_not() -> None:
    merged = merge(dvl=NavUnitSettings())
    _, notices = run(merged, [fix("dvl", 0.1 * t, altitude_m=0.0 if t % 20 else 5.0) for t in range(100)])
    assert "nav_impossible" not in [notice.code for notice in notices]
    _, notices = run(merged, [fix("dvl", 10.0 + 0.1 * t, altitude_m=0.0) for t in range(60)])
    assert [notice.code for notice in notices].count("nav_impossible") == 1


def test_a_receiver_a_degree_off_for_four_seconds_moves_no_ping() -> None:
    """Live this killed perception: the merge follows after three positions, perception waits until they agree for
    longer."""
    positions = [place(0.0, 0.15 * t) for t in range(300)]
    for t in range(100, 140):
        positions[t] = {name: value + 1.0 for name, value in positions[t].items()}
    merged = merge(gps=NavUnitSettings())
    samples, _ = run(merged, [fix("gps", 0.1 * t, **position) for t, position in enumerate(positions)])
    buffer = NavBuffer(NavigationConfig())
    for sample in samples:
        buffer.add(sample)
    poses = buffer.interpolate(T0.utc_ns * 1e-9 + np.arange(5.0, 28.0, 0.1))
    assert merged.counters["nav.refix.gps"] == 2
    assert buffer.counters["navigation.position_refix"] == 0
    assert np.abs(poses.latitude_deg - HOME[0]).max() < 0.01
    assert poses.stale.sum() < 45
    assert "navigation.positions_rejected" in [notice.code for notice in buffer.take_notices()]
