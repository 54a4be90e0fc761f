"""Read what a folder of results or of a session holds, finished or still growing, for the page that shows it."""

from __future__ import annotations

import json
import math
import os
import time
from datetime import datetime
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from auv_mcm.clean_text import clean
from auv_mcm.contacts.contact_words import ContactWords, feature_words
from auv_mcm.errors import AuvMcmError, BadInputError
from auv_mcm.safe_files import open_regular
from auv_mcm.settings.config import Config
from auv_mcm.shell.health.files import HEALTH, read_health
from sim_replay.verdicts import Place, Verdict
from sim_replay.view.waterfall_store import Seen

SUMMARY: Final = "summary.json"
CONTACTS: Final = "contacts.geojson"
TRACK: Final = "track.geojson"
JOURNAL: Final = "contacts.jsonl"
_MAX_JSON_BYTES: Final = 256 << 20  # bytes of one file: 100 000 contacts with all their views


class Overview(NamedTuple):
    """Hold a contact in short; NaN for what is not known.

    time_s: of its best view's pass, which `side` and `ground_range_m` belong to.
    """

    id: str
    place: Place
    p_mine: float
    said: ContactWords
    called: bool | None
    length_m: float
    side: str
    ground_range_m: float
    time_s: float

    @property
    def seen(self) -> Seen:
        """Return when, on which side and where it was seen."""
        return Seen(self.time_s, self.side, self.place.latitude_deg, self.place.longitude_deg)


class ContactFile:
    """Read the contacts of a folder again whenever its files have changed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._state: tuple[Any, ...] = ()
        self._journal_bytes = 0
        self._is_whole = False
        self.version = 0
        """Counts changes."""
        self.features: dict[str, dict[str, Any]] = {}
        """GeoJSON features as written, by contact id, in the order of ids."""

    def refresh(self) -> bool:
        """Read what is new. A journal's lines are read once each; contacts.geojson counts once the mission has ended.

        Returns whether another replay's contacts took the place of those before, so that an id may be of another one.
        Raises BadInputError for a damaged file.
        """
        whole, journal = self._folder / CONTACTS, self._folder / JOURNAL
        has_ended = not journal.exists() or (self._folder / SUMMARY).exists()  # else it may be of an earlier start
        state = (file_stamp(whole) if has_ended else None, file_stamp(journal))
        if state == self._state:
            return False
        is_other = False
        if state[0] is not None:
            if not self._state or state[0] != self._state[0]:
                is_other = self._is_whole
                self._take(_features(whole))
                self._is_whole = True
        elif state[1] is not None:
            if self._is_whole or state[1][1] < self._journal_bytes:
                is_other, self._is_whole = True, False
                self._journal_bytes, self.features = 0, {}
            self._read_journal(journal)
        self._state = state
        return is_other

    def _read_journal(self, path: Path) -> None:
        with open_regular(path) as file:
            file.seek(self._journal_bytes)
            data = file.read()
        whole = data.rfind(b"\n") + 1
        self._journal_bytes += whole
        found = dict(self.features)
        for line in data[:whole].splitlines():
            try:
                feature = json.loads(line)["contact"]
                found[str(feature["properties"]["id"])] = feature
            except (ValueError, KeyError, TypeError):
                continue  # of another version, or damaged: the service's own files say more
        self._take(list(found.values()))

    def _take(self, features: list[dict[str, Any]]) -> None:
        by_id = {str(feature["properties"]["id"]): feature for feature in features}
        self.features = dict(sorted(by_id.items()))
        self.version += 1


def overview(feature: dict[str, Any]) -> Overview:
    """Take from a contact's feature what lists and maps show; NaN for what is not known."""
    properties = feature["properties"]
    geometry = feature.get("geometry") or {}
    longitude, latitude = (geometry.get("coordinates") or [None, None])[:2]
    name = clean(str(properties["id"]))
    views = properties.get("views") or []
    side, ground_range_m = properties.get("side"), properties.get("ground_range_m")
    shown = next(
        (view for view in views if view.get("side") == side and view.get("ground_range_m") == ground_range_m),
        views[0] if views else {},
    )
    return Overview(
        id=name,
        place=Place(name, number(latitude), number(longitude), number(properties.get("sigma_m"))),
        p_mine=number(properties.get("p_mine")),
        said=feature_words(properties),
        called=properties.get("called"),
        length_m=number(properties.get("length_m")),
        side=side if side in ("port", "starboard") else "",
        ground_range_m=number(ground_range_m),
        time_s=time_s(shown.get("time") or properties.get("time")),
    )


