"""Read XTF side-scan logs as a stream of navigation samples, pings and notices.

Layouts are pyxtf's; its reading loop is not used, because it loads a pickled index it finds beside the log, stops at
the first damaged packet and never ends on a packet of length zero. Conventions of the format (Triton Imaging, "eXtended
Triton Format", rev. 42): header times are UTC with 10 ms resolution; pitch is positive bow up, roll positive starboard
down, headings are degrees true; speed is in knots; a stored slant range is the far end of the last sample.
"""

from __future__ import annotations

import math
import os
import struct
from collections import Counter, deque
from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np
import pyxtf
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import NAN, EchoTrace, NavSample, Notice, Ping, SourceEvent
from auv_mcm.safe_files import open_regular
from auv_mcm.settings.config import SonarConfig
from drivers.navigation.corrections import offset_m
from sim_replay.logs.ping_clock import spread_ties
from sim_replay.logs.port_order import DECISIVE, PortOrderEvidence, port_order_evidence
from sim_replay.logs.xtf_channels import (
    ChannelHead,
    PacketHead,
    Packing,
    belongs,
    channel_index,
    choose_pair,
    learn_packing,
    pair_notices,
)
from sim_replay.logs.xtf_header import (
    GROUND_RANGE,
    LATITUDE_LONGITUDE,
    SIDE_SCAN,
    Channel,
    channels,
    header_channel,
    kind_name,
    name_channels,
)
from sim_replay.logs.xtf_navigation import (
    NAVIGATION_KINDS,
    PacketQueue,
    Place,
    SensorWatch,
    Wanted,
    are_degrees,
    behind,
    projection,
    utc_seconds,
)
from sim_replay.logs.xtf_packets import (
    FILE_FORMAT,
    HEADER_BLOCK,
    DamagedBytes,
    FileHeader,
    XtfPacket,
    header_bytes,
    read_packets,
)
from sim_replay.logs.xtf_samples import are_signed, halves, hold_both_sides, magnitude

KNOT_MPS: Final = 1852.0 / 3600.0  # m/s: a nautical mile in an hour
PROBE_PINGS: Final = 50  # looked at before the first is given, to learn what all of them share
_PROBE_PACKETS: Final = 4 * PROBE_PINGS  # of side scan, as a ping may be four; to learn how they hold channels
_PROBE_ITEMS: Final = 20 * _PROBE_PACKETS  # of any kind, among which they are looked for

_SONAR: Final = 0  # packet type: side scan and sub-bottom
_PING_HEADER: Final = 256  # bytes (XTF)
_CHANNEL_HEADER: Final = 64  # bytes (XTF)
_DAY_S: Final = 86_400.0  # seconds per day
_FIRST_YEAR: Final = 1980  # before it there was no recorder of this format: a clock that was never set
_MAX_INTERVAL_S: Final = 2.0  # s between pings: at 750 m of range a second passes
_NOMINAL_SOUND_SPEED_MPS: Final = 1500.0  # m/s, for the time between pings of which nothing else is known
_MAX_LAYBACK_M: Final = 5000.0  # m: longer than any tow cable lets a sonar hang behind
_CLOCK_NOT_SET: Final = "the recorder's clock was never set: the date is unknown and times count from 1970"
_MAX_DURATION_S: Final = 5.0  # s of a trace, 3750 m; a longer one is damage
_MAX_DAMAGE_NOTICES: Final = 10  # of a file; further damage is only counted
# What the reader mends, leaves out and counts, or was set to do: nobody has to act.
_MENDED: Final = frozenset(
    f"reader.{name}"
    for name in (
        *(
            "ping_empty",
            "side_empty",
            "time_tied",
            "clock_stuck",
            "joined_log",
            "other_channel",
            "sound_speed_overridden",
            "range_from_duration",
        ),
        *("sample_type_change", "sample_count_change", "weight_change", "sample_not_finite", "time_delay"),
    )
)


class _PingTime(NamedTuple):
    """Hold the time in a ping's header, in the order of the format, under pyxtf's names."""

    Year: int
    Month: int
    Day: int
    Hour: int
    Minute: int
    Second: int
    HSeconds: int


class _PingHeader(NamedTuple):
    """Hold the other fields read of a ping's header, likewise."""

    SoundVelocity: float
    ShipSpeed: float
    ShipGyro: float
    ShipYcoordinate: float
    ShipXcoordinate: float
    SensorSpeed: float
    SensorYcoordinate: float
    SensorXcoordinate: float
    Layback: float
    SensorDepth: float
    SensorPrimaryAltitude: float
    SensorPitch: float
    SensorRoll: float
    SensorHeading: float


class _ChannelHeader(NamedTuple):
    """Hold the fields read of a channel's header in a ping, likewise."""

    ChannelNumber: int
    SlantRange: float
    TimeDelay: float
    TimeDuration: float
    SecondsPerPing: float
    Frequency: int
    NumSamples: int
    Weight: int


def _packed(structure: Any, names: tuple[str, ...]) -> struct.Struct:
    """Unpack some fields of one of pyxtf's structures, named in their order there: ten times as fast as one attribute
    after the other."""
    types = dict(structure._fields_)
    code, end = "<", 0
    for name in names:
        field = getattr(structure, name)
        code += f"{field.offset - end}x{types[name]._type_}"
        end = field.offset + field.size
    return struct.Struct(code)


_TIME_FIELDS: Final = _packed(pyxtf.XTFPingHeader, _PingTime._fields)
_PING_FIELDS: Final = _packed(pyxtf.XTFPingHeader, _PingHeader._fields)
_NO_HEADER: Final = _ChannelHeader(0, NAN, NAN, NAN, NAN, 0, 0, 0)
_PING_NUMBER: Final = _packed(pyxtf.XTFPingHeader, ("PingNumber",))
_CHANNEL_FIELDS: Final = _packed(pyxtf.XTFPingChanHeader, _ChannelHeader._fields)


class _Trace(NamedTuple):
    samples: NDArray[Any]  # as stored
    range_m: float
    delay_s: float
    weight: int


class _RawPing(NamedTuple):
    offset: int
    header: _PingHeader
    time_s: float
    interval_s: float
    port: _Trace | None
    starboard: _Trace | None
    day_s: float = NAN  # since midnight, by a clock whose date may be impossible
    year: int = 0


