"""Measure this computer's speed."""

from __future__ import annotations

from auv_mcm.detect.cascade.speed import measure_speed
from tests.auv_mcm.detect.drawn_cascades import draw_model


def test_a_measured_speed_is_a_number_of_evaluations() -> None:
    assert 1e4 < measure_speed(draw_model(1, sizes=(2,)), 0.5, 0.5, n_runs=1) < 1e12
