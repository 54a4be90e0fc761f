"""From events to blocks: order, gaps, clocks, layouts, and navigation that is late, wrong or missing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.frozen_state import freeze
from auv_mcm.intake import BLOCK_PINGS, Intake, PingBlock, SegmentEnd
from auv_mcm.records import EchoTrace, NavSample, Notice, Ping, PoseTrack
from auv_mcm.settings.config import Config
from tests.make.records import nav_of

START_S = 1.7e9
PING_S, NAV_S = 0.1, 0.2
SAMPLES = np.arange(8, dtype=np.uint16)
TRACE = EchoTrace(samples=SAMPLES, first_range_m=0.05, spacing_m=0.1)
OTHER_TRACE = structs.replace(TRACE, samples=SAMPLES[:6])


def ping(number: int, time_s: float | None = None, trace: EchoTrace | None = TRACE) -> Ping:
    return Ping(
        number=number, time_s=START_S + PING_S * number if time_s is None else time_s, port=trace, starboard=TRACE
    )


def navigation(index: int, shift_s: float = 0.0) -> NavSample:
    since_s = NAV_S * index
    return nav_of(
        START_S + since_s + shift_s,
        latitude_deg=43.0 + 1.8e-5 * since_s,
        heading_rad=0.1 + 0.01 * since_s,
        pitch_rad=0.002 * since_s + 0.01 * max(since_s - 12.0, 0.0) ** 2,
        altitude_m=0.5,
        speed_mps=2.0,
    )


def mission(n_pings: int, nav_delay_s: float = 0.0) -> list[Ping | NavSample]:
    """In order of arrival: pings at once, navigation after a delay."""
    pings: list[tuple[float, Ping | NavSample]] = [(PING_S * i, ping(i)) for i in range(n_pings)]
    fixes: list[tuple[float, Ping | NavSample]] = [
        (NAV_S * i + nav_delay_s - 1e-6, navigation(i)) for i in range(math.ceil(n_pings * PING_S / NAV_S) + 1)
    ]
    return [event for _, event in sorted(pings + fixes, key=lambda item: item[0])]


class Fed:
    """An intake and what it released so far."""

    def __init__(self, config: Config | None = None) -> None:
        self.counters: Counter[str] = Counter()
        self.intake = Intake(config or Config(), self.counters)
        self.released: list[PingBlock | SegmentEnd] = []
        self.notices: list[Notice] = []

    def feed(self, events: Iterable[Ping | NavSample]) -> Fed:
        for event in events:
            if isinstance(event, NavSample):
                self.notices += self.intake.add_navigation(event)
            else:
                self.released += self.intake.add_ping(event)
        return self

    def flush(self) -> Fed:
        self.released += self.intake.flush()
        return self

    @property
    def blocks(self) -> list[PingBlock]:
        return [item for item in self.released if isinstance(item, PingBlock)]

    @property
    def segments(self) -> list[list[int]]:
        """Numbers of the pings between segment ends."""
        found: list[list[int]] = [[]]
        for item in self.released:
            if isinstance(item, SegmentEnd):
                found.append([])
            else:
                found[-1] += [p.number for p in item.pings]
        return [numbers for numbers in found if numbers]


def assert_same_blocks(one: Fed, other: Fed) -> None:
    assert [type(item) for item in one.released] == [type(item) for item in other.released]
    for a, b in zip(one.blocks, other.blocks, strict=True):
        assert [p.number for p in a.pings] == [p.number for p in b.pings]
        for name in PoseTrack.__struct_fields__:
            np.testing.assert_array_equal(getattr(a.poses, name), getattr(b.poses, name), err_msg=name)
        np.testing.assert_array_equal(a.yaw_rate_rad_s, b.yaw_rate_rad_s)
        np.testing.assert_array_equal(a.pitch_rate_rad_s, b.pitch_rate_rad_s)


def test_every_ping_comes_out_once_in_order_with_its_pose() -> None:
    fed = Fed().feed(mission(200)).flush()
    assert fed.segments == [list(range(200))]
    assert [len(block.pings) for block in fed.blocks] == [BLOCK_PINGS] * 6 + [8]
    assert fed.counters["navigation.ping_stale"] == 0
    for block in fed.blocks:
        since_s = np.array([PING_S * p.number for p in block.pings])
        np.testing.assert_allclose(block.poses.time_s, START_S + since_s)
        np.testing.assert_allclose(block.poses.heading_rad, 0.1 + 0.01 * since_s, atol=1e-6)
        np.testing.assert_allclose(block.poses.latitude_deg, 43.0 + 1.8e-5 * since_s, atol=1e-10)
        assert len(block.poses) == block.along_m.shape[0] == len(block.pings)
    middle = fed.blocks[2]
    np.testing.assert_allclose(middle.yaw_rate_rad_s, 0.01, rtol=1e-5)
    np.testing.assert_allclose(middle.pitch_rate_rad_s, 0.002, rtol=1e-5)


@pytest.mark.parametrize("delay_s", [-30.0, -1.0, 0.05, 0.3, 1.0])
def test_blocks_do_not_depend_on_when_navigation_arrived(delay_s: float) -> None:
    """Within the time that is waited for it."""
    assert_same_blocks(Fed().feed(mission(200, delay_s)).flush(), Fed().feed(mission(200)).flush())


@given(order=st.lists(st.booleans(), min_size=150, max_size=150))
@settings(max_examples=20)
def test_any_interleaving_gives_the_same_blocks(order: list[bool]) -> None:
    """Navigation up to 2 s ahead of or behind the pings, by the toss of a coin."""
    pings, fixes = [ping(i) for i in range(100)], [navigation(i) for i in range(51)]
    events: list[Ping | NavSample] = []
    for heads in order:
        lead_s = NAV_S * (51 - len(fixes)) - PING_S * (100 - len(pings))
        take_fix = fixes and (not pings or lead_s < -2.0 or (heads and lead_s < 2.0))
        events.append(fixes.pop(0) if take_fix else pings.pop(0) if pings else fixes.pop(0))
        if not pings and not fixes:
            break
    assert_same_blocks(Fed().feed([*events, *pings, *fixes]).flush(), Fed().feed(mission(100)).flush())


@pytest.mark.parametrize("measured_m", [math.nan, 8.0])
def test_where_navigation_has_no_altitude_that_of_the_sonar_serves(measured_m: float) -> None:
    events = [structs.replace(e, altitude_m=7.0 if isinstance(e, Ping) else measured_m) for e in mission(70)]
    expected_m = 7.0 if math.isnan(measured_m) else measured_m
    for block in Fed().feed(events).flush().blocks:
        assert set(block.poses.altitude_m.tolist()) == {expected_m}


def test_without_navigation_pings_wait_a_bounded_time() -> None:
    fed = Fed()
    most = 0
    for number in range(2000):
        fed.feed([ping(number)])
        most = max(most, number + 1 - sum(len(block.pings) for block in fed.blocks))
    # Waited for: one second of rates and twice the longest hole of two seconds.
    assert most <= BLOCK_PINGS + math.ceil(5.0 / PING_S) + 1
    assert fed.flush().segments == [list(range(2000))]
    assert fed.counters["navigation.ping_stale"] == 2000
    assert all(np.isnan(block.poses.latitude_deg).all() for block in fed.blocks)


def test_navigation_that_stops_holds_nothing_up() -> None:
    fed = Fed()
    for event in mission(1000):
        if isinstance(event, Ping) or event.time_s < START_S + 30.0:
            fed.feed([event])
    waiting = 1000 - sum(len(block.pings) for block in fed.blocks)
    assert waiting <= BLOCK_PINGS + math.ceil(5.0 / PING_S) + 1
    assert fed.flush().segments == [list(range(1000))]
    assert 1000 - 300 - 6 <= fed.counters["navigation.ping_stale"] <= 1000 - 300 + 10


@pytest.mark.parametrize("factor", [1.0, 1.94])
def test_pings_wait_for_fixes_eight_seconds_apart_and_for_what_they_say_of_the_speed(factor: float) -> None:
    fed = Fed()
    for event in mission(800):
        if isinstance(event, NavSample):
            north_deg = event.latitude_deg if round((event.time_s - START_S) / NAV_S) % 40 == 0 else math.nan
            fed.feed([structs.replace(event, heading_rad=1e-9, speed_mps=2.0 * factor, latitude_deg=north_deg)])
        else:
            fed.feed([event])
    np.testing.assert_allclose(fed.blocks[1].poses.speed_mps, 2.0, rtol=1e-3)
    for block in fed.blocks[2:20]:  # the second fix lends its place 4 s back
        north_m = 2.0 * (block.poses.time_s - START_S)
        np.testing.assert_allclose((block.poses.latitude_deg - 43.0) / 0.9e-5, north_m, atol=0.01)
        assert not block.poses.stale.any()


@pytest.mark.parametrize("wrong_s", [START_S + 1e6, START_S + 3600.0, math.inf, math.nan, 0.0, -1e9])
def test_one_wrong_stamp_of_navigation_changes_no_pose(wrong_s: float) -> None:
    """Navigation arrives half a second late, so who stops waiting for it gets worse poses."""
    events = mission(300, 0.5)
    spoilt = Fed().feed([*events[:100], structs.replace(navigation(20), time_s=wrong_s), *events[100:]]).flush()
    assert_same_blocks(spoilt, Fed().feed(events).flush())


def test_repeated_and_slightly_older_times_are_dropped_and_counted() -> None:
    late = [ping(100, START_S + PING_S), ping(101, START_S + 0.15), ping(102, START_S - 0.6)]
    fed = Fed().feed([ping(0), ping(1), late[0], ping(2), late[1], ping(3), late[2], ping(4)]).flush()
    assert fed.segments == [[0, 1, 2, 3, 4]]
    assert fed.counters["ping.time_repeated"] == 1
    assert fed.counters["ping.time_backwards"] == 2


def test_pings_that_go_because_times_are_too_coarse_are_reported_once() -> None:
    whole = [ping(number, START_S + number // 10) for number in range(200)]
    found = Fed().feed(whole).flush().intake.take_notices()
    (text,) = (one.text for one in found if one.code == "ping.times_repeat")
    assert text.startswith("64 of 72 pings have the time of the one before")
    rarely = [ping(number, START_S + number - (number % 4 == 3)) for number in range(400)]
    for others in (rarely, [each for number in range(200) for each in [ping(number)] * 2]):
        assert "ping.times_repeat" not in [one.code for one in Fed().feed(others).flush().intake.take_notices()]


@pytest.mark.parametrize("sides", [("port", "starboard"), ("starboard", "port")])
def test_sides_that_come_as_pings_of_the_same_time_are_one_ping(sides: tuple[str, str]) -> None:
    together = mission(100)
    alone = [
        half
        for event in together
        for half in ([structs.replace(event, **{side: None}) for side in sides] if isinstance(event, Ping) else [event])
    ]
    one, other = Fed().feed(together).flush(), Fed().feed(alone).flush()
    assert_same_blocks(one, other)
    assert all(ping.port is not None and ping.starboard is not None for block in other.blocks for ping in block.pings)
    assert not other.counters["ping.time_repeated"]


@pytest.mark.parametrize(
    ("step_s", "counter"),
    [(-3600.0, "ping.clock_stepped_back"), (-1.5, "ping.clock_stepped_back"), (3600.0, "ping.gap")],
)
def test_a_clock_that_is_set_ends_the_segment_and_goes_on(step_s: float, counter: str) -> None:
    after = [structs.replace(event, time_s=event.time_s + step_s + 10.0) for event in mission(100)]
    numbered = [
        structs.replace(event, number=event.number + 100) if isinstance(event, Ping) else event for event in after
    ]
    fed = Fed().feed([*mission(100), *numbered]).flush()
    assert fed.counters[counter] == 1
    assert fed.segments == [list(range(100)), list(range(100, 200))]
    assert fed.counters["navigation.ping_stale"] <= 10
    last = fed.blocks[-1]
    np.testing.assert_allclose(
        last.poses.heading_rad[:-10],
        0.1 + 0.01 * (PING_S * (np.array([p.number for p in last.pings[:-10]]) - 100)),
        atol=1e-6,
    )


def test_pings_that_look_elsewhere_begin_a_segment_even_within_a_second() -> None:
    again = [structs.replace(ping(number), number=8 + number, squint_rad=0.05) for number in range(8)]
    fed = Fed().feed([*mission(8), *again]).flush()
    assert fed.segments == [list(range(8)), list(range(8, 16))]
    assert fed.counters["ping.sub_aperture"] == 1


@pytest.mark.parametrize("sides", [(), ("starboard", "port")], ids=["one ping", "a ping of each side"])
@pytest.mark.parametrize("leap_s", [-START_S, -30.0, 30.0, 86400.0])
def test_a_ping_of_another_time_costs_that_ping_alone(leap_s: float, sides: tuple[str, ...]) -> None:
    """Sides that come as pings of their own do not confirm each other."""
    events, leap = mission(100), ping(1000, START_S + leap_s)
    leaps = [structs.replace(leap, **{side: None}) for side in sides] or [leap]
    fed, undisturbed = Fed().feed([*events[:60], *leaps, *events[60:]]).flush(), Fed().feed(events).flush()
    assert_same_blocks(fed, undisturbed)
    assert fed.counters["ping.time_leap"] == 1


def test_a_last_ping_after_a_hole_is_not_lost() -> None:
    fed = Fed().feed([*(ping(i) for i in range(20)), ping(20, START_S + 600.0)]).flush()
    assert fed.segments == [list(range(20)), [20]]


def test_holes_in_time_end_segments() -> None:
    """Longer than two seconds, or than the longest bridged hole of navigation, whichever is more."""
    for hole_s, n_segments in ((1.9, 1), (2.3, 2), (600.0, 2)):
        pings = [ping(i) for i in range(40)] + [ping(i, START_S + PING_S * i + hole_s) for i in range(40, 80)]
        fed = Fed().feed(pings).flush()
        assert len(fed.segments) == n_segments
        assert fed.counters["ping.gap"] == n_segments - 1
        assert [number for numbers in fed.segments for number in numbers] == list(range(80))


@given(layouts=st.lists(st.integers(0, 2), min_size=1, max_size=150))
def test_a_block_never_mixes_layouts(layouts: list[int]) -> None:
    traces = (TRACE, OTHER_TRACE, None)
    fed = Fed().feed([ping(i, trace=traces[layout]) for i, layout in enumerate(layouts)]).flush()
    assert fed.segments == [list(range(len(layouts)))]
    for block in fed.blocks:
        assert len({layouts[p.number] for p in block.pings}) == 1
    longest = [len(block.pings) for block in fed.blocks]
    joined = [
        len(a.pings)
        for a, b in zip(fed.blocks, fed.blocks[1:], strict=False)
        if layouts[a.pings[0].number] == layouts[b.pings[0].number]
    ]
    assert max(longest) <= BLOCK_PINGS
    assert all(length == BLOCK_PINGS for length in joined)


@pytest.mark.parametrize(
    ("change", "n_blocks"),
    [
        ({"spacing_m": 0.1006}, 1),
        ({"spacing_m": 0.107}, 2),
        ({"first_range_m": 0.09}, 1),
        ({"first_range_m": 0.11}, 2),
        ({"first_range_m": 0.09, "spacing_m": 0.103}, 2),
    ],
)
def test_only_ranges_that_move_by_half_a_sample_split_a_block(change: dict[str, float], n_blocks: int) -> None:
    moved = structs.replace(TRACE, **change)
    blocks = Fed().feed([ping(i, trace=TRACE if i < 16 else moved) for i in range(32)]).flush().blocks
    assert len(blocks) == n_blocks


def test_sample_type_and_sound_speed_split_no_block() -> None:
    pings = [structs.replace(ping(i), sound_speed_mps=1500.0 + 0.1 * i) for i in range(32)]
    pings[7] = structs.replace(pings[7], port=structs.replace(TRACE, samples=SAMPLES.astype(np.float32)))
    assert [len(block.pings) for block in Fed().feed(pings).flush().blocks] == [32]


def test_pings_without_channel_or_time_are_counted_and_left_out() -> None:
    silent = Ping(number=7, time_s=START_S + 0.05, port=None, starboard=None)
    fed = Fed().feed([ping(0), silent, ping(8, math.nan), ping(9, math.inf), ping(1)]).flush()
    assert fed.segments == [[0, 1]]
    assert fed.counters["ping.no_side_scan_channel"] == 1
    assert fed.counters["ping.time_not_finite"] == 2


def test_flush_of_nothing_is_the_end_of_a_segment() -> None:
    assert Fed().flush().released == [SegmentEnd()]


def test_refusals_of_navigation_stay_counted_after_a_clock_step() -> None:
    fed = Fed().feed([structs.replace(navigation(0), time_s=math.nan), *mission(50)])
    fed.feed([ping(100, START_S - 3600.0)])
    assert fed.intake.navigation_counters["navigation.time_not_finite"] == 1


def along(fed: Fed) -> list[NDArray[np.float64]]:
    """Along-track distances per block, as the pipeline asks for them."""
    found: list[NDArray[np.float64]] = []
    for item in fed.released:
        if isinstance(item, SegmentEnd):
            fed.intake.start_segment(float(found[-1][-1]) if found else 0.0)
        else:
            found.append(fed.intake.place_along_track(item).along_m)
    return found


def test_a_sonar_that_is_off_lets_no_memory_grow_and_costs_no_ping(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("auv_mcm.intake._MAX_WITHOUT_PING", 1000)
    fed, n_bytes = Fed().feed(mission(50)), []
    for index in range(26, 12_026):
        fed.feed([navigation(index)])
        fed.released += fed.intake.let_go()
        if index % 3000 == 0:
            n_bytes.append(len(freeze(fed.intake, {})))
    assert max(n_bytes) < 1.2 * n_bytes[0]
    fed.feed(ping(number) for number in range(24_000, 24_040)).flush()
    assert fed.segments == [[*range(50)], [*range(24_000, 24_040)]]
    assert not any(block.poses.stale.any() for block in fed.blocks)


def test_where_the_sonar_stays_silent_its_last_pings_come_and_the_segment_ends_as_if_they_had_waited() -> None:
    silence = [navigation(index) for index in range(26, 3000)]
    later = [event for n in range(40) for event in (navigation(3000 + n), ping(6000 + 2 * n))]
    waiting = Fed().feed([*mission(50), *silence, *later]).flush()
    fed = Fed().feed(mission(50))
    for sample in silence:
        fed.feed([sample])
        fed.released += fed.intake.let_go()
    assert fed.segments == [[*range(50)]]
    assert isinstance(fed.released[-1], SegmentEnd)
    assert_same_blocks(fed.feed(later).flush(), waiting)


@pytest.mark.parametrize("later_s", [10.0, 3600.0])
def test_no_segment_ends_while_pings_come_though_the_clock_of_navigation_leaps(later_s: float) -> None:
    fed, events = Fed(), mission(60)
    leap = structs.replace(navigation(20), time_s=START_S + later_s)
    for event in [*events[:60], leap, *events[60:]]:
        fed.feed([event])
        fed.released += fed.intake.let_go()
    assert fed.flush().segments == [[*range(60)]]


def test_distance_is_speed_integrated_over_time_across_blocks() -> None:
    faster = (
        structs.replace(event, speed_mps=2.0 + 0.01 * (event.time_s - START_S))
        if isinstance(event, NavSample)
        else event
        for event in mission(200)
    )
    fed = Fed().feed(faster).flush()
    distance = np.concatenate(along(fed))
    between_s = PING_S * (np.arange(199) + 0.5)
    np.testing.assert_allclose(np.diff(distance), (2.0 + 0.01 * between_s) * PING_S, rtol=1e-5)
    assert distance[0] == Config().waterfall.max_ping_gap_m
    fed.intake.start_segment(700.0)
    assert fed.intake.place_along_track(fed.blocks[0]).along_m[0] == 700.0 + Config().waterfall.max_ping_gap_m


@given(speeds=st.lists(st.floats(-30.0, 30.0) | st.just(math.nan), min_size=2, max_size=60), seed=st.integers(0, 99))
@settings(max_examples=30)
def test_distance_always_grows(speeds: list[float], seed: int) -> None:
    steps = np.random.default_rng(seed).choice([1e-6, 0.01, 0.1, 3.0], len(speeds))
    times = START_S + np.cumsum(steps)
    fed = Fed()
    for number, (speed, time_s) in enumerate(zip(speeds, times.tolist(), strict=True)):
        sample = NavSample(time_s=time_s, latitude_deg=43.0, longitude_deg=5.0, heading_rad=0.0, speed_mps=speed)
        fed.feed([sample, ping(number, time_s)])
    distance = np.concatenate(along(fed.flush()))
    assert np.isfinite(distance).all()
    assert (np.diff(distance) > 0.0).all()


def test_a_speed_astern_spaces_pings_as_one_ahead() -> None:
    ahead = mission(40)
    astern = [structs.replace(e, speed_mps=-e.speed_mps) if isinstance(e, NavSample) else e for e in ahead]
    distances, expected = (np.concatenate(along(Fed().feed(events).flush())) for events in (astern, ahead))
    np.testing.assert_array_equal(distances, expected)


def test_unknown_speed_is_counted_and_guessed() -> None:
    fed = Fed().feed([ping(i) for i in range(10)]).flush()
    distance = np.concatenate(along(fed))
    assert fed.counters["navigation.speed_unknown"] == 10
    np.testing.assert_allclose(np.diff(distance), 1.5 * PING_S, rtol=1e-5)


# --- positions that jump ---------------------------------------------------------------------------------------------


def displaced(
    events: Iterable[Ping | NavSample], from_ping: int, to_ping: int, degrees: float
) -> list[Ping | NavSample]:
    """The events with the positions of some pings' time elsewhere."""
    first_s, stop_s = START_S + PING_S * from_ping, START_S + PING_S * to_ping
    return [
        structs.replace(event, latitude_deg=event.latitude_deg + degrees)
        if isinstance(event, NavSample) and first_s <= event.time_s < stop_s
        else event
        for event in events
    ]


