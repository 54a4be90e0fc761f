"""Every code that detection or confirmation can give has words, and stands on one side of the decision."""

from __future__ import annotations

from typing import Final, get_args

import pytest

from auv_mcm.classify.reasons import CLOSE_LOOK_REASONS, bearing, in_words
from auv_mcm.confirm import mrf
from auv_mcm.confirm.snake_rules import REJECTING
from auv_mcm.detect.belief import REASONS

CONTOURS: Final = {"start_replaced", "no_highlight", "no_shadow"}  # beside those that reject
SOLIDS: Final = {"no_data", "clutter", "at_bound", "altitude", "buried", "cut_off", "weak_highlight"}


@pytest.mark.parametrize("code", sorted({*REJECTING, *CONTOURS, *SOLIDS, *get_args(mrf.Flag), *REASONS}))
def test_every_code_has_words(code: str) -> None:
    words = in_words(code)
    assert words != code.replace("_", " ")
    assert "_" not in words
    assert len(words.split()) >= 5


def test_one_code_has_one_meaning() -> None:
    assert REASONS.keys().isdisjoint(CLOSE_LOOK_REASONS)
    reported = [*REASONS.values(), *CLOSE_LOOK_REASONS.values()]
    assert len(reported) == len(set(reported))


def test_a_code_without_a_text_is_described_by_its_name() -> None:
    assert in_words("brand_new") == "brand new"
    assert bearing("brand_new") == "note"


def test_what_rejects_speaks_against_a_mine() -> None:
    assert {bearing(code) for code in REJECTING} == {"against"}
    assert bearing("highlight_and_shadow") == "for"
    assert bearing("weak_highlight") == "note"
