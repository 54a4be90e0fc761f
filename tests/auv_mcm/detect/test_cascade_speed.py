"""Budgets from this computer's speed."""

from __future__ import annotations

import math

import pytest

from auv_mcm.detect.cascade.speed import budget_for, measure_speed
from tests.auv_mcm.detect.drawn_cascades import draw_model


def test_a_budget_is_the_evaluations_of_its_share_of_the_time() -> None:
    assert budget_for(400e6, 15.0, 0.05) == 300_000_000
    assert budget_for(400e6, 15.0, 0.0) == 0


@pytest.mark.parametrize(("speed", "period_s", "duty"), [(-1.0, 1.0, 0.5), (1.0, math.inf, 0.5), (1.0, 1.0, 1.01), (math.nan, 1.0, 0.5)])
def test_senseless_shares_are_refused(speed: float, period_s: float, duty: float) -> None:
    with pytest.raises(ValueError, match="must be finite"):
        budget_for(speed, period_s, duty)


def test_a_measured_speed_is_a_number_of_evaluations() -> None:
    assert 1e4 < measure_speed(draw_model(1, sizes=(2,)), 0.5, 0.5, n_runs=1) < 1e12
