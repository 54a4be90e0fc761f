"""The mission report: one HTML file that needs nothing else, for a person to read on a screen or on paper."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.export import best_view, error_ellipse, is_mine_like
from auv_mcm.contacts.picture import CEILING_DB, COLOURS, FLOOR_DB
from auv_mcm.detect.belief import REASONS
from auv_mcm.records import Contact, CoveragePatch, Detection, Notice, Waypoint
from sim_replay.report import words
from sim_replay.report.chart import WIDTH, draw_chart
from sim_replay.report.pictures import PictureCollector, Strip, snippet_jpeg

_SNIPPET_BYTES: Final = 3_500_000  # pictures of contacts in the page; further contacts are told in words, their files lie in snippets/
_NOTICES_PER_CODE: Final = 5
_LEAST_BOX_M: Final = 3.0
_CLASSES: Final = {
    "cylinder": "cylinder",
    "sphere": "sphere",
    "truncated_cone": "truncated cone",
    "wedge": "wedge",
    "clutter": "clutter",
    "unknown": "unknown",
}


class MissionRecord(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """What the page says about the mission as a whole.

    start_s, stop_s: UTC seconds of the first and last ping, NaN if there was none. track_latitude_deg, track_longitude_deg: (n,) float64,
    a few thousand positions at most, NaN where the track breaks. costs: seconds per stage, in the order to show them.
    """

    name: str
    logs: tuple[str, ...]
    start_s: float
    stop_s: float
    track_latitude_deg: NDArray[np.float64]
    track_longitude_deg: NDArray[np.float64]
    distance_m: float
    covered_km2: float
    wall_s: float
    config_yaml: str
    costs: dict[str, float]


def write_report(
    path: Path,
    mission: MissionRecord,
    contacts: Sequence[Contact],
    patches: Iterable[CoveragePatch],
    waypoints: Sequence[Waypoint],
    notices: Iterable[Notice],
    counters: Mapping[str, float],
    pictures: PictureCollector,
) -> None:
    """Write the page to `path`."""
    path.write_text(render_report(mission, contacts, patches, waypoints, notices, counters, pictures), encoding="utf-8", errors="replace")


def render_report(
    mission: MissionRecord,
    contacts: Sequence[Contact],
    patches: Iterable[CoveragePatch],
    waypoints: Sequence[Waypoint],
    notices: Iterable[Notice],
    counters: Mapping[str, float],
    pictures: PictureCollector,
) -> str:
    """The page as text."""
    import jinja2  # bench extra: pictures must be at hand without it
    from markupsafe import Markup

    folder = Path(__file__).parent
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    ranked = sorted(contacts, key=lambda contact: (not contact.p_mine >= 0.0, -contact.p_mine, contact.id))
    strips = pictures.strips()
    track_deg = np.column_stack([mission.track_latitude_deg, mission.track_longitude_deg]).astype(np.float64)
    cards = _cards(ranked, strips, waypoints)
    return environment.get_template("report.html.j2").render(
        style=Markup((folder / "report.css").read_text(encoding="utf-8")),
        title=mission.name or "Mission report",
        mission=mission,
        facts=_facts(mission, contacts),
        bands=_bands(contacts),
        strips=[_strip_view(strip, ranked, pictures.times()) for strip in strips],
        legend=_legend(),
        chart=draw_chart(track_deg, ranked, patches, waypoints),
        chart_width=WIDTH,
        band=_band,
        likely=[card for card in cards if card.mine_like],
        clutter=[card for card in cards if not card.mine_like],
        legs=[point for point in waypoints if point.kind == "leg_exit"],
        counters=words.explained(counters, words.is_loss),
        counted=words.explained(counters, lambda name: not words.is_loss(name)),
        reasons=REASONS,
        notices=_by_code(notices),
        costs=_costs(mission.costs),
        words=words,
    )


def _facts(mission: MissionRecord, contacts: Sequence[Contact]) -> list[tuple[str, str, str]]:
    """Headline figures: value, name, detail."""
    span_s = mission.stop_s - mission.start_s
    likely = sum(is_mine_like(contact) for contact in contacts)
    facts = [
        (str(likely), "mine-like contact" if likely == 1 else "mine-like contacts", f"of {len(contacts)} in all"),
        (words.area(1e6 * mission.covered_km2), "covered", "turns and poor pings left out"),
        (words.distance(mission.distance_m), "sailed", "along the track"),
        (words.duration(span_s), "of recording", _period(mission)),
    ]
    if mission.wall_s > 0.0 and math.isfinite(span_s):
        speed = span_s / mission.wall_s
        facts.append((f"{speed:.0f}×" if speed >= 10.0 else f"{speed:.1f}×", "real time", f"processed in {words.duration(mission.wall_s)}"))
    return facts


def _period(mission: MissionRecord) -> str:
    if not (math.isfinite(mission.start_s) and math.isfinite(mission.stop_s)):
        return "no time was recorded"
    same_day = words.utc(mission.start_s, "%Y-%m-%d") == words.utc(mission.stop_s, "%Y-%m-%d")
    return f"{words.utc(mission.start_s)} to {words.utc(mission.stop_s, '%H:%M:%S' if same_day else '%Y-%m-%d %H:%M:%S')} UTC"


def _band(p_mine: float) -> str:
    """Style class of a p_mine: four steps are told apart by colour at a glance."""
    return "p4" if p_mine >= 0.8 else "p3" if p_mine >= 0.5 else "p2" if p_mine >= 0.2 else "p1"


def _bands(contacts: Sequence[Contact]) -> list[tuple[str, str, int, float]]:
    counted = [sum(_band(contact.p_mine) == name for contact in contacts) for name in ("p4", "p3", "p2", "p1")]
    texts = ("0.8 and above", "0.5 to 0.8", "0.2 to 0.5", "below 0.2")
    most = max(1, *counted)
    return [(name, text, n, 100.0 * n / most) for name, text, n in zip(("p4", "p3", "p2", "p1"), texts, counted, strict=True)]


class _Box(NamedTuple):
    contact: Contact
    left: float
    top: float
    width: float
    height: float
    flip: bool  # label on the left


def _strip_view(strip: Strip, contacts: Sequence[Contact], times: tuple[NDArray[np.float64], NDArray[np.float64]]) -> dict[str, Any]:
    """A strip with its overlays in per cent of the picture."""
    length_m, width_m = strip.stop_m - strip.start_m, 2.0 * strip.half_width_m

    def top(row_m: float) -> float:
        return 100.0 * (strip.stop_m - row_m) / length_m

    boxes = []
    for contact in reversed(contacts):
        for view in contact.views:
            row_m, across_m = _place_m(view)
            if not strip.holds(row_m):
                continue
            tall = _box_m(view.length_m)
            wide = max(_box_m(view.length_m), _box_m(view.width_m))
            left = 50.0 + 100.0 * (across_m - wide / 2.0) / width_m
            boxes.append(_Box(contact, left, top(row_m + tall / 2.0), 100.0 * wide / width_m, 100.0 * tall / length_m, left > 80.0))
    along_step = words.nice_step(length_m, 6)
    across_step = words.nice_step(strip.half_width_m, 4)
    ticks = []
    for number in range(math.ceil(strip.start_m / along_step), math.ceil(strip.stop_m / along_step)):
        row_m = number * along_step
        if 3.0 < top(row_m) < 97.0:
            ticks.append((top(row_m), words.distance(row_m), _clock(row_m, times)))
    across = [number * across_step for number in range(int(strip.half_width_m / across_step) + 1)]
    return {
        "number": strip.number,
        "picture": _data_uri(strip.jpeg, "jpeg"),
        "size": (strip.width_px, strip.height_px),
        "ratio": width_m / length_m,
        "start": words.distance(strip.start_m),
        "stop": words.distance(strip.stop_m),
        "began": _clock(strip.start_m, times),
        "boxes": boxes,
        "likely": sum(is_mine_like(contact) for contact in {box.contact.id: box.contact for box in boxes}.values()),
        "ticks": ticks,
        "ranges": sorted({(50.0 + side * 50.0 * far / strip.half_width_m, f"{far:g}") for far in across for side in (-1.0, 1.0)}),
        "gaps": [
            (top(stop), 100.0 * (stop - start) / length_m, words.distance(stop - start))
            for start, stop in strip.gaps_m
            if stop - start >= 0.005 * length_m
        ],
    }


def _place_m(view: Detection) -> tuple[float, float]:
    """Metres along track from the mission's first grid row, and across track, starboard positive."""
    across_m = view.column * view.column_spacing_m
    return view.row * view.row_spacing_m, across_m if view.side == "starboard" else -across_m


