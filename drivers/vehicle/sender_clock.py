"""Follow a sender's clock, which may be off by any amount, to find messages that were sent earlier.

A message that somebody recorded earlier and sends once more bears an old time; the vehicle's own messages bear its time
of now.
"""

from __future__ import annotations

import math
from typing import Final

MAX_AGE_S: Final = 1.0
"""A message that is older than the newest by so much is refused. Networks reorder and delay by milliseconds."""
JITTER_S: Final = 0.5
"""By so much an answer may seem to come before its question, as minimum delays differ and clocks are slewed."""
ANOTHER_CLOCK_S: Final = 5.0
"""A clock that was set is believed when messages agree on it for so long and none came by the one before."""
_DRIFT: Final = 2e-4  # two crystals, 100 ppm each


class SenderClock:
    """Follow the clock of one sender by the times of its messages.

    The offset to this computer's monotonic clock is that of the minimum delay: a message is received after it was sent,
    never before.
    """

    def __init__(self) -> None:
        self._offset_s = math.nan  # of the sender's clock from ours, for a message without delay
        self._followed_s = 0.0
        self._other_offset_s = math.nan  # of a clock that may take its place
        self._other_since_s = 0.0

    def hear(self, time_s: float, now_s: float) -> bool:
        """Take a message's time; return whether it was sent lately. now_s: when it was received, monotonic."""
        offset_s = time_s - now_s
        if not math.isfinite(offset_s) or time_s <= 0.0:
            return False
        if math.isnan(self._offset_s):
            self._follow(offset_s, now_s)
        expected_s = self._offset_s - _DRIFT * max(now_s - self._followed_s, 0.0)
        if abs(offset_s - expected_s) <= MAX_AGE_S:
            self._follow(max(offset_s, expected_s), now_s)
            return True
        if not abs(offset_s - self._other_offset_s) <= MAX_AGE_S:
            self._other_offset_s, self._other_since_s = offset_s, now_s
        elif now_s - self._other_since_s >= ANOTHER_CLOCK_S:
            self._follow(offset_s, now_s)
            return True
        return False

    def is_after(self, time_s: float, moment_s: float) -> bool:
        """Check whether a recent message was sent after a moment of the monotonic clock."""
        return time_s - self._offset_s >= moment_s - JITTER_S

    def _follow(self, offset_s: float, now_s: float) -> None:
        self._offset_s, self._followed_s = offset_s, now_s
        self._other_offset_s = math.nan
