"""Write a contact sheet as PDF: the area, and every contact that matters with picture, sentence, place and verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.clean_text import clean
from auv_mcm.contacts.contact_words import feature_words
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.shell.whole_files import write_file
from sim_replay.report.report_words import call_name, degrees_minutes, nice_step
from sim_replay.verdict_layers import MISSED, UNMATCHED
from sim_replay.verdicts import Judged, evidence_words

if TYPE_CHECKING:
    from fpdf import FPDF

Feature = Mapping[str, Any]
Layers = Mapping[str, Sequence[Feature]]

_WIDTH_MM, _CHART_MM, _ROW_MM, _PICTURE_MM = 180.0, 150.0, 44.0, 38.0  # of A4 with margins of 15 mm
_MARGIN_MM, _BOTTOM_MM = 15.0, 282.0
_WORDS_MM = _PICTURE_MM + 4.0  # from the margin to the words beside a picture
_NO_TIME: Final = datetime(1970, 1, 1, tzinfo=UTC)
_FACTS: Final = 8.5  # points of small text
_MISSING: Final = str.maketrans({"\u2032": "'", "\u2033": '"', "\u2013": "-", "\u2026": "...", "\u202f": " "})


def write_contact_sheet(path: Path, results: Path, layers: Layers, name: str) -> None:
    """Write the sheet of results: contacts judged, mine-like or called, and objects that only people saw.

    Letters beyond Latin-1, which the fonts of every PDF reader have, become question marks. Equal results give equal
    bytes. Raises OSError.

    Parameters
    ----------
    path
        Of the PDF.
    results
        Folder with the pictures of contacts.
    layers
        As `read_layers` reads them, with verdicts.
    name
        Of the mission.
    """
    from fpdf import FPDF  # bench extra

    contacts = sheet_contacts(layers)
    sheet = FPDF(format="A4")
    sheet.set_creation_date(_NO_TIME)
    sheet.set_title(_latin(name))
    sheet.set_margins(_MARGIN_MM, _MARGIN_MM)
    sheet.set_auto_page_break(False)
    sheet.add_page()
    _line(sheet, 18.0, "B", name)
    missed = layers.get(MISSED, ())
    judged = sum(one["properties"].get("verdict") is not None for one in contacts)
    words = f"{len(contacts)} contacts to look at, {judged} judged; {len(missed)} seen by people alone"
    if unmatched := layers.get(UNMATCHED):
        words += f"; {len(unmatched)} more unmatched: no contact stands for what was judged"
    _line(sheet, 10.0, "", words)
    _chart(sheet, layers, contacts)
    calls = [str(one["properties"].get("verdict")) for one in contacts]
    counted = Judged(calls.count("mine_like"), calls.count("not_mine_like"), calls.count("undecided"), len(missed))
    _line(sheet, _FACTS, "", f"Of this mission alone, {evidence_words([counted])}.")
    sheet.add_page()
    for one in (*contacts, *missed):
        words_mm = sum(_line(sheet, *row, width_mm=_WIDTH_MM - _WORDS_MM, dry_run=True) for row in _rows(one))
        if sheet.get_y() + max(_ROW_MM, words_mm + 2.0) > _BOTTOM_MM:
            sheet.add_page()
        _contact(sheet, one, results)
    write_file(path, bytes(sheet.output()))


def sheet_contacts(layers: Layers) -> list[Feature]:
    """List the contacts of a sheet: judged, mine-like or called, the likeliest mine first."""

    def matters(properties: Mapping[str, Any]) -> bool:
        return bool(
            properties.get("verdict") or properties.get("called") or (properties.get("p_mine") or 0.0) >= MINE_LIKE_P
        )

    found = [one for one in layers.get("contacts", ()) if matters(one["properties"])]
    return sorted(found, key=lambda one: (-(one["properties"].get("p_mine") or 0.0), one["properties"]["id"]))


def _contact(sheet: FPDF, feature: Feature, results: Path) -> None:
    """Write one contact in a row of its own: picture to the left, words beside it."""
    properties, top = feature["properties"], sheet.get_y()
    name = _name(properties)
    picture = results / "snippets" / f"{name}.png"
    if name.startswith("C") and name[1:].isdecimal() and picture.is_file():
        try:
            sheet.image(str(picture), _MARGIN_MM, top, _PICTURE_MM, _PICTURE_MM, keep_aspect_ratio=True)
        except (OSError, SyntaxError, ValueError):  # of Pillow, as a file is damaged
            sheet.set_font("helvetica", "", _FACTS)
            sheet.text(_MARGIN_MM, top + 4.0, "picture damaged")
    sheet.set_left_margin(_MARGIN_MM + _WORDS_MM)
    sheet.set_y(top)
    for row in _rows(feature):
        _line(sheet, *row)
    sheet.set_left_margin(_MARGIN_MM)
    sheet.set_y(max(top + _ROW_MM, sheet.get_y() + 2.0))
    sheet.set_draw_color(200)
    sheet.line(_MARGIN_MM, sheet.get_y() - 2.0, _MARGIN_MM + _WIDTH_MM, sheet.get_y() - 2.0)


def _rows(feature: Feature) -> Iterator[tuple[float, str, str]]:
    properties = feature["properties"]
    yield 11.0, "B", _name(properties)
    if "p_mine" in properties and properties.get("views") is not None:
        said = feature_words(properties)
        yield 10.0, "", said.sentence
        for side, reason in (("For", said.reason_for), ("Against", said.reason_against)):
            if reason:
                yield _FACTS, "", f"{side}: {reason}"
    longitude, latitude = ((feature.get("geometry") or {}).get("coordinates") or [math.nan, math.nan])[:2]
    depth = properties.get("depth_m")
    place = f"{degrees_minutes(latitude, 'N', 'S')}, {degrees_minutes(longitude, 'E', 'W')}"
    yield _FACTS, "", place + (f", {depth:.1f} m deep" if isinstance(depth, int | float) else "")
    if properties.get("verdict"):
        kind = f", {properties['verdict_type']}" if properties.get("verdict_type") else ""
        by = f"{properties.get('judged_by') or '?'}, {properties.get('judged_time') or '?'}"
        yield 10.0, "", f"Judged {call_name(str(properties['verdict']))}{kind} by {by}"
        if properties.get("verdict_comment"):
            comment = str(properties["verdict_comment"])
            yield _FACTS, "", comment if len(comment) <= 300 else f"{comment[:300]}..."


def _name(properties: Mapping[str, Any]) -> str:
    return str(properties.get("id") or properties.get("object") or "")


def _chart(sheet: FPDF, layers: Layers, contacts: Sequence[Feature]) -> None:
    """Draw coverage, track, contacts and missed objects, north up, with a scale."""
    named = [*contacts, *layers.get(MISSED, ())]
    lines = [*_lines(layers.get("coverage", ())), *_lines(layers.get("track", ()))]
    points = [tuple(one["geometry"]["coordinates"][:2]) for one in named if one.get("geometry")]
    every = [point for line in lines for point in line] + points
    top = sheet.get_y() + 4.0
    if not every:
        _line(sheet, 10.0, "", "No position was recorded, so that there is no chart.")
        return
    frame = LocalFrame(latitude_deg=every[0][1], longitude_deg=every[0][0])

    def placed(longitude_deg: float, latitude_deg: float) -> tuple[float, float]:
        east_m, north_m, _ = frame.to_enu([latitude_deg], [longitude_deg], 0.0)[0].tolist()
        return east_m, north_m

    east, north = zip(*(placed(*point) for point in every), strict=True)
    span_m = max(max(east) - min(east), max(north) - min(north), 1.0)
    scale = 0.94 * _CHART_MM / span_m
    middle = 0.5 * (max(east) + min(east)), 0.5 * (max(north) + min(north))

    def on_paper(point: tuple[float, float]) -> tuple[float, float]:
        east_m, north_m = placed(*point)
        return (
            _MARGIN_MM + _WIDTH_MM / 2.0 + scale * (east_m - middle[0]),
            top + _CHART_MM / 2.0 - scale * (north_m - middle[1]),
        )

    sheet.set_draw_color(160)
    sheet.rect(_MARGIN_MM, top, _WIDTH_MM, _CHART_MM)
    sheet.set_fill_color(214, 230, 230)
    for ring in _lines(layers.get("coverage", ())):
        sheet.polygon([on_paper(point) for point in ring], style="F")
    sheet.set_draw_color(36, 81, 94)
    for line in _lines(layers.get("track", ())):
        sheet.polyline([on_paper(point) for point in line])
    for one, point in zip((one for one in named if one.get("geometry")), points, strict=True):
        _mark(sheet, one, *on_paper(point))
    bar_m = nice_step(span_m, 5)
    sheet.set_draw_color(0)
    sheet.line(_MARGIN_MM + 5.0, top + _CHART_MM - 5.0, _MARGIN_MM + 5.0 + scale * bar_m, top + _CHART_MM - 5.0)
    sheet.set_font("helvetica", "", _FACTS)
    sheet.text(_MARGIN_MM + 5.0, top + _CHART_MM - 6.5, f"{bar_m:g} m")
    sheet.text(_MARGIN_MM + _WIDTH_MM - 20.0, top + 6.0, "north is up")
    _corners(sheet, frame, middle, scale, top)
    sheet.set_y(top + _CHART_MM + 3.0)
    _line(
        sheet,
        _FACTS,
        "",
        "Shaded: searched. Line: track. Red: judged mine-like, or rather a mine than not; grey: others.",
    )


def _corners(sheet: FPDF, frame: LocalFrame, middle: tuple[float, float], scale: float, top: float) -> None:
    """Write where the north-western and the south-eastern corner of the chart are."""
    for side, right_mm, down_mm in ((-1.0, 2.0, 4.0), (1.0, _WIDTH_MM - 45.0, _CHART_MM - 2.0)):
        east_m, north_m = middle[0] + side * _WIDTH_MM / 2.0 / scale, middle[1] - side * _CHART_MM / 2.0 / scale
        latitude, longitude, _ = frame.to_geodetic([[east_m, north_m, 0.0]])
        place = f"{degrees_minutes(latitude[0], 'N', 'S')}, {degrees_minutes(longitude[0], 'E', 'W')}"
        sheet.text(_MARGIN_MM + right_mm, top + down_mm, _latin(place))


def _mark(sheet: FPDF, feature: Feature, right: float, down: float) -> None:
    properties = feature["properties"]
    likely = properties.get("verdict") == "mine_like" or (
        properties.get("verdict") is None and (properties.get("p_mine") or 0.0) >= 0.5
    )
    sheet.set_draw_color(*((211, 18, 63) if likely else (60, 60, 60)))
    sheet.circle(right, down, 1.3)
    sheet.set_font("helvetica", "", 7.0)
    sheet.text(right + 1.8, down + 1.0, _latin(_name(properties)))


def _lines(features: Sequence[Feature]) -> Iterator[list[tuple[float, float]]]:
    """Yield every line, and every outer ring, of features as longitude and latitude."""
    for feature in features:
        geometry = feature.get("geometry")
        if not geometry or geometry["type"] == "Point":
            continue
        kind, coordinates = geometry["type"], geometry["coordinates"]
        if kind in ("LineString", "Polygon"):
            parts = [coordinates] if kind == "LineString" else coordinates[:1]
        else:
            parts = coordinates if kind == "MultiLineString" else [polygon[0] for polygon in coordinates]
        yield from ([(float(point[0]), float(point[1])) for point in part] for part in parts if len(part) > 1)


def _line(sheet: FPDF, size: float, style: str, text: str, *, width_mm: float = 0.0, dry_run: bool = False) -> float:
    """Write a paragraph, or find out how much room it takes. Returns its height in mm."""
    sheet.set_font("helvetica", style, size)
    how: dict[str, Any] = {"new_x": "LMARGIN", "new_y": "NEXT", "output": "HEIGHT", "dry_run": dry_run}
    return cast(float, sheet.multi_cell(width_mm, 0.45 * size, _latin(text), align="L", **how))


def _latin(text: str) -> str:
    return clean(text).translate(_MISSING).encode("latin-1", "replace").decode("latin-1")
