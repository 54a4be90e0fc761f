"""Which of the fixes of one source are accepted, on a line where 10 m/s can be travelled."""

from __future__ import annotations

import tracemalloc
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.geometry.fix_agreement import FixAgreement, FixDecision

SPAN_S = 4.5


class Fix(NamedTuple):
    time_s: float
    place_m: float


def agreement(span_s: float = SPAN_S) -> FixAgreement[Fix]:
    return FixAgreement(
        lambda a, b: abs(b.place_m - a.place_m), lambda a, b: 1.0 + 10.0 * abs(b.time_s - a.time_s), span_s
    )


def decided(places_m: list[float], span_s: float = SPAN_S) -> list[FixDecision[Fix]]:
    """What each of the fixes, one a second, decides."""
    one = agreement(span_s)
    return [one.add(Fix(float(t), place_m)) for t, place_m in enumerate(places_m)]


def accepted(decisions: list[FixDecision[Fix]]) -> list[float]:
    return [fix.place_m for decision in decisions for fix in decision.accepted]


def test_the_first_fixes_wait_until_they_span_long_enough_and_are_accepted_together() -> None:
    decisions = decided([0.0] * 7)
    assert [len(decision.accepted) for decision in decisions] == [0, 0, 0, 0, 0, 6, 1]
    assert sum(decision.n_rejected for decision in decisions) == 0


@pytest.mark.parametrize("n_wrong", [1, 2])
def test_the_majority_of_the_first_fixes_is_accepted_wherever_the_wrong_ones_stand(n_wrong: int) -> None:
    for first in range(6 - n_wrong):
        places = [500.0 if first <= t < first + n_wrong else 0.0 for t in range(8)]
        decisions = decided(places)
        assert accepted(decisions) == [0.0] * (8 - n_wrong)
        assert sum(decision.n_rejected for decision in decisions) == n_wrong


def test_somebody_who_cannot_wait_gets_the_best_so_far() -> None:
    one = agreement()
    assert one.is_decided
    for t, place_m in enumerate([900.0, 0.0, 0.0]):
        one.add(Fix(float(t), place_m))
    assert not one.is_decided
    assert [fix.place_m for fix in one.decide().accepted] == [0.0, 0.0]
    assert one.is_decided
    assert one.decide() == FixDecision()


def test_a_step_is_followed_from_its_first_fix_on() -> None:
    decisions = decided([0.0] * 10 + [700.0] * 8)
    step = decisions[15]
    assert [fix.time_s for fix in step.accepted] == [10.0, 11.0, 12.0, 13.0, 14.0, 15.0]
    assert step.step_m == 700.0
    assert step.doubt_m == 700.0
    assert not step.disputed
    assert all(decision.step_m == 0.0 for decision in decisions if decision is not step)


def test_without_a_span_three_fixes_that_agree_are_enough() -> None:
    assert accepted(decided([0.0, 0.0, 700.0, 700.0, 700.0, 700.0], span_s=0.0)) == [
        0.0,
        0.0,
        700.0,
        700.0,
        700.0,
        700.0,
    ]


def test_a_place_that_could_be_reached_in_time_still_belongs_to_its_own_track() -> None:
    """30 m off for four seconds at 10 Hz: 3 s later 10 m/s would do."""
    one = agreement()
    fixes = [Fix(0.1 * t, 30.0 if 60 <= t < 100 else 0.0) for t in range(160)]
    assert {fix.place_m for each in fixes for fix in one.add(each).accepted} == {0.0}


def test_fixes_that_nobody_confirms_are_not_waited_for() -> None:
    one = agreement()
    for t in range(6):
        one.add(Fix(float(t), 0.0))
    one.add(Fix(6.0, 500.0))
    assert one.waiting_since_s == 6.0
    assert one.waiting_apart_m == 500.0
    assert one.advance(10.0).n_rejected == 0
    assert one.advance(12.1).n_rejected == 1
    assert one.waiting_since_s == float("inf")


@settings(max_examples=150, deadline=None)
@given(st.lists(st.sampled_from([0.0, 0.0, 0.0, 300.0, 900.0, -5000.0]), max_size=120))
def test_every_fix_is_accepted_in_order_rejected_once_or_still_waits(places_m: list[float]) -> None:
    one = agreement()
    times: list[float] = []
    n_rejected = 0
    for t, place_m in enumerate(places_m):
        decision = one.add(Fix(float(t), place_m))
        times += [fix.time_s for fix in decision.accepted]
        n_rejected += decision.n_rejected
    n_waiting = len(places_m) - len(times) - n_rejected
    assert n_waiting >= 0
    assert times == sorted(set(times))
    if one.waiting_since_s == float("inf"):
        assert n_waiting == 0


def test_scattered_fixes_cost_no_memory() -> None:
    one = agreement()
    tracemalloc.start()
    try:
        peaks = []
        for lap in range(3):
            for t in range(2000):
                number = 2000 * lap + t
                one.add(Fix(float(number), 1e5 * (number * 7919 % 1009)))
            peaks.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert peaks[-1] < peaks[0] + 8192
