"""Describe a recorded log: what it holds, what a replay would use of it and leave out, and every notice it would raise.

The log goes through the chain up to the waterfall, without looking for anything in it, so that what is described is
what a replay takes.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import SIDES, EchoTrace, NavSample, Notice, Ping, PipelineEvent, Side, Tile
from auv_mcm.settings.config import Config
from sim_replay.logs.open_log import find_format
from sim_replay.logs.recorded import RecordedMission, open_mission

Info = dict[str, Any]
"""Values by name, as `--json` writes them; None for what the log does not state."""

_QUANTITIES: Final = ("position", "heading", "attitude", "depth", "altitude", "speed")
_GAP_INTERVALS: Final = (
    5.0  # of the usual interval between pings, and a second, from which on a pause is a gap (chosen)
)
_MIN_GAP_S: Final = 1.0  # s: a shorter pause is none, however fast the sonar pings (chosen)
_SHOWN_GAPS: Final = 10  # the longest are listed
_COURSE_M: Final = 2.0  # m between fixes, over which a course is taken: ten times the noise of a good receiver (chosen)
_EARTH_M_PER_DEG: Final = 111_195.0  # m per degree of a great circle (mean radius 6371 km)
_USED: Final = ("reader.pings", "ping.received", "bottom.corrected")


def describe(path: Path, config: Config, progress: Callable[[float], None] = lambda fraction: None) -> Info:
    """Read a log, or a recorded session, from end to end and describe it.

    Parameters
    ----------
    path
        A file, or the folder of a recording.
    config
        As for a replay.
    progress
        Called with the fraction done, 0..1.

    Raises
    ------
    UsageError
        As a replay would, BadInputError for what cannot be replayed.
    """
    form = find_format(path)
    mission = open_mission([path], config)
    pipeline = Pipeline(config, detect=lambda tile: TileDetections((), 0, 0), seabed=lambda tile: None)
    pings, navigation, floor = _Pings(), _Navigation(), _Floor()
    notices: list[Notice] = []
    for made in _fed(mission, pipeline, pings, navigation, progress):
        if isinstance(made, Notice):
            notices.append(made)
        elif isinstance(made, Tile):
            floor.add(made)
    counters = mission.counters() + pipeline.counters
    (log,) = mission.logs
    return {
        "path": str(path),
        "format": form.name,
        "title": form.title,
        "bytes": sum(mission.sizes_bytes.values()),
        "files": {str(name): size for name, size in mission.sizes_bytes.items()},
        "frequency_khz": _known(float(getattr(log, "frequency_khz", 0.0)) or math.nan),
        "frequencies_khz": [khz for khz in getattr(log, "frequencies_khz", ()) if khz > 0.0],
        "channels": str(getattr(log, "channel_names", "")),
        "sides": {side: pings.side(side) for side in SIDES},
        "transfer": pings.transfer()
        or next((notice.text for notice in notices if notice.code.startswith("transfer.")), None),
        "pings": pings.table(),
        "clock": {**pings.clock(), **_counted(counters, "time", "clock", "pause")},
        "navigation": {**navigation.table(), "sources": dict(getattr(log, "navigation_sources", dict)())},
        "altitude": floor.table(),
        "bottom_line": [{**line.entry(), "problem": line.problem} for line in mission.bottom_lines],
        "used": _used(pings, counters),
        "left_out": {name: count for name, count in sorted(counters.items()) if name not in _USED},
        "notices": [_notice(notice) for notice in notices if not notice.for_the_record],
        "remarks": [_notice(notice) for notice in notices if notice.for_the_record],
    }


def _fed(
    mission: RecordedMission,
    pipeline: Pipeline,
    pings: _Pings,
    navigation: _Navigation,
    progress: Callable[[float], None],
) -> Iterator[PipelineEvent]:
    """Feed a mission to the pipeline and note its pings and navigation; yields what comes of it."""
    for event in mission.events():
        if isinstance(event, Ping):
            pings.add(event)
        elif isinstance(event, NavSample):
            navigation.add(event)
        yield from pipeline.feed(event)
        progress(mission.fraction_done)
    yield from pipeline.finish()


def _notice(notice: Notice) -> dict[str, str]:
    return {"code": notice.code, "text": notice.text, "place": notice.place}


def _counted(counters: Counter[str], *words: str) -> dict[str, int]:
    return {name: n for name, n in sorted(counters.items()) if any(word in name for word in words)}


def _used(pings: _Pings, counters: Counter[str]) -> Info:
    placed = pings.count - counters["navigation.ping_stale"]
    lines = {"bottom_corrected": n} if (n := counters["bottom.corrected"]) else {}
    return {"pings": pings.count, "pings_with_position": max(placed, 0), **lines}


def _known(number: float, digits: int = 3) -> float | None:
    return round(float(number), digits) if math.isfinite(number) else None


def _utc(time_s: float) -> str | None:
    try:
        return datetime.fromtimestamp(time_s, UTC).isoformat(timespec="milliseconds") if math.isfinite(time_s) else None
    except (ValueError, OverflowError, OSError):
        return None


def _gaps(times_s: NDArray[np.float64], least_s: float) -> Info:
    """Describe the pauses of at least so many seconds between times in order."""
    steps = np.diff(times_s)
    at = np.flatnonzero(steps > least_s)
    longest = at[np.argsort(-steps[at], kind="stable")][:_SHOWN_GAPS]
    return {
        "longer_than_s": round(least_s, 3),
        "count": len(at),
        "longest": [{"after": _utc(float(times_s[n])), "seconds": _known(float(steps[n]))} for n in longest],
    }


class _Pings:
    """Gather pings: times, and the layout of each side."""

    def __init__(self) -> None:
        self._times_s: list[float] = []
        self._layouts: dict[Side, Counter[tuple[int, str, float, float]]] = {side: Counter() for side in SIDES}
        self._speeds: Counter[float] = Counter()
        self._transfers: set[str] = set()

    @property
    def count(self) -> int:
        """Return the number of pings."""
        return len(self._times_s)

    def add(self, ping: Ping) -> None:
        """Take the next ping."""
        self._times_s.append(ping.time_s)
        self._speeds[round(ping.sound_speed_mps, 1)] += 1
        if ping.transfer is not None:
            self._transfers.add(ping.transfer)
        traces: tuple[tuple[Side, EchoTrace | None], ...] = (("port", ping.port), ("starboard", ping.starboard))
        for side, trace in traces:
            if trace is not None:
                first_m, spacing_m = round(trace.first_range_m, 4), round(trace.spacing_m, 6)
                self._layouts[side][trace.samples.shape[0], trace.samples.dtype.str, first_m, spacing_m] += 1

    def transfer(self) -> str:
        """Say what samples are where the sonar's protocol states it."""
        return f"{' and '.join(sorted(self._transfers))}, by the sonar's protocol" if self._transfers else ""

    def side(self, side: Side) -> Info | None:
        """Describe a side by its commonest layout; None if it was never there."""
        layouts = self._layouts[side]
        if not layouts:
            return None
        (n_samples, kind, first_m, spacing_m), _ = layouts.most_common(1)[0]
        return {
            "pings": layouts.total(),
            "samples": n_samples,
            "sample_type": np.dtype(kind).name,
            "spacing_m": spacing_m,
            "first_range_m": first_m,
            "range_m": _known(first_m + spacing_m * (n_samples - 0.5)),
            "layouts": len(layouts),
        }

    def table(self) -> Info:
        """Describe how many there are, how fast they come, and where they pause."""
        times = np.array(self._times_s)
        ordered = np.sort(times)
        steps = np.diff(ordered)
        steps = steps[steps > 0.0]
        usual_s = float(np.median(steps)) if steps.size else math.nan
        duration_s = float(ordered[-1] - ordered[0]) if times.size else 0.0
        least_s = max(_MIN_GAP_S, _GAP_INTERVALS * usual_s) if math.isfinite(usual_s) else _MIN_GAP_S
        return {
            "count": self.count,
            "duration_s": _known(duration_s),
            "rate_per_s": _known(_rate_per_s(steps)),
            "gaps": _gaps(ordered, least_s),
            "sound_speed_mps": [min(self._speeds), max(self._speeds)] if self._speeds else None,
        }

    def clock(self) -> Info:
        """Describe the times of pings."""
        times = np.array(self._times_s)
        return {
            "first": _utc(float(times.min())) if times.size else None,
            "last": _utc(float(times.max())) if times.size else None,
            "steps_back": int(np.count_nonzero(np.diff(times) < 0.0)),
        }


