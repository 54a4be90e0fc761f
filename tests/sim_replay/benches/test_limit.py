"""What the bench of a second view counts, on made-up contacts and on one tiny mission."""

from __future__ import annotations

import math

import numpy as np
import pytest

from auv_mcm.errors import UsageError
from sim_replay.benches.limit import VIEWS, KnownObject, across_m, best_of, fly_twice, judged, legs_across
from sim_replay.scoring.thresholds import found_at, rocks_called_at
from sim_replay.simulator.plan import planned_legs
from sim_replay.simulator.scene import (
    STEADY,
    Lawnmower,
    ObjectKind,
    Scene,
    SceneObject,
    Seabed,
    Sonar,
    Spiral,
    Track,
    World,
)
from sim_replay.simulator.scene_file import read_scene


def known(kind: str, *, seen_twice: bool = True) -> KnownObject:
    return KnownObject(kind, kind not in ("rock", "wreck"), seen_twice, (0.0, 0.0))


def test_a_target_counts_by_its_best_contact_and_clutter_counts_neither_way() -> None:
    objects = [known("box"), known("rock"), known("wreck"), known("box", seen_twice=False), known("sphere")]
    contacts = [(0, 1.0), (0, 3.0), (1, 2.0), (2, 9.0), (3, 9.0), (-1, 0.0), (-1, 1.0)]
    found = best_of(objects, contacts, 0.1)
    assert found.targets.tolist() == [3.0, -math.inf]
    assert found.rocks.tolist() == [2.0]
    assert sorted(found.false_alarms) == [0.0, 1.0, 2.0]
    assert sorted(found.bare) == [0.0, 1.0]
    assert [found_at([found], limit).count for limit in (0.0, 10.0)] == [1, 1]


def test_rocks_are_called_where_nine_targets_of_ten_are() -> None:
    some = [best_of([known("box"), known("rock")], [(0, float(k)), (1, 9.5 - k)], 0.1) for k in range(10)]
    called = rocks_called_at(some, 0.9)
    assert called is not None
    assert (called.count, called.of) == (9, 10)


def test_the_second_pass_is_square_to_the_first_and_covers_the_same_floor() -> None:
    scene = read_scene("flat")
    own, across = planned_legs(scene.track.plan), legs_across(scene)
    assert all(abs(math.cos(leg.direction_rad - own[0].direction_rad)) < 1e-9 for leg in across)
    low_m, high_m = across_m(scene)
    alongs = sorted(own[0].along_across(leg.east_m, leg.north_m)[0] for leg in across)
    gaps = np.diff([2.0 * 0.0 - alongs[0], *alongs, 2.0 * 290.0 - alongs[-1]])
    assert gaps.max() <= 80.0 + 1e-9
    for leg in across:
        ends = sorted(own[0].along_across(*place)[1] for place in ((leg.east_m, leg.north_m), leg.end))
        assert ends == pytest.approx([low_m, high_m])


def test_a_plan_that_cannot_be_crossed_is_refused_before_anything_is_flown() -> None:
    with pytest.raises(UsageError, match="lawnmower"):
        fly_twice(Scene(track=Track(plan=Spiral())))


def test_each_pass_is_judged_by_its_own_views() -> None:
    sand = Seabed(type="sand", relief_rms_m=0.0)
    placed: list[tuple[ObjectKind, float]] = [("box", 10.0), ("rock", 20.0)]
    scene = Scene(
        name="tiny",
        seed=5,
        world=World(depth_m=20.0, seabeds=(sand,), relief_rms_m=0.0, cell_m=0.1),
        objects=tuple(
            SceneObject(kind=kind, leg=0, along_m=along, across_m=12.0, strength_db=-14.0) for kind, along in placed
        ),
        sonar=Sonar(range_m=25.0, n_samples=500, ping_rate_hz=10.0, range_resolution_m=0.08, beam_lines=3),
        track=Track(plan=Lawnmower(n_legs=1, leg_m=30.0, spacing_m=30.0), altitude_m=5.0, speed_mps=2.0, motion=STEADY),
    )
    found = judged(scene, *fly_twice(scene))
    assert list(found) == list(VIEWS)
    assert all(len(one.targets) + len(one.rocks) <= 2 for one in found.values())
    assert found["one, along"].targets.max(initial=-math.inf) > -math.inf
