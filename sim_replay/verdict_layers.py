"""Put what people judged into the layers of a mission, and write contacts with it as GeoJSON and KML 2.2."""

from __future__ import annotations

import html
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.clean_text import clean
from auv_mcm.contacts.geojson import collection
from auv_mcm.records import NAN
from auv_mcm.shell.whole_files import write_file
from sim_replay.structures import STRUCTURES
from sim_replay.verdicts import Place, Verdict, is_missed, sorted_verdicts

Feature = Mapping[str, Any]
Layers = Mapping[str, Sequence[Feature]]

MISSED: Final = "missed_contacts"
"""Layer of objects that an analyst drew, or judged mine-like, and that no contact of these results stands for."""
UNMATCHED: Final = "unmatched_verdicts"
"""Layer of the other verdicts that no contact stands for: what they were about is not reported any more."""

COLUMNS: Final = ("verdict", "verdict_type", "verdict_comment", "judged_by", "judged_time")
"""Properties of a contact that people judged, None for one that they did not."""

_COLOURS: Final = {
    "mine_like": "ff3c14dc",
    "not_mine_like": "ffb4a078",
    "missed": "ff00a5ff",
    "structure": "ffe0c040",
}  # aabbggrr
_ROWS: Final = (
    *(("p_mine", "p_mine"), ("called", "called a mine"), ("class", "class"), ("structure", "part of the structure")),
    *(("n_contacts", "contacts"), ("n_called", "of them called")),
    *(("length_m", "length, m"), ("width_m", "width, m"), ("height_m", "height, m")),
    *(("sigma_m", "position error (1 sigma), m"), ("depth_m", "depth below the surface, m"), ("n_views", "views")),
    *(("verdict", "verdict"), ("verdict_type", "type"), ("verdict_comment", "comment")),
    *(("judged_by", "judged by"), ("judged_time", "judged at")),
)
"""Properties in the balloon of a contact, and their words."""


def verdict_columns(verdict: Verdict | None) -> dict[str, str | None]:
    """Name the columns of a verdict, all of them None where nobody judged."""
    if verdict is None:
        return dict.fromkeys(COLUMNS)
    said = (verdict.call, verdict.type, verdict.comment, verdict.by, verdict.time)
    return dict(zip(COLUMNS, said, strict=True))


def with_verdicts(layers: Layers, verdicts: Iterable[Verdict]) -> dict[str, Sequence[Feature]]:
    """Add the columns of verdicts to every contact, and a layer each for `MISSED` and `UNMATCHED` objects.

    Layers come in the order given, new ones last and only where they hold something.
    """
    contacts = layers.get("contacts", ())
    matched, alone = sorted_verdicts(verdicts, list(map(_place, contacts)))
    judged = [
        {**one, "properties": {**one["properties"], **verdict_columns(matched.get(one["properties"]["id"]))}}
        for one in contacts
    ]
    found = {**layers, **({"contacts": judged} if "contacts" in layers else {})}
    missed = [_alone(verdict) for verdict in alone if is_missed(verdict)]
    others = [_alone(verdict) for verdict in alone if not is_missed(verdict)]
    return found | ({MISSED: missed} if missed else {}) | ({UNMATCHED: others} if others else {})


def write_geojson(path: Path, layers: Layers) -> None:
    """Write contacts, missed objects and structures as one FeatureCollection, each with its `layer`. Raises OSError."""
    features = [
        {**one, "properties": {"layer": name, **one["properties"]}}
        for name in ("contacts", MISSED, UNMATCHED, STRUCTURES)
        for one in layers.get(name, ())
    ]
    write_file(path, collection(features))


def write_kml(path: Path, layers: Layers, name: str, results: Path) -> None:
    """Write contacts and missed objects as KML, with the pictures of `results` where they lie. Raises OSError."""
    folder = os.path.relpath(results.resolve(), path.resolve().parent)
    pictures = Path(folder)

    def picture(snippet: str) -> str:
        return quote(os.fsencode(pictures / snippet)) if (results / snippet).is_file() else ""

    text = "".join(
        (
            '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2">\n<Document>\n',
            f"<name>{_xml(name)}</name>\n",
            *kml_folders(layers, picture),
            "</Document>\n</kml>\n",
        )
    )
    write_file(path, text.encode())


