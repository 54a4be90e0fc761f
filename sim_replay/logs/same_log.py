"""Leave out logs of a mission that hold what another one holds: copies, and the same pings at another frequency."""

from __future__ import annotations

import math
import zlib
from array import array
from collections.abc import Iterable, Iterator
from itertools import combinations
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from auv_mcm.records import EchoTrace, Notice, Ping, SourceEvent
from auv_mcm.safe_files import open_regular
from sim_replay.logs.log_reader import Log

_COMPARED_BYTES: Final = 1 << 20  # at once; bounds memory
_SAME_FREQUENCY: Final = 1.25  # ratio: frequencies of one sonar's sides differ by less (chosen)
_TOGETHER_S: Final = 30.0  # s between the first pings of files that a recorder writes side by side, maximum (chosen)


class OpenedLog(NamedTuple):
    """Hold a log, where it was named, and its first ping."""

    first_s: float
    place: int
    log: Log
    first: Ping | None

    @property
    def paths(self) -> str:
        """Name its files."""
        return ", ".join(map(str, self.log.sizes_bytes))

    @property
    def frequency_khz(self) -> float:
        """Return its frequency, 0 if the log states none."""
        return float(getattr(self.log, "frequency_khz", 0.0))


def without_repeats(opened: list[OpenedLog], subsystem: int | None) -> tuple[list[OpenedLog], list[Notice]]:
    """Leave out all logs but one of those that are the same, and of files of several frequencies the lower.

    subsystem: 20 keeps the lowest frequency. Returns the logs that are kept, in their order, and a notice for each
    other.
    """
    left_out: dict[int, Notice] = {}
    for one, two in combinations(opened, 2):
        if one.place in left_out or two.place in left_out:
            continue
        if _are_same(one, two):
            size_one, size_two = (sum(item.log.sizes_bytes.values()) for item in (one, two))
            kept, other = (two, one) if size_two > size_one else (one, two)
            text = f"{other.paths} is left out: it is the same log as {kept.paths}, and its pings would count twice"
            left_out[other.place] = Notice(code="log_repeated", text=text, place=other.paths)
        elif _are_two_frequencies(one, two):
            low, high = sorted((one, two), key=lambda item: item.frequency_khz)
            kept, other, wanted = (low, high, 21) if subsystem == 20 else (high, low, 20)
            text = (
                f"{other.paths} is left out: it holds the pings of {kept.paths} at {other.frequency_khz:g} kHz instead "
                f"of {kept.frequency_khz:g} kHz. Set sonar.subsystem: {wanted} to use it"
            )
            left_out[other.place] = Notice(code="log_of_another_frequency", text=text, place=other.paths)
    return [item for item in opened if item.place not in left_out], list(left_out.values())


class PingsOnce:
    """Leave out pings that a log before holds too, each with the navigation ahead of it, as where files overlap."""

    def __init__(self) -> None:
        self._marks = array("q")  # of the pings so far, 8 bytes each
        self._newest_s = -math.inf
        self.n_repeated = 0
        """Of the last log."""

    def of(self, events: Iterable[SourceEvent]) -> Iterator[SourceEvent]:
        """Yield the events of the next log, without what was read before."""
        # Of pings before; empty for a log that begins later than all before ended, of which nothing is held back.
        known: set[int] | None = None if self._marks else set()
        own, held, newest_s, self.n_repeated = array("q"), list[SourceEvent](), self._newest_s, 0
        for event in events:
            if not isinstance(event, Ping):
                if known is None or known:
                    held.append(event)
                else:
                    yield event
                continue
            if known is None:
                known = set(self._marks) if event.time_s <= self._newest_s else set()
            newest_s = max(newest_s, event.time_s)
            own.append(_mark(event))
            if own[-1] in known:
                self.n_repeated += 1
                yield from (one for one in held if isinstance(one, Notice))
            else:
                yield from held
                yield event
            held.clear()
        yield from held
        self._marks += own
        self._newest_s = newest_s


def _mark(ping: Ping) -> int:
    """Give a number that distinguishes pings by time, squint and samples."""
    sides = (0 if trace is None else zlib.crc32(trace.samples.tobytes()) for trace in (ping.port, ping.starboard))
    return hash((ping.time_s, ping.squint_rad, *sides))


def first_ping(log: Log) -> Ping | None:
    """Read a log's first ping; None if there is none."""
    return next((event for event in log if isinstance(event, Ping)), None)


def _are_same(one: OpenedLog, two: OpenedLog) -> bool:
    """Check whether two logs begin with the same ping, as copies do, or one file with all of the other."""
    if one.first_s != two.first_s:
        return False
    if one.first is not None and two.first is not None:
        if one.first.squint_rad != two.first.squint_rad:  # sub-apertures of one line
            return False
        sides = (one.first.port, two.first.port), (one.first.starboard, two.first.starboard)
        if all(_same_trace(*pair) for pair in sides):
            return True
    (first, *more), (second, *further) = (list(item.log.sizes_bytes) for item in (one, two))
    return not more and not further and _one_begins_the_other(first, second)


def _same_trace(one: EchoTrace | None, two: EchoTrace | None) -> bool:
    if one is None or two is None:
        return one is two
    return np.array_equal(one.samples, two.samples)


def _one_begins_the_other(first: Path, second: Path) -> bool:
    with open_regular(first) as one, open_regular(second) as two:
        while True:
            a, b = one.read(_COMPARED_BYTES), two.read(_COMPARED_BYTES)
            n_both = min(len(a), len(b))
            if a[:n_both] != b[:n_both]:
                return False
            if len(a) != len(b) or not a:
                return True


def _are_two_frequencies(one: OpenedLog, two: OpenedLog) -> bool:
    low, high = sorted((one.frequency_khz, two.frequency_khz))
    if low <= 0.0 or high <= _SAME_FREQUENCY * low or abs(one.first_s - two.first_s) > _TOGETHER_S:
        return False
    if one.first is None or two.first is None:
        return False
    both_port = one.first.port is not None and two.first.port is not None
    return both_port or (one.first.starboard is not None and two.first.starboard is not None)
