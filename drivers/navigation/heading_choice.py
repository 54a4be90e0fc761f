"""Choose the heading of a unit that sends several, and say which are not true or not read."""

from __future__ import annotations

import math
from typing import Any, Final

from auv_mcm.records import NAN, Notice
from drivers.navigation.sentences import Hdg, Hdm, Ohpr

_BEST_FOR: Final = 64  # sentences after its last heading for which a better kind of heading is still waited for
_N_REPORTED: Final = 20  # sentences in a row before a notice: 2 s of 10 Hz, in which a compass may start
_UNREAD: Final = frozenset(("VHW", "OSD", "HSC", "RSA", "PSXN", "PHTRO", "PTVG", "PNORS", "PRDIE", "PGRMH"))
"""Sentences that carry a heading, or may, and are not read."""


class HeadingChoice:
    """Prefer true headings to magnetic ones with a variation, and these to those without.

    Raises `nav_heading_magnetic`, `nav_heading_not_read` and `nav_heading_not_valid`, once each.
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._variation_rad = NAN  # as RMC has it
        self._since = [_BEST_FOR] * 3  # sentences since the last heading, by rank
        self._n_empty = 0  # sentences of headings without one, in a row
        self._n_unread = 0
        self._raised: set[str] = set()
        self._notices: list[Notice] = []

    def take_notices(self) -> list[Notice]:
        """Take the notices raised since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def vary(self, variation_rad: float) -> None:
        """Take the magnetic variation of another sentence of the unit, positive to the east; NaN: unknown."""
        if not math.isnan(variation_rad):
            self._variation_rad = variation_rad

    def true_rad(self, record: Hdg | Hdm) -> float:
        """Correct a magnetic heading by its own deviation and variation, else by the variation heard before."""
        own = record if isinstance(record, Hdg) else Hdg(record.heading_rad)
        variation_rad = self._variation_rad if math.isnan(own.variation_rad) else own.variation_rad
        corrections = (angle for angle in (own.deviation_rad, variation_rad) if not math.isnan(angle))
        return (own.heading_rad + sum(corrections)) % math.tau

    def serves(self, record: Any, heading_rad: float) -> bool:
        """Take a sentence and the heading in it (NaN: none); find whether it is used."""
        self._since = [since + 1 for since in self._since]
        if math.isnan(heading_rad):
            if type(record).__name__ in _HEADINGS:
                self._count_empty(type(record).__name__)
            return True
        self._n_empty = 0
        rank = self._rank(record)
        self._since[rank] = 0
        if any(since < _BEST_FOR for since in self._since[:rank]):
            return False
        if rank == _MAGNETIC:
            text = (
                f"'{self._source}' sends magnetic headings without the variation: they are used as they are. Have it "
                "send the variation (HDG or RMC) or true headings (HDT or THS), or set the unit's heading_offset_deg "
                "to the local variation, positive to the east."
            )
            self._raise_once("nav_heading_magnetic", text)
        return True

    def ignored(self, key: str) -> None:
        """Take a sentence that is not read, by its key."""
        if key.partition(",")[0] not in _UNREAD or min(self._since) < _BEST_FOR:
            return
        self._n_unread += 1
        if self._n_unread >= _N_REPORTED:
            text = (
                f"'{self._source}' sends {key}, which may carry a heading and is not read, and no heading that is: the "
                "course is used. Have it send HDT, THS or HDG."
            )
            self._raise_once("nav_heading_not_read", text)

    def _rank(self, record: Any) -> int:
        if isinstance(record, Ohpr):
            return _MAGNETIC
        if isinstance(record, Hdg) and not math.isnan(record.variation_rad):
            return _VARIED
        if isinstance(record, Hdg | Hdm):
            return _MAGNETIC if math.isnan(self._variation_rad) else _VARIED
        return _TRUE

    def _count_empty(self, name: str) -> None:
        self._n_empty += 1
        if self._n_empty >= _N_REPORTED and min(self._since) >= _BEST_FOR:
            text = (
                f"'{self._source}' sends {name.upper()} without a valid heading: the course is used. Check that it has "
                "a fix or is aligned, and its antennas."
            )
            self._raise_once("nav_heading_not_valid", text)

    def _raise_once(self, code: str, text: str) -> None:
        if code not in self._raised:
            self._raised.add(code)
            self._notices.append(Notice(code=code, text=text, place=self._source))


_TRUE, _VARIED, _MAGNETIC = range(3)  # ranks, the best first
_HEADINGS: Final = frozenset(("Hdt", "Ths", "Hdg", "Hdm", "Hpr", "Avr", "Gpatt", "Ohpr"))
