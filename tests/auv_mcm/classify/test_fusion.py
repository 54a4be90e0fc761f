"""Fusion of several views: new evidence counts, repeated evidence hardly, contradiction is reported."""

from __future__ import annotations

import math
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import FRAME, MINE_LIKE_P, vacuous
from auv_mcm.classify.fusion import AGREEMENT_NATS, CONTRADICTION, FusedViews, agreement_nats, fuse
from auv_mcm.classify.reasons import bearing
from auv_mcm.records import NAN, ContactClass, Detection
from tests.auv_mcm.classify.drawn_looks import confirmation, detection, like

PRIOR = math.log(0.1 / 0.9)
ONE_KIND = (0.0, -50.0)
"""Of a verifier that is sure of the kind."""
SAME, SLOPE = AGREEMENT_NATS
"""Evidence of a second view from elsewhere that surely shows the same kind, and the weight of the logarithm of the
chance of that."""


def looked_at(
    log_ratio: float,
    aspect_deg: float,
    time_s: float = 0.0,
    prior: float = PRIOR,
    shape: NDArray[np.float64] | None = None,
    kind_nats: tuple[float, ...] = (),
    **values: Any,
) -> Detection:
    """A view with evidence in nats, and which solids its shadow may be of."""
    found = confirmation(log_ratio, shape, **values)
    p_mine = 1.0 / (1.0 + math.exp(-(log_ratio + prior)))
    return detection(p_mine=p_mine, aspect_deg=aspect_deg, time_s=time_s, confirmation=found, kind_nats=kind_nats)


def odds(verdict: FusedViews) -> float:
    return math.log(verdict.p_mine / (1.0 - verdict.p_mine))


def reported(verdict: FusedViews) -> tuple[Any, ...]:
    """All of it, where NaN is NaN."""
    return tuple(str(field) for field in verdict)


aspects = st.floats(0.0, 359.0)
shapes = st.sampled_from([None, like("cylinder"), like("sphere", "truncated_cone"), like("wedge", quality=0.6)])
views = st.lists(
    st.tuples(st.floats(-8.0, 8.0), aspects, shapes, st.booleans(), st.booleans()), min_size=1, max_size=12
).map(
    lambda rows: [
        looked_at(log_ratio, aspect, float(number), shape=shape, half_turn_symmetric=symmetric)
        if close
        else detection(p_mine=1.0 / (1.0 + math.exp(-log_ratio)), aspect_deg=aspect, time_s=float(number))
        for number, (log_ratio, aspect, shape, symmetric, close) in enumerate(rows)
    ]
)


# ---------------------------------------------------------------- one view


@given(st.floats(-12.0, 12.0), st.floats(-6.0, 2.0), aspects, shapes)
def test_one_view_keeps_its_p_mine_to_the_last_bit(
    log_ratio: float, prior: float, aspect: float, shape: NDArray[np.float64] | None
) -> None:
    view = looked_at(log_ratio, aspect, prior=prior, shape=shape)
    verdict = fuse([view], prior)
    assert verdict.p_mine == view.p_mine
    assert math.isnan(verdict.conflict)
    assert verdict.reasons == ()


@given(st.floats(0.0, 1.0))
def test_one_view_without_a_confirmation_keeps_its_p_mine_too(p_mine: float) -> None:
    assert fuse([detection(p_mine=p_mine)], PRIOR).p_mine == p_mine


def test_no_views_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one view"):
        fuse([], PRIOR)


# ---------------------------------------------------------------- any views


@settings(max_examples=50)
@given(views, st.integers(0, 1000))
@example([looked_at(2.0, 60.0 * n, n, kind_nats=ONE_KIND[:: (1, 1, -1)[n]]) for n in range(3)], 3)  # equally mine-like
def test_the_order_of_views_changes_not_a_bit(seen: list[Detection], seed: int) -> None:
    shuffled = np.random.Generator(np.random.PCG64(seed)).permutation(len(seen))
    assert reported(fuse(seen, PRIOR)) == reported(fuse([seen[number] for number in shuffled], PRIOR))


