"""Write what an archive holds: `index.geojson` and `index.html`, over all missions and all objects."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import quote

import numpy as np

from auv_mcm.clean_text import clean
from auv_mcm.contacts.antimeridian import split_ring
from auv_mcm.contacts.geojson import (
    METRE_DIGITS,
    PROBABILITY_DIGITS,
    Json,
    collection_parts,
    feature,
    geojson_point,
    one_or_multi,
    positions_of,
    rounded,
)
from auv_mcm.geometry.geodesy import wrap_longitude_deg
from auv_mcm.safe_files import read_regular
from auv_mcm.settings.config import ContactsConfig
from auv_mcm.shell.whole_files import write_file, write_parts
from sim_replay.batch.missions import MISSIONS, MissionOutcome
from sim_replay.batch.objects_seen import CoveredPatch, SeenContact, SeenMission, SeenObject, objects_seen
from sim_replay.results_folder import summary_of

_MAX_ROWS: Final = 500  # rows of each table: bounds the page; index.geojson holds all
_MAP_WIDTH: Final = 1000.0  # units of the drawing
_MAP_MARGIN: Final = 20.0  # units
_MIN_FRAME: Final = 9.0  # units: of a mission that is small beside the distance to others, so that it can be seen
_MIN_SPAN_DEG: Final = 1e-3  # of the map, so that a single place has an extent: about 100 m
_LAST_TIME: Final = "~"  # after every time in ISO 8601: for a mission in which nothing was covered


class IndexedMission(NamedTuple):
    """Hold the figures of one mission.

    box_deg: west, south, east, north of its coverage, None without any; a side may lie beyond 180 degrees. repeats: the
    mission before it whose pings it holds again, as a copy of a log does; empty for its own.
    """

    name: str
    start: str
    stop: str
    summary: dict[str, Any]
    box_deg: tuple[float, float, float, float] | None
    repeats: str = ""


def write_index(out: Path, outcomes: Sequence[MissionOutcome], config: ContactsConfig) -> list[SeenObject]:
    """Join the contacts of all missions that were replayed; write both files, and return the objects.

    They hold no time and no figure of the run itself: the same results give the same bytes. Raises OSError.
    """
    replayed = [(outcome.log.name, outcome.folder) for outcome in outcomes if not outcome.failure]
    timed = [(_indexed(name, folder), folder) for name, folder in replayed]
    timed.sort(key=lambda one: (one[0].start or _LAST_TIME, one[0].name))
    missions = _repeats_named(timed)
    own = [one for one, mission in zip(timed, missions, strict=True) if not mission.repeats]
    seen = [SeenMission(mission.name, _contacts(folder)) for mission, folder in own]
    objects = objects_seen(seen, (_coverage(folder) for _, folder in own), config)
    failed = [outcome for outcome in outcomes if outcome.failure]
    write_parts(out / "index.geojson", collection_parts(_features(missions, failed, objects)))
    write_file(out / "index.html", _page(missions, failed, objects).encode("utf-8", "replace"))
    return objects


def object_id(number: int) -> str:
    """Name the object of this place in the order of first sighting, from 0."""
    return f"O{number + 1:05d}"


def _indexed(name: str, folder: Path) -> IndexedMission:
    times: list[str] = []
    box_deg: tuple[float, float, float, float] | None = None
    for properties, rings in _patches(folder):
        times += [time for time in (properties["start"], properties["stop"]) if time]
        for ring in rings:
            if box_deg is not None:
                ring[:, 0] = _near(ring[:, 0], box_deg[0])
            (west, south), (east, north) = ring.min(axis=0).tolist(), ring.max(axis=0).tolist()
            if box_deg is not None:
                west, south = min(west, box_deg[0]), min(south, box_deg[1])
                east, north = max(east, box_deg[2]), max(north, box_deg[3])
            box_deg = west, south, east, north
    summary = summary_of(folder)
    assert summary is not None, "a replay without failure has a summary"
    return IndexedMission(name, min(times, default=""), max(times, default=""), summary, box_deg)


def _repeats_named(timed: Sequence[tuple[IndexedMission, Path]]) -> list[IndexedMission]:
    """Find missions whose contacts and coverage are those of one before, with its times: copies of a log."""
    first: dict[tuple[str, ...], str] = {}
    found = []
    for mission, folder in timed:
        files = [read_regular(folder / f"{name}.geojson") for name in ("contacts", "coverage")]
        original = first.setdefault(tuple(sha256(file).hexdigest() for file in files), mission.name)
        is_copy = bool(mission.start) and original != mission.name
        found.append(mission._replace(repeats=original) if is_copy else mission)
    return found


def _patches(folder: Path) -> Iterator[tuple[dict[str, Any], list[Any]]]:
    """Read the patches of a mission one by one: their properties, and outlines (n, 2) of longitude and latitude."""
    for patch in json.loads(read_regular(folder / "coverage.geojson"))["features"]:
        geometry = patch["geometry"]
        if geometry is None:
            polygons = []
        elif geometry["type"] == "Polygon":
            polygons = [geometry["coordinates"]]
        else:
            polygons = geometry["coordinates"]
        yield patch["properties"], [np.array(polygon[0], dtype=np.float64) for polygon in polygons]


def _coverage(folder: Path) -> list[CoveredPatch]:
    return [
        CoveredPatch(ring, properties["evaluated_fraction"]) for properties, rings in _patches(folder) for ring in rings
    ]


def _contacts(folder: Path) -> tuple[SeenContact, ...]:
    contacts = []
    for found in json.loads(read_regular(folder / "contacts.geojson"))["features"]:
        properties = found["properties"]
        covariance = np.array(properties["covariance_m2"], dtype=np.float64)
        if found["geometry"] is None or not np.isfinite(covariance).all():
            continue
        longitude_deg, latitude_deg = found["geometry"]["coordinates"]
        contacts.append(
            SeenContact(
                id=properties["id"],
                latitude_deg=latitude_deg,
                longitude_deg=longitude_deg,
                covariance_m2=covariance,
                p_mine=properties["p_mine"],
                classification=properties["class"],
                called=bool(properties["called"]),
            )
        )
    return tuple(contacts)


def _features(
    missions: Sequence[IndexedMission], failed: Sequence[MissionOutcome], objects: Sequence[SeenObject]
) -> Iterator[dict[str, Json]]:
    for mission in missions:
        properties: dict[str, Json] = {
            "kind": "mission",
            "name": mission.name,
            "start": mission.start or None,
            "stop": mission.stop or None,
            "results": f"{MISSIONS}/{mission.name}",
            "repeats": mission.repeats or None,
            "failure": None,
        }
        figures = {name: mission.summary.get(name) for name in ("pings", "covered_km2", "contacts", "contacts_called")}
        yield feature(_box(mission.box_deg), properties | figures)
    for outcome in failed:
        failure: dict[str, Json] = {"kind": "mission", "name": outcome.log.name, "failure": clean(outcome.failure)}
        yield feature(None, failure)
    for number, one in enumerate(objects):
        likeliest = one.likeliest
        history: list[Json] = [
            {"mission": sighting.mission, "contact": None if sighting.contact is None else sighting.contact.id}
            for sighting in one.history
        ]
        yield feature(
            geojson_point(one.longitude_deg, one.latitude_deg),
            {
                "kind": "object",
                "id": object_id(number),
                "change": one.change,
                "p_mine": rounded(likeliest.p_mine, PROBABILITY_DIGITS),
                "class": likeliest.classification,
                "called": _is_called(one),
                "sigma_m": rounded(float(np.sqrt(np.linalg.eigvalsh(one.covariance_m2)[-1])), METRE_DIGITS),
                "history": history,
            },
        )


def _box(box_deg: tuple[float, float, float, float] | None) -> Json:
    if box_deg is None:
        return None
    west, south, east, north = box_deg
    ring = np.array([[west, south], [east, south], [east, north], [west, north], [west, south]])
    return one_or_multi("Polygon", [[positions_of(piece)] for piece in split_ring(ring)])


def _near(longitude_deg: Any, reference_deg: float) -> Any:
    """Shift longitudes by whole turns, so that they lie within half a turn of a reference."""
    return reference_deg + wrap_longitude_deg(longitude_deg - reference_deg)


def _is_called(one: SeenObject) -> bool:
    return any(sighting.contact is not None and sighting.contact.called for sighting in one.history)


def _page(missions: Sequence[IndexedMission], failed: Sequence[MissionOutcome], objects: Sequence[SeenObject]) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    template = Environment(
        loader=PackageLoader("sim_replay.batch", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    ).get_template("index.html.j2")
    called = [(object_id(number), one) for number, one in enumerate(objects) if _is_called(one)]
    called.sort(key=lambda pair: (-pair[1].likeliest.p_mine, pair[0]))
    place = _Map(missions, objects)
    return template.render(
        missions=missions[:_MAX_ROWS],
        n_missions=len(missions),
        failed=[(outcome.log.name, clean(outcome.failure)) for outcome in failed],
        called=called[:_MAX_ROWS],
        n_called=len(called),
        n_objects=len(objects),
        changes=Counter(one.change for _, one in called),
        report=lambda name, contact="": (
            quote(os.fsencode(f"{MISSIONS}/{name}/report.html")) + (f"#{contact}" if contact else "")
        ),
        place=place,
        clean=clean,
    )


class _Map:
    """Place longitudes and latitudes on a drawing that is true to scale at its middle."""

    def __init__(self, missions: Sequence[IndexedMission], objects: Sequence[SeenObject]) -> None:
        boxes = [mission.box_deg for mission in missions if mission.box_deg is not None]
        corners = [corner for west, south, east, north in boxes for corner in ((west, south), (east, north))]
        points = np.array(corners + [(one.longitude_deg, one.latitude_deg) for one in objects]).reshape(-1, 2)
        self.is_empty = not len(points)
        self._reference = 0.0 if self.is_empty else float(points[0, 0])
        points[:, 0] = _near(points[:, 0], self._reference)
        self._west = float(points[:, 0].min(initial=self._reference + 180.0))
        self._north = float(points[:, 1].max(initial=-90.0))
        span_deg = np.ptp(points, axis=0) if len(points) else np.zeros(2)
        narrowing = np.cos(np.radians(self._north - 0.5 * span_deg[1]))
        width_deg, height_deg = np.maximum(span_deg * (narrowing, 1.0), _MIN_SPAN_DEG)
        self._down_per_deg = (_MAP_WIDTH - 2.0 * _MAP_MARGIN) / max(width_deg, height_deg)
        self._right_per_deg = self._down_per_deg * narrowing
        self.width = width_deg * self._down_per_deg + 2.0 * _MAP_MARGIN
        self.height = height_deg * self._down_per_deg + 2.0 * _MAP_MARGIN

    def frame(self, box_deg: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        """Return left, top, width and height of a mission's outline, large enough to be seen and clicked."""
        west, south, east, north = box_deg
        left, top = self.right(west), self.down(north)
        width, height = self.right(east) - left, self.down(south) - top
        wider, taller = max(_MIN_FRAME - width, 0.0), max(_MIN_FRAME - height, 0.0)
        return left - wider / 2.0, top - taller / 2.0, width + wider, height + taller

    def right(self, longitude_deg: float) -> float:
        """Return the units from the left edge."""
        return float(_MAP_MARGIN + (_near(longitude_deg, self._reference) - self._west) * self._right_per_deg)

    def down(self, latitude_deg: float) -> float:
        """Return the units from the top edge."""
        return float(_MAP_MARGIN + (self._north - latitude_deg) * self._down_per_deg)
