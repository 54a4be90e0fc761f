"""Write contacts, coverage and way-points as text: GeoJSON (RFC 7946), CSV (RFC 4180) and KML 2.2.

Pure functions of records. Equal records give equal bytes: keys have a fixed order, features are sorted, numbers are
rounded to what they can mean (1e-9 degrees is 0.1 mm). An unknown number is `null` in JSON and an empty cell in CSV.

What there may be very many of can also be had in parts, a record at a time, from records that come in order: contacts
in that of `contact_order`, patches in that of `coverage_order`.
"""

from __future__ import annotations

import csv
import html
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, Final, get_args

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import bounded_by, singleton_belief
from auv_mcm.clean_text import clean
from auv_mcm.contacts.antimeridian import split_line, split_ring
from auv_mcm.contacts.contact import (
    best_view,
    call_words,
    depth_m,
    error_ellipse_ring_m,
    is_mine_like,
    sigma_m,
    view_reasons,
)
from auv_mcm.contacts.contact_words import contact_words
from auv_mcm.contacts.geojson import (
    DEGREE_DIGITS,
    METRE_DIGITS,
    PROBABILITY_DIGITS,
    Json,
    collection,
    collection_parts,
    feature,
    geojson_point,
    one_or_multi,
    positions_of,
    rounded,
    rounded_direction,
    rounded_longitude,
)
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NAN, Contact, ContactClass, CoveragePatch, Detection, Waypoint

_DATUM: Final = (
    "Positions are WGS 84. Depths are of the sea floor below the surface at the time, by the vehicle's own depth and "
    "its height over the floor; they are not reduced for tide."
)

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


def snippet_path(contact: Contact) -> str:
    """Name the path of a contact's picture, relative to the file that names it."""
    return f"snippets/{contact.id}.png"


def iso_time(time_s: float) -> str | None:
    """Write UTC seconds since 1970 as ISO 8601 with milliseconds and Z; None if not a time of the years 1 to 9999."""
    try:
        moment = _EPOCH + timedelta(milliseconds=round(time_s * 1000.0))
    except (OverflowError, ValueError):
        return None
    return moment.replace(tzinfo=None).isoformat(timespec="milliseconds") + "Z"


def contacts_geojson(contacts: Iterable[Contact]) -> bytes:
    """Write a FeatureCollection with one point per contact, sorted by id.

    A contact without a position has a null geometry.

    `sigma_m` is the semi-major axis of the 1-sigma error ellipse; `covariance_m2` is [[east-east, east-north],
    [east-north, north-north]]. `side`, `ground_range_m`, `score` and the snippet are those of the view with the
    greatest score. `summary` is the contact in one sentence, `mine_kind_open` what has to be added to the belief in the
    kinds of mine to make `p_mine`. `views` are in order of time; `log_ratio` and `belief` of one that was not confirmed
    are null. No belief contradicts the p_mine beside it. `false_alarms_per_km2` is the density of non-mines at least as
    mine-like that the mission's own background makes expected, with its 95 % interval; `called` says that the operator
    accepts as many.
    """
    return b"".join(contacts_geojson_parts(sorted(contacts, key=contact_order)))


def contacts_geojson_parts(contacts: Iterable[Contact]) -> Iterator[bytes]:
    """Yield contacts.geojson in parts of bytes, a contact at a time."""
    return collection_parts(map(contact_feature, contacts))


def coverage_geojson_parts(patches: Iterable[CoveragePatch]) -> Iterator[bytes]:
    """Write a FeatureCollection with one polygon or multi-polygon per patch, in parts. patches: in `coverage_order`."""
    return collection_parts(map(_coverage_feature, patches))


def contact_order(contact: Contact) -> str:
    """Return the key that contacts are sorted by in files."""
    return contact.id


def coverage_order(patch: CoveragePatch) -> tuple[int, str, float]:
    """Return the key that patches of coverage are sorted by in files."""
    return patch.tile_index, patch.side, patch.start_s