@settings(max_examples=50)
@given(views, st.floats(-6.0, 2.0))
def test_belief_sums_to_one_and_everything_is_a_number_in_its_range(seen: list[Detection], prior: float) -> None:
    verdict = fuse(seen, prior)
    assert set(verdict.belief) == {*FRAME, "unknown"}
    assert sum(verdict.belief.values()) == pytest.approx(1.0, abs=1e-12)
    assert all(share >= 0.0 for share in verdict.belief.values())
    assert 0.0 <= verdict.p_mine <= 1.0
    assert math.isnan(verdict.conflict) == (len(seen) == 1)
    assert len(seen) == 1 or 0.0 <= verdict.conflict <= 1.0
    assert all(0.0 <= direction < 180.0 for direction in verdict.next_look_deg)


@settings(max_examples=50)
@given(views, st.floats(-6.0, 2.0))
def test_class_belief_and_p_mine_agree(seen: list[Detection], prior: float) -> None:
    """Bel(mine) <= p_mine <= Pl(mine); a contact called a mine has a kind of mine, or none where no view has evidence
    of kinds."""
    verdict = fuse(seen, prior)
    of_mines = sum(verdict.belief[name] for name in FRAME if name != "clutter")
    assert of_mines <= verdict.p_mine + 1e-12
    assert verdict.belief["clutter"] <= 1.0 - verdict.p_mine + 1e-12
    if verdict.p_mine < MINE_LIKE_P:
        assert verdict.belief[verdict.classification] == max(verdict.belief.values())
    else:
        assert verdict.classification != "clutter"
        assert verdict.classification == verdict.mine_kind
    assert verdict.mine_kind != "clutter"


@given(st.floats(-1.0, 8.0), st.sampled_from(["cylinder", "sphere", "truncated_cone", "wedge"]), st.floats(0.05, 1.0))
def test_a_contact_called_a_mine_is_of_the_kind_that_its_shadow_is_most_like(
    log_ratio: float, kind: ContactClass, quality: float
) -> None:
    verdict = fuse([looked_at(log_ratio, 20.0, prior=0.0, shape=like(kind, quality=quality))], 0.0)
    assert verdict.p_mine >= MINE_LIKE_P
    assert verdict.classification == kind


# ---------------------------------------------------------------- the most mine-like view speaks, the others say
# whether it is of one kind


def test_the_most_mine_like_view_speaks_and_others_add_what_their_kinds_say() -> None:
    for ratios in ([2.0, 1.0], [2.0, -1.0], [1.0, 1.0, 1.0], [-2.0, -1.0, 0.5]):
        for kinds, each in ((ONE_KIND, SAME), ((), 0.0), ((0.0, 0.0), SAME - SLOPE * math.log(2.0))):
            seen = [looked_at(r, 120.0 * n, float(n), kind_nats=kinds) for n, r in enumerate(ratios)]
            assert odds(fuse(seen, PRIOR)) == pytest.approx(PRIOR + max(ratios) + each * (len(seen) - 1), abs=0.03)


@given(st.lists(aspects, min_size=2, max_size=5), st.floats(-6.0, 2.0))
@settings(max_examples=30)
def test_views_without_evidence_stay_at_the_prior_however_many(directions: list[float], prior: float) -> None:
    seen = [looked_at(0.0, aspect, float(number), prior) for number, aspect in enumerate(directions)]
    assert odds(fuse(seen, prior)) == pytest.approx(prior, abs=1e-6)


def test_what_looks_like_a_mine_of_another_kind_from_each_side_is_less_likely_one() -> None:
    """As a stone does."""
    one = looked_at(4.0, 10.0, kind_nats=ONE_KIND)
    for apart_deg in (45.0, 90.0, 180.0):
        both = fuse([one, looked_at(4.0, 10.0 + apart_deg, 1.0, kind_nats=ONE_KIND[::-1])], PRIOR)
        assert odds(both) < PRIOR + 1.5
        assert (both.reasons, bearing(both.reasons[0])) == (("kinds_differ",), "against")


def test_however_many_views_agree_three_count() -> None:
    seen = [looked_at(1.0, 40.0 * number, float(number), kind_nats=ONE_KIND) for number in range(9)]
    verdict = fuse(seen, PRIOR)
    assert odds(verdict) == pytest.approx(PRIOR + 1.0 + 3.0 * SAME, abs=1e-6)
    assert (verdict.reasons, bearing(verdict.reasons[0])) == (("kinds_agree",), "for")


