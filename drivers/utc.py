"""Choose the source of UTC: this computer, or one unit's ZDA, with or without a pulse per second. It reads no clock."""

from __future__ import annotations

from collections import Counter
from typing import Final

from auv_mcm.clock import Stamp
from auv_mcm.records import Notice
from drivers.clocks import DeviceClock, PulseLabels, UtcAnchor, host_offset_ns, sentence_offset_ns, wire_delay_s
from drivers.links.pulse import unpack_edge
from drivers.navigation.nav_decoder import NavFix
from drivers.ports import PortSettings

_LOST_NS: Final = 10_000_000_000  # ns without a pulse or a sentence, after which UTC counts as lost
_EPOCH_S: Final = 1024 * 7 * 86_400  # s: GPS counts weeks modulo 1024; a receiver that missed a turn dates this early
_MAX_EPOCHS: Final = 2  # GPS began in 1980: a third turn is in 2038
_RELEASED_S: Final = 1_767_225_600  # 2026-01-01: no sound clock shows less
_AGREE_NS: Final = 200_000_000  # units send a sentence as late as that


class UtcReference:
    """Keep the anchor of UTC that all ports share on the unit that gives UTC; on this computer's own until it reports.

    A reading counts if it agrees with the last one that did, or with the one just before. If the unit falls silent, UTC
    goes on from its last reading by the monotonic clock, which a crystal keeps within 0.1 ms per second: this
    computer's own may never have been set. Both raise a notice.

    counters: utc.readings, utc.refused (in disagreement), utc.epochs_added
    (times 1024 weeks), utc.pulse.* of `PulseLabels`, utc.clock.* of `DeviceClock`.
    """

    def __init__(self, unit: PortSettings | None) -> None:
        """unit: the port that gives UTC, None for this computer alone."""
        self.anchor = UtcAnchor("this computer")
        self._unit = unit
        self._has_pulse = False
        self._delay_s = 0.0
        if unit is not None and unit.unit is not None:
            self._has_pulse = unit.unit.pulse_link is not None
            self._delay_s = unit.unit.latency_s
        self._clock = DeviceClock("" if unit is None else f"port '{unit.name}'")
        self._labels = PulseLabels()
        self._own: Counter[str] = Counter()
        self._agreed_ns: int | None = None  # of UTC minus the time of arrival
        self._before_ns: int | None = None
        self._is_taken = False
        self._is_lost = False
        self._last_ns: int | None = None
        self._own_offset_ns = 0  # UTC of this computer minus monotonic time
        self._n_epochs: int | None = None  # that are added to the unit's time

    @property
    def counters(self) -> Counter[str]:
        return Counter(
            {f"utc.{name}": count for name, count in (self._own + self._labels.counters + self._clock.counters).items()}
        )

    def passed(self, stamp: Stamp) -> list[Notice]:
        """Take the passing of time; called for every chunk before it is decoded.

        stamp: by this computer's own clocks.
        """
        notices: list[Notice | None] = []
        self._own_offset_ns = host_offset_ns(stamp)
        if not self._is_taken:
            notices.append(self.anchor.follow(host_offset_ns(stamp), stamp.mono_ns))
        if self._unit is not None:
            if self._last_ns is None:
                self._last_ns = stamp.mono_ns
            if not self._is_lost and stamp.mono_ns - self._last_ns > _LOST_NS:
                self._is_lost = True
                notices.append(self._lost(self._unit))
        return [notice for notice in notices if notice is not None]

    def pulse(self, data: bytes) -> None:
        """Take an edge, as its port delivered it."""
        mono_ns = unpack_edge(data)
        if mono_ns is not None:
            self._labels.pulse(mono_ns)

    def take_fix(self, fix: NavFix) -> list[Notice]:
        """Take a unit's fix; use its time if the unit gives UTC."""
        if self._unit is None or fix.source != self._unit.name or not fix.is_time_message or fix.time_utc_s is None:
            return []
        if not self._agrees(round(fix.time_utc_s * 1e9) - fix.received.mono_ns):
            self._own["refused"] += 1
            return []
        notices: list[Notice | None] = [self._rolled_over(fix.time_utc_s, fix.received.mono_ns, self._unit)]
        time_utc_s = fix.time_utc_s + (self._n_epochs or 0) * _EPOCH_S
        if self._has_pulse:
            offset_ns = self._labels.offset_ns(time_utc_s, fix.received)
        else:
            delay_s = self._delay_s + wire_delay_s(fix.n_bytes, self._unit.baud)
            offset_ns = sentence_offset_ns(self._clock, time_utc_s, fix.received, delay_s=delay_s)
        if offset_ns is None:
            return [notice for notice in notices if notice is not None]
        self._own["readings"] += 1
        mono_ns = fix.received.mono_ns
        if self._is_taken:
            notices += [self.anchor.follow(offset_ns, mono_ns), self._back(self._unit)]
        else:
            notices.append(self._take(offset_ns, mono_ns, self._unit))
        self._last_ns = mono_ns
        return [notice for notice in notices if notice is not None]

    def _rolled_over(self, time_utc_s: float, mono_ns: int, unit: PortSettings) -> Notice | None:
        """Find, at the first reading and where the date leaps, how many times 1024 weeks the unit is back."""
        if self._n_epochs is not None:
            return None
        own_s = max((mono_ns + self._own_offset_ns) * 1e-9, _RELEASED_S)
        self._n_epochs = min(max(round((own_s - time_utc_s) / _EPOCH_S), 0), _MAX_EPOCHS)
        self._own["epochs_added"] = self._n_epochs
        if not self._n_epochs:
            return None
        text = (
            f"the date of '{unit.name}' is {self._n_epochs * 1024} weeks back, as of a receiver that missed a turn of "
            "the GPS week: they are added, to come nearest to this computer's clock. Check that clock, and the "
            "receiver's firmware."
        )
        return Notice(code="utc_rollover", text=text, place=unit.name)

    def _agrees(self, offset_ns: int) -> bool:
        """Check a reading before it goes into any clock, for one that is wrong would stay there."""
        known = [known_ns for known_ns in (self._agreed_ns, self._before_ns) if known_ns is not None]
        self._before_ns = offset_ns
        if not any(abs(offset_ns - known_ns) <= _AGREE_NS for known_ns in known):
            return False
        if self._agreed_ns is not None and abs(offset_ns - self._agreed_ns) > _EPOCH_S * 500_000_000:
            self._n_epochs = None  # a receiver that starts shows any date until it has found its own
        self._agreed_ns = offset_ns
        return True

    def _take(self, offset_ns: int, mono_ns: int, unit: PortSettings) -> Notice:
        ahead_s = (mono_ns + offset_ns - self.anchor.utc_ns(mono_ns)) * 1e-9
        self._is_taken, self._is_lost = True, False
        self.anchor.take_over(f"port '{unit.name}'", offset_ns, mono_ns)
        what = "ZDA and pulses" if self._has_pulse else "ZDA"
        text = f"UTC now comes from the {what} of '{unit.name}', {ahead_s:+.3f} s from this computer's clock"
        return Notice(code="utc_taken", text=text, place=unit.name, for_the_record=True)

    def _back(self, unit: PortSettings) -> Notice | None:
        if not self._is_lost:
            return None
        self._is_lost = False
        return Notice(code="utc_back", text=f"'{unit.name}' gives UTC again", place=unit.name)

    def _lost(self, unit: PortSettings) -> Notice:
        what = "ZDA that names a pulse" if self._has_pulse else "ZDA with its date"
        goes_on = "is kept by this computer's clock" if self._is_taken else "is this computer's own until it does"
        advice = "that it is set to send ZDA each second"
        advice += ", right after its pulse, and the pulse's wire" if self._has_pulse else ", and that it has a fix"
        text = f"'{unit.name}' gave no {what} for {_LOST_NS * 1e-9:g} s: UTC {goes_on}. Check {advice}."
        return Notice(code="utc_lost", text=text, place=unit.name)
