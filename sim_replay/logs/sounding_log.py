"""Read logs whose messages are soundings: one side of a ping, or both, with the navigation of that moment.

Such messages have a length and no checksum. One counts if another begins right behind it, or if none begins inside it:
a damaged length costs its own message, not those that it would swallow.
"""

from __future__ import annotations

import heapq
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN, EchoTrace, NavSample, Ping, SourceEvent
from auv_mcm.settings.config import SonarConfig
from drivers.framing import Framed, Framer, Refused
from sim_replay.logs.log_order import TimeOrder
from sim_replay.logs.log_reader import first_placed_s
from sim_replay.logs.message_file import MessageFile
from sim_replay.logs.ping_clock import spread_ties
from sim_replay.logs.xtf_report import LogReport

USUAL_SOUND_SPEED_MPS: Final = 1500.0  # m/s, where a log states none
_MAX_RANGE_M: Final = 2000.0  # m: more than any side scan reaches; a greater range is damage (chosen)
_JOINED_NS: Final = 10_000_000  # ns between the sides of one ping: fewer than between pings at 25 m (chosen)
_UNENDING: Final = 1 << 62  # bytes, of a file of which the beginning alone is looked at


class Layout(NamedTuple):
    """Describe how the messages of a format follow each other.

    name: of the format, in counters. first, first_at: bytes that every message has, and where. head_bytes: as many
    show whether one begins. max_bytes: of the longest. begins: whether one may begin, given a buffer, the place there
    and the place in the file. length: in bytes, given a buffer and the place; while it is not known, more than are
    there; 0 if impossible.
    """

    name: str
    first: re.Pattern[bytes]
    first_at: int
    head_bytes: int
    max_bytes: int
    begins: Callable[[bytes | bytearray, int, int], bool]
    length: Callable[[bytes | bytearray, int], int]


class FollowedGrammar:
    """Recognise messages of a layout in a file of some size in bytes; a message is its bytes."""

    proven: Final = False

    def __init__(self, layout: Layout, header_bytes: int, size_bytes: int) -> None:
        self._layout, self._size_bytes = layout, size_bytes
        self._origin = header_bytes  # of the buffer in the file
        self.name, self.head_bytes = layout.name, layout.head_bytes
        self.max_message_bytes = layout.max_bytes + layout.head_bytes

    def find(self, buffer: bytearray, start: int, refused: Refused) -> int:
        """Find the first place at which a message may begin."""
        layout, at = self._layout, start
        while (hit := layout.first.search(buffer, at + layout.first_at)) is not None:
            at = hit.start() - layout.first_at
            if len(buffer) - at < layout.head_bytes or layout.begins(buffer, at, self._origin + at):
                return at
            at += 1
        return -1

    def read(self, buffer: bytearray, at: int) -> tuple[bytes, int] | int | str:
        """Read a message with its end."""
        layout, there = self._layout, len(buffer) - at
        if there < layout.head_bytes:
            return layout.head_bytes
        if not layout.begins(buffer, at, self._origin + at):
            return "head"
        n_bytes = layout.length(buffer, at)
        if not layout.head_bytes <= n_bytes <= layout.max_bytes:
            return "length"
        behind = min(layout.head_bytes, self._size_bytes - self._origin - at - n_bytes)
        if there < n_bytes + max(behind, 0):
            return n_bytes + max(behind, 0)
        stop = at + n_bytes
        if behind == layout.head_bytes and not layout.begins(buffer, stop, self._origin + stop):
            inner = self.find(buffer, at + 1, {})
            if 0 <= inner < stop and len(buffer) - inner >= layout.head_bytes:
                return "swallowed"
        return bytes(buffer[at:stop]), n_bytes

    def forget(self, n_bytes: int) -> None:
        """Follow the buffer, which has lost its first bytes."""
        self._origin += n_bytes


def n_messages(layout: Layout, head: bytes) -> int:
    """Count the messages in a file's first bytes."""
    return len(Framer(FollowedGrammar(layout, 0, _UNENDING)).feed(head))


