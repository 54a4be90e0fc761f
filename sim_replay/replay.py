"""Replay a recorded mission through the pipeline, in this process, into a folder of results."""

from __future__ import annotations

import math
import resource
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clean_text import clean
from auv_mcm.clearance.clearance_map import ClearanceMap
from auv_mcm.clearance.clearance_picture import clearance_png
from auv_mcm.clearance.detection_performance import configured_performance
from auv_mcm.clock import Clock, SystemClock
from auv_mcm.contacts.antimeridian import split_line
from auv_mcm.contacts.contact import best_view
from auv_mcm.contacts.contact_picture import snippet_png
from auv_mcm.contacts.geojson import Json, collection, feature, one_or_multi, positions_of
from auv_mcm.memory import return_freed_memory, return_large_arrays
from auv_mcm.pipeline import Pipeline
from auv_mcm.program import made_with
from auv_mcm.records import Contact, CoveragePatch, Notice, PipelineEvent, Side, Tile
from auv_mcm.settings.config import Config, config_yaml
from auv_mcm.shell.mission_totals import clearance_notices, notice_lists
from auv_mcm.shell.results import MissionResults, plan_waypoints
from auv_mcm.shell.snippet_files import make_results_directory, write_snippets
from auv_mcm.shell.tally import Tally
from auv_mcm.shell.whole_files import write_file, write_json
from auv_mcm.skips import ALL_SKIPS, NO_SKIPS, Skips
from sim_replay.logs.open_log import CHUNK_BYTES
from sim_replay.logs.recorded import Pace, RecordedMission, open_mission
from sim_replay.mosaic import Mosaic
from sim_replay.report import MissionRecord, PictureCollector, Shown, write_report
from sim_replay.report.map_picture import MAX_BLOCKS, RESOLUTION_M, map_picture
from sim_replay.report.report_file import REPORT, report_contents, write_contents
from sim_replay.results_folder import kept_alone, log_entry
from sim_replay.verdicts import Verdict, read_verdicts

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
    waits: bool = False,
) -> dict[str, Any]:
    """Replay `logs`, or a recorded session of ports, as one mission and write every result into `folder`.

    Results of an earlier replay are replaced. Returns what summary.json holds.

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
    waits
        For another replay that writes to the folder, instead of raising UsageError.

    Raises
    ------
    UsageError
        For a folder that cannot be written to or is in use, BadInputError for logs or verdicts that cannot be read.
    """
    clock = clock or SystemClock()
    judged = read_verdicts(verdicts or folder)
    mission = open_mission(logs, config, chunk_bytes)
    return_large_arrays()
    pipeline = Pipeline(config, without_skips=without_skips, threads=threads, timer=clock.monotonic_s)
    replaying = _Replaying(mission, pipeline, config, found)  # reads tables: what is refused leaves no folder
    make_results_directory(folder)
    with kept_alone(folder, waits=waits):
        # written last: its presence says that the other files belong together
        (folder / "summary.json").unlink(missing_ok=True)
        replaying.run(Pace(speed, clock), clock, progress)
        summary = replaying.write(folder, judged) | {
            "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, 1),
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


class _Replaying:
    """Feed the pipeline a mission, and gather what it reports as far as the results need it; tiles leave only small
    pictures.
    """

    def __init__(
        self, mission: RecordedMission, pipeline: Pipeline, config: Config, found: Callable[[Contact], None]
    ) -> None:
        self._mission, self._pipeline, self._config, self._found = mission, pipeline, config, found
        self._tally = Tally()
        self._coverage: list[CoveragePatch] = []
        self._searched = ClearanceMap(configured_performance(config), config.plan.area_deg)
        self._notices: list[Notice] = []
        self._pictures = PictureCollector()
        self._track = _Track()
        self._mosaic = Mosaic(config, RESOLUTION_M, MAX_BLOCKS, coarsen=True, errors=False)
        self._processing_s = 0.0
        self._costs_s: dict[str, float] = {}  # of each stage, in the order to show them

    def run(self, pace: Pace, clock: Clock, progress: Progress) -> None:
        """Work off the whole mission."""
        mission, read_total_s, pictures_s = self._mission, 0.0, 0.0
        started_s = read_s = clock.monotonic_s()
        for event in mission.events():
            read_total_s += clock.monotonic_s() - read_s
            if (wait_s := pace.wait_s(event)) > 0.0:
                time.sleep(wait_s)
            self._tally.add(event)
            if events := self._pipeline.feed(event):
                fed_s = clock.monotonic_s()
                self._add(events)
                pictures_s += clock.monotonic_s() - fed_s
            progress(mission.fraction_done)
            read_s = clock.monotonic_s()
        events = self._pipeline.finish()
        fed_s = clock.monotonic_s()
        self._add(events)
        pictures_s += clock.monotonic_s() - fed_s
        self._processing_s = clock.monotonic_s() - started_s
        self._costs_s = {"read": read_total_s, **self._pipeline.costs_s, "pictures": pictures_s}

    def write(self, folder: Path, judged: Sequence[Verdict]) -> dict[str, Any]:
        """Write every result but summary.json, of which the first entries are returned."""
        return_freed_memory()  # of tiles: the report takes its place
        contacts = sorted(self._pipeline.contacts, key=lambda contact: contact.id)
        counters = self._mission.counters() + self._pipeline.counters
        waypoints = plan_waypoints(contacts, self._tally, self._config, counters)
        clearance = self._searched.snapshot()
        png = b"" if clearance is None else clearance_png(clearance)
        point = self._pipeline.operating_point
        results = MissionResults(contacts, self._coverage, waypoints, self._tally, point, clearance, png)
        for write in results.writers(folder, self._config.mission).values():
            write()
        write_snippets(
            folder, {contact.id: snippet_png(view) for contact in contacts if (view := best_view(contact)) is not None}
        )
        write_file(folder / "track.geojson", collection([feature(self._track.geometry(), {})]))
        self._add(clearance_notices(clearance))
        totals, took_s = results.totals(self._config.plan), self._processing_s
        record = self._record(totals, png, judged)
        shown = Shown(record, contacts, self._coverage, waypoints, self._notices, counters, self._pictures)
        kept = report_contents(shown)
        write_contents(folder, kept)
        write_report(folder / REPORT, shown._replace(pictures=kept))
        return {
            **made_with(),
            "mission": self._config.mission,
            **self._origin(folder),
            **totals,
            "counters": dict(sorted(counters.items())),
            "places": self._pipeline.places,
            **notice_lists(self._notices),
            "processing_s": round(took_s, 3),
            "times_real_time": round(self._tally.duration_s / took_s, 1) if took_s > 0.0 else None,
            "costs_s": {stage: round(cost_s, 4) for stage, cost_s in self._costs_s.items()},
        }

    def _origin(self, folder: Path) -> dict[str, Any]:
        """Name the logs, and the bottom lines that came with them."""
        logs = [log_entry(path, size, folder) for path, size in self._mission.sizes_bytes.items()]
        lines = [line.entry() for line in self._mission.bottom_lines]
        return {"logs": logs, **({"bottom_lines": lines} if lines else {})}

    def _record(self, totals: Mapping[str, Any], picture: bytes, judged: Sequence[Verdict]) -> MissionRecord:
        """Describe the mission for its report. picture: of the clearance, empty without one."""
        tally, track, paths = self._tally, self._track, self._mission.sizes_bytes
        return MissionRecord(
            name=clean(self._config.mission or ", ".join(dict.fromkeys(path.stem for path in paths))),
            logs=tuple(clean(str(path)) for path in paths),
            start_s=tally.first_s,
            stop_s=tally.last_s,
            duration_s=tally.duration_s,
            track_latitude_deg=track.latitude_deg,
            track_longitude_deg=track.longitude_deg,
            distance_m=tally.distance_m,
            covered_km2=totals["covered_km2"],
            wall_s=self._processing_s,
            config_yaml=config_yaml(self._config),
            costs=self._costs_s,
            searched=totals.get("searched", {}),
            clearance_png=picture,
            files=_FILES + (("clearance.png",) if picture else ()),
            map_picture=map_picture(self._mosaic),
            verdicts=tuple(judged),
        )

    def _add(self, events: Sequence[PipelineEvent]) -> None:
        for event in events:
            match event:
                case Tile():
                    self._pictures.add_tile(event)
                    self._track.add(event)
                    self._mosaic.add(event)
                case CoveragePatch():
                    self._coverage.append(event)
                    self._searched.add(event)
                case Contact():
                    self._found(event)
                case Notice():
                    self._notices.append(event)
