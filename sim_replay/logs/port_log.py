"""Decode the recorded bytes of ports as live, with their recorded stamps.

A session holds every port as it was read. A sonar's own log (JSF, svlog) is read as the ports that would have received
it: see `jsf_recording` and `svlog_recording`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

from auv_mcm.clock import Stamp
from auv_mcm.records import Notice, Ping, SourceEvent
from auv_mcm.source import QuantityState
from drivers.recording.session_layout import PartEnd, Recorded
from sim_replay.logs.log_reader import first_placed_s


class PortDecoding(Protocol):
    """Decode and merge all ports.

    Its events depend on the configuration and on what is fed alone: it reads no clock.
    """

    @property
    def counters(self) -> Counter[str]: ...

    def feed(self, port: str, data: bytes, stamp: Stamp) -> list[SourceEvent]:
        """Decode bytes of one port, in the order in which they were read. Empty ones only advance the time."""
        ...

    def finish(self) -> list[SourceEvent]:
        """Release what waits: no bytes follow."""
        ...


class PortRecording(Protocol):
    """Hold the bytes that ports received.

    Iterate for it in the order of recording; every iteration starts anew, with new counters and notices. A mark stands
    where the computer that recorded was started again.
    """

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        """Return the size of each file in use, in the order of recording."""
        ...

    @property
    def bytes_read(self) -> int:
        """Count the bytes read so far."""

    @property
    def counters(self) -> Counter[str]: ...

    @property
    def notices(self) -> list[Notice]:
        """List the notices in the order in which they arose."""
        ...

    def __iter__(self) -> Iterator[Recorded | PartEnd]: ...


class PortLog:
    """Replay a recording of ports as a log. Iterate for its events; every iteration starts anew."""

    def __init__(
        self, recording: PortRecording, make_intake: Callable[[], PortDecoding], *, pause_s: float = math.inf
    ) -> None:
        """Store the recording. make_intake: a new intake, from the same configuration as the recorded one; called where
        a part of the recording begins.

        pause_s: where the stamps leap ahead by more than this, or step back, the intake is finished and begun anew;
        infinite for stamps of one computer's monotonic clock. frequency_khz: of a sonar's own log, 0 if not stated.
        """
        self._recording = recording
        self.frequency_khz = float(getattr(recording, "frequency_khz", 0.0))
        self._make_intake = make_intake
        self._pause_ns = pause_s * 1e9
        self._intake = make_intake()
        self._finished: Counter[str] = Counter()  # of intakes before the one in use

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        """Return the size of each file in use, in the order of recording."""
        return self._recording.sizes_bytes

    @property
    def bytes_read(self) -> int:
        """Count the bytes read so far."""
        return self._recording.bytes_read

    @property
    def counters(self) -> Counter[str]:
        """Count what reading and decoding skipped or mended so far."""
        return self._recording.counters + self._finished + self._intake.counters

    def navigation_sources(self) -> dict[str, str]:
        """Name the port that served each quantity of navigation last; empty before anything was read."""
        states: tuple[QuantityState, ...] = getattr(self._intake, "quantities", tuple)()
        return {state.name: state.served_by for state in states if state.served_by}

    def first_time_s(self) -> float:
        """Find the time of the first ping, s since 1970; infinite without one."""
        return next(
            (event.time_s for event in self if isinstance(event, Ping) and math.isfinite(event.time_s)), math.inf
        )

    def __iter__(self) -> Iterator[SourceEvent]:
        chunks = iter(self._recording)
        self._intake, self._finished = self._make_intake(), Counter()
        n_notices, last_ns, has_ended = 0, None, False
        for recorded in chunks:
            yield from self._recording.notices[n_notices:]
            n_notices = len(self._recording.notices)
            if isinstance(recorded, PartEnd):
                if not recorded.is_cut_off and not has_ended:
                    yield from self._intake.finish()
                self._begin_intake()
                last_ns, has_ended = None, False
                continue
            if recorded.ends_events:
                has_ended = True
                yield from self._intake.finish()
            if recorded.direction != "in" or has_ended:
                continue
            if (
                last_ns is not None
                and math.isfinite(self._pause_ns)
                and not 0 <= recorded.stamp.mono_ns - last_ns <= self._pause_ns
            ):
                yield from self._intake.finish()
                self._begin_intake()
            last_ns = recorded.stamp.mono_ns
            yield from self._intake.feed(recorded.port, recorded.data, recorded.stamp)
        yield from self._recording.notices[n_notices:]
        yield from () if has_ended else self._intake.finish()

    def _begin_intake(self) -> None:
        self._finished += self._intake.counters
        self._intake = self._make_intake()


class SonarLog(PortLog):
    """Read a sonar's own log.

    Without pings, or without a position for any, it is refused before anything is done with it.
    """

    def __init__(
        self,
        recording: PortRecording,
        make_intake: Callable[[], PortDecoding],
        place: Path,
        no_navigation: str,
        pause_s: float,
    ) -> None:
        """no_navigation: for the message, where a log of this format would hold positions, and what to do."""
        super().__init__(recording, make_intake, pause_s=pause_s)
        self._place = place
        self._no_navigation = no_navigation

    def first_time_s(self) -> float:
        """Find the time of the first ping, s since 1970.

        Raises BadInputError for a log without usable pings or without positions.
        """
        return first_placed_s(self, self._place, self._no_navigation)
