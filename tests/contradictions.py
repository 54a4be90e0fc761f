"""The rule that what is said of a contact obeys, written down a second time, from the words alone."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

from auv_mcm.contacts.contact_words import ContactWords, feature_words

SIDES = {"Very likely a mine": (80, 99), "Probably a mine": (50, 79), "Possibly a mine": (20, 49)}
KINDS = ("cylinder", "sphere", "truncated cone", "wedge")
DENIALS = ("without a bright echo", "without a shadow", "no echo", "no bright echo", "too bright")


def contradictions(words: ContactWords, p_mine: float, belief: Mapping[str, float], called: bool | None) -> list[str]:
    """List what contradicts what in the words of a contact; empty for none."""
    found = []
    text, both = words.sentence, f"{words.reason_for} {words.reason_against}"
    number = re.search(r"(\d+) %", text)
    low, high = SIDES.get(words.level, (1, 19))
    if number and not low <= int(number[1]) <= high:
        found.append(f"{number[1]} % is not '{words.level}'")
    if number and "below" not in text and abs(int(number[1]) - 100.0 * p_mine) > 1.0:
        found.append(f"{number[1]} % is not p_mine {p_mine}")
    named = [kind for kind in KINDS if kind in f"{text} {both}".lower()]
    if len(named) > 1:
        found.append(f"several kinds are named: {named}")
    if named and words.label != named[0]:
        found.append(f"label '{words.label}', but {named[0]} is named")
    if named and not (p_mine >= 0.5 and belief.get(named[0].replace(" ", "_"), 0.0) >= 0.5):
        found.append(f"{named[0]} is named without grounds")
    if named and ("fits no kind" in words.reason_against or "unclear" in text):
        found.append("a kind is named, and its shape is denied")
    if (
        words.reason_for
        and any(denial in words.reason_against for denial in DENIALS)
        and "a bright echo with a shadow" in both
    ):
        found.append("an echo with a shadow is claimed and denied")
    if p_mine >= 0.5 and not words.reason_for:
        found.append("a mine without a reason for it")
    if p_mine < 0.5 and not words.reason_against:
        found.append("not rather a mine, without a reason against it")
    if called is True and p_mine < 0.2 and "Called all the same" not in text:
        found.append("called, and probably not a mine")
    if called is False and p_mine >= 0.5 and "Not called" not in text:
        found.append("not called, and probably a mine")
    mines = sum(share for name, share in belief.items() if name not in ("clutter", "unknown")) + words.open_share
    if p_mine >= 0.0 and abs(mines - p_mine) > 1e-3 and belief.get("unknown", 0.0) > words.open_share + 1e-3:
        found.append(f"the bar says {mines}, the sentence {p_mine}")
    return [
        *found,
        *(f"'{word}' is for statistics" for word in ("nats", "p_mine", "sigma") if word in f"{text} {both}"),
    ]


def all_contradictions(contacts: Path) -> list[str]:
    """List what contradicts what in the words of every contact of a file; empty for none."""
    found = []
    for feature in json.loads(contacts.read_bytes())["features"]:
        properties = feature["properties"]
        words = feature_words(properties)
        found += contradictions(words, properties["p_mine"], properties["belief"], properties["called"])
        if words.sentence != properties["summary"]:
            found.append(f"{properties['id']}: the file says '{properties['summary']}', its reader '{words.sentence}'")
    return found