def messages_of(layout: Layout, path: Path, chunk_bytes: int, header_bytes: int = 0) -> MessageFile[bytes]:
    """Open a file of messages of a layout behind a header. Raises BadInputError for one that cannot be read."""
    return MessageFile(path, partial(FollowedGrammar, layout, header_bytes), chunk_bytes, header_bytes)


class Sounding(NamedTuple):
    """Hold what a message says of one side of a ping, or of both; times of the navigation do not count."""

    stamp: Stamp
    place: str
    port: EchoTrace | None
    starboard: EchoTrace | None
    navigation: NavSample
    sound_speed_mps: float = USUAL_SOUND_SPEED_MPS
    interval_s: float = NAN

    @property
    def time_s(self) -> float:
        """Return the time, s since 1970."""
        return self.stamp.utc_ns * 1e-9


Decode: TypeAlias = Callable[[Framed[bytes], str], Iterable[Sounding]]
"""Reads soundings in a message, given the place of it for messages to people."""


def stamp_of(time_s: float) -> Stamp:
    """Return the stamp of a time, s since 1970."""
    time_ns = round(time_s * 1e9)
    return Stamp(time_ns, time_ns)


def trace_of(samples: NDArray[Any], first_m: float, range_m: float, report: LogReport) -> EchoTrace | None:
    """Spread samples evenly over slant ranges; None, counted, without samples or for a range that cannot be.

    Parameters
    ----------
    samples
        (n,), near to far.
    first_m, range_m
        Near end of the first sample and far end of the last.
    report
        Takes the count.
    """
    if not samples.size or not 0.0 <= first_m < range_m <= _MAX_RANGE_M:  # False for NaN too
        report.counters["reader.ping_empty"] += 1
        return None
    spacing_m = (range_m - first_m) / samples.size
    return EchoTrace(samples=samples, first_range_m=first_m + 0.5 * spacing_m, spacing_m=spacing_m)


def place_of(latitude_deg: float, longitude_deg: float, report: LogReport) -> tuple[float, float]:
    """Return a position, NaN for 0, 0 and what is impossible, which `report` counts."""
    if latitude_deg == longitude_deg == 0.0:
        report.counters["reader.zero_position"] += 1
        return NAN, NAN
    if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):
        report.counters["reader.impossible_position"] += 1
        return NAN, NAN
    return latitude_deg, longitude_deg


