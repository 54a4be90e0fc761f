"""Write the mission report: one HTML file that needs nothing else, for a person to read on a screen or on paper."""

from __future__ import annotations

import base64
import functools
import hashlib
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.clearance.residual import PRIOR_SHARE
from auv_mcm.contacts.contact import depth_m, is_mine_like, sigma_m
from auv_mcm.contacts.contact_picture import CEILING_DB, COLOURS, FLOOR_DB
from auv_mcm.contacts.contact_words import ContactWords, contact_words
from auv_mcm.contacts.export import snippet_path
from auv_mcm.records import Contact, CoveragePatch, Notice, Waypoint
from auv_mcm.shell.whole_files import write_file
from sim_replay.report import report_words as words
from sim_replay.report.cards import band, cards, place_m, strips_with
from sim_replay.report.chart import WIDTH, draw_chart
from sim_replay.report.map_picture import MapPicture
from sim_replay.report.pictures import PictureStrip
from sim_replay.structures import Member, find_structures
from sim_replay.verdicts import CALLS, Judged, Place, Verdict, evidence_words, is_missed, sorted_verdicts

_NOTICES_PER_CODE: Final = 5  # shown, the others are counted
MAX_CARDS: Final = 100  # bounds the page: see MAX_ROWS
MAX_ROWS: Final = 1000
"""Contacts in the table that have no card. With MAX_CARDS and the limits of pictures the page stays below 5 MB.
"""
MAX_STRUCTURES: Final = 50  # on the page, the largest: bounds it too
MAX_MISSED: Final = 200  # objects that only people saw, on the page: bounds it too
_SUMMARY_ORDER: Final[Mapping[str, int]] = {"mine_like": 0, "": 1, "undecided": 1, "not_mine_like": 2}
"""Order of the summary's contacts by verdict, empty for none."""
_LAYERS: Final = (
    ("mosaic", "sonar"),
    ("covered", "covered"),
    ("track", "track"),
    ("leg", "second views"),
    ("p1", "clutter"),
    ("ellipse", "errors"),
)
"""Parts of the map that can be switched off: the style class of each and its name."""
ONE_PAGE: Final = "one-page.html"
_ONE_PAGE_ROWS: Final = 12  # contacts in the summary: more do not fit below the map on a page of A4
_NAMED: Final = 5  # people named in the summary
_TURN_COLOUR: Final = "#7a3fc0"  # of the bars beside a strip, as in the style
_MIN_BOX_M: Final = 3.0  # m: of the mark around a contact, so that it stays visible