def test_a_mine_seen_badly_once_is_still_a_mine() -> None:
    well, badly = looked_at(5.0, 10.0, kind_nats=ONE_KIND), looked_at(-3.0, 100.0, 1.0, kind_nats=(0.0, 0.0))
    assert odds(fuse([well, badly], PRIOR)) > PRIOR + 5.0


@pytest.mark.parametrize(
    ("symmetric", "apart_deg", "n_counted"),
    [
        *[((True, True), 0.0, 1), ((True, True), 90.0, 2), ((True, True), 180.0, 1)],
        *[((False, False), 0.0, 1), ((False, False), 90.0, 2), ((False, False), 180.0, 2), ((True, False), 180.0, 2)],
    ],
)
@pytest.mark.parametrize("log_ratio", [1.0, 4.0])
def test_the_opposite_side_is_new_evidence_of_the_kind_only_if_the_solid_looks_different_from_there(
    symmetric: tuple[bool, bool], apart_deg: float, n_counted: int, log_ratio: float
) -> None:
    """A view excludes each of the three other solids by 0.7, independently, and two that count leave 0.3 of 0.3."""
    aspects = (10.0, 10.0 + apart_deg)
    shape, likely = like("wedge", quality=0.7), 5.0  # a prior at which p_mine bounds no belief in the kind
    seen = [
        looked_at(log_ratio, aspect, aspect, likely, shape, half_turn_symmetric=same)
        for aspect, same in zip(aspects, symmetric, strict=True)
    ]
    verdict = fuse(seen, likely)
    # Beside one view with as much evidence of a mine, whose shadow leaves 0.7 for each of the three.
    alone = fuse([looked_at(odds(verdict) - likely, 10.0, 0.0, likely, shape)], likely)
    assert verdict.belief["wedge"] / alone.belief["wedge"] == pytest.approx(
        ((1.0 - 0.3**n_counted) / 0.7) ** 3, abs=1e-3
    )
    assert odds(verdict) == pytest.approx(likely + log_ratio, abs=1e-6)


def test_views_that_each_leave_two_kinds_together_leave_one() -> None:
    both = fuse(
        [
            looked_at(5.0, 0.0, shape=like("cylinder", "sphere"), kind_nats=ONE_KIND),
            looked_at(5.0, 90.0, 1.0, shape=like("cylinder", "wedge"), kind_nats=ONE_KIND),
        ],
        PRIOR,
    )
    assert both.classification == "cylinder"
    assert both.belief["cylinder"] > 0.7
    assert both.conflict < 0.3


def test_shapes_of_different_kinds_take_no_evidence_for_a_mine() -> None:
    for quality in (0.6, 0.8, 0.95):
        seen = [
            looked_at(4.0, 0.0, shape=like("cylinder", quality=quality)),
            looked_at(4.0, 90.0, 1.0, shape=like("sphere", quality=quality)),
        ]
        assert odds(fuse(seen, PRIOR)) == pytest.approx(PRIOR + 4.0, abs=1e-6)


kinds_seen = st.lists(st.floats(-6.0, 0.0), min_size=3, max_size=3).map(tuple)


@settings(max_examples=50)
@given(st.lists(st.tuples(st.floats(-8.0, 8.0), aspects, kinds_seen | st.just(())), min_size=1, max_size=6))
def test_each_further_view_counts_by_the_chance_that_it_shows_the_kind_of_the_best(
    seen: list[tuple[float, float, tuple[float, ...]]],
) -> None:
    """Written out view by view, the most mine-like first, by probabilities."""
    assume(len({ratio for ratio, *_ in seen}) == len(seen))
    total = 0.0
    counted: list[float] = []
    best = max(seen)[2]
    for _, aspect, kinds in sorted(seen, key=lambda view: -view[0]):
        share = 1.0 if counted else 0.0
        for other in counted:
            angle = abs(aspect - other) % 360.0
            share *= 1.0 - math.exp(-(min(angle, 360.0 - angle) ** 2) / (2.0 * 15.0**2))
        if best and kinds:
            p, q = (np.exp(nats) / np.exp(nats).sum() for nats in (np.array(best), np.array(kinds)))
            total += share * (SAME + SLOPE * math.log(max(sum(p * q), 1e-3)))
        counted.append(aspect)
    views = [detection(aspect_deg=aspect, kind_nats=kinds) for _, aspect, kinds in seen]
    assert agreement_nats(views, [ratio for ratio, *_ in seen]) == pytest.approx(min(total, 3.0 * SAME), abs=1e-9)


