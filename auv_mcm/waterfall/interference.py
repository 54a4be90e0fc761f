"""Take pulses of other sonars out of the picture: they strike single pings, which the sea floor does not.

Whatever lies on the sea floor mostly shows in several pings. Where many pings show what those around do not, it is
interference, and their blocks are cleaned; others stay as they are.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.interference import PINGS, here, lone_echoes, middle_two
from auv_mcm.kernels.order import median
from auv_mcm.records import Notice, Side

_STRONG: Final = 50.0  # intensity over that of the pings around, which shows interference; speckle and glints reach 30
_WEAK: Final = 10.0  # the same, from which it is taken out; and over that of the block, which shows it
_BLOCKS: Final = 3  # the newest blocks of pings, which are judged together. Chosen
_MIN_PINGS: Final = 12
"""Pings of those with strong ones, from which they are struck. Of 2,800 blocks of drawn missions and recorded lines
none has more than 7; pulses 20 dB above the sea floor in every third ping make 14."""
_FEWER_PINGS: Final = 4  # of them, with which it goes on. Chosen
_MAX_SPACING_M: Final = 0.25  # m between pings: half of the smallest mine, which shows in two of them at least
_MIN_REPORTED: Final = 256  # pings of struck blocks, from which a person is asked to act. Chosen


class InterferenceFilter:
    """Follow one side, block by block of pings."""

    def __init__(self, side: Side, counters: Counter[str]) -> None:
        """counters: of pings that other sonars strike."""
        self._side = side
        self._counters = counters
        self._newest: deque[int] = deque(maxlen=_BLOCKS)
        self._is_struck = False
        self._n_pings = self._n_struck = 0
        self._is_reported = False

    def cleaned(
        self, intensity: NDArray[np.float64], valid: NDArray[np.bool_], along_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], list[Notice]]:
        """Replace what strikes single pings by what the pings around show there; return also what that raises.

        Parameters
        ----------
        intensity, valid
            (n_pings, n_columns), 0 where not valid.
        along_m
            (n_pings,) distance along the track.
        """
        if len(intensity) < PINGS or median(np.diff(along_m)) > _MAX_SPACING_M:
            return intensity, []
        found, around = lone_echoes(intensity, _WEAK, _STRONG)
        n_struck = _count_struck(intensity, found, around)
        self._newest.append(n_struck)
        self._is_struck = sum(self._newest) >= (_FEWER_PINGS if self._is_struck else _MIN_PINGS)
        if not self._is_struck:
            return intensity, []
        lone = found > 0
        self._counters[f"quality.{self._side}_interference"] += int(np.count_nonzero(lone.any(axis=1)))
        lone[:, 1:] |= found[:, :-1] > 0  # and what is left of a pulse at its ends
        lone[:, :-1] |= found[:, 1:] > 0
        return np.where(lone & valid, middle_two(intensity), intensity), self._notices(len(found), n_struck)

    def _notices(self, n_pings: int, n_struck: int) -> list[Notice]:
        self._n_pings += n_pings
        self._n_struck += n_struck
        if self._n_pings < _MIN_REPORTED or self._is_reported:
            return []
        self._is_reported = True
        text = (
            f"{self._side} hears another sonar or echo sounder: {self._n_struck} of {self._n_pings} pings show pulses "
            "that the pings around do not. They are taken out, but hide what lies under them. Switch the other one "
            "off over the area, or trigger both together."
        )
        return [Notice(code="quality.interference", text=text)]


def _count_struck(intensity: NDArray[np.float64], found: NDArray[np.uint8], around: NDArray[np.float64]) -> int:
    """Count the pings with strong echoes. Single pings stand out of a large shadow, too, but not of the block."""
    pings = np.flatnonzero(found.max(axis=1, initial=0) > 1)
    if not pings.size:
        return 0
    strong = (found[pings] > 1) & (here(intensity[pings]) > _WEAK * around.mean(axis=0))
    return int(np.count_nonzero(strong.any(axis=1)))