def test_a_step_to_another_place_ends_the_segment_there() -> None:
    fed = Fed().feed(displaced(mission(300), 150, 300, 0.5)).flush()
    before, after = fed.segments
    assert before == list(range(before[0], after[0]))
    assert [*before, *after] == list(range(300))
    assert abs(after[0] - 150) <= 1
    latitude = np.concatenate([block.poses.latitude_deg for block in fed.blocks])
    assert np.abs(latitude[: after[0]] - 43.0).max() < 0.01
    assert np.abs(latitude[after[0] :] - 43.5).max() < 0.01


def test_an_excursion_of_seconds_moves_no_ping_and_ends_no_segment() -> None:
    fed = Fed().feed(displaced(mission(300), 150, 190, 0.5)).flush()
    assert len(fed.segments) == 1
    assert all(np.abs(block.poses.latitude_deg - 43.0).max() < 0.01 for block in fed.blocks)
    assert fed.intake.navigation_counters["navigation.position_jump"] == 20


@pytest.mark.parametrize("delay_s", [0.05, 0.3])
def test_a_step_ends_the_segment_at_the_same_ping_whenever_navigation_arrives(delay_s: float) -> None:
    one = Fed().feed(displaced(mission(300), 150, 300, 0.5)).flush()
    other = Fed().feed(displaced(mission(300, delay_s), 150, 300, 0.5)).flush()
    assert one.segments == other.segments


