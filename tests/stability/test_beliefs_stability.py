"""Long chains, sure contradictions and likelihoods without bounds: beliefs stay exact, finite and honest."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from auv_mcm.classify.beliefs import (
    APART_FROM,
    FRAME,
    N_CLASSES,
    N_SUBSETS,
    Array,
    ViewMass,
    belief,
    combine,
    dempster,
    pignistic,
    subset,
    vacuous,
    yager,
)
from auv_mcm.classify.evidence import ClassEvidence, view_mass
from auv_mcm.records import ContactClass
from sim_replay.benches.stability.back_rows import GRID, whole_masses
from tests.make.random_numbers import generator


@pytest.fixture(autouse=True)
def _no_floating_point_flag() -> Iterator[None]:
    with np.errstate(all="raise", under="ignore"):
        yield


def floats(masses: list[list[int]]) -> Array:
    return np.array(masses) / GRID


def seen(mass: Array, k: int, n: int) -> ViewMass:
    return ViewMass(mass=mass, aspect_rad=math.pi * k / n, half_turn_symmetric=False)


SURE = {name: np.eye(N_SUBSETS)[subset(name)] for name in FRAME}


def test_a_thousand_views_neither_underflow_nor_drift() -> None:
    masses = floats(whole_masses(1, 1000))
    fused = dempster(masses)
    assert fused.mass.sum() == pytest.approx(1.0, abs=1e-12)
    assert -math.inf < fused.log_agreement < -100.0
    assert yager(masses).sum() == pytest.approx(1.0, abs=1e-12)
    halves = dempster(np.stack((dempster(masses[:500]).mass, dempster(masses[500:]).mass)))
    np.testing.assert_allclose(halves.mass, fused.mass, rtol=0, atol=1e-12)


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
