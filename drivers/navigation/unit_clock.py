"""How late a unit's messages come, from its own time stamps."""

from __future__ import annotations

from typing import Final

_HALF_WINDOW_NS: Final = 30_000_000_000
_MAX_DELAY_NS: Final = 1_000_000_000


class UnitClock:
    """The delay of each message beyond the least one of the last half to whole minute.

    Delays are one-sided, so the least difference between arrival and time stamp is the clocks' offset; half a minute is short
    enough for any crystal's drift. A difference a second above the least means that the unit's clock was set: `n_resets` counts, and the
    window begins anew.
    """

    def __init__(self) -> None:
        self.n_resets = 0
        self._least_ns: int | None = None
        self._least_before_ns: int | None = None
        self._window_start_ns = 0

    def delay_ns(self, unit_utc_s: float, arrival_mono_ns: int) -> int:
        """Nanoseconds, 0 or more. unit_utc_s: of the measurement, by the unit; arrival_mono_ns: by this computer's monotonic clock."""
        difference_ns = arrival_mono_ns - round(unit_utc_s * 1e9)
        least_ns = min((least for least in (self._least_ns, self._least_before_ns) if least is not None), default=difference_ns)
        if difference_ns - least_ns > _MAX_DELAY_NS:
            self.n_resets += 1
            self._least_ns = self._least_before_ns = None
            least_ns = difference_ns
        if self._least_ns is None or arrival_mono_ns - self._window_start_ns > _HALF_WINDOW_NS:
            self._least_before_ns, self._least_ns = self._least_ns, difference_ns
            self._window_start_ns = arrival_mono_ns
        self._least_ns = min(self._least_ns, difference_ns)
        return max(difference_ns - least_ns, 0)