class SoundingLog:
    """Read a log of soundings. Iterate for its events in order of time; every iteration begins at the first.

    A position is given only where it differs from the one before. Counts reader.pings, reader.ping_empty,
    reader.repeated_navigation, reader.zero_position, reader.impossible_position, reader.not_used.KIND, and those of
    `MessageFile`, `TimeOrder` and `spread_ties`.
    """

    def __init__(
        self,
        path: Path,
        files: Sequence[MessageFile[bytes]],
        decoder: Callable[[LogReport], Decode],
        sonar: SonarConfig,
        no_navigation: str,
        frequencies_khz: tuple[float, ...] = (),
        frequency_khz: float = 0.0,
    ) -> None:
        """Store what to read.

        Parameters
        ----------
        path
            As the log was named.
        files
            Of messages, each in the order of time.
        decoder
            Makes a reader of messages for one iteration; it may raise notices.
        sonar
            Its sound speed replaces the log's.
        no_navigation
            For the message, where a log of this format would hold positions, and what to do.
        frequencies_khz, frequency_khz
            All that are there, ascending, and the one in use; 0 where the log states none.
        """
        self._path, self._files, self._decoder, self._no_navigation = path, files, decoder, no_navigation
        self._set_speed_mps = sonar.sound_speed_mps
        self._report = LogReport(path)
        self._last_place, self._last = (NAN, NAN), ""
        self.frequencies_khz, self.frequency_khz = frequencies_khz, frequency_khz

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        """Return the size of each file of messages."""
        return {file.path: file.size_bytes for file in self._files}

    @property
    def bytes_read(self) -> int:
        """Count the bytes read so far."""
        return sum(file.bytes_read for file in self._files)

    @property
    def counters(self) -> Counter[str]:
        """Count what reading skipped or mended so far."""
        return sum((file.counters for file in self._files), self._report.counters)

    def navigation_sources(self) -> dict[str, str]:
        """Name what gives each quantity of navigation."""
        return dict.fromkeys(("position", "heading", "attitude", "depth", "altitude", "speed"), "ping headers")

    def first_time_s(self) -> float:
        """Find the time of the first ping, s since 1970. Raises BadInputError without pings or positions."""
        return first_placed_s(self, self._path, self._no_navigation)

    def __iter__(self) -> Iterator[SourceEvent]:
        report, ties = self._report, Counter[str]()
        report.clear()
        self._last_place, self._last = (NAN, NAN), ""
        for number, (time_s, sounding) in enumerate(spread_ties(_joined(self._in_order()), ties)):
            if (sample := self._sample(sounding.navigation, time_s)) is not None:
                yield sample
            ping = self._ping(sounding, time_s, number)
            yield from report.take()
            yield ping
        del ties["reader.time_backwards"]  # counted before
        report.counters.update(ties)
        report.extend([damage for file in self._files if (damage := file.damage()) is not None])
        report.finish()
        yield from report.take()

    def _in_order(self) -> Iterator[Sounding]:
        decode, order = self._decoder(self._report), TimeOrder[Sounding](self._report.counters)
        streams = (
            chain.from_iterable(decode(framed, f"{file.path.name}, byte {framed.offset}") for framed in file)
            for file in self._files
        )
        for sounding in heapq.merge(*streams, key=lambda sounding: sounding.stamp.mono_ns):
            yield from order.add(sounding)
        yield from order.finish()

    def _sample(self, given: NavSample, time_s: float) -> NavSample | None:
        """Return what is new of the navigation; None where nothing is."""
        place, now = (given.latitude_deg, given.longitude_deg), repr(structs.astuple(given))  # NaN equals NaN
        if now == self._last:
            self._report.counters["reader.repeated_navigation"] += 1
            return None
        self._last = now
        if place == self._last_place:
            place = NAN, NAN
        elif math.isfinite(place[0]):
            self._last_place = place
        return structs.replace(given, time_s=time_s, latitude_deg=place[0], longitude_deg=place[1])

    def _ping(self, sounding: Sounding, time_s: float, number: int) -> Ping:
        report, logged_mps = self._report, sounding.sound_speed_mps
        speed_mps = self._set_speed_mps or logged_mps
        if speed_mps != logged_mps:
            text = f"sonar.sound_speed_mps {speed_mps:g} replaces {logged_mps:g} m/s; slant ranges are scaled likewise"
            report.notify_once("reader.sound_speed_overridden", text, sounding.place)
        altitude_m = sounding.navigation.altitude_m
        report.counters["reader.pings"] += 1
        return Ping(
            number=number,
            time_s=time_s,
            port=_scaled(sounding.port, speed_mps / logged_mps),
            starboard=_scaled(sounding.starboard, speed_mps / logged_mps),
            sound_speed_mps=speed_mps,
            altitude_m=altitude_m if altitude_m > 0.0 else NAN,
            place=f"{sounding.place}, ping {number}",
        )


def _joined(soundings: Iterable[Sounding]) -> Iterator[Sounding]:
    """Join the sides of a ping that come in messages of their own."""
    held: Sounding | None = None
    for sounding in soundings:
        if held is None:
            held = sounding
        elif (
            (held.port is None) != (sounding.port is None)
            and (held.starboard is None) != (sounding.starboard is None)
            and abs(sounding.stamp.mono_ns - held.stamp.mono_ns) <= _JOINED_NS
        ):
            yield held._replace(port=held.port or sounding.port, starboard=held.starboard or sounding.starboard)
            held = None
        else:
            yield held
            held = sounding
    if held is not None:
        yield held


def _scaled(trace: EchoTrace | None, factor: float) -> EchoTrace | None:
    if trace is None or factor == 1.0:
        return trace
    return structs.replace(trace, first_range_m=trace.first_range_m * factor, spacing_m=trace.spacing_m * factor)
