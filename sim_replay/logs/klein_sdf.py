"""Read Klein logs (.sdf): data pages of SonarPro, each with a header and a vector of samples per channel.

Layouts are those of Klein's "SDF/SDFX Data Page Definitions" (15300018) as public readers have them: Neptus for pages
3501 and 3502 (UUV-3500), SDFFiles of F. Le Bars for 5000, others for 3000, 3001, 5001 and 5004; no recording was at
hand. Pages 3000 and 3001 hold port and starboard of the low frequency, then of the high one; 3501 is
the low, 3502 the high frequency of a UUV-3500; 5000, 5001 and 5004 hold five beams to port and five to starboard, the
first the farthest ahead, which together fill the way to the next ping: they become lines of their own, in that order.
Other pages are counted and left out.

Positions are radians: the towed fish where it is given, else the ship. A UUV's attitude, depth and altitude are those
of its vehicle (the auxiliary fields); of a towed fish the depth is left out, as its unit is volts.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from struct import Struct
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import NAN, NavSample
from auv_mcm.settings.config import Config
from drivers.framing import Framed
from sim_replay.logs.log_reader import Log
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
from sim_replay.logs.xtf_fields import number_or_nan
from sim_replay.logs.xtf_report import LogReport

_MARK: Final = b"\xff\xff\xff\xff"
_HEAD: Final = Struct("<4xII")  # bytes of the page behind the mark, page version
_LAST_VERSION: Final = 6000  # page versions are numbers of sonars, from 1000 on
_HEADER_BYTES: Final = (256, 1024)  # of a page: the shortest that is known, and the longest taken (chosen)
_MAX_PAGE_BYTES: Final = 1 << 22  # with raw signals; eight times a page of the widest side scan (chosen)
_SPEEDS_MPS: Final = (1300.0, 1700.0)  # m/s: other sound speeds are no water's
_CENTI: Final = 0.01  # m/s in a unit of sound speed and of a fish's own speed; s in one of time
_MAX_BEAM_GAP_S: Final = 1.0  # s between pings, at most, that beams are spread over (chosen)
_N_BEAMS: Final = 5  # to a side
_PROBED: Final = 200  # pages in which frequencies are looked for (chosen)
_NO_NAVIGATION: Final = "neither the fish nor the ship has one in its pages. Record with the receiver connected."


class _Page(NamedTuple):
    """Describe a page's samples: types of one, of their number before them, channels of a side, and frequencies."""

    sample: str
    length: str
    n_beams: int = 1
    low: bool = False
    high: bool = False
    is_uuv: bool = False


_TOWED, _WIDE = _Page("<u2", "<u2", low=True, high=True), _Page("<u2", "<u2", n_beams=_N_BEAMS, high=True)
_PAGES: Final = {
    **dict.fromkeys((3000, 3001), _TOWED),
    3501: _Page("<u4", "<u4", low=True, is_uuv=True),
    3502: _Page("<u4", "<u4", high=True, is_uuv=True),
    **dict.fromkeys((5000, 5001, 5004), _WIDE),
}
_FIELDS: Final = (
    *(("number", 16, "I"), ("n_samples", 20, "I"), ("beams", 24, "I"), ("range_m", 32, "I"), ("fish_cmps", 36, "I")),
    *(("sound_cmps", 40, "I"), ("year", 72, "6I"), ("hundredths", 96, "I"), ("fish_deg", 112, "4f")),
    *(
        ("altitude_m", 128, "f"),
        ("speed_mps", 136, "f"),
        ("ship_deg", 140, "f"),
        ("ship", 148, "2d"),
        ("fish", 164, "2d"),
    ),
    *(("header_bytes", 184, "I"), ("aux", 200, "4f"), ("fraction_s", 220, "f"), ("laid_back", 300, "2d")),
    ("khz", 408, "I"),
)
"""Names, places behind the beginning of the mark, and types."""
_STRUCTS: Final = tuple((name, at, Struct("<" + form)) for name, at, form in _FIELDS)


def recognise(head: bytes) -> int:
    """Weigh what speaks for the format in a file's first bytes: data pages."""
    return 2 * n_messages(_LAYOUT, head) or int(
        len(head) >= _HEAD.size and head.startswith(_MARK) and _HEAD.unpack_from(head)[1] <= _LAST_VERSION
    )


def _begins(buffer: bytes | bytearray, at: int, position: int) -> bool:
    n_bytes, version = _HEAD.unpack_from(buffer, at)
    (n_header,) = Struct("<I").unpack_from(buffer, at + 184)
    return bool(
        buffer[at : at + 4] == _MARK
        and 1000 <= version <= _LAST_VERSION
        and _HEADER_BYTES[0] <= n_header <= min(_HEADER_BYTES[1], n_bytes)
    )


def _length(buffer: bytes | bytearray, at: int) -> int:
    return len(_MARK) + int(_HEAD.unpack_from(buffer, at)[0])


_LAYOUT: Final = Layout(
    "sdf",
    re.compile(_MARK + rb".{4}..\0\0", re.DOTALL),
    0,
    len(_MARK) + _HEADER_BYTES[0],
    _MAX_PAGE_BYTES,
    _begins,
    _length,
)


def _fields(page: bytes) -> dict[str, Any]:
    """Read a header; numbers beyond its end are 0."""
    n_header = len(_MARK) + Struct("<I").unpack_from(page, 184)[0]
    header = page[:n_header].ljust(512, b"\0")
    read = {name: form.unpack_from(header, at) for name, at, form in _STRUCTS}
    return {name: value[0] if len(value) == 1 else value for name, value in read.items()}


