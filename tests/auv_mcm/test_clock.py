from __future__ import annotations

import time

import pytest

from auv_mcm.clock import Clock, SystemClock
from tests.manual_clock import ManualClock


def test_system_clock_reads_the_system() -> None:
    clock: Clock = SystemClock()
    before_s = time.time()
    first_s = clock.monotonic_s()
    assert before_s <= clock.utc_s() <= time.time()
    assert clock.monotonic_s() >= first_s


def test_a_manual_clock_reads_what_it_is_advanced_to() -> None:
    clock = ManualClock(1_700_000_000.0)
    clock.advance_to(1_700_000_012.5)
    assert clock.utc_s() == 1_700_000_012.5
    assert clock.monotonic_s() == 12.5


@pytest.mark.parametrize("step_s", [-3600.0, 3600.0, 0.0])
def test_durations_never_go_back_when_log_time_steps(step_s: float) -> None:
    clock: Clock = (replay := ManualClock(1000.0))
    replay.advance_to(1010.0)
    replay.advance_to(1010.0 + step_s)
    assert clock.utc_s() == 1010.0 + step_s
    assert clock.monotonic_s() == 10.0 + max(0.0, step_s)


@pytest.mark.parametrize("nonsense", [float("nan"), float("inf"), float("-inf")])
def test_a_log_time_that_is_not_finite_moves_nothing(nonsense: float) -> None:
    clock = ManualClock(5.0)
    clock.advance_to(nonsense)
    assert (clock.utc_s(), clock.monotonic_s()) == (5.0, 0.0)
