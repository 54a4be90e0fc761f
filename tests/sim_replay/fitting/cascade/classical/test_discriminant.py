"""The discriminant against plain gradient descent, and odds that hold on samples not fitted on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from sim_replay.fitting.cascade.classical.discriminant import Discriminant, fit_calibrated, fit_discriminant
from tests.sim_replay.fitting.cascade.classical.chip_samples import Array, generator


def _samples(seed: int, n: int, slopes: Array) -> tuple[Array, NDArray[np.bool_]]:
    draw = generator(seed)
    features = draw.normal(size=(n, len(slopes)))
    return features, draw.random(n) < 1.0 / (1.0 + np.exp(-(features @ slopes - 0.5)))


def _oracle(features: Array, is_positive: NDArray[np.bool_], weight: Array, ridge: float) -> Discriminant:
    """Gradient descent on standardised features, far longer than needed."""
    mean = (features * weight[:, np.newaxis]).sum(axis=0) / weight.sum()
    scale = np.sqrt((weight[:, np.newaxis] * (features - mean) ** 2).sum(axis=0) / weight.sum())
    z = (features - mean) / scale
    slopes, offset = np.zeros(features.shape[1]), 0.0
    for _ in range(4000):
        excess = weight * (1.0 / (1.0 + np.exp(-(z @ slopes + offset))) - is_positive)
        slopes -= (z.T @ excess + ridge * slopes) / weight.sum()
        offset -= excess.sum() / weight.sum()
    return Discriminant(float(offset - (slopes / scale) @ mean), slopes / scale)


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), ridge=st.sampled_from([0.5, 3.0]))
def test_the_discriminant_is_the_one_that_descent_ends_at(seed: int, ridge: float) -> None:
    features, is_positive = _samples(seed, 120, np.array([1.0, -0.5, 0.0]))
    weight = generator(seed + 1).uniform(0.5, 3.0, 120)
    found, wanted = (
        fit_discriminant(features, is_positive, weight, ridge),
        _oracle(features, is_positive, weight, ridge),
    )
    assert found.slopes == pytest.approx(wanted.slopes, abs=1e-6)
    assert found.offset == pytest.approx(wanted.offset, abs=1e-6)


@settings(max_examples=10, deadline=None)
@given(scale=st.floats(1e-3, 1e3), shift=st.floats(-10.0, 10.0))
def test_units_of_features_change_no_odds(scale: float, shift: float) -> None:
    features, is_positive = _samples(1, 200, np.array([1.0, -1.0]))
    moved = features * np.array([scale, 1.0]) + np.array([shift * scale, shift])
    first, second = (fit_discriminant(f, is_positive, np.ones(200), 1.0).log_odds(f) for f in (features, moved))
    assert second == pytest.approx(first, abs=1e-6)


def test_a_weight_counts_as_so_many_samples() -> None:
    features, is_positive = _samples(2, 60, np.array([1.0, 0.5]))
    weight = generator(3).integers(1, 4, 60)
    weighed = fit_discriminant(features, is_positive, weight.astype(np.float64), 1.0)
    repeated = fit_discriminant(
        np.repeat(features, weight, axis=0), np.repeat(is_positive, weight), np.ones(int(weight.sum())), 1.0
    )
    assert weighed.slopes == pytest.approx(repeated.slopes, abs=1e-9)


def test_features_that_never_vary_have_no_weight() -> None:
    features, is_positive = _samples(4, 100, np.array([1.0]))
    found = fit_discriminant(np.column_stack([features, np.full(100, 7.3)]), is_positive, np.ones(100), 1.0)
    assert found.slopes[1] == 0.0


def test_features_that_part_the_kinds_wholly_give_finite_slopes() -> None:
    features = np.linspace(-1.0, 1.0, 50)[:, np.newaxis]
    found = fit_discriminant(features, features[:, 0] > 0.0, np.ones(50), 1e-3)
    assert math.isfinite(found.slopes[0])
    assert ((found.log_odds(features) > 0.0) == (features[:, 0] > 0.0)).all()


@pytest.mark.parametrize("answer", [True, False])
def test_samples_of_one_kind_are_refused(answer: bool) -> None:
    with pytest.raises(UsageError, match="needs targets and others"):
        fit_discriminant(np.zeros((3, 1)), np.full(3, answer), np.ones(3), 1.0)


def test_odds_hold_on_samples_not_fitted_on_where_a_plain_fit_is_too_sure() -> None:
    slopes = np.zeros(60)
    slopes[:2] = 1.0
    features, is_positive = _samples(5, 300, slopes)
    fresh, is_fresh_positive = _samples(6, 4000, slopes)
    groups = [f"line {index % 10}" for index in range(300)]

    def log_loss(found: Discriminant) -> float:
        odds = found.log_odds(fresh)
        return float((np.logaddexp(0.0, odds) - is_fresh_positive * odds).mean())

    plain = fit_discriminant(features, is_positive, np.ones(300), 0.01)
    calibrated = fit_calibrated(features, is_positive, np.ones(300), 0.01, groups)
    assert log_loss(calibrated) < 0.9 * log_loss(plain)
    assert np.array_equal(np.argsort(calibrated.log_odds(fresh)), np.argsort(plain.log_odds(fresh)))


def test_one_group_alone_is_fitted_as_it_is() -> None:
    features, is_positive = _samples(7, 100, np.array([1.0]))
    plain, alone = (
        fit_discriminant(features, is_positive, np.ones(100), 1.0),
        fit_calibrated(features, is_positive, np.ones(100), 1.0, ["a"] * 100),
    )
    assert alone.offset == plain.offset
    assert np.array_equal(alone.slopes, plain.slopes)
