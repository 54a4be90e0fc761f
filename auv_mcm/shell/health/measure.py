"""Measure processes, disk and temperature of the computer that the service runs on, as Linux reports them."""

from __future__ import annotations

import math
import multiprocessing
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from auv_mcm.shell.health.judge import Computer, Process

_PROCESSES: Final = Path("/proc")
_THERMAL: Final = Path("/sys/class/thermal")
# Fields of /proc/PID/stat behind the name, which may hold spaces, from 0: proc(5) counts utime 14, stime 15, rss 24.
_UTIME, _STIME, _RSS = 11, 12, 21


def measure_process(process_id: int | None, processes: Path = _PROCESSES) -> Process | None:
    """Measure a process; None where it is not there or /proc does not state it."""
    try:
        fields = (processes / str(process_id) / "stat").read_text("ascii", "replace").rpartition(")")[2].split()
        ticks = int(fields[_UTIME]) + int(fields[_STIME])
        return Process(ticks / os.sysconf("SC_CLK_TCK"), float(int(fields[_RSS]) * os.sysconf("SC_PAGE_SIZE")))
    except (OSError, IndexError, ValueError):
        return None


def perception_process() -> int | None:
    """Find the process of perception, None while there is none."""
    return next((child.pid for child in multiprocessing.active_children() if child.name == "perception"), None)


def measure_computer(folder: Path, thermal: Path = _THERMAL) -> Computer:
    """Measure the free space on the disk of `folder`, and the warmest of the places that the kernel measures."""
    try:
        free_bytes = float(shutil.disk_usage(folder).free)
    except OSError:
        free_bytes = math.nan
    zones = [(_degrees(zone / "temp"), min(_slowing(zone), default=math.inf)) for zone in thermal.glob("thermal_zone*")]
    known = [(degrees, hot) for degrees, hot in zones if math.isfinite(degrees)]
    # The zone that is nearest to its own limit, or the warmest one where none has a limit.
    degrees, hot = max(known, key=lambda zone: (zone[0] - zone[1], zone[0]), default=(math.nan, math.inf))
    return Computer(free_bytes, degrees, hot)


def _slowing(zone: Path) -> Iterator[float]:
    """Give the temperatures of a zone from which on the kernel cools or stops (its trip points but the active ones)."""
    for kind in zone.glob("trip_point_*_type"):
        try:
            name = kind.read_text("ascii").strip()
        except (OSError, UnicodeError):
            continue
        limit = _degrees(kind.with_name(kind.name.replace("_type", "_temp")))
        if name in ("passive", "hot", "critical") and limit > 0.0:  # unset ones are 0 or below
            yield limit


def _degrees(path: Path) -> float:
    try:
        return int(path.read_text("ascii")) * 1e-3
    except (OSError, ValueError):
        return math.nan
