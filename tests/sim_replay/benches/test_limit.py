"""What the bench of the limit counts, on made-up contacts and on one tiny mission."""

from __future__ import annotations

import argparse
import math

import numpy as np
import pytest

from auv_mcm.classify.odds import shipped_odds
from auv_mcm.errors import UsageError
from auv_mcm.records import LookStep
from sim_replay.benches import limit
from sim_replay.benches.flown_twice import (
    NOTHING_NATS,
    JudgedContact,
    KnownObject,
    Passes,
    TwiceFlown,
    across_m,
    fly_twice,
    legs_across,
    sorted_flight,
)
from sim_replay.benches.limit import (
    BETTER,
    DEPENDENT,
    INDEPENDENT,
    SHIPPED,
    TRIES_PER_KM2,
    Evidence,
    Flight,
    Scores,
    chain_scores,
    correlations,
    dependence,
    fused_nats,
    observed,
    observer_scores,
    pd_count,
    report,
    rocks_called,
    threshold,
)
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

TARGET, ROCK, TYRE = (
    KnownObject(number, kind, kind == "box", True, True) for number, kind in enumerate(("box", "rock", "tyre"))
)
STEPS: tuple[LookStep, ...] = ("detector", "contours", "shape")
PRIOR = shipped_odds("cascade").prior


def contact(on: int, first: float = math.nan, second: float = math.nan) -> JudgedContact:
    """A contact with this evidence from each pass."""
    known: dict[Passes, float] = {"first": first, "second": second, "both": float(np.fmax(first, second))}
    log_odds = {name: PRIOR + ratio for name, ratio in known.items() if math.isfinite(ratio)}
    by_step = {step: PRIOR + first for step in STEPS if math.isfinite(first)}
    return JudgedContact(on, log_odds, by_step, (first, second))


def flight(*contacts: JudgedContact, scene: str = "flat", evidence: dict[int, Evidence] | None = None) -> Flight:
    return Flight(TwiceFlown(scene, 0.1, (TARGET, ROCK, TYRE), contacts), evidence or {}, ())


# ---------------------------------------------------------------- counting


def test_pd_is_at_the_lowest_threshold_with_no_more_false_alarms_than_allowed() -> None:
    scores = Scores(np.array([5.0, 3.0, 1.0, NOTHING_NATS]), np.array([4.0, 2.0, 0.0]), 0.1)
    assert [pd_count(scores, limit_per_km2) for limit_per_km2 in (9.0, 10.0, 20.0, 30.0, 1e4)] == [1, 2, 3, 3, 3]
    assert threshold(scores, 10.0) == 2.0


def test_false_alarms_by_chance_take_their_part_of_what_is_allowed() -> None:
    """Of 100 per km2 on 0.1 km2 one is left beside nine rocks: a million tries need ln(1e6) nats."""
    bare = Scores(np.array([20.0, 8.0]), np.empty(0), 0.1, 1e7)
    assert threshold(bare, 100.0) == pytest.approx(math.log(1e6 / 10.0))
    rocks = bare._replace(false_alarms=np.full(9, 30.0))
    assert threshold(rocks, 100.0) == pytest.approx(math.log(1e6))
    assert pd_count(rocks, 100.0) == 1
    assert threshold(bare._replace(false_alarms=np.full(10, 30.0)), 100.0) == 30.0


def test_a_target_counts_by_its_best_contact_and_clutter_counts_neither_way() -> None:
    flown = flight(
        contact(0, 1.0), contact(0, 3.0), contact(1, 2.0), contact(2, 9.0), contact(-1, 0.0), contact(-1, 1.0)
    )
    scores = chain_scores([flown, flight()], lambda one: one.log_odds.get("first"))
    assert scores.targets.tolist() == [PRIOR + 3.0, NOTHING_NATS]
    assert sorted(scores.false_alarms) == [PRIOR, PRIOR + 1.0, PRIOR + 2.0]
    assert scores.area_km2 == pytest.approx(0.2)
    bare = chain_scores([flown], lambda one: one.log_odds.get("first"), rocks_count=False)
    assert sorted(bare.false_alarms) == [PRIOR, PRIOR + 1.0]


def test_rocks_are_called_where_nine_targets_of_ten_are() -> None:
    some = [flight(contact(0, float(k)), contact(1, 9.5 - k)) for k in range(10)]
    assert rocks_called(some, lambda one: one.log_odds.get("first")) == (9, 10)
    assert rocks_called(some, lambda one: one.log_odds.get("second")) == (0, 10)