def open_file(path: Path, config: Config, chunk_bytes: int) -> Log:
    """Open a log. Raises BadInputError for one that cannot be read."""
    file = messages_of(_LAYOUT, path, chunk_bytes)
    there: Counter[bool] = Counter()
    khz: set[float] = set()
    for framed in islice(file, _PROBED):
        version = _HEAD.unpack_from(framed.message)[1]
        page = _PAGES.get(version)
        if page is not None:
            for is_high in (False, True):
                there[is_high] += any(map(len, _channels(framed.message, page, is_high)))
            khz |= {float(_fields(framed.message)["khz"])} - {0.0}
    wants_low = config.sonar.subsystem == 20
    is_high = bool(there[True]) and not (wants_low and there[False])
    known = tuple(sorted(khz))
    used_khz = (known[-1] if is_high else known[0]) if known else 0.0

    def decoder(report: LogReport) -> Decode:
        if there[True] and there[False]:
            used, other = ("high", 20) if is_high else ("low", 21)
            text = f"of a low and a high frequency the {used} one is used. Set sonar.subsystem: {other} for the other"
            asked = config.sonar.subsystem is not None
            report.notify("reader.frequency_chosen", text, path.name, for_the_record=asked)
        return _decoder(is_high, report)

    return SoundingLog(path, [file], decoder, config.sonar, _NO_NAVIGATION, known, used_khz)


def _decoder(is_high: bool, report: LogReport) -> Decode:
    last_s = NAN

    def decode(framed: Framed[bytes], place: str) -> Iterator[Sounding]:
        nonlocal last_s
        version = _HEAD.unpack_from(framed.message)[1]
        page = _PAGES.get(version)
        if page is None or not (page.high if is_high else page.low):
            report.counters[f"reader.not_used.page_{version}"] += 1
            return
        fields = _fields(framed.message)
        channels = _channels(framed.message, page, is_high)
        time_s = _time_s(fields)
        if math.isnan(time_s):
            report.counters["reader.time_invalid"] += 1
            return
        gap_s = time_s - last_s if 0.0 < time_s - last_s <= _MAX_BEAM_GAP_S else 0.0
        last_s = time_s
        sound_mps = _CENTI * fields["sound_cmps"]
        if not _SPEEDS_MPS[0] <= sound_mps <= _SPEEDS_MPS[1]:
            sound_mps = USUAL_SOUND_SPEED_MPS
            report.notify_once("reader.sound_speed_assumed", f"pages state no sound speed: {sound_mps:g} m/s", place)
        navigation = _navigation(fields, page, report)
        beams = [beam for beam in range(page.n_beams) if page.n_beams == 1 or fields["beams"] >> beam & 1]
        beams = beams or list(range(page.n_beams))
        for line, beam in enumerate(reversed(beams)):  # from the one farthest astern
            sides = [channels[beam], channels[page.n_beams + beam]]
            port, starboard = (trace_of(side[: fields["n_samples"]], 0.0, fields["range_m"], report) for side in sides)
            if port is not None or starboard is not None:
                at_s = time_s + gap_s * ((line + 0.5) / len(beams) - 0.5)
                yield Sounding(stamp_of(at_s), place, port, starboard, navigation, sound_mps)

    return decode


def _channels(page: bytes, kind: _Page, is_high: bool) -> list[NDArray[Any]]:
    """Read the vectors of samples of a frequency, each behind its count; empty ones where the page ends before."""
    first = 2 * (is_high and kind.low)  # behind those of the low frequency
    at, count, channels = len(_MARK) + _fields(page)["header_bytes"], np.dtype(kind.length), []
    for _ in range(first + 2 * kind.n_beams if (kind.high if is_high else kind.low) else 0):
        (n_samples,) = np.frombuffer(page, count, 1, at) if at + count.itemsize <= len(page) else (0,)
        at += count.itemsize
        n_bytes = int(n_samples) * np.dtype(kind.sample).itemsize
        channels.append(
            np.frombuffer(page[at : at + n_bytes], kind.sample) if at + n_bytes <= len(page) else np.empty(0)
        )
        at += n_bytes
    return channels[first:]


def _time_s(fields: dict[str, Any]) -> float:
    """Return the time of a ping, s since 1970; NaN for a date that cannot be."""
    try:
        year, month, day, hour, minute, second = fields["year"]
        whole_s = datetime(year, month, day, hour, minute, second, tzinfo=UTC).timestamp()
    except (ValueError, OverflowError):
        return NAN
    fraction_s = float(fields["fraction_s"])
    return whole_s + (fraction_s if 0.0 < fraction_s < 1.0 else _CENTI * float(min(fields["hundredths"], 99)))


def _navigation(fields: dict[str, Any], page: _Page, report: LogReport) -> NavSample:
    places = fields["laid_back"], fields["fish"], fields["ship"]
    given = (place for place in places if place != (0.0, 0.0) and math.isfinite(sum(place)))
    latitude_rad, longitude_rad = next(given, (0.0, 0.0))
    latitude_deg, longitude_deg = place_of(math.degrees(latitude_rad), math.degrees(longitude_rad), report)
    heading_deg, pitch_deg, roll_deg, _ = map(number_or_nan, fields["fish_deg"])
    altitude_m, depth_m, speed_mps = number_or_nan(fields["altitude_m"]), NAN, number_or_nan(fields["speed_mps"])
    if page.is_uuv:
        heading_deg = number_or_nan(fields["ship_deg"])
        pitch_deg, roll_deg, depth_m, altitude_m = map(number_or_nan, fields["aux"])
        speed_mps = _CENTI * fields["fish_cmps"]
    return NavSample(
        time_s=0.0,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        heading_rad=math.radians(heading_deg) % math.tau,
        pitch_rad=math.radians(pitch_deg),
        roll_rad=math.radians(roll_deg),
        depth_m=depth_m,
        altitude_m=altitude_m,
        speed_mps=speed_mps,
    )
