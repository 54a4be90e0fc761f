"""Check that two sides of one transmission, and only they, become one frame, and that no side is lost."""

from __future__ import annotations

from collections import Counter

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from auv_mcm.records import EchoTrace
from drivers.sonar.pairing import SidePairer
from drivers.sonar.sonar_decoder import SonarFrame

RANGE_M = 50.0
PERIOD_S = 0.08


def side(to_port: bool, number: int, time_s: float | None, received: int = 0) -> SonarFrame:
    trace = EchoTrace(samples=np.ones(10, dtype=np.float32), first_range_m=2.5, spacing_m=RANGE_M / 10)
    return SonarFrame(
        number=number,
        port=trace if to_port else None,
        starboard=None if to_port else trace,
        transfer="intensity",
        received=Stamp(received, received),
        n_bytes=62,
        device_time_s=time_s,
    )


def paired(sides: list[SonarFrame]) -> tuple[list[tuple[int, str]], Counter[str]]:
    counters: Counter[str] = Counter()
    pairer = SidePairer(counters)
    frames = [frame for one in sides for frame in pairer.add(one)] + pairer.finish()
    return [
        (frame.number, "P" * (frame.port is not None) + "S" * (frame.starboard is not None)) for frame in frames
    ], counters


def test_sides_with_one_number_are_one_transmission() -> None:
    frames, counters = paired([side(port, n, n * PERIOD_S) for n in range(3) for port in (True, False)])
    assert frames == [(0, "PS"), (1, "PS"), (2, "PS")]
    assert counters == {}


def test_heads_that_count_for_themselves_are_paired_by_time() -> None:
    frames, _ = paired(
        [side(port, n + (0 if port else 40), n * PERIOD_S + 0.001 * port) for n in range(3) for port in (False, True)]
    )
    assert [sides for _, sides in frames] == ["PS"] * 3


def test_heads_without_a_common_clock_are_paired_by_number() -> None:
    frames, _ = paired([side(port, n, n * PERIOD_S + 900.0 * port) for n in range(3) for port in (False, True)])
    assert frames == [(0, "PS"), (1, "PS"), (2, "PS")]


def test_a_lone_side_goes_out_after_the_next_message_and_is_counted() -> None:
    counters: Counter[str] = Counter()
    pairer = SidePairer(counters)
    assert pairer.add(side(True, 1, PERIOD_S)) == []
    (lone,) = pairer.add(side(True, 2, 2 * PERIOD_S))
    assert (lone.number, lone.starboard) == (1, None)
    (both,) = pairer.add(side(False, 2, 2 * PERIOD_S))
    assert both.number == 2
    assert counters == {"pairing.lone_port": 1}


def test_a_side_never_joins_the_next_transmission() -> None:
    frames, counters = paired([side(True, 1, PERIOD_S), side(False, 2, 2 * PERIOD_S), side(True, 3, 3 * PERIOD_S)])
    assert frames == [(1, "P"), (2, "S"), (3, "P")]
    assert counters == {"pairing.lone_port": 2, "pairing.lone_starboard": 1}


def test_a_head_that_does_not_count_its_pings_repeats_none() -> None:
    assert paired([side(True, 0, n * PERIOD_S) for n in range(3)])[0] == [(0, "P")] * 3


def test_a_repeated_message_counts_once() -> None:
    port, starboard = side(True, 1, PERIOD_S), side(False, 1, PERIOD_S)
    for sides in ([port, port, starboard], [port, starboard, starboard], [port, starboard, port]):
        frames, counters = paired(sides)
        assert frames == [(1, "PS")]
        assert counters == {"pairing.repeated_side": 1}


def test_the_frame_arrived_when_its_first_side_did() -> None:
    pairer = SidePairer(Counter())
    pairer.add(side(False, 1, PERIOD_S, received=10))
    (frame,) = pairer.add(side(True, 1, PERIOD_S, received=20))
    assert frame.received == Stamp(10, 10)


@given(
    lost=st.lists(st.tuples(st.booleans(), st.booleans()), max_size=30),
    starboard_first=st.booleans(),
    common=st.booleans(),
)
def test_whatever_is_lost_every_remaining_side_comes_out_once_and_in_its_place(
    lost: list[tuple[bool, bool]], starboard_first: bool, common: bool
) -> None:
    order = (False, True) if starboard_first else (True, False)
    offset = 0 if common else 17
    sides = [
        side(port, n if port else n + offset, n * PERIOD_S)
        for n, gone in enumerate(lost)
        for port in order
        if not gone[port]  # a message that did not arrive
    ]
    wanted = ["P" * (not gone[True]) + "S" * (not gone[False]) for gone in lost if not all(gone)]
    frames, counters = paired(sides)
    assert [kinds for _, kinds in frames] == wanted
    assert counters["pairing.lone_port"] == wanted.count("P")
    assert counters["pairing.lone_starboard"] == wanted.count("S")