def test_pings_that_cannot_wait_for_the_decision_say_so_in_their_sigma() -> None:
    """Navigation so late that the wait for it ends while fixes still contradict each other."""
    late = Fed().feed(displaced(mission(300, nav_delay_s=2.5), 150, 300, 0.01)).flush()
    doubtful = [block.poses for block in late.blocks if (block.poses.position_sigma_m > 1000.0).any()]
    assert doubtful
    latitude = np.concatenate([block.poses.latitude_deg for block in late.blocks])
    sigma_m = np.concatenate([block.poses.position_sigma_m for block in late.blocks])
    wrong = (np.arange(300) >= 152) & (np.abs(latitude - 43.01) > 0.005)
    assert wrong.any()
    assert (sigma_m[wrong] > 1000.0).all()


def test_what_is_decided_only_at_the_end_is_reported_too() -> None:
    """A mission so short that fixes are settled when nobody can wait any longer."""
    fed = Fed().feed(displaced(mission(40), 10, 25, 0.5)).flush()
    assert [notice.code for notice in fed.notices + fed.intake.take_notices()] == ["navigation.positions_rejected"]


def test_a_clock_that_steps_back_again_and_again_repeats_no_notice() -> None:
    fed = Fed()
    for lap in range(4):
        events = [
            structs.replace(event, time_s=event.time_s - 1000.0 * lap) for event in displaced(mission(40), 10, 25, 0.5)
        ]
        fed.feed(events)
    assert [notice.code for notice in fed.flush().notices + fed.intake.take_notices()] == [
        "navigation.positions_rejected"
    ]