def test_a_second_view_from_nowhere_known_adds_nothing() -> None:
    views = [detection(aspect_deg=aspect, kind_nats=(0.0, -9.0)) for aspect in (NAN, 90.0)]
    assert agreement_nats(views, [2.0, 1.0]) == 0.0
    seen = [looked_at(2.0, 90.0, shape=like("cylinder")), looked_at(1.0, NAN, 1.0, shape=like("sphere"))]
    assert odds(fuse(seen, PRIOR)) == pytest.approx(PRIOR + 2.0)


# ---------------------------------------------------------------- views that do not fit together


def test_views_sure_of_opposite_classes_are_not_fused_and_the_most_mine_like_counts() -> None:
    mine, stone = looked_at(7.0, 0.0, shape=like("cylinder")), looked_at(-7.0, 90.0, 1.0)
    verdict = fuse([stone, mine], PRIOR)
    assert verdict.reasons == (CONTRADICTION,)
    assert verdict.conflict >= 0.9
    assert verdict.p_mine == mine.p_mine
    assert verdict.classification == "cylinder"
    assert verdict.belief == fuse([mine], PRIOR).belief


def test_of_equally_mine_like_views_the_first_speaks() -> None:
    later, earlier = looked_at(6.5, 0.0, 2.0, shape=like("wedge")), looked_at(6.5, 90.0, 1.0, shape=like("sphere"))
    for order in permutations([later, earlier, looked_at(-9.0, 45.0, 9.0)]):
        verdict = fuse(order, PRIOR)
        assert verdict.reasons == (CONTRADICTION,)
        assert verdict.classification == "sphere"


@pytest.mark.parametrize(("log_ratio", "conflict"), [(2.0, 0.53), (5.0, 0.85)])
def test_views_that_waver_are_fused_without_a_word_and_leave_the_better_one(log_ratio: float, conflict: float) -> None:
    verdict = fuse([looked_at(log_ratio, 0.0), looked_at(-log_ratio, 90.0, 1.0)], PRIOR)
    assert verdict.reasons == ()
    assert verdict.conflict == pytest.approx(conflict, abs=0.01)
    assert odds(verdict) == pytest.approx(PRIOR + log_ratio, abs=1e-6)


# ---------------------------------------------------------------- no confirmation


@settings(max_examples=30)
@given(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), aspects)
def test_a_view_without_a_confirmation_counts_by_its_p_mine(first: float, second: float, aspect: float) -> None:
    """As one with the same evidence and nothing to say about the kind."""
    close = [looked_at(first, 0.0), looked_at(second, aspect, 1.0)]
    far = [detection(p_mine=view.p_mine, aspect_deg=view.aspect_deg, time_s=view.time_s) for view in close]
    for seen in (far, [close[0], far[1]], [far[0], close[1]]):
        verdict, expected = fuse(seen, PRIOR), fuse(close, PRIOR)
        assert verdict.p_mine == pytest.approx(expected.p_mine, abs=1e-9)
        assert verdict.belief == pytest.approx(expected.belief, abs=1e-9)


def test_views_sure_beyond_their_digits_break_nothing() -> None:
    seen = [detection(p_mine=p_mine, aspect_deg=aspect, time_s=aspect) for p_mine, aspect in ((1.0, 0.0), (1.0, 90.0))]
    assert fuse(seen, PRIOR).p_mine > 0.999
    seen.append(detection(p_mine=0.0, aspect_deg=45.0, time_s=99.0))
    assert fuse(seen, PRIOR).reasons == (CONTRADICTION,)


# ---------------------------------------------------------------- where to look next


