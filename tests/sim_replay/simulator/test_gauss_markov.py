"""Gauss-Markov processes have the variance and correlation that their differential equation gives them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_replay.simulator.gauss_markov import DAMPING, GaussMarkov
from tests.make.random_numbers import generator

PERIOD_S = 4.0
OMEGA = 2.0 * math.pi / PERIOD_S
N = 2000


def correlation(lag_s: float) -> float:
    """Of the stationary solution of x'' + 2 z w x' + w^2 x = noise at two times."""
    damped = OMEGA * math.sqrt(1.0 - DAMPING**2)
    return math.exp(-DAMPING * OMEGA * lag_s) * (
        math.cos(damped * lag_s) + DAMPING * OMEGA / damped * math.sin(damped * lag_s)
    )


@pytest.fixture(scope="module")
def ensemble() -> list[GaussMarkov]:
    return [GaussMarkov(0.3, PERIOD_S, generator(seed)) for seed in range(N)]


@pytest.mark.parametrize("time_s", [0.0, 0.0625, 1.3, 41.7])
def test_values_and_rates_are_gaussian_from_the_start_and_stay_so(ensemble: list[GaussMarkov], time_s: float) -> None:
    values, rates = np.array([process.at(time_s) for process in ensemble]).T
    tolerance = 4.5 * math.sqrt(2.0 / N)  # of a variance from N independent samples
    assert np.mean(values**2) == pytest.approx(0.3**2, rel=tolerance)
    assert np.mean(rates**2) == pytest.approx(
        (0.3 * OMEGA) ** 2, rel=tolerance + 0.02
    )  # joining by cubics costs rates a little more
    assert abs(np.mean(values)) < 4.5 * 0.3 / math.sqrt(N)
    assert abs(np.mean(values * rates)) < 4.5 * 0.3**2 * OMEGA / math.sqrt(N)
    assert np.mean((values / 0.3) ** 4) == pytest.approx(3.0, abs=4.5 * math.sqrt(96.0 / N))


@pytest.mark.parametrize("lag_s", [0.2, 0.7, 1.5, 2.4, 4.0, 9.0])
def test_correlation_over_time_is_that_of_a_damped_oscillator(ensemble: list[GaussMarkov], lag_s: float) -> None:
    first, then = (np.array([process.at(3.1 + lag)[0] for process in ensemble]) for lag in (0.0, lag_s))
    expected = correlation(lag_s)
    tolerance = 4.5 * math.sqrt((1.0 + expected**2) / N)
    assert np.mean(first * then) / 0.3**2 == pytest.approx(expected, abs=tolerance)


@settings(max_examples=50)
@given(st.floats(0.01, 60.0))
def test_the_rate_is_how_fast_the_value_changes(time_s: float) -> None:
    process = GaussMarkov(2.0, PERIOD_S, generator(5))
    before, after = process.at(time_s - 1e-6)[0], process.at(time_s + 1e-6)[0]
    assert (after - before) / 2e-6 == pytest.approx(process.at(time_s)[1], abs=1e-4)


def test_values_depend_on_the_time_alone_and_grow_with_sigma() -> None:
    forward, backward, larger, none = (GaussMarkov(sigma, PERIOD_S, generator(8)) for sigma in (1.0, 1.0, 3.0, 0.0))
    times = [0.37 * tick for tick in range(600)]
    values = np.array([forward.at(time_s) for time_s in times])
    assert np.array_equal(values, np.array([backward.at(time_s) for time_s in reversed(times)])[::-1])
    assert np.allclose([larger.at(time_s) for time_s in times], 3.0 * values, rtol=1e-12, atol=0.0)
    assert {none.at(time_s) for time_s in times} == {(0.0, 0.0)}
