"""Find announced contacts that the journal does not hold."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from typing import Final

CONTACT: Final = re.compile(r"^contact (\S+) (?:new|updated): (\S+), p_mine (\S+), (\S+) (\S+), (\d+) views$")
"""The line with which the console announces a contact."""


def announced_in(journal: bytes) -> list[tuple[int, str]]:
    """List event and contact of each whole line of contacts.jsonl."""
    records = [json.loads(line) for line in journal.split(b"\n")[:-1]]
    return [(record["event"], record["contact"]["properties"]["id"]) for record in records]


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
