"""Pair the sides of a transmission that arrive in separate messages."""

from __future__ import annotations

from collections import Counter

from msgspec import structs

from drivers.sonar.sonar_decoder import SonarFrame


class SidePairer:
    """Join one-sided frames of the same transmission.

    Two heads with a common count of pings are paired by number, two with separate counts by time: within half the
    two-way travel time to the far end of the trace there is no other transmission. A side that stays alone goes out
    with the next message that is not its other half; `counters`: pairing.lone_port, pairing.lone_starboard and
    pairing.repeated_side.
    """

    def __init__(self, counters: Counter[str]) -> None:
        self._counters = counters
        self._waiting: SonarFrame | None = None
        self._last: SonarFrame | None = None  # sent last, to recognise repetitions

    def add(self, frame: SonarFrame) -> list[SonarFrame]:
        """Take a one-sided frame; return the frames that became ready."""
        waiting = self._waiting
        if _repeats(waiting, frame) or _repeats(self._last, frame):
            self._counters["pairing.repeated_side"] += 1
            return []
        if waiting is not None and _together(waiting, frame):
            self._waiting = None
            # The message that came first gives the best time of the transmission.
            if waiting.port is None:
                self._last = structs.replace(waiting, port=frame.port)
            else:
                self._last = structs.replace(waiting, starboard=frame.starboard)
            return [self._last]
        ready = self.finish()
        self._waiting = frame
        return ready

    def finish(self) -> list[SonarFrame]:
        """Return the side that still waits for its other half."""
        if self._waiting is None:
            return []
        self._last, self._waiting = self._waiting, None
        self._counters["pairing.lone_port" if self._last.starboard is None else "pairing.lone_starboard"] += 1
        return [self._last]


def _repeats(known: SonarFrame | None, frame: SonarFrame) -> bool:
    if known is None or frame.number != known.number or frame.device_time_s != known.device_time_s:
        return False
    return (frame.port is not None and known.port is not None) or (
        frame.starboard is not None and known.starboard is not None
    )


def _together(one: SonarFrame, other: SonarFrame) -> bool:
    if (one.port is None) == (other.port is None):
        return False
    if one.number == other.number:
        return True
    if one.device_time_s is None or other.device_time_s is None:
        return False
    trace = one.port if one.port is not None else one.starboard
    assert trace is not None, "a frame has a side"
    far_m: float = trace.first_range_m + trace.spacing_m * trace.samples.shape[0]
    one_way_s = far_m / one.sound_speed_mps
    return abs(other.device_time_s - one.device_time_s) < one_way_s
