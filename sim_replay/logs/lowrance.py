"""Read Lowrance and Simrad logs (.sl2, .sl3): frames of sonar channels, with the position and course of the boat.

Layouts are those of opensounder's "sounder-log-formats" (format 2 and 3), held against SL3Reader (Halmai et al., ISPRS
Int. J. Geo-Inf. 9 (2020) 149) and sonarlight; no recording was at hand. A composite frame (channel 5) holds both sides,
from far port to far starboard, at limits of range below and above 0; channels 3 and 4 hold one each. Ranges and depths
are feet, speeds knots, angles radians, positions metres of a spherical Mercator projection. Flags of validity are left
out, as their descriptions contradict each other, and so is the magnetic heading: the course over ground is used. Frames
of SL3 whose version is 13 have a longer header (SL3Reader).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from struct import Struct
from typing import Any, Final, NamedTuple

import numpy as np

from auv_mcm.records import EchoTrace, NavSample
from auv_mcm.safe_files import open_regular
from auv_mcm.settings.config import Config
from drivers.framing import Framed
from sim_replay.logs.log_reader import CERTAIN, Log
from sim_replay.logs.sounding_log import (
    Decode,
    Layout,
    Sounding,
    SoundingLog,
    messages_of,
    place_of,
    stamp_of,
    trace_of,
)
from sim_replay.logs.xtf_fields import KNOT_MPS, number_or_nan
from sim_replay.logs.xtf_report import LogReport

_FILE_HEADER: Final = Struct("<HHH")  # format, version, bytes of a block; two bytes of 0 follow
_HEADER_BYTES: Final = 8  # of the file, where the first frame begins
_BLOCKS: Final = (1970, 3200)  # bytes of a block: down scan, side scan
_LEFT, _RIGHT, _BOTH = 3, 4, 5  # channels of side scan
_MAX_CHANNEL: Final = 15  # 9, 10 and 11 are 3D and test channels
_FOOT_M: Final = 0.3048  # m per foot
_POLAR_RADIUS_M: Final = 6_356_752.3142  # m, of the sphere of the projection (WGS 84's minor semi-axis)
_MAX_FRAME_BYTES: Final = 0xFFFF  # what the length of a frame can state
_FIRST_S: Final = 946_684_800  # 2000-01-01, s since 1970: before it a clock was never set
_NO_TIME: Final = 0xFFFF_FFFF  # of a recorder that has not heard satellites
_PROBED: Final = 64  # frames in which the time of the beginning is looked for (chosen)
_LOOK_BYTES: Final = 1 << 20  # in a log without its header, frames are looked for this far
_KHZ: Final = (200.0, 50.0, 83.0, 455.0, 800.0, 38.0, 28.0)  # by the code of SL3; those of SL2 are disputed
_LONGER_VERSION, _MORE_BYTES = 13, 12  # of SL3's frames: their header has as many more than that of version 10
_NO_NAVIGATION: Final = "its frames have none. Record with a satellite receiver in use."


class _Version(NamedTuple):
    """Describe the header of a frame: its fields in order, and where the channel stands."""

    header: Struct
    names: tuple[str, ...]
    channel_at: int

    def fields(self, buffer: bytes | bytearray, at: int) -> dict[str, Any]:
        """Read the header of a frame."""
        return dict(zip(self.names, self.header.unpack_from(buffer, at), strict=True))

    def samples_at(self, frame: dict[str, Any]) -> int:
        """Find where the samples of a frame begin in it."""
        return self.header.size + (_MORE_BYTES if frame.get("version") == _LONGER_VERSION else 0)

    def layout(self) -> Layout:
        """Return how frames follow each other."""

        def begins(buffer: bytes | bytearray, at: int, position: int) -> bool:
            frame = self.fields(buffer, at)
            whole = frame["packet"] + self.samples_at(frame) == frame["size"] or frame["offset"] == position
            return bool(whole and frame["size"] >= self.header.size and frame["channel"] <= _MAX_CHANNEL)

        def length(buffer: bytes | bytearray, at: int) -> int:
            return int(self.fields(buffer, at)["size"])

        first = re.compile(rb"(?!\0\0).{4}[\0-\x0f]\0", re.DOTALL)  # a length, another, and the channel
        return Layout("lowrance", first, self.channel_at - 4, self.header.size, _MAX_FRAME_BYTES, begins, length)


_LIMITS: Final = ("first_ft", "last_ft", "start_s")
_TAIL: Final = ("speed_kn", "x", "y", "course_rad", "time_ms")
_VERSIONS: Final = {
    2: _Version(
        Struct("<I24xH2xHH4xff12xIf32xf4xii4xf16xI"),
        ("offset", "size", "channel", "packet", *_LIMITS, "depth_ft", *_TAIL),
        32,
    ),
    3: _Version(
        Struct("<IIH2xH6xff12xIIfB31xf4xii4xf16xI40x"),
        ("offset", "version", "size", "channel", *_LIMITS, "packet", "depth_ft", "frequency", *_TAIL),
        12,
    ),
}
"""By the number in the file's header."""


