"""Make a card per contact: one picture, one sentence and two reasons, and behind them the statistics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from auv_mcm.classify.beliefs import bounded_by, singleton_belief
from auv_mcm.classify.reasons import Bearing, bearing, in_words
from auv_mcm.contacts.contact import best_view, call_words, depth_m, error_ellipse, is_mine_like, view_reasons
from auv_mcm.contacts.contact_words import HALF_SEEN, MINES, ContactWords, contact_words, plain_kind
from auv_mcm.records import Contact, Detection, Waypoint
from sim_replay.report import report_words as words
from sim_replay.report.panels import ViewPicture, view_picture
from sim_replay.report.pictures import PictureStrip

_PICTURE_BYTES: Final = (
    # of pictures of contacts in the page; further contacts are described in words, their files lie in snippets/
    1_200_000
)
_MAX_VIEWS: Final = 8  # shown on a card
_MIN_SHARE_SHOWN: Final = 0.005  # of belief
_OPEN_FROM: Final = 0.1  # share of belief, from which a class is still open
_COMPASS: Final = 44.0  # radius of its rose, drawing units


class Share(NamedTuple):
    """Hold the belief in one class."""

    name: str
    text: str
    percent: float


class Reason(NamedTuple):
    """Hold why a view from there is worth while."""

    bearing: Bearing
    text: str


class ViewLine(NamedTuple):
    """Hold the evidence of one view. number: in order of time, from 1.

    beliefs, evidence, model: empty if it was not confirmed.
    """

    number: int
    place: str
    verdict: str
    beliefs: list[Share]
    evidence: str
    model: str
    reasons: list[Reason]


class Arrow(NamedTuple):
    """Draw a view of the contact on the compass: from the rim to near the middle, and where its number stands."""

    path: str
    text: str
    right: float
    down: float


class Compass(NamedTuple):
    """Hold the drawing of a contact's views by direction."""

    label: str
    arrows: list[Arrow]
    next_look: str  # SVG path data


class Card(NamedTuple):
    """Hold the card of one contact."""

    contact: Contact
    mine_like: bool
    band: str
    said: ContactWords
    percent: float
    place: str
    picture: ViewPicture | None
    pictured: str
    facts: list[tuple[str, str]]
    beliefs: list[Share]
    reasons: list[Reason]
    views: list[ViewLine]
    n_more_views: int
    agreement: str
    next_look: str
    compass: Compass | None
    strips: list[int]
    leg: int | None


def cards(contacts: Sequence[Contact], strips: Sequence[PictureStrip], waypoints: Sequence[Waypoint]) -> list[Card]:
    """Make cards in the order of `contacts`; pictures go to the first, as many as the page has room for."""
    legs = {point.contact_id: point.leg for point in waypoints if point.kind == "leg_exit"}
    left = _PICTURE_BYTES
    made = []
    for contact in contacts:
        mine_like = is_mine_like(contact)
        shown = _shown_view(contact)
        picture = None
        if shown is not None and left > 0:
            picture = view_picture(shown, panels=mine_like, kind=contact_words(contact).kind)
            left -= picture.n_bytes
        made.append(_card(contact, shown, picture, strips, legs))
    return made


def band(p_mine: float) -> str:
    """Choose the style class of a p_mine: four steps differ in colour at a glance."""
    return "p4" if p_mine >= 0.8 else "p3" if p_mine >= 0.5 else "p2" if p_mine >= 0.2 else "p1"


def place_m(view: Detection) -> tuple[float, float]:
    """Compute metres along track from the mission's first grid row, and across track, starboard positive."""
    across_m = view.column * view.column_spacing_m
    return view.row * view.row_spacing_m, across_m if view.side == "starboard" else -across_m


def strips_with(contact: Contact, strips: Sequence[PictureStrip]) -> list[int]:
    """List the strips that show a contact, by number."""
    return sorted({strip.number for strip in strips for view in contact.views if strip.holds(place_m(view)[0])})