def shown_verdict(verdict: Verdict) -> dict[str, Any]:
    """Take from a verdict what lists and maps show."""
    return {
        "object": verdict.object,
        "call": verdict.call,
        "type": verdict.type,
        "comment": verdict.comment,
        "by": verdict.by,
        "time": verdict.time,
        "drawn": verdict.drawn,
        "latitude": verdict.latitude_deg,
        "longitude": verdict.longitude_deg,
        "across": None
        if verdict.ground_range_m is None
        else -verdict.ground_range_m
        if verdict.side == "port"
        else verdict.ground_range_m,
        "length_m": verdict.length_m,
        "width_m": verdict.width_m,
        "height_m": verdict.height_m,
        "shadow_length_m": verdict.shadow_length_m,
    }


def time_s(text: Any) -> float:
    """Read an ISO 8601 time as UTC seconds since 1970, NaN if it is none."""
    try:
        return datetime.fromisoformat(str(text)).timestamp()
    except ValueError:
        return math.nan


def track_of(folder: Path) -> dict[str, Any]:
    """Read the track that results hold, for a map without a waterfall; its stretches are apart by None."""
    path = folder / TRACK
    positions: list[Any] = []
    if path.exists():
        found = read_json(path)
        try:
            for geometry in (feature["geometry"] for feature in found["features"] if feature["geometry"]):
                lines = geometry["coordinates"] if geometry["type"] == "MultiLineString" else [geometry["coordinates"]]
                for line in lines:
                    positions += [*line, (None, None)]
        except (KeyError, TypeError) as error:
            raise BadInputError(f"{path} holds no track as auv-mcm writes it. Replay the log again.") from error
    return {
        "row": list(range(len(positions))),
        "latitude": [position[1] for position in positions],
        "longitude": [position[0] for position in positions],
        "time": [None] * len(positions),
    }


def read_summary(folder: Path) -> dict[str, Any] | None:
    """Read summary.json, None if it is not there (yet). Raises BadInputError for one that is damaged."""
    path = folder / SUMMARY
    if not path.exists():
        return None
    found = read_json(path)
    if not isinstance(found, dict):
        raise BadInputError(f"{path} is not the summary of a mission. Replay the log again.")
    return found


def is_silent(session: Path) -> bool:
    """Find whether a session's record of health is too old: its service ended without a summary, or hangs."""
    try:
        return read_health(session / HEALTH).is_late(time.time())
    except AuvMcmError:
        return False  # none yet


def summary_config(summary: dict[str, Any], place: Path) -> Config:
    """Read the configuration in a summary. Raises BadInputError for one of another version."""
    try:
        return msgspec.convert(summary.get("config", {}), Config)
    except (msgspec.ValidationError, AuvMcmError) as error:
        raise BadInputError(
            f"{place / SUMMARY} was written by another version: {error}. Replay the log again, or give --config."
        ) from error


def read_json(path: Path) -> Any:
    """Read a file of JSON. Raises BadInputError naming it."""
    try:
        with open_regular(path) as file:
            if os.fstat(file.fileno()).st_size > _MAX_JSON_BYTES:
                raise BadInputError(f"{path} is larger than {_MAX_JSON_BYTES} bytes. Show a part of the mission.")
            return json.loads(file.read())
    except OSError as error:
        raise BadInputError(f"{path} cannot be read: {error.strerror}. Check its permissions.") from error
    except (ValueError, RecursionError) as error:
        raise BadInputError(f"{path} is not JSON: {error}. Replay the log again.") from error


def _features(path: Path) -> list[dict[str, Any]]:
    try:
        features = read_json(path)["features"]
        for feature in features:
            feature["properties"]["id"]
    except (KeyError, TypeError) as error:
        raise BadInputError(f"{path} holds no contacts as auv-mcm writes them. Replay the log again.") from error
    return list(features)


def file_stamp(path: Path) -> tuple[int, int] | None:
    """Return what a file has another of once it was written, None if it is not there."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def number(value: Any) -> float:
    """Read a number of a file, NaN for anything else."""
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
