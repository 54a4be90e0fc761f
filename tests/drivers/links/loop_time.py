"""Provide an event loop whose time passes only when there is nothing to do, and then at once as far as its next
timer."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Callable, Coroutine
from contextvars import Context
from typing import Any, TypeVar, TypeVarTuple, Unpack

R = TypeVar("R")
Ts = TypeVarTuple("Ts")


class _Selector(selectors.SelectSelector):
    """Never waits where a timer is set, but says for how long it would have."""

    def __init__(self) -> None:
        super().__init__()
        self.n_waits = 0
        self.waited_s = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self.n_waits += 1
        ready = super().select(None if timeout is None else 0.0)
        if not ready:
            self.waited_s += timeout or 0.0
        return ready


class LoopTime(asyncio.SelectorEventLoop):
    """n_wake_ups: how often it looked for something to do. timers: all that were ever set."""

    def __init__(self) -> None:
        self._waits = _Selector()
        self.timers: list[asyncio.TimerHandle] = []
        super().__init__(self._waits)

    @property
    def n_wake_ups(self) -> int:
        return self._waits.n_waits

    @property
    def n_timers_set(self) -> int:
        """Of those that neither fired nor were cancelled."""
        return sum(not timer.cancelled() and timer.when() > self.time() for timer in self.timers)

    def time(self) -> float:
        return 1000.0 + self._waits.waited_s

    def call_at(
        self, when: float, callback: Callable[[Unpack[Ts]], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.TimerHandle:
        timer = super().call_at(when, callback, *args, context=context)
        self.timers.append(timer)
        return timer


class LoopClock:
    """Return the loop's time as that of a link."""

    def monotonic_s(self) -> float:
        return asyncio.get_running_loop().time()

    def utc_s(self) -> float:
        return 1.7e9 + self.monotonic_s()


def run_in_loop_time(scenario: Callable[[LoopTime], Coroutine[Any, Any, R]]) -> R:
    loop = LoopTime()
    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        return runner.run(scenario(loop))
