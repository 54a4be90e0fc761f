"""Find announced contacts that the journal does not hold, or that the results hold otherwise."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

CONTACT: Final = re.compile(r"^contact (\S+) (?:new|updated): (\S+), p_mine (\S+), (\S+) (\S+), (\d+) views$")
"""The line with which the console announces a contact."""


def announced_in(journal: bytes) -> list[tuple[int, str]]:
    """List event and contact of each whole line of contacts.jsonl."""
    return [(record["event"], record["contact"]["properties"]["id"]) for record in _whole(journal)]


def stored_otherwise(journal: bytes, stored: Sequence[Mapping[str, Any]]) -> list[str]:
    """List contacts whose last line of contacts.jsonl is not what contacts.geojson holds, in words.

    What the operating point of the whole mission may change at the end is left out.
    """
    announced = {record["contact"]["properties"]["id"]: record["contact"] for record in _whole(journal)}
    features = {feature["properties"]["id"]: feature for feature in stored}
    found = [f"{name} is not stored" for name in sorted(announced.keys() - features.keys())]
    found += [f"{name} was not announced" for name in sorted(features.keys() - announced.keys())]
    for name in sorted(announced.keys() & features.keys()):
        was, now = ((feature["properties"], feature["geometry"]) for feature in (announced[name], features[name]))
        differ = [key for key in ("p_mine", "time") if was[0][key] != now[0][key]]
        differ += ["place"] if was[1] != now[1] else []
        found += [f"{name} is stored with another {' and '.join(differ)}"] if differ else []
    return found


def _whole(journal: bytes) -> list[dict[str, Any]]:
    """Read the whole lines of a journal."""
    return [json.loads(line) for line in journal.split(b"\n")[:-1]]


def not_in_journal(console: Sequence[str], journal: bytes) -> tuple[str, ...]:
    """List the console's lines of contacts which no whole line of contacts.jsonl holds with the same figures."""
    held = []
    for record in journal.split(b"\n")[:-1]:  # what has no end was cut off, and never announced
        feature = json.loads(record)["contact"]
        held.append((feature["properties"], feature["geometry"]["coordinates"]))
    missing = []
    for line in console:
        if (matched := CONTACT.match(line)) is None:
            continue
        contact_id, classification, *figures = matched.groups()
        p_mine, latitude_deg, longitude_deg = map(float, figures[:3])
        if not any(
            properties["id"] == contact_id
            and properties["class"] == classification
            and math.isclose(properties["p_mine"], p_mine, abs_tol=0.0051)
            and math.isclose(place[1], latitude_deg, abs_tol=2e-7)
            and math.isclose(place[0], longitude_deg, abs_tol=2e-7)
            for properties, place in held
        ):
            missing.append(line)
    return tuple(missing)
