"""Convert device times to the clocks of this computer.

A message is never received before it was sent, so its delay is one-sided: the minimum difference between arrival and
device time is the offset of the two clocks, plus the minimum delay. Times are kept on the monotonic clock, which nobody
sets; UTC is put on last, by an anchor that follows, in the order of trust: a pulse each second named by a sentence
(`PulseLabels`), the times in the sentences alone (`sentence_offset_ns`), or this computer's own UTC (`host_offset_ns`).
Nothing here reads a clock.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from typing import Final, NamedTuple

from auv_mcm.clock import Stamp
from auv_mcm.records import Notice

MILLISECOND_COUNTER_S: Final = 2**32 / 1000.0  # after which a 32-bit counter of milliseconds starts over

_NS: Final = 1_000_000_000  # nanoseconds per second
_MILLION: Final = 1_000_000  # parts per million
_BITS_PER_BYTE: Final = 10  # 8N1
_DRIFT_PPM: Final = 100  # of a device's crystal against this computer's, maximum
_RESOLUTION_NS: Final = 10_000_000  # of the window's end, which bounds how many messages it holds
_LATEST_S: Final = 1e12  # no clock reports more
_STEP_NS: Final = 500_000_000  # a device whose time is off by more was set or started anew
_MAX_NOTICES: Final = 20  # per clock: one whose messages have two times would raise one with each
_LATE_FOR_NS: Final = 3_000_000_000  # unless the link stalled, which does not last as long
_UTC_STEP_NS: Final = 100_000_000  # ns: an offset of UTC that differs by more is a step, by less it is followed slowly
_UTC_SLEW_PPM: Final = 500  # as fast as NTP slews
# ns of a step back: the chain takes pings and navigation that go back by less than 1 s for late. Chosen, as pings are
# up to 0.5 s apart.
_UTC_SHORT_BACK_NS: Final = 1_500_000_000
# until the clock has caught up after it, 200 s for each second: a unit's UTC comes each second, and 5 ms at once are
# less than the time between two pings
_UTC_WAIT_PPM: Final = 5_000
_PULSE_PPM: Final = 200  # ppm between pulses and this computer's clock, maximum: crystals are within 100


class HostTime(NamedTuple):
    """Hold an instant that a device reported, on this computer's monotonic clock.

    residual_ns: by how much longer this message was on its way than the quickest one of the window, 0 or more. segment:
    counts how often the device's time was anchored anew; mono_ns never goes back inside a segment. settled_ns: since
    the segment began; an offset from few messages may be late by as much as all of them were. notice: what a person
    should know.
    """

    mono_ns: int
    residual_ns: int
    segment: int
    settled_ns: int
    notice: Notice | None = None


def wire_delay_s(n_bytes: int, baud: float | None) -> float:
    """Return the seconds that bytes take on a serial line, ten bits each; 0 without one (baud None)."""
    return 0.0 if baud is None else n_bytes * _BITS_PER_BYTE / baud


class DeviceClock:
    """Map one device's counter or clock to the monotonic clock, by the lower envelope of arrival minus device time.

    A message that arrived at t bounds the offset by (arrival - device time) + drift * (now - t): the minimum of
    these over the window is the tightest bound, never below the true offset plus the minimum delay while the drift
    keeps within its bound. Counts clock.anchored_anew, .out_of_order and .without_device_time.
    """

    def __init__(self, source: str, *, wrap_s: float | None = None, window_s: float = 60.0) -> None:
        """source: the device, for messages.

        wrap_s: after which the counter starts over (`MILLISECOND_COUNTER_S`; 86400 for a time of day), None: never.
        """
        self.counters: Counter[str] = Counter()
        self._source = source
        self._wrap_ns = None if wrap_s is None else round(wrap_s * _NS)
        self._window = _Envelope(round(window_s * _NS))
        self._segment = 0
        self._began_ns: int | None = None
        self._last_device_ns = 0
        self._last_number: int | None = None
        self._last_mono_ns = 0
        self._late_since_ns: int | None = None

    def host_time(
        self, device_time_s: float | None, received: Stamp, *, delay_s: float = 0.0, number: int | None = None
    ) -> HostTime:
        """Return the monotonic time at which the device's time was device_time_s.

        Parameters
        ----------
        device_time_s
            Seconds; where it is None, not finite or absurd, the arrival stands for it.
        received
            Of the chunk that brought it, in order.
        delay_s
            What surely passed between device_time_s and `received`: `wire_delay_s`, and for a sonar the echo time 2 *
            range / sound speed.
        number
            The device's own count of messages; where both go back, the device started anew.
        """
        now_ns = received.mono_ns
        arrival_ns = now_ns - round(delay_s * _NS)
        if device_time_s is None or not abs(device_time_s) <= _LATEST_S:
            self.counters["clock.without_device_time"] += 1
            self._last_mono_ns = max(arrival_ns, self._last_mono_ns)
            return HostTime(self._last_mono_ns, 0, self._segment, 0)
        device_ns = round(device_time_s * _NS)
        if self._began_ns is None:
            return self._anchor(device_ns, arrival_ns, now_ns, number, None)
        envelope_ns = self._window.min_ns(now_ns)
        if self._wrap_ns is not None:
            # Of all the times that the counter may mean, the nearest to what it should be.
            device_ns += (arrival_ns - envelope_ns - device_ns + self._wrap_ns // 2) // self._wrap_ns * self._wrap_ns
        offset_ns = arrival_ns - device_ns
        if (why := self._distrust(device_ns, offset_ns - envelope_ns, now_ns, number)) is not None:
            return self._anchor(device_ns, arrival_ns, now_ns, number, self._jump_notice(why, offset_ns - envelope_ns))
        self._window.add(offset_ns, now_ns)
        mono_ns = device_ns + self._window.min_ns(now_ns)
        residual_ns = arrival_ns - mono_ns
        if device_ns < self._last_device_ns:
            self.counters["clock.out_of_order"] += 1
        return self._keep(device_ns, max(mono_ns, self._last_mono_ns), residual_ns, now_ns, number, None)

    def _distrust(self, device_ns: int, late_ns: int, now_ns: int, number: int | None) -> str | None:
        """Return why the offset so far no longer holds, None if it does."""
        if -_STEP_NS <= late_ns <= _STEP_NS:
            self._late_since_ns = None
            return None
        if late_ns < 0:
            return "jumped ahead"
        went_back = number is not None and self._last_number is not None and number < self._last_number
        if went_back or device_ns < self._last_device_ns - _STEP_NS:
            return "started anew"
        if self._late_since_ns is None:
            self._late_since_ns = now_ns
        return "fell back" if now_ns - self._late_since_ns >= _LATE_FOR_NS else None

    def _jump_notice(self, why: str, late_ns: int) -> Notice | None:
        self.counters["clock.anchored_anew"] += 1
        if self.counters["clock.anchored_anew"] > _MAX_NOTICES:
            return None
        last = " Further ones are only counted." if self.counters["clock.anchored_anew"] == _MAX_NOTICES else ""
        text = (
            f"the clock of {self._source} {why}: it is {abs(late_ns) / _NS:.3f} s from where it should be. Its times "
            "are taken from the arrival of its messages until they settle. If this repeats, check the device's supply "
            f"and its time synchronisation.{last}"
        )
        return Notice(code="device_clock_anchored_anew", text=text, place=self._source)

    def _anchor(
        self, device_ns: int, arrival_ns: int, now_ns: int, number: int | None, notice: Notice | None
    ) -> HostTime:
        self._segment += self._began_ns is not None
        self._began_ns = now_ns
        self._late_since_ns = None
        self._window.clear()
        self._window.add(arrival_ns - device_ns, now_ns)
        return self._keep(device_ns, arrival_ns, 0, now_ns, number, notice)

    def _keep(
        self, device_ns: int, mono_ns: int, residual_ns: int, now_ns: int, number: int | None, notice: Notice | None
    ) -> HostTime:
        assert self._began_ns is not None
        self._last_device_ns, self._last_number, self._last_mono_ns = device_ns, number, mono_ns
        return HostTime(mono_ns, residual_ns, self._segment, now_ns - self._began_ns, notice)


class _Envelope:
    """Track the minimum of offset + drift * age over a window in constant time.

    A bound above a later one can never be the minimum again.
    """

    def __init__(self, window_ns: int) -> None:
        self._window_ns = window_ns
        self._bounds: deque[tuple[int, int]] = (
            deque()
        )  # when, and the offset with the drift since the clock's zero taken off; rising

    def clear(self) -> None:
        self._bounds.clear()

    def add(self, offset_ns: int, now_ns: int) -> None:
        bound_ns = offset_ns - self._drift_ns(now_ns)
        bounds = self._bounds
        while bounds and bounds[-1][1] >= bound_ns:
            bounds.pop()
        if not bounds or now_ns - bounds[-1][0] >= _RESOLUTION_NS:
            bounds.append((now_ns, bound_ns))

    def min_ns(self, now_ns: int) -> int:
        """Return the minimum bound of the offset.

        After a pause longer than the window the last one counts: looser, not wrong.
        """
        bounds = self._bounds
        while len(bounds) > 1 and now_ns - bounds[0][0] > self._window_ns:
            bounds.popleft()
        return bounds[0][1] + self._drift_ns(now_ns)

    def _drift_ns(self, mono_ns: int) -> int:
        return mono_ns * _DRIFT_PPM // _MILLION


class UtcAnchor:
    """Hold UTC minus monotonic time.

    Follow small differences slowly; a step anchors UTC anew, which `segment` counts. After a short one back UTC goes
    slower until the clock has caught up: nothing that is timed by it goes back.
    """

    def __init__(self, source: str) -> None:
        """source: whose UTC is followed, for messages."""
        self.segment = 0
        self._source = source
        self._offset_ns: int | None = None
        self._last_mono_ns = 0
        self._stepped_offset_ns: int | None = None
        self._waits = False  # for the clock followed, which stepped back

    def follow(self, offset_ns: int, mono_ns: int) -> Notice | None:
        """Take a new reading of UTC minus monotonic time, in order of time. Return a notice when that stepped.

        One reading far off is rejected: a process may be held up between reading two clocks. Two that agree are a step.
        """
        if self._offset_ns is None:
            self._offset_ns, self._last_mono_ns = offset_ns, mono_ns
            return None
        elapsed_ns, self._last_mono_ns = max(mono_ns - self._last_mono_ns, 0), mono_ns
        difference_ns = offset_ns - self._offset_ns
        is_small = abs(difference_ns) <= _UTC_STEP_NS
        self._waits = self._waits and not is_small
        if is_small or (self._waits and -_UTC_SHORT_BACK_NS <= difference_ns < 0):
            max_step_ns = elapsed_ns * (_UTC_SLEW_PPM if is_small else _UTC_WAIT_PPM) // _MILLION
            self._offset_ns += max(-max_step_ns, min(difference_ns, max_step_ns))
            self._stepped_offset_ns = None
            return None
        if self._stepped_offset_ns is None or abs(offset_ns - self._stepped_offset_ns) > _UTC_STEP_NS:
            self._stepped_offset_ns = offset_ns
            return None
        self._stepped_offset_ns = None
        self._waits = -_UTC_SHORT_BACK_NS <= difference_ns < 0
        if self._waits:
            how = f"come to the new UTC within {-difference_ns / _NS / _UTC_WAIT_PPM * _MILLION:.0f} s"
        else:
            self._offset_ns, how = offset_ns, "are by the new UTC"
            self.segment += 1
        text = (
            f"UTC of {self._source} stepped by {difference_ns / _NS:+.3f} s. Times from here on {how}, those before "
            "are not corrected. Set clocks before the mission, or let them slew."
        )
        return Notice(code="utc_stepped", text=text, place=self._source)

    def take_over(self, source: str, offset_ns: int, mono_ns: int) -> None:
        """Follow another source's UTC from here on; offset_ns is its UTC minus monotonic time."""
        self._source, self._last_mono_ns, self._stepped_offset_ns = source, mono_ns, None
        self._waits = self._offset_ns is not None and -_UTC_SHORT_BACK_NS <= offset_ns - self._offset_ns < 0
        if not self._waits:
            self._offset_ns = offset_ns
            self.segment += 1

    def utc_ns(self, mono_ns: int) -> int:
        """Return UTC, ns since 1970, at a monotonic time, by the clock followed. Call `follow` first."""
        assert self._offset_ns is not None
        return mono_ns + self._offset_ns


