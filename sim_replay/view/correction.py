"""Show the first bottom return along the waterfall, and keep what people correct of it beside the logs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import msgspec
import numpy as np

from auv_mcm.clock import SystemClock
from auv_mcm.errors import UsageError
from sim_replay.logs.bottom_lines import BottomLine, find_bottom_line, line_of, write_bottom_line
from sim_replay.logs.log_reader import Log
from sim_replay.logs.recorded import RecordedMission
from sim_replay.view.waterfall_store import Seen, WaterfallStore

_MAX_SHOWN: Final = 8000  # rows of the line on the page: more than a screen has pixels

Stretch: TypeAlias = Sequence[tuple[float, float]]
"""Rows of the waterfall and first returns, m of slant range."""


def bottom_shown(store: WaterfallStore, recorded: RecordedMission | None) -> dict[str, Any]:
    """Give the first returns that the waterfall was made with, thinned, and the stretches that lie beside the logs.

    Parameters
    ----------
    store
        The waterfall.
    recorded
        Its logs; None where they may still grow.
    """
    rows = np.arange(0, store.stop_row, max(1, -(-store.stop_row // _MAX_SHOWN)), dtype=np.int64)
    _, first_return_m = store.poses(rows)
    kept = [] if recorded is None else [line.stretches for _, _, line in _lines(recorded) if line is not None]
    stretches = []
    for stretch in (stretch for stretches in kept for stretch in stretches):
        found = store.rows_at([Seen(point.time_s) for point in stretch])
        if all(map(math.isfinite, found)):
            stretches.append([[row, point.first_return_m] for row, point in zip(found, stretch, strict=True)])
    return {"row": (rows + 0.5).tolist(), "first_return": first_return_m.round(3).tolist(), "stretches": stretches}


def keep_bottom(store: WaterfallStore, recorded: RecordedMission, by: str, stretches: Sequence[Stretch]) -> list[Path]:
    """Keep corrections beside the logs that they belong to, in place of those before; returns the files.

    Parameters
    ----------
    store
        The waterfall that rows are of.
    recorded
        Its logs, read to their end.
    by
        Who corrects.
    stretches
        Each of two points or more, within one log.

    Raises
    ------
    UsageError
        For stretches that cannot be kept; OSError from the disk.
    """
    by_log: dict[Path, tuple[Log, list[list[tuple[float, float]]]]] = {
        path: (log, []) for path, log, line in _lines(recorded) if line is not None
    }
    times_s = store.times()
    for stretch in stretches:
        points: dict[float, float] = {}
        for row, return_m in stretch:
            if not (0.0 <= row < len(times_s) and math.isfinite(times_s[int(row)])):
                raise UsageError("a stretch lies outside the pings: move its ends")
            points[float(times_s[int(row)])] = return_m
        named = {found[0]: found[1] for time_s in points if (found := recorded.log_at(time_s)) is not None}
        if len(named) != 1:
            raise UsageError("a stretch lies in several logs, or in none: end it within one, or show one alone")
        ((path, log),) = named.items()
        by_log.setdefault(path, (log, []))[1].append(list(points.items()))
    try:
        now_s = SystemClock().utc_s()
        lines = {path: line_of(log, by, now_s, parts) for path, (log, parts) in by_log.items()}
    except (msgspec.ValidationError, ValueError) as error:
        raise UsageError(f"this bottom line cannot be kept: {error}") from error
    return [write_bottom_line(path, line) for path, line in lines.items()]


def _lines(recorded: RecordedMission) -> list[tuple[Path, Log, BottomLine | None]]:
    """Read what lies beside each log now; None for nothing, or for what cannot be used."""
    named = [(path, log, find_bottom_line(path, log)) for path, log in recorded.named_logs]
    return [(path, log, None if found is None else found.line) for path, log, found in named]
