"""False alarms per km² and per decision."""

from __future__ import annotations

import argparse
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_replay.studies.pfa import PAPER_PER_KM2, PAPER_PFA, decisions_per_km2, false_alarms_per_km2, grids, pfa, run


def test_the_papers_pair_is_one_decision_in_a_square_of_16_cm() -> None:
    implied = PAPER_PER_KM2 / PAPER_PFA
    assert implied == pytest.approx(3.731e7, rel=1e-3)
    assert pfa(PAPER_PER_KM2, decisions_per_km2(0.1637, 0.1637)) == pytest.approx(PAPER_PFA, rel=1e-3)


@pytest.mark.parametrize(
    ("along_m", "across_m", "per_km2", "probability"),
    [
        (0.12, 0.058, 1.437e8, 6.96e-7),
        (0.24, 0.116, 3.592e7, 2.784e-6),
        (0.12, 0.06, 1.389e8, 7.2e-7),
        (1000.0, 1000.0, 1.0, 100.0),
    ],
)
def test_hundred_false_alarms_per_km2_on_grids_worked_out_by_hand(
    along_m: float, across_m: float, per_km2: float, probability: float
) -> None:
    assert decisions_per_km2(along_m, across_m) == pytest.approx(per_km2, rel=1e-3)
    assert pfa(100.0, decisions_per_km2(along_m, across_m)) == pytest.approx(probability, rel=1e-3)


@given(alarms=st.floats(0.0, 1e5), along_m=st.floats(0.01, 2.0), across_m=st.floats(0.005, 2.0))
def test_there_and_back_is_the_same(alarms: float, along_m: float, across_m: float) -> None:
    per_km2 = decisions_per_km2(along_m, across_m)
    assert false_alarms_per_km2(pfa(alarms, per_km2), per_km2) == pytest.approx(alarms, rel=1e-12)


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan])
def test_no_decisions_give_no_probability(wrong: float) -> None:
    with pytest.raises(ValueError, match="above 0"):
        pfa(100.0, wrong)
    with pytest.raises(ValueError, match="above 0"):
        decisions_per_km2(wrong, 0.06)


def test_the_bench_prints_k_of_every_grid(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(argparse.Namespace()) == 0
    printed = capsys.readouterr().out
    assert all(f"{decisions_per_km2(grid.along_m, grid.across_m):.4g}" in printed for grid in grids())
