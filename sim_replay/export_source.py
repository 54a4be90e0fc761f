"""Find what an export is made of: recorded logs, their configuration, and results that lie beside them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Tile
from auv_mcm.safe_files import read_regular
from auv_mcm.settings.config import Config
from auv_mcm.shell.recovery import EARLY_JOURNAL, JOURNAL, SUMMARY
from auv_mcm.waterfall.radiometry import REFERENCE_PINGS
from sim_replay.logs.bottom_lines import bottom_line_path
from sim_replay.logs.image_sidecar import sidecar_path
from sim_replay.logs.open_log import logs_config
from sim_replay.logs.recorded import open_mission
from sim_replay.logs.session_parts import recordings_of, session_of
from sim_replay.report.report_file import REPORT_CONTENTS
from sim_replay.results_folder import named_path, resolved_log
from sim_replay.verdicts import VERDICTS_FILE

CONTACTS: Final = "contacts.geojson"
TRACK: Final = "track.geojson"
_KEPT: Final = {
    *(CONTACTS, TRACK, "coverage.geojson", "clearance.geojson", "waypoints.geojson", SUMMARY),
    *(REPORT_CONTENTS, VERDICTS_FILE, JOURNAL, EARLY_JOURNAL),
}


class ExportSource(NamedTuple):
    """Name the logs of a mission, the configuration to read them with, and the folder of its results if there is one.

    The logs may be gone where only the results are needed.
    """

    logs: tuple[Path, ...]
    config: Config
    results: Path | None

    def keeps(self, path: Path) -> bool:
        """Check whether a path is a log or what belongs to it, or a file of the results that exports are made of."""
        place = path.resolve()
        if place in (file.resolve() for log in self.logs for file in (sidecar_path(log), bottom_line_path(log))):
            return True
        recordings = [part.resolve() for log in self.logs for part in (log, *recordings_of(log))]
        if place in recordings or any(part.is_dir() and part in place.parents for part in recordings[1:]):
            return True
        return self.results is not None and place.parent == self.results.resolve() and place.name in _KEPT


def find_source(paths: Sequence[Path], config: Config | None) -> ExportSource:
    """Find out what the paths are: results of a replay, the folder of a session, or logs.

    config: serves in place of that of the replay or the session. Raises UsageError or BadInputError.
    """
    folder = session_of(paths[0])
    if len(paths) == 1 and recordings_of(folder):
        used = config or logs_config([folder]) or Config()
        has_ended = all((folder / name).is_file() for name in (SUMMARY, CONTACTS))
        return ExportSource((folder,), used, folder if has_ended else None)
    if len(paths) == 1 and (folder / SUMMARY).is_file():
        return _replayed(folder, config)
    for path in paths:
        if (path / SUMMARY).is_file():
            raise UsageError(f"{path} is a folder of results, which is exported by itself. Name it alone.")
    return ExportSource(tuple(paths), config or logs_config(list(paths)) or Config(), None)


def tiles(
    source: ExportSource,
    progress: Callable[[float], None] = lambda fraction: None,
    reference_pings: float = REFERENCE_PINGS,
) -> Iterator[Tile]:
    """Read the logs and make the tiles of the waterfall, without looking for anything in them.

    Parameters
    ----------
    source
        Of the logs.
    progress
        Called with the fraction done, 0..1.
    reference_pings
        Of the tiles' levels, as of `Waterfall`.

    Raises
    ------
    BadInputError
        If nothing can be read.
    """
    missing = [path for path in source.logs if not path.exists()]
    if missing:
        raise BadInputError(
            f"{missing[0]}, which these results were made of, is not there any more. Name the log itself."
        )
    mission = open_mission(source.logs, source.config)
    pipeline = Pipeline(
        source.config,
        detect=lambda tile: TileDetections((), 0, 0),
        seabed=lambda tile: None,
        reference_pings=reference_pings,
    )
    for event in mission.events():
        yield from (made for made in pipeline.feed(event) if isinstance(made, Tile))
        progress(mission.fraction_done)
    yield from (made for made in pipeline.finish() if isinstance(made, Tile))


def _replayed(folder: Path, config: Config | None) -> ExportSource:
    path = folder / SUMMARY
    try:
        summary = json.loads(read_regular(path))
        logs = tuple(_log_of(log, folder) for log in summary.get("logs", ()))
        used = config or (msgspec.convert(summary["config"], Config) if "config" in summary else Config())
    except (OSError, ValueError, KeyError, TypeError, AttributeError, msgspec.ValidationError) as error:
        raise BadInputError(f"{path} cannot be read: {error}. Replay the log again.") from error
    return ExportSource(logs, used, folder)


def _log_of(entry: dict[str, str], folder: Path) -> Path:
    try:
        return resolved_log(entry, folder)
    except FileNotFoundError:
        return named_path(entry)  # which is missed only where the log itself is needed