class _Navigation:
    """Gather navigation: when each quantity came, and the track that positions make."""

    def __init__(self) -> None:
        self._times_s: dict[str, list[float]] = {name: [] for name in _QUANTITIES}
        self._fixes: list[tuple[float, float, float]] = []
        self._headings: list[tuple[float, float]] = []
        self._speeds: list[tuple[float, float]] = []

    def add(self, sample: NavSample) -> None:
        """Take the next sample."""
        given = {
            "position": sample.latitude_deg + sample.longitude_deg,
            "heading": sample.heading_rad,
            "attitude": sample.pitch_rad + sample.roll_rad,
            "depth": sample.depth_m,
            "altitude": sample.altitude_m,
            "speed": sample.speed_mps,
        }
        for name, number in given.items():
            if math.isfinite(number):
                self._times_s[name].append(sample.time_s)
        if math.isfinite(given["position"]):
            self._fixes.append((sample.time_s, sample.latitude_deg, sample.longitude_deg))
        if math.isfinite(sample.heading_rad):
            self._headings.append((sample.time_s, sample.heading_rad))
        if math.isfinite(sample.speed_mps):
            self._speeds.append((sample.time_s, sample.speed_mps))

    def table(self) -> Info:
        """Describe each quantity, and how speeds and headings agree with the track."""
        quantities = {name: self._quantity(np.array(times)) for name, times in self._times_s.items()}
        track_s, courses_rad, speeds_mps, length_m = self._track()
        return {
            "quantities": quantities,
            "track_m": _known(length_m, 1),
            "speed_mps": {
                "stated": _known(_median([speed for _, speed in self._speeds])),
                "track": _known(_median(speeds_mps)),
            },
            "heading_minus_course_deg": self._crab_deg(track_s, courses_rad),
            "heading_is_constant": bool(self._headings) and len({heading for _, heading in self._headings}) == 1,
        }

    @staticmethod
    def _quantity(times_s: NDArray[np.float64]) -> Info | None:
        if not times_s.size:
            return None
        steps = np.diff(np.sort(times_s))
        steps = steps[steps > 0.0]
        longest_s = float(steps.max()) if steps.size else math.nan
        return {
            "count": int(times_s.size),
            "rate_per_s": _known(_rate_per_s(steps)),
            "longest_gap_s": _known(longest_s),
        }

    def _track(self) -> tuple[list[float], list[float], list[float], float]:
        """Return times, courses and speeds over pieces of a few metres of the track, and its length."""
        times_s: list[float] = []
        courses: list[float] = []
        speeds: list[float] = []
        length_m = 0.0
        last: tuple[float, float, float] | None = None
        for fix in self._fixes:
            if last is None or fix[0] <= last[0]:
                last = fix
                continue
            north_m = _EARTH_M_PER_DEG * (fix[1] - last[1])
            east_deg = (fix[2] - last[2] + 180.0) % 360.0 - 180.0
            east_m = _EARTH_M_PER_DEG * east_deg * math.cos(math.radians(fix[1]))
            step_m = math.hypot(north_m, east_m)
            if step_m < _COURSE_M:
                continue
            times_s.append(0.5 * (fix[0] + last[0]))
            courses.append(math.atan2(east_m, north_m))
            speeds.append(step_m / (fix[0] - last[0]))
            length_m += step_m
            last = fix
        return times_s, courses, speeds, length_m

    def _crab_deg(self, times_s: Sequence[float], courses_rad: Sequence[float]) -> float | None:
        """Return the median of heading minus course, degrees to starboard; None where either is missing."""
        if not times_s or not self._headings:
            return None
        headings = np.array(sorted(self._headings))
        near = np.clip(np.searchsorted(headings[:, 0], times_s), 0, len(headings) - 1)
        off = headings[near, 1] - np.array(courses_rad)
        middle = math.atan2(float(np.sin(off).mean()), float(np.cos(off).mean()))  # a compass turned round is about 180
        middle += _median((off - middle + math.pi) % (2.0 * math.pi) - math.pi)
        return _known(math.degrees(math.remainder(middle, 2.0 * math.pi)), 1)


