"""Run the real service on a computer whose UTC steps: clocks that others use cannot be set for a test.

`python -m sim_replay.hil.stepping_service CONFIG AT_S BY_S`; a line `start SECONDS` on standard input gives the start
of the run, by the monotonic clock.
"""

from __future__ import annotations

import math
import sys
import threading
from pathlib import Path
from typing import TextIO

from auv_mcm.clock import Clock, SystemClock
from auv_mcm.commands import read_config
from auv_mcm.commands.run import run_service


class SteppingClock:
    """Provide a clock whose UTC is by_s ahead from the monotonic instant given to `step_at` on."""

    def __init__(self, clock: Clock, by_s: float) -> None:
        self._clock = clock
        self._by_s = by_s
        self._from_s = math.inf

    def step_at(self, mono_s: float) -> None:
        """Step UTC from an instant of the monotonic clock on."""
        self._from_s = mono_s

    def monotonic_s(self) -> float:
        return self._clock.monotonic_s()

    def utc_s(self) -> float:
        utc_s = self._clock.utc_s()
        return utc_s if self._clock.monotonic_s() < self._from_s else utc_s + self._by_s


def follow(clock: SteppingClock, lines: TextIO, at_s: float) -> None:
    """Step the clock at_s after the start that the lines give."""
    for line in lines:
        word, _, start_s = line.partition(" ")
        if word == "start":
            clock.step_at(float(start_s) + at_s)


def main(config: str, at_s: str, by_s: str) -> int:
    """Run the service with a clock that steps."""
    clock = SteppingClock(SystemClock(), float(by_s))
    threading.Thread(target=follow, args=(clock, sys.stdin, float(at_s)), daemon=True).start()
    return run_service(read_config(Path(config)), clock)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