def widest_gap_middle_deg(directions: list[float]) -> float:
    """By trying every tenth of a degree: the direction farthest from all viewed, opposite ones alike."""
    tried = np.arange(0.0, 180.0, 0.1)
    apart = np.abs(tried[:, np.newaxis] - np.array(directions))
    apart = np.abs(apart - 180.0 * np.round(apart / 180.0))
    return float(tried[apart.min(axis=1).argmax()])


@settings(max_examples=50)
@given(st.lists(aspects, min_size=1, max_size=5))
@example([15.0 * number for number in range(12)])  # however narrow that is
def test_the_next_look_points_into_the_widest_gap_of_aspects(directions: list[float]) -> None:
    seen = [detection(p_mine=0.5, aspect_deg=aspect, time_s=float(number)) for number, aspect in enumerate(directions)]
    verdict = fuse(seen, 0.0)
    expected = widest_gap_middle_deg(directions)

    def room_deg(direction: float) -> float:
        return min(abs(math.remainder(direction - taken, 180.0)) for taken in directions)

    assert 1 <= len(verdict.next_look_deg) <= 2
    assert room_deg(verdict.next_look_deg[0]) == pytest.approx(room_deg(expected), abs=0.2)


def test_one_view_is_looked_at_again_square_to_it() -> None:
    assert fuse([detection(p_mine=0.5, aspect_deg=190.0)], PRIOR).next_look_deg == pytest.approx((100.0,))


def test_after_two_opposite_passes_no_direction_that_repeats_them_is_named() -> None:
    opposite = [detection(p_mine=0.5, aspect_deg=aspect, time_s=aspect) for aspect in (125.8, 305.0)]
    assert fuse(opposite, 0.0).next_look_deg == pytest.approx((35.4,))
    apart = [detection(p_mine=0.5, aspect_deg=aspect, time_s=aspect) for aspect in (90.0, 304.0)]
    assert fuse(apart, 0.0).next_look_deg == pytest.approx((17.0, 107.0))


def test_what_is_decided_is_not_looked_at_again() -> None:
    for p_mine in (0.012, 0.84):
        assert fuse([detection(p_mine=p_mine)], PRIOR).next_look_deg == ()
    for p_mine in (0.0125, 0.2, 0.83):
        assert fuse([detection(p_mine=p_mine)], PRIOR).next_look_deg != ()
    sure = [looked_at(3.0, aspect, aspect, kind_nats=ONE_KIND) for aspect in (0.0, 60.0, 120.0)]
    assert fuse(sure[:1], PRIOR).next_look_deg != ()
    assert fuse(sure, PRIOR).next_look_deg == ()


def test_a_view_from_nowhere_known_requests_no_direction() -> None:
    verdict = fuse([detection(p_mine=0.5, aspect_deg=NAN)], PRIOR)
    assert verdict.next_look_deg == ()
    assert verdict.p_mine == 0.5


# ---------------------------------------------------------------- the class reported


def test_the_class_reported_follows_shape_once_it_is_a_mine() -> None:
    assert fuse([looked_at(5.0, 0.0, shape=like("wedge"))], PRIOR).classification == "wedge"
    assert fuse([looked_at(-5.0, 0.0, shape=like("wedge"))], PRIOR).classification == "clutter"
    for nothing_said in (looked_at(5.0, 0.0, shape=vacuous()), detection(p_mine=0.9)):
        assert fuse([nothing_said], PRIOR).classification == "unknown"
    assert fuse([looked_at(5.0, 0.0, shape=like("sphere", "truncated_cone"))], PRIOR).classification == "unknown"


def test_the_prior_is_in_the_belief_once() -> None:
    """A view whose evidence just makes up for how rare mines are leaves mine and clutter even, be it one view or
    two."""
    for seen in ([looked_at(-PRIOR, 0.0)], [looked_at(-PRIOR, 0.0), looked_at(-PRIOR, 90.0, 1.0)]):
        verdict = fuse(seen, PRIOR)
        assert verdict.p_mine == pytest.approx(0.5, abs=1e-2)
        assert verdict.belief["clutter"] == pytest.approx(0.5, abs=1e-2)
