"""Differences are taken mission by mission; worlds are drawn from their seed; the picture shows both flights."""

from __future__ import annotations

import math

import numpy as np
import pytest

from auv_mcm.errors import UsageError
from sim_replay.adaptive.compare import AreaMine, Arm, Compared, Counts
from sim_replay.adaptive.order import SIDE_M, drawn_scene
from sim_replay.adaptive.summary import HEADER, paired, planned_words, rows
from sim_replay.simulator.scene import TARGET_KINDS


def arm(track_m: float, n_found: int, reached_m: float | None) -> Arm:
    counts = Counts(n_found=n_found, n_false=3, n_found_half=n_found - 1, n_false_half=1)
    targets = tuple(AreaMine(p_detected=0.7, found=k < n_found) for k in range(10))
    return Arm(
        track_m=track_m,
        duration_s=track_m / 2.0,
        reached_m=reached_m,
        verdict="",
        believed=0.71,
        n_targets=10,
        at_end=counts,
        targets=targets,
    )


def mission(seed: int, adaptive: Arm, fixed: Arm) -> Compared:
    return Compared(
        seed=seed,
        area_km2=0.01,
        required=0.7,
        adaptive=adaptive,
        fixed=fixed,
        planned_m=2000.0,
        expected=0.72,
    )


def test_a_difference_that_is_the_same_in_every_mission_is_certain() -> None:
    fixed = np.array([100.0, 900.0, 400.0])
    reported = paired(fixed - 50.0, fixed, np.ones(3))
    assert reported.difference == pytest.approx(-50.0)
    assert (reported.low, reported.high) == pytest.approx((-50.0, -50.0))


def test_the_interval_covers_the_true_difference_at_its_nominal_rate() -> None:
    random = np.random.Generator(np.random.PCG64(5))
    covered = 0
    for _ in range(200):
        fixed = random.normal(10.0, 5.0, 30)
        reported = paired(fixed + random.normal(-1.0, 2.0, 30), fixed, np.ones(30))
        covered += reported.low <= -1.0 <= reported.high
    assert covered >= 180


def test_tracks_until_reached_are_compared_only_where_both_reached() -> None:
    missions = [
        mission(1, arm(800.0, 8, 700.0), arm(2000.0, 9, 1000.0)),
        mission(2, arm(900.0, 7, 880.0), arm(2000.0, 6, None)),
    ]
    table = {row[0]: row[1:] for row in rows(missions)}
    assert all(len(row) == len(HEADER) - 1 for row in table.values())
    assert table["track flown, m"][:3] == ["2", "850", "2000"]
    assert table["track until reached where both did, m"][:3] == ["1", "700", "1000"]
    assert table["share that reached the order"][1:3] == ["1.00", "0.50"]
    assert table["Pd at the end, mine-like"][1:3] == ["0.750", "0.750"]
    assert "2000 m planned" in planned_words(missions)


def test_a_lawnmower_that_never_reached_is_reported_as_such() -> None:
    table = {row[0]: row[1:] for row in rows([mission(1, arm(800.0, 8, 700.0), arm(1000.0, 5, None))])}
    assert table["share that reached the order"][1:3] == ["1.00", "0.00"]
    assert table["track until reached where both did, m"] == ["0", "-", "-", "-"]
    assert table["track flown, m"][1:3] == ["800", "1000"]


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
