"""Decode Water Linked DVL reports in JSON, one object a line, as they come over TCP (port 16171). Water Linked, "DVL
protocol": reports of velocity, and of the unit's own dead reckoning for its attitude.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from typing import Any, Final

from drivers.navigation.dvl_water_linked import Record, Velocity, WaterLinkedAttitude

_MAX_LINE_BYTES: Final = 1 << 14  # 16 times a report of four transducers
_MAX_VELOCITY_MPS: Final = 20.0  # m/s: faster than any vehicle or lock on the bottom
_MAX_NUMBER: Final = 1e18  # microseconds since 1970 have 16 digits


class JsonReports:
    """Find reports in a stream, however it is cut up. Never raises; holds one line at most.

    counters: water_linked.messages, .bytes_skipped, .refused.oversize, .malformed (JSON, fields impossible), .ignored
    (answers to commands and other reports).
    """

    def __init__(self, counters: Counter[str]) -> None:
        self._counters = counters
        self._line = b""
        self._is_long = False

    def feed(self, data: bytes) -> list[Record]:
        """Return the reports that these bytes complete, in order."""
        *lines, rest = (self._line + data).split(b"\n")
        found = []
        for line in lines:
            if self._is_long or len(line) > _MAX_LINE_BYTES:
                self._is_long = False
                self._counters["water_linked.refused.oversize"] += 1
                self._counters["water_linked.bytes_skipped"] += len(line) + 1
                continue
            record = self._record(line)
            if record is not None:
                found.append(record)
        if len(rest) > _MAX_LINE_BYTES:
            self._counters["water_linked.bytes_skipped"] += len(rest)
            rest, self._is_long = b"", True
        self._line = rest
        return found

    def _record(self, line: bytes) -> Record | None:
        text = line.strip()
        if not text:
            return None
        try:
            report = json.loads(text) if text.startswith(b"{") else None
        except (ValueError, RecursionError):
            report = None
        if not isinstance(report, dict):
            self._counters["water_linked.bytes_skipped"] += len(line) + 1
            return None
        self._counters["water_linked.messages"] += 1
        try:
            record = parse_report(report)
        except (ValueError, KeyError, TypeError, OverflowError):
            self._counters["water_linked.malformed"] += 1
            return None
        if record is None:
            self._counters["water_linked.ignored"] += 1
        return record


def parse_report(report: dict[str, Any]) -> Record | None:
    """Decode a report; None for another kind. Raises ValueError, KeyError or TypeError for what cannot be true.

    Formats before json_v3 have no `type`; their velocities are known by their fields.
    """
    kind = report.get("type", "velocity" if "vx" in report else None)
    if kind == "velocity":
        good = report["velocity_valid"]
        if not isinstance(good, bool):
            raise ValueError("velocity_valid is neither true nor false")
        limit = _MAX_VELOCITY_MPS if good else _MAX_NUMBER
        forward, starboard, down = (_number(report[name], limit) if good else math.nan for name in ("vx", "vy", "vz"))
        covariance = report.get("covariance", [])
        flat = tuple(_number(value) for row in covariance for value in row) if isinstance(covariance, list) else ()
        return Velocity(
            forward,
            starboard,
            down,
            good,
            _number(report["altitude"]),
            _number(report["fom"]),
            flat if len(flat) == 9 else (math.nan,) * 9,
            round(_number(report.get("time_of_validity", 0))),
            round(_number(report.get("time_of_transmission", report.get("time_of_validity", 0)))),
            _number(report.get("time", 0.0)),
            round(_number(report.get("status", 0))),
        )
    if kind == "position_local":
        roll, pitch, yaw = (math.radians(_number(report[name], 360.0)) for name in ("roll", "pitch", "yaw"))
        x, y, z, sigma = (_number(report[name]) for name in ("x", "y", "z", "std"))
        status = round(_number(report.get("status", 0)))
        return WaterLinkedAttitude(_number(report["ts"]), x, y, z, sigma, roll, pitch, yaw % math.tau, status)
    return None


def _number(value: Any, limit: float = _MAX_NUMBER) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= limit:
        raise ValueError(f"not a number here: {value!r}")
    return float(value)
