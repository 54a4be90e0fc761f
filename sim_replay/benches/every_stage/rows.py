"""Time a stage and what a user would take instead, in turn, and hold what they cost beside how far they err."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import msgspec

_SLOW_S: Final = 1.0  # beyond it once is enough: its own scatter no longer matters


class Cost(msgspec.Struct, frozen=True):
    """Hold processor times of repeats, ms."""

    times_ms: tuple[float, ...]

    @property
    def ms(self) -> float:
        """Take the median."""
        return statistics.median(self.times_ms)


class Alternative(msgspec.Struct, frozen=True, kw_only=True):
    """Hold what a user would take instead. missing: why it was not measured; empty where it was."""

    name: str
    cost: Cost | None = None
    error: float | None = None
    missing: str = ""


class StageRow(msgspec.Struct, frozen=True, kw_only=True):
    """Hold a stage at one setting.

    error: in the unit named. limit: the most that it may be, which the quick form holds it to; None for no limit.
    """

    stage: str
    setting: str
    cost: Cost
    error: float
    unit: str
    limit: float | None = None
    alternative: Alternative | None = None

    @property
    def holds(self) -> bool:
        """Check whether the error is within the limit."""
        return self.limit is None or self.error <= self.limit


class Amount(NamedTuple):
    """Say how much to measure. n: inputs per row; repeat: times per input."""

    n: int
    repeat: int


def timed(repeat: int, *works: Callable[[], Any]) -> list[tuple[Any, Cost]]:
    """Do works in turn, so that a busy computer slows all alike; returns what each gave last, and its cost."""
    given: list[Any] = [None] * len(works)
    times_ms: list[list[float]] = [[] for _ in works]
    for _ in range(repeat):
        for k, work in enumerate(works):
            if times_ms[k] and times_ms[k][-1] > 1e3 * _SLOW_S:
                continue
            began_s = time.thread_time()
            given[k] = work()
            times_ms[k].append(1e3 * (time.thread_time() - began_s))
    return [(result, Cost(tuple(times))) for result, times in zip(given, times_ms, strict=True)]
