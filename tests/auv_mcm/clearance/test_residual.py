"""What a search leaves, against playing it out at random."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clearance.residual import Prior, remaining_mines, sweep_width_m

CELL_M2 = 100.0


def played_out(
    n_found: int, p: np.ndarray[tuple[int], np.dtype[np.float64]], prior: Prior, seed: int = 1
) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Mines left over in searches that found exactly n_found, each with a density of its own."""
    rng = np.random.Generator(np.random.PCG64(seed))
    density = rng.gamma(prior.shape, 1.0 / prior.rate_km2, 400_000)
    area_km2 = CELL_M2 * 1e-6
    found = rng.poisson(density * area_km2 * p.sum())
    left = rng.poisson(density * area_km2 * (1.0 - p).sum())
    return np.asarray(left[found == n_found])


@pytest.mark.parametrize("n_found", [0, 1, 4])
def test_what_remains_is_what_is_left_when_played_out(n_found: int) -> None:
    p = np.concatenate([np.zeros(800), np.full(2000, 0.7), np.full(4000, 0.95)])
    prior = Prior(2.0, 1.0)
    left = played_out(n_found, p, prior)
    told = remaining_mines(n_found, p, CELL_M2, prior)
    assert left.size > 5000
    assert told.expected == pytest.approx(left.mean(), abs=4.0 * left.std() / math.sqrt(left.size) + 1e-3)
    assert told.p_none == pytest.approx((left == 0).mean(), abs=0.02)
    assert (left <= told.high).mean() >= 0.95 - 0.01
    assert (left <= told.high - 1).mean() < 0.95 + 0.01


@given(p=st.floats(0.0, 0.98), more=st.floats(0.0, 1.0), found=st.floats(0.0, 50.0))
def test_a_better_search_leaves_no_more(p: float, more: float, found: float) -> None:
    better = p + more * (1.0 - p)
    before, after = (remaining_mines(found, np.full(1000, each), CELL_M2) for each in (p, better))
    assert after.expected <= before.expected + 1e-12
    assert after.p_none >= before.p_none - 1e-12


def test_a_whole_search_leaves_nothing() -> None:
    told = remaining_mines(3, np.ones(500), CELL_M2)
    assert told == (0.0, 0, 1.0)


def test_a_small_search_that_found_much_has_left_much() -> None:
    """Five mines where each is found with 0.4 leave some eight behind, however small the area: the prior adds half a mine."""
    for n_cells in (100, 10_000):
        told = remaining_mines(5, np.full(n_cells, 0.4), CELL_M2)
        assert told.expected == pytest.approx(5.5 * 0.6 / 0.4)
        assert told.high > 7


def test_no_search_and_no_knowledge_leave_anything_possible() -> None:
    told = remaining_mines(0, np.zeros(100), CELL_M2)
    assert math.isinf(told.expected)
    assert told.p_none == 0.0


def test_no_search_leaves_what_was_expected_before() -> None:
    told = remaining_mines(0, np.zeros(10_000), CELL_M2, Prior(3.0, 1.5))
    assert told.expected == pytest.approx(2.0)


def test_what_no_search_can_be_is_refused() -> None:
    for found, p, cell in ((-1.0, 0.5, 1.0), (math.nan, 0.5, 1.0), (1.0, 1.5, 1.0), (1.0, math.nan, 1.0), (1.0, 0.5, 0.0)):
        with pytest.raises(ValueError, match=r"out of range|no probability"):
            remaining_mines(found, np.full(3, p), cell)


def test_sweep_width_is_the_integral_over_range() -> None:
    ground = np.linspace(0.0, 50.0, 501)
    assert sweep_width_m(ground, np.full(501, 0.8)) == pytest.approx(40.0)
    assert sweep_width_m(ground, 1.0 - ground / 50.0) == pytest.approx(25.0)
    with pytest.raises(ValueError, match="must rise"):
        sweep_width_m(ground[::-1], ground)
