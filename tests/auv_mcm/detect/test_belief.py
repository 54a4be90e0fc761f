"""What speaks for and against a mine: directions, bounds and words, whatever the constants are set to."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.detect.belief import (
    HEIGHT_RANGE_M,
    MIN_OBJECT_M,
    REASONS,
    contrast_odds,
    crowding,
    odds_of,
    probability,
    with_measurement,
)
from auv_mcm.detect.measure import Measurement
from auv_mcm.records import NAN
from auv_mcm.settings.config import DetectConfig

LONGEST_M = DetectConfig().max_object_m


def log_odds(score: float, measured: Measurement, max_object_m: float) -> tuple[float, tuple[str, ...]]:
    return with_measurement(contrast_odds(score), measured, max_object_m)


def measurement(**values: Any) -> Measurement:
    """A mine-like object with highlight and shadow, with some fields changed."""
    known: dict[str, Any] = {
        "row": 10.0,
        "column": 200.0,
        "along_m": 0.8,
        "across_m": 0.4,
        "shadow_length_m": 1.0,
        "height_m": 0.4,
        "highlight_db": 8.0,
        "shadow_db": -10.0,
        "has_highlight": True,
        "has_shadow": True,
        "touches_border": False,
        "in_turn": False,
        "saturated": False,
        "snippet": np.zeros((1, 1), dtype=np.uint8),
        "snippet_row": 0.5,
        "snippet_column": 0.5,
    }
    return Measurement(**{**known, **values})


NO_SHADOW = {"has_shadow": False, "shadow_length_m": NAN, "height_m": NAN, "shadow_db": NAN}
NO_HIGHLIGHT = {"has_highlight": False, "highlight_db": NAN}
DOUBTS: list[tuple[str, dict[str, Any]]] = [
    ("no_shadow", NO_SHADOW),
    ("no_highlight", NO_HIGHLIGHT),
    ("too_large", {"along_m": LONGEST_M + 0.1}),
    ("too_large", {"across_m": LONGEST_M + 0.1}),
    ("too_large", {"touches_border": True}),
    ("too_small", {"along_m": 0.9 * MIN_OBJECT_M, "across_m": 0.9 * MIN_OBJECT_M}),
    ("implausible_height", {"height_m": 0.9 * HEIGHT_RANGE_M[0]}),
    ("implausible_height", {"height_m": 1.1 * HEIGHT_RANGE_M[1]}),
    ("in_turn", {"in_turn": True}),
]


@pytest.mark.parametrize("score", [3.3, 5.0, 6.5])
@pytest.mark.parametrize(("reason", "values"), DOUBTS)
def test_every_doubt_lowers_the_odds_and_is_said(reason: str, values: dict[str, Any], score: float) -> None:
    sure, without = log_odds(score, measurement(), LONGEST_M)
    doubtful, reasons = log_odds(score, measurement(**values), LONGEST_M)
    assert doubtful < sure
    assert reason in reasons
    assert reason not in without


def test_highlight_and_shadow_together_are_said_and_a_shadow_is_the_better_witness() -> None:
    both, reasons = log_odds(5.0, measurement(), LONGEST_M)
    assert reasons == ("highlight_and_shadow",)
    shadow_only, _ = log_odds(5.0, measurement(**NO_HIGHLIGHT), LONGEST_M)
    highlight_only, _ = log_odds(5.0, measurement(**NO_SHADOW), LONGEST_M)
    assert both > shadow_only > highlight_only


def test_an_object_longer_than_any_mine_is_never_more_likely_a_mine_than_not() -> None:
    odds, _ = log_odds(50.0, measurement(along_m=LONGEST_M + 0.1), LONGEST_M)
    assert odds < 0.0


def test_clipping_is_said_but_held_against_nothing() -> None:
    assert log_odds(5.0, measurement(saturated=True), LONGEST_M)[0] == log_odds(5.0, measurement(), LONGEST_M)[0]
    assert "saturated" in log_odds(5.0, measurement(saturated=True), LONGEST_M)[1]


def test_an_unknown_height_is_held_against_nothing() -> None:
    assert log_odds(5.0, measurement(height_m=NAN), LONGEST_M)[0] == log_odds(5.0, measurement(), LONGEST_M)[0]


SIZES = st.floats(0.01, 20.0)


@given(
    scores=st.tuples(st.floats(-10.0, 30.0), st.floats(-10.0, 30.0)),
    along_m=SIZES,
    across_m=SIZES,
    height_m=st.one_of(st.just(NAN), st.floats(0.0, 30.0)),
    flags=st.tuples(*[st.booleans()] * 5),
)
def test_odds_rise_with_the_score_within_bounds_and_reasons_are_known_words(
    scores: tuple[float, float], along_m: float, across_m: float, height_m: float, flags: tuple[bool, ...]
) -> None:
    names = ("has_highlight", "has_shadow", "touches_border", "in_turn", "saturated")
    found = measurement(along_m=along_m, across_m=across_m, height_m=height_m, **dict(zip(names, flags, strict=True)))
    (low, reasons), (high, also) = (log_odds(score, found, LONGEST_M) for score in sorted(scores))
    assert low <= high
    assert reasons == also
    assert set(reasons) <= set(REASONS)
    assert len(set(reasons)) == len(reasons) > 0
    assert abs(low) < 20.0
    assert abs(high) < 20.0


def test_every_reason_has_words_of_its_own() -> None:
    assert len(set(REASONS.values())) == len(REASONS)
    assert all(code.isidentifier() and text and not text.endswith(".") for code, text in REASONS.items())


def test_a_few_neighbours_cost_nothing_and_many_cost_more_up_to_a_bound() -> None:
    costs = [crowding(n) for n in range(1000)]
    assert costs[0] == costs[1] == 0.0
    assert costs == sorted(costs)
    assert costs[20] > 0.0
    assert costs[-1] == costs[100]


@given(st.floats(-13.0, 13.0))
def test_probability_and_odds_are_inverse(odds: float) -> None:
    assert odds_of(probability(odds)) == pytest.approx(odds, abs=1e-8)


def test_certainties_have_finite_odds() -> None:
    assert math.isfinite(odds_of(0.0))
    assert odds_of(1.0) == pytest.approx(-odds_of(0.0))
    assert probability(0.0) == 0.5
    assert 0.0 < probability(-600.0) < 1e-200
    assert probability(600.0) == 1.0