def waypoints_geojson(waypoints: Sequence[Waypoint]) -> bytes:
    """Write a FeatureCollection of the way-points in sailing order.

    Then comes one line per leg from where the one before ended.
    """
    features = []
    for order, waypoint in enumerate(waypoints):
        properties: dict[str, Json] = {
            "order": order,
            "leg": waypoint.leg,
            "kind": waypoint.kind,
            "heading_deg": _direction(math.degrees(waypoint.heading_rad), PROBABILITY_DIGITS),
            "contact_id": waypoint.contact_id,
            "why": waypoint.why,
        }
        features.append(feature(geojson_point(waypoint.longitude_deg, waypoint.latitude_deg), properties))
    positions = np.array(
        [(waypoint.longitude_deg, waypoint.latitude_deg) for waypoint in waypoints], dtype=np.float64
    ).reshape(-1, 2)
    for leg in dict.fromkeys(waypoint.leg for waypoint in waypoints):
        members = [order for order, waypoint in enumerate(waypoints) if waypoint.leg == leg]
        line = positions[max(members[0] - 1, 0) : members[-1] + 1]
        pieces: list[Json] = [positions_of(piece) for piece in split_line(line)]
        if pieces:
            last = waypoints[members[-1]]
            features.append(
                feature(
                    one_or_multi("LineString", pieces), {"leg": leg, "contact_id": last.contact_id, "why": last.why}
                )
            )
    return collection(features)


CSV_COLUMNS: Final = (
    *(
        "id",
        "time",
        "latitude_deg",
        "longitude_deg",
        "sigma_m",
        "p_mine",
        "class",
        "length_m",
        "width_m",
        "height_m",
        "n_views",
    ),
    *("aspects_deg", "side", "ground_range_m", "score", "snippet", "reasons"),
    *("length_sigma_m", "width_sigma_m", "height_sigma_m"),
    *("false_alarms_per_km2", "false_alarms_low_per_km2", "false_alarms_high_per_km2", "called", "depth_m"),
    "summary",
)


def contacts_csv_parts(contacts: Iterable[Contact]) -> Iterator[str]:
    """Write a row of column names and one per contact, in parts. contacts: in `contact_order`.

    Lists are joined by blanks, reasons by semicolons. Text that a spreadsheet would take for a formula gets an
    apostrophe in front.
    """
    yield _csv_row(CSV_COLUMNS)
    for contact in contacts:
        yield _csv_row(_csv_cells(contact))


def contacts_kml_parts(contacts: Iterable[Contact], mission: str = "") -> Iterator[str]:
    """Write a KML document: contacts that are mine-like or called, and the rest, in two folders.

    Each contact has its picture, which lies in `snippets/` beside the file, a table and its 2-sigma error ellipse.

    contacts: in `contact_order`, gone through several times.
    """
    head = (
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<kml xmlns="http://www.opengis.net/kml/2.2">',
        "<Document>",
        f"<name>{_xml(mission or 'Contacts')}</name>",
        f"<description>{_xml(_DATUM)}</description>",
        _kml_style("mine_like", "ff3c14dc"),
        _kml_style("clutter", "ffb4a078"),
    )
    yield "\n".join(head)
    for style, title, mine_like in (("mine_like", "Mine-like", True), ("clutter", "Clutter", False)):
        n = sum((contact.called or is_mine_like(contact)) == mine_like for contact in contacts)
        yield f"\n<Folder>\n<name>{title} ({n})</name>"
        for contact in contacts:
            if (contact.called or is_mine_like(contact)) == mine_like:
                yield "\n".join(["", *_kml_placemark(contact, style)])
        yield "\n</Folder>"
    yield "\n</Document>\n</kml>\n"


def contact_feature(contact: Contact) -> dict[str, Json]:
    """Describe a contact as a GeoJSON feature, with a null geometry where its position is not known."""
    view, said = best_view(contact), contact_words(contact)
    properties: dict[str, Json] = {
        "id": contact.id,
        "time": iso_time(contact.time_s),
        "p_mine": rounded(contact.p_mine, PROBABILITY_DIGITS),
        "class": contact.classification,
        "belief": _belief(contact.belief),
        "length_m": rounded(contact.length_m, METRE_DIGITS),
        "width_m": rounded(contact.width_m, METRE_DIGITS),
        "height_m": rounded(contact.height_m, METRE_DIGITS),
        "n_views": len(contact.views),
        "aspects_deg": [_direction(aspect) for aspect in contact.aspects_deg],
        "sigma_m": rounded(sigma_m(contact), METRE_DIGITS),
        "side": view.side if view else None,
        "ground_range_m": rounded(view.ground_range_m, METRE_DIGITS) if view else None,
        "snippet": snippet_path(contact),
        "reasons": list(contact.reasons),
        "score": rounded(view.score, METRE_DIGITS) if view else None,
        "covariance_m2": [[rounded(float(value), 6) for value in row] for row in np.asarray(contact.covariance_m2)],
        "length_sigma_m": rounded(contact.length_sigma_m, METRE_DIGITS),
        "width_sigma_m": rounded(contact.width_sigma_m, METRE_DIGITS),
        "height_sigma_m": rounded(contact.height_sigma_m, METRE_DIGITS),
        "conflict": rounded(contact.conflict, PROBABILITY_DIGITS),
        "next_look_deg": [_direction(direction) for direction in contact.next_look_deg],
        "false_alarms_per_km2": rounded(contact.false_alarms_per_km2, METRE_DIGITS),
        "false_alarms_95_per_km2": [rounded(bound, METRE_DIGITS) for bound in contact.false_alarms_95_per_km2],
        "called": contact.called,
        "depth_m": rounded(depth_m(contact), METRE_DIGITS),
        "mine_kind_open": rounded(said.open_share, PROBABILITY_DIGITS),
        "summary": said.sentence,
        "views": [_view(view) for view in contact.views],
    }
    return feature(geojson_point(contact.longitude_deg, contact.latitude_deg), properties)


