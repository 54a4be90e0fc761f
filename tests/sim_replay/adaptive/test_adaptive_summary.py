"""Differences are taken mission by mission; worlds are drawn from their seed."""

from __future__ import annotations

import math

import pytest

from auv_mcm.errors import UsageError
from sim_replay.adaptive.order import SIDE_M, drawn_scene
from sim_replay.benches.adapt import EXPERIMENT, LAWNMOWER, REPLANNED, Arm
from sim_replay.benches.experiment import DRAWN, experiment_rows
from sim_replay.simulator.scene import TARGET_KINDS


def arm(track_m: float, n_found: int, reached_m: float | None) -> Arm:
    return Arm(
        track_m=track_m,
        duration_s=track_m / 2.0,
        reached_m=reached_m,
        believed=0.71,
        believed_at_mines=7.0,
        n_targets=10,
        n_found=n_found,
        n_false=3,
        area_km2=0.01,
        planned_m=2000.0,
        expected=0.72,
    )


def test_both_flights_have_a_row_and_differences_are_paired() -> None:
    flown = [
        {LAWNMOWER: arm(2000.0, 9, 1000.0), REPLANNED: arm(800.0, 8, 700.0)},
        {LAWNMOWER: arm(2000.0, 6, None), REPLANNED: arm(900.0, 7, 880.0)},
    ]
    fixed, replanned = (row.cells for row in experiment_rows(EXPERIMENT, [DRAWN] * 2, flown))
    assert (fixed["track, m"].value, replanned["track, m"].value) == (2000.0, 850.0)
    assert replanned["more track, m"].value == -1150.0
    assert (fixed["order reached"].value, replanned["order reached"].value) == (0.5, 1.0)
    assert replanned["the same where mines lie"].value == pytest.approx(0.7)
    assert (replanned["Pd, mine-like"].value, replanned["more Pd"].value) == (0.75, 0.0)
    words = EXPERIMENT.words(flown)
    assert "2000 m planned" in words
    assert "in the 1 worlds where both did: lawnmower 1000, replanned 700" in words


def test_without_an_order_reached_by_both_no_track_until_then_is_compared() -> None:
    assert "in the 0 worlds" in EXPERIMENT.words([{LAWNMOWER: arm(1000.0, 5, None), REPLANNED: arm(800.0, 8, 700.0)}])


def test_worlds_come_from_their_seed_alone_and_hold_all_objects_inside_the_area() -> None:
    scene = drawn_scene(860)
    assert scene == drawn_scene(860)
    assert scene != drawn_scene(861)
    places = [(target.east_m or 0.0, target.north_m or 0.0) for target in scene.objects]
    assert all(0.0 < value < SIDE_M for place in places for value in place)
    assert min(math.dist(a, b) for k, a in enumerate(places) for b in places[:k]) >= 8.0
    assert sum(target.kind in TARGET_KINDS for target in scene.objects) == 30


def test_an_area_without_room_is_refused_with_what_to_do() -> None:
    with pytest.raises(UsageError, match="take a larger one"):
        drawn_scene(860, 7.0)
