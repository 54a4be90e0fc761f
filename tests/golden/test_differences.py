"""What moved is put in words that name the contact and the amount."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import pytest

from tests.golden.differences import OTHER_PLATFORM, distance_m, mission_differences, text_differences

METRE_DEG = 1.0 / 111_195.0


def contact(name: str, north_m: float, p_mine: float = 0.5, kind: str = "sphere") -> dict[str, Any]:
    return {"id": name, "place": [5.0, 43.0 + north_m * METRE_DEG], "p_mine": p_mine, "class": kind}


def answer(*contacts: dict[str, Any]) -> dict[str, Any]:
    return {
        "log": "a",
        "contacts": list(contacts),
        "totals": {"pings": 10},
        "notices": ["x: y"],
        "counters": {"a.b": 1},
        "digests": {"contacts.geojson": "a"},
    }


BEFORE = answer(contact("c1", 0.0), contact("c2", 30.0, 0.8, "wedge"))


def changed(**parts: Any) -> list[str]:
    return mission_differences(BEFORE, {**deepcopy(BEFORE), **parts})


def test_a_contact_that_comes_is_named_and_shifts_the_names_of_others() -> None:
    after = answer(contact("c1", 0.0), contact("c2", 12.0, 0.1, "clutter"), contact("c3", 30.0, 0.8, "wedge"))
    assert mission_differences(BEFORE, after) == [
        "contact new: c2 (clutter, p_mine 0.1)",
        "c2 (wedge, p_mine 0.8): now called c3",
    ]


def test_a_contact_that_goes_is_named() -> None:
    assert mission_differences(BEFORE, answer(contact("c1", 0.0))) == ["contact gone: c2 (wedge, p_mine 0.8)"]


@pytest.mark.parametrize(
    ("after", "words"),
    [
        (contact("c2", 30.0, 0.811, "wedge"), ["c2 (wedge, p_mine 0.8): p_mine 0.8 -> 0.811"]),
        (contact("c2", 30.0, 0.809, "wedge"), []),
        (contact("c2", 30.0, 0.8, "sphere"), ["c2 (wedge, p_mine 0.8): class wedge -> sphere"]),
        (contact("c2", 30.5, 0.8, "wedge"), ["c2 (wedge, p_mine 0.8): moved by 0.500 m"]),
        (contact("c2", 30.01, 0.8, "wedge"), []),
    ],
)
def test_a_change_of_a_contact_is_named(after: dict[str, Any], words: list[str]) -> None:
    assert mission_differences(BEFORE, answer(contact("c1", 0.0), after)) == words


def test_totals_notices_counters_and_files_are_named() -> None:
    assert changed(totals={"pings": 11}) == ["pings: 10 -> 11"]
    assert changed(notices=["z: w"]) == ["notice gone: x: y", "notice new: z: w"]
    assert changed(counters={}) == ["counter a.b: 1 -> none"]
    assert changed(digests={"contacts.geojson": "b"}) == ["other bytes: contacts.geojson"]
    assert changed(log="b") == ["the mission itself is another: its log has other bytes"]


def test_on_another_platform_bytes_do_not_count_and_a_centimetre_does() -> None:
    after = {**answer(contact("c1", 0.01), BEFORE["contacts"][1]), "log": "b", "digests": {}}
    assert mission_differences(BEFORE, after, OTHER_PLATFORM) == ["c1 (sphere, p_mine 0.5): moved by 0.010 m"]
    assert mission_differences(BEFORE, {**deepcopy(BEFORE), "log": "b", "digests": {}}, OTHER_PLATFORM) == []


def test_an_error_that_changes_is_shown_before_and_after() -> None:
    assert mission_differences({"error": "a"}, {"error": "b"}) == ["was: a", "is: b"]
    assert mission_differences({"error": "a"}, BEFORE) == ["was: a", "is: an answer"]


def test_texts_are_compared_leaf_by_leaf() -> None:
    old: dict[str, Any] = {"run": {"about": "x", "arguments": {"--out": "a"}}, "gone": {}}
    new: dict[str, Any] = {"run": {"about": "x", "arguments": {"--out": "b"}}, "view": {}}
    assert text_differences(old, new) == [
        "run: was arguments --out: a",
        "run: is arguments --out: b",
        "gone: gone",
        "view: new",
    ]


def test_an_expectation_that_goes_is_named() -> None:
    old = {"clean": [{"test": "a", "expected": {"code": 0}}, {"test": "b", "expected": {"code": 1}}]}
    assert text_differences(old, {"clean": old["clean"][:1]}) == ["clean: was test: b", "clean: was expected code: 1"]


def test_a_place_that_is_lost_is_infinitely_far() -> None:
    assert distance_m(None, [5.0, 43.0]) == float("inf")
    assert distance_m(None, None) == 0.0
    assert distance_m([5.0, 60.0], [5.0 + METRE_DEG, 60.0]) == pytest.approx(0.5, rel=1e-6)
