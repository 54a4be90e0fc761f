"""Sort the features of a folder of results into layers, and write them as GPX 1.1 (topografix.com/GPX/1/1)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

from auv_mcm.clean_text import clean
from auv_mcm.errors import BadInputError
from auv_mcm.safe_files import read_regular
from auv_mcm.shell.whole_files import write_file
from sim_replay.structures import STRUCTURES, with_structures
from sim_replay.verdict_layers import MISSED, is_likely, verdict_words, with_verdicts
from sim_replay.verdicts import read_verdicts

_WHOLE: Final = ("contacts", "track", "coverage", "clearance")
_WAYPOINTS: Final = "waypoints"
_NEEDED: Final = {"contacts": ("id", "p_mine", "class", "views")}
_DATUM: Final = "WGS 84; depths are of the sea floor below the surface at the time, not reduced for tide"
_EASTERNMOST_DEG: Final = 179.999999999  # 180 itself is not allowed (GPX 1.1, longitudeType); 0.1 mm

Feature = Mapping[str, Any]


def read_layers(results: Path) -> dict[str, Sequence[Feature]]:
    """Read the GeoJSON files of a folder of results: one layer each, way-points one for each purpose.

    `second_views` and `survey_legs` are lines, `waypoints_turn` and the like points. Files that are not there are left
    out. Contacts carry the verdicts of people; `missed_contacts` are objects that only people saw, `structures`
    contacts that crowd together. Raises BadInputError for a file that cannot be read, or if there are no results.
    """
    layers: dict[str, Sequence[Feature]] = {}
    for name in (*_WHOLE, _WAYPOINTS):
        path = results / f"{name}.geojson"
        if not path.is_file():
            continue
        try:
            features: list[Feature] = json.loads(read_regular(path))["features"]
            for one in features:
                _ = one["geometry"], {**one["properties"]}, [one["properties"][key] for key in _NEEDED.get(name, ())]
            layers |= {name: features} if name != _WAYPOINTS else _by_purpose(features)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise BadInputError(f"{path} cannot be read: {error}. Replay the log again.") from error
    if not layers:
        raise BadInputError(f"{results} holds no results yet. Replay the log, or wait until the session has ended.")
    return with_structures(with_verdicts(layers, read_verdicts(results)))


def write_gpx(path: Path, layers: Mapping[str, Sequence[Feature]], name: str) -> None:
    """Write mine-like contacts, missed ones and structures as way-points, legs as routes, the track. Raises OSError.

    A contact that is called is mine-like here. One that was judged not mine-like stays, and says so. A structure stands
    at the middle of its outline.
    """
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<gpx version="1.1" creator="auv-mcm" xmlns="http://www.topografix.com/GPX/1/1">',
        f"<metadata><name>{_text(name)}</name><desc>{_DATUM}</desc></metadata>",
        *(_contact(feature) for feature in layers.get("contacts", ()) if feature["geometry"] and is_likely(feature)),
        *map(_missed, layers.get(MISSED, ())),
        *map(_structure, layers.get(STRUCTURES, ())),
        *_routes(layers),
        *(_track(feature["geometry"]) for feature in layers.get("track", ()) if feature["geometry"]),
        "</gpx>",
    ]
    write_file(path, "\n".join(lines).encode() + b"\n")


def _by_purpose(features: Iterable[Feature]) -> dict[str, Sequence[Feature]]:
    sorted_in: dict[str, list[Feature]] = {"second_views": [], "survey_legs": []}
    for feature in features:
        properties = feature["properties"]
        if "kind" in properties:
            sorted_in.setdefault(f"{_WAYPOINTS}_{properties['kind']}", []).append(feature)
        else:
            sorted_in["second_views" if properties["contact_id"] else "survey_legs"].append(feature)
    return dict(sorted_in)


def _contact(feature: Feature) -> str:
    properties = feature["properties"]
    depth = "" if properties.get("depth_m") is None else f", depth {properties['depth_m']:.1f} m"
    kind = properties["class"].replace("_", " ")
    judged = verdict_words(properties)
    what = f"p_mine {properties['p_mine'] or 0.0:.4f}, {kind}{depth}" + (f"; {judged}" if judged else "")
    called = "called contact" if properties.get("called") else "mine-like contact"
    return _waypoint(feature, what, called)


def _missed(feature: Feature) -> str:
    return _waypoint(feature, verdict_words(feature["properties"]), "missed contact")


def _structure(feature: Feature) -> str:
    properties = feature["properties"]
    what = (
        f"{properties['length_m']:.0f} x {properties['width_m']:.0f} m, {properties['n_contacts']} contacts, "
        f"{properties['n_called']} of them called"
    )
    rings = feature["geometry"]["coordinates"]
    outline = (rings[0] if feature["geometry"]["type"] == "Polygon" else rings[0][0])[:-1]
    middle = [sum(axis) / len(outline) for axis in zip(*outline, strict=True)]
    return _waypoint({**feature, "geometry": {"coordinates": middle}}, what, "structure")


def _waypoint(feature: Feature, what: str, kind: str) -> str:
    properties = feature["properties"]
    return (
        f"<wpt {_at(feature['geometry']['coordinates'])}>"
        + (f"<time>{_text(properties['time'])}</time>" if properties.get("time") else "")
        + f"<name>{_text(properties['id'])}</name><desc>{_text(what)}</desc><type>{kind}</type></wpt>"
    )


def _routes(layers: Mapping[str, Sequence[Feature]]) -> Iterator[str]:
    points = [feature for name, features in layers.items() if name.startswith(f"{_WAYPOINTS}_") for feature in features]
    points.sort(key=lambda feature: feature["properties"]["order"])
    for leg in dict.fromkeys(feature["properties"]["leg"] for feature in points):
        members = [feature for feature in points if feature["properties"]["leg"] == leg]
        last = members[-1]["properties"]
        purpose = "second view" if last["contact_id"] else "survey leg"
        yield (
            f"<rte><name>{_text(f'leg {leg}: ' + (last['contact_id'] or purpose))}</name>"
            f"<desc>{_text(last['why'])}</desc><type>{purpose}</type>"
            + "".join(
                f"<rtept {_at(feature['geometry']['coordinates'])}><name>{_text(feature['properties']['kind'])}</name>"
                "</rtept>"
                for feature in members
                if feature["geometry"]
            )
            + "</rte>"
        )


def _track(geometry: Mapping[str, Any]) -> str:
    lines = geometry["coordinates"] if geometry["type"] == "MultiLineString" else [geometry["coordinates"]]
    pieces = ("".join(f"<trkpt {_at(point)}/>" for point in line) for line in lines)
    return "<trk><name>track</name>" + "".join(f"<trkseg>{piece}</trkseg>" for piece in pieces) + "</trk>"


def _at(point: Sequence[float]) -> str:
    return f'lat="{point[1]:.9f}" lon="{min(point[0], _EASTERNMOST_DEG):.9f}"'


def _text(text: str) -> str:
    return escape(clean(text), quote=False)
