"""Belief functions against their definitions in rational arithmetic, and what several views say together."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from functools import reduce
from typing import TypeAlias

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import (
    APART_FROM,
    DEMPSTER_BELOW,
    EVERYTHING,
    FRAME,
    MIN_IGNORANCE,
    MINES,
    N_CLASSES,
    N_SUBSETS,
    Array,
    ViewMass,
    belief,
    combine,
    conflict,
    conjunctive,
    dempster,
    discount,
    next_look_aspects,
    nonspecificity,
    pignistic,
    subset,
    vacuous,
    yager,
)
from tests.make.random_numbers import generator

Classes: TypeAlias = frozenset[int]
Exact: TypeAlias = dict[Classes, Fraction]

SETS: list[Classes] = [frozenset(i for i in range(N_CLASSES) if index >> i & 1) for index in range(N_SUBSETS)]
NOTHING, ALL = SETS[0], SETS[-1]
NEAR = 1e-12


# The oracle: the definitions, over frozen sets, in rational arithmetic.


def exact(mass: Array) -> Exact:
    return {classes: Fraction(value) for classes, value in zip(SETS, mass.tolist(), strict=True) if value}


def floats(mass: Exact) -> Array:
    return np.array([float(mass.get(classes, Fraction(0))) for classes in SETS])


def exact_conjunctive(first: Exact, second: Exact) -> Exact:
    joint: Exact = {}
    for (a, mass_a), (b, mass_b) in itertools.product(first.items(), second.items()):
        joint[a & b] = joint.get(a & b, Fraction(0)) + mass_a * mass_b
    return joint


def normalised(joint: Exact) -> Exact:
    agreement = sum((value for classes, value in joint.items() if classes), Fraction(0))
    return {classes: value / agreement for classes, value in joint.items() if classes}


def with_conflict_unknown(joint: Exact) -> Exact:
    known = {classes: value for classes, value in joint.items() if classes}
    return known | {ALL: known.get(ALL, Fraction(0)) + joint.get(NOTHING, Fraction(0))}


# Random sources.


def random_masses(seed: int, n: int) -> Array:
    """(n, 32): from a few sets to all of them, from mild to extreme."""
    random = generator(seed)
    masses = random.exponential(size=(n, N_SUBSETS)) ** random.choice([1.0, 4.0, 12.0], size=(n, 1))
    masses *= random.random((n, N_SUBSETS)) < random.choice([0.15, 0.5, 1.0], size=(n, 1))
    masses[:, 0] = 0.0
    masses[:, EVERYTHING] += 0.05 * np.maximum(masses.sum(axis=1), 1.0)
    return np.asarray(masses / masses.sum(axis=1, keepdims=True))


def mass_of(**shares: float) -> Array:
    """Mass by names of classes joined by `_or_`; what is left goes to everything."""
    mass = np.zeros(N_SUBSETS)
    for names, share in shares.items():
        mass[sum(1 << FRAME.index(name) for name in FRAME if name in names.split("_or_"))] += share
    mass[EVERYTHING] += 1.0 - mass.sum()
    return mass


def excluding(*shares: float) -> Array:
    """The separable mass that excludes class i with probability shares[i]."""
    each = []
    for i, share in enumerate(shares):
        mass = np.zeros(N_SUBSETS)
        mass[EVERYTHING ^ (1 << i)], mass[EVERYTHING] = share, 1.0 - share
        each.append(mass)
    return reduce(lambda first, second: conjunctive(first, second)[0], each)


SURE_CYLINDER = excluding(0.0, 0.95, 0.95, 0.95, 0.95)
SURE_CLUTTER = excluding(0.95, 0.95, 0.95, 0.95, 0.0)
LIKELY_SPHERE = excluding(0.7, 0.0, 0.3, 0.6, 0.7)
LIKELY_CONE = excluding(0.7, 0.4, 0.0, 0.6, 0.7)

UNIT = st.integers(0, 1000).map(lambda k: k / 1000)


@st.composite
def source(draw: st.DrawFn) -> Array:
    weights = np.zeros(N_SUBSETS)
    for index in draw(st.lists(st.integers(1, EVERYTHING), min_size=1, max_size=8)):
        weights[index] += draw(st.integers(1, 1000))
    weights[EVERYTHING] += weights.sum() / draw(st.integers(1, 50))
    return np.asarray(weights / weights.sum())


@st.composite
def separable(draw: st.DrawFn) -> Array:
    shares = draw(st.lists(UNIT.map(lambda u: 0.95 * u), min_size=N_CLASSES, max_size=N_CLASSES))
    shares[draw(st.integers(0, N_CLASSES - 1))] = 0.0
    return excluding(*shares)


@st.composite
def view(draw: st.DrawFn) -> ViewMass:
    return ViewMass(
        mass=draw(st.one_of(source(), separable())),
        aspect_rad=draw(st.one_of(st.floats(-7.0, 7.0), st.sampled_from([0.0, 0.1, math.pi]))),
        half_turn_symmetric=draw(st.booleans()),
    )


def seen(mass: Array, aspect_deg: float, *, symmetric: bool = True) -> ViewMass:
    return ViewMass(mass=mass, aspect_rad=math.radians(aspect_deg), half_turn_symmetric=symmetric)


def plausibility(mass: Array) -> Array:
    """(32,) mass of all sets that meet each set: what is not believed of its complement, whose index is 31 less its
    own."""
    return np.asarray(1.0 - belief(mass)[..., ::-1])


# Functions of one mass.


def test_a_subset_is_the_sum_of_its_classes() -> None:
    assert subset() == 0
    assert subset("cylinder") == 1
    assert subset(*FRAME) == EVERYTHING
    assert subset("clutter") == EVERYTHING - MINES
    with pytest.raises(ValueError, match="unknown"):
        subset("unknown")


def test_belief_and_pignistic_are_their_definitions() -> None:
    masses = random_masses(1, 40)
    masses[:10] = conjunctive(masses[:10], masses[10:20])[0]
    for k, mass in enumerate(masses):
        m = exact(mass)
        some = {classes: value for classes, value in m.items() if classes}
        expected = [float(sum(value for classes, value in some.items() if classes <= other)) for other in SETS]
        np.testing.assert_allclose(belief(masses)[k], expected, rtol=0, atol=NEAR)
        total = sum(some.values())
        betting = [
            float(sum((v / len(c) for c, v in some.items() if i in c), Fraction(0)) / total) for i in range(N_CLASSES)
        ]
        np.testing.assert_allclose(pignistic(masses)[k], betting, rtol=0, atol=NEAR)
        bits = sum(float(v) * math.log2(len(c)) for c, v in some.items())
        assert nonspecificity(masses)[k] == pytest.approx(bits, abs=NEAR)


@given(source(), UNIT)
def test_a_discount_scales_belief_and_leaves_the_rest_unknown(mass: Array, reliability: float) -> None:
    discounted = discount(mass, reliability)
    np.testing.assert_allclose(belief(discounted)[:-1], reliability * belief(mass)[:-1], rtol=0, atol=NEAR)
    assert discounted.sum() == pytest.approx(1.0, abs=NEAR)
    np.testing.assert_array_equal(discount(mass, 1.0), mass)
    np.testing.assert_array_equal(discount(mass, 0.0), vacuous())


# Rules of combination.


def test_a_thousand_random_views_combine_as_in_rational_arithmetic() -> None:
    masses = random_masses(2, 1000).reshape(2, 500, N_SUBSETS)
    joint, contradiction = conjunctive(masses[0], masses[1])
    fused = dempster(masses)
    unknown = yager(masses)
    for k in range(500):
        pair = [exact(masses[0, k]), exact(masses[1, k])]
        m = exact_conjunctive(*pair)
        np.testing.assert_allclose(joint[k], floats(m), rtol=NEAR, atol=0)
        k_exact = m.get(NOTHING, Fraction(0))
        assert contradiction[k] == pytest.approx(float(k_exact), abs=NEAR)
        assert conflict(masses[0, k], masses[1, k]) == pytest.approx(float(k_exact), abs=NEAR)
        np.testing.assert_allclose(fused.mass[k], floats(normalised(m)), rtol=NEAR, atol=0)
        assert fused.log_agreement[k] == pytest.approx(math.log(1 - k_exact), abs=NEAR)
        np.testing.assert_allclose(unknown[k], floats(with_conflict_unknown(m)), rtol=NEAR, atol=0)


def test_chains_of_views_combine_as_in_rational_arithmetic() -> None:
    for seed in range(5):
        masses = random_masses(seed, 4)
        chain = [exact(mass) for mass in masses]
        joint = reduce(exact_conjunctive, chain)
        np.testing.assert_allclose(dempster(masses).mass, floats(normalised(joint)), rtol=NEAR, atol=0)
        np.testing.assert_allclose(yager(masses), floats(with_conflict_unknown(joint)), rtol=NEAR, atol=0)


def test_rules_take_stacks_of_sources_as_one_by_one() -> None:
    masses = random_masses(4, 24).reshape(4, 2, 3, N_SUBSETS)
    for rule in (lambda m: dempster(m).mass, yager):
        together = rule(masses)
        assert together.shape == (2, 3, N_SUBSETS)
        for i, j in np.ndindex(2, 3):
            np.testing.assert_array_equal(together[i, j], rule(masses[:, i, j]))


# Views of one contact.

ZADEH = (mass_of(cylinder=0.99, sphere=0.01), mass_of(clutter=0.99, sphere=0.01))


def test_zadehs_example_ends_in_ignorance_not_in_the_class_both_doubt() -> None:
    assert dempster(np.stack(ZADEH)).mass[subset("sphere")] == pytest.approx(1.0)
    for reliability in (1.0, 0.95):
        a, b = (discount(mass, reliability) for mass in ZADEH)
        fusion = combine([seen(a, 0), seen(b, 90)])
        assert fusion.conflict > APART_FROM
        np.testing.assert_array_equal(fusion.mass, vacuous())


@settings(max_examples=60)
@given(st.lists(view(), min_size=1, max_size=7), st.integers(0, 1000))
def test_the_order_of_views_does_not_matter(views: list[ViewMass], seed: int) -> None:
    fusion = combine(views)
    again = combine([views[i] for i in generator(seed).permutation(len(views))])
    assert fusion.conflict == pytest.approx(again.conflict, abs=NEAR)
    np.testing.assert_allclose(fusion.mass, again.mass, rtol=0, atol=NEAR)
    assert fusion.mass[0] == 0.0
    assert (fusion.mass >= 0.0).all()
    assert fusion.mass.sum() == pytest.approx(1.0, abs=NEAR)


@given(st.one_of(source(), separable()))
def test_one_view_is_what_it_says(mass: Array) -> None:
    fusion = combine([seen(mass, 30)])
    np.testing.assert_allclose(fusion.mass, mass, rtol=0, atol=NEAR)
    assert fusion.conflict == 0.0


def test_views_from_square_aspects_count_in_full() -> None:
    fusion = combine([seen(LIKELY_SPHERE, 10), seen(LIKELY_CONE, 100)])
    np.testing.assert_allclose(fusion.mass, dempster(np.stack((LIKELY_SPHERE, LIKELY_CONE))).mass, rtol=0, atol=1e-7)


@given(separable(), st.integers(2, 5))
def test_the_same_seen_again_counts_once(mass: Array, n: int) -> None:
    for turn_deg in (0, 180):
        np.testing.assert_allclose(
            combine([seen(mass, 70 + turn_deg * i) for i in range(n)]).mass, mass, rtol=0, atol=NEAR
        )


def gain_bits(*views: ViewMass) -> float:
    """Compute the information of all views beyond the first."""
    return float(nonspecificity(combine(views[:1]).mass) - nonspecificity(combine(views).mass))


def test_a_view_adds_the_more_the_farther_its_aspect_is_from_those_viewed() -> None:
    gains = [gain_bits(seen(LIKELY_SPHERE, 0), seen(LIKELY_SPHERE, apart)) for apart in (0, 5, 10, 20, 30, 45, 90)]
    assert gains[0] == pytest.approx(0.0, abs=NEAR)
    assert all(less < more for less, more in itertools.pairwise(gains))
    rho = math.exp(-(20.0**2) / (2.0 * 15.0**2))
    again = dempster(np.stack((LIKELY_SPHERE, discount(LIKELY_SPHERE, 1.0 - rho)))).mass
    np.testing.assert_allclose(
        combine([seen(LIKELY_SPHERE, 350), seen(LIKELY_SPHERE, 10)]).mass, again, rtol=0, atol=NEAR
    )


def test_the_opposite_side_is_news_only_of_a_shape_that_differs_there() -> None:
    same = seen(LIKELY_SPHERE, 0), seen(LIKELY_SPHERE, 180)
    other = tuple(seen(v.mass, math.degrees(v.aspect_rad), symmetric=False) for v in same)
    assert gain_bits(*same) == pytest.approx(0.0, abs=NEAR)
    assert gain_bits(*other) > 0.3


def test_of_like_aspects_the_view_that_adds_most_counts_in_full_whenever_it_came() -> None:
    poor = discount(LIKELY_CONE, 0.2)
    for views in ((poor, LIKELY_SPHERE), (LIKELY_SPHERE, poor)):
        fusion = combine([seen(views[0], 40), seen(views[1], 40)])
        np.testing.assert_allclose(fusion.mass, LIKELY_SPHERE, rtol=0, atol=NEAR)


def test_conflict_chooses_the_rule() -> None:
    def fused(share: float) -> tuple[Array, Array]:
        pair = np.stack((mass_of(cylinder=math.sqrt(share)), mass_of(clutter=math.sqrt(share))))
        fusion = combine([seen(pair[0], 0), seen(pair[1], 90)])
        assert fusion.conflict == pytest.approx(share)
        return fusion.mass, pair

    for share, rule in (
        (0.59, lambda pair: dempster(pair).mass),
        (0.61, yager),
        (0.89, yager),
        (0.91, lambda _: vacuous()),
    ):
        mass, pair = fused(share)
        np.testing.assert_allclose(mass, rule(pair), rtol=0, atol=1e-7)
    assert fused(0.59)[0][EVERYTHING] < 0.15
    assert fused(0.61)[0][EVERYTHING] > 0.61


def test_two_sure_views_that_contradict_each_other_leave_nothing_known_and_a_third_shows_which_is_odd() -> None:
    two = combine([seen(SURE_CYLINDER, 0), seen(SURE_CLUTTER, 60)])
    assert DEMPSTER_BELOW < two.conflict < APART_FROM
    assert two.mass[EVERYTHING] > 0.85
    three = combine([seen(SURE_CYLINDER, 0), seen(SURE_CLUTTER, 60), seen(SURE_CYLINDER, 120)])
    assert three.conflict > APART_FROM
    assert combine([seen(SURE_CYLINDER, 0), seen(SURE_CYLINDER, 120)]).conflict < DEMPSTER_BELOW


def test_many_views_that_waver_between_two_classes_are_not_contradictory() -> None:
    views = [seen((LIKELY_SPHERE, LIKELY_CONE)[i % 2], 18 * i) for i in range(10)]
    fusion = combine(views)
    assert fusion.conflict < DEMPSTER_BELOW
    assert belief(fusion.mass)[subset("sphere", "truncated_cone")] > 0.9


def test_contradiction_from_the_same_aspect_is_seen_although_the_second_view_counts_for_nothing() -> None:
    assert combine([seen(ZADEH[0], 40), seen(ZADEH[1], 40)]).conflict > APART_FROM


def test_no_source_can_veto_all_others() -> None:
    sure = mass_of(clutter=1.0)
    fusion = combine([seen(sure, 0), seen(discount(mass_of(cylinder=1.0), 0.5), 90)])
    assert fusion.mass[EVERYTHING] > 0.4 * MIN_IGNORANCE
    assert plausibility(fusion.mass)[subset("cylinder")] > 0.0


def test_what_is_no_mass_or_no_aspect_is_refused() -> None:
    good = vacuous()
    wrong: list[tuple[NDArray[np.float64], float]] = [
        (good[:16], 0.0),
        (2.0 * good, 0.0),
        (np.full(N_SUBSETS, 1.0 / N_SUBSETS), 0.0),
        (np.where(np.arange(N_SUBSETS) == 3, np.nan, good), 0.0),
        (good, math.nan),
    ]
    for mass, aspect in wrong:
        with pytest.raises(ValueError, match="of a view"):
            ViewMass(mass=mass, aspect_rad=aspect)
    with pytest.raises(ValueError, match="at least one view"):
        combine([])


# Another look.


def test_another_look_comes_from_the_middle_of_the_widest_gap_of_aspects() -> None:
    def offered_deg(*viewed_deg: float) -> list[float]:
        return [round(math.degrees(a), 9) for a in next_look_aspects(np.radians(viewed_deg))]

    assert offered_deg() == []
    assert offered_deg(30.0) == [120.0]
    assert offered_deg(30.0, 210.0) == [120.0]
    assert offered_deg(0.0, 90.0) == [45.0, 135.0]
    assert offered_deg(350.0, 20.0) == [95.0, 5.0]
    assert offered_deg(-1e-15) == [90.0]


@given(st.lists(st.floats(-20.0, 20.0), min_size=1, max_size=6))
def test_no_direction_is_farther_from_all_aspects_viewed_than_the_first_offered(taken: list[float]) -> None:
    def nearest(direction: float) -> float:
        return min(abs(math.remainder(direction - aspect, math.pi)) for aspect in taken)

    first = next_look_aspects(taken)[0]
    assert 0.0 <= first < math.pi
    assert all(nearest(direction) <= nearest(first) + 1e-8 for direction in np.linspace(0.0, math.pi, 60).tolist())