class _Habits(NamedTuple):
    """Hold what the first pings show of the recorder."""

    port_far_to_near: bool
    ship_position: bool
    ship_gyro: bool
    ship_speed: bool
    wanted: Wanted  # of navigation packets
    starboard_far_to_near: bool = False


class XtfLog:
    """Read one XTF file. Iterate for NavSample, Ping and Notice; `counters` fill meanwhile.

    Pings come in file order, each after its NavSample and its notices. Memory does not depend on the length of the log.
    Every iteration starts anew.

    Navigation: a header that repeats all navigation of the one before brings no NavSample; a position is given only
    where it differs from the one before, so that interpolation runs between distinct fixes and a frozen navigation ages
    until it counts as stale. Zero means unknown for a position and for a header without any navigation; an altitude of
    zero is delivered as it is, and refused by intake.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        sonar: SonarConfig,
        *,
        epsg: int | None = None,
        chunk_bytes: int = 1 << 18,
    ) -> None:
        """Open and check the file header. `chunk_bytes` sizes the read buffer and nothing else.

        epsg: of the projection of positions in metres; None for degrees.

        Raises BadInputError for anything but an XTF file with side-scan channels in slant range and geographic
        coordinates, UsageError for an `epsg` that cannot be used.
        """
        self._path = Path(path)
        self._sonar = sonar
        self._chunk_bytes = max(chunk_bytes, 2)  # 1 would ask for line buffering
        self.counters: Counter[str] = Counter()
        self.bytes_read = 0
        self._notices: deque[Notice] = deque()
        self._raised: set[str] = set()
        self._reference_weight: dict[str, int] = {}
        self._n_samples: dict[str, tuple[int, np.dtype[Any]]] = {}
        self._last_navigation: tuple[float, ...] = ()
        self._project: Place | None = None if epsg is None else projection(epsg)
        self._units_by_value = False  # degrees, although the header says metres
        self._packets = PacketQueue()
        self._watch = SensorWatch()
        self._packing = Packing()
        self._heads: dict[int, list[PacketHead]] = {}  # of the packets behind a file header, by its offset
        with self._open() as file:
            self.size_bytes = os.fstat(file.fileno()).st_size
            self._first_packet, header = self._read_file_header(file)
            try:
                self._use_header(file, header, 0)
            except _NoSideScanError as error:
                raise BadInputError(
                    f"{error} It holds {self._inventory(file)}. Give a log recorded with side scan switched on."
                ) from error
            self._check_units(file)

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        """Return the size of the file."""
        return {self._path: self.size_bytes}

    def navigation_sources(self) -> dict[str, str]:
        """Name what gives each quantity of navigation."""
        return dict.fromkeys(("position", "heading", "attitude", "depth", "altitude", "speed"), "ping headers")

    @property
    def channel_names(self) -> str:
        """Name the channels that the file header describes."""
        return name_channels(self._channels)

    @property
    def frequencies_khz(self) -> tuple[float, ...]:
        """Return all frequencies of side scan, ascending."""
        return self._pair.frequencies_khz

    @property
    def frequency_khz(self) -> float:
        """Return the frequency in use, 0 where the log states none."""
        return self._pair.used_khz

    def first_time_s(self) -> float:
        """Find the time of the first ping, s since 1970. Raises BadInputError if there is none."""
        return next(
            (event.time_s for event in self if isinstance(event, Ping) and math.isfinite(event.time_s)), math.inf
        )

    def __iter__(self) -> Iterator[SourceEvent]:
        """Iterate. Raises BadInputError if there is no usable ping at all."""
        self.counters.clear()
        self.bytes_read = 0
        self._notices.clear()
        self._raised.clear()
        self._reference_weight.clear()
        self._n_samples.clear()
        self._last_navigation = ()
        self._packets, self._watch = PacketQueue(), SensorWatch()
        with self._open() as file:
            _, header = self._read_file_header(file)
            self._use_header(file, header, 0)
            self._raise_other_channels_notice(header)
            raw_pings = self._timed(self._raw_pings(file))
            probe = list(islice(raw_pings, PROBE_PINGS))
            if not probe:
                raise BadInputError(self._no_ping_text())
            probe, raw_pings = self._mended(probe, raw_pings)
            habits = self._habits(probe)
            for number, (time_s, raw) in enumerate(spread_ties(chain(probe, raw_pings), self.counters)):
                if self._notices:
                    yield from self._notices
                    self._notices.clear()
                yield from self._packets.until(time_s, habits.wanted, self._place_deg)
                navigation = self._navigation(raw, time_s, habits)
                if navigation is not None:
                    yield navigation
                ping = self._ping(raw, time_s, number, habits)
                if self._notices:
                    yield from self._notices
                    self._notices.clear()
                yield ping
            self.bytes_read = self.size_bytes
            self._raise_total_notices()
            yield from self._notices
            self._notices.clear()

    # --- file and file header ---

    def _open(self) -> BinaryIO:
        if self._path.is_dir():
            raise BadInputError(f"{self._path} is a directory. Name the XTF file inside it.")
        try:
            return open_regular(self._path, self._chunk_bytes)
        except FileNotFoundError as error:
            raise BadInputError(f"{self._path} does not exist. Check the path.") from error
        except OSError as error:
            raise BadInputError(f"{self._path} cannot be read: {error.strerror}. Check its permissions.") from error

    def _read_file_header(self, file: BinaryIO) -> tuple[int, bytes]:
        size = os.fstat(file.fileno()).st_size
        if size == 0:
            raise BadInputError(
                f"{self._path} is empty (0 bytes). The recorder wrote nothing, or a copy failed: fetch it again."
            )
        first = file.read(1)
        if first[0] != FILE_FORMAT:
            raise BadInputError(
                f"{self._path} is not an XTF file: byte 0 is 0x{first[0]:02x}, an XTF file starts with "
                f"0x{FILE_FORMAT:02x}. Give the XTF export of this log."
            )
        if size < HEADER_BLOCK:
            raise BadInputError(
                f"{self._path} ends inside its file header ({size} of {HEADER_BLOCK} bytes). Fetch the file again."
            )
        length = header_bytes(file, 0, size) or HEADER_BLOCK
        file.seek(0)
        return length, file.read(length)

    def _use_header(self, file: BinaryIO, data: bytes, offset: int) -> None:
        """Learn channels and units from a file header and the packets behind it. Raises BadInputError or UsageError."""
        place = f"{self._path}" if offset == 0 else f"{self._path} (file header at byte {offset})"
        header = pyxtf.XTFFileHeader.from_buffer_copy(data)
        self._file_header, self._header_bytes = header, data
        self._channels = channels(header, data)
        side_scan = [c for c in self._channels if c.kind in SIDE_SCAN]
        if not side_scan:
            raise _NoSideScanError(f"{place} has no side-scan channel ({name_channels(self._channels)}).")
        heads = self._packet_heads(file, offset, len(data))
        self._packing = learn_packing(heads, len(self._channels))
        self._pair = choose_pair(self._channels, heads, self._packing, self._sonar.subsystem)
        port, starboard = self._pair.port, self._pair.starboard
        self._port_number = port.number if port is not None else -1
        self._starboard_number = starboard.number if starboard is not None else -1
        for channel in (port, starboard):
            if channel is None:
                continue
            if channel.dtype is None:
                raise BadInputError(
                    f"{place}: channel {channel.number} ({channel.name}) has a sample format that cannot be read "
                    "(known: 1, 2 and 4 byte integers, IEEE float). Export the log again with integer samples."
                )
            if header_channel(header, data, channel.number).CorrectionFlags == GROUND_RANGE:
                raise BadInputError(
                    f"{place}: channel {channel.number} ({channel.name}) is already corrected to ground range; slant "
                    "range is needed. Export the log without slant-range correction."
                )

        joined_in_metres = offset > 0 and header.NavUnits != LATITUDE_LONGITUDE
        if joined_in_metres and self._project is None and not self._units_by_value:
            raise BadInputError(f"{place}: {self._metres_text()}")

    def _metres_text(self) -> str:
        return (
            f"positions are projected coordinates in metres (NavUnits {self._file_header.NavUnits}) and the "
            "projection is not given. Set navigation.epsg to its EPSG code (32632 for UTM zone 32 north), or export "
            "the log with latitude and longitude (NavUnits 3)."
        )

    def _check_units(self, file: BinaryIO) -> None:
        """Find whether positions that are said to be metres are degrees. Raises BadInputError where they are not."""
        units = self._file_header.NavUnits
        if units == LATITUDE_LONGITUDE or self._project is not None:
            return
        positions: list[tuple[float, float, float]] = []
        for number, raw in enumerate(islice(self._raw_pings(file), PROBE_PINGS)):
            header, time_s = raw.header, raw.time_s if math.isfinite(raw.time_s) else float(number)
            sensor = header.SensorXcoordinate, header.SensorYcoordinate
            ship = header.ShipXcoordinate, header.ShipYcoordinate
            positions.append((time_s, *(ship if sensor == (0.0, 0.0) else sensor)))
        positions += [
            (packet.time_s if math.isfinite(packet.time_s) else float(number), packet.x, packet.y)
            for number, packet in enumerate(self._packets.positions)
        ]
        if any(position[1:] != (0.0, 0.0) for position in positions) and not are_degrees(positions):
            raise BadInputError(f"{self._path}: {self._metres_text()}")
        self._units_by_value = True

    def _inventory(self, file: BinaryIO) -> str:
        kinds: Counter[str] = Counter()
        for item in read_packets(file, self._first_packet, self.size_bytes, ()):
            if isinstance(item, XtfPacket):
                kinds[kind_name(item.kind)] += 1
        return ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items())) + " packets" if kinds else "no packets"

    def _no_ping_text(self) -> str:
        seen = ", ".join(f"{name} {n}" for name, n in sorted(self.counters.items())) or "no packets"
        return (
            f"{self._path} has side-scan channels but no usable side-scan ping ({seen}). Check that the recording was "
            "not stopped at once."
        )

    # --- packets to raw pings ---

    def _packet_heads(self, file: BinaryIO, offset: int, n_bytes: int) -> list[PacketHead]:
        """Read the heads of the first side-scan packets behind a file header; the file is left where it was."""
        if offset in self._heads:
            return self._heads[offset]
        at = file.seek(0, os.SEEK_CUR)
        heads: list[PacketHead] = []
        for item in islice(read_packets(file, offset + n_bytes, self.size_bytes, (_SONAR,)), _PROBE_ITEMS):
            if isinstance(item, FileHeader) or len(heads) == _PROBE_PACKETS:
                break
            if isinstance(item, XtfPacket) and item.kind == _SONAR:
                head = self._head(item, [])
                if head is not None:
                    heads.append(head)
        file.seek(at)
        self._heads[offset] = heads
        return heads

    def _head(self, packet: XtfPacket, before: list[PacketHead]) -> PacketHead | None:
        """Read what a packet states of its ping and channels; None for a damaged one. before: packets of its ping."""
        for n_before in dict.fromkeys((sum(len(part.channels) for part in before), 0)):
            extents = list(self._extents(packet.data, n_before))
            if extents and all(n_bytes is not None for _, _, n_bytes, _ in extents):
                return _packet_head(packet.data, [header for *_, header in extents])
        return None

    def _raw_pings(self, file: BinaryIO) -> Iterator[_RawPing]:
        waiting: list[XtfPacket] = []
        heads: list[PacketHead] = []
        for item in self._sonar_packets(file):
            head = self._head(item, heads) if self._packing.joins and item is not None else None
            if waiting and (head is None or not belongs(self._packing, heads, head, len(self._channels))):
                if (ping := self._raw_ping(waiting)) is not None:
                    yield ping
                waiting, heads = [], []
            if item is None:
                continue
            if head is not None:
                waiting.append(item)
                heads.append(head)
            elif (ping := self._raw_ping([item])) is not None:
                yield ping
        if waiting and (ping := self._raw_ping(waiting)) is not None:
            yield ping

    def _sonar_packets(self, file: BinaryIO) -> Iterator[XtfPacket | None]:
        """Yield the packets of side scan, and None where other channels hold from there on."""
        for item in read_packets(file, self._first_packet, self.size_bytes, (_SONAR, *NAVIGATION_KINDS)):
            self.bytes_read = item.offset
            if isinstance(item, DamagedBytes):
                self._raise_damage_notice(item)
            elif isinstance(item, FileHeader):
                yield None
                self._raise_joined_notice(file, item)
            elif item.kind != _SONAR:
                if item.kind in NAVIGATION_KINDS:
                    self._packets.add(item.kind, item.data)
                self.counters[f"reader.packet_not_side_scan.{kind_name(item.kind)}"] += 1
            else:
                yield item

    def _extents(self, data: bytes, n_before: int) -> Iterator[tuple[Channel | None, int, int | None, _ChannelHeader]]:
        """Find, per channel of a ping packet: its description, offset and length of its samples (None: beyond the
        packet), its header. n_before: channels of the ping in packets before.
        """
        if len(data) < _PING_HEADER:
            yield None, 0, None, _NO_HEADER
            return
        n_channels = int.from_bytes(data[4:6], "little")
        offset = _PING_HEADER
        for index in range(n_channels):
            if offset + _CHANNEL_HEADER > len(data):
                yield None, offset, None, _NO_HEADER
                return
            header = _ChannelHeader._make(_CHANNEL_FIELDS.unpack_from(data, offset))
            offset += _CHANNEL_HEADER
            number = channel_index(self._packing, self._channels, _channel_head(header), n_before + index)
            if number >= len(self._channels):
                yield None, offset, None, _NO_HEADER
                return
            channel = self._channels[number]
            width = channel.dtype.itemsize if channel.dtype is not None else 1
            n_samples = header.NumSamples
            if n_samples == 0 and offset + channel.legacy_samples * width <= len(data):
                n_samples = channel.legacy_samples  # before rev. X26 the file header gave it for all pings
            n_bytes = n_samples * width
            if offset + n_bytes > len(data):
                yield channel, offset, None, header
                return
            yield channel, offset, n_bytes, header
            offset += n_bytes

    def _raw_ping(self, packets: list[XtfPacket]) -> _RawPing | None:
        """Make a ping of the packets that hold its channels."""
        packet, data = packets[0], packets[0].data
        traces: dict[int, _Trace] = {}
        empty, n_before = False, 0
        interval = NAN
        for part in packets:
            for channel, start, n_bytes, header in self._extents(part.data, n_before):
                n_before += 1
                if n_bytes is None or channel is None:
                    what = "a ping's channels do not fit into its packet"
                    self._raise_damage_notice(DamagedBytes(part.offset, len(part.data), what, at_end=False))
                    return None
                is_used = channel.number in (self._port_number, self._starboard_number)
                if not is_used or channel.dtype is None or not self._pair.takes(header.Frequency):
                    self.counters["reader.other_channel"] += 1
                    continue
                n_samples = n_bytes // channel.dtype.itemsize
                range_m = self._range_m(header, part)
                if n_samples == 0 or not 0.0 < range_m < 1e4:
                    empty = True
                    continue
                samples = np.frombuffer(part.data, channel.dtype, n_samples, start)
                interval = header.SecondsPerPing
                if channel.number in traces:
                    self.counters["reader.side_repeated"] += 1
                traces[channel.number] = _Trace(samples, range_m, header.TimeDelay, header.Weight)
        if not traces:
            code = "reader.ping_empty" if empty else "reader.ping_without_side_scan"
            self.counters[code] += 1
            if empty:
                text = "a ping has no samples, or neither slant range nor duration; such pings are skipped and counted"
                self._raise_notice_once("reader.ping_empty", text, self._place(packet.offset))
            return None
        if empty:
            self.counters["reader.side_empty"] += 1
            self._raise_notice_once(
                "reader.side_empty",
                "one side of a ping has no samples, or neither slant range nor duration; that side is left out and "
                "counted",
                self._place(packet.offset),
            )
        clock = _PingTime._make(_TIME_FIELDS.unpack_from(data))
        time_s = _utc_seconds(clock)
        day_s = 3600.0 * clock.Hour + 60.0 * clock.Minute + clock.Second + 0.01 * clock.HSeconds
        ping_header = _PingHeader._make(_PING_FIELDS.unpack_from(data))
        return _RawPing(
            packet.offset,
            ping_header,
            NAN if time_s is None else time_s,
            interval,
            traces.get(self._port_number),
            traces.get(self._starboard_number),
            day_s,
            clock.Year,
        )

    def _timed(self, raw_pings: Iterator[_RawPing]) -> Iterator[_RawPing]:
        """Leave out pings without a time; where the clock was never set, count all from 1970."""
        probe = list(islice(raw_pings, PROBE_PINGS))
        if not probe:
            return
        place = self._place(probe[0].offset)
        pings = chain(probe, raw_pings)
        if all(math.isnan(raw.time_s) for raw in probe):
            yield from self._counted(probe, pings, place)
            return
        year = probe[0].year
        if 0 < year < 100:
            text = f"years have two digits ({year:02d}) and are taken as 1980 to 2079; check the dates of contacts"
            self._raise_notice_once("reader.time_two_digits", text, place)
        elif year < _FIRST_YEAR:
            self._raise_notice_once("reader.time_unknown", f"{_CLOCK_NOT_SET} (year {year})", place)
        for raw in pings:
            if not math.isnan(raw.time_s):
                yield raw
                continue
            self.counters["reader.time_invalid"] += 1
            self._raise_notice_once(
                "reader.time_invalid",
                f"a ping's date or time is impossible (year {raw.year}); such pings are skipped and counted: set the "
                "recorder's clock",
                self._place(raw.offset),
            )

    def _counted(self, probe: list[_RawPing], pings: Iterator[_RawPing], place: str) -> Iterator[_RawPing]:
        """Time pings without a date, by the time of day if it goes on, else by their interval."""
        runs = len({raw.day_s for raw in probe}) > 1
        interval_s = _interval_s(probe)
        how = "the time of day" if runs else f"{interval_s:.3g} s from ping to ping"
        self._raise_notice_once("reader.time_unknown", f"{_CLOCK_NOT_SET}, by {how}", place)
        midnights, last_s = 0, -math.inf
        for number, raw in enumerate(pings):
            midnights += runs and raw.day_s < last_s - 0.5 * _DAY_S
            last_s = raw.day_s
            yield raw._replace(time_s=midnights * _DAY_S + raw.day_s if runs else number * interval_s)

    def _range_m(self, header: _ChannelHeader, packet: XtfPacket) -> float:
        """Return the slant range of a channel, which recorders that leave it 0 state by its duration."""
        if 0.0 < header.SlantRange < math.inf or not 0.0 < header.TimeDuration < _MAX_DURATION_S:
            return header.SlantRange
        place = self._place(packet.offset)
        stored = _PingHeader._make(_PING_FIELDS.unpack_from(packet.data)).SoundVelocity
        self.counters["reader.range_from_duration"] += 1
        text = "the slant range is 0; it is computed from the duration of the trace and the sound speed"
        self._raise_notice_once("reader.range_from_duration", text, place)
        return 0.5 * header.TimeDuration * self._sound_speed(_number(stored), place)

    # --- evidence of the first pings ---

    def _mended(self, probe: list[_RawPing], others: Iterator[_RawPing]) -> tuple[list[_RawPing], Iterator[_RawPing]]:
        """Make magnitudes of signed samples and two sides of one trace, where the first pings show that they are."""
        place = self._place(probe[0].offset)
        signed = {side for side in ("port", "starboard") if self._is_signed(side, probe, place)}
        change = _Change(frozenset(signed), False)
        both = self._hold_both_sides([change.apply(raw) for raw in probe])
        if both:
            text = (
                "one channel holds both sides, port from far to near, then starboard from near to far: the water "
                "column is in its middle. It is split there; if port and starboard look exchanged, set sonar.sides: "
                "swapped"
            )
            self._raise_notice("reader.both_sides_in_one_channel", text, place)
        change = change._replace(splits=both)
        return [change.apply(raw) for raw in probe], map(change.apply, others)

    def _is_signed(self, side: str, probe: list[_RawPing], place: str) -> bool:
        traces = [trace for raw in probe if (trace := getattr(raw, side)) is not None]
        channel = self._pair.port if side == "port" else self._pair.starboard
        if not traces or channel is None:
            return False
        says_signed = not header_channel(self._file_header, self._header_bytes, channel.number).UniPolar
        if not are_signed(np.concatenate([trace.samples for trace in traces]), says_signed):
            return False
        text = f"samples of {side} are signed numbers about zero; their magnitude is used"
        if not says_signed:
            text += ", although the file header says UniPolar. Check the waterfall, and export envelopes if it is wrong"
        self._raise_notice("reader.signed_samples", text, place, for_the_record=says_signed)
        return True

    def _hold_both_sides(self, probe: list[_RawPing]) -> bool:
        if any(raw.port is not None and raw.starboard is not None for raw in probe):
            return False
        traces = [trace for raw in probe if (trace := raw.port or raw.starboard) is not None]
        (n_samples, range_m), _ = Counter((trace.samples.shape[0], trace.range_m) for trace in traces).most_common(1)[0]
        chosen = [trace.samples for trace in traces if (trace.samples.shape[0], trace.range_m) == (n_samples, range_m)]
        return hold_both_sides(np.stack(chosen), range_m, self._sonar.blank_m)

    def _habits(self, probe: list[_RawPing]) -> _Habits:
        headers = [raw.header for raw in probe]

        def all_unknown(field: str) -> bool:
            return all(_number(getattr(h, field)) == 0.0 for h in headers)

        def any_known(field: str) -> bool:
            return any(_number(getattr(h, field)) != 0.0 for h in headers)

        ship_position = (
            all_unknown("SensorYcoordinate") and all_unknown("SensorXcoordinate") and any_known("ShipYcoordinate")
        )
        if ship_position:
            layback = any_known("Layback")
            self._raise_notice_once(
                "reader.ship_position",
                f"the log has no sensor positions; the vessel's are used, {'with the' if layback else 'without'} "
                f"layback{' logged for each ping' if layback else ''}. For a towed sonar log sensor positions, or set "
                "sonar.lever_arm_m to the sonar's place from the vessel's reference ([-30, 0, 0] for 30 m astern)",
                self._place(probe[0].offset),
            )
        has_position = ship_position or any_known("SensorYcoordinate") or any_known("SensorXcoordinate")
        wanted = Wanted(
            position=not has_position,
            heading=all_unknown("SensorHeading") and all_unknown("ShipGyro"),
            level=all_unknown("SensorPitch") and all_unknown("SensorRoll"),
        )
        used = ", ".join(
            f"{quantity} from packets {kind}"
            for quantity, kind in self._packets.kinds.items()
            if getattr(wanted, quantity)
        )
        if used:
            self._raise_notice(
                "reader.navigation_packets",
                f"ping headers lack what packets of their own hold: {used}",
                self._place(probe[0].offset),
                for_the_record=True,
            )
        if self._file_header.NavUnits != LATITUDE_LONGITUDE and self._project is None and has_position | bool(used):
            self._raise_notice_once(
                "reader.units_by_value",
                f"the log says that positions are metres (NavUnits {self._file_header.NavUnits}), and their values are "
                "degrees: they are read as degrees. Check a contact's place; have the writer state NavUnits 3",
                self._place(probe[0].offset),
            )
        starboard_far_to_near = self._starboard_is_turned(probe)
        if starboard_far_to_near:
            probe = [raw._replace(starboard=_reversed(raw.starboard)) for raw in probe]
        return _Habits(
            port_far_to_near=self._port_order(probe) == "far_to_near",
            starboard_far_to_near=starboard_far_to_near,
            ship_position=ship_position,
            ship_gyro=all_unknown("SensorHeading") and any_known("ShipGyro"),
            ship_speed=all_unknown("SensorSpeed") and any_known("ShipSpeed"),
            wanted=wanted,
        )

    def _port_order(self, probe: list[_RawPing]) -> str:
        wanted = self._sonar.port_order
        evidence = _probe_port_order(probe, self._sonar.blank_m)
        place = self._place(probe[0].offset)
        if evidence is None:
            return "far_to_near"  # no port channel: nothing to turn
        seen = None
        if abs(evidence.total) >= DECISIVE:
            seen = "far_to_near" if evidence.total > 0.0 else "near_to_far"
        cues = (
            f"water column {evidence.water_column:+.2f}, ring-down {evidence.ring_down:+.2f}, "
            f"likeness to starboard {evidence.starboard:+.2f}; positive speaks for far_to_near"
        )
        if wanted == "auto":
            order = seen or "far_to_near"
            text = (
                f"port samples are taken as stored {order} ({cues})"
                if seen
                else f"the order of port samples cannot be seen in the first pings ({cues}); {order} is assumed. "
                "If port looks mirrored, set sonar.port_order"
            )
            self._raise_notice("reader.port_order", text, place, for_the_record=seen is not None)
            return order
        if seen is not None and seen != wanted and abs(evidence.total) >= 2 * DECISIVE:
            self._raise_notice(
                "reader.port_order_disagrees",
                f"sonar.port_order is {wanted}, but the first pings look {seen} ({cues}). The setting is obeyed; "
                "check the port waterfall",
                place,
            )
        return wanted

    def _starboard_is_turned(self, probe: list[_RawPing]) -> bool:
        """Check whether starboard is stored far to near, which the format does not provide for."""
        alone = _probe_port_order(
            [raw._replace(port=raw.starboard, starboard=None) for raw in probe], self._sonar.blank_m
        )
        if alone is None or alone.total < DECISIVE:
            return False
        port = _probe_port_order([raw._replace(starboard=None) for raw in probe], self._sonar.blank_m)
        likeness = 0.0
        if port is not None and abs(port.total) >= DECISIVE:
            near = [raw._replace(port=_reversed(raw.port)) for raw in probe] if port.total > 0.0 else probe
            pairs = [raw._replace(port=raw.starboard, starboard=raw.port) for raw in near]
            with_port = _probe_port_order(pairs, self._sonar.blank_m)
            likeness = 0.0 if with_port is None else with_port.starboard
        if alone.total < 2 * DECISIVE and alone.total + likeness < 3 * DECISIVE:
            return False
        text = "starboard is stored far to near and is turned"
        exchanged = port is not None and port.total <= -2 * DECISIVE
        if exchanged:
            text += (
                ", while port is stored near to far: the channels may be exchanged. The file header's sides are taken; "
                "if port and starboard look exchanged, set sonar.sides: swapped"
            )
        code = "reader.sides_disagree" if exchanged else "reader.starboard_order"
        self._raise_notice(code, text, self._place(probe[0].offset), for_the_record=not exchanged)
        return True

    # --- raw pings to records ---

    def _navigation(self, raw: _RawPing, time_s: float, habits: _Habits) -> NavSample | None:
        h = raw.header
        heading = h.ShipGyro if habits.ship_gyro else h.SensorHeading
        latitude, longitude = self._header_place(raw, time_s, habits, heading)
        speed = h.ShipSpeed if habits.ship_speed else h.SensorSpeed
        values: tuple[float, ...] = (
            latitude,
            longitude,
            heading,
            h.SensorPitch,
            h.SensorRoll,
            h.SensorDepth,
            h.SensorPrimaryAltitude,
            speed,
        )
        is_whole = math.isfinite(sum(values))  # what is not finite leaves no finite sum
        if not is_whole:
            values = tuple(map(_number, values))
        latitude, longitude, heading, pitch, roll, depth, altitude, speed = values
        by_packet = habits.wanted.position and "position" in self._packets.kinds
        if latitude == longitude == heading == altitude == 0.0 and not by_packet:
            self.counters["reader.zero_navigation"] += 1
            text = "a ping has no navigation (all zero); it is taken as unknown"
            self._raise_notice_once("reader.zero_navigation", text, self._place(raw.offset))
            return None
        if not is_whole and any(map(math.isnan, values)):
            self.counters["reader.nan_navigation"] += 1
            text = "navigation holds NaN or infinity; those quantities are taken as unknown"
            self._raise_notice_once("reader.nan_navigation", text, self._place(raw.offset))
        if by_packet:
            latitude = longitude = NAN
        elif latitude == longitude == 0.0:
            self.counters["reader.zero_position"] += 1
            text = "a ping has heading or altitude but no position (0, 0); the position is taken as unknown"
            self._raise_notice_once("reader.zero_position", text, self._place(raw.offset))
            latitude = longitude = NAN
        elif abs(latitude) > 90.0 or abs(longitude) > 360.0:
            self.counters["reader.impossible_position"] += 1
            text = (
                f"impossible position {latitude}, {longitude}; taken as unknown. If these are metres of a projection, "
                "set navigation.epsg"
            )
            self._raise_notice_once("reader.impossible_position", text, self._place(raw.offset))
            latitude = longitude = NAN
        elif not -180.0 <= longitude < 180.0:
            longitude = (longitude + 180.0) % 360.0 - 180.0
        if habits.wanted.heading and "heading" in self._packets.kinds:
            heading = NAN
            values = (*values[:2], NAN, *values[3:])
        last = self._last_navigation
        self._last_navigation = (latitude, longitude, *values[2:])
        if last and _all_alike(last, self._last_navigation):
            self.counters["reader.repeated_navigation"] += 1
            return None
        if last and latitude == last[0] and longitude == last[1]:
            latitude = longitude = NAN
        if math.isnan(latitude) or math.isnan(longitude):
            latitude = longitude = NAN  # half a position is none
        return NavSample(
            time_s=time_s,
            latitude_deg=latitude,
            longitude_deg=longitude,
            heading_rad=math.radians(heading),
            pitch_rad=math.radians(pitch),
            roll_rad=math.radians(roll),
            depth_m=depth,
            altitude_m=altitude,
            speed_mps=speed * KNOT_MPS,
        )

    def _place_deg(self, x: float, y: float) -> tuple[float, float]:
        """Convert stored coordinates, as far as they are metres, to latitude and longitude."""
        if self._project is None or (x, y) == (0.0, 0.0) or not math.isfinite(x + y):
            return y, x
        is_degrees = self._file_header.NavUnits == LATITUDE_LONGITUDE and abs(x) <= 360.0 and abs(y) <= 90.0
        return (y, x) if is_degrees else self._project(x, y)

    def _header_place(self, raw: _RawPing, time_s: float, habits: _Habits, heading_deg: float) -> tuple[float, float]:
        """Find the latitude and longitude of a ping's header: the sensor's, or the ship's where that stands still."""
        h = raw.header
        if habits.ship_position:
            ship = self._place_deg(h.ShipXcoordinate, h.ShipYcoordinate)
            return behind(ship, h.Layback, h.ShipGyro or heading_deg) if 0.0 < h.Layback < _MAX_LAYBACK_M else ship
        sensor = self._place_deg(h.SensorXcoordinate, h.SensorYcoordinate)
        if h.ShipYcoordinate == h.ShipXcoordinate == 0.0:
            return sensor
        ship = self._place_deg(h.ShipXcoordinate, h.ShipYcoordinate)
        place = self._watch.look(time_s, sensor, ship, heading_deg)
        if self._watch.is_still:
            self.counters["reader.sensor_position_still"] += 1
            self._raise_notice_once(
                "reader.sensor_position_still",
                "the sensor's position stands still while the ship's moves: the ship's is used, with the sensor where "
                "it last was from it. For a towed sonar set sonar.lever_arm_m if it never was known; check the "
                "positioning of the sensor",
                self._place(raw.offset),
            )
        return place

    def _ping(self, raw: _RawPing, time_s: float, number: int, habits: _Habits) -> Ping:
        place = self._place(raw.offset)
        logged = self._sound_speed(_number(raw.header.SoundVelocity), place)
        speed = self._sonar.sound_speed_mps or logged
        if speed != logged:
            self._raise_notice_once(
                "reader.sound_speed_overridden",
                f"sonar.sound_speed_mps {speed:g} replaces the log's {logged:g} m/s; slant ranges are scaled by "
                f"{speed / logged:.4f}",
                place,
            )
        altitude = _number(raw.header.SensorPrimaryAltitude)
        self.counters["reader.pings"] += 1
        return Ping(
            number=number,
            time_s=time_s,
            port=self._echo("port", raw.port, speed, logged, habits.port_far_to_near, place),
            starboard=self._echo("starboard", raw.starboard, speed, logged, habits.starboard_far_to_near, place),
            sound_speed_mps=speed,
            altitude_m=altitude if altitude > 0.0 else NAN,
            place=f"{place}, ping {number}",
        )

    def _echo(
        self, side: str, trace: _Trace | None, speed: float, logged: float, turned: bool, place: str
    ) -> EchoTrace | None:
        if trace is None:
            return None
        samples = trace.samples
        form = (samples.shape[0], samples.dtype)
        known = self._n_samples.setdefault(side, form)
        if form != known:
            self._n_samples[side] = form
            what = "sample_type" if form[1] != known[1] else "sample_count"
            self.counters[f"reader.{what}_change"] += 1
            self._raise_notice_once(
                f"reader.{what}_change",
                f"{side} changes from {known[0]} samples of {known[1].str} to {form[0]} of {form[1].str}; later "
                "changes are counted",
                place,
            )
        reference = self._reference_weight.setdefault(side, trace.weight)
        if trace.weight != reference:
            # A sample's value is stored * 2^-weight; only a change against the first ping matters, absolute gain does
            # not.
            samples = np.ldexp(samples.astype(np.float32), max(-60, min(60, reference - trace.weight)))
            self.counters["reader.weight_change"] += 1
            self._raise_notice_once(
                "reader.weight_change",
                f"{side} changes its weight factor; samples are scaled to the first ping's",
                place,
            )
        if samples.dtype.kind == "f" and not np.all(np.isfinite(samples)):
            self.counters["reader.sample_not_finite"] += 1
            self._raise_notice_once(
                "reader.sample_not_finite",
                f"{side} holds samples that are NaN or infinite; they are delivered as such",
                place,
            )
        spacing = trace.range_m * speed / logged / samples.shape[0]
        delay = trace.delay_s if 0.0 < trace.delay_s < 10.0 else 0.0
        if delay:
            self._raise_notice_once(
                "reader.time_delay",
                f"{side} was recorded from {delay:g} s after the transmission on; its ranges start "
                f"{delay * speed / 2:.2f} m out",
                place,
            )
        return EchoTrace(
            samples=np.ascontiguousarray(samples[::-1]) if turned else samples,
            first_range_m=delay * speed / 2.0 + 0.5 * spacing,
            spacing_m=spacing,
        )

    def _sound_speed(self, stored: float, place: str) -> float:
        speed = stored if 1400.0 <= stored <= 1600.0 else 2.0 * stored
        if 1400.0 <= speed <= 1600.0:
            return speed
        self.counters["reader.sound_speed_absurd"] += 1
        text = f"sound velocity {stored:g} m/s is absurd; 1500 is used. Set sonar.sound_speed_mps if you know it"
        self._raise_notice_once("reader.sound_speed_absurd", text, place)
        return 1500.0

    # --- notices ---

    def _place(self, offset: int) -> str:
        return f"{self._path.name}, byte {offset}"

    def _raise_notice(self, code: str, text: str, place: str, *, for_the_record: bool = False) -> None:
        remark = for_the_record or code in _MENDED
        self._notices.append(Notice(code=code, text=text, place=place, for_the_record=remark))

    def _raise_notice_once(self, code: str, text: str, place: str) -> None:
        if code not in self._raised:
            self._raised.add(code)
            self._raise_notice(code, text, place)

    def _raise_damage_notice(self, damage: DamagedBytes) -> None:
        self.counters["reader.damaged_packet"] += 1
        self.counters["reader.damaged_bytes"] += damage.n_bytes
        n_damaged = self.counters["reader.damaged_packet"]
        if n_damaged > _MAX_DAMAGE_NOTICES:
            return
        outcome = "everything before it is used" if damage.at_end else "reading goes on after it"
        more = "; further damage is only counted" if n_damaged == _MAX_DAMAGE_NOTICES else ""
        self._raise_notice(
            "reader.damaged_packet",
            f"{damage.what}; {damage.n_bytes} bytes are left out, {outcome}{more}",
            self._place(damage.offset),
        )

    def _raise_joined_notice(self, file: BinaryIO, item: FileHeader) -> None:
        self.counters["reader.joined_log"] += 1
        place = self._place(item.offset)
        try:
            self._use_header(file, item.data, item.offset)
            self._raise_notice_once(
                "reader.joined_log",
                "another file header starts here: logs were joined; its channels hold from here on",
                place,
            )
        except (BadInputError, UsageError) as error:
            self._channels, self._port_number, self._starboard_number = [], -1, -1
            self._raise_notice_once("reader.joined_log_unusable", f"{error} Its pings are skipped", place)

    def _raise_other_channels_notice(self, data: bytes) -> None:
        self._notices += pair_notices(self._pair, self._packing, self._sonar.subsystem, self._place(0))
        if others := self._pair.others:
            self._raise_notice(
                "reader.other_channel",
                f"channels {self._port_number} and {self._starboard_number} are used; "
                f"further side-scan channels are left out and counted: {name_channels(others)}",
                self._place(0),
            )
        header = self._file_header
        offsets = [
            f"channel {c.number} offset {info.OffsetX:g}, {info.OffsetY:g}, {info.OffsetZ:g} m"
            for c in self._channels
            if c.number in (self._port_number, self._starboard_number)
            for info in (header_channel(header, data, c.number),)
            if info.OffsetX or info.OffsetY or info.OffsetZ
        ]
        if header.NavigationLatency:
            offsets.append(f"navigation latency {header.NavigationLatency} ms")
        if offsets:
            self._raise_notice(
                "reader.mounting_not_applied",
                f"the log states {'; '.join(offsets)}. It is not known whether positions include it: "
                "nothing is applied, set sonar.lever_arm_m if needed",
                self._place(0),
            )

    def _raise_total_notices(self) -> None:
        place = self._path.name
        tied, stuck, backwards = (
            self.counters[f"reader.{name}"] for name in ("time_tied", "clock_stuck", "time_backwards")
        )
        if tied:
            text = f"{tied} pings shared a time stamp with the one before; they are spread evenly"
            self._raise_notice("reader.time_tied", text, place)
        if stuck:
            text = f"the clock stood still for {stuck} pings; they are timed by their interval"
            self._raise_notice("reader.clock_stuck", text, place)
        if backwards:
            self._raise_notice(
                "reader.time_backwards", f"time went backwards {backwards} times; check the recorder's clock", place
            )


