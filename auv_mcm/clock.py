"""Define the only source of time, and the time stamp of bytes."""

from __future__ import annotations

import time
from typing import NamedTuple, Protocol


class Clock(Protocol):
    """Read time twofold: for durations, and for time stamps. Neither stands in for the other."""

    def monotonic_s(self) -> float:
        """Read seconds since an arbitrary start.

        Never steps back, so deadlines and ages are measured with it.
        """

    def utc_s(self) -> float:
        """Read UTC seconds since 1970; may step when the system's clock is set."""


class SystemClock:
    """Read the computer's own clocks."""

    def monotonic_s(self) -> float:
        return time.monotonic()

    def utc_s(self) -> float:
        return time.time()


class Stamp(NamedTuple):
    """Time at which the last byte of a chunk was read, on both clocks of this computer.

    mono_ns: monotonic clock. utc_ns: nanoseconds since 1970, as this computer's clock showed them.
    """

    mono_ns: int
    utc_ns: int
