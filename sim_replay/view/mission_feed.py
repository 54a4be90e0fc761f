"""Make the waterfall of a mission for the page: from its logs, or from a session's recording as it grows."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm.contacts.geojson import Json
from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.errors import AuvMcmError
from auv_mcm.model_file import NONE
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import CoveragePatch, Notice, Ping, PipelineEvent, SourceEvent, Tile
from auv_mcm.settings.config import Config, ConfirmConfig, DetectConfig
from auv_mcm.waterfall.radiometry import LOCAL_MEAN_REACH_M
from sim_replay.logs.port_log import PortLog
from sim_replay.logs.recorded import RecordedMission, open_mission
from sim_replay.logs.session_reader import recorded_config
from sim_replay.view.growing_session import GrowingSession
from sim_replay.view.water_column import WaterColumn
from sim_replay.view.waterfall_store import WaterfallStore

log = logging.getLogger(__name__)

_TILE_ROWS: Final = 64
"""Rows of a tile here: a picture comes every 8 m of track instead of 61, at the same cost (87 times real time for both
on the demo scene, 2 cores)."""

_FIRST_PINGS: Final = 64
"""Pings of the first picture: those that the law of samples needs. Rows of the whole come after up to 512, and 20 m."""
_FIRST_EVENTS: Final = 4096  # newest ones kept for it: 64 pings of 1 Hz among navigation of 60 Hz; chosen


class OpenedMission(NamedTuple):
    """Hold the events of a mission, the configuration they are processed with, and what gives the fraction read.

    recorded: the logs they come from; None for a session that may still grow.
    """

    config: Config
    events: Iterable[SourceEvent]
    fraction_done: Callable[[], float]
    recorded: RecordedMission | None = None


class MissionFeed:
    """Fill a store with the waterfall of a mission, in a thread of its own."""

    def __init__(self, store: WaterfallStore, open_events: Callable[[threading.Event], OpenedMission | None]) -> None:
        """open_events: opens the mission, in the thread; None if there is none. It may wait until the event is set."""
        self.store = store
        """The waterfall over ground range."""
        self.slant = WaterfallStore()
        """The same rows over slant range: the water column and the first bottom return."""
        self._settled = self.store, self.slant  # others stand in for them until they have rows
        self.recorded: RecordedMission | None = None
        self.config = Config()
        self._open_events = open_events
        self._stop = threading.Event()
        self._fraction: Callable[[], float] = lambda: 0.0
        self.is_done = False
        """Whether everything there is was read."""
        self.problem = ""
        """Why there is no waterfall, or none any more, for a person."""
        self.coverage: list[list[list[Json]]] = []
        """Polygons [ring][longitude, latitude] of sea floor seen well enough, by the pictures alone."""
        self.n_pings = 0
        self._thread = threading.Thread(target=self._run, name="mission-feed", daemon=True)

    @property
    def fraction_done(self) -> float:
        """Return how much of the logs has been read, 0..1."""
        return 1.0 if self.is_done else min(1.0, self._fraction())

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def close(self) -> None:
        """End reading, and wait for that."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        for store in self._settled:
            store.close()

    def join(self) -> None:
        """Wait until everything was read."""
        self._thread.join()

    def _run(self) -> None:
        try:
            opened = self._open_events(self._stop)
            if opened is not None:
                self.config, events, self._fraction, self.recorded = opened
                self._read(events)
        except (AuvMcmError, OSError) as error:
            self.problem = str(error)
            log.warning("no waterfall: %s", error)
        self.is_done = True

    def _read(self, events: Iterable[SourceEvent]) -> None:
        pipeline = self._pipeline()
        column = WaterColumn(self.config.waterfall.column_spacing_m, self.config.sonar.max_range_m)
        first: deque[SourceEvent] = deque(maxlen=_FIRST_EVENTS)
        for event in events:
            if self._stop.is_set():
                return
            if isinstance(event, Ping):
                self.n_pings += 1
                column.add_ping(event)
            self._take(pipeline.feed(event), column)
            if self.n_pings <= _FIRST_PINGS:
                first.append(event)
                if isinstance(event, Ping) and self.n_pings == _FIRST_PINGS and not self.store.stop_row:
                    self._show_first(first, column)
        self._take(pipeline.finish(), column)
        self.store, self.slant = self._settled

    def _pipeline(self) -> Pipeline:
        """Prepare the chain up to pictures and coverage, which needs no model."""
        config = Config(
            sonar=self.config.sonar,
            navigation=self.config.navigation,
            waterfall=msgspec.structs.replace(self.config.waterfall, tile_rows=_TILE_ROWS),
            detect=DetectConfig(model=NONE, gate=NONE),
            confirm=ConfirmConfig(enabled=False),
        )
        nothing = TileDetections((), 0, 0)
        return Pipeline(config, detect=lambda tile: nothing, seabed=lambda tile: None, overlap_m=LOCAL_MEAN_REACH_M)

    def _show_first(self, events: Iterable[SourceEvent], column: WaterColumn) -> None:
        """Show what the chain sees of these events alone, until it has settled on rows of the whole."""
        pipeline = self._pipeline()
        found = [made for event in events for made in pipeline.feed(event)]
        store, slant = (WaterfallStore(is_provisional=True) for _ in range(2))
        _draw([*found, *pipeline.finish()], column, store, slant)
        if store.stop_row:
            self.store, self.slant = store, slant

    def _take(self, events: list[PipelineEvent], column: WaterColumn) -> None:
        _draw(events, column, *self._settled)
        if self._settled[0].stop_row >= max(self.store.stop_row, 1):
            self.store, self.slant = self._settled
        for event in events:
            if isinstance(event, CoveragePatch):
                self.coverage += [np.round(ring, 7).tolist() for ring in event.rings_deg]  # 1e-7 degrees: 1 cm
            elif isinstance(event, Notice):
                log.debug("%s", event.text)


def _draw(events: list[PipelineEvent], column: WaterColumn, store: WaterfallStore, slant: WaterfallStore) -> None:
    for event in events:
        if isinstance(event, Tile):
            store.add(event)
            column.add_tile(event, slant)


def open_logs(paths: list[Path], config: Config) -> OpenedMission:
    """Open finished logs, and warn of those that are left out. Raises UsageError or BadInputError."""
    mission = open_mission(paths, config)
    for notice in mission.notices:
        log.warning("%s", notice.text)
    return OpenedMission(config, mission.events(), lambda: mission.fraction_done, mission)


def follow_session(folder: Path, config: Config | None, stop: threading.Event) -> OpenedMission | None:
    """Open the recording in a session's folder, once it has begun, and follow it; None if it was stopped before.

    Parameters
    ----------
    folder
        Of the session.
    config
        To process it with; None for what it was recorded with.
    stop
        Ends waiting and following.

    Raises
    ------
    BadInputError
        For a recording of another version.
    """
    from drivers.port_intake import PortIntake

    session = GrowingSession(folder, stop)
    head = session.wait_for_head()
    if head is None:
        return None
    recorded = recorded_config(head)
    used = recorded if config is None else config
    ports = used if used.ports else msgspec.structs.replace(used, ports=recorded.ports)
    return OpenedMission(used, PortLog(session, lambda: PortIntake(ports)), lambda: 0.0)
