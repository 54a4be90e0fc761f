"""Declare stages at their settings, beside what a user would take instead, and measure what each costs and errs."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
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


class Other(NamedTuple):
    """Declare what a user would take instead of a row.

    error: of its answer, as the row's if None. per: as of a row. missing: why it cannot be measured; empty where it can
    be.
    """

    name: str
    work: Callable[[], Any]
    error: Callable[[Any], float] | None = None
    per: float = 1.0
    missing: str = ""


class Row(NamedTuple):
    """Declare a stage at one setting.

    work: does it on inputs that it holds, and gives an answer. error: of the answer, in the unit named. bound: the most
    that it may be; None for no bound. per: what the time is divided by.
    """

    stage: str
    setting: str
    work: Callable[[], Any]
    error: Callable[[Any], float]
    unit: str
    bound: float | None = None
    alternative: Other | None = None
    per: float = 1.0


def measured(rows: Sequence[Row], repeat: int) -> list[StageRow]:
    """Do the works of all rows in turn, each once however many rows it stands in, and take costs and errors."""
    others = [row.alternative.work for row in rows if row.alternative is not None and not row.alternative.missing]
    works = list(dict.fromkeys([*(row.work for row in rows), *others]))
    done = dict(zip(works, timed(repeat, *works), strict=True))

    def cost(work: Callable[[], Any], per: float) -> Cost:
        return Cost(tuple(ms / per for ms in done[work][1].times_ms))

    found = []
    for row in rows:
        other = None
        if row.alternative is not None:
            name, work, error, per, missing = row.alternative
            other = Alternative(name=name, missing=missing)
            if not missing:
                other = Alternative(name=name, cost=cost(work, per), error=(error or row.error)(done[work][0]))
        found.append(
            StageRow(
                stage=row.stage,
                setting=row.setting,
                cost=cost(row.work, row.per),
                error=row.error(done[row.work][0]),
                unit=row.unit,
                limit=row.bound,
                alternative=other,
            )
        )
    return found


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
