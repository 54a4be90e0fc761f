"""Put in words what moved between two answers."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

from tests.golden.answers import Answer

P_CHANGED: Final = 0.01  # of p_mine; issue of the golden answers: what moved by less does not change a decision
MOVED_M: Final = 0.1  # a fifth of a small mine's length; less is no news to a diver (chosen)
SAME_CONTACT_M: Final = 2.0  # within which a contact that came is one that went: the scoring gate's order (chosen)
PLACE_TOLERANCE_M: Final = 0.001  # documented: across platforms places agree to 1 mm
_METRE_PER_DEGREE: Final = 111_195.0  # mean Earth radius 6371 km times pi / 180


class Tolerance(NamedTuple):
    """What counts as moved. p_mine: of a contact. place_m: of a contact. digests: whether bytes count."""

    p_mine: float
    place_m: float
    digests: bool


WORDS: Final = Tolerance(p_mine=P_CHANGED, place_m=MOVED_M, digests=True)
OTHER_PLATFORM: Final = Tolerance(p_mine=P_CHANGED, place_m=PLACE_TOLERANCE_M, digests=False)


def mission_differences(old: Answer, new: Answer, tolerance: Tolerance = WORDS) -> list[str]:
    """Say what moved in the answer to a mission: contacts first, then totals, notices, counters and files."""
    if ("error" in old) or ("error" in new):
        was, now = old.get("error", "an answer"), new.get("error", "an answer")
        return [] if was == now else [f"was: {was}", f"is: {now}"]
    found = list(_contacts(old["contacts"], new["contacts"], tolerance))
    if not tolerance.digests:
        return found
    if old["log"] != new["log"]:
        found.insert(0, "the mission itself is another: its log has other bytes")
    found += _numbers("", old["totals"], new["totals"])
    before: Counter[str] = Counter(old["notices"])
    after: Counter[str] = Counter(new["notices"])
    found += [f"notice gone: {text}" for text in (before - after).elements()]
    found += [f"notice new: {text}" for text in (after - before).elements()]
    found += _numbers("counter ", old["counters"], new["counters"])
    moved = [name for name in _either(old["digests"], new["digests"]) if _differ(old["digests"], new["digests"], name)]
    return [*found, *([f"other bytes: {', '.join(moved)}"] if moved else [])]


def text_differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Say which texts of `--help`, or expectations of scenarios, came, went or changed."""
    found = []
    for name in _either(old, new):
        if name not in new:
            found.append(f"{name}: gone")
        elif name not in old:
            found.append(f"{name}: new")
        else:
            before, after = Counter(_leaves(old[name])), Counter(_leaves(new[name]))
            found += [f"{name}: was {leaf}" for leaf in (before - after).elements()]
            found += [f"{name}: is {leaf}" for leaf in (after - before).elements()]
            if old[name] != new[name] and before == after:
                found.append(f"{name}: other order")
    return found


def distance_m(one: Sequence[float] | None, other: Sequence[float] | None) -> float:
    """Return the distance of two places (longitude, latitude in degrees); inf where only one is known."""
    if one is None or other is None:
        return 0.0 if one is other else math.inf
    east_deg = (other[0] - one[0]) * math.cos(math.radians(one[1]))
    return math.hypot(east_deg, other[1] - one[1]) * _METRE_PER_DEGREE


def _contacts(old: Sequence[Answer], new: Sequence[Answer], tolerance: Tolerance) -> Iterator[str]:
    """Pair contacts by the nearest place, since a contact that comes shifts the numbers of those after it."""
    pairs = _paired(old, new)
    partners = dict(pairs.items())
    for index, contact in enumerate(old):
        if index not in partners:
            yield f"contact gone: {_named(contact)}"
    for index, contact in enumerate(new):
        if index not in partners.values():
            yield f"contact new: {_named(contact)}"
    for index, other in sorted(partners.items()):
        yield from _changes(old[index], new[other], tolerance)


def _paired(old: Sequence[Answer], new: Sequence[Answer]) -> dict[int, int]:
    near = sorted(
        (distance_m(one["place"], other["place"]), one["id"] != other["id"], i, j)
        for i, one in enumerate(old)
        for j, other in enumerate(new)
        if distance_m(one["place"], other["place"]) <= SAME_CONTACT_M
    )
    pairs: dict[int, int] = {}
    taken: set[int] = set()
    for _, _, i, j in near:
        if i not in pairs and j not in taken:
            pairs[i] = j
            taken.add(j)
    return pairs


def _changes(old: Answer, new: Answer, tolerance: Tolerance) -> Iterator[str]:
    name = _named(old)
    if old["id"] != new["id"] and tolerance.digests:
        yield f"{name}: now called {new['id']}"
    if abs(new["p_mine"] - old["p_mine"]) > tolerance.p_mine:
        yield f"{name}: p_mine {old['p_mine']:g} -> {new['p_mine']:g}"
    if old["class"] != new["class"]:
        yield f"{name}: class {old['class']} -> {new['class']}"
    # stored places are rounded to half a tolerance, each of the two
    moved_m = distance_m(old["place"], new["place"])
    if moved_m > 2.0 * tolerance.place_m:
        yield f"{name}: moved by {moved_m:.3f} m"


def _named(contact: Answer) -> str:
    return f"{contact['id']} ({contact['class']}, p_mine {contact['p_mine']:g})"


def _numbers(prefix: str, old: Mapping[str, float], new: Mapping[str, float]) -> Iterator[str]:
    for name in _either(old, new):
        if _differ(old, new, name):
            yield f"{prefix}{name}: {old.get(name, 'none')} -> {new.get(name, 'none')}"


def _either(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    return list(dict.fromkeys([*old, *new]))


def _differ(old: Mapping[str, Any], new: Mapping[str, Any], name: str) -> bool:
    return bool(old.get(name) != new.get(name))


def _leaves(value: Any, path: str = "") -> Iterator[str]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _leaves(inner, f"{path} {key}".strip())
    elif isinstance(value, list):
        for inner in value:
            yield from _leaves(inner, path)
    else:
        yield f"{path}: {value}"
