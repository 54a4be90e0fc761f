"""From matches of shape models to masses that know what they do not know."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.classify.beliefs import (
    EVERYTHING,
    FRAME,
    MINES,
    N_CLASSES,
    N_SUBSETS,
    Array,
    belief,
    pignistic,
    subset,
    vacuous,
)
from auv_mcm.classify.evidence import (
    TEMPERATURE,
    ClassEvidence,
    size_plausibility,
    view_mass,
)
from auv_mcm.records import NAN, ContactClass

NEAR = 1e-12
SHARE = st.one_of(st.floats(0.0, 1.0), st.just(NAN))
EVIDENCE = st.dictionaries(
    st.sampled_from(FRAME),
    st.builds(ClassEvidence, nll=st.one_of(st.floats(-1e6, 1e6), st.just(math.inf)), plausibility=SHARE),
)


def matches(**nll: float) -> dict[ContactClass, ClassEvidence]:
    """Evidence from `nll` by class, the classes not named matching hopelessly; sizes and highlights not known."""
    return {name: ClassEvidence(nll=nll.get(name, 3000.0)) for name in FRAME}


def bel(mass: Array, *names: ContactClass) -> float:
    return float(belief(mass)[subset(*names)])


def pl(mass: Array, *names: ContactClass) -> float:
    return 1.0 - float(belief(mass)[EVERYTHING - subset(*names)])


# One row per example of the source paper's Table 1. Log-likelihoods of a shadow of some hundred pixels.
TABLE_1 = {
    "cylinder": matches(cylinder=1000.0, sphere=1060.0, truncated_cone=1052.0, wedge=1045.0, clutter=1007.0),
    "sphere": matches(cylinder=1060.0, sphere=1000.0, truncated_cone=1030.0, wedge=1050.0, clutter=1011.0),
    "cone": matches(cylinder=1050.0, sphere=1002.0, truncated_cone=1000.0, wedge=1045.0, clutter=1012.0),
    "clutter": matches(cylinder=1000.5, sphere=1060.0, truncated_cone=1055.0, wedge=1045.0, clutter=1000.0),
}


def test_a_clear_cylinder_is_classified_as_one() -> None:
    mass = view_mass(TABLE_1["cylinder"], quality=0.9)
    assert bel(mass, "cylinder") > 0.5
    assert pl(mass, "cylinder") == pytest.approx(1.0)
    assert max(bel(mass, name) for name in FRAME[1:]) < NEAR
    assert pignistic(mass)[FRAME.index("clutter")] < 0.2


def test_a_cone_that_could_be_a_sphere_is_classified_as_one_of_the_two() -> None:
    mass = view_mass(TABLE_1["cone"], quality=0.9)
    assert bel(mass, "sphere", "truncated_cone") > 0.65
    assert mass[subset("sphere", "truncated_cone")] > 1.5 * mass[subset("truncated_cone")] > 0.0
    assert bel(mass, "sphere") < NEAR
    assert pignistic(mass).argsort()[::-1][:2].tolist() == [FRAME.index("truncated_cone"), FRAME.index("sphere")]


def test_clutter_that_could_be_a_cylinder_leaves_the_decision_open() -> None:
    mass = view_mass(TABLE_1["clutter"], quality=0.9)
    assert bel(mass, "cylinder", "clutter") > 0.6
    assert belief(mass)[MINES] < 0.01 < 0.9 < 1.0 - bel(mass, "clutter")
    assert pignistic(mass).argmax() == FRAME.index("clutter")


def test_classes_that_match_alike_share_one_mass() -> None:
    mass = view_mass(matches(sphere=900.0, truncated_cone=900.0), quality=1.0)
    assert mass[subset("sphere", "truncated_cone")] == pytest.approx(0.95**3)
    everything = {name: ClassEvidence(nll=123.0) for name in FRAME}
    np.testing.assert_array_equal(view_mass(everything, quality=1.0), vacuous())


@given(EVIDENCE, st.floats(0.0, 1.0), st.floats(0.1, 100.0))
def test_masses_are_masses_and_no_view_is_sure(
    evidence: dict[ContactClass, ClassEvidence], quality: float, temperature: float
) -> None:
    mass = view_mass(evidence, quality, temperature)
    assert mass.shape == (N_SUBSETS,)
    assert (mass >= 0.0).all()
    assert mass[0] == 0.0
    assert mass.sum() == pytest.approx(1.0, abs=NEAR)
    assert mass[EVERYTHING] >= 0.05**N_CLASSES * 0.999
    assert belief(mass).max() <= 1.0 + NEAR


@given(EVIDENCE)
def test_a_worthless_view_and_no_evidence_are_ignorance(evidence: dict[ContactClass, ClassEvidence]) -> None:
    np.testing.assert_array_equal(view_mass(evidence, quality=0.0), vacuous())
    np.testing.assert_array_equal(view_mass({}, quality=1.0), vacuous())


def test_the_worse_a_view_the_less_it_believes() -> None:
    beliefs = [bel(view_mass(TABLE_1["cylinder"], quality), "cylinder") for quality in (0.0, 0.2, 0.5, 0.8, 0.95)]
    assert all(less < more for less, more in itertools.pairwise(beliefs))
    assert bel(view_mass(TABLE_1["cylinder"], 1.0), "cylinder") == beliefs[-1]


def test_masses_are_the_products_of_what_is_stated_of_each_class() -> None:
    quality = 0.75
    mass = view_mass(TABLE_1["cone"], quality)
    lowest = min(item.nll for item in TABLE_1["cone"].values())
    excluded = [
        Fraction(quality * (1.0 - math.exp((lowest - TABLE_1["cone"][name].nll) / TEMPERATURE))) for name in FRAME
    ]
    for index in range(N_SUBSETS):
        expected = math.prod(1 - x if index >> i & 1 else x for i, x in enumerate(excluded))
        assert mass[index] == pytest.approx(float(expected), abs=NEAR)


def test_a_class_not_tried_stays_possible() -> None:
    mass = view_mass({"sphere": ClassEvidence(nll=900.0), "clutter": ClassEvidence(nll=990.0)}, quality=0.9)
    assert pl(mass, "wedge") == pl(mass, "sphere") == pytest.approx(1.0)
    assert pl(mass, "clutter") == pytest.approx(0.1)


@given(st.floats(-1e6, 1e6))
def test_only_differences_of_log_likelihoods_count(shift: float) -> None:
    moved = {name: ClassEvidence(nll=item.nll + shift) for name, item in TABLE_1["cone"].items()}
    np.testing.assert_allclose(view_mass(moved, 0.9), view_mass(TABLE_1["cone"], 0.9), rtol=0, atol=1e-9)


# Sizes.


def sized(share: float) -> dict[ContactClass, ClassEvidence]:
    """A sphere that matches far better than all else, of a size plausible by `share`."""
    return matches(clutter=1000.0) | {"sphere": ClassEvidence(nll=900.0, plausibility=share)}


def test_what_looks_like_a_mine_of_impossible_size_is_clutter() -> None:
    mass = view_mass(sized(0.0), quality=0.9)
    assert bel(mass, "clutter") > 0.6
    assert pl(mass, "sphere") == pytest.approx(0.1)


def test_the_less_plausible_a_size_the_less_a_mine_is_believed() -> None:
    doubts = [
        pignistic(view_mass(sized(share), quality=0.9))[FRAME.index("clutter")]
        for share in (1.0, 0.8, 0.6, 0.5, 0.4, 0.2, 0.0)
    ]
    assert all(less < more for less, more in itertools.pairwise(doubts))
    assert (
        pl(view_mass(sized(0.5), quality=0.9), "sphere")
        == pl(view_mass(sized(0.5), quality=0.9), "clutter")
        == pytest.approx(1.0)
    )
    np.testing.assert_array_equal(view_mass(sized(NAN), 0.9), view_mass(sized(1.0), 0.9))


def test_sizes_are_plausible_inside_their_range_and_fade_over_three_tenths_of_it() -> None:
    for size, expected in (
        (0.69, 0.0),
        (0.7, 0.0),
        (0.85, 0.5),
        (1.0, 1.0),
        (1.5, 1.0),
        (2.0, 1.0),
        (2.3, 0.5),
        (2.6, 0.0),
        (9.0, 0.0),
    ):
        assert size_plausibility([size], [1.0], [2.0]) == pytest.approx(expected, abs=NEAR)
    assert size_plausibility([0.85, 2.3, 1.1], [1.0] * 3, [2.0] * 3) == pytest.approx(0.25)
    assert size_plausibility([NAN, 2.3], [1.0] * 2, [2.0] * 2) == pytest.approx(0.5)
    np.testing.assert_allclose(size_plausibility([[1.2, 1.3], [0.1, 1.3]], [1.0, 1.0], [2.0, 2.0]), [1.0, 0.0])
    with pytest.raises(ValueError, match="min_m <= max_m"):
        size_plausibility([1.0], [2.0], [1.0])
    with pytest.raises(ValueError, match="min_m <= max_m"):
        size_plausibility([1.0], [0.0], [1.0])


def test_evidence_out_of_range_is_refused() -> None:
    for nll in (NAN, -math.inf):
        with pytest.raises(ValueError, match="nll"):
            ClassEvidence(nll=nll)
    with pytest.raises(ValueError, match="plausibility"):
        ClassEvidence(nll=1.0, plausibility=1.1)
    for quality in (-0.1, 1.1, NAN):
        with pytest.raises(ValueError, match="quality"):
            view_mass(TABLE_1["cone"], quality)
    for temperature in (0.0, -1.0, NAN, math.inf):
        with pytest.raises(ValueError, match="temperature"):
            view_mass(TABLE_1["cone"], 0.9, temperature)
    with pytest.raises(ValueError, match="unknown"):
        view_mass({"unknown": ClassEvidence(nll=1.0)}, 0.9)