def recognise(head: bytes) -> int:
    """Weigh what speaks for the format in a file's first bytes: its header, else frames that state their own place."""
    if _stated_version(head):
        return CERTAIN
    return max(len(_frames_in_place(head, version)) for version in _VERSIONS.values())


def _stated_version(head: bytes) -> int:
    if len(head) < _HEADER_BYTES:
        return 0
    number, version, block = _FILE_HEADER.unpack_from(head)
    return int(number) if number in _VERSIONS and version <= 2 and block in _BLOCKS else 0


def _frames_in_place(head: bytes, version: _Version) -> list[int]:
    """List places of frames whose first number is that place."""
    places: list[int] = []
    begins, last = version.layout().begins, len(head) - version.header.size
    for first in range(4 if last >= _HEADER_BYTES else 0):
        numbers = np.frombuffer(head, "<u4", (len(head) - first) // 4, first)
        places += (np.flatnonzero(numbers == np.arange(numbers.size) * 4 + first) * 4 + first).tolist()
    return [at for at in places if _HEADER_BYTES <= at <= last and begins(head, at, at)]


def open_file(path: Path, config: Config, chunk_bytes: int) -> Log:
    """Open a log. Raises BadInputError for one that cannot be read."""
    with open_regular(path) as file:
        head = file.read(_LOOK_BYTES)
    stated = _stated_version(head)
    number = stated or max(_VERSIONS, key=lambda one: len(_frames_in_place(head, _VERSIONS[one])))
    version = _VERSIONS[number]
    file_of = messages_of(version.layout(), path, chunk_bytes, _HEADER_BYTES if stated else 0)
    start_s, khz = 0, 0.0
    for framed in islice(file_of, _PROBED):
        frame = version.fields(framed.message, 0)
        if not start_s and _FIRST_S <= frame["start_s"] < _NO_TIME:
            start_s = frame["start_s"]
        if frame["channel"] in (_LEFT, _RIGHT, _BOTH) and frame.get("frequency", len(_KHZ)) < len(_KHZ):
            khz = khz or _KHZ[frame["frequency"]]
    decoder = _decoder(version, start_s, path)
    return SoundingLog(path, [file_of], decoder, config.sonar, _NO_NAVIGATION, (khz,) if khz else (), khz)


def _decoder(version: _Version, start_s: int, path: Path) -> Callable[[LogReport], Decode]:
    def decoder(report: LogReport) -> Decode:
        if not start_s:
            text = "no frame has the time of the beginning: times count from 1970, and contacts carry them"
            report.notify("reader.time_unknown", text, path.name)

        def decode(framed: Framed[bytes], place: str) -> Iterator[Sounding]:
            frame = version.fields(framed.message, 0)
            if frame["channel"] not in (_LEFT, _RIGHT, _BOTH):
                report.counters[f"reader.not_used.channel_{frame['channel']}"] += 1
                return
            port, starboard = _sides(frame, framed.message, version.samples_at(frame), report)
            if port is None and starboard is None:
                return
            yield Sounding(
                stamp_of(start_s + 1e-3 * frame["time_ms"]), place, port, starboard, _navigation(frame, report)
            )

        return decode

    return decoder


def _sides(
    frame: dict[str, Any], message: bytes, first: int, report: LogReport
) -> tuple[EchoTrace | None, EchoTrace | None]:
    samples = np.frombuffer(message[first : first + frame["packet"]], np.uint8)
    first_m, last_m = _FOOT_M * frame["first_ft"], _FOOT_M * frame["last_ft"]
    if frame["channel"] != _BOTH:
        trace = trace_of(samples, first_m, last_m, report)
        return (trace, None) if frame["channel"] == _LEFT else (None, trace)
    if not first_m < 0.0:  # as large to port
        first_m = -last_m
    if not (math.isfinite(first_m + last_m) and last_m > 0.0):
        report.counters["reader.ping_empty"] += 1
        return None, None
    n_port = round(samples.size * -first_m / (last_m - first_m))
    port = trace_of(np.ascontiguousarray(samples[:n_port][::-1]), 0.0, -first_m, report)
    return port, trace_of(samples[n_port:], 0.0, last_m, report)


def _navigation(frame: dict[str, Any], report: LogReport) -> NavSample:
    latitude_deg, longitude_deg = place_of(*_degrees(frame["x"], frame["y"]), report)
    course_rad, altitude_m = number_or_nan(frame["course_rad"]), _FOOT_M * number_or_nan(frame["depth_ft"])
    return NavSample(
        time_s=0.0,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        heading_rad=course_rad % math.tau,
        altitude_m=altitude_m,
        speed_mps=KNOT_MPS * number_or_nan(frame["speed_kn"]),
    )


def _degrees(x_m: int, y_m: int) -> tuple[float, float]:
    """Compute latitude and longitude, degrees."""
    latitude_rad = 2.0 * math.atan(math.exp(y_m / _POLAR_RADIUS_M)) - 0.5 * math.pi
    return math.degrees(latitude_rad), math.degrees(x_m / _POLAR_RADIUS_M)
