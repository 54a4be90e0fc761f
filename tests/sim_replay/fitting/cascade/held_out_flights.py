"""Held-out missions through the whole pipeline under one configuration, on a farm: what the scores of a trained model
are made of."""

from __future__ import annotations

import gc
import json
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import msgspec

from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.pipeline import Pipeline
from auv_mcm.settings.config import Config
from sim_replay import scoring
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.missions import config_for
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.scene_file import read_scene


class Flight(NamedTuple):
    """A mission to fly, and the configuration that the payload flies it with."""

    scene: Scene
    config: Config


def held_out(names: Sequence[str], seeds: Sequence[int], config: Config) -> tuple[Flight, ...]:
    """Every scene, as it is, with every seed, scene by scene; of the sonar the payload has an operator's settings.

    Raises UsageError for scenes that are not there.
    """
    flights = []
    for scene in map(read_scene, names):
        sonar = msgspec.structs.replace(config.sonar, beam_width_deg=config_for(scene).sonar.beam_width_deg)
        reported = msgspec.structs.replace(config, sonar=sonar)
        flights += [Flight(msgspec.structs.replace(scene, seed=seed), reported) for seed in seeds]
    return tuple(flights)


def fly(flight: Flight) -> scoring.ScoredMission:
    """What the payload reports of a mission, and the truth about it."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    mission, pipeline = Mission(flight.scene), Pipeline(flight.config)
    for event in mission.events():
        pipeline.feed(event)
    pipeline.finish()
    place = f"{flight.scene.name}, seed {flight.scene.seed}"
    contacts = scoring.parse_contacts(json.loads(contacts_geojson(pipeline.contacts)), place)
    return scoring.ScoredMission(contacts, scoring.parse_truth(mission.truth(), place), place)


def fly_all(
    flights: Sequence[Flight], farm: Farm, progress: Callable[[int], None] = lambda done: None
) -> Iterator[scoring.ScoredMission]:
    """All flights in their order, ready for `scoring.score_missions`; raises as run_tasks does."""
    return run_tasks(fly, flights, farm, progress)
