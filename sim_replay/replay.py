"""Replay a recorded mission through the pipeline, in this process, into a folder of results."""

from __future__ import annotations

import math
import os
import resource
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm import __version__, kernels
from auv_mcm.clean_text import clean
from auv_mcm.clearance.clearance_map import ClearanceMap
from auv_mcm.clearance.clearance_picture import clearance_png
from auv_mcm.clearance.detection_performance import configured_performance
from auv_mcm.clock import Clock, SystemClock
from auv_mcm.contacts.antimeridian import split_line
from auv_mcm.contacts.contact import best_view
from auv_mcm.contacts.contact_picture import snippet_png
from auv_mcm.contacts.geojson import Json, collection, feature, one_or_multi, positions_of
from auv_mcm.memory import return_large_arrays
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, CoveragePatch, Notice, PipelineEvent, Side, Tile
from auv_mcm.settings.config import Config, config_yaml
from auv_mcm.shell.mission_totals import (
    area_totals,
    clearance_notices,
    contact_totals,
    notice_lists,
    point_totals,
    search_totals,
)
from auv_mcm.shell.results import plan_waypoints, write_clearance, write_results
from auv_mcm.shell.snippet_files import make_results_directory, write_snippets
from auv_mcm.shell.tally import Tally
from auv_mcm.shell.whole_files import write_file, write_json
from auv_mcm.skips import ALL_SKIPS, NO_SKIPS, Skips
from sim_replay.logs.open_log import CHUNK_BYTES
from sim_replay.logs.recorded import Pace, open_mission
from sim_replay.mosaic import Mosaic
from sim_replay.report import MissionRecord, PictureCollector, write_report
from sim_replay.report.map_picture import MAX_BLOCKS, RESOLUTION_M, map_picture
from sim_replay.report.report_file import REPORT, report_contents, write_contents
from sim_replay.verdicts import read_verdicts

MAX_TRACK_POINTS: Final = 4000  # of the track in the report: bounds the page

_FILES: Final = (
    *("contacts.geojson", "contacts.csv", "contacts.kml", "waypoints.geojson", "coverage.geojson"),
    *("clearance.geojson", "track.geojson", "summary.json", "one-page.html"),
)
"""What lies beside the report of every mission."""

Progress = Callable[[float], None]


def replay(
    logs: Sequence[Path],
    folder: Path,
    config: Config,
    *,
    without_skips: Skips = NO_SKIPS,
    threads: int = 1,
    chunk_bytes: int = CHUNK_BYTES,
    speed: float = math.inf,
    clock: Clock | None = None,
    progress: Progress = lambda fraction: None,
    verdicts: Path | None = None,
    found: Callable[[Contact], None] = lambda contact: None,
) -> dict[str, Any]:
    """Replay `logs`, or a recorded session of ports, as one mission and write every result into `folder`.

    Results of an earlier replay are replaced.

    Returns what summary.json holds.

    Parameters
    ----------
    without_skips
        Those of `auv_mcm.skips` that are switched off.
    speed
        Times real time; inf does not wait.
    progress
        Called with the fraction done, 0..1.
    verdicts
        Folder with what people judged, which the report shows; None for that of the results.
    found
        Called with each contact as it is found, and again as it changes.

    Raises
    ------
    UsageError
        For a folder that cannot be written to, BadInputError if there is nothing to replay or a verdict is damaged.
    """
    clock = clock or SystemClock()
    judged = read_verdicts(verdicts or folder)
    mission = open_mission(logs, config, chunk_bytes)
    return_large_arrays()
    pipeline = Pipeline(config, without_skips=without_skips, threads=threads, timer=clock.monotonic_s)
    tally, gathered, pace = Tally(), _Gathered(config, found), Pace(speed, clock)
    make_results_directory(folder)
    # written last: its presence says that the other files belong together
    (folder / "summary.json").unlink(missing_ok=True)
    costs_s = {"read": 0.0, "pictures": 0.0}
    started_s = read_s = clock.monotonic_s()
    for event in mission.events():
        costs_s["read"] += clock.monotonic_s() - read_s
        if (wait_s := pace.wait_s(event)) > 0.0:
            time.sleep(wait_s)
        tally.add(event)
        events = pipeline.feed(event)
        if events:
            fed_s = clock.monotonic_s()
            gathered.add(events)
            costs_s["pictures"] += clock.monotonic_s() - fed_s
        progress(mission.fraction_done)
        read_s = clock.monotonic_s()
    events = pipeline.finish()
    fed_s = clock.monotonic_s()
    gathered.add(events)
    costs_s["pictures"] += clock.monotonic_s() - fed_s
    processing_s = clock.monotonic_s() - started_s
    costs_s = {"read": costs_s.pop("read"), **pipeline.costs_s, **costs_s}

    contacts = sorted(pipeline.contacts, key=lambda contact: contact.id)
    counters = mission.counters() + pipeline.counters
    waypoints = plan_waypoints(contacts, tally, config.plan, counters)
    write_results(folder, contacts, gathered.coverage, waypoints, config.mission)
    write_snippets(
        folder, {contact.id: snippet_png(view) for contact in contacts if (view := best_view(contact)) is not None}
    )
    clearance = gathered.searched.snapshot()
    clearance_map = b"" if clearance is None else clearance_png(clearance)
    write_clearance(folder, clearance, clearance_map)
    write_file(folder / "track.geojson", collection([feature(gathered.track.geometry(), {})]))
    gathered.add(clearance_notices(clearance))
    searched = search_totals(clearance, contacts)
    area = area_totals(clearance, config.plan)
    point = point_totals(pipeline.operating_point)
    totals = {**tally.totals(), **contact_totals(contacts, gathered.coverage), **point, **searched, **area}
    record = MissionRecord(
        name=clean(config.mission or ", ".join(dict.fromkeys(path.stem for path in mission.sizes_bytes))),
        logs=tuple(clean(str(path)) for path in mission.sizes_bytes),
        start_s=tally.first_s,
        stop_s=tally.last_s,
        track_latitude_deg=gathered.track.latitude_deg,
        track_longitude_deg=gathered.track.longitude_deg,
        distance_m=tally.distance_m,
        covered_km2=totals["covered_km2"],
        wall_s=processing_s,
        config_yaml=config_yaml(config),
        costs=costs_s,
        searched=searched.get("searched", {}),
        clearance_png=clearance_map,
        files=_FILES + (("clearance.png",) if clearance_map else ()),
        map_picture=map_picture(gathered.mosaic),
        verdicts=judged,
    )
    shown = report_contents(
        record, contacts, gathered.coverage, waypoints, gathered.notices, counters, gathered.pictures
    )
    write_contents(folder, shown)
    write_report(folder / REPORT, record, contacts, gathered.coverage, waypoints, gathered.notices, counters, shown)
    summary: dict[str, Any] = {
        "version": __version__,
        "mission": config.mission,
        "logs": [
            {"path": str(path.absolute()), "bytes": size, "relative": os.path.relpath(path, folder)}
            for path, size in mission.sizes_bytes.items()
        ],
        **({"bottom_lines": lines} if (lines := [line.entry() for line in mission.bottom_lines]) else {}),
        **totals,
        "waypoints": len(waypoints),
        "counters": dict(sorted(counters.items())),
        "places": pipeline.places,
        **notice_lists(gathered.notices),
        "processing_s": round(processing_s, 3),
        "times_real_time": round(tally.duration_s / processing_s, 1) if processing_s > 0.0 else None,
        "costs_s": {stage: round(cost_s, 4) for stage, cost_s in costs_s.items()},
        "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, 1),
        "kernels": kernels.backend(),
        "threads": threads,
        "exhaustive": without_skips == ALL_SKIPS,
        "without_skips": sorted(without_skips),
        "config": msgspec.to_builtins(config),
    }
    write_json(folder / "summary.json", summary)
    return summary


