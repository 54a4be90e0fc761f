"""Add up what stages of the chain cost, where somebody wants to know."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext


class StageTimers(dict[str, AbstractContextManager[None]]):
    """Give what is entered while a stage runs, by its name; several are entered per ping, so each is made once.

    A stage is not entered within itself.
    """

    def __init__(self, timer: Callable[[], float] | None, costs_s: dict[str, float]) -> None:
        """costs_s: by stage, added to; nothing without a timer."""
        super().__init__()
        self._timer, self._costs_s = timer, costs_s

    def __missing__(self, stage: str) -> AbstractContextManager[None]:
        self[stage] = nullcontext() if self._timer is None else _Timed(stage, self._timer, self._costs_s)
        return self[stage]


class _Timed:
    """Add what a stage takes to its costs."""

    __slots__ = ("_costs_s", "_stage", "_start_s", "_timer")

    def __init__(self, stage: str, timer: Callable[[], float], costs_s: dict[str, float]) -> None:
        self._stage, self._timer, self._costs_s = stage, timer, costs_s

    def __enter__(self) -> None:
        self._start_s = self._timer()

    def __exit__(self, *_: object) -> None:
        self._costs_s[self._stage] = self._costs_s.get(self._stage, 0.0) + self._timer() - self._start_s
