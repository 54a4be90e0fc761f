"""From matches of shape models to masses that know what they do not know, and from scores to probabilities."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import (
    EVERYTHING,
    FRAME,
    MINES,
    N_CLASSES,
    N_SUBSETS,
    Array,
    belief,
    p_mine,
    pignistic,
    plausibility,
    subset,
    vacuous,
)
from auv_mcm.classify.evidence import (
    TEMPERATURE,
    Calibration,
    ClassEvidence,
    appriou_mass,
    calibrated,
    calibration_error,
    fit_calibration,
    highlight_consistency,
    size_plausibility,
    view_mass,
)
from auv_mcm.errors import BadInputError
from auv_mcm.records import NAN, ContactClass

NEAR = 1e-12
SHARE = st.one_of(st.floats(0.0, 1.0), st.just(NAN))
EVIDENCE = st.dictionaries(
    st.sampled_from(FRAME),
    st.builds(ClassEvidence, nll=st.one_of(st.floats(-1e6, 1e6), st.just(math.inf)), plausibility=SHARE, highlight_consistency=SHARE),
)


def matches(**nll: float) -> dict[ContactClass, ClassEvidence]:
    """Evidence from `nll` by class, the classes not named matching hopelessly; sizes and highlights not known."""
    return {name: ClassEvidence(nll=nll.get(name, 3000.0)) for name in FRAME}


def bel(mass: Array, *names: ContactClass) -> float:
    return float(belief(mass)[subset(*names)])


def pl(mass: Array, *names: ContactClass) -> float:
    return float(plausibility(mass)[subset(*names)])


# One row per example of the source paper's Table 1. Log-likelihoods of a shadow of some hundred pixels.
TABLE_1 = {
    "cylinder": matches(cylinder=1000.0, sphere=1060.0, truncated_cone=1052.0, wedge=1045.0, clutter=1007.0),
    "sphere": matches(cylinder=1060.0, sphere=1000.0, truncated_cone=1030.0, wedge=1050.0, clutter=1011.0),
    "cone": matches(cylinder=1050.0, sphere=1002.0, truncated_cone=1000.0, wedge=1045.0, clutter=1012.0),
    "clutter": matches(cylinder=1000.5, sphere=1060.0, truncated_cone=1055.0, wedge=1045.0, clutter=1000.0),
}


def test_the_source_papers_table_comes_out_of_the_comparison_rule() -> None:
    """Bel(cyl), Bel(sph), Bel(con), Bel(clut) of its four examples are 0.71 0 0 0.2, 0 0.833 0 0.083, 0 0.303 0.45 0.045, 0.42 0 0 0.46."""
    published = {
        "cylinder": (0.71, 0.0, 0.0, 0.2),
        "sphere": (0.0, 0.833, 0.0, 0.083),
        "cone": (0.0, 0.303, 0.45, 0.045),
        "clutter": (0.42, 0.0, 0.0, 0.46),
    }
    for row, expected in published.items():
        mass = appriou_mass(TABLE_1[row], quality=0.9)
        beliefs = [bel(mass, name) for name in ("cylinder", "sphere", "truncated_cone", "clutter")]
        assert beliefs == pytest.approx(expected, abs=0.1)
        assert sum(beliefs) < 1.0


def test_a_clear_cylinder_is_believed_one() -> None:
    mass = view_mass(TABLE_1["cylinder"], quality=0.9)
    assert bel(mass, "cylinder") > 0.5
    assert pl(mass, "cylinder") == pytest.approx(1.0)
    assert max(bel(mass, name) for name in FRAME[1:]) < NEAR
    assert p_mine(mass) > 0.8


def test_a_cone_that_could_be_a_sphere_is_believed_one_of_the_two() -> None:
    mass = view_mass(TABLE_1["cone"], quality=0.9)
    assert bel(mass, "sphere", "truncated_cone") > 0.65
    assert mass[subset("sphere", "truncated_cone")] > 1.5 * mass[subset("truncated_cone")] > 0.0
    assert bel(mass, "sphere") < NEAR
    assert pignistic(mass).argsort()[::-1][:2].tolist() == [FRAME.index("truncated_cone"), FRAME.index("sphere")]
    # The first family splits it instead into two beliefs that contradict each other.
    first = appriou_mass(TABLE_1["cone"], quality=0.9)
    assert first[subset("sphere", "truncated_cone")] < 0.02
    assert min(bel(first, "sphere"), bel(first, "truncated_cone")) > 0.3


def test_clutter_that_could_be_a_cylinder_leaves_the_decision_open() -> None:
    mass = view_mass(TABLE_1["clutter"], quality=0.9)
    assert bel(mass, "cylinder", "clutter") > 0.6
    assert belief(mass)[MINES] < 0.01 < 0.9 < plausibility(mass)[MINES]
    assert pignistic(mass).argmax() == FRAME.index("clutter")


def test_classes_that_match_alike_share_one_mass() -> None:
    mass = view_mass(matches(sphere=900.0, truncated_cone=900.0), quality=1.0)
    assert mass[subset("sphere", "truncated_cone")] == pytest.approx(0.95**3)
    everything = {name: ClassEvidence(nll=123.0) for name in FRAME}
    np.testing.assert_array_equal(view_mass(everything, quality=1.0), vacuous())


@given(EVIDENCE, st.floats(0.0, 1.0), st.floats(0.1, 100.0))
def test_masses_are_masses_and_no_view_is_sure(evidence: dict[ContactClass, ClassEvidence], quality: float, temperature: float) -> None:
    for rule in (view_mass, appriou_mass):
        mass = rule(evidence, quality, temperature)
        assert mass.shape == (N_SUBSETS,)
        assert (mass >= 0.0).all()
        assert mass[0] == 0.0
        assert mass.sum() == pytest.approx(1.0, abs=NEAR)
        assert mass[EVERYTHING] >= 0.05**N_CLASSES * 0.999
        assert belief(mass).max() <= 1.0 + NEAR


@given(EVIDENCE)
def test_a_worthless_view_and_no_evidence_are_ignorance(evidence: dict[ContactClass, ClassEvidence]) -> None:
    for rule in (view_mass, appriou_mass):
        np.testing.assert_array_equal(rule(evidence, quality=0.0), vacuous())
        np.testing.assert_array_equal(rule({}, quality=1.0), vacuous())


def test_the_worse_a_view_the_less_it_believes() -> None:
    beliefs = [bel(view_mass(TABLE_1["cylinder"], quality), "cylinder") for quality in (0.0, 0.2, 0.5, 0.8, 0.95)]
    assert all(less < more for less, more in itertools.pairwise(beliefs))
    assert bel(view_mass(TABLE_1["cylinder"], 1.0), "cylinder") == beliefs[-1]


def test_masses_are_the_products_of_what_is_said_of_each_class() -> None:
    quality = 0.75
    mass = view_mass(TABLE_1["cone"], quality)
    lowest = min(item.nll for item in TABLE_1["cone"].values())
    excluded = [Fraction(quality * (1.0 - math.exp((lowest - TABLE_1["cone"][name].nll) / TEMPERATURE))) for name in FRAME]
    for index in range(N_SUBSETS):
        expected = math.prod(1 - x if index >> i & 1 else x for i, x in enumerate(excluded))
        assert mass[index] == pytest.approx(float(expected), abs=NEAR)


def test_a_class_not_tried_stays_possible() -> None:
    mass = view_mass({"sphere": ClassEvidence(nll=900.0), "clutter": ClassEvidence(nll=990.0)}, quality=0.9)
    assert pl(mass, "wedge") == pl(mass, "sphere") == pytest.approx(1.0)
    assert pl(mass, "clutter") == pytest.approx(0.1)


@given(st.floats(-1e6, 1e6))
def test_only_differences_of_log_likelihoods_count(shift: float) -> None:
    for rule in (view_mass, appriou_mass):
        moved = {name: ClassEvidence(nll=item.nll + shift) for name, item in TABLE_1["cone"].items()}
        np.testing.assert_allclose(rule(moved, 0.9), rule(TABLE_1["cone"], 0.9), rtol=0, atol=1e-9)


# Sizes and highlights.


def sized(share: float) -> dict[ContactClass, ClassEvidence]:
    """A sphere that matches far better than all else, of a size plausible by `share`."""
    return matches(clutter=1000.0) | {"sphere": ClassEvidence(nll=900.0, plausibility=share)}


def test_what_looks_like_a_mine_of_impossible_size_is_clutter() -> None:
    mass = view_mass(sized(0.0), quality=0.9)
    assert bel(mass, "clutter") > 0.6
    assert pl(mass, "sphere") == pytest.approx(0.1)
    # In the first family the other classes exclude each other and so leave the impossible one.
    assert bel(appriou_mass(sized(0.0), quality=0.9), "sphere") > 0.6


def test_the_less_plausible_a_size_the_less_a_mine_is_believed() -> None:
    probabilities = [float(p_mine(view_mass(sized(share), quality=0.9))) for share in (1.0, 0.8, 0.6, 0.5, 0.4, 0.2, 0.0)]
    assert all(more > less for more, less in itertools.pairwise(probabilities))
    assert pl(view_mass(sized(0.5), quality=0.9), "sphere") == pl(view_mass(sized(0.5), quality=0.9), "clutter") == pytest.approx(1.0)
    np.testing.assert_array_equal(view_mass(sized(NAN), 0.9), view_mass(sized(1.0), 0.9))


def test_a_highlight_that_does_not_fit_weighs_against_a_class_but_does_not_exclude_it() -> None:
    def cone_against_sphere(consistency: float) -> Array:
        return view_mass(
            matches() | {"truncated_cone": ClassEvidence(nll=900.0, highlight_consistency=consistency), "sphere": ClassEvidence(nll=900.0)},
            0.9,
        )

    np.testing.assert_array_equal(cone_against_sphere(NAN), cone_against_sphere(1.0))
    assert pl(cone_against_sphere(1.0), "truncated_cone") == pytest.approx(1.0)
    assert pl(cone_against_sphere(0.5), "truncated_cone") == pytest.approx(1.0 - 0.9 * 0.3)
    assert pl(cone_against_sphere(0.0), "truncated_cone") == pytest.approx(1.0 - 0.9 * 0.6)


def test_sizes_are_plausible_inside_their_range_and_fade_over_three_tenths_of_it() -> None:
    for size, expected in ((0.69, 0.0), (0.7, 0.0), (0.85, 0.5), (1.0, 1.0), (1.5, 1.0), (2.0, 1.0), (2.3, 0.5), (2.6, 0.0), (9.0, 0.0)):
        assert size_plausibility([size], [1.0], [2.0]) == pytest.approx(expected, abs=NEAR)
    assert size_plausibility([0.85, 2.3, 1.1], [1.0] * 3, [2.0] * 3) == pytest.approx(0.25)
    assert size_plausibility([NAN, 2.3], [1.0] * 2, [2.0] * 2) == pytest.approx(0.5)
    np.testing.assert_allclose(size_plausibility([[1.2, 1.3], [0.1, 1.3]], [1.0, 1.0], [2.0, 2.0]), [1.0, 0.0])
    with pytest.raises(ValueError, match="least_m <= most_m"):
        size_plausibility([1.0], [2.0], [1.0])
    with pytest.raises(ValueError, match="least_m <= most_m"):
        size_plausibility([1.0], [0.0], [1.0])


def test_highlights_agree_within_fifteen_centimetres() -> None:
    agreement = highlight_consistency([1.0, 1.15, 0.85, 9.0, NAN], 1.0)
    np.testing.assert_allclose(agreement, [1.0, math.exp(-0.5), math.exp(-0.5), 0.0, NAN], atol=NEAR)


def test_evidence_out_of_range_is_refused() -> None:
    for nll in (NAN, -math.inf):
        with pytest.raises(ValueError, match="nll"):
            ClassEvidence(nll=nll)
    with pytest.raises(ValueError, match="plausibility"):
        ClassEvidence(nll=1.0, plausibility=1.1)
    with pytest.raises(ValueError, match="highlight_consistency"):
        ClassEvidence(nll=1.0, highlight_consistency=-0.1)
    for rule in (view_mass, appriou_mass):
        for quality in (-0.1, 1.1, NAN):
            with pytest.raises(ValueError, match="quality"):
                rule(TABLE_1["cone"], quality)
        for temperature in (0.0, -1.0, NAN, math.inf):
            with pytest.raises(ValueError, match="temperature"):
                rule(TABLE_1["cone"], 0.9, temperature)
        with pytest.raises(ValueError, match="unknown"):
            rule({"unknown": ClassEvidence(nll=1.0)}, 0.9)


# Calibration.


def labelled(slope: float, offset: float, n: int = 20000) -> tuple[Array, NDArray[np.bool_]]:
    """Scores, and truths that are mines with the probability a calibration of that slope and offset gives them."""
    random = np.random.Generator(np.random.PCG64(5))
    score = random.beta(0.8, 0.8, n)
    return score, random.random(n) < calibrated(score, Calibration(slope=slope, offset=offset))


def test_the_default_calibration_changes_nothing() -> None:
    score = np.linspace(0.0, 1.0, 101)
    np.testing.assert_allclose(calibrated(score, Calibration()), score, rtol=0, atol=1e-8)


@pytest.mark.parametrize(("slope", "offset"), [(1.0, 0.0), (0.4, -1.5), (2.5, 1.0)])
def test_a_calibration_is_found_again_from_its_outcomes(slope: float, offset: float) -> None:
    score, mine = labelled(slope, offset)
    fitted = fit_calibration(score, mine)
    assert fitted.slope == pytest.approx(slope, rel=0.1)
    assert fitted.offset == pytest.approx(offset, abs=0.1)
    assert calibration_error(calibrated(score, fitted), mine) < 0.012
    if slope != 1.0:
        assert calibration_error(score, mine) > 0.1
    assert fit_calibration(score, mine) == fitted


def test_the_fit_has_the_least_log_loss() -> None:
    score, mine = labelled(0.6, 0.5, 300)
    fitted = fit_calibration(score, mine)
    target = np.where(mine, (mine.sum() + 1.0) / (mine.sum() + 2.0), 1.0 / ((~mine).sum() + 2.0))

    def loss(slope: float, offset: float) -> float:
        p = calibrated(score, Calibration(slope=slope, offset=offset))
        return float(-(target * np.log(p) + (1.0 - target) * np.log1p(-p)).sum())

    least = loss(fitted.slope, fitted.offset)
    for ds, do in itertools.product((-1e-3, 0.0, 1e-3), repeat=2):
        assert loss(fitted.slope + ds, fitted.offset + do) >= least


def test_separable_scores_give_a_finite_calibration_that_keeps_their_order() -> None:
    score = np.array([0.0, 0.1, 0.2, 0.8, 0.9, 1.0])
    fitted = fit_calibration(score, score > 0.5)
    p = calibrated(score, fitted)
    assert (np.diff(p) > 0.0).all()
    assert 0.0 < p[0] < 0.4
    assert 0.6 < p[-1] < 1.0


@given(st.floats(0.01, 50.0), st.floats(-50.0, 50.0), st.lists(st.floats(0.0, 1.0), min_size=2, max_size=8))
def test_every_calibration_keeps_the_order_of_scores(slope: float, offset: float, scores: list[float]) -> None:
    p = calibrated(sorted(scores), Calibration(slope=slope, offset=offset))
    assert (np.diff(p) >= 0.0).all()
    assert ((p >= 0.0) & (p <= 1.0)).all()


def test_what_cannot_be_calibrated_is_refused_with_the_reason() -> None:
    for score, mine, reason in (
        ([0.2, 0.8], [True, True], "of others"),
        ([0.2, 0.8], [False, False], "of mines"),
        ([0.9, 0.8, 0.1, 0.2], [False, False, True, True], "do not score higher"),
        ([0.5, 0.5], [False, True], "do not score higher"),
        ([], [], "one or more"),
        ([0.5], [True, False], "as many scores"),
        ([0.5, NAN], [True, False], "lie in"),
        ([0.5, 1.5], [True, False], "lie in"),
    ):
        with pytest.raises(BadInputError, match=reason):
            fit_calibration(score, mine)
    for slope, offset in ((0.0, 0.0), (-1.0, 0.0), (NAN, 0.0), (1.0, math.inf)):
        with pytest.raises(ValueError, match="slope"):
            Calibration(slope=slope, offset=offset)


def test_the_calibration_error_is_the_mean_distance_of_promise_and_outcome() -> None:
    assert calibration_error([0.05, 0.95], [False, True]) == pytest.approx(0.05)
    assert calibration_error([1.0, 0.0], [False, True]) == pytest.approx(1.0)
    # In one bin what is promised too much for one is made good by the other.
    assert calibration_error([0.52, 0.58], [False, True]) == pytest.approx(0.05)
    assert calibration_error([0.4, 0.6], [False, True], n_bins=1) == pytest.approx(0.0)
    with pytest.raises(BadInputError, match="one or more"):
        calibration_error([], [])