class _Track:
    """Keep positions along the track, NaN where it breaks, thinned so that a mission of any length leaves a few
    thousand.
    """

    def __init__(self) -> None:
        self._points: list[NDArray[np.float64]] = []
        self._every = 8  # grid rows, about a metre
        self._side: Side | None = None
        self._next_row = 0

    def add(self, tile: Tile) -> None:
        self._side = self._side or tile.side
        if tile.side != self._side:
            return
        first_row = tile.first_row + tile.core_start
        if first_row != self._next_row:
            self._points.append(np.full((1, 2), np.nan))
        self._next_row = tile.first_row + tile.core_stop
        core = slice(tile.core_start, tile.core_stop, self._every)
        points = np.column_stack([tile.pose.latitude_deg[core], tile.pose.longitude_deg[core]])
        points[tile.pose.stale[core]] = np.nan
        self._points.append(points)
        if sum(map(len, self._points)) > MAX_TRACK_POINTS:
            self._points = [np.concatenate(self._points)[::2]]
            self._every *= 2

    @property
    def latitude_deg(self) -> NDArray[np.float64]:
        return self._all()[:, 0]

    @property
    def longitude_deg(self) -> NDArray[np.float64]:
        return self._all()[:, 1]

    def geometry(self) -> Json:
        """Draw the stretches of the track as lines, None if there is none."""
        points = self._all()[:, ::-1]
        known = np.isfinite(points).all(axis=1)
        stretches = np.split(points, np.flatnonzero(np.diff(known)) + 1)
        lines = [line for line in stretches if len(line) > 1 and np.isfinite(line).all()]
        pieces: list[Json] = [positions_of(piece) for line in lines for piece in split_line(line)]
        return one_or_multi("LineString", pieces) if pieces else None

    def _all(self) -> NDArray[np.float64]:
        return np.concatenate([np.empty((0, 2)), *self._points])


class _Gathered:
    """Gather what the pipeline reported, as far as the results need it; tiles leave only small pictures."""

    def __init__(self, config: Config, found: Callable[[Contact], None]) -> None:
        self._found = found
        self.coverage: list[CoveragePatch] = []
        self.searched = ClearanceMap(configured_performance(config))
        self.notices: list[Notice] = []
        self.pictures = PictureCollector()
        self.track = _Track()
        self.mosaic = Mosaic(config, RESOLUTION_M, MAX_BLOCKS, coarsen=True)

    def add(self, events: Sequence[PipelineEvent]) -> None:
        for event in events:
            match event:
                case Tile():
                    self.pictures.add_tile(event)
                    self.track.add(event)
                    self.mosaic.add(event)
                case CoveragePatch():
                    self.coverage.append(event)
                    self.searched.add(event)
                case Contact():
                    self._found(event)
                case Notice():
                    self.notices.append(event)
