"""The only source of time. Live runs use the system's clocks; replay and tests advance theirs by hand."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Two readings: one for durations, one for time stamps. Neither stands in for the other."""

    def monotonic_s(self) -> float:
        """Seconds since an arbitrary start; never steps back, so deadlines and ages are measured with it."""

    def utc_s(self) -> float:
        """UTC seconds since 1970; may step when the system's clock is set."""


class SystemClock:
    """The computer's own clocks."""

    def monotonic_s(self) -> float:
        return time.monotonic()

    def utc_s(self) -> float:
        return time.time()


class ReplayClock:
    """Time as a recorded mission tells it: `utc_s` is the last log time, `monotonic_s` the sum of its forward steps.

    A log whose time steps back sets UTC back, yet no measured duration becomes negative.
    """

    def __init__(self, start_utc_s: float = 0.0) -> None:
        self._utc_s = start_utc_s
        self._monotonic_s = 0.0

    def monotonic_s(self) -> float:
        return self._monotonic_s

    def utc_s(self) -> float:
        return self._utc_s

    def advance_to(self, utc_s: float) -> None:
        """Set the clock to log time `utc_s`; a time that is not finite leaves it as it is."""
        step_s = utc_s - self._utc_s
        if -float("inf") < step_s < float("inf"):
            self._utc_s = utc_s
            self._monotonic_s += max(0.0, step_s)
