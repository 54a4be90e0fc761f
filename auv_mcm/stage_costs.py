"""Add up what stages of the chain cost, where somebody wants to know."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from typing import Final

UNTIMED: Final = nullcontext()
"""Enter this where nobody does."""


class Timed:
    """Add what a stage takes to its costs. Several are entered per ping, so this is no generator."""

    __slots__ = ("_costs_s", "_stage", "_start_s", "_timer")

    def __init__(self, stage: str, timer: Callable[[], float], costs_s: dict[str, float]) -> None:
        self._stage, self._timer, self._costs_s = stage, timer, costs_s

    def __enter__(self) -> None:
        self._start_s = self._timer()

    def __exit__(self, *_: object) -> None:
        self._costs_s[self._stage] = self._costs_s.get(self._stage, 0.0) + self._timer() - self._start_s
