"""Read Humminbird recordings: a .DAT file and the folder of .SON files beside it, one per sonar channel.

Layouts are those of PINGMapper's "Binary Structure" page, held against PINGVerter and PyHum; no recording was at hand.
B002.SON is port, B003.SON starboard. A record begins with C0 DE AB 21; tags follow, each with its number, big-endian,
up to the count of samples (A0) and 21, then samples of 8 bits, near to far. The index (.IDX) is not needed. Where the
page says centimetres for depth and speed, both readers divide by 10, and so does this one.

No range is recorded: as in both readers a sample is taken as long as the beam of a transducer of 108 mm is narrow at
455 kHz, 2 / pi of a wavelength over its length, m. Positions are metres of a Mercator projection on the International
Spheroid of 1924, with the latitude stretched by the square of its axes' ratio.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Final, Literal

import numpy as np

from auv_mcm.errors import BadInputError
from auv_mcm.records import NAN, NavSample
from auv_mcm.safe_files import open_regular, read_regular
from auv_mcm.settings.config import Config
from drivers.framing import Framed
from sim_replay.logs.log_reader import CERTAIN, Log
from sim_replay.logs.sounding_log import (
    USUAL_SOUND_SPEED_MPS,
    Decode,
    Layout,
    Sounding,
    SoundingLog,
    messages_of,
    n_messages,
    place_of,
    stamp_of,
    trace_of,
)
from sim_replay.logs.xtf_report import LogReport

_SIDES: Final = "[Bb]00[23].[Ss][Oo][Nn]"  # names of files of side scan
_DAT_NAMES: Final = "*.[Dd][Aa][Tt]"
_MARK: Final = b"\xc0\xde\xab\x21"
_DATS: Final[dict[int, tuple[Literal["big", "little"], tuple[bytes, ...]]]] = {
    64: ("big", (b"\xc1",)),
    96: ("little", (b"\xc3", b"\xc4")),
    100: ("little", (b"\xc3", b"\xc4")),
}
"""By length in bytes: the order of bytes, and the first ones known."""
_ONIX: Final = b"<NumberOfPings="  # in the text of a recording without a date
_MAX_DAT_BYTES: Final = 1 << 16  # of the longest, which holds text (chosen)
_START_AT: Final = 20  # byte of the beginning, s since 1970
_HEAD_BYTES: Final = 16  # of a record, up to its second tag
_MAX_HEAD_BYTES: Final = 200  # of a record's tags: the longest known are 152 (chosen)
_MAX_SAMPLES: Final = 1 << 16  # of a ping: ten times what is known (chosen)
_COUNT, _END = 0xA0, 0x21  # tags of the number of samples, and of the end of a record's tags
_TIME, _EAST, _NORTH, _HEADING, _SPEED, _DEPTH, _BEAM, _HZ = 0x81, 0x82, 0x83, 0x84, 0x85, 0x87, 0x50, 0x92
_PORT, _STARBOARD = 2, 3  # beams
_TENTH: Final = 0.1  # of a degree, m or m/s in a unit of heading, depth and speed
_LENGTH_M, _FREQUENCY_HZ = 0.108, 455e3  # of the transducer that spacing is taken from (PINGMapper)
_RADIUS_M: Final = 6_378_388.0  # m, semi-major axis of the International Spheroid of 1924
_STRETCH: Final = 1.0067642927  # of the tangent of latitude: its semi-major over its semi-minor axis, squared
_PROBED: Final = 64  # records in which frequencies are looked for (chosen)
_NO_NAVIGATION: Final = "its records have none (tags 82 and 83). Record with a satellite receiver in use."


def recognise(head: bytes) -> int:
    """Weigh what speaks for the format in a file's first bytes: a whole .DAT file, or records."""
    order = _DATS.get(len(head))
    if (order is not None and head.startswith(order[1])) or (head[:1] == b"\xc1" and _ONIX in head[:_MAX_DAT_BYTES]):
        return CERTAIN
    return 2 * n_messages(_LAYOUT, head) or int(head.startswith(_MARK))


def open_file(path: Path, config: Config, chunk_bytes: int) -> Log:
    """Open a recording by its .DAT file, its folder or a .SON file in it.

    Raises BadInputError where the folder has no side scan, or a file cannot be read.
    """
    folder = path if path.is_dir() else path.parent if _is_record(path) else path.with_suffix("")
    names = sorted(folder.glob(_SIDES), key=lambda name: name.name.upper()) if folder.is_dir() else []
    if not names:
        raise BadInputError(
            f"{path} is a Humminbird recording without side scan: {folder} has no B002.SON (port) or B003.SON "
            "(starboard). Copy the folder of the recording beside its .DAT file, with all its files."
        )
    files = [messages_of(_LAYOUT, name, chunk_bytes) for name in names]
    start_s = _start_s(folder)
    heads = [_tags(framed.message, 0)[0] for file in files for framed in islice(file, _PROBED)]
    khz = tuple(
        sorted({1e-3 * tags[_HZ] for tags in heads if tags.get(_HZ) and tags.get(_BEAM) in (_PORT, _STARBOARD)})
    )

    def decoder(report: LogReport) -> Decode:
        return _decoder(start_s, path, report)

    return SoundingLog(path, files, decoder, config.sonar, _NO_NAVIGATION, khz, khz[-1] if khz else 0.0)


