"""Sum up a replay in one line: what was found, how much floor was searched how well, and what to mend first."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

_MEND: Final = {
    "transfer.chosen": "set sonar.transfer, as the samples leave open what they are",
    "transfer.unchecked": "set sonar.transfer, as too few samples show what they are",
    "transfer.disagrees": "check sonar.transfer, as the samples look otherwise",
    "transfer.turned": "replay logs of different recorders apart, or set sonar.transfer",
    "quality.samples_unusable": "check what records or reads the samples, as those of a side cannot be used",
    "contacts.background_unlike": "look at the pictures, as p_mine may be wrong on this floor",
}
"""What a person can do about notices that question the whole mission, by code; the first two found are named."""
_MOST: Final = 2  # notices named: a line, no list. Chosen


def closing_line(summary: Mapping[str, Any]) -> str:
    """Write the line from what `summary.json` holds."""
    n_called = int(summary.get("contacts_called", 0))
    parts = [f"{n_called} contact{'' if n_called == 1 else 's'} called mine{'' if n_called == 1 else 's'}"]
    point = summary.get("operating_point") or {}
    expected = (point.get("expected_per_km2") or {}).get("middle")
    if n_called and expected is not None and point["searched_km2"]:
        parts[0] += f", of which {expected * point['searched_km2']:.0f} are expected to be none"
    searched = summary.get("searched")
    if searched:
        parts.append(
            f"{searched['km2']:.3g} km² searched, where {100.0 * searched['p_detected_mean']:.0f} % of mines are "
            "expected to be found"
        )
    else:
        parts.append("no sea floor searched")
    if n_corrected := summary.get("counters", {}).get("bottom.corrected"):
        parts.append(f"bottom line corrected by hand over {n_corrected} pings")
    line = "; ".join(parts) + "."
    mend = to_mend(summary)
    return line + (f" To mend: {'; '.join(mend)}." if mend else "")


def to_mend(summary: Mapping[str, Any]) -> list[str]:
    """List what a person should do first, most consequential first."""
    codes = [notice["code"] for notice in summary.get("notices", ())]
    found = [words for code, words in _MEND.items() if code in codes][:_MOST]
    if n_lost := summary.get("counters", {}).get("detect.without_position"):
        found.insert(0, f"record positions, as {n_lost} detections without one are left out")
    elif (n_far := summary.get("counters", {}).get("navigation.ping_stale", 0)) and not summary.get("searched"):
        found.insert(0, f"give pings and navigation one clock, as {n_far} pings are not near a position in time")
    point = summary.get("operating_point") or {}
    if point.get("area_too_small") and summary.get("searched"):
        found.append(
            f"the area is too small for {point['asked_per_km2']:g} false alarms per km² to mean one; go by the order "
            "of p_mine"
        )
    return found
