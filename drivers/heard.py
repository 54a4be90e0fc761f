"""Count what a port delivers: pings with their range, samples and rate, and the quantities of navigation."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

from auv_mcm.records import Notice, Ping
from auv_mcm.settings.port_settings import QUANTITIES, Quantity
from drivers.navigation.nav_decoder import NavFix
from drivers.port_stream import Decoded


class Heard:
    """Gather what was decoded. quantities: fixes that give each; notices: of the decoder, in order."""

    def __init__(self, delivers: Sequence[Quantity]) -> None:
        """delivers: quantities that are taken from the port."""
        self.quantities: Counter[Quantity] = Counter()
        self.notices: list[Notice] = []
        self.n_pings = 0
        self._delivers = delivers
        self._sides: Counter[str] = Counter()
        self._first_s = self._last_s = math.nan
        self._range_m, self._n_samples = 0.0, 0

    def add(self, decoded: Iterable[Decoded]) -> None:
        """Take the next items, in order."""
        for item in decoded:
            if isinstance(item, Ping):
                self._add_ping(item)
            elif isinstance(item, NavFix):
                self.quantities.update(set(given_quantities(item)) & set(self._delivers))
            else:
                self.notices.append(item)

    def words(self) -> str:
        """Describe it in a line; empty where nothing was delivered."""
        parts = [self._ping_words()] if self.n_pings else []
        if self.quantities:
            parts.append(", ".join(f"{name} {self.quantities[name]}" for name in QUANTITIES if self.quantities[name]))
        return "; ".join(parts)

    def _add_ping(self, ping: Ping) -> None:
        if not self.n_pings:
            self._first_s = ping.time_s
        self.n_pings += 1
        self._last_s = ping.time_s
        for side, trace in (("port", ping.port), ("starboard", ping.starboard)):
            if trace is not None:
                self._sides[side] += 1
                self._n_samples = trace.samples.shape[0]
                self._range_m = trace.first_range_m + trace.spacing_m * (self._n_samples - 0.5)

    def _ping_words(self) -> str:
        sides = " and ".join(side for side in ("port", "starboard") if self._sides[side])
        words = f"{self.n_pings} pings of {sides}, {self._n_samples} samples a side to {self._range_m:.1f} m"
        span_s = self._last_s - self._first_s
        return f"{words}, {(self.n_pings - 1) / span_s:.1f} a second" if span_s > 0.0 else words


def given_quantities(fix: NavFix) -> list[Quantity]:
    """List the quantities that a fix gives."""
    numbers: dict[Quantity, float] = {
        "position": fix.latitude_deg + fix.longitude_deg,
        "heading": fix.heading_rad,
        "attitude": fix.pitch_rad + fix.roll_rad,
        "depth": fix.depth_m,
        "altitude": fix.altitude_m,
        "speed": fix.speed_mps,
    }
    return [name for name, number in numbers.items() if math.isfinite(number)]
