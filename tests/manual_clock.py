"""A clock that tests advance by hand."""

from __future__ import annotations


class ManualClock:
    """Give time as a recorded mission has it: `utc_s` is the last log time, `monotonic_s` the sum of its forward steps.

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
