"""What is said of a contact: one sentence and two reasons that never contradict each other."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.classify.reasons import CLOSE_LOOK_REASONS
from auv_mcm.contacts.contact_words import MINES, ContactWords, describe
from auv_mcm.detect.belief import REASONS
from tests.contradictions import contradictions

CODES = sorted({*REASONS, *CLOSE_LOOK_REASONS, "unheard_of"})
WORDS = st.lists(st.sampled_from(CODES), max_size=6)


def said(**changes: Any) -> ContactWords:
    known: dict[str, Any] = {
        "p_mine": 0.62,
        "belief": {"cylinder": 0.55, "unknown": 0.45},
        "length_m": 1.93,
        "next_look_deg": (155.2, 65.0),
        "called": True,
        "reasons": (),
        "view_reasons": [("highlight_and_shadow",), ()],
    }
    return describe(**{**known, **changes})


def test_a_sentence_is_read_in_five_seconds() -> None:
    assert said().sentence == (
        "Probably a mine, 62 %. Cylinder about 1.9 m. Seen twice. Look again from 155 or 335 degrees."
    )
    assert said().label == "cylinder"
    assert said().reason_for == "echo and shadow fit a cylinder"
    assert said().reason_against == ""


def test_a_kind_is_named_only_where_it_is_rather_that_than_not() -> None:
    faint = said(p_mine=0.21, belief={"sphere": 0.06, "clutter": 0.66, "unknown": 0.28}, called=False)
    assert faint.sentence.startswith("Possibly a mine, 21 %. Shape unclear, about 1.9 m.")
    assert faint.label == "shape unclear"
    assert faint.open_share == pytest.approx(0.15)
    assert said(belief={"cylinder": 0.49, "unknown": 0.51}).kind == ""


def test_a_call_that_departs_from_the_odds_is_explained() -> None:
    assert "Not called: more false alarms" in said(called=False).sentence
    assert "Called all the same" in said(p_mine=0.1, belief={"unknown": 1.0}).sentence
    assert "alled" not in said().sentence
    assert "alled" not in said(called=None).sentence


@pytest.mark.parametrize(
    ("p_mine", "words"),
    [
        (0.0, "Probably not a mine: below 1 % chance that it is one."),
        (0.1999, "Probably not a mine: 19 % chance that it is one."),
        (0.2, "Possibly a mine, 20 %."),
        (0.4999, "Possibly a mine, 49 %."),
        (0.7999, "Probably a mine, 79 %."),
        (0.8, "Very likely a mine, 80 %."),
        (1.0, "Very likely a mine, 99 %."),
        (math.nan, "Not rated."),
        (math.inf, "Not rated."),
    ],
)
def test_per_cent_lie_on_their_level_and_are_never_certain(p_mine: float, words: str) -> None:
    found = said(p_mine=p_mine, belief={"unknown": 1.0}, called=None, length_m=math.nan, view_reasons=[])
    assert found.sentence.startswith(words)


def test_a_code_of_one_view_in_three_gives_no_reason() -> None:
    views = [("highlight_and_shadow",), ("highlight_and_shadow",), ("no_shadow", "crowded")]
    found = said(belief={"unknown": 1.0}, view_reasons=views, reasons=[code for view in views for code in view])
    assert (found.reason_for, found.reason_against) == ("a bright echo with a shadow right behind it", "")


@pytest.mark.parametrize("lost", [("no_shadow",), ("no_highlight",), ("no_shadow", "no_highlight")])
def test_what_has_echo_and_shadow_is_not_said_to_lack_one(lost: tuple[str, ...]) -> None:
    found = said(belief={"unknown": 1.0}, view_reasons=[("highlight_and_shadow", *lost)])
    assert found.reason_against == "its echo and shadow could not be traced in the sea floor around"
    assert said(belief={"unknown": 1.0}, view_reasons=[lost[:1]]).reason_against != found.reason_against


def test_a_kind_that_is_named_overrules_reasons_of_shape_alone() -> None:
    views = [("too_long", "no_shadow")]
    assert said(view_reasons=views).reason_against == said(view_reasons=[("no_shadow",)]).reason_against != ""
    assert said(view_reasons=[("too_long",)]).reason_against == ""


@given(
    p_mine=st.one_of(st.floats(0.0, 1.0), st.just(math.nan)),
    parts=st.lists(st.floats(0.0, 1.0), min_size=6, max_size=6),
    length_m=st.one_of(st.floats(0.0, 40.0), st.just(math.nan)),
    looks=st.lists(st.floats(-720.0, 720.0), max_size=2),
    called=st.sampled_from([None, True, False]),
    views=st.lists(WORDS, max_size=4),
    more=WORDS,
)
def test_nothing_that_is_said_contradicts_anything_else(
    p_mine: float,
    parts: list[float],
    length_m: float,
    looks: list[float],
    called: bool | None,
    views: list[list[str]],
    more: list[str],
) -> None:
    shares = [part / (sum(parts) or 1.0) for part in parts]
    bound = p_mine if p_mine >= 0.0 else 1.0
    mines = sum(shares[:4])
    kept = [share * min(1.0, bound / mines) if mines else 0.0 for share in shares[:4]]
    clutter = min(shares[4], 1.0 - bound) if p_mine >= 0.0 else 0.0
    belief = dict(zip(MINES, kept, strict=True)) | {"clutter": clutter, "unknown": 1.0 - sum(kept) - clutter}
    found = describe(
        p_mine=p_mine,
        belief=belief,
        length_m=length_m,
        next_look_deg=looks,
        called=called,
        reasons=more,
        view_reasons=views,
    )
    assert contradictions(found, p_mine, belief, called) == []
    assert re.fullmatch(r"[ -~]*", found.sentence), "plain ASCII, for any spreadsheet"
