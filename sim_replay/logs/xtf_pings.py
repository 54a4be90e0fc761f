"""Read the pings of an XTF log as they are stored: packets in, both sides of one ping out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import NAN
from sim_replay.logs.xtf_channels import PacketHead, belongs
from sim_replay.logs.xtf_fields import ChannelHeader, PingHeader, number_or_nan, ping_header, ping_time
from sim_replay.logs.xtf_header import kind_name
from sim_replay.logs.xtf_layout import SONAR, Extent, Layout, extents, packet_head
from sim_replay.logs.xtf_navigation import LATE_S, NAVIGATION_KINDS, PacketQueue, utc_seconds
from sim_replay.logs.xtf_packets import DamagedBytes, FileHeader, XtfPacket, read_packets
from sim_replay.logs.xtf_report import LogReport

_MAX_AHEAD: Final = 64  # pings read ahead, which bounds memory: two seconds of 30 a second
_MAX_DURATION_S: Final = 5.0  # s of a trace, 3750 m; a longer one is damage


class Trace(msgspec.Struct, frozen=True, eq=False):
    """Hold one side of a ping. samples: as stored."""

    samples: NDArray[Any]
    range_m: float
    delay_s: float
    weight: int


class RawPing(msgspec.Struct, frozen=True, eq=False):
    """Hold a ping as stored. day_s: since midnight, by a clock whose date may be impossible; time_s is NaN then."""

    offset: int
    header: PingHeader
    time_s: float
    interval_s: float
    port: Trace | None
    starboard: Trace | None
    day_s: float = NAN
    year: int = 0


class PingReader:
    """Read a log's pings; navigation packets between them go to `packets`.

    layout: of the part of the log that is being read. bytes_read: how far reading has come.
    """

    def __init__(
        self, first_packet: int, layout: Layout, learn: Callable[[BinaryIO, FileHeader], Layout], report: LogReport
    ) -> None:
        """Start before the first packet.

        Parameters
        ----------
        first_packet
            Its byte.
        layout
            Of the file header.
        learn
            Gives the layout of a further file header, and raises BadInputError or UsageError for one of no use.
        report
            Takes counters and notices.
        """
        self.layout = layout
        self.packets = PacketQueue()
        self.bytes_read = 0
        self._first_packet, self._learn, self._report = first_packet, learn, report

    def read(self, file: BinaryIO, size_bytes: int) -> Iterator[RawPing]:
        """Yield the pings in the order of the file."""
        waiting: list[XtfPacket] = []
        heads: list[PacketHead] = []
        for item in self._sonar_packets(file, size_bytes):
            layout = self.layout
            head = None
            if layout.packing.joins and item is not None:
                head = packet_head(layout.packing, layout.channels, item, heads)
            if waiting and (head is None or not belongs(layout.packing, heads, head, len(layout.channels))):
                if (ping := self._ping(waiting)) is not None:
                    yield ping
                waiting, heads = [], []
            if item is None:
                continue
            if head is not None:
                waiting.append(item)
                heads.append(head)
            elif (ping := self._ping([item])) is not None:
                yield ping
        if waiting and (ping := self._ping(waiting)) is not None:
            yield ping

    def _sonar_packets(self, file: BinaryIO, size_bytes: int) -> Iterator[XtfPacket | None]:
        """Yield the packets of side scan, and None where another file header holds from there on."""
        report = self._report
        for item in read_packets(file, self._first_packet, size_bytes, (SONAR, *NAVIGATION_KINDS)):
            self.bytes_read = item.offset
            if isinstance(item, DamagedBytes):
                report.damaged(item)
            elif isinstance(item, FileHeader):
                yield None
                self._join(file, item)
            elif item.kind != SONAR:
                if item.kind in NAVIGATION_KINDS:
                    self.packets.add(item.kind, item.data, item.offset)
                report.counters[f"reader.packet_not_side_scan.{kind_name(item.kind)}"] += 1
            else:
                yield item

    def _join(self, file: BinaryIO, item: FileHeader) -> None:
        report = self._report
        report.counters["reader.joined_log"] += 1
        place = report.place(item.offset)
        try:
            self.layout = self._learn(file, item)
            text = "another file header starts here: logs were joined; its channels hold from here on"
            report.notify_once("reader.joined_log", text, place)
        except (BadInputError, UsageError) as error:
            self.layout = self.layout.without_channels()
            report.notify_once("reader.joined_log_unusable", f"{error} Its pings are skipped", place)

    def _ping(self, packets: list[XtfPacket]) -> RawPing | None:
        """Make a ping of the packets that hold its channels."""
        report, layout, packet = self._report, self.layout, packets[0]
        used = layout.port_number, layout.starboard_number
        traces: dict[int, Trace] = {}
        empty, n_before, interval_s = False, 0, NAN
        for part in packets:
            for extent in extents(layout.packing, layout.channels, part.data, n_before):
                n_before += 1
                if extent.n_bytes is None or extent.channel is None:
                    what = "a ping's channels do not fit into its packet"
                    report.damaged(DamagedBytes(part.offset, len(part.data), what, at_end=False))
                    return None
                number = extent.channel.number
                if number not in used or extent.channel.dtype is None or not layout.pair.takes(extent.header.Frequency):
                    report.counters["reader.other_channel"] += 1
                    continue
                trace = self._trace(extent, part)
                if trace is None:
                    empty = True
                    continue
                interval_s = extent.header.SecondsPerPing
                if number in traces:
                    report.counters["reader.side_repeated"] += 1
                traces[number] = trace
        if empty or not traces:
            self._report_empty(packet.offset, has_other=bool(traces), is_empty=empty)
        if not traces:
            return None
        clock = ping_time(packet.data)
        time_s = utc_seconds(
            clock.Year, clock.Month, clock.Day, (clock.Hour, clock.Minute, clock.Second), 0.01 * clock.HSeconds
        )
        return RawPing(
            packet.offset,
            ping_header(packet.data),
            NAN if time_s is None else time_s,
            interval_s,
            traces.get(used[0]),
            traces.get(used[1]),
            clock.of_day_s,
            clock.Year,
        )

    def _trace(self, extent: Extent, packet: XtfPacket) -> Trace | None:
        """Return the samples of a channel; None for none, or without a range."""
        channel, n_bytes, header = extent.channel, extent.n_bytes, extent.header
        if channel is None or channel.dtype is None or n_bytes is None:
            return None
        n_samples = n_bytes // channel.dtype.itemsize
        range_m = self._range_m(header, packet)
        if n_samples == 0 or not 0.0 < range_m < 1e4:
            return None
        samples = np.frombuffer(packet.data, channel.dtype, n_samples, extent.offset)
        return Trace(samples, range_m, header.TimeDelay, header.Weight)

    def _report_empty(self, offset: int, *, has_other: bool, is_empty: bool) -> None:
        """Count a ping, or a side of it, that has no samples or no range."""
        report, place = self._report, self._report.place(offset)
        if not is_empty:
            report.counters["reader.ping_without_side_scan"] += 1
        elif has_other:
            report.counters["reader.side_empty"] += 1
            text = (
                "one side of a ping has no samples, or neither slant range nor duration; that side is left out and "
                "counted"
            )
            report.notify_once("reader.side_empty", text, place)
        else:
            report.counters["reader.ping_empty"] += 1
            text = "a ping has no samples, or neither slant range nor duration; such pings are skipped and counted"
            report.notify_once("reader.ping_empty", text, place)

    def _range_m(self, header: ChannelHeader, packet: XtfPacket) -> float:
        """Return the slant range of a channel, which recorders that leave it 0 state by its duration."""
        if 0.0 < header.SlantRange < math.inf or not 0.0 < header.TimeDuration < _MAX_DURATION_S:
            return header.SlantRange
        report, place = self._report, self._report.place(packet.offset)
        stored = ping_header(packet.data).SoundVelocity
        report.counters["reader.range_from_duration"] += 1
        text = "the slant range is 0; it is computed from the duration of the trace and the sound speed"
        report.notify_once("reader.range_from_duration", text, place)
        return 0.5 * header.TimeDuration * sound_speed_mps(number_or_nan(stored), place, report)


def read_ahead(pings: Iterator[RawPing]) -> Iterator[RawPing]:
    """Give pings once those after them are read, and with them navigation packets that were written late."""
    held: deque[RawPing] = deque()
    for ping in pings:
        held.append(ping)
        while len(held) > _MAX_AHEAD or ping.time_s - held[0].time_s > LATE_S:
            yield held.popleft()
    yield from held


def sound_speed_mps(stored: float, place: str, report: LogReport) -> float:
    """Return the sound speed of a ping, which some recorders state half, and others not at all.

    Parameters
    ----------
    stored
        In the ping's header, m/s.
    place
        Of the ping, for the notice.
    report
        Takes it.
    """
    speed = stored if 1400.0 <= stored <= 1600.0 else 2.0 * stored
    if 1400.0 <= speed <= 1600.0:
        return speed
    report.counters["reader.sound_speed_absurd"] += 1
    text = f"sound velocity {stored:g} m/s is absurd; 1500 is used. Set sonar.sound_speed_mps if you know it"
    report.notify_once("reader.sound_speed_absurd", text, place)
    return 1500.0
