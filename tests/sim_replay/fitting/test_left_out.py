"""Weights on domains that they were not fitted on: what is left out, what is counted, and what is kept of missions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from auv_mcm.classify.odds import shipped_odds
from auv_mcm.errors import BadInputError, UsageError
from sim_replay.fitting import looks
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.fit_odds import STEPS, LookTable, StepTable
from sim_replay.fitting.left_out import (
    FITTED,
    KINDS,
    Scored,
    dealt,
    error_of,
    fitted_on,
    kind_of,
    left_out_scores,
    left_out_tasks,
    pd_at,
)
from sim_replay.fitting.looks import DRAWN, LookTask, MissionLooks, all_looks, read_looks, write_looks
from sim_replay.fitting.recorders import RECORDERS

LOG_RECORDER = "log 0.3 dB"
LINE = "somewhere/reef.xtf"
N_LOOKS = 60
NAMES = tuple(dict.fromkeys(name for tree in shipped_odds("cascade").detector.trees for name, *_ in tree.ask))


def drawn_mission(task: LookTask, law: str = "amplitude_uint16", number: int = 0) -> MissionLooks:
    """Looks in which the score of the cascade separates targets, a quarter of all, and nothing else does."""
    random = np.random.Generator(np.random.PCG64([number, task.seed]))
    is_target = np.arange(N_LOOKS) % 4 == 0
    steps = {}
    for step in STEPS:
        values = random.normal(0.0, 1.0, (N_LOOKS, len(NAMES)))
        values[:, NAMES.index("cascade_score")] += 6.0 * is_target
        steps[step] = StepTable(NAMES, len(NAMES), values)
    usual = np.full(N_LOOKS, task.times == 1 and task.source != DRAWN)
    table = LookTable(usual, is_target, is_target, np.where(is_target, 1.0, 2.0), steps)
    return MissionLooks(task, law, int(is_target.sum()), 0.05, table)


def some_missions() -> list[MissionLooks]:
    judged = left_out_tasks(("flat", "ripple", "mixed"), 1, [Path(LINE), Path("river.xtf")], 1)
    tasks = [task for task in judged if task.recorder in (None, LOG_RECORDER)]
    tasks += [LookTask(name, 9, 3) for name in ("flat", "ripple", "mixed")]
    missions = [drawn_mission(task, number=number) for number, task in enumerate(tasks)]
    drawn = [drawn_mission(LookTask(DRAWN, 7), "log_uint8", 50), drawn_mission(LookTask(DRAWN, 8), number=51)]
    return [*missions, *drawn]


def test_a_domain_is_left_out_with_all_that_is_like_it() -> None:
    missions = some_missions()
    everything = {*FITTED, *KINDS}

    def domains(out: str, judged_only: frozenset[str] = frozenset()) -> list[str]:
        chosen = fitted_on(missions, everything, frozenset({out}), judged_only)
        return sorted(one.task.domain for one in chosen if one.task.recorder is None)

    assert domains("flat") == sorted([*2 * ["ripple"], *2 * ["mixed"], DRAWN, DRAWN, "reef", "river"])
    own = [*2 * ["flat"], *2 * ["ripple"], *2 * ["mixed"]]
    assert domains("reef", frozenset({"river"})) == sorted([*own, DRAWN, DRAWN])
    assert domains(LOG_RECORDER).count(DRAWN) == 1, "the one whose recorder has another law"
    assert domains(LOG_RECORDER).count("ripple") == 1, "other floors"
    assert {kind_of(one.task) for one in fitted_on(missions, {DRAWN}, frozenset(), frozenset())} == {DRAWN}


def test_every_domain_is_dealt_into_one_part() -> None:
    missions = some_missions()
    each = dealt(missions, 99)
    assert sorted(domain for part in each for domain in part) == sorted(
        ["flat", "ripple", "mixed", LOG_RECORDER, "reef", "river"]
    )
    assert [len(part) for part in each] == [1] * 6
    assert sorted(len(part) for part in dealt(missions, 4)) == [1, 1, 2, 2]


@pytest.mark.parametrize("limit", [0.0, 10.0, 100.0, 1e6])
def test_looks_at_targets_are_counted_above_the_threshold_that_lets_so_many_false_alarms_pass(limit: float) -> None:
    random = np.random.Generator(np.random.PCG64(3))
    missions = [
        Scored("flat", random.normal(0.0, 2.0, 40), random.random(40) < 0.3, random.choice([1.0, 4.0], 40), 20, 0.1)
        for _ in range(3)
    ]
    joined = [
        (odds, target, weight)
        for one in missions
        for odds, target, weight in zip(one.log_odds, one.is_target, one.weight, strict=True)
    ]
    best = 0.0
    for threshold, _, _ in joined:
        if sum(weight for odds, target, weight in joined if odds >= threshold and not target) <= limit * 0.3:
            best = max(best, sum(weight for odds, target, weight in joined if odds >= threshold and target))
    assert pd_at(missions, limit) == pytest.approx(min(best / 60.0, 1.0))


def test_the_calibration_error_counts_a_look_as_often_as_it_stands_for() -> None:
    mission = Scored("flat", np.zeros(2), np.array([True, False]), np.array([1.0, 3.0]), 1, 0.1)
    assert error_of([mission]) == pytest.approx(0.25)
    assert error_of([mission._replace(log_odds=np.empty(0), is_target=np.empty(0, bool), weight=np.empty(0))]) is None


def test_what_carries_over_is_found_on_the_domain_left_out() -> None:
    folds = [frozenset({"flat"}), frozenset({"reef"}), frozenset({LOG_RECORDER})]
    found = left_out_scores(some_missions(), frozenset(), folds, n_trees=40)
    assert {one.domain for one in found} == {"flat", "reef", LOG_RECORDER}
    assert pd_at(found, 10.0) > 0.9


# ---------------------------------------------------------------- missions in a folder


def same(one: MissionLooks, other: MissionLooks) -> bool:
    assert one[:4] == other[:4]
    for step in STEPS:
        assert one.looks.steps[step].names == other.looks.steps[step].names
        assert one.looks.steps[step].n_summed == other.looks.steps[step].n_summed
        assert np.array_equal(one.looks.steps[step].values, other.looks.steps[step].values)
    return all(np.array_equal(a, b) for a, b in zip(one.looks[:4], other.looks[:4], strict=True))


@pytest.mark.parametrize(
    "task", [LookTask("flat", 3, 3), LookTask("flat", 3, 1, LOG_RECORDER), LookTask(DRAWN, 4), LookTask(LINE, 5)]
)
def test_a_mission_comes_back_from_its_file_as_it_was(tmp_path: Path, task: LookTask) -> None:
    mission = drawn_mission(task)
    write_looks(mission, tmp_path)
    assert same(read_looks(task, tmp_path), mission)


def test_missions_in_the_folder_are_not_flown_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tasks = [LookTask("flat", 1), LookTask("flat", 2), LookTask("flat", 1, 1, next(iter(RECORDERS)))]
    flown: list[LookTask] = []

    def fly(task: LookTask) -> MissionLooks:
        flown.append(task)
        return drawn_mission(task)

    monkeypatch.setattr(looks, "fly_looks", fly)
    write_looks(drawn_mission(tasks[1]), tmp_path)
    assert [one.task for one in all_looks(tasks, tmp_path, Farm())] == tasks
    assert flown == [tasks[0], tasks[2]]


def test_a_file_that_holds_no_looks_is_named(tmp_path: Path) -> None:
    task = LookTask("flat", 1)
    write_looks(drawn_mission(task), tmp_path)
    (place,) = tmp_path.iterdir()
    place.write_bytes(place.read_bytes()[:200])
    with pytest.raises(BadInputError, match=r"flat-x1-1\.npz holds no looks"):
        read_looks(task, tmp_path)


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="cannot be made"):
        all_looks([LookTask("flat", 1)], tmp_path / "file" / "looks", Farm())
