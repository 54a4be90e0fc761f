"""Measure mission time, which stands still while the computer is too slow for the mission."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate


class MissionTime:
    """Measure times of a run, s after its start.

    The clock stands still while the computer is too slow for the mission.
    """

    def __init__(self, start_s: float, holds: Sequence[tuple[float, float]]) -> None:
        """start_s: of the monotonic clock. holds: when each ended, by the same clock, and how long it was, s."""
        self._start_s = start_s
        self._holds = holds
        self._ended_s = [ended_s for ended_s, _ in holds]
        self._held_s = list(accumulate((for_s for _, for_s in holds), initial=0.0))

    def at(self, mono_s: float) -> float:
        """Convert an instant of the monotonic clock to mission time."""
        n_over = bisect_right(self._ended_s, mono_s)
        held_s = self._held_s[n_over]
        if n_over < len(self._holds):
            ended_s, for_s = self._holds[n_over]
            held_s += max(mono_s - ended_s + for_s, 0.0)
        return mono_s - self._start_s - held_s