def test_an_observer_scores_what_the_first_pass_saw() -> None:
    flown = flight(evidence={0: Evidence(30.0, 0.0, 31.0), 1: Evidence(40.0, 45.0, 50.0)})
    scores = observer_scores([flown], lambda one: one.mine_alone, rocks_count=True)
    assert scores.targets == pytest.approx([30.0], abs=1e-6)
    assert scores.false_alarms == pytest.approx([-5.0 + math.log(TRIES_PER_KM2 / 300.0)])
    assert observer_scores([flown], lambda one: one.mine, rocks_count=False).false_alarms.size == 0


# ---------------------------------------------------------------- two views


def test_each_rule_fuses_two_views_as_it_says() -> None:
    fused = {rule: fused_nats(rule, 3.0, 1.0, 0.25) for rule in limit.RULES}
    assert fused == {BETTER: 3.0, SHIPPED: pytest.approx(3.2), DEPENDENT: pytest.approx(3.2), INDEPENDENT: 4.0}
    for rule in limit.RULES:
        assert fused_nats(rule, math.nan, 2.0, 0.5) == fused_nats(rule, 2.0, math.nan, 0.5) == 2.0


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_the_dependence_of_views_is_recovered_from_views_drawn_with_it(rho: float) -> None:
    """Evidence of variance 2 m around m for mines and -m for others, at the odds of mines that the chain presumes."""
    random, mean = np.random.Generator(np.random.PCG64(4)), 3.0
    covariance = 2.0 * mean * np.array([[1.0, rho], [rho, 1.0]])
    mines = random.multivariate_normal([mean, mean], covariance, 100)
    others = random.multivariate_normal([-mean, -mean], covariance, round(100 * math.exp(-PRIOR)))
    drawn = flight(*(contact(0, *row) for row in mines.tolist()), *(contact(-1, *row) for row in others.tolist()))
    assert dependence([drawn]) == pytest.approx(rho, abs=0.15)
    found = correlations([drawn])
    assert found["targets"][0] == 100
    assert found["targets"][1] == pytest.approx(rho, abs=0.25)
    assert found["bare floor"][1] == pytest.approx(rho, abs=0.05)


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


# ---------------------------------------------------------------- the report


def test_the_report_has_a_row_for_everyone_who_looked_and_one_per_rule() -> None:
    evidence = {0: Evidence(30.0, 5.0, 31.0), 1: Evidence(40.0, 45.0, 50.0)}
    flown = [
        flight(contact(0, 4.0, 2.0), contact(1, 3.0, -1.0), contact(-1, 0.0), scene=name, evidence=evidence)
        for name in ("flat", "rough")
    ]
    lines = report(flown, in_markdown=True).splitlines()
    for words, n in (
        ("| flat | ", 6),
        ("| all | ", 6),
        ("observer who knows no rocks", 1),
        (SHIPPED, 1),
        (DEPENDENT, 1),
    ):
        assert sum(words in line for line in lines) == n, words
    assert not any("observer" in line for line in report([flight(contact(0, 1.0))]).splitlines())


def test_scenes_that_are_not_there_are_refused_before_anything_is_flown() -> None:
    parser = argparse.ArgumentParser()
    limit.add_arguments(parser)
    with pytest.raises(UsageError, match="nowhere"):
        limit.run(parser.parse_args(["--scenes", "nowhere"]))


def test_the_chain_never_finds_more_than_the_observer_in_the_same_pings() -> None:
    """On 30 m of sand, where the observer finds the box and calls no rock."""
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
    flown = observed(scene, sorted_flight(scene, *fly_twice(scene)))
    assert [(one.kind, one.seen_first) for one in flown.flown.objects] == [(kind, True) for kind, _ in placed]
    observer = observer_scores([flown], lambda one: one.mine_alone, rocks_count=True)
    chain = chain_scores([flown], lambda one: one.log_odds.get("first"))
    assert observer.targets.min() > threshold(observer, 10.0)
    assert observer.false_alarms.max() < threshold(observer, 10.0)
    assert max(flown.bare) < 0.0
    assert all(pd_count(chain, per_km2) <= pd_count(observer, per_km2) for per_km2 in limit.LIMITS_PER_KM2)