def _card(
    contact: Contact,
    shown: Detection | None,
    picture: ViewPicture | None,
    strips: Sequence[PictureStrip],
    legs: Mapping[str, int],
) -> Card:
    listed = _listed_views(contact)
    views = [_view_line(number, view) for number, view in listed]
    beliefs = _shares(contact.belief, contact.p_mine)
    if len(views) == 1 and [_rounded(share) for share in views[0].beliefs] == [_rounded(share) for share in beliefs]:
        views = [views[0]._replace(beliefs=[])]  # one view is all there is: once is enough
    listed_with_views = {reason.text for line in views for reason in line.reasons}
    said = contact_words(contact)
    number = next((number for number, view in enumerate(contact.views, start=1) if view is shown), 0)
    return Card(
        contact=contact,
        mine_like=is_mine_like(contact),
        band=band(contact.p_mine),
        said=said,
        percent=100.0 * contact.p_mine if contact.p_mine >= 0.0 else 0.0,
        place=_place(contact),
        picture=picture,
        pictured=f"view {number} of {len(contact.views)}" if len(contact.views) > 1 else "",
        facts=_facts(contact),
        beliefs=beliefs,
        reasons=[reason for reason in _reasons(contact.reasons) if reason.text not in listed_with_views],
        views=views,
        n_more_views=len(contact.views) - len(views),
        agreement=words.agreement(contact.conflict) if math.isfinite(contact.conflict) else "",
        next_look=_next_look(contact),
        compass=_compass(contact, [number for number, _ in listed]),
        strips=strips_with(contact, strips),
        leg=legs.get(contact.id),
    )


def _shown_view(contact: Contact) -> Detection | None:
    """Choose the view with the greatest score, of those with a confirmation if there are any."""
    close = tuple(view for view in contact.views if view.confirmation is not None and view.snippet.size)
    return max(
        close,
        key=lambda view: (-math.inf if math.isnan(view.score) else view.score, -view.time_s),
        default=best_view(contact),
    )


def _listed_views(contact: Contact) -> list[tuple[int, Detection]]:
    """Number the views in order of time; of very many keep those with the greatest scores."""
    numbered = list(enumerate(contact.views, start=1))
    strongest = sorted(numbered, key=lambda one: (-one[1].score if math.isfinite(one[1].score) else math.inf, one[0]))[
        :_MAX_VIEWS
    ]
    return sorted(strongest, key=lambda one: one[0])


def _view_line(number: int, view: Detection) -> ViewLine:
    found = view.confirmation
    direction, time = _compass_deg(view.aspect_deg), words.utc(view.time_s, "%H:%M:%S")
    place = f"{view.side}, {words.metres(view.ground_range_m, 1)} off, looking towards {direction}, {time}"
    if found is None:
        return ViewLine(number, place, "Not confirmed", [], "", "", _reasons(view.reasons))
    verdict, model = "Contours rejected" if found.rejected else "Contours of an object", ""
    if found.model is not None:
        model = (
            f"Best model: {plain_kind(found.model.classification)}, "
            f"{words.model_sizes(found.model.sizes, found.model.sigma)}"
        )
    return ViewLine(
        number,
        place,
        verdict,
        _shares(singleton_belief(bounded_by(found.mass, view.p_mine)), view.p_mine),
        words.evidence_words(found.log_ratio),
        model,
        _reasons(view_reasons(view)),
    )


def _reasons(codes: Sequence[str]) -> list[Reason]:
    """Sort what speaks for a mine, what against, and then what limits both."""
    if HALF_SEEN & set(codes):
        codes = [code for code in codes if code != "highlight_and_shadow"]  # of detection, which confirmation corrects
    reasons = [Reason(bearing(code), in_words(code)) for code in codes]
    return sorted(reasons, key=lambda reason: ("for", "against", "note").index(reason.bearing))


def _shares(belief: Mapping[str, float], p_mine: float) -> list[Share]:
    """Sort the belief: kinds of mine, greatest first, then mines of open kind, so that these add up to p_mine.

    Then comes clutter, and the unknown last.
    """
    kinds = {name: share for name, share in belief.items() if name in MINES}
    unknown = belief.get("unknown", 0.0)
    is_open = min(max(p_mine - sum(kinds.values()), 0.0), unknown) if p_mine >= 0.0 else 0.0
    rest = {name: share for name, share in belief.items() if name not in MINES and name != "unknown"}
    parts = [
        *sorted(kinds.items(), key=lambda part: -part[1]),
        ("open", is_open),
        *sorted(rest.items(), key=lambda part: -part[1]),
        ("unknown", unknown - is_open),
    ]
    return [
        Share(name, "mine, kind open" if name == "open" else plain_kind(name), 100.0 * share)
        for name, share in parts
        if share >= _MIN_SHARE_SHOWN
    ]


def _rounded(share: Share) -> tuple[str, int]:
    return share.name, round(share.percent)


