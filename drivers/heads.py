"""Join two one-sided sonar heads on separate wires into one sonar."""

from __future__ import annotations

from collections import Counter, deque
from typing import Final

from msgspec import structs

from auv_mcm.records import Ping

_MAX_WAITING: Final = 8  # pings of one head that wait for the other's; bounds memory and delay


class HeadPairer:
    """Join one-sided pings of two heads that were sent within the echo time of the far end of the trace.

    A ping stays alone if the other head's next is later, or after _MAX_WAITING more from its own head. counters:
    heads.joined, heads.lone_port, heads.lone_starboard.
    """

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self._waiting: deque[Ping] = deque()  # all of one side

    def add(self, ping: Ping) -> list[Ping]:
        """Return the pings that one more ping completes, in order of time for each head."""
        waiting = self._waiting
        if waiting and (waiting[0].port is None) == (ping.port is None):
            waiting.append(ping)
            return [self._alone(waiting.popleft())] if len(waiting) > _MAX_WAITING else []
        ready: list[Ping] = []
        while waiting:
            other = waiting[0]
            if abs(other.time_s - ping.time_s) < _echo_time_s(ping):
                waiting.popleft()
                self.counters["heads.joined"] += 1
                return [*ready, _joined(other, ping)]
            if other.time_s > ping.time_s:
                return [*ready, self._alone(ping)]
            ready.append(self._alone(waiting.popleft()))
        waiting.append(ping)
        return ready

    def finish(self) -> list[Ping]:
        """Return the pings that still wait for their other half."""
        ready = [self._alone(ping) for ping in self._waiting]
        self._waiting.clear()
        return ready

    def _alone(self, ping: Ping) -> Ping:
        self.counters["heads.lone_port" if ping.starboard is None else "heads.lone_starboard"] += 1
        return ping


def _joined(one: Ping, other: Ping) -> Ping:
    """Join two halves into one ping at the time of the first, with the number of port's."""
    port, starboard = (one, other) if one.starboard is None else (other, one)
    time_s = min(one.time_s, other.time_s)
    return structs.replace(port, time_s=time_s, starboard=starboard.starboard)


def _echo_time_s(ping: Ping) -> float:
    trace = ping.port if ping.port is not None else ping.starboard
    assert trace is not None, "a ping has a side"
    far_m: float = trace.first_range_m + trace.spacing_m * (trace.samples.shape[0] - 0.5)
    return 2.0 * far_m / ping.sound_speed_mps
