"""Word a contact for people: one sentence, and at most one reason for a mine and one against it.

The report, the page of `auv-mcm view`, contacts.csv, contacts.geojson and the console all say what stands here. One
rule keeps label, picture, bar, evidence and call from contradicting each other:

- How likely a mine is, follows from `p_mine` alone, and the per cent that are said lie on the same side of each
  threshold as `p_mine` does.
- A kind of mine is named only for a contact that is rather a mine than not, and only if the belief in that kind is a
  half or more. Everywhere else the shape is said to be unclear.
- The bar shows `p_mine` in two parts: the kinds of mine, and `mine, kind open`.
- A picture names the model drawn over it only where that is the kind named.
- The reason for a mine and the reason against it are about different properties, each holds in at least half of the
  views, and there is always one on the side that `p_mine` takes.
- A call that departs from how likely a mine is, is explained in the sentence.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.classify.reasons import bearing, in_words
from auv_mcm.contacts.contact import view_reasons
from auv_mcm.contacts.geojson import METRE_DIGITS, PROBABILITY_DIGITS
from auv_mcm.records import NAN, Contact

RATHER_A_MINE_P: Final = 0.5  # threshold of p_mine, and of belief in a kind: more likely than not
LEVELS: Final = (
    (0.8, "Very likely a mine"),
    (RATHER_A_MINE_P, "Probably a mine"),
    (MINE_LIKE_P, "Possibly a mine"),
    (0.0, "Probably not a mine"),
)
"""Minimum p_mine of each level, and its words. The first step was chosen: four of five such contacts are mines."""
MINES: Final = ("cylinder", "sphere", "truncated_cone", "wedge")

HALF_SEEN: Final = frozenset(
    {
        *("in_shadow", "no_echo", "weak_highlight", "no_highlight", "no_shadow", "shadow_not_dark", "hole_in_bright"),
        *("not_measured", "no_data"),
    }
)
"""Codes which deny that there is an echo with a shadow behind it."""
_NOT_TRACED: Final = frozenset({"no_highlight", "no_shadow"})
"""Codes of confirmation as well, which may find no outline of what the detector measured."""
_OF_SHAPE: Final = frozenset(
    {
        *("clutter", "too_large", "too_small", "too_long", "too_short", "too_low", "too_high", "implausible_height"),
        *("highlight_too_large", "shadow_too_large", "little_evidence"),
    }
)
"""Codes about shape and size, which all views together overrule where they give a kind of mine."""
_PLAINER: Final = {
    "clutter": "its outline fits no kind of mine well",
    "little_evidence": "its outline hardly stands out from the sea floor",
}


class ContactWords(msgspec.Struct, frozen=True, kw_only=True):
    """Hold what is said of a contact.

    level: how likely a mine is, as one of LEVELS; "Not rated" without p_mine. percent: of p_mine, "" without it. kind:
    the class of mine that is named, "" where the shape is unclear. sentence: all of it, for one line. reason_for,
    reason_against: a phrase, "" for none. open_share: belief in a mine of open kind, so that it and the kinds of mine
    add up to p_mine.
    """

    level: str
    percent: str
    kind: str
    sentence: str
    reason_for: str
    reason_against: str
    open_share: float

    @property
    def label(self) -> str:
        """Give the kind for a column of a table, as people write it."""
        return (
            plain_kind(self.kind) if self.kind else "probably not" if self.level == LEVELS[-1][1] else "shape unclear"
        )


def contact_words(contact: Contact) -> ContactWords:
    """Word a contact, its numbers rounded as files give them, so that file and words agree."""
    return describe(
        p_mine=round(contact.p_mine, PROBABILITY_DIGITS),
        belief={name: round(share, PROBABILITY_DIGITS) for name, share in contact.belief.items()},
        length_m=round(contact.length_m, METRE_DIGITS),
        next_look_deg=[round(direction, METRE_DIGITS) for direction in contact.next_look_deg],
        called=contact.called,
        reasons=contact.reasons,
        view_reasons=[view_reasons(view) for view in contact.views],
    )


def feature_words(properties: Mapping[str, Any]) -> ContactWords:
    """Word a contact from the properties of its feature in contacts.geojson, as `contact_words` does its record.

    What a file of an earlier version lacks counts as not known.
    """
    belief = properties.get("belief") or {}
    return describe(
        p_mine=_number(properties.get("p_mine")),
        belief={str(name): _number(share) for name, share in belief.items()} if isinstance(belief, Mapping) else {},
        length_m=_number(properties.get("length_m")),
        next_look_deg=[_number(direction) for direction in properties.get("next_look_deg") or ()],
        called=properties.get("called"),
        reasons=properties.get("reasons") or (),
        view_reasons=[view.get("reasons") or () for view in properties.get("views") or ()],
    )


def describe(
    *,
    p_mine: float,
    belief: Mapping[str, float],
    length_m: float,
    next_look_deg: Sequence[float],
    called: bool | None,
    reasons: Sequence[str],
    view_reasons: Sequence[Sequence[str]],
) -> ContactWords:
    """Word a contact from what its record, or its feature in a file, says.

    Parameters
    ----------
    p_mine
        Probability of a mine, NaN where it is not known.
    belief
        Mass of each class and of `unknown`.
    length_m
        NaN where it is not known.
    next_look_deg
        Directions to view from, the most informative first; empty for none.
    called
        Whether it is on the mine side of the operating point, None before that was decided.
    reasons
        Codes of all its views together.
    view_reasons
        Codes of each view.
    """
    p_mine = p_mine if 0.0 <= p_mine <= 1.0 else NAN
    level = next((words for minimum, words in LEVELS if p_mine >= minimum), "Not rated")
    kind = _kind(p_mine, belief)
    percent = _percent(p_mine)
    chance = f": {percent} chance that it is one." if level == LEVELS[-1][1] else f", {percent}." if percent else "."
    sentences = [
        level + chance,
        _shape(kind, p_mine, length_m),
        f"Seen {_times(len(view_reasons))}." if view_reasons else "",
        _next_look(p_mine, next_look_deg),
        _call(p_mine, called),
    ]
    reason_for, reason_against = _reasons(p_mine, kind, _held_by_most(reasons, view_reasons))
    mines = sum(share for name, share in belief.items() if name in MINES)
    return ContactWords(
        level=level,
        percent=percent,
        kind=kind,
        sentence=" ".join(filter(None, sentences)),
        reason_for=reason_for,
        reason_against=reason_against,
        open_share=min(max(p_mine - mines, 0.0), belief.get("unknown", 0.0)) if p_mine >= 0.0 else 0.0,
    )


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else NAN


def plain_kind(name: str) -> str:
    """Write the name of a class as people do."""
    return name.replace("_", " ")


def _kind(p_mine: float, belief: Mapping[str, float]) -> str:
    kind = max(MINES, key=lambda name: belief.get(name, 0.0))
    return kind if p_mine >= RATHER_A_MINE_P and belief.get(kind, 0.0) >= RATHER_A_MINE_P else ""


def _percent(p_mine: float) -> str:
    """Write whole per cent, rounded, but never across a threshold of LEVELS and never as certainty."""
    if not p_mine >= 0.0:
        return ""
    if p_mine < 0.01:
        return "below 1 %"
    low = next(minimum for minimum, _ in LEVELS if p_mine >= minimum)
    high = min((minimum for minimum, _ in LEVELS if minimum > low), default=1.0)
    return f"{min(max(round(100.0 * p_mine), 1, math.ceil(round(100.0 * low, 6))), round(100.0 * high) - 1)} %"


def _shape(kind: str, p_mine: float, length_m: float) -> str:
    size = f"about {length_m:.1f} m" if length_m >= 0.05 and math.isfinite(length_m) else ""
    if kind:
        return f"{plain_kind(kind).capitalize()}{f' {size}' if size else ', size not measured'}."
    if p_mine >= MINE_LIKE_P:
        return f"Shape unclear{f', {size}' if size else ''}."
    return f"{size.capitalize()}." if size else ""


def _times(number: int) -> str:
    return {1: "once", 2: "twice"}.get(number, f"{number} times")


def _next_look(p_mine: float, next_look_deg: Sequence[float]) -> str:
    if not (p_mine >= MINE_LIKE_P and next_look_deg and math.isfinite(next_look_deg[0])):
        return ""
    first = round(next_look_deg[0]) % 360
    return f"Look again from {first:03d} or {(first + 180) % 360:03d} degrees."


def _call(p_mine: float, called: bool | None) -> str:
    if called is False and p_mine >= RATHER_A_MINE_P:
        return "Not called: more false alarms as mine-like are expected here than are accepted."
    if called and not p_mine >= MINE_LIKE_P:
        return "Called all the same: hardly any false alarm as mine-like is expected here."
    return ""


def _held_by_most(reasons: Sequence[str], views: Sequence[Sequence[str]]) -> list[str]:
    """List codes that half of the views have, and those of no view but of all together, in their order."""
    counted = Counter(code for view in views for code in dict.fromkeys(view))
    named = dict.fromkeys((*reasons, *(code for view in views for code in view)))
    return [code for code in named if not counted[code] or 2 * counted[code] >= len(views)]


def _reasons(p_mine: float, kind: str, codes: Sequence[str]) -> tuple[str, str]:
    """Choose a reason for and one against; the side that p_mine takes always has one."""
    against = [code for code in codes if bearing(code) == "against" and not (kind and code in _OF_SHAPE)]
    is_half_seen = not HALF_SEEN.isdisjoint(codes)
    chosen_for = [code for code in codes if bearing(code) == "for" and not is_half_seen]
    reason_against = _phrase(against[0]) if against else ""
    if against and against[0] in _NOT_TRACED and "highlight_and_shadow" in codes:
        reason_against = "its echo and shadow could not be traced in the sea floor around"
    reason_for = f"echo and shadow fit a {plain_kind(kind)}" if kind and not is_half_seen else ""
    reason_for = reason_for or (_phrase(chosen_for[0]) if chosen_for else "")
    if p_mine >= RATHER_A_MINE_P and not reason_for:
        reason_for = "all in all it looks more like mines than like anything else"
    if not p_mine >= RATHER_A_MINE_P and not reason_against:
        reason_against = "rocks and patches of sea floor look like this at least as often"
    return reason_for, reason_against


def _phrase(code: str) -> str:
    return _PLAINER.get(code) or in_words(code).partition(":")[0]
