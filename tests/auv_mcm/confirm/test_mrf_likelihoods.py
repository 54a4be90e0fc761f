"""Costs of intensities against densities integrated numerically, and laws recovered from samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import gammaln, kve, polygamma

from auv_mcm.confirm.likelihoods import (
    BackgroundLaw,
    background_cost,
    choose_background_law,
    gamma_cost,
    inverse_trigamma,
    k_table,
    log_bessel_k,
    trigamma,
)


def gamma_density(value: NDArray[np.float64], mean: NDArray[np.float64] | float, shape: float) -> NDArray[np.float64]:
    log_density = shape * np.log(shape / mean) + (shape - 1.0) * np.log(value) - shape * value / mean - gammaln(shape)
    return np.asarray(np.exp(log_density))


def shared(value: NDArray[np.float64], looks: float) -> NDArray[np.float64]:
    """What every cost leaves out: minus the logarithm of L^L I^(L-1) / Gamma(L)."""
    return np.asarray(-looks * math.log(looks) - (looks - 1.0) * np.log(value) + gammaln(looks))


@pytest.mark.parametrize("looks", [1.0, 1.9, 4.0])
def test_gamma_cost_is_minus_the_log_density(looks: float) -> None:
    value = np.array([1e-3, 0.1, 1.0, 7.0])
    np.testing.assert_allclose(
        gamma_cost(value, 0.3, looks) + shared(value, looks), -np.log(gamma_density(value, 0.3, looks))
    )


@pytest.mark.parametrize(("looks", "nu"), [(1.0, 0.7), (1.0, 4.0), (2.3, 1.5), (3.0, 12.0)])
def test_k_cost_is_that_of_speckle_mixed_over_texture(looks: float, nu: float) -> None:
    mean = 2.5
    value = np.array([1e-3, 0.05, 0.7, 2.5, 20.0, 90.0])
    log_texture = np.linspace(-40.0, 5.0, 40001)
    texture = np.exp(log_texture)
    weight = gamma_density(texture, 1.0, nu) * texture * (log_texture[1] - log_texture[0])
    density = np.array([(gamma_density(np.full_like(texture, v), mean * texture, looks) * weight).sum() for v in value])
    cost = background_cost(value, mean, BackgroundLaw(looks, nu)) + shared(value, looks)
    np.testing.assert_allclose(cost, -np.log(density), atol=1e-3)


def test_k_law_with_hardly_any_texture_is_gamma() -> None:
    value = np.array([0.01, 0.3, 1.0, 2.5])
    np.testing.assert_allclose(
        background_cost(value, 1.0, BackgroundLaw(2.0, 40.0)), gamma_cost(value, 1.0, 2.0), atol=0.1
    )


@pytest.mark.parametrize("looks", [1.0, 6.0, 16.0])
@pytest.mark.parametrize("nu", [0.3, 1.0, 20.0])
def test_k_table_is_finite_everywhere(looks: float, nu: float) -> None:
    _, cost = k_table(looks, nu)
    assert np.isfinite(cost).all()


@pytest.mark.parametrize("order", [0.0, 0.1, -0.5, 1.0, -2.3, 19.7, -50.0])
def test_the_bessel_function_is_scipys(order: float) -> None:
    x = np.exp(np.linspace(math.log(3e-4), math.log(3e5), 501))
    expected = np.log(kve(order, x)) - x
    np.testing.assert_allclose(log_bessel_k(order, x), expected, rtol=2.3e-16, atol=2e-13)


@pytest.mark.parametrize("x", [0.05, 0.3, 1.0, 2.5, 7.9, 8.1, 300.0])
def test_trigamma_and_its_inverse(x: float) -> None:
    assert trigamma(x) == pytest.approx(float(polygamma(1, x)), rel=1e-9)
    assert inverse_trigamma(trigamma(x)) == pytest.approx(x, rel=1e-6)


@pytest.mark.parametrize("nu", [0.7, 1.5, 4.0])
def test_texture_is_found_from_log_cumulants(nu: float) -> None:
    random = np.random.Generator(np.random.PCG64(1))
    sample = random.exponential(1.0, 6000) * random.gamma(nu, 1.0 / nu, 6000)
    law = choose_background_law(float(np.log(sample).var()), 1.0, 6000)
    assert law.looks == 1.0
    assert law.nu == pytest.approx(nu, rel=0.25)


@pytest.mark.parametrize("n", [60, 500, 6000])
@pytest.mark.parametrize("looks", [1.0, 2.5])
def test_speckle_alone_stays_gamma(n: int, looks: float) -> None:
    random = np.random.Generator(np.random.PCG64(2))
    laws = [choose_background_law(float(np.log(random.gamma(looks, 1.0, n)).var()), looks, n) for _ in range(60)]
    assert sum(law == BackgroundLaw(looks, math.inf) for law in laws) >= 58


def test_smoother_than_speckle_means_more_looks() -> None:
    random = np.random.Generator(np.random.PCG64(3))
    law = choose_background_law(float(np.log(random.gamma(4.0, 0.25, 4000)).var()), 1.0, 4000)
    assert law.looks == pytest.approx(4.0, rel=0.1)
    assert math.isinf(law.nu)
