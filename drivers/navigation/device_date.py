"""Find the date that belongs to a time of day."""

from __future__ import annotations

import math
from typing import Final

from auv_mcm.clock import Stamp

DAY_S: Final = 86_400.0  # seconds per day


class DeviceDate:
    """Make full times from times of day: the day nearest to the unit's clock, or to this computer's before a date.

    Nearest means within half a day, so midnight passes unnoticed, on both sides.
    """

    def __init__(self) -> None:
        self._anchor: tuple[float, int] | None = None  # UTC seconds of the unit, and the monotonic clock then

    def dated(self, date_days: float, time_of_day_s: float, stamp: Stamp) -> float | None:
        """Return UTC seconds since 1970 of a date and a time of day, days since 1970 and seconds; either may be NaN."""
        if math.isnan(date_days) or math.isnan(time_of_day_s):
            return self.nearest(time_of_day_s, stamp)
        utc_s = date_days * DAY_S + time_of_day_s
        self._anchor = utc_s, stamp.mono_ns
        return utc_s

    def nearest(self, time_of_day_s: float, stamp: Stamp) -> float | None:
        """Return UTC seconds since 1970 of a time of day; None if it is NaN."""
        if math.isnan(time_of_day_s):
            return None
        if self._anchor is None:
            now_s = stamp.utc_ns * 1e-9
        else:
            utc_s, mono_ns = self._anchor
            now_s = utc_s + (stamp.mono_ns - mono_ns) * 1e-9
        return round((now_s - time_of_day_s) / DAY_S) * DAY_S + time_of_day_s
