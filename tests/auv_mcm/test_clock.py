"""The clock of the computer."""

from __future__ import annotations

import time

from auv_mcm.clock import Clock, SystemClock


def test_system_clock_reads_the_system() -> None:
    clock: Clock = SystemClock()
    before_s = time.time()
    first_s = clock.monotonic_s()
    assert before_s <= clock.utc_s() <= time.time()
    assert clock.monotonic_s() >= first_s
