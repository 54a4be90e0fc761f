"""Read a log format of your own.

    python own_log_reader.py LOG

The format is made up: a .npz archive of numpy arrays with a row for each ping: `time_s` (n,) UTC seconds since 1970,
the pose (POSE below, each (n,)), and amplitudes `port`, `starboard` (n, n_samples), near to far, up to `range_m` ().
LOG is written in that format, and the pipeline finds the same mines in both. In a package, one line of
pyproject.toml makes `auv-mcm replay` recognise such files by their content:

    [project.entry-points."auv_mcm.logs"]
    lab_log = "my_package.own_log_reader:READER"
"""

import math
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import BadZipFile

import numpy as np

from auv_mcm.errors import BadInputError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import EchoTrace, NavSample, Ping, SourceEvent
from auv_mcm.settings.config import Config
from sim_replay.logs.log_reader import LogReader
from sim_replay.logs.open_log import open_log

POSE = ("latitude_deg", "longitude_deg", "heading_rad", "altitude_m", "depth_m")


def recognises(head: bytes) -> bool:
    """Look at the first bytes of a file: a ZIP archive whose first member is ours."""
    return head.startswith(b"PK\x03\x04") and head[30:].startswith(b"time_s.npy")


def events(path: Path, file: BinaryIO, config: Config, counters: Counter[str]) -> Iterator[SourceEvent]:
    """Yield navigation and pings in order of time. Damage is skipped and counted; what is not known is NaN."""
    try:
        arrays = dict(np.load(file))
        rows = zip(*(arrays[name] for name in ("time_s", "port", "starboard", *POSE)), strict=True)
        step_m = float(arrays["range_m"]) / arrays["port"].shape[1]
    except (ValueError, KeyError, BadZipFile) as error:
        raise BadInputError(f"{path}: {error}. Write the archive anew") from error
    for number, (time_s, port, starboard, *pose) in enumerate(rows):
        if not math.isfinite(time_s):
            counters["lab_log.no_time"] += 1
            continue
        # The format has neither pitch nor roll: a steady vehicle is assumed.
        yield NavSample(time_s=time_s, pitch_rad=0.0, roll_rad=0.0, **dict(zip(POSE, pose, strict=True)))
        left, right = (
            EchoTrace(samples=side, first_range_m=0.5 * step_m, spacing_m=step_m) for side in (port, starboard)
        )
        yield Ping(number=number, time_s=time_s, port=left, starboard=right, place=f"{path.name}, ping {number}")


READER = LogReader("laboratory archive", recognises, events)


def write_archive(log: Path, path: Path) -> None:
    """Convert a log to the format: each ping with the navigation nearest in time."""
    recorded = list(open_log(log, Config()))
    pings = [event for event in recorded if isinstance(event, Ping) and event.port and event.starboard]
    fixes = [event for event in recorded if isinstance(event, NavSample)]
    used = [min(fixes, key=lambda fix: abs(fix.time_s - ping.time_s)) for ping in pings]
    rows: dict[str, Any] = {name: [getattr(fix, name) for fix in used] for name in POSE}
    rows |= {side: [getattr(ping, side).samples for ping in pings] for side in ("port", "starboard")}
    range_m = max(ping.port.spacing_m * len(ping.port.samples) for ping in pings if ping.port)
    np.savez(path, time_s=[ping.time_s for ping in pings], range_m=range_m, **rows)


def n_mines(source: Iterable[SourceEvent]) -> int:
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
            n_archive = n_mines(READER.events(archive, file, Config(), Counter()))
    print(f"mine-like contacts: {n_mines(open_log(log, Config()))} in {log.name}, {n_archive} in the archive")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