def _is_record(path: Path) -> bool:
    with open_regular(path) as file:
        return recognise(file.read(_MAX_DAT_BYTES)) < CERTAIN


def _start_s(folder: Path) -> int:
    """Find the time of the beginning in the .DAT file beside or in a folder; 0 without one."""
    home = folder.resolve()
    beside = [path for path in home.parent.glob(_DAT_NAMES) if path.stem == home.name]
    for path in [*beside, *sorted(home.glob(_DAT_NAMES))]:
        order, first = _DATS.get(path.stat().st_size, ("big", ())) if path.is_file() else ("big", ())
        if first and (data := read_regular(path, _MAX_DAT_BYTES)).startswith(first):
            return int.from_bytes(data[_START_AT : _START_AT + 4], order)
    return 0


def _tags(buffer: bytes | bytearray, at: int) -> tuple[dict[int, int], int]:
    """Read the tags of a record and find where its samples begin; 0 while its end is missing, -1 for a strange one."""
    tags: dict[int, int] = {}
    place = at + len(_MARK)
    while place < len(buffer):
        tag = buffer[place]
        if tag == _END and _COUNT in tags:
            return tags, place + 1
        if not (0x50 <= tag <= 0x57 or 0x80 <= tag <= _COUNT) or place - at > _MAX_HEAD_BYTES:
            return tags, -1
        stop = place + (2 if tag < 0x80 else 5)
        tags[tag] = int.from_bytes(buffer[place + 1 : stop], "big", signed=tag in (_EAST, _NORTH))
        place = stop
    return tags, 0


def _begins(buffer: bytes | bytearray, at: int, position: int) -> bool:
    return buffer[at : at + 4] == _MARK and buffer[at + 4] == 0x80


def _length(buffer: bytes | bytearray, at: int) -> int:
    tags, first = _tags(buffer, at)
    if not first:
        return len(buffer) - at + 1
    return first - at + tags[_COUNT] if first > 0 and tags[_COUNT] <= _MAX_SAMPLES else 0


_LAYOUT: Final = Layout(
    "humminbird", re.compile(re.escape(_MARK)), 0, _HEAD_BYTES, _MAX_HEAD_BYTES + _MAX_SAMPLES, _begins, _length
)


def _decoder(start_s: int, path: Path, report: LogReport) -> Decode:
    if not start_s:
        text = "no .DAT file has the time of the beginning: times count from 1970, and contacts carry them"
        report.notify("reader.time_unknown", text, path.name)
    wavelength_m = USUAL_SOUND_SPEED_MPS / _FREQUENCY_HZ
    spacing_m = math.asin(wavelength_m / _LENGTH_M) * 2.0 / math.pi
    text = (
        f"the recorder states no range: a sample is taken as {1e3 * spacing_m:.1f} mm. Compare depth and first return "
        "('auv-mcm info'); sonar.sound_speed_mps scales ranges"
    )
    report.notify("reader.range_assumed", text, path.name, for_the_record=True)

    def decode(framed: Framed[bytes], place: str) -> Iterator[Sounding]:
        tags, first = _tags(framed.message, 0)
        beam = tags.get(_BEAM, -1)
        if beam not in (_PORT, _STARBOARD):
            report.counters[f"reader.not_used.beam_{beam}"] += 1
            return
        samples = np.frombuffer(framed.message[first:], np.uint8)
        if (trace := trace_of(samples, 0.0, spacing_m * samples.size, report)) is None:
            return
        port, starboard = (trace, None) if beam == _PORT else (None, trace)
        time_s = start_s + 1e-3 * tags.get(_TIME, 0)
        yield Sounding(stamp_of(time_s), place, port, starboard, _navigation(tags, report))

    return decode


def _navigation(tags: dict[int, int], report: LogReport) -> NavSample:
    latitude_deg, longitude_deg = place_of(*_degrees(tags.get(_EAST, 0), tags.get(_NORTH, 0)), report)

    def tenths(tag: int) -> float:
        return _TENTH * (tags[tag] & 0xFFFF) if tag in tags else NAN  # a flag stands in the upper half

    heading_deg = tenths(_HEADING)
    return NavSample(
        time_s=0.0,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        heading_rad=math.radians(heading_deg) if heading_deg <= 360.0 else NAN,
        altitude_m=tenths(_DEPTH),
        speed_mps=tenths(_SPEED),
    )


def _degrees(east_m: int, north_m: int) -> tuple[float, float]:
    """Compute latitude and longitude, degrees."""
    on_sphere_rad = 2.0 * math.atan(math.exp(north_m / _RADIUS_M)) - 0.5 * math.pi
    return math.degrees(math.atan(_STRETCH * math.tan(on_sphere_rad))), math.degrees(east_m / _RADIUS_M)