def _view(view: Detection) -> dict[str, Json]:
    close = view.confirmation
    return {
        "time": iso_time(view.time_s),
        "side": view.side,
        "aspect_deg": _direction(view.aspect_deg),
        "ground_range_m": rounded(view.ground_range_m, METRE_DIGITS),
        "p_mine": rounded(view.p_mine, PROBABILITY_DIGITS),
        "log_ratio": rounded(close.log_ratio, METRE_DIGITS) if close else None,
        "belief": _belief(singleton_belief(bounded_by(close.mass, view.p_mine))) if close else None,
        "reasons": list(view_reasons(view)),
        **({} if view.squint_rad == 0.0 else {"squint_deg": rounded(math.degrees(view.squint_rad), METRE_DIGITS)}),
    }


def _coverage_feature(patch: CoveragePatch) -> dict[str, Json]:
    polygons: list[Json] = [
        [positions_of(piece)] for ring in patch.rings_deg if np.isfinite(ring).all() for piece in split_ring(ring)
    ]
    properties: dict[str, Json] = {
        "side": patch.side,
        "tile": patch.tile_index,
        "start": iso_time(patch.start_s),
        "stop": iso_time(patch.stop_s),
        "covered_m2": rounded(patch.covered_m2, METRE_DIGITS),
        "evaluated_fraction": rounded(patch.evaluated_fraction, PROBABILITY_DIGITS),
        "lost_m2": {reason: rounded(patch.lost_m2[reason], METRE_DIGITS) for reason in sorted(patch.lost_m2)},
    }
    return feature(one_or_multi("Polygon", polygons), properties)


def _direction(direction_deg: float, digits: int = METRE_DIGITS) -> float | None:
    return rounded(rounded_direction(direction_deg, digits), digits)


