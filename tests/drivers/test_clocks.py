"""Device times on this computer's clocks, beside a lower envelope worked out by going through every message again."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from drivers.clocks import (
    MILLISECOND_COUNTER_S,
    DeviceClock,
    HostTime,
    PulseLabels,
    SourceClock,
    UtcAnchor,
    host_offset_ns,
    wire_delay_s,
)

NS = 1_000_000_000
BOOT_NS = 5_000 * NS
UTC_AT_BOOT_NS = 1_700_000_000 * NS


class Message(NamedTuple):
    true_ns: int  # by the monotonic clock
    device_s: float
    received_ns: int


def stamp(mono_ns: int, utc_step_ns: int = 0) -> Stamp:
    return Stamp(mono_ns, UTC_AT_BOOT_NS + mono_ns + utc_step_ns)


def messages(
    seed: int,
    n: int,
    *,
    drift_ppm: float = 0.0,
    period_s: float = 0.1,
    delay_s: float = 0.02,
    first_s: float = 12.0,
    start_ns: int = BOOT_NS,
) -> list[Message]:
    """Messages of a device whose counter runs off by drift_ppm, each late by an exponential delay, never one before
    another."""
    rng = np.random.Generator(np.random.PCG64(seed))
    made, last_ns = [], 0
    for k in range(n):
        true_ns = start_ns + round(k * period_s * NS)
        device_s = first_s + k * period_s * (1.0 + drift_ppm * 1e-6)
        last_ns = max(last_ns, true_ns + round(rng.exponential(delay_s) * NS))
        made.append(Message(true_ns, device_s, last_ns))
    return made


def mapped(clock: DeviceClock, stream: list[Message]) -> list[HostTime]:
    return [clock.host_time(message.device_s, stamp(message.received_ns)) for message in stream]


def envelope_ns(stream: list[Message], k: int, window_s: float, drift_ppm: int) -> Fraction:
    """Where message k was sent by the lower envelope: every message of the window bounds the offset, loosened by its
    age."""
    now_ns = stream[k].received_ns
    bounds = [
        message.received_ns - round(message.device_s * NS) + Fraction((now_ns - message.received_ns) * drift_ppm, 10**6)
        for message in stream[: k + 1]
        if now_ns - message.received_ns <= window_s * NS
    ]
    return round(stream[k].device_s * NS) + min(bounds)


@given(
    seed=st.integers(0, 10_000),
    drift_ppm=st.floats(-100.0, 100.0),
    delay_s=st.sampled_from([0.0, 0.001, 0.05]),
    period_s=st.sampled_from([0.05, 0.7]),
    window_s=st.sampled_from([2.0, 60.0]),
)
def test_times_follow_the_lower_envelope(
    seed: int, drift_ppm: float, delay_s: float, period_s: float, window_s: float
) -> None:
    stream = messages(seed, 60, drift_ppm=drift_ppm, delay_s=delay_s, period_s=period_s)
    # The window holds one message of any 10 ms: these are as far apart as that.
    stream = [
        message
        for k, message in enumerate(stream)
        if k == 0 or message.received_ns - stream[k - 1].received_ns >= 10_000_000
    ]
    clock = DeviceClock("sonar", window_s=window_s)
    for k, time in enumerate(mapped(clock, stream)):
        assert abs(time.mono_ns - envelope_ns(stream, k, window_s, 100)) <= 2
        assert time.residual_ns == stream[k].received_ns - time.mono_ns >= 0
    assert not clock.counters


@given(seed=st.integers(0, 10_000), drift_ppm=st.floats(-99.0, 99.0), delay_s=st.sampled_from([0.001, 0.02, 0.1]))
def test_a_time_is_never_before_the_truth_nor_after_the_arrival_nor_goes_back(
    seed: int, drift_ppm: float, delay_s: float
) -> None:
    stream = messages(seed, 200, drift_ppm=drift_ppm, delay_s=delay_s)
    times = mapped(DeviceClock("sonar"), stream)
    assert all(
        message.true_ns - 2 <= time.mono_ns <= message.received_ns for message, time in zip(stream, times, strict=True)
    )
    assert all(after.mono_ns >= before.mono_ns for before, after in pairwise(times))


@pytest.mark.parametrize("drift_ppm", [-80.0, 0.0, 80.0])
def test_a_minute_of_late_messages_is_resolved_to_ten_milliseconds(drift_ppm: float) -> None:
    stream = messages(3, 6000, drift_ppm=drift_ppm, delay_s=0.05)
    times = mapped(DeviceClock("sonar"), stream)
    assert (
        max(time.mono_ns - message.true_ns for message, time in zip(stream[600:], times[600:], strict=True))
        < 10_000_000
    )


def test_what_the_wire_and_the_echo_took_is_taken_off() -> None:
    stream = [message._replace(received_ns=message.true_ns + 80_000_000) for message in messages(1, 20)]
    clock = DeviceClock("sonar")
    assert wire_delay_s(1152, 115_200.0) == 0.1
    assert wire_delay_s(1152, None) == 0.0
    for message in stream:
        assert (
            abs(clock.host_time(message.device_s, stamp(message.received_ns), delay_s=0.08).mono_ns - message.true_ns)
            < 100_000
        )


@given(seed=st.integers(0, 1000), n_before=st.integers(1, 60))
def test_a_counter_that_wraps_is_the_same_clock(seed: int, n_before: int) -> None:
    first_s = MILLISECOND_COUNTER_S - n_before * 0.1
    stream = messages(seed, 80, first_s=first_s)
    wrapping = DeviceClock("sonar", wrap_s=MILLISECOND_COUNTER_S)
    wrapped = [message._replace(device_s=message.device_s % MILLISECOND_COUNTER_S) for message in stream]
    times, expected = mapped(wrapping, wrapped), mapped(DeviceClock("sonar"), stream)
    assert all(abs(a.mono_ns - b.mono_ns) < 2000 and a.segment == 0 for a, b in zip(times, expected, strict=True))
    assert not wrapping.counters


@given(
    seed=st.integers(0, 1000),
    first_s=st.sampled_from([30.0, 86_000.0, 3.0e6]),
    outage_s=st.floats(1.0, 300.0),
    wraps=st.booleans(),
    n_before=st.integers(5, 60),
)
def test_a_device_that_starts_anew_is_anchored_anew_at_once(
    seed: int, first_s: float, outage_s: float, wraps: bool, n_before: int
) -> None:
    before = messages(seed, n_before, first_s=first_s)
    after = messages(seed + 1, 60, first_s=0.2, start_ns=before[-1].received_ns + round(outage_s * NS))
    clock = DeviceClock("sonar", wrap_s=MILLISECOND_COUNTER_S if wraps else None)
    assert {time.segment for time in mapped(clock, before)} == {0}
    times = mapped(clock, after)
    assert {time.segment for time in times} == {1}
    assert [time.notice is not None for time in times] == [True] + [False] * 59
    assert times[0].settled_ns == 0 < times[1].settled_ns
    assert all(
        message.true_ns - 2 <= time.mono_ns <= message.received_ns for message, time in zip(after, times, strict=True)
    )
    assert clock.counters == {"clock.anchored_anew": 1}


def test_a_device_that_starts_anew_soon_after_its_start_shows_by_its_ping_number() -> None:
    clock = DeviceClock("sonar")
    for k in range(8):
        clock.host_time(1.0 + k * 0.1, stamp(BOOT_NS + k * 100_000_000), number=k + 1)
    again = clock.host_time(2.0, stamp(BOOT_NS + 20 * NS), number=1)
    assert (again.segment, again.mono_ns) == (1, BOOT_NS + 20 * NS)


def test_a_device_that_fell_back_is_anchored_anew_once_it_is_no_stall() -> None:
    clock = DeviceClock("sonar")
    mapped(clock, before := messages(1, 20, delay_s=0.0))
    after = messages(2, 60, delay_s=0.0, first_s=before[-1].device_s + 0.1, start_ns=before[-1].true_ns + 10 * NS)
    times = mapped(clock, after)
    assert [time.segment for time in times] == [0] * 30 + [1] * 30
    assert times[-1].mono_ns == after[-1].true_ns
    assert times[0].residual_ns > 9 * NS


def test_a_device_with_two_times_is_reported_twenty_times_and_counted() -> None:
    clock = DeviceClock("inertial unit")
    times = [clock.host_time(100.0 + k * 0.1 + k % 2 * 18.0, stamp(BOOT_NS + k * NS // 10)) for k in range(400)]
    notices = [time.notice.text for time in times if time.notice is not None]
    assert len(notices) == 20
    assert notices[-1].endswith("only counted.")
    assert clock.counters["clock.anchored_anew"] == 399


def test_a_stalled_link_leaves_the_times_alone() -> None:
    stream = messages(1, 100, delay_s=0.0)
    stall_end_ns = stream[70].true_ns
    stalled = [
        message._replace(received_ns=max(message.received_ns, stall_end_ns + k)) if k > 20 else message
        for k, message in enumerate(stream)
    ]
    clock = DeviceClock("sonar")
    times = mapped(clock, stalled)
    assert all(
        abs(time.mono_ns - message.true_ns) < 1_000_000 and time.segment == 0
        for message, time in zip(stalled, times, strict=True)
    )
    assert not clock.counters


def test_a_device_time_that_leaps_ahead_costs_two_anchors_and_no_wrong_time() -> None:
    stream = messages(1, 60, delay_s=0.001)
    damaged = [
        message._replace(device_s=message.device_s + 1e6) if k == 30 else message for k, message in enumerate(stream)
    ]
    times = mapped(DeviceClock("sonar"), damaged)
    assert [time.segment for time in times] == [0] * 30 + [1] + [2] * 29
    assert all(0 <= time.mono_ns - message.true_ns < 20_000_000 for message, time in zip(damaged, times, strict=True))


@pytest.mark.parametrize("nonsense", [None, math.nan, math.inf, -math.inf, 1e300])
def test_without_a_device_time_the_arrival_stands(nonsense: float | None) -> None:
    clock = DeviceClock("sonar")
    clock.host_time(3.0, stamp(BOOT_NS))
    time = clock.host_time(nonsense, stamp(BOOT_NS + NS), delay_s=0.25)
    assert time.mono_ns == BOOT_NS + NS - NS // 4
    assert clock.counters == {"clock.without_device_time": 1}


@given(
    times=st.lists(st.tuples(st.floats(0.0, 5000.0), st.integers(0, 3 * NS), st.floats(0.0, 0.5)), max_size=60),
    wraps=st.booleans(),
)
def test_no_device_time_however_wild_makes_time_go_back_inside_a_segment(
    times: list[tuple[float, int, float]], wraps: bool
) -> None:
    clock, anchor, now_ns = DeviceClock("sonar", wrap_s=600.0 if wraps else None), UtcAnchor("host"), BOOT_NS
    source, last = SourceClock(clock, anchor), {0: 0}
    for device_s, step_ns, delay_s in times:
        now_ns += step_ns
        anchor.follow(host_offset_ns(stamp(now_ns)), now_ns)
        time = source.time(device_s, stamp(now_ns), delay_s=delay_s)
        assert time.utc_ns >= last.get(time.segment, 0)
        assert time.segment >= max(last)
        last[time.segment] = time.utc_ns


@given(
    seed=st.integers(0, 1000),
    # Five messages apart: a step is accepted once two messages in a row have seen it.
    steps=st.lists(
        st.tuples(st.sampled_from(range(0, 100, 5)), st.sampled_from([-3600, 3600, 1, -3])),
        max_size=4,
        unique_by=lambda s: s[0],
    ),
    jitter_ns=st.sampled_from([0, 50_000, 3_000_000]),
)
def test_steps_of_this_computers_clock_are_reported_and_followed(
    seed: int, steps: list[tuple[int, int]], jitter_ns: int
) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    anchor = UtcAnchor("this computer")
    source = SourceClock(DeviceClock("sonar"), anchor)
    step_ns, n_notices, last = 0, 0, dict[int, int]()
    for k, message in enumerate(messages(seed, 120, delay_s=0.002)):
        step_ns += sum(step_s for at, step_s in steps if at == k) * NS
        held_up_ns = round(rng.exponential(jitter_ns)) if jitter_ns else 0
        received = stamp(message.received_ns, step_ns + held_up_ns)
        n_notices += anchor.follow(host_offset_ns(received), received.mono_ns) is not None
        time = source.time(message.device_s, received)
        assert time.utc_ns >= last.get(time.segment, 0)
        last[time.segment] = time.utc_ns
        if not any(at <= k < at + 2 for at, _ in steps):
            assert abs(time.utc_ns - (UTC_AT_BOOT_NS + message.true_ns + step_ns)) < 40_000_000
    # A step at the first message is where UTC starts; one that is undone before it was seen twice is none.
    assert n_notices <= len(steps)
    assert anchor.segment == n_notices
    if all(at > 0 for at, _ in steps):
        assert n_notices == len(steps)


def test_one_late_look_at_utc_is_no_step() -> None:
    anchor = UtcAnchor("this computer")
    for k in range(20):
        held_up_ns = 300_000_000 if k == 7 else 0
        assert anchor.follow(UTC_AT_BOOT_NS + held_up_ns, k * NS) is None
        assert anchor.utc_ns(0) == UTC_AT_BOOT_NS


def test_slewing_is_followed() -> None:
    anchor = UtcAnchor("this computer")
    for k in range(200):
        assert anchor.follow(k * 400_000, k * NS) is None
        assert anchor.utc_ns(0) == k * 400_000


def test_a_pulse_off_beat_or_a_sentence_without_one_gives_nothing() -> None:
    labels = PulseLabels()
    assert labels.offset_ns(5.0, stamp(BOOT_NS)) is None
    labels.pulse(BOOT_NS - 1)  # no clock keeps a beat to the nanosecond
    labels.pulse(BOOT_NS + NS)
    assert labels.offset_ns(6.0, stamp(BOOT_NS + NS + 1)) is not None
    assert labels.offset_ns(6.5, stamp(BOOT_NS + NS + 1)) is None
    assert labels.offset_ns(6.0, stamp(BOOT_NS + 2 * NS)) is None
    labels.pulse(BOOT_NS + NS + 400_000_000)
    assert labels.offset_ns(7.0, stamp(BOOT_NS + NS + 500_000_000)) is None
    assert labels.counters == {"pulse.label_without_pulse": 3, "pulse.label_not_full_second": 1, "pulse.off_beat": 1}
