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
    MINES_PER_KM2,
    MINES_SPREAD,
    N_BINS,
    BackgroundPrior,
    counted_log_odds,
    estimate_background,
    expected_background,
    interpolation,
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


def slow_background(
    counts: NDArray[np.float64], area_km2: float, prior: BackgroundPrior, n_draws: int = 60_000
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Weigh draws of the prior by how likely they make the counts: mean and standard deviation of the log-density per
    level, and the mean logarithm of the density of mines.
    """
    random = np.random.Generator(np.random.PCG64(1))
    values = random.multivariate_normal(prior.mean, np.array(prior.covariance), n_draws)
    mines = np.exp(math.log(MINES_PER_KM2) + MINES_SPREAD * random.standard_normal(n_draws))
    share = np.array(
        [math.erfc((level - prior.mine_mean_nats) / prior.mine_sd_nats / math.sqrt(2.0)) / 2.0 for level in LEVELS_NATS]
    )
    share -= np.append(share[1:], 0.0)
    density = BIN_NATS * np.exp(values @ interpolation(LEVELS_NATS + 0.5 * BIN_NATS).T)
    expected = area_km2 * (density + mines[:, np.newaxis] * share)
    log_weight = (xlogy(counts, expected) - expected).sum(axis=1)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    reaching = np.log(np.cumsum(density[:, ::-1], axis=1)[:, ::-1])
    mean = weight @ reaching
    return mean, np.sqrt(weight @ (reaching - mean) ** 2), float(weight @ np.log(mines))


@pytest.mark.parametrize(("seed", "area_km2"), [(1, 0.0), (2, 0.002), (3, 0.01), (4, 0.02)])
def test_the_estimate_is_that_of_draws_weighed_by_their_likelihood(seed: int, area_km2: float) -> None:
    counts = counted_log_odds(drawn_background(seed, area_km2))
    middle, spread, log_mines = slow_background(counts, area_km2, PRIOR)
    found = estimate_background(counts, area_km2, PRIOR)
    read = LEVELS_NATS <= 2.0  # beyond, where a contact in a thousand lies, first order in the spread no longer holds
    assert np.abs(found.middle - middle)[read].max() < 0.2
    assert math.log(found.mines_per_km2) == pytest.approx(log_mines, abs=0.1)
    assert np.allclose(((found.high - found.low) / (2.0 * 1.96))[read], spread[read], rtol=0.2)


def test_an_empty_mission_gives_what_training_expects() -> None:
    found = estimate_background(np.zeros(N_BINS), 0.0, PRIOR)
    assert found.middle == pytest.approx(expected_background(PRIOR)[0], abs=1e-9)
    assert found.mines_per_km2 == pytest.approx(MINES_PER_KM2)


COUNTS = drawn.arrays(np.float64, N_BINS, elements=st.integers(0, 300).map(float))


@given(COUNTS, st.sampled_from([0.0, 0.001, 0.1, 20.0]))
def test_the_more_mine_like_a_contact_the_fewer_false_alarms_whatever_was_seen(
    counts: NDArray[np.float64], area_km2: float
) -> None:
    found = estimate_background(counts, area_km2, PRIOR)
    for part in found[:3]:
        assert np.isfinite(part).all()
        assert (np.diff(part) <= 1e-12).all()
    assert (found.low <= found.middle + 1e-12).all()
    assert (found.middle <= found.high + 1e-12).all()
    densities = [found.false_alarms(nats).per_km2 for nats in (-9.0, LOWEST_NATS, -1.0, 0.1, 3.0, 9.0)]
    assert densities == sorted(densities, reverse=True)


@pytest.mark.parametrize("area_km2", [0.005, 0.05, 0.5, 5.0])
def test_more_background_never_makes_a_contact_more_mine_like(area_km2: float) -> None:
    """As far as a density can matter: beyond the last knot a steeper slope takes rarer ones further down."""
    density = BIN_NATS * np.exp(interpolation(LEVELS_NATS + 0.5 * BIN_NATS) @ np.array(PRIOR.mean))
    before = estimate_background(np.zeros(N_BINS), area_km2, PRIOR)
    for times in (0.5, 1.0, 2.0, 4.0, 16.0):
        found = estimate_background(times * area_km2 * density, area_km2, PRIOR)
        matters = before.middle > math.log(0.1)  # per km²
        assert (found.middle >= before.middle - 1e-9)[matters].all(), times
        before = found


@given(COUNTS)
def test_the_estimate_is_the_same_again_to_the_last_bit(counts: NDArray[np.float64]) -> None:
    first, again = (estimate_background(counts, 0.05, PRIOR) for _ in range(2))
    assert [part.tobytes() for part in first[:3]] == [part.tobytes() for part in again[:3]]


@pytest.mark.parametrize("seed", range(5))
def test_a_handful_of_mines_among_few_contacts_does_not_silence_them(seed: int) -> None:
    background = drawn_background(seed, 0.01)
    mines = np.array([-0.5, 0.4, 1.2, 2.1, 2.6, 3.3])
    assert len(mines) > 0.1 * len(background)
    without = estimate_background(counted_log_odds(background), 0.01, PRIOR)
    among = estimate_background(counted_log_odds(np.concatenate([background, mines])), 0.01, PRIOR)
    for asked in (30.0, 100.0, 300.0):
        assert among.level_nats(asked) < without.level_nats(asked) + 1.0
    assert among.mines_per_km2 > 2.0 * without.mines_per_km2
    assert np.count_nonzero(mines >= among.level_nats(30.0)) >= 3


@pytest.mark.parametrize("times", [0.3, 1.0, 3.0])
def test_a_long_mission_shows_its_background_by_itself(times: float) -> None:
    area_km2 = 20.0
    log_odds = drawn_background(7, area_km2, times)
    found = estimate_background(counted_log_odds(log_odds), area_km2, PRIOR)
    for level in (0, 6, 14):
        n = np.count_nonzero(log_odds >= LEVELS_NATS[level])
        estimate = found.false_alarms(LEVELS_NATS[level])
        assert estimate.per_km2 == pytest.approx(n / area_km2, rel=0.15)
        assert estimate.low < n / area_km2 < estimate.high


def test_the_level_is_where_as_many_false_alarms_as_asked_are_expected() -> None:
    found = estimate_background(counted_log_odds(drawn_background(3, 0.1)), 0.1, PRIOR)
    for asked in (3.0, 30.0, 300.0):
        assert found.false_alarms(found.level_nats(asked)).per_km2 == pytest.approx(asked)
    assert found.level_nats(1e6) == -math.inf
    assert found.level_nats(1e-9) == math.inf


def test_bins_in_which_nothing_is_reported_carry_no_information() -> None:
    counts = counted_log_odds(drawn_background(3, 0.1))
    silenced = np.where(LEVELS_NATS >= -1.0, counts, 0.0)
    found, rest = (estimate_background(some, 0.1, PRIOR, reported_from_nats=-1.0) for some in (counts, silenced))
    assert found.middle.tobytes() == rest.middle.tobytes()
    believed_empty = estimate_background(silenced, 0.1, PRIOR)
    assert found.middle[0] > believed_empty.middle[0] + 1.0


def test_log_odds_fall_into_bins_from_the_lowest_level_on() -> None:
    counts = counted_log_odds([LOWEST_NATS - 0.01, LOWEST_NATS, LOWEST_NATS + 0.3, 50.0, math.inf, -math.inf])
    assert (counts[0], counts[1], counts[-1], counts.sum()) == (1.0, 1.0, 2.0, 4.0)


def test_what_cannot_be_is_refused() -> None:
    for counts, area_km2 in ((np.zeros(3), 1.0), (np.full(N_BINS, -1.0), 1.0), (np.full(N_BINS, math.nan), 1.0)):
        with pytest.raises(ValueError, match="counts must be"):
            estimate_background(counts, area_km2, PRIOR)
    with pytest.raises(ValueError, match="the area searched must be finite and not negative, got nan"):
        estimate_background(np.zeros(N_BINS), math.nan, PRIOR)


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
