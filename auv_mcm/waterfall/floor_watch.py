"""Know where a side hears no sea floor: a transducer or cable that died leaves noise, which looks like flat sand."""

from __future__ import annotations

from collections import Counter, deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.order import median
from auv_mcm.records import Notice, Side, Tile

NEAR_M: Final = 0.25  # m behind the first return, where the floor stands out in full
REACH_M: Final = 2.0
"""Slant range from there, m, within which the floor is loudest, minimum."""
REACH_SHARE: Final = 0.5
"""Of the first return, within which it begins on the lower side of a steep slope, too."""
_MIN_RISE: Final = 0.2
"""Nats that the floor there stands above the water. Of noise the median over 32 pings deviates by 0.06 from 0; of 96
blocks of a river and 94 of a reef, recorded, the lowest has 0.36."""
_MIN_REPORTED: Final = 256  # pings in a row, from which a person is asked to look: half a minute at 10 Hz; chosen
_MAX_TIMES: Final = 256  # stretches remembered: a tile has one ping a row at the most, and holes are rare


class FloorWatch:
    """Follow one side, block by block of pings."""

    def __init__(self, side: Side, counters: Counter[str]) -> None:
        """counters: of pings that show no sea floor."""
        self._side = side
        self._counters = counters
        self._unheard_s: deque[tuple[float, float]] = deque(maxlen=_MAX_TIMES)
        self._n_in_a_row = 0
        self._is_reported = False

    def add(self, rise: NDArray[np.float64], times_s: NDArray[np.float64]) -> list[Notice]:
        """Take the rise from water to floor of a block's pings, nats, NaN where unknown; return what it raises."""
        known = rise[np.isfinite(rise)]
        limit = 2.0 * _MIN_RISE if self._n_in_a_row else _MIN_RISE  # a few pings at the end scatter more
        if not known.size or not median(known) < limit:
            self._n_in_a_row = 0
            return []
        goes_on = self._n_in_a_row > 0 and self._unheard_s[-1][1] < times_s[0]  # unless a clock was set back
        start_s = self._unheard_s.pop()[0] if goes_on else float(times_s[0])
        self._unheard_s.append((start_s, float(times_s[-1])))
        self._counters[f"quality.{self._side}_floor_not_heard"] += len(times_s)
        self._n_in_a_row += len(times_s)
        if self._n_in_a_row < _MIN_REPORTED or self._is_reported:
            return []
        self._is_reported = True
        text = (
            f"{self._side} hears no sea floor: its echoes are no stronger where the bottom begins than in the water "
            "before. Nothing there counts as covered. Check the transducer, its cable and the sonar's gain."
        )
        return [Notice(code="quality.floor_not_heard", text=text)]

    def unheard_rows(self, tile: Tile) -> NDArray[np.bool_]:
        """Select the rows of a tile of this side that show no sea floor, (n_rows,)."""
        times_s, unheard = tile.pose.time_s, np.zeros(len(tile.pose), dtype=np.bool_)
        for start_s, stop_s in self._unheard_s:
            unheard |= (times_s >= start_s) & (times_s <= stop_s)
        return unheard
