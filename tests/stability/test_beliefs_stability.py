"""Long chains, sure contradictions and likelihoods without bounds: beliefs stay exact, finite and honest."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from auv_mcm.classify.beliefs import (
    APART_FROM,
    DEMPSTER_BELOW,
    EVERYTHING,
    FRAME,
    N_CLASSES,
    N_SUBSETS,
    Array,
    ViewMass,
    belief,
    combine,
    conjunctive,
    dempster,
    discount,
    pignistic,
    subset,
    vacuous,
    yager,
)
from auv_mcm.classify.evidence import ClassEvidence, view_mass
from auv_mcm.records import ContactClass
from sim_replay.benches.stability.back_rows import GRID, whole_masses


@pytest.fixture(autouse=True)
def _no_floating_point_flag() -> Iterator[None]:
    with np.errstate(all="raise", under="ignore"):
        yield


def generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def floats(masses: list[list[int]]) -> Array:
    return np.array(masses) / GRID


def seen(mass: Array, k: int, n: int) -> ViewMass:
    return ViewMass(mass=mass, aspect_rad=math.pi * k / n, half_turn_symmetric=False)


SURE = {name: np.eye(N_SUBSETS)[subset(name)] for name in FRAME}
ZADEH = 0.99 * SURE["cylinder"] + 0.01 * SURE["wedge"], 0.99 * SURE["clutter"] + 0.01 * SURE["wedge"]


def test_a_thousand_views_neither_underflow_nor_drift() -> None:
    masses = floats(whole_masses(1, 1000))
    fused = dempster(masses)
    assert fused.mass.sum() == pytest.approx(1.0, abs=1e-12)
    assert -math.inf < fused.log_agreement < -100.0
    assert yager(masses).sum() == pytest.approx(1.0, abs=1e-12)
    halves = dempster(np.stack((dempster(masses[:500]).mass, dempster(masses[500:]).mass)))
    np.testing.assert_allclose(halves.mass, fused.mass, rtol=0, atol=1e-12)


def test_two_hundred_views_of_one_contact_are_fused() -> None:
    masses = floats(whole_masses(2, 200))
    views = [seen(mass, k, 200) for k, mass in enumerate(masses)]
    fusion = combine(views)
    assert fusion.mass.sum() == pytest.approx(1.0, abs=1e-12)
    again = combine(views[::-1])
    np.testing.assert_array_equal(fusion.mass, again.mass)


def test_sure_sources_that_contradict_each_other_give_a_flag_and_no_nan() -> None:
    pair = np.stack((SURE["cylinder"], SURE["clutter"]))
    mass, conflict = conjunctive(pair[0], pair[1])
    assert float(conflict) == float(mass[0]) == 1.0
    fused = dempster(pair)
    assert fused.log_agreement == -math.inf
    np.testing.assert_array_equal(fused.mass, vacuous())
    np.testing.assert_array_equal(yager(pair), vacuous())
    fusion = combine([seen(pair[0], 0, 2), seen(pair[1], 1, 2)])
    assert fusion.conflict > APART_FROM
    np.testing.assert_array_equal(fusion.mass, vacuous())


def test_a_contradiction_stays_one_whatever_follows() -> None:
    fused = dempster(np.stack((SURE["cylinder"], SURE["clutter"], SURE["sphere"], vacuous())))
    assert fused.log_agreement == -math.inf
    np.testing.assert_array_equal(fused.mass, vacuous())


def test_a_contradiction_in_one_stack_does_not_touch_the_others() -> None:
    first = np.stack((SURE["cylinder"], SURE["cylinder"], vacuous()))
    second = np.stack((SURE["clutter"], SURE["cylinder"], SURE["sphere"]))
    fused = dempster(np.stack((first, second)))
    np.testing.assert_array_equal(fused.log_agreement, [-math.inf, 0.0, 0.0])
    np.testing.assert_array_equal(fused.mass, np.stack((vacuous(), SURE["cylinder"], SURE["sphere"])))


@pytest.mark.parametrize("doubt", [0.0, 1e-300, 1e-16, 1e-13, 1e-9, 1e-3])
def test_the_nearer_to_sure_contradictory_sources_are_the_less_is_made_of_what_they_share(doubt: float) -> None:
    pair = [
        (1.0 - doubt) * SURE["cylinder"] + doubt * SURE["wedge"],
        (1.0 - doubt) * SURE["clutter"] + doubt * SURE["wedge"],
    ]
    fused = dempster(np.stack(pair))
    assert np.isfinite(fused.mass).all()
    if doubt**2 < 1e-12:
        np.testing.assert_array_equal(fused.mass, vacuous())
    assert combine([seen(mass, k, 2) for k, mass in enumerate(pair)]).conflict > APART_FROM


@pytest.mark.parametrize("reliability", [0.5, 0.7, 0.8, 0.95, 1.0])
def test_zadehs_doctors_never_agree_on_what_both_doubt(reliability: float) -> None:
    fusion = combine([seen(discount(mass, reliability), k, 2) for k, mass in enumerate(ZADEH)])
    assert belief(fusion.mass)[subset("wedge")] < 0.02
    assert pignistic(fusion.mass).max() < 0.5
    if reliability >= 0.8:
        assert fusion.mass[EVERYTHING] > 0.6


def test_sure_sources_that_agree_are_combined() -> None:
    fusion = combine([seen(SURE["cylinder"], k, 7) for k in range(7)])
    assert fusion.conflict < DEMPSTER_BELOW
    assert belief(fusion.mass)[subset("cylinder")] == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("scale", [1e-300, 1e-6, 1.0, 1e3, 1e6, 1e12, 1e300, math.inf])
def test_likelihoods_of_any_size_give_masses(scale: float) -> None:
    for signs in (
        (1, 1, 1, 1, 1),
        (0, 1, 1, 1, 1),
        (1, 0, 0, 1, 1),
        (1, 1, 1, 1, 0),
        (-1, 1, 0, 1, -1),
        (-1, -1, -1, -1, -1),
    ):
        if scale == math.inf and -1 in signs:
            continue
        for sure in (0.0, 1.0, 1e-310, 1.0 - 2.0**-53, math.nan):
            evidence: dict[ContactClass, ClassEvidence] = {
                name: ClassEvidence(nll=sign * scale if sign else 0.0, plausibility=sure)
                for name, sign in zip(FRAME, signs, strict=True)
            }
            mass = view_mass(evidence, 1.0)
            assert (mass >= 0.0).all()
            assert mass.sum() == pytest.approx(1.0, abs=1e-12)
            assert np.isfinite(pignistic(mass)).all()
            assert (belief(mass) + belief(mass)[::-1] <= 1.0 + 1e-12).all()


def test_likelihoods_of_a_million_nats_keep_their_differences() -> None:
    random = generator(3)
    for _ in range(200):
        nll = np.round(random.uniform(0.0, 40.0, N_CLASSES), 3)
        plain, far = (
            view_mass({name: ClassEvidence(nll=x + shift) for name, x in zip(FRAME, nll.tolist(), strict=True)}, 0.95)
            for shift in (0.0, 1e6)
        )
        np.testing.assert_allclose(far, plain, rtol=0, atol=1e-9)
