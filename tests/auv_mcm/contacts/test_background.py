"""The background of a mission: against a slow estimate, and what must hold for any mission."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as drawn
from numpy.typing import NDArray
from scipy.special import xlogy

from auv_mcm.contacts.background import (
    BIN_NATS,
    KNOTS_NATS,
    LEVELS_NATS,
    LOWEST_NATS,
    N_BINS,
    BackgroundPrior,
    counted_log_odds,
    expected_background,
    interpolation,
    known_background,
    parse_background,
    shipped_background,
)
from auv_mcm.errors import BadInputError

PRIOR = shipped_background().cascade


def drawn_background(seed: int, area_km2: float, times: float = 1.0) -> NDArray[np.float64]:
    """Draw contacts on no mine, (n,) log-odds, as densely as training expects, or `times` as densely."""
    random = np.random.Generator(np.random.PCG64(seed))
    middle = LEVELS_NATS + 0.5 * BIN_NATS
    density = np.exp(interpolation(middle) @ np.array(PRIOR.mean)) * BIN_NATS
    n = random.poisson(times * area_km2 * density)
    return np.repeat(middle, n)


def density_of(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give the density per bin, contacts per km², of log-densities (..., n_knots)."""
    return np.asarray(BIN_NATS * np.exp(values @ interpolation(LEVELS_NATS + 0.5 * BIN_NATS).T))


def slow_background(
    counts: NDArray[np.float64], area_km2: float, prior: BackgroundPrior, n_draws: int = 100_000
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weigh draws of the prior by how likely they make the counts: mean and standard deviation at the knots."""
    random = np.random.Generator(np.random.PCG64(1))
    values = random.multivariate_normal(prior.mean, np.array(prior.covariance), n_draws)
    expected = area_km2 * density_of(values)
    log_weight = (xlogy(counts, expected) - expected).sum(axis=1)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    mean = weight @ values
    return mean, np.sqrt(weight @ (values - mean) ** 2)


@pytest.mark.parametrize(("seed", "area_km2"), [(1, 0.0), (2, 0.002), (3, 0.01), (4, 0.02)])
def test_the_estimate_is_that_of_draws_weighed_by_their_likelihood(seed: int, area_km2: float) -> None:
    counts = counted_log_odds(drawn_background(seed, area_km2))
    middle, spread = slow_background(counts, area_km2, PRIOR)
    values, covariance = known_background(counts, area_km2, PRIOR)
    np.testing.assert_allclose(values, middle, atol=0.2)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), spread, rtol=0.2)


def test_an_empty_mission_gives_what_training_expects() -> None:
    values, covariance = known_background(np.zeros(N_BINS), 0.0, PRIOR)
    np.testing.assert_allclose(values, PRIOR.mean, atol=1e-9)
    np.testing.assert_allclose(covariance, PRIOR.covariance, atol=1e-9)
    middle, _ = expected_background(PRIOR)
    np.testing.assert_allclose(middle, np.log(np.cumsum(density_of(np.array(PRIOR.mean))[::-1])[::-1]))


COUNTS = drawn.arrays(np.float64, N_BINS, elements=st.integers(0, 300).map(float))


@given(COUNTS, st.sampled_from([0.0, 0.001, 0.1, 20.0]))
def test_the_estimate_is_finite_and_the_same_again_whatever_was_seen(
    counts: NDArray[np.float64], area_km2: float
) -> None:
    first, again = (known_background(counts, area_km2, PRIOR) for _ in range(2))
    assert all(np.isfinite(part).all() for part in first)
    assert (np.linalg.eigvalsh(first[1]) > 0.0).all()
    assert [part.tobytes() for part in first] == [part.tobytes() for part in again]


@pytest.mark.parametrize("times", [0.3, 1.0, 3.0])
def test_a_long_mission_shows_its_background_by_itself(times: float) -> None:
    area_km2 = 20.0
    log_odds = drawn_background(7, area_km2, times)
    values, _ = known_background(counted_log_odds(log_odds), area_km2, PRIOR)
    reaching = np.cumsum(density_of(values)[::-1])[::-1]
    for level in (0, 6, 14):
        assert reaching[level] == pytest.approx(np.count_nonzero(log_odds >= LEVELS_NATS[level]) / area_km2, rel=0.15)


def test_bins_in_which_nothing_is_reported_carry_no_information() -> None:
    counts = counted_log_odds(drawn_background(3, 0.1))
    silenced = np.where(LEVELS_NATS >= -1.0, counts, 0.0)
    (found, _), (rest, _) = (known_background(some, 0.1, PRIOR, reported_from_nats=-1.0) for some in (counts, silenced))
    assert found.tobytes() == rest.tobytes()
    believed_empty, _ = known_background(silenced, 0.1, PRIOR)
    assert found[0] > believed_empty[0] + 1.0


def test_log_odds_fall_into_bins_from_the_lowest_level_on() -> None:
    counts = counted_log_odds([LOWEST_NATS - 0.01, LOWEST_NATS, LOWEST_NATS + 0.3, 50.0, math.inf, -math.inf])
    assert (counts[0], counts[1], counts[-1], counts.sum()) == (1.0, 1.0, 2.0, 4.0)


def test_what_cannot_be_is_refused() -> None:
    for counts, area_km2 in ((np.zeros(3), 1.0), (np.full(N_BINS, -1.0), 1.0), (np.full(N_BINS, math.nan), 1.0)):
        with pytest.raises(ValueError, match="counts must be"):
            known_background(counts, area_km2, PRIOR)
    with pytest.raises(ValueError, match="the area searched must be finite and not negative, got nan"):
        known_background(np.zeros(N_BINS), math.nan, PRIOR)


def test_a_model_file_that_is_none_says_where_and_what_to_do() -> None:
    good = msgspec.json.encode(shipped_background())
    assert parse_background(good, "here") == shipped_background()
    bad = msgspec.json.decode(good)
    bad["cascade"]["covariance"][0][1] = 50.0
    for data in (b"{}", msgspec.json.encode(bad), b"\xff"):
        with pytest.raises(BadInputError, match=r"background\.json: .*calibrate background"):
            parse_background(data, "background.json")


def test_the_shipped_prior_reaches_what_was_asked_on_scenes_left_out_of_it() -> None:
    model = shipped_background()
    assert len(KNOTS_NATS) == len(model.cascade.mean)
    reached = [point for scene in model.left_out for point in scene.reached]
    for asked in {point.asked_per_km2 for point in reached}:
        some = [point for point in reached if point.asked_per_km2 == asked]
        n_asked, n_reached = sum(point.n_asked for point in some), sum(point.n_reached for point in some)
        assert n_asked / 3.0 < n_reached < 3.0 * n_asked
