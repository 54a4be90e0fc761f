"""Each fault strikes the pings it is meant for, and faults compose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.records import EchoTrace, NavSample, Ping
from sim_replay.simulator.faults import with_faults
from sim_replay.simulator.scene import Fault, SampleRecorder

N_PINGS = 12
RECORDER = SampleRecorder(samples="amplitude_uint16")


def samples(number: int, side: str) -> NDArray[np.uint16]:
    """Different for every ping and side."""
    return (np.arange(4) + 10 * number + (1000 if side == "port" else 2000)).astype(np.uint16)


def mission(n_pings: int = N_PINGS, dtype: Any = np.uint16) -> Iterator[NavSample | Ping]:
    for number in range(n_pings):
        yield NavSample(time_s=100.0 + number, latitude_deg=43.0)
        port, starboard = (
            EchoTrace(samples=samples(number, side).astype(dtype), first_range_m=0.1, spacing_m=0.2)
            for side in ("port", "starboard")
        )
        yield Ping(
            number=number, time_s=100.0 + number, port=port, starboard=starboard, altitude_m=6.0, place=f"ping {number}"
        )


def struck(*faults: Fault, recorder: SampleRecorder = RECORDER) -> tuple[list[NavSample], list[Ping]]:
    events = list(with_faults(mission(), faults, recorder))
    return [event for event in events if isinstance(event, NavSample)], [
        event for event in events if isinstance(event, Ping)
    ]


def numbers(pings: Sequence[Ping]) -> list[int]:
    return [ping.number for ping in pings]


def of(ping: Ping, side: str) -> list[float]:
    trace: EchoTrace | None = getattr(ping, side)
    assert trace is not None
    values: list[float] = trace.samples.tolist()
    return values


def check_untouched(pings: Sequence[Ping], but: Sequence[int] = (), side: str = "both") -> None:
    for ping in pings:
        for each in ("port", "starboard"):
            if ping.number not in but or side not in ("both", each):
                assert of(ping, each) == samples(ping.number, each).tolist()


def same(events: Sequence[NavSample | Ping], others: Sequence[NavSample | Ping]) -> bool:
    def facts(event: NavSample | Ping) -> object:
        if isinstance(event, NavSample):
            return event
        traces = (event.port, event.starboard)
        return (
            event.number,
            event.time_s,
            [None if t is None else (t.samples.tolist(), t.samples.dtype) for t in traces],
        )

    return [facts(event) for event in events] == [facts(event) for event in others]


def test_navigation_after_the_last_ping_passes_too() -> None:
    last = NavSample(time_s=500.0)
    fault = Fault(kind="gap", at_ping=3)
    assert list(with_faults([*mission(), last], (fault,), RECORDER))[-1] is last


@pytest.mark.parametrize(("kind", "left"), [("drop", [0, 1, 2, 3, 5, 7, 9, 10, 11]), ("gap", [0, 1, 2, 3, 9, 10, 11])])
def test_a_drop_loses_every_other_ping_a_gap_all_of_them_and_neither_navigation(kind: Any, left: list[int]) -> None:
    navigation, pings = struck(Fault(kind=kind, at_ping=4, n_pings=5))
    assert numbers(pings) == left
    assert len(navigation) == N_PINGS
    check_untouched(pings)


@pytest.mark.parametrize("side", ["port", "starboard", "both"])
def test_a_gain_step_multiplies_amplitudes(side: Any) -> None:
    _, pings = struck(Fault(kind="gain_step", at_ping=4, n_pings=3, side=side, gain_db=-6.0))
    assert numbers(pings) == list(range(N_PINGS))
    check_untouched(pings, but=(4, 5, 6), side=side)
    for number in (4, 5, 6):
        for each in ("port", "starboard"):
            if side in ("both", each):
                factor = 10.0 ** (-6.0 / 20.0)
                assert of(pings[number], each) == [round(value * factor) for value in samples(number, each).tolist()]


@pytest.mark.parametrize(
    ("recorder", "dtype", "gain_db", "expected"),
    [
        (SampleRecorder(samples="amplitude_uint16"), np.uint16, 20.0, [0, 1000, 65535]),
        (SampleRecorder(samples="amplitude_uint16", full_scale=4095), np.uint16, 40.0, [0, 4095, 4095]),
        (SampleRecorder(samples="amplitude_uint8"), np.uint8, 6.0206, [0, 200, 255]),
        (SampleRecorder(samples="amplitude_uint8", full_scale=15), np.uint8, -40.0, [0, 1, 2]),
        (SampleRecorder(samples="amplitude_float32"), np.float32, 60.0, [0.0, 1e5, 2e7]),
        (SampleRecorder(samples="amplitude_float32", full_scale=50_000), np.float32, 60.0, [0.0, 5e4, 5e4]),
        (SampleRecorder(samples="log_uint8", db_per_count=0.5), np.uint8, 6.0, [12, 112, 212]),
        (SampleRecorder(samples="log_uint8", db_per_count=0.5, full_scale=200), np.uint8, -6.0, [0, 88, 188]),
        (SampleRecorder(samples="log_uint8", db_per_count=0.5, full_scale=200), np.uint8, 10.0, [20, 120, 200]),
        (SampleRecorder(samples="log_uint16", db_per_count=0.01), np.uint16, 60.0, [6000, 6100, 65535]),
    ],
)
def test_gain_is_stored_as_the_recorder_stores_it(
    recorder: SampleRecorder, dtype: Any, gain_db: float, expected: list[float]
) -> None:
    loudest = {"amplitude_float32": 2e4, "amplitude_uint16": 60_000, "log_uint16": 60_000}.get(recorder.samples, 200)
    trace = EchoTrace(samples=np.array([0, 100, loudest], dtype=dtype), first_range_m=0.1, spacing_m=0.2)
    ping = Ping(number=0, time_s=0.0, port=trace, starboard=None)
    (louder,) = with_faults([ping], [Fault(kind="gain_step", at_ping=0, gain_db=gain_db)], recorder)
    assert isinstance(louder, Ping)
    assert louder.starboard is None
    assert louder.port is not None
    assert louder.port.samples.dtype == dtype
    assert of(louder, "port") == pytest.approx(expected)
    assert trace.samples.tolist() == [0, 100, loudest]


@pytest.mark.parametrize("samples_are", ["uint16", "log_uint8"])
def test_interference_is_as_far_above_the_middle_sample_as_stated_and_moves(samples_are: Any) -> None:
    random = np.random.default_rng(3)
    recorder = SampleRecorder(samples=samples_are, db_per_count=0.5)
    echoes = random.integers(50, 60, 1000).astype(np.uint16 if samples_are == "uint16" else np.uint8)
    trace = EchoTrace(samples=echoes, first_range_m=0.05, spacing_m=0.1)
    pings = [Ping(number=n, time_s=float(n), port=trace, starboard=trace) for n in range(40)]
    fault = Fault(kind="interference", at_ping=0, n_pings=40, side="port", gain_db=20.0)
    heard = [event for event in with_faults(pings, [fault], recorder) if isinstance(event, Ping)]
    assert all(of(ping, "starboard") == echoes.tolist() for ping in heard)
    middle = float(np.median(echoes.astype(np.float64)))
    level = round(10.0 * middle) if samples_are == "uint16" else round(middle + 40.0)
    struck = [np.flatnonzero(np.array(of(ping, "port")) != echoes).tolist() for ping in heard]
    assert {of(ping, "port")[k] for ping, where in zip(heard, struck, strict=True) for k in where} == {level}
    assert 8 <= np.mean([len(where) for where in struck]) <= 16
    assert len({tuple(where) for where in struck}) == 40


@pytest.mark.parametrize("kind", ["gain_step", "interference"])
def test_a_level_in_logarithms_of_unknown_scale_is_refused_before_the_first_event(kind: Any) -> None:
    fault = Fault(kind=kind, at_ping=1000, gain_db=3.0)
    with pytest.raises(UsageError, match="db_per_count"):
        next(with_faults(mission(), [fault], SampleRecorder(samples="log_uint8")))


@pytest.mark.parametrize("side", ["port", "starboard", "both"])
def test_a_stuck_channel_repeats_its_last_samples(side: Any) -> None:
    _, pings = struck(Fault(kind="stuck_channel", at_ping=4, n_pings=3, side=side))
    check_untouched(pings, but=(4, 5, 6), side=side)
    for ping in pings[4:7]:
        for each in ("port", "starboard"):
            if side in ("both", each):
                assert of(ping, each) == samples(3, each).tolist()
        assert ping.time_s == 100.0 + ping.number


def test_a_channel_stuck_from_the_start_repeats_the_first_samples() -> None:
    _, pings = struck(Fault(kind="stuck_channel", at_ping=0, n_pings=3))
    assert [of(ping, "port") for ping in pings[:4]] == [samples(number, "port").tolist() for number in (0, 0, 0, 3)]


@pytest.mark.parametrize("side", ["port", "starboard", "both"])
def test_a_dead_channel_is_missing(side: Any) -> None:
    _, pings = struck(Fault(kind="dead_channel", at_ping=4, n_pings=3, side=side))
    check_untouched([ping for ping in pings if ping.number not in (4, 5, 6)])
    for ping in pings[4:7]:
        assert (ping.port is None) == (side in ("both", "port"))
        assert (ping.starboard is None) == (side in ("both", "starboard"))


def test_a_clock_step_moves_pings_and_navigation_for_good() -> None:
    navigation, pings = struck(Fault(kind="clock_step", at_ping=4, n_pings=1, step_s=-3600.0))
    expected = [100.0 + number - (3600.0 if number >= 4 else 0.0) for number in range(N_PINGS)]
    assert [ping.time_s for ping in pings] == expected
    assert [sample.time_s for sample in navigation] == expected
    check_untouched(pings)


def test_a_navigation_loss_takes_the_navigation_alone() -> None:
    navigation, pings = struck(Fault(kind="navigation_loss", at_ping=4, n_pings=3))
    assert [sample.time_s - 100.0 for sample in navigation] == [0.0, 1.0, 2.0, 3.0, 7.0, 8.0, 9.0, 10.0, 11.0]
    assert numbers(pings) == list(range(N_PINGS))
    check_untouched(pings)


def test_navigation_of_a_lost_ping_is_lost_with_that_pings_number() -> None:
    gap = Fault(kind="gap", at_ping=3, n_pings=4)
    loss = Fault(kind="navigation_loss", at_ping=4, n_pings=2)
    for faults in ((gap, loss), (loss, gap)):
        navigation, pings = struck(*faults)
        assert [sample.time_s - 100.0 for sample in navigation] == [0, 1, 2, 3, 6, 7, 8, 9, 10, 11]
        assert numbers(pings) == [0, 1, 2, 7, 8, 9, 10, 11]


def test_gains_multiply_and_clock_steps_add() -> None:
    faults = [
        Fault(kind="gain_step", at_ping=2, n_pings=9, gain_db=20.0),
        Fault(kind="gain_step", at_ping=4, n_pings=2, gain_db=-20.0),
    ]
    faults += [Fault(kind="clock_step", at_ping=1, step_s=5.0), Fault(kind="clock_step", at_ping=6, step_s=2.0)]
    _, pings = struck(*faults)
    assert [ping.time_s - 100.0 - ping.number for ping in pings] == [0.0] + [5.0] * 5 + [7.0] * 6
    check_untouched([pings[number] for number in (0, 1, 4, 5, 11)])
    assert of(pings[3], "port") == [10 * value for value in samples(3, "port").tolist()]


def test_a_stuck_channel_repeats_what_the_faults_before_it_left() -> None:
    stuck = Fault(kind="stuck_channel", at_ping=4, n_pings=2)
    gain = Fault(kind="gain_step", at_ping=3, n_pings=1, gain_db=20.0)
    later_gain = Fault(kind="gain_step", at_ping=5, n_pings=1, gain_db=20.0)
    _, pings = struck(gain, stuck, later_gain)
    amplified = [10 * value for value in samples(3, "port").tolist()]
    assert of(pings[4], "port") == amplified
    assert of(pings[5], "port") == [min(65535, 10 * value) for value in amplified]
    _, pings = struck(stuck, gain)
    assert of(pings[4], "port") == samples(3, "port").tolist()
    _, pings = struck(Fault(kind="gap", at_ping=3), stuck)
    assert of(pings[3], "port") == samples(2, "port").tolist()
    _, pings = struck(Fault(kind="dead_channel", at_ping=4), stuck)
    assert pings[4].port is None
    assert of(pings[5], "port") == samples(3, "port").tolist()


faults = st.builds(
    Fault,
    kind=st.sampled_from(
        ["drop", "gap", "gain_step", "stuck_channel", "dead_channel", "clock_step", "navigation_loss", "interference"]
    ),
    at_ping=st.integers(0, 14),
    n_pings=st.integers(1, 8),
    side=st.sampled_from(["port", "starboard", "both"]),
    gain_db=st.floats(-60.0, 60.0),
    step_s=st.floats(-100.0, 100.0),
)


@given(st.lists(faults, max_size=4), faults)
def test_faults_strike_one_after_the_other_and_alike_each_time(first: list[Fault], last: Fault) -> None:
    once = list(with_faults(mission(), [*first, last], RECORDER))
    assert same(once, list(with_faults(mission(), [*first, last], RECORDER)))
    if not any(
        fault.kind in ("drop", "gap") for fault in first
    ):  # a lost ping takes the number of its navigation with it
        assert same(once, list(with_faults(with_faults(mission(), first, RECORDER), [last], RECORDER)))
    assert numbers([event for event in once if isinstance(event, Ping)]) == sorted(
        {e.number for e in once if isinstance(e, Ping)}
    )


@given(st.lists(faults, max_size=4))
def test_pings_before_the_first_fault_are_untouched(several: list[Fault]) -> None:
    start = min((fault.at_ping for fault in several), default=N_PINGS)
    before = 2 * min(start, N_PINGS)
    assert same(list(islice(with_faults(mission(), several, RECORDER), before)), list(islice(mission(), before)))


def test_events_come_one_by_one_and_what_was_read_is_not_changed() -> None:
    kept = list(mission())
    copies = [structs.replace(event) for event in kept]
    all_kinds = [
        Fault(kind=kind, at_ping=2, n_pings=3, gain_db=6.0, step_s=1.0)
        for kind in ("gain_step", "stuck_channel", "clock_step")
    ]
    asked = 0

    def source() -> Iterator[NavSample | Ping]:
        nonlocal asked
        for event in kept:
            asked += 1
            yield event

    arriving = with_faults(source(), all_kinds, RECORDER)
    for number in range(N_PINGS):
        assert isinstance(next(arriving), NavSample)
        assert isinstance(next(arriving), Ping)
        assert asked == 2 * (number + 1)
    assert same(kept, copies)
    check_untouched([event for event in kept if isinstance(event, Ping)])