class _Floor:
    """Gather the altitude that is stated and the first return of the sea floor, per row of the waterfall."""

    def __init__(self) -> None:
        self._stated: list[NDArray[np.float64]] = []
        self._returns: list[NDArray[np.float64]] = []

    def add(self, tile: Tile) -> None:
        """Take the rows that belong to a tile alone."""
        core = slice(tile.core_start, tile.core_stop)
        self._stated.append(np.asarray(tile.pose.altitude_m, dtype=np.float64)[core])
        self._returns.append(np.asarray(tile.first_return_m, dtype=np.float64)[core])

    def table(self) -> Info:
        """Compare both, medians in metres; None for what is not known."""
        stated = np.concatenate([np.empty(0), *self._stated])
        returns = np.concatenate([np.empty(0), *self._returns])
        both = np.isfinite(stated) & np.isfinite(returns)
        return {
            "stated_m": _known(_median(stated[np.isfinite(stated)])),
            "first_return_m": _known(_median(returns[np.isfinite(returns)])),
            "stated_minus_first_return_m": _known(_median((stated - returns)[both])),
        }


def _median(numbers: Sequence[float] | NDArray[np.float64]) -> float:
    return float(np.median(np.asarray(numbers))) if len(numbers) else math.nan


def _rate_per_s(steps_s: NDArray[np.float64]) -> float:
    """Return the rate between gaps; the mean, as the median of times in steps of 10 ms is off by some percent."""
    usual = steps_s[steps_s <= 2.0 * np.median(steps_s)] if steps_s.size else steps_s
    return 1.0 / float(usual.mean()) if usual.size else math.nan
