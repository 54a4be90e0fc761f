"""Read ACME logs: lines of JSON, the first of them `{"format": "acme-log"}`.

A line with `fix` holds [UTC s, latitude, longitude in degrees, heading in degrees, depth, altitude in m]; one with
`ping` holds [number, UTC s of the transmission, range in m], `port` and `starboard` amplitudes, near to far.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from auv_mcm.records import EchoTrace, NavSample, Ping, SourceEvent
from auv_mcm.settings.config import Config
from sim_replay.logs.log_reader import LogReader

FIRST_LINE: Final = b'{"format": "acme-log"}\n'


def events(path: Path, file: BinaryIO, config: Config, counters: Counter[str]) -> Iterator[SourceEvent]:
    """Yield the fixes and pings of a log; a line that cannot be read counts in acme_log.damaged_lines."""
    for number, line in enumerate(file, 1):
        try:
            record = json.loads(line)
            if "fix" in record:
                yield _fix(*record["fix"])
            elif "ping" in record:
                yield _ping(record, f"{path.name}, line {number}")
        except (ValueError, TypeError, KeyError):
            counters["acme_log.damaged_lines"] += 1


def _fix(
    time_s: float, latitude_deg: float, longitude_deg: float, heading_deg: float, depth_m: float, altitude_m: float
) -> NavSample:
    return NavSample(
        time_s=time_s,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        heading_rad=math.radians(heading_deg),
        pitch_rad=0.0,
        roll_rad=0.0,
        depth_m=depth_m,
        altitude_m=altitude_m,
    )


def _ping(record: dict[str, Any], place: str) -> Ping:
    number, time_s, range_m = record["ping"]
    port, starboard = (_trace(record[side], range_m) for side in ("port", "starboard"))
    return Ping(number=number, time_s=time_s, port=port, starboard=starboard, transfer="amplitude", place=place)


def _trace(amplitudes: list[int], range_m: float) -> EchoTrace:
    spacing_m = range_m / len(amplitudes)
    return EchoTrace(samples=np.array(amplitudes, np.uint16), first_range_m=0.5 * spacing_m, spacing_m=spacing_m)


READER: Final = LogReader("ACME log", lambda head: head.startswith(FIRST_LINE), events)