def host_offset_ns(stamp: Stamp) -> int:
    """Return UTC minus monotonic time by this computer's own clocks."""
    return stamp.utc_ns - stamp.mono_ns


def sentence_offset_ns(unit: DeviceClock, utc_s: float, received: Stamp, *, delay_s: float = 0.0) -> int:
    """Return UTC minus monotonic time by the UTC in a unit's sentences (ZDA), which it must send at that time.

    Parameters
    ----------
    unit
        The clock of that unit alone.
    utc_s
        Finite.
    delay_s
        As of `DeviceClock.host_time`.
    """
    return round(utc_s * _NS) - unit.host_time(utc_s, received, delay_s=delay_s).mono_ns


class PulseLabels:
    """Derive UTC from a pulse at each full second (PPS) and the sentence that names it (ZDA) before the next one.

    A pulse counts when it is full seconds after the one before, within 200 ppm. Counts pulse.off_beat,
    .label_without_pulse and .label_not_full_second.
    """

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self._last_ns: int | None = None
        self._steady = False

    def pulse(self, mono_ns: int) -> None:
        """Take a pulse's edge, by the monotonic clock."""
        if self._last_ns is not None:
            interval_ns = mono_ns - self._last_ns
            n_seconds = round(interval_ns / _NS)
            self._steady = n_seconds >= 1 and abs(interval_ns - n_seconds * _NS) * _MILLION <= _PULSE_PPM * interval_ns
            if not self._steady:
                self.counters["pulse.off_beat"] += 1
        self._last_ns = mono_ns

    def offset_ns(self, utc_s: float, received: Stamp) -> int | None:
        """Return UTC minus monotonic time; None if the sentence names no pulse.

        utc_s: the full second that it names.
        """
        if not math.isfinite(utc_s) or utc_s != round(utc_s):
            self.counters["pulse.label_not_full_second"] += 1
            return None
        if self._last_ns is None or not self._steady or not 0 <= received.mono_ns - self._last_ns < _NS:
            self.counters["pulse.label_without_pulse"] += 1
            return None
        return round(utc_s) * _NS - self._last_ns


class SourceTime(NamedTuple):
    """Hold the time of an event.

    utc_ns never goes back inside a segment; residual_ns, settled_ns, notice: see `HostTime`.
    """

    utc_ns: int
    residual_ns: int
    segment: int
    settled_ns: int
    notice: Notice | None


class SourceClock:
    """Convert one device's times to UTC.

    All devices share the anchor: it is followed once per chunk, before decoding.
    """

    def __init__(self, device: DeviceClock, utc: UtcAnchor) -> None:
        self._device = device
        self._utc = utc
        self._segment = -1
        self._last_utc_ns = 0

    def time(
        self, device_time_s: float | None, received: Stamp, *, delay_s: float = 0.0, number: int | None = None
    ) -> SourceTime:
        """Return the time in UTC, as `DeviceClock.host_time`."""
        host = self._device.host_time(device_time_s, received, delay_s=delay_s, number=number)
        segment = host.segment + self._utc.segment
        utc_ns = self._utc.utc_ns(host.mono_ns)
        if segment == self._segment:
            utc_ns = max(utc_ns, self._last_utc_ns)
        self._segment, self._last_utc_ns = segment, utc_ns
        return SourceTime(utc_ns, host.residual_ns, segment, host.settled_ns, host.notice)
