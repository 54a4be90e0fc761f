"""Thin a quantity of navigation that comes more often than anybody can use, before it takes room beside pings."""

from __future__ import annotations

import math
from typing import Final

from auv_mcm.settings.port_settings import QUANTITIES, Quantity

MAX_PER_S: Final = 200
"""Samples of one quantity that go on in a second. Chosen: inertial units here send up to 100, a ping needs one before
and one behind it, and a service beside 22 pings a second loses none at 2500 samples a second, twice of what six
quantities come to."""


class Thinning:
    """Choose which samples go on. Their times alone decide.

    One of the same instant as the one before says nothing new. Of those that come too often as many go on as a second
    may have, and then one each time that their share of a second is over, so that they stay evenly spread.
    """

    def __init__(self) -> None:
        self._newest_s = dict.fromkeys(QUANTITIES, -math.inf)
        self._room = dict.fromkeys(QUANTITIES, float(MAX_PER_S))  # samples that may go on at once, at the newest

    def takes(self, quantity: Quantity, time_s: float) -> bool:
        """Check whether a sample goes on, and note it. time_s: monotonic, of the measurement."""
        newest_s = self._newest_s[quantity]
        if time_s == newest_s:
            return False
        passed_s = max(time_s - newest_s, 0.0)
        room = min(self._room[quantity] + passed_s * MAX_PER_S, float(MAX_PER_S))
        self._newest_s[quantity] = max(newest_s, time_s)
        self._room[quantity] = room - (room >= 1.0)
        return room >= 1.0
