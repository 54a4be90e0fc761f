"""Collect the counters and notices of reading one XTF log."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Final

from auv_mcm.records import Notice
from sim_replay.logs.xtf_packets import DamagedBytes

_MAX_DAMAGE_NOTICES: Final = 10  # of a file; further damage is only counted
# What the reader mends, leaves out and counts, or was set to do: nobody has to act.
_MENDED: Final = frozenset(
    f"reader.{name}"
    for name in (
        *("ping_empty", "side_empty", "time_tied", "clock_stuck", "joined_log", "other_channel"),
        *("sound_speed_overridden", "range_from_duration", "sample_type_change", "sample_count_change"),
        *("weight_change", "sample_not_finite", "time_delay"),
    )
)


class LogReport:
    """Hold counters, and notices until they are taken."""

    def __init__(self, path: Path) -> None:
        self._name = path.name
        self.counters: Counter[str] = Counter()
        self._notices: list[Notice] = []
        self._raised: set[str] = set()

    def clear(self) -> None:
        """Start at the beginning of the log."""
        self.counters.clear()
        self._notices.clear()
        self._raised.clear()

    def take(self) -> list[Notice]:
        """Return the notices since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def place(self, offset: int) -> str:
        """Name a byte of the file."""
        return f"{self._name}, byte {offset}"

    def extend(self, notices: list[Notice]) -> None:
        """Take notices that others wrote."""
        self._notices += notices

    def notify(self, code: str, text: str, place: str, *, for_the_record: bool = False) -> None:
        """Raise a notice."""
        remark = for_the_record or code in _MENDED
        self._notices.append(Notice(code=code, text=text, place=place, for_the_record=remark))

    def notify_once(self, code: str, text: str, place: str) -> None:
        """Raise a notice whose code was not raised by this method yet."""
        if code not in self._raised:
            self._raised.add(code)
            self.notify(code, text, place)

    def damaged(self, damage: DamagedBytes) -> None:
        """Count damage; the first of a file raises notices."""
        self.counters["reader.damaged_packet"] += 1
        self.counters["reader.damaged_bytes"] += damage.n_bytes
        n_damaged = self.counters["reader.damaged_packet"]
        if n_damaged > _MAX_DAMAGE_NOTICES:
            return
        outcome = "everything before it is used" if damage.at_end else "reading goes on after it"
        more = "; further damage is only counted" if n_damaged == _MAX_DAMAGE_NOTICES else ""
        text = f"{damage.what}; {damage.n_bytes} bytes are left out, {outcome}{more}"
        self.notify("reader.damaged_packet", text, self.place(damage.offset))

    def finish(self) -> None:
        """Raise the notices that need the whole log."""
        tied, stuck, backwards = (
            self.counters[f"reader.{name}"] for name in ("time_tied", "clock_stuck", "time_backwards")
        )
        if tied:
            text = f"{tied} pings shared a time stamp with the one before; they are spread evenly"
            self.notify("reader.time_tied", text, self._name)
        if stuck:
            text = f"the clock stood still for {stuck} pings; they are timed by their interval"
            self.notify("reader.clock_stuck", text, self._name)
        if backwards:
            text = f"time went backwards {backwards} times; check the recorder's clock"
            self.notify("reader.time_backwards", text, self._name)