def _next_look(contact: Contact) -> str:
    if not contact.next_look_deg:
        looked = any(view.confirmation is not None for view in contact.views)
        return "a further view would hardly change the call" if looked else ""
    first = contact.next_look_deg[0]
    line = f"along {_compass_deg(first)} or {_compass_deg(first + 180.0)}"
    off = [abs(math.remainder(aspect - first, 180.0)) for aspect in contact.aspects_deg if math.isfinite(aspect)]
    why = [f"the nearest view so far was {min(off):.0f}° off"] if off else []
    likely = sorted(
        ((share, name) for name, share in contact.belief.items() if share >= _OPEN_FROM and name != "unknown"),
        reverse=True,
    )
    if contact.belief.get("unknown", 0.0) >= 0.5:
        why.append("its kind is open")
    elif len(likely) > 1:
        why.append(f"it is open between {words.listed([plain_kind(name) for _, name in likely[:3]])}")
    return f"{line}: {words.listed(why)}" if why else line


def _compass_deg(direction_deg: float) -> str:
    return f"{round(direction_deg) % 360:03d}°" if math.isfinite(direction_deg) else "?"


def _compass(contact: Contact, numbers: Sequence[int]) -> Compass | None:
    """Draw views as arrows towards the contact in the middle, the next proposed as a line through it; north is up."""
    looks = [(number, contact.views[number - 1].aspect_deg) for number in numbers]
    looks = [(number, aspect) for number, aspect in looks if math.isfinite(aspect)]
    if not contact.next_look_deg and len(looks) < 2:
        return None
    arrows = []
    for number, aspect in looks:
        right, down = math.sin(math.radians(aspect)), -math.cos(math.radians(aspect))
        tip, tail = (-9.0 * right, -9.0 * down), (-_COMPASS * right, -_COMPASS * down)
        barbs = [
            (tip[0] - 8.0 * right + side * 4.0 * down, tip[1] - 8.0 * down - side * 4.0 * right) for side in (-1.0, 1.0)
        ]
        path = f"M{_at(tail)}L{_at(tip)}M{_at(barbs[0])}L{_at(tip)}L{_at(barbs[1])}"
        arrows.append(Arrow(path, str(number), -(_COMPASS + 9.0) * right, -(_COMPASS + 9.0) * down + 3.5))
    line = ""
    if contact.next_look_deg:
        turn = math.radians(contact.next_look_deg[0])
        end = _COMPASS * math.sin(turn), -_COMPASS * math.cos(turn)
        line = f"M{_at((-end[0], -end[1]))}L{_at(end)}"
    label = "Look angles so far: " + (
        words.listed([_compass_deg(aspect) for _, aspect in looks]) or "directions not known"
    )
    return Compass(label, arrows, line)


def _at(point: tuple[float, float]) -> str:
    return f"{point[0]:.1f} {point[1]:.1f}"


def _place(contact: Contact) -> str:
    latitude = words.degrees_minutes(contact.latitude_deg, "N", "S")
    depth = f", {depth_m(contact):.1f} m deep" if math.isfinite(depth_m(contact)) else ""
    return f"{latitude}, {words.degrees_minutes(contact.longitude_deg, 'E', 'W')}{depth}"


def _facts(contact: Contact) -> list[tuple[str, str]]:
    major_m, minor_m, direction_deg = error_ellipse(contact)
    length, width, height = (
        words.plus_minus(*size)
        for size in (
            (contact.length_m, contact.length_sigma_m),
            (contact.width_m, contact.width_sigma_m),
            (contact.height_m, contact.height_sigma_m),
        )
    )
    facts = [
        ("p_mine", f"{contact.p_mine:.4f}" if math.isfinite(contact.p_mine) else "not known"),
        ("Size", f"{length} × {width}, height {height}"),
        ("Depth", f"{depth_m(contact):.1f} m" if math.isfinite(depth_m(contact)) else "not known"),
        ("Position", f"{contact.latitude_deg:.7f}, {contact.longitude_deg:.7f}"),
        (
            "Error, 1 σ",
            f"{major_m:.2f} × {minor_m:.2f} m along {direction_deg:03.0f}°" if major_m >= 0.0 else "not known",
        ),
        ("First seen", f"{words.utc(contact.time_s)} UTC"),
        ("Aspect", ", ".join(_compass_deg(aspect) for aspect in contact.aspects_deg) or "not known"),
    ]
    if contact.called is not None:
        facts.insert(1, ("Called a mine", call_words(contact)))
    view = best_view(contact)
    if view is not None:
        facts += [
            ("Best view", f"{view.side}, {words.metres(view.ground_range_m, 1)} off, ping {view.ping_number}"),
            ("Contrast", f"echo {words.decibels(view.highlight_db)}, shadow {words.decibels(view.shadow_db)}"),
            ("Contrast score", f"{view.score:.1f} σ" if math.isfinite(view.score) else "unknown"),
        ]
    return facts
