"""What a passage shows of a likely mine a second time is left out, and nothing else."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from auv_mcm.contacts.repeats import without_repeats
from auv_mcm.records import Detection
from tests.auv_mcm.contacts.test_ledger import view

MINE: dict[str, Any] = {"p_mine": 0.9, "score": 1.0}
END: dict[str, Any] = {"p_mine": 0.6, "score": 2.0}


def scores(detections: list[Detection]) -> list[float]:
    return [one.score for one in detections]


def test_of_two_ends_the_likelier_stays_whether_they_come_together_or_not() -> None:
    mine, end = view(0.0, 0.0, 100.0, **MINE), view(1.2, -1.2, 101.0, **END)
    assert scores(without_repeats([mine, end], [])[0]) == [1.0]
    assert scores(without_repeats([end, mine], [])[0]) == [1.0]
    kept, likely = without_repeats([mine], [])
    assert scores(kept) == scores(likely) == [1.0]
    assert without_repeats([end], likely) == ([], likely)


@pytest.mark.parametrize(
    "other",
    [
        {"east_m": 2.1},
        {"time_s": 131.0},
        {"heading_rad": 0.8},
        {"squint_rad": 0.05},
        {"side": "port"},
        {"p_mine": 0.95},
    ],
    ids=["beyond a mine's length", "later", "after a turn", "other sub-aperture", "other side", "likelier, and later"],
)
def test_what_may_be_another_object_or_another_look_stays(other: dict[str, Any]) -> None:
    _, likely = without_repeats([view(0.0, 0.0, 100.0, **MINE)], [])
    later = view(**{"east_m": 1.0, "north_m": 0.0, "time_s": 101.0, **END, **other})
    assert scores(without_repeats([later], likely)[0]) == [2.0]


def test_beside_what_is_no_likely_mine_everything_stays() -> None:
    pair = [view(0.0, 0.0, 100.0, p_mine=0.19, score=1.0), view(0.5, 0.0, 100.0, p_mine=0.1, score=2.0)]
    assert without_repeats(pair, []) == (pair, [])


def test_what_is_remembered_ends_with_the_passage() -> None:
    _, likely = without_repeats([view(0.0, 0.0, 100.0, **MINE)], [])
    kept, likely = without_repeats([view(50.0, 0.0, 130.0, p_mine=0.01)], likely)
    assert len(kept) == 1
    assert likely == []


@given(
    places=st.lists(st.tuples(st.floats(0.0, 6.0), st.floats(0.0, 6.0), st.floats(0.0, 1.0)), max_size=9),
    order=st.randoms(),
)
def test_what_stays_is_what_no_likelier_mine_beside_it_has_taken_whatever_the_order(
    places: list[tuple[float, float, float]], order: Any
) -> None:
    apart_m = {(j, k): math.dist(places[j][:2], places[k][:2]) for j in range(len(places)) for k in range(len(places))}
    assume(all(abs(each - 2.0) > 1e-3 for each in apart_m.values()))
    expected: set[int] = set()
    for k in sorted(range(len(places)), key=lambda k: (-places[k][2], k)):
        if not any(places[j][2] >= 0.2 and apart_m[j, k] < 2.0 for j in expected):
            expected.add(k)
    seen = [view(e, n, 100.0 + k, p_mine=p, score=float(k)) for k, (e, n, p) in enumerate(places)]
    order.shuffle(seen)
    assert set(scores(without_repeats(seen, [])[0])) == expected
