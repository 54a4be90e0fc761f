"""How the logarithm of speckle is spread."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import polygamma
from scipy.stats import skew

from auv_mcm.waterfall.log_gamma import LOOKS, LOOKS_PRIOR, log_std_and_skewness


def test_far_above_the_cut_cumulants_are_polygamma_functions() -> None:
    log_std, skewness = log_std_and_skewness(np.array([np.inf, 15.9]))
    for row in range(2):
        assert np.exp(log_std[row]) ** 2 == pytest.approx(polygamma(1, LOOKS), rel=1e-5)
        assert skewness[row] == pytest.approx(polygamma(2, LOOKS) / polygamma(1, LOOKS) ** 1.5, rel=1e-4)


@pytest.mark.parametrize("column", [0, 40, 80])
@pytest.mark.parametrize("cut_nats", [-4.0, -1.0, -0.3])
def test_what_is_cut_off_is_allowed_for(column: int, cut_nats: float) -> None:
    looks = float(LOOKS[column])
    random = np.random.default_rng(column)
    excess = np.maximum(np.log(random.gamma(looks, 1.0 / looks, 400_000)) - cut_nats, 0.0)
    log_std, skewness = log_std_and_skewness(np.array([excess.mean()]))
    assert np.exp(log_std[0, column]) == pytest.approx(excess.std(), rel=0.01)
    assert skewness[0, column] == pytest.approx(skew(excess), abs=0.03)


def test_the_prior_of_the_looks_is_a_probability() -> None:
    assert LOOKS_PRIOR.sum() == pytest.approx(1.0)
    assert (LOOKS_PRIOR > 0.0).all()