class _Change(NamedTuple):
    """Hold what is done to every ping. signed: sides of which magnitudes are used. splits: a trace is both sides."""

    signed: frozenset[str]
    splits: bool

    def apply(self, raw: _RawPing) -> _RawPing:
        """Return the ping with what is done to it."""
        if raw.port is not None and "port" in self.signed:
            raw = raw._replace(port=raw.port._replace(samples=magnitude(raw.port.samples)))
        if raw.starboard is not None and "starboard" in self.signed:
            raw = raw._replace(starboard=raw.starboard._replace(samples=magnitude(raw.starboard.samples)))
        only = raw.port or raw.starboard
        if not self.splits or only is None or (raw.port is not None and raw.starboard is not None):
            return raw
        port, starboard = halves(only.samples)
        return raw._replace(port=only._replace(samples=port), starboard=only._replace(samples=starboard))


class _NoSideScanError(BadInputError):
    """Signal a file without side-scan channels: the caller completes the message with what the file holds instead."""


def _channel_head(header: _ChannelHeader) -> ChannelHead:
    return ChannelHead(header.ChannelNumber, header.NumSamples, float(header.Frequency))


def _packet_head(data: bytes, headers: list[_ChannelHeader]) -> PacketHead:
    clock = _PingTime._make(_TIME_FIELDS.unpack_from(data))
    of_day_s = 3600.0 * clock.Hour + 60.0 * clock.Minute + clock.Second + 0.01 * clock.HSeconds
    (ping_number,) = _PING_NUMBER.unpack_from(data)
    return PacketHead(ping_number, of_day_s, tuple(map(_channel_head, headers)))


