"""Choose which of several units serves a quantity."""

from __future__ import annotations

import math
from typing import Final

START_S: Final = 5.0
"""Time after the first unit is heard in which a better one serves at once: units do not all start at the same
moment."""


class UnitHealth:
    """Track when a unit last gave a quantity, and since when without a gap. Times are monotonic seconds."""

    def __init__(self, source: str, priority: int, valid_s: float) -> None:
        self.source = source
        self.priority = priority
        self.valid_s = valid_s
        self.last_s = -math.inf
        self.since_s = math.inf
        self.has_failed = False

    def gave(self, now_s: float) -> None:
        """Note that the unit gave a value."""
        if not self.is_healthy(now_s):
            self.has_failed = math.isfinite(self.last_s)
            self.since_s = now_s
        self.last_s = now_s

    def is_healthy(self, now_s: float) -> bool:
        """Find whether the last value is recent enough."""
        return now_s - self.last_s <= self.valid_s


class Fallback:
    """Choose the serving unit of one quantity: the best healthy one.

    A better one takes over from a healthy one only after being healthy for `recover_s`, so that a loose contact does
    not make two units alternate. At the start, one that has not failed yet takes over at once.
    """

    def __init__(self, recover_s: float) -> None:
        self.serving: UnitHealth | None = None
        self._recover_s = recover_s
        self._units: list[UnitHealth] = []  # the best first
        self._began_s = math.inf

    @property
    def units(self) -> tuple[UnitHealth, ...]:
        """Return every unit that has ever given the quantity, the best first."""
        return tuple(self._units)

    def add(self, unit: UnitHealth) -> None:
        self._units.append(unit)
        self._units.sort(key=lambda known: (known.priority, known.source))

    def choose(self, now_s: float) -> UnitHealth | None:
        """Return the unit that serves from here on; None while none is healthy."""
        serving = self.serving
        if serving is not None and not serving.is_healthy(now_s):
            serving = None
        for unit in self._units:
            if unit is serving:
                break
            waited = self.is_starting(unit) or now_s - unit.since_s >= self._recover_s
            if unit.is_healthy(now_s) and (serving is None or waited):
                serving = unit
                break
        if serving is not None:
            self._began_s = min(self._began_s, now_s)
        self.serving = serving
        return serving

    def is_starting(self, unit: UnitHealth) -> bool:
        """Return whether the unit was first heard with the others, or soon after them, and has not failed since."""
        return not unit.has_failed and unit.since_s - self._began_s <= START_S
