"""More budget never calls fewer mines, on ten short missions, one of every named scene."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from msgspec import structs

from auv_mcm.pipeline import Pipeline
from auv_mcm.records import SourceEvent
from auv_mcm.settings.config import Config
from sim_replay.missions import SCENES, config_for
from sim_replay.simulator.mission import Mission
from tests.accuracy.test_recorders import best_at, one_leg

SEEDS = (9501,)
DUTIES = (0.01, 0.03, 1.0)
"""Shares of a core, from the cheapest pass to everything."""
LEG_M, N_TARGETS = 40.0, 10


def n_mines_called(config: Config, events: Sequence[SourceEvent], targets: Sequence[dict[str, Any]]) -> int:
    pipeline = Pipeline(config)
    for event in events:
        pipeline.feed(event)
    pipeline.finish()
    called = tuple(contact for contact in pipeline.contacts if contact.called)
    return sum(best_at(target["lat"], target["lon"], called) is not None for target in targets)


def called_by_duty(name: str, seed: int) -> list[int]:
    scene = structs.replace(one_leg(name, LEG_M, N_TARGETS), seed=seed)
    scene = structs.replace(scene, sonar=structs.replace(scene.sonar, beam_lines=3))
    usual, mission = config_for(scene), Mission(scene)
    events = list(mission.events())
    targets = [each for each in mission.truth()["objects"] if each["is_target"]]
    budgets = [structs.replace(usual.budget, duty=duty) for duty in DUTIES]
    return [n_mines_called(structs.replace(usual, budget=budget), events, targets) for budget in budgets]


def test_more_budget_never_calls_fewer_mines() -> None:
    """On one mission a closer look may take a single mine back that the detector's odds alone had called."""
    missions = {(name, seed): called_by_duty(name, seed) for name in SCENES for seed in SEEDS}
    assert {key: n for key, n in missions.items() if any(more < less - 1 for less, more in pairwise(n))} == {}
    together = [sum(column) for column in zip(*missions.values(), strict=True)]
    assert together == sorted(together)
    assert together[-1] > 2 * together[0], "budgets that cut nothing test nothing"