def kml_folders(layers: Layers, picture: Callable[[str], str] = lambda snippet: "") -> Iterator[str]:
    """Yield styles and folders of KML: structures, mine-like contacts, missed objects, clutter, other verdicts.

    A contact is among the mine-like where it is called, has p_mine 0.2, or was judged so: what the chain believes is
    never taken away by a verdict. picture: gives the address of a contact's picture, empty for none.
    """
    contacts = layers.get("contacts", ())
    likely = [one for one in contacts if is_likely(one)]
    others = [one for one in contacts if not is_likely(one)]
    for style, colour in _COLOURS.items():
        area = f"<PolyStyle><color>33{colour[2:]}</color></PolyStyle>"
        yield f'<Style id="{style}"><IconStyle><color>{colour}</color></IconStyle>{area}</Style>\n'
    folders = (
        ("Structures", layers.get(STRUCTURES, ()), "structure"),
        *(("Mine-like", likely, "mine_like"), ("Missed", layers.get(MISSED, ()), "missed")),
        *(("Clutter", others, "not_mine_like"), ("Other verdicts", layers.get(UNMATCHED, ()), "not_mine_like")),
    )
    for title, members, style in folders:
        if members:
            yield f"<Folder>\n<name>{title} ({len(members)})</name>\n"
            yield from (_placemark(one, style, picture) for one in members)
            yield "</Folder>\n"


def verdict_words(properties: Mapping[str, Any]) -> str:
    """Say the verdict of a feature in a few words, empty where nobody judged."""
    call = properties.get("verdict")
    if not call:
        return ""
    said = [str(properties.get(name) or "") for name in ("verdict_type", "verdict_comment")]
    about = ", ".join(filter(None, said))
    return clean(f"judged {_words('verdict', call)} by {properties.get('judged_by')}" + (f": {about}" if about else ""))


def is_likely(feature: Feature) -> bool:
    """Decide whether a contact is among the mine-like: called, of p_mine 0.2 or more, or judged so."""
    properties = feature["properties"]
    likely = (properties.get("p_mine") or 0.0) >= MINE_LIKE_P or bool(properties.get("called"))
    return likely or properties.get("verdict") == "mine_like"


def _place(feature: Feature) -> Place:
    properties = feature["properties"]
    longitude, latitude = (feature["geometry"] or {"coordinates": (NAN, NAN)})["coordinates"][:2]
    sigma_m = properties.get("sigma_m")
    return Place(properties["id"], latitude, longitude, NAN if sigma_m is None else sigma_m)


def _alone(verdict: Verdict) -> dict[str, Any]:
    properties = {
        "id": verdict.object,
        "drawn": verdict.drawn,
        **verdict_columns(verdict),
        "contact_id": verdict.contact_id or None,
        **{name: getattr(verdict, name) for name in ("length_m", "width_m", "height_m", "sigma_m", "side")},
        "ground_range_m": verdict.ground_range_m,
        "time": verdict.view_time or None,
    }
    geometry = {"type": "Point", "coordinates": [verdict.longitude_deg, verdict.latitude_deg]}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _placemark(feature: Feature, style: str, picture: Callable[[str], str]) -> str:
    properties = feature["properties"]
    rows = "".join(
        f"<tr><td>{words}</td><td>{html.escape(_words(name, properties[name]))}</td></tr>"
        for name, words in _ROWS
        if properties.get(name) not in (None, "")
    )
    address = picture(str(properties["snippet"])) if properties.get("snippet") else ""
    image = f'<img src="{html.escape(address)}" alt="sonar picture"/>' if address else ""
    data = "".join(
        f'<Data name="{name}"><value>{_xml(str(properties[name]))}</value></Data>'
        for name in ("p_mine", *COLUMNS)
        if properties.get(name) is not None
    )
    point = ""
    if feature["geometry"] is not None and feature["geometry"]["type"] == "Point":
        point = f"<Point><coordinates>{_position(feature['geometry']['coordinates'])}</coordinates></Point>"
    elif feature["geometry"] is not None:
        point = _polygons(feature["geometry"])
    time = properties.get("time")
    return (
        f"<Placemark><name>{_xml(str(properties['id']))}</name>"
        f"<description>{_xml(f'{image}<table>{rows}</table>')}</description>"
        + (f"<TimeStamp><when>{_xml(time)}</when></TimeStamp>" if time else "")
        + f"<styleUrl>#{style}</styleUrl><ExtendedData>{data}</ExtendedData>{point}</Placemark>\n"
    )


def _polygons(geometry: Mapping[str, Any]) -> str:
    parts = geometry["coordinates"] if geometry["type"] == "MultiPolygon" else [geometry["coordinates"]]
    rings = (
        f"<LinearRing><coordinates>{' '.join(map(_position, part[0]))}</coordinates></LinearRing>" for part in parts
    )
    polygons = "".join(f"<Polygon><outerBoundaryIs>{ring}</outerBoundaryIs></Polygon>" for ring in rings)
    return f"<MultiGeometry>{polygons}</MultiGeometry>"


def _position(position: Sequence[float]) -> str:
    return f"{position[0]:.9f},{position[1]:.9f},0"


def _words(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4f}" if name == "p_mine" else f"{value:.2f}"
    return clean(str(value).replace("_", " ") if name in ("verdict", "class") else str(value))


def _xml(text: str) -> str:
    """Escape text for XML 1.0, which forbids control characters: `clean` leaves none of them."""
    return html.escape(clean(text))