class MissionRecord(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold the facts of the mission as a whole.

    start_s, stop_s: UTC seconds of the first and last ping, NaN if there was none; duration_s: without holes between
    logs, NaN in results of older builds. track_latitude_deg, track_longitude_deg: (n,) float64, a few thousand
    positions at most, NaN where the track breaks. costs: seconds per stage, in the order to show them. searched: what
    `search_totals` says, clearance_png: the picture of it; both empty if nothing was. files: names of the files beside
    the page, to link to. map_picture: the sonar picture under the map. verdicts: of people, in the order of judging.
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
    searched: dict[str, Any] = {}
    clearance_png: bytes = b""
    files: tuple[str, ...] = ()
    map_picture: MapPicture | None = None
    verdicts: tuple[Verdict, ...] = ()
    duration_s: float = math.nan


class Pictures(Protocol):
    """Give the strips of the waterfall, and when the vehicle passed where."""

    def strips(self) -> tuple[PictureStrip, ...]:
        """Give the strips, within the bytes that a page has room for."""
        ...

    def times(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Give places along the track, m, ascending, and the UTC seconds there."""
        ...


class Shown(NamedTuple):
    """Hold all that a report shows."""

    mission: MissionRecord
    contacts: Sequence[Contact]
    patches: Iterable[CoveragePatch]
    waypoints: Sequence[Waypoint]
    notices: Iterable[Notice]
    counters: Mapping[str, float]
    pictures: Pictures


def ranked_contacts(contacts: Iterable[Contact]) -> list[Contact]:
    """Sort contacts, the likeliest mine first."""
    return sorted(contacts, key=lambda contact: (not contact.p_mine >= 0.0, -contact.p_mine, contact.id))


def write_report(path: Path, shown: Shown) -> None:
    """Write the page to `path`, and beside it a summary that prints on one page of A4.

    The MAX_CARDS contacts most likely to be mines get a card, these and the next MAX_ROWS a line of the table; the rest
    is in the contact files alone.
    """
    context = _context(shown)
    for name, template in ((path, "report.html.j2"), (path.with_name(ONE_PAGE), "one_page.html.j2")):
        write_file(name, _rendered(template, context).encode("utf-8", "replace"))


def render_report(shown: Shown) -> str:
    """Render the page as text."""
    return _rendered("report.html.j2", _context(shown))


def _rendered(template: str, context: Mapping[str, Any]) -> str:
    return str(_environment().get_template(template).render(context))


@functools.cache
def _environment() -> Any:
    import jinja2  # bench extra: pictures must be at hand without it

    loader, undefined = jinja2.FileSystemLoader(Path(__file__).parent), jinja2.StrictUndefined
    # Templates are compiled in every process and drawn once: optimising takes longer than it saves.
    return jinja2.Environment(
        loader=loader, undefined=undefined, autoescape=True, trim_blocks=True, lstrip_blocks=True, optimized=False
    )


def _context(shown: Shown) -> dict[str, Any]:
    """Gather what the templates show."""
    mission, contacts, patches, waypoints, notices, counters, pictures = shown
    ranked = ranked_contacts(contacts)
    strips = pictures.strips()
    track_deg = np.column_stack([mission.track_latitude_deg, mission.track_longitude_deg]).astype(np.float64)
    places = [Place(one.id, one.latitude_deg, one.longitude_deg, sigma_m(one)) for one in ranked]
    judged, alone = sorted_verdicts(mission.verdicts, places)
    missed = [verdict for verdict in alone if is_missed(verdict)]
    structures = find_structures([_member(one) for one in ranked])[:MAX_STRUCTURES]
    part_of = {member.contact_id: one.id for one in structures for member in one.members}
    # Whatever somebody may have to act on has its own line.
    own_line = {one.id for one in ranked if one.called or is_mine_like(one) or one.id in judged}
    listed = ranked[: MAX_CARDS + MAX_ROWS]
    listed += [one for one in ranked[len(listed) :] if one.id in judged][:MAX_ROWS]
    described = cards(listed[:MAX_CARDS], strips, waypoints)
    first = {card.contact.id for card in described if _is_likely(card.contact, judged)}
    rows = [_contact_row(contact, strips, number < MAX_CARDS) for number, contact in enumerate(listed)]
    likely_rows = [row for row in rows if _is_likely(row.contact, judged)]
    likely_rows.sort(key=lambda row: _SUMMARY_ORDER[_call(row.contact, judged)])
    return {
        **_frame(),
        **_of_mission(mission, list(notices), counters),
        "facts": _facts(mission, contacts),
        "bands": _bands(contacts),
        "strips": [_strip_view(strip, listed, pictures.times()) for strip in strips],
        "chart": draw_chart(
            track_deg,
            listed,
            patches,
            waypoints,
            mission.map_picture and mission.map_picture.box,
            missed[:MAX_MISSED],
            structures,
        ),
        "kinds": sorted({row.said.label for row in rows}),
        "said": {row.contact.id: row.said for row in rows},
        "likely": [card for card in described if card.contact.id in first],
        "clutter": [card for card in described if card.contact.id not in first],
        "rows": rows,
        "first_rows": likely_rows[:_ONE_PAGE_ROWS],
        "judged": judged,
        "structures": structures,
        "part_of": part_of,
        "grouped": set(part_of) - own_line,
        "missed": missed,
        "judgement": _judgement(judged.values(), missed, len(alone) - len(missed)),
        "n_more_likely": len(likely_rows[_ONE_PAGE_ROWS:]),
        "n_unlisted": len(ranked) - len(listed),
        "legs": [point for point in waypoints if point.kind == "leg_exit"],
    }


def _frame() -> dict[str, Any]:
    """Give what is the same for every mission."""
    from markupsafe import Markup  # comes with jinja2

    folder = Path(__file__).parent
    script = (folder / "report.js").read_text(encoding="utf-8")
    return {
        "style": Markup((folder / "report.css").read_text(encoding="utf-8")),
        "legend": _legend(),
        "script": Markup(script),
        "script_sha256": base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        "layers": _LAYERS,
        "chart_width": WIDTH,
        "band": band,
        "calls": CALLS,
        "most_missed": MAX_MISSED,
        "mine_like_p": MINE_LIKE_P,
        "words": words,
    }


def _of_mission(mission: MissionRecord, notices: Sequence[Notice], counters: Mapping[str, float]) -> dict[str, Any]:
    """Give what is shown of the mission as a whole."""
    return {
        "title": mission.name or "Mission report",
        "mission": mission,
        "mosaic_uri": "" if mission.map_picture is None else _data_uri(mission.map_picture.webp, "webp"),
        "searched": _searched(mission.searched),
        "mines_left": _mines_left(mission.searched),
        "clearance_map": base64.b64encode(mission.clearance_png).decode(),
        "counters": words.explained_counters(counters, words.is_loss),
        "counted": words.explained_counters(counters, lambda name: not words.is_loss(name)),
        "notices": _by_code([notice for notice in notices if not notice.for_the_record]),
        "remarks": _by_code([notice for notice in notices if notice.for_the_record]),
        "costs": _costs(mission.costs),
    }


def _member(contact: Contact) -> Member:
    return Member(
        contact.id, contact.latitude_deg, contact.longitude_deg, contact.length_m, contact.p_mine, bool(contact.called)
    )


def _call(contact: Contact, judged: Mapping[str, Verdict]) -> str:
    verdict = judged.get(contact.id)
    return "" if verdict is None else verdict.call


def _is_likely(contact: Contact, judged: Mapping[str, Verdict]) -> bool:
    """Decide whether a contact comes first: called, mine-like, or judged so."""
    return bool(contact.called) or is_mine_like(contact) or _call(contact, judged) == "mine_like"


def _judgement(judged: Collection[Verdict], missed: Sequence[Verdict], n_unmatched: int) -> str:
    """Sum up what people judged, empty if nobody did. n_unmatched: other verdicts that no contact stands for."""
    verdicts = [*judged, *missed]
    if not (verdicts or n_unmatched):
        return ""
    counts = (f"{sum(one.call == call for one in verdicts)} {words.call_name(call)}" for call in CALLS)
    names = sorted({one.by for one in verdicts})
    by = ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
    alone = f"; {len(missed)} of them missed: no contact stands for them" if missed else ""
    if n_unmatched:
        alone += f"; {n_unmatched} more unmatched: no contact stands for what was judged"
    of_contacts = [one.call for one in judged]
    enough = evidence_words([Judged(*map(of_contacts.count, CALLS))])
    by = f"; judged by {by}" if by else ""
    return f"{', '.join(counts)}{alone}{by}. Of this mission alone, {enough}."


def _facts(mission: MissionRecord, contacts: Sequence[Contact]) -> list[tuple[str, str, str]]:
    """List headline figures: value, name, detail."""
    likely = sum(is_mine_like(contact) for contact in contacts)
    facts = [
        (str(likely), "mine-like contact" if likely == 1 else "mine-like contacts", f"of {len(contacts)} in all"),
        (
            words.area(1e6 * mission.covered_km2),
            "covered",
            "overlap counted twice; turns, poor pings, large shadows left out",
        ),
        (words.distance(mission.distance_m), "sailed", "along the track"),
        (words.duration(mission.duration_s), "of recording", _period(mission)),
    ]
    if any(contact.called is not None for contact in contacts):
        called = sum(bool(contact.called) for contact in contacts)
        facts.insert(1, (str(called), "called", "within the false alarms per km² that you accept"))
    if mission.wall_s > 0.0 and math.isfinite(mission.duration_s):
        speed = mission.duration_s / mission.wall_s
        facts.append(
            (
                f"{speed:.0f}×" if speed >= 10.0 else f"{speed:.1f}×",
                "real time",
                f"processed in {words.duration(mission.wall_s)}",
            )
        )
    return facts


class ContactRow(NamedTuple):
    """Hold a contact in one line."""

    contact: Contact
    carded: bool
    called: str
    said: ContactWords
    length: str
    size: str
    depth: str
    place: str
    strips: list[int]
    snippet: str


def _contact_row(contact: Contact, strips: Sequence[PictureStrip], carded: bool) -> ContactRow:
    latitude = words.degrees_minutes(contact.latitude_deg, "N", "S")
    longitude = words.degrees_minutes(contact.longitude_deg, "E", "W")
    sizes = [_number(size_m, 2) for size_m in (contact.length_m, contact.width_m, contact.height_m)]
    return ContactRow(
        contact,
        carded=carded,
        called="" if contact.called is None else "yes" if contact.called else "no",
        said=contact_words(contact),
        length=sizes[0],
        size=" × ".join(size or "?" for size in sizes),
        depth=_number(depth_m(contact), 1),
        place=f"{latitude}, {longitude}",
        strips=strips_with(contact, strips),
        snippet=snippet_path(contact),
    )


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else ""


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def _searched(searched: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """List figures of the search: value, name, detail."""
    if not searched:
        return []
    left, at_p, missed = searched["mines_left"], searched["km2_at_p"], 1.0 - searched["p_detected_mean"]
    return [
        (_percent(missed), "of mines missed", "by the tables for such sea floor and ranges, on average"),
        (words.area(1e6 * at_p["0.9"]), "missed with 10 % or less", f"of {words.area(1e6 * searched['km2'])} seen"),
        (f"{left['expected']:.1f}", "mines left, expected", f"no more than {left['at_most_95']} with 95 %"),
    ]


def _mines_left(searched: Mapping[str, Any]) -> str:
    """Explain where the number of mines left comes from."""
    if not searched:
        return ""
    left = searched["mines_left"]
    own = ""
    if "mine_share" in left:  # results of older versions lack it
        own = f"; of this mission's own contacts {_percent(left['mine_share'])} are, by which the chances are weighed"
    return (
        f"Mine-like contacts stand for {searched['mines_found']:.1f} mines found; mines left are those among the "
        f"{left['among_contacts']} contacts that are not mine-like: their chances add up to {left['p_mine_sum']:.1f}. "
        f"They presume that {_percent(PRIOR_SHARE)} of contacts are mines{own}. A little is added for mines that make "
        "no contact at all; on floors unlike those of simulated missions these can be many."
    )


def _period(mission: MissionRecord) -> str:
    if not (math.isfinite(mission.start_s) and math.isfinite(mission.stop_s)):
        return "no time was recorded"
    same_day = words.utc(mission.start_s, "%Y-%m-%d") == words.utc(mission.stop_s, "%Y-%m-%d")
    return (
        f"{words.utc(mission.start_s)} to "
        f"{words.utc(mission.stop_s, '%H:%M:%S' if same_day else '%Y-%m-%d %H:%M:%S')} UTC"
    )


def _bands(contacts: Sequence[Contact]) -> list[tuple[str, str, int, float]]:
    counted = [sum(band(contact.p_mine) == name for contact in contacts) for name in ("p4", "p3", "p2", "p1")]
    texts = ("80 % and above", "50 to 79 %", "20 to 49 %", "below 20 %")
    most = max(1, *counted)
    return [
        (name, text, n, 100.0 * n / most)
        for name, text, n in zip(("p4", "p3", "p2", "p1"), texts, counted, strict=True)
    ]


class _Box(NamedTuple):
    contact: Contact
    left: float
    top: float
    width: float
    height: float
    flip: bool  # label on the left


def _strip_view(
    strip: PictureStrip, contacts: Sequence[Contact], times: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> dict[str, Any]:
    """Lay overlays over a strip, in per cent of the picture."""
    length_m, width_m = strip.stop_m - strip.start_m, 2.0 * strip.half_width_m

    def top(row_m: float) -> float:
        return 100.0 * (strip.stop_m - row_m) / length_m

    boxes = []
    for contact in reversed(contacts):
        for view in contact.views:
            row_m, across_m = place_m(view)
            if not strip.holds(row_m):
                continue
            tall = _box_m(view.length_m)
            wide = max(_box_m(view.length_m), _box_m(view.width_m))
            left = 50.0 + 100.0 * (across_m - wide / 2.0) / width_m
            boxes.append(
                _Box(
                    contact, left, top(row_m + tall / 2.0), 100.0 * wide / width_m, 100.0 * tall / length_m, left > 80.0
                )
            )
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
        "ranges": sorted(
            {(50.0 + side * 50.0 * far / strip.half_width_m, f"{far:g}") for far in across for side in (-1.0, 1.0)}
        ),
        "turns": [(top(stop), 100.0 * (stop - start) / length_m) for start, stop in strip.turns_m],
        "gaps": [
            (top(stop), 100.0 * (stop - start) / length_m, words.distance(stop - start))
            for start, stop in strip.gaps_m
            if stop - start >= 0.005 * length_m
        ],
    }


def _box_m(size_m: float) -> float:
    return max(_MIN_BOX_M, 1.6 * size_m) if math.isfinite(size_m) else _MIN_BOX_M


def _clock(row_m: float, times: tuple[NDArray[np.float64], NDArray[np.float64]]) -> str:
    rows, seconds = times
    return words.utc(float(np.interp(row_m, rows, seconds)), "%H:%M:%S") if len(rows) else ""


def _by_code(notices: Iterable[Notice]) -> list[tuple[str, int, list[Notice]]]:
    codes: dict[str, list[Notice]] = {}
    for notice in notices:
        codes.setdefault(notice.code, []).append(notice)
    return [(code, len(codes[code]), codes[code][:_NOTICES_PER_CODE]) for code in codes]


def _costs(costs: Mapping[str, float]) -> list[tuple[str, str, float]]:
    total = sum(costs.values())
    return (
        [(name.replace("_", " "), f"{seconds:.2f} s", 100.0 * seconds / total) for name, seconds in costs.items()]
        if total > 0.0
        else []
    )


def _legend() -> dict[str, Any]:
    """Draw the colour scale of the strips."""
    colours = [f"#{red:02x}{green:02x}{blue:02x}" for blue, green, red in COLOURS.tolist()]
    return {
        "gradient": ", ".join(colours[1:64:6]),
        "floor": f"{FLOOR_DB:+.0f} dB".replace("-", "\u2212"),
        "ceiling": f"{CEILING_DB:+.0f} dB",
        "none": colours[0],
        "soft": colours[64 + 40],
        "turned": _TURN_COLOUR,
    }


def _data_uri(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