def _box_m(size_m: float) -> float:
    return max(_LEAST_BOX_M, 1.6 * size_m) if math.isfinite(size_m) else _LEAST_BOX_M


def _clock(row_m: float, times: tuple[NDArray[np.float64], NDArray[np.float64]]) -> str:
    rows, seconds = times
    return words.utc(float(np.interp(row_m, rows, seconds)), "%H:%M:%S") if len(rows) else ""


class _Card(NamedTuple):
    contact: Contact
    mine_like: bool
    band: str
    picture: dict[str, Any] | None
    facts: list[tuple[str, str]]
    beliefs: list[tuple[str, str, float]]
    strips: list[int]
    leg: int | None


def _cards(contacts: Sequence[Contact], strips: Sequence[Strip], waypoints: Sequence[Waypoint]) -> list[_Card]:
    legs = {point.contact_id: point.leg for point in waypoints if point.kind == "leg_exit"}
    left = _SNIPPET_BYTES
    cards = []
    for contact in contacts:
        view = best_view(contact)
        picture = None
        if view is not None and left > 0:
            jpeg = snippet_jpeg(view)
            left -= len(jpeg)
            picture = _snippet_view(view, jpeg)
        beliefs = [
            (name, _CLASSES.get(name, name.replace("_", " ")), 100.0 * mass) for name, mass in contact.belief.items() if mass >= 0.005
        ]
        seen = {strip.number for strip in strips for one in contact.views if strip.holds(_place_m(one)[0])}
        cards.append(
            _Card(
                contact=contact,
                mine_like=is_mine_like(contact),
                band=_band(contact.p_mine),
                picture=picture,
                facts=_contact_facts(contact, view),
                beliefs=sorted(beliefs, key=lambda belief: (belief[0] == "unknown", -belief[2])),
                strips=sorted(seen),
                leg=legs.get(contact.id),
            )
        )
    return cards


