"""Mines left as estimated against those really left."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.clearance.residual import remaining_mines
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import Contact
from sim_replay.benches.clearance import CHAIN, EXPERIMENT, JudgedClearance, judge_mission
from sim_replay.benches.experiment import experiment_rows
from tests.make.records import clearance_of

FRAME = LocalFrame(latitude_deg=43.0, longitude_deg=5.0)


def place(east_m: float, north_m: float) -> tuple[float, float]:
    latitude_deg, longitude_deg, _ = FRAME.to_geodetic([east_m, north_m, 0.0])
    return float(latitude_deg), float(longitude_deg)


def contact(east_m: float, north_m: float, p_mine: float) -> Contact:
    latitude_deg, longitude_deg = place(east_m, north_m)
    made = SimpleNamespace(
        latitude_deg=latitude_deg, longitude_deg=longitude_deg, p_mine=p_mine, covariance_m2=np.eye(2) * 0.01
    )
    return cast("Contact", cast("Any", made))


def searched(p: float) -> Clearance:
    """Forty by forty metres, all seen."""
    return clearance_of(np.full((10, 10), p))


def test_a_target_is_found_by_a_contact_called_near_it_and_others_are_left() -> None:
    contacts = [contact(10.5, 10.0, 0.9), contact(20.0, 21.0, 0.15), contact(35.0, 5.0, 0.7), contact(5.0, 35.0, 0.1)]
    judged = judge_mission(searched(0.6), contacts, [place(10.0, 10.0), place(20.0, 20.0), place(30.0, 30.0)])
    assert (judged.n_targets, judged.n_found, judged.n_left) == (3, 1, 2)
    assert judged.by_tables == pytest.approx(1.8)
    assert judged.expected == remaining_mines([0.9, 0.15, 0.7, 0.1], [True, False, True, False], [0.6]).expected


def test_a_floor_without_contacts_or_targets_is_judged_too() -> None:
    judged = judge_mission(searched(0.6), [], [])
    assert (judged.n_targets, judged.n_found) == (0, 0)


def mission(n_left: int, expected: float) -> JudgedClearance:
    return JudgedClearance(n_targets=20, n_found=20 - n_left, by_tables=12.0, expected=expected)


def test_an_estimate_far_off_is_outside_the_interval() -> None:
    assert mission(4, 6.0).is_inside
    assert not mission(19, 3.0).is_inside
    assert not mission(0, 40.0).is_inside


def test_the_table_says_what_was_left_and_what_was_expected() -> None:
    rows = experiment_rows(EXPERIMENT, ["flat", "rough"], [{CHAIN: mission(4, 6.0)}, {CHAIN: mission(19, 3.0)}])
    cells = rows[-1].cells
    assert (cells["targets"].value, cells["left"].value, cells["in the interval"].text) == (40.0, 23.0, "1 of 2")
