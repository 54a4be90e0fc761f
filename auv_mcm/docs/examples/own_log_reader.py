"""Read a log format of your own.

    python own_log_reader.py LOG

The format is made up: a .npz archive of numpy arrays, as a laboratory may keep its surveys, with one row for each ping:
`time_s` (n,) UTC seconds since 1970, `latitude_deg`, `longitude_deg`, `heading_deg`, `altitude_m`, `depth_m` (n,), and
amplitudes `port`, `starboard` (n, n_samples), near to far, up to `range_m` (). LOG is written in that format, and the
pipeline finds the same contacts in both.

To have `auv-mcm replay` read the format, add the reader to your package's pyproject.toml; files are then recognised by
their content:

    [project.entry-points."auv_mcm.logs"]
    lab_log = "my_package.own_log_reader:READER"
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from auv_mcm.errors import BadInputError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import EchoTrace, NavSample, Ping, SourceEvent
from auv_mcm.settings.config import Config
from sim_replay.logs.log_reader import LogReader
from sim_replay.logs.open_log import open_log

POSE = ("latitude_deg", "longitude_deg", "heading_deg", "altitude_m", "depth_m")


def recognises(head: bytes) -> bool:
    """Look at the first bytes of a file: a ZIP archive whose first member is ours."""
    return head.startswith(b"PK\x03\x04") and head[30:].startswith(b"time_s.npy")


def events(path: Path, file: BinaryIO, config: Config, counters: Counter[str]) -> Iterator[SourceEvent]:
    """Yield navigation and pings in order of time. Damage is skipped and counted; what is not known is NaN."""
    try:
        arrays = dict(np.load(file))
        range_m = float(arrays["range_m"])
        rows = zip(*(arrays[name] for name in ("time_s", *POSE, "port", "starboard")), strict=True)
    except (ValueError, KeyError) as error:
        raise BadInputError(f"{path}: {error}. Write the archive anew") from error
    for number, (time_s, latitude, longitude, heading, altitude, depth, port, starboard) in enumerate(rows):
        if not math.isfinite(time_s):
            counters["lab_log.no_time"] += 1
            continue
        yield NavSample(
            time_s=time_s,
            latitude_deg=latitude,
            longitude_deg=longitude,
            heading_rad=math.radians(heading),
            pitch_rad=0.0,  # the format has none: a steady vehicle is assumed
            roll_rad=0.0,
            depth_m=depth,
            altitude_m=altitude,
        )
        step_m = range_m / len(port)
        traces = [EchoTrace(samples=side, first_range_m=0.5 * step_m, spacing_m=step_m) for side in (port, starboard)]
        yield Ping(
            number=number, time_s=time_s, port=traces[0], starboard=traces[1], place=f"{path.name}, ping {number}"
        )


READER = LogReader("laboratory archive", recognises, events)


def write_archive(log: Path, path: Path) -> None:
    """Convert a log to the format: each ping with the navigation nearest in time."""
    recorded = list(open_log(log, Config()))
    pings = [event for event in recorded if isinstance(event, Ping)]
    fixes = [event for event in recorded if isinstance(event, NavSample)]
    nearest = np.abs(np.subtract.outer([ping.time_s for ping in pings], [fix.time_s for fix in fixes])).argmin(axis=1)
    used = [fixes[index] for index in nearest]
    np.savez(
        path,
        time_s=[ping.time_s for ping in pings],
        latitude_deg=[fix.latitude_deg for fix in used],
        longitude_deg=[fix.longitude_deg for fix in used],
        heading_deg=[math.degrees(fix.heading_rad) for fix in used],
        altitude_m=[fix.altitude_m for fix in used],
        depth_m=[fix.depth_m for fix in used],
        port=[trace.samples for ping in pings if (trace := ping.port) is not None],
        starboard=[trace.samples for ping in pings if (trace := ping.starboard) is not None],
        range_m=max(trace.spacing_m * len(trace.samples) for ping in pings if (trace := ping.port) is not None),
    )


def contacts_of(source: Iterable[SourceEvent]) -> int:
    """Run the pipeline over events, as a replay does, and count the contacts more likely to be mines than not."""
    pipeline = Pipeline(Config())
    for event in source:
        pipeline.feed(event)
    pipeline.finish()
    return sum(contact.p_mine > 0.5 for contact in pipeline.contacts)


def main(log: Path) -> None:
    """Write a log in the own format and replay it."""
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "survey.npz"
        write_archive(log, archive)
        with archive.open("rb") as file:
            assert READER.recognises(file.read(1 << 20))
            file.seek(0)
            counters: Counter[str] = Counter()
            n_archive = contacts_of(READER.events(archive, file, Config(), counters))
    print(f"mine-like contacts: {contacts_of(open_log(log, Config()))} in {log.name}, {n_archive} in the archive")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
