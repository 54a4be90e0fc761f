"""Assignments at the least cost, beside scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from auv_mcm.contacts.assignment import cheapest_columns


@pytest.mark.parametrize("n_rows", [1, 2, 5, 12])
@pytest.mark.parametrize("n_more", [0, 1, 7])
def test_each_row_gets_a_column_of_its_own_as_scipy_chooses_them(n_rows: int, n_more: int) -> None:
    for seed in range(20):
        cost = np.random.default_rng(seed).exponential(size=(n_rows, n_rows + n_more))
        assert cheapest_columns(cost).tolist() == linear_sum_assignment(cost)[1].tolist()


def test_total_is_least_where_many_costs_are_equal_or_prohibitive() -> None:
    for seed in range(40):
        draw = np.random.default_rng(seed)
        cost = draw.integers(0, 4, size=(8, 11)).astype(np.float64)
        cost[draw.random(cost.shape) < 0.4] = 1e9
        chosen = cheapest_columns(cost)
        assert len(set(chosen.tolist())) == 8
        assert cost[np.arange(8), chosen].sum() == cost[linear_sum_assignment(cost)].sum()


def test_no_rows_need_no_columns() -> None:
    assert cheapest_columns(np.zeros((0, 3))).tolist() == []