def _contact_facts(contact: Contact, view: Detection | None) -> list[tuple[str, str]]:
    major_m, minor_m, direction_deg = error_ellipse(contact)
    facts = [
        ("Size", f"{words.metres(contact.length_m)} × {words.metres(contact.width_m)}, height {words.metres(contact.height_m)}"),
        ("Position", f"{contact.latitude_deg:.7f}, {contact.longitude_deg:.7f}"),
        ("", f"{words.degrees_minutes(contact.latitude_deg, 'N', 'S')}, {words.degrees_minutes(contact.longitude_deg, 'E', 'W')}"),
        ("Error, 1 σ", f"{major_m:.2f} × {minor_m:.2f} m along {direction_deg:03.0f}°" if major_m >= 0.0 else "not known"),
        ("First seen", f"{words.utc(contact.time_s)} UTC"),
        ("Aspect", ", ".join(f"{aspect:03.0f}°" for aspect in contact.aspects_deg) or "not known"),
    ]
    if view is not None:
        facts += [
            ("Best view", f"{view.side}, {view.ground_range_m:.1f} m off, ping {view.ping_number}"),
            ("Contrast", f"echo {_decibels(view.highlight_db)}, shadow {_decibels(view.shadow_db)}"),
            ("Score", f"{view.score:.1f} σ"),
        ]
    return facts


def _decibels(level_db: float) -> str:
    return f"{level_db:+.1f} dB".replace("-", "\u2212") if math.isfinite(level_db) else "none"


def _snippet_view(view: Detection, jpeg: bytes) -> dict[str, Any]:
    """A contact's picture with its centroid and a scale bar in per cent, oriented as in the strips."""
    tall_m, wide_m = view.snippet.shape[0] * view.row_spacing_m, view.snippet.shape[1] * view.column_spacing_m
    across = (view.snippet_column + 0.5) / max(1, view.snippet.shape[1])
    along = (view.snippet_row + 0.5) / max(1, view.snippet.shape[0])
    bar_m = next((step for step in (10.0, 5.0, 2.0, 1.0, 0.5, 0.2) if step <= 0.4 * wide_m), 0.1)
    return {
        "picture": _data_uri(jpeg, "jpeg"),
        "ratio": wide_m / tall_m if tall_m > 0.0 else 1.0,
        "left": 100.0 * (1.0 - across if view.side == "port" else across),
        "top": 100.0 * (1.0 - along),
        "bar_m": f"{bar_m:g} m",
        "bar": 100.0 * bar_m / wide_m if wide_m > 0.0 else 0.0,
        "port": view.side == "port",
    }


def _by_code(notices: Iterable[Notice]) -> list[tuple[str, int, list[Notice]]]:
    codes: dict[str, list[Notice]] = {}
    for notice in notices:
        codes.setdefault(notice.code, []).append(notice)
    return [(code, len(codes[code]), codes[code][:_NOTICES_PER_CODE]) for code in codes]


def _costs(costs: Mapping[str, float]) -> list[tuple[str, str, float]]:
    total = sum(costs.values())
    return [(name.replace("_", " "), f"{seconds:.2f} s", 100.0 * seconds / total) for name, seconds in costs.items()] if total > 0.0 else []


def _legend() -> dict[str, Any]:
    """The colour scale of the strips."""
    colours = [f"#{red:02x}{green:02x}{blue:02x}" for blue, green, red in COLOURS.tolist()]
    return {
        "gradient": ", ".join(colours[1:64:6]),
        "floor": f"{FLOOR_DB:+.0f} dB".replace("-", "\u2212"),
        "ceiling": f"{CEILING_DB:+.0f} dB",
        "none": colours[0],
        "soft": colours[64 + 40],
        "turned": colours[128 + 40],
    }


def _data_uri(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