def _csv_row(cells: Sequence[Any]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\r\n").writerow(cells)
    return text.getvalue()


def _csv_cells(contact: Contact) -> list[Any]:
    view = best_view(contact)
    return [
        _cell(contact.id),
        iso_time(contact.time_s),
        rounded(contact.latitude_deg, DEGREE_DIGITS),
        rounded_longitude(contact.longitude_deg),
        rounded(sigma_m(contact), METRE_DIGITS),
        rounded(contact.p_mine, PROBABILITY_DIGITS),
        contact.classification,
        rounded(contact.length_m, METRE_DIGITS),
        rounded(contact.width_m, METRE_DIGITS),
        rounded(contact.height_m, METRE_DIGITS),
        len(contact.views),
        " ".join(f"{rounded_direction(aspect, 1):.1f}" for aspect in contact.aspects_deg),
        view.side if view else None,
        rounded(view.ground_range_m, METRE_DIGITS) if view else None,
        rounded(view.score, METRE_DIGITS) if view else None,
        _cell(snippet_path(contact)),
        _cell("; ".join(contact.reasons)),
        rounded(contact.length_sigma_m, METRE_DIGITS),
        rounded(contact.width_sigma_m, METRE_DIGITS),
        rounded(contact.height_sigma_m, METRE_DIGITS),
        rounded(contact.false_alarms_per_km2, METRE_DIGITS),
        *(rounded(bound, METRE_DIGITS) for bound in contact.false_alarms_95_per_km2),
        None if contact.called is None else str(contact.called).lower(),
        rounded(depth_m(contact), METRE_DIGITS),
        _cell(contact_words(contact).sentence),
    ]


def _belief(belief: Mapping[str, float]) -> dict[str, Json]:
    """Sort classes in the order of the record, whatever others after them."""
    known = {name: belief[name] for name in get_args(ContactClass) if name in belief}
    return {name: rounded(share, PROBABILITY_DIGITS) for name, share in (known | dict(belief)).items()}


def _cell(text: str) -> str:
    return "'" + text if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text


def _xml(text: str) -> str:
    """Escape text for XML 1.0, which forbids control characters, surrogates and two more: `clean` leaves none of
    them."""
    return html.escape(clean(text))


def _kml_style(name: str, colour: str) -> str:
    return (
        f'<Style id="{name}"><IconStyle><color>{colour}</color></IconStyle>'
        f"<LineStyle><color>{colour}</color><width>2</width></LineStyle>"
        f"<PolyStyle><color>33{colour[2:]}</color></PolyStyle></Style>"
    )


def _kml_placemark(contact: Contact, style: str) -> list[str]:
    if not (math.isfinite(contact.latitude_deg) and math.isfinite(contact.longitude_deg)):
        return [f"<Placemark><name>{_xml(contact.id)}</name><description>position not known</description></Placemark>"]
    frame = LocalFrame(latitude_deg=contact.latitude_deg, longitude_deg=contact.longitude_deg)
    position = _kml_coordinates(np.array([[contact.longitude_deg, contact.latitude_deg]]))
    geometry = [f"<Point><coordinates>{position}</coordinates></Point>"]
    ring_m = error_ellipse_ring_m(contact)
    if np.isfinite(ring_m).all():
        latitude, longitude, _ = frame.to_geodetic(np.column_stack([ring_m, np.zeros(len(ring_m))]))
        for piece in split_ring(np.column_stack([longitude, latitude])):
            ring = f"<LinearRing><coordinates>{_kml_coordinates(piece)}</coordinates></LinearRing>"
            geometry.append(f"<Polygon><outerBoundaryIs>{ring}</outerBoundaryIs></Polygon>")
    time = iso_time(contact.time_s)
    return [
        "<Placemark>",
        f"<name>{_xml(contact.id)}</name>",
        f"<description>{_xml(_kml_table(contact))}</description>",
        *([f"<TimeStamp><when>{time}</when></TimeStamp>"] if time else []),
        f"<styleUrl>#{style}</styleUrl>",
        "<MultiGeometry>",
        *geometry,
        "</MultiGeometry>",
        "</Placemark>",
    ]


def _kml_coordinates(points: NDArray[np.float64]) -> str:
    return " ".join(f"{longitude:.9f},{latitude:.9f},0" for longitude, latitude in points.tolist())


def _kml_table(contact: Contact) -> str:
    view = best_view(contact)
    said = contact_words(contact)
    belief = contact.belief.get(said.kind, NAN)
    rows: list[tuple[str, Any]] = [
        ("summary", said.sentence),
        ("speaks for a mine", said.reason_for),
        ("speaks against a mine", said.reason_against),
        ("p_mine", f"{contact.p_mine:.{PROBABILITY_DIGITS}f}" if math.isfinite(contact.p_mine) else "not known"),
        ("called a mine", call_words(contact)),
        ("class", said.label),
        ("belief in the class", f"{belief:.2f}" if math.isfinite(belief) else "?"),
        ("size (length, width, height) ± 1 sigma", " × ".join(_size(*size) for size in _sizes(contact)) + " m"),
        ("position error (1 sigma)", f"{sigma_m(contact):.2f} m"),
        ("depth below the surface", f"{depth_m(contact):.1f} m" if math.isfinite(depth_m(contact)) else "not known"),
        ("views", len(contact.views)),
        ("aspects", ", ".join(f"{rounded_direction(aspect, 0):03.0f}°" for aspect in contact.aspects_deg)),
        ("side and ground range", f"{view.side}, {view.ground_range_m:.1f} m" if view else ""),
        ("reasons", "; ".join(contact.reasons)),
    ]
    picture = f'<img src="{html.escape(snippet_path(contact))}" alt="sonar picture"/>' if contact.views else ""
    return (
        f"{picture}<table>"
        + "".join(f"<tr><td>{html.escape(name)}</td><td>{html.escape(str(value))}</td></tr>" for name, value in rows)
        + "</table>"
    )


def _sizes(contact: Contact) -> tuple[tuple[float, float], ...]:
    """List length, width and height, each with its 1-sigma."""
    return (
        (contact.length_m, contact.length_sigma_m),
        (contact.width_m, contact.width_sigma_m),
        (contact.height_m, contact.height_sigma_m),
    )


def _size(value_m: float, error_m: float) -> str:
    if not math.isfinite(value_m):
        return "?"
    return f"{value_m:.2f} ± {error_m:.2f}" if math.isfinite(error_m) else f"{value_m:.2f}"
