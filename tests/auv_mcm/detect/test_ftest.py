"""The closed-form deviates against the exact F distribution."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import fdtr, fdtrc, ndtri, polygamma

from auv_mcm.detect.ftest import equivalent_looks, f_deviate

LOOKS = (1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0, 1e3, 1e4)
BACKGROUND_LOOKS = (20.0, 30.0, 100.0, 1e3, 1e4)


def exact_deviate(ratio: NDArray[np.float64], looks: float, background_looks: float) -> NDArray[np.float64]:
    """Through the exact tail probability, always the smaller tail, where nothing cancels."""
    below = fdtr(2.0 * looks, 2.0 * background_looks, ratio)
    above = fdtrc(2.0 * looks, 2.0 * background_looks, ratio)
    return np.asarray(np.where(below < 0.5, ndtri(below), -ndtri(above)), dtype=np.float64)


def both(looks: float, background_looks: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Exact and approximate deviates of ratios from deviate -5 to 6."""
    width = np.sqrt(1.0 / looks + 1.0 / background_looks)
    ratio = np.exp(np.concatenate([np.linspace(-16.0, 3.0, 2001), np.linspace(-9.0 * width, 9.0 * width, 1001)]))
    exact = exact_deviate(ratio, looks, background_looks)
    found = f_deviate(*(np.broadcast_to(np.float32(v), ratio.shape) for v in (ratio, looks, background_looks)))
    inside = (exact >= -5.0) & (exact <= 6.0)
    assert exact[inside].min() < -4.9
    assert exact[inside].max() > 5.9
    return exact[inside], found[inside].astype(np.float64)


@pytest.mark.parametrize("background_looks", BACKGROUND_LOOKS)
@pytest.mark.parametrize("looks", LOOKS)
def test_bright_boxes_get_the_exact_deviate_within_7_percent(looks: float, background_looks: float) -> None:
    exact, found = both(looks, background_looks)
    above = exact > 0.0
    assert np.abs(found - exact)[above].max() < 0.43
    strong = exact > 1.0
    assert np.abs(found[strong] / exact[strong] - 1.0).max() < 0.071


@pytest.mark.parametrize("background_looks", BACKGROUND_LOOKS)
@pytest.mark.parametrize(
    ("looks", "share"), [(1.0, 0.48), (2.0, 0.27), (5.0, 0.09), (10.0, 0.036), (30.0, 0.01), (1e3, 0.009), (1e4, 0.009)]
)
def test_dark_boxes_are_understated_by_no_more_than_documented_and_never_overstated(
    looks: float, background_looks: float, share: float
) -> None:
    exact, found = both(looks, background_looks)
    below = exact < 0.0
    error = (found - exact)[below]
    assert error.min() > -0.02
    assert (error / np.maximum(-exact[below], 1.0)).max() < share


@pytest.mark.parametrize("looks", LOOKS)
def test_more_looks_than_a_hundred_on_both_sides_are_as_good_as_exact(looks: float) -> None:
    exact, found = both(max(looks, 100.0), 1e3)
    np.testing.assert_allclose(found, exact, rtol=0, atol=0.02)


@pytest.mark.parametrize("background_looks", [1.0, 2.0, 5.0, 10.0])
def test_a_poor_background_never_makes_a_bright_box_seem_rarer_than_it_is(background_looks: float) -> None:
    for looks in LOOKS:
        ratio = np.exp(np.linspace(0.0, 9.0, 500))
        exact = exact_deviate(ratio, looks, background_looks)
        found = f_deviate(*(np.broadcast_to(np.float32(v), ratio.shape) for v in (ratio, looks, background_looks)))
        strong = (exact > 1.0) & (exact < 6.0)
        assert (found[strong] / exact[strong]).max() < 1.06


def test_the_deviate_rises_with_the_ratio_down_to_zero_and_up_to_any_brightness() -> None:
    ratio = np.concatenate([[0.0], np.geomspace(1e-30, 1e30, 4000)]).astype(np.float32)
    for looks in LOOKS:
        for background_looks in (1.0, *BACKGROUND_LOOKS):
            with np.errstate(all="raise", under="ignore"):
                found = f_deviate(
                    ratio, np.full(ratio.shape, looks, np.float32), np.full(ratio.shape, background_looks, np.float32)
                )
            assert np.isfinite(found).all()
            assert found.dtype == np.float32
            assert np.diff(found).min() > -1e-4 * np.abs(found).max()  # float32 rounding, nothing more


def test_equivalent_looks_invert_the_variance_of_log_speckle() -> None:
    looks = np.geomspace(0.5, 1e5, 3000)
    found = equivalent_looks(polygamma(1, looks).astype(np.float32))
    error = found / looks - 1.0
    assert np.abs(error[looks >= 1.0]).max() < 0.07
    assert np.abs(error[looks >= 5.0]).max() < 0.006
    assert np.abs(error).max() < 0.13
    assert error.max() < 1e-6  # never more looks than there are: that would overstate every deviate


def test_equivalent_looks_agree_with_simulated_speckle() -> None:
    random = np.random.default_rng(3)
    for looks in (1, 4, 16):
        variance = np.log(random.gamma(looks, 1.0 / looks, 200_000)).var()
        assert float(equivalent_looks(np.array([variance], dtype=np.float32))[0]) == pytest.approx(looks, rel=0.08)