def _all_alike(values: tuple[float, ...], others: tuple[float, ...]) -> bool:
    """Compare numbers of which NaN equals NaN."""
    return values == others or all(a == b or (a != a and b != b) for a, b in zip(values, others, strict=True))


def _number(value: float) -> float:
    """Return the number if finite, else NaN."""
    return value if math.isfinite(value) else NAN


def _utc_seconds(clock: _PingTime) -> float | None:
    return utc_seconds(
        clock.Year, clock.Month, clock.Day, (clock.Hour, clock.Minute, clock.Second), 0.01 * clock.HSeconds
    )


def _interval_s(probe: list[_RawPing]) -> float:
    """Find the time between pings without a clock: as logged, else by way and speed, else by the range."""
    logged = [raw.interval_s for raw in probe if 0.0 < raw.interval_s <= _MAX_INTERVAL_S]
    if logged:
        return float(np.median(logged))
    first, last = probe[0].header, probe[-1].header
    speed_mps = KNOT_MPS * float(np.median([raw.header.SensorSpeed or raw.header.ShipSpeed for raw in probe]))
    ends = ((first.SensorYcoordinate, first.SensorXcoordinate), (last.SensorYcoordinate, last.SensorXcoordinate))
    way_m = math.hypot(*offset_m(*ends)) if all(abs(y) <= 90.0 and abs(x) <= 360.0 for y, x in ends) else 0.0
    if len(probe) > 1 and speed_mps > 0.0 and 0.0 < way_m / speed_mps / (len(probe) - 1) <= _MAX_INTERVAL_S:
        return way_m / speed_mps / (len(probe) - 1)
    ranges_m = [trace.range_m for raw in probe for trace in (raw.port, raw.starboard) if trace is not None]
    return 2.0 * max(ranges_m) / _NOMINAL_SOUND_SPEED_MPS


def _reversed(trace: _Trace | None) -> _Trace | None:
    return None if trace is None else trace._replace(samples=trace.samples[::-1])


def _probe_port_order(probe: list[_RawPing], blank_m: float) -> PortOrderEvidence | None:
    """Return evidence from the probed pings of the commonest port form; None without a port channel."""
    forms = Counter((raw.port.samples.shape[0], raw.port.range_m) for raw in probe if raw.port is not None)
    if not forms:
        return None
    n_samples, range_m = forms.most_common(1)[0][0]
    chosen = [
        raw
        for raw in probe
        if raw.port is not None and (raw.port.samples.shape[0], raw.port.range_m) == (n_samples, range_m)
    ]
    port = np.stack([raw.port.samples for raw in chosen if raw.port is not None])
    others = [
        raw.starboard.samples
        for raw in chosen
        if raw.starboard is not None and raw.starboard.samples.shape[0] == n_samples
    ]
    starboard = np.stack(others) if others else None
    return port_order_evidence(
        np.nan_to_num(port), None if starboard is None else np.nan_to_num(starboard), range_m / n_samples, blank_m
    )
