"""Read XTF side-scan logs as a stream of navigation samples, pings and notices.

Layouts are pyxtf's; its reading loop is not used, because it loads a pickled index it finds beside the log, stops at
the first damaged packet and never ends on a packet of length zero. Conventions of the format (Triton Imaging, "eXtended
Triton Format", rev. 42): header times are UTC with 10 ms resolution; pitch is positive bow up, roll positive starboard
down, headings are degrees true; speed is in knots; a stored slant range is the far end of the last sample.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path
from typing import BinaryIO

from auv_mcm.errors import BadInputError
from auv_mcm.records import Ping, SourceEvent
from auv_mcm.safe_files import open_regular
from auv_mcm.settings.config import SonarConfig
from sim_replay.logs.ping_clock import spread_ties
from sim_replay.logs.xtf_clock import timed
from sim_replay.logs.xtf_header import LATITUDE_LONGITUDE, kind_name, name_channels
from sim_replay.logs.xtf_layout import PROBE_PINGS, Layout, NoSideScanError, learn_layout, raise_notices
from sim_replay.logs.xtf_navigation import Place, are_degrees, is_nowhere, projection
from sim_replay.logs.xtf_packets import FILE_FORMAT, HEADER_BLOCK, FileHeader, XtfPacket, header_bytes, read_packets
from sim_replay.logs.xtf_pings import PingReader, RawPing, read_ahead
from sim_replay.logs.xtf_probe import learn_change, learn_fields, learn_orders
from sim_replay.logs.xtf_records import Echoes, HeaderNavigation
from sim_replay.logs.xtf_report import LogReport


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
        self, path: str | os.PathLike[str], sonar: SonarConfig, *, epsg: int | None = None, chunk_bytes: int = 1 << 18
    ) -> None:
        """Open and check the file header. `chunk_bytes` sizes the read buffer and nothing else.

        epsg: of the projection of positions in metres; None for degrees.

        Raises BadInputError for anything but an XTF file with side-scan channels in slant range and geographic
        coordinates, UsageError for an `epsg` that cannot be used.
        """
        self._path = Path(path)
        self._sonar = sonar
        self._chunk_bytes = max(chunk_bytes, 2)  # 1 would ask for line buffering
        self._report = LogReport(self._path)
        self._project: Place | None = None if epsg is None else projection(epsg)
        self._units_by_value = False  # degrees, although the header says metres
        self._layouts: dict[int, Layout] = {}  # by the offset of their file headers
        self.bytes_read = 0
        with self._open() as file:
            self.size_bytes = os.fstat(file.fileno()).st_size
            self._first_packet, header = self._read_file_header(file)
            try:
                self._layout = self._learn(file, FileHeader(0, header))
            except NoSideScanError as error:
                raise BadInputError(
                    f"{error} It holds {self._inventory(file)}. Give a log recorded with side scan switched on."
                ) from error
            self._check_units(file)

    @property
    def counters(self) -> Counter[str]:
        """Return what was counted so far."""
        return self._report.counters

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
        return name_channels(self._layout.channels)

    @property
    def frequencies_khz(self) -> tuple[float, ...]:
        """Return all frequencies of side scan, ascending."""
        return self._layout.pair.frequencies_khz

    @property
    def frequency_khz(self) -> float:
        """Return the frequency in use, 0 where the log states none."""
        return self._layout.pair.used_khz

    def first_time_s(self) -> float:
        """Find the time of the first ping, s since 1970. Raises BadInputError if there is none."""
        return next(
            (event.time_s for event in self if isinstance(event, Ping) and math.isfinite(event.time_s)), math.inf
        )

    def __iter__(self) -> Iterator[SourceEvent]:
        """Iterate. Raises BadInputError if there is no usable ping at all."""
        report = self._report
        report.clear()
        self.bytes_read = 0
        with self._open() as file:
            raise_notices(self._layout, self._sonar, report)
            reader = PingReader(self._first_packet, self._layout, self._learn, report)
            raw_pings = timed(reader.read(file, self.size_bytes), report)
            probe = list(islice(raw_pings, PROBE_PINGS))
            if not probe:
                raise BadInputError(self._no_ping_text())
            change = learn_change(probe, reader.layout, self._sonar.blank_m, report)
            probe, raw_pings = [change.apply(raw) for raw in probe], map(change.apply, raw_pings)

            def place_deg(x: float, y: float) -> tuple[float, float]:
                return self._place_deg(reader.layout, x, y)

            by_value = reader.layout.is_in_metres and self._project is None
            nav_units = reader.layout.header.NavUnits if by_value else None
            fields = learn_fields(probe, reader.packets.kinds, nav_units, report)
            pings: Iterator[RawPing] = chain(probe, raw_pings)
            if any(fields.wanted) and reader.packets.kinds:
                pings = read_ahead(pings)
            navigation = HeaderNavigation(fields, reader.packets, place_deg, report)
            echoes = Echoes(learn_orders(probe, self._sonar, report), self._sonar.sound_speed_mps, report)
            for number, (time_s, raw) in enumerate(spread_ties(pings, report.counters)):
                self.bytes_read = reader.bytes_read
                yield from report.take()
                yield from reader.packets.until(time_s, raw.offset, fields.wanted, place_deg, report)
                sample = navigation.sample(raw, time_s)
                if sample is not None:
                    yield sample
                ping = echoes.ping(raw, time_s, number)
                yield from report.take()
                yield ping
            self.bytes_read = self.size_bytes
            report.finish()
            yield from report.take()

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

    def _learn(self, file: BinaryIO, header: FileHeader) -> Layout:
        """Learn what a file header of the log describes. Raises BadInputError or UsageError."""
        layout = self._layouts.get(header.offset)
        if layout is None:
            layout = learn_layout(file, header.data, header.offset, str(self._path), self._sonar.subsystem)
            self._layouts[header.offset] = layout
        is_unknown = layout.is_in_metres and self._project is None and not self._units_by_value
        if header.offset > 0 and is_unknown:
            place = f"{self._path} (file header at byte {header.offset})"
            raise BadInputError(f"{place}: {self._metres_text(layout)}")
        return layout

    def _metres_text(self, layout: Layout) -> str:
        return (
            f"positions are projected coordinates in metres (NavUnits {layout.header.NavUnits}) and the "
            "projection is not given. Set navigation.epsg to its EPSG code (32632 for UTM zone 32 north), or export "
            "the log with latitude and longitude (NavUnits 3)."
        )

    def _check_units(self, file: BinaryIO) -> None:
        """Find whether positions that are said to be metres are degrees. Raises BadInputError where they are not."""
        if not self._layout.is_in_metres or self._project is not None:
            return
        reader = PingReader(self._first_packet, self._layout, self._learn, self._report)
        positions: list[tuple[float, float, float]] = []
        for number, raw in enumerate(islice(reader.read(file, self.size_bytes), PROBE_PINGS)):
            header, time_s = raw.header, raw.time_s if math.isfinite(raw.time_s) else float(number)
            sensor = header.SensorXcoordinate, header.SensorYcoordinate
            ship = header.ShipXcoordinate, header.ShipYcoordinate
            positions.append((time_s, *(ship if is_nowhere(sensor) else sensor)))
        positions += [
            (packet.time_s if math.isfinite(packet.time_s) else float(number), packet.x, packet.y)
            for number, packet in enumerate(reader.packets.positions)
        ]
        known = [position for position in positions if not is_nowhere(position[1:])]
        if known and not are_degrees(known):
            raise BadInputError(f"{self._path}: {self._metres_text(self._layout)}")
        self._units_by_value = True

    def _place_deg(self, layout: Layout, x: float, y: float) -> tuple[float, float]:
        """Convert stored coordinates, as far as they are metres, to latitude and longitude."""
        if self._project is None or (x, y) == (0.0, 0.0) or not math.isfinite(x + y):
            return y, x
        is_degrees = layout.header.NavUnits == LATITUDE_LONGITUDE and abs(x) <= 360.0 and abs(y) <= 90.0
        return (y, x) if is_degrees else self._project(x, y)

    def _inventory(self, file: BinaryIO) -> str:
        kinds: Counter[str] = Counter()
        for item in read_packets(file, self._first_packet, self.size_bytes, ()):
            if isinstance(item, XtfPacket):
                kinds[kind_name(item.kind)] += 1
        return ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items())) + " packets" if kinds else "no packets"

    def _no_ping_text(self) -> str:
        seen = ", ".join(f"{name} {n}" for name, n in sorted(self.counters.items())) or "no packets"
        remedy = "Check that the recording was not stopped at once."
        if self.counters["reader.ping_empty"]:
            remedy = (
                "Its pings have no samples, or neither a slant range nor a duration. Export the log again with one of "
                "them."
            )
        return f"{self._path} has side-scan channels but no usable side-scan ping ({seen}). {remedy}"
